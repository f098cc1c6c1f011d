"""One dataset out of recordings and sensor files: what `spheremcap merge` and `spheremcap sync` do."""

import itertools
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

from spheremcap.errors import UsageError, printable
from spheremcap.io import recording
from spheremcap.io.frames import frames_of
from spheremcap.io.join import McapStream, Merged, Stream, frame_prefix, in_range, merge_streams
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import checked_output
from spheremcap.io.sources import is_recording
from spheremcap.merging.clock import Clock
from spheremcap.merging.frames import FramesStream, loose
from spheremcap.merging.log import SensorLog
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.placement import Placement, apart, base_ns, given_words
from spheremcap.merging.samples import SensorStream
from spheremcap.merging.sensors import read_sensors
from spheremcap.merging.sync import Sync, SyncConfig, SyncError, residual_log, sync_marker
from spheremcap.merging.times import YEAR_2000_NS, Timing


@dataclass(frozen=True)
class Source:
    """One input: an MCAP, or a sensor file or folder (`name` goes into its topics; the file's by default).

    `offset_ns` and `drift` correct its clock; `prefix` goes before an MCAP's topics; `mapping` and `rate_hz`
    are for tables. `sync_marker` names the marker whose track the sensor's clock is found from; its offset
    then is the guess.
    """

    path: Path
    name: str = ""
    offset_ns: int = 0
    drift: Fraction = Fraction(0)
    prefix: str = ""
    mapping: TableMapping | None = None
    rate_hz: float | None = None
    sync_marker: str | None = None

    @property
    def label(self) -> str:
        """How the input is called in `--offset NAME=...` and in topics."""
        return self.name or self.path.stem


@dataclass(frozen=True)
class Dataset:
    """What a merge made: messages by topic, lines for the user, where each input was placed and why, what was lost of
    sensor files, and the clocks that were found.
    """

    merged: Merged
    notes: tuple[str, ...]
    placements: tuple[Placement, ...] = ()
    sensors_lost: tuple[str, ...] = ()
    syncs: Mapping[str, Sync] = field(default_factory=dict)

    @property
    def lost(self) -> tuple[str, ...]:
        """What of the inputs is not in the output, one line each."""
        return self.sensors_lost + self.merged.lost


@dataclass(frozen=True)
class _Recording:
    """An MCAP input with its clock, and its first message's own stamp (None: it has no messages)."""

    source: Source
    records: McapRecords
    first_ns: int | None
    clock: Clock

    @property
    def last_ns(self) -> int:
        """The last message's own stamp, as far as the file itself says; 0 without messages."""
        span_ns = self.records.span_ns or (0, 0)
        return max(self.first_ns or 0, span_ns[1])

    def placement(self) -> Placement | None:
        if self.first_ns is None:
            return None
        source = self.source
        return Placement(
            source.label, source.label, source.path.name, "messages", sum(self.records.counts.values()),
            self.first_ns, self.last_ns, None, Timing("log times"), self.clock,
            given_words(source.offset_ns, source.drift), source.offset_ns,
        )  # fmt: skip


def merge(
    sources: Sequence[Source],
    output: str | os.PathLike[str],
    *,
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    force: bool = False,
    config: SyncConfig | None = None,
    say: Callable[[str], None] = lambda line: None,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> Dataset:
    """Merge recordings and sensor files by log time into `output`; inputs stay as they are.

    Every input's clock comes first, and what is read of an input is read through it. A sensor whose stamps count
    from the start of its device keeps them after the start of the MCAP inputs, and its offset is added to that. `say`
    gets a line on each placement and each note, before anything is written; `progress` gets messages done and expected.
    `inputs` are further files that the output must not be (mappings).
    `stop` is asked before each input and while they are written: once it says yes the merge ends, and what there is
    stays readable in OUT.part; from then on it has to say yes.

    Raises a SpheremcapError for inputs that cannot be read and clocks that cannot be found, and a UsageError for inputs
    that do not overlap the others or whose clock began anew, unless `force` takes them as they are.
    """
    given_files = [*(source.path for source in sources), *inputs]
    checked_output(output, given_files, overwrite=overwrite)
    with ExitStack() as stack:
        recordings: list[_Recording] = []
        logs: list[tuple[Source, list[SensorLog]]] = []
        for source in sources:
            if stop():
                break
            if is_recording(source.path):
                records = stack.enter_context(McapRecords(source.path))
                first_ns = first_log_time(records)
                clock = Clock(source.offset_ns, source.drift, first_ns or 0)
                recordings.append(_Recording(source, records, first_ns, clock))
            else:
                found = read_sensors(source.path, name=source.label, mapping=source.mapping, rate_hz=source.rate_hz)
                logs.append((source, found))
        _all_different([log.name for _, found in logs for log in found], recordings)
        placed, syncs = _placed(recordings, logs, config)
        placements = [p for r in recordings if (p := r.placement()) is not None] + [p for _, p in placed]
        for place in placements:
            for stamp_ns in place.span_ns[: 1 if place.what == "messages" else 2]:  # a damaged file may state any end
                in_range(stamp_ns, place.input)
        notes = [p.line() for p in placements] + _timeless(recordings)
        for log, _ in placed:
            notes.extend(log.notes)
            if log.name in syncs:
                notes.append(f"{log.name}: {syncs[log.name].line()}")
        for line in notes:
            say(line)
        doubts = [doubt for log, _ in placed for doubt in log.doubts] + apart(placements)
        if doubts and not force and not stop():
            raise UsageError("; ".join(doubts) + "; --force merges as it stands")
        notes.extend(doubts)
        for doubt in doubts:
            say(doubt)
        streams = [_stream(r) for r in recordings]
        apart_frames = _loose_frames(recordings, placed)
        if apart_frames:
            notes.append(f"nothing says where {', '.join(apart_frames)} stand: at the world's origin, for viewers")
            say(notes[-1])
            streams.append(FramesStream(apart_frames, _own_topic(recordings), [p.span_ns for p in placements]))
        for log, place in placed:
            sync_facts = syncs[log.name].facts() if log.name in syncs else {}
            streams.append(SensorStream(log, place.clock, facts=place.facts() | sync_facts))
            if log.name in syncs:
                topic = f"/sync/{log.name}/residual"
                streams.append(SensorStream(residual_log(syncs[log.name], log.name), topic=topic))
        merged = merge_streams(streams, output, inputs=given_files, overwrite=overwrite, progress=progress, stop=stop)
        late = list(merged.notes)
        for own in recordings:
            if own.records.unordered:
                late.append(
                    f"{own.records.path}: {own.records.unordered} messages were out of order; sorted by log time"
                )
        notes.extend(late)
        for line in late:
            say(line)
    lost = tuple(line for log, _ in placed for line in log.lost)
    return Dataset(merged, tuple(notes), tuple(placements), lost, syncs)


def _timeless(recordings: Sequence[_Recording]) -> list[str]:
    """A line for each recording that begins in 1970, because its video does not say when it was."""
    return [
        f"{own.records.path}: its video does not say when it was, so it begins at 1970: track it with --start-time, or "
        f"give --offset {own.source.label}=TIME"
        for own in recordings
        if any(facts.get("time_source") == "zero" for facts in recording.runs_of(own.records).values())
        and own.first_ns is not None
        and own.clock(own.first_ns) < YEAR_2000_NS
    ]


def _loose_frames(recordings: Sequence[_Recording], placed: Sequence[tuple[SensorLog, Placement]]) -> list[str]:
    """The coordinate frames that nothing connects with the others."""
    used = {log.frame_id for log, _ in placed if log.kind != "record" and log.frame_id}
    parents: dict[str, str] = {}
    for own in recordings:
        found = frames_of(own.records)
        if found is None:  # they are connected in a way that is not read here
            continue
        before = frame_prefix(own.source.prefix)
        used |= {before + frame for frame in found[0]}
        parents |= {before + child: before + parent for child, parent in found[1].items()}
    return loose(used, parents)


def _own_topic(recordings: Sequence[_Recording]) -> str:
    """A topic for the frames that no input has."""
    taken = {own.source.prefix + c.topic for own in recordings for c in own.records.channels.values()}
    return next(t for n in itertools.count(1) if (t := f"/merged{n if n > 1 else ''}/tf") not in taken)


def _stream(own: _Recording) -> Stream:
    moved = own.source.offset_ns or own.source.drift
    place = own.placement()
    return McapStream(
        own.records, clock=own.clock if moved else None, prefix=own.source.prefix,
        facts=None if place is None else (own.source.label, place.facts()),
    )  # fmt: skip


def _all_different(names: Sequence[str], recordings: Sequence[_Recording]) -> None:
    """Raises UsageError where two sensors would share a topic."""
    topics = {own.source.prefix + c.topic: own.source for own in recordings for c in own.records.channels.values()}
    for name, count in Counter(names).items():
        if (there := topics.get(f"/sensors/{name}")) is not None:
            raise UsageError(f"{there.path} has /sensors/{name} already: give the file another name, as in other=PATH")
        if count > 1:
            raise UsageError(f"{count} sensors would be /sensors/{name}: give one another name, as in other=PATH")


def _placed(
    recordings: Sequence[_Recording],
    logs: Sequence[tuple[Source, list[SensorLog]]],
    config: SyncConfig | None,
) -> tuple[list[tuple[SensorLog, Placement]], dict[str, Sync]]:
    """Every sensor with its place. All logs of one input that count from the same zero have one clock."""
    starts = [(own.clock(own.first_ns), own.source.label) for own in recordings if own.first_ns is not None]
    if not starts:  # without recordings the sensors with a true clock say when it was
        for source, found in logs:
            firsts = [int(log.stamp_ns[0]) for log in found if log.timing.zero == "1970"]
            starts.extend((first + source.offset_ns, source.label) for first in firsts)
    start_ns, start_of = min(starts, key=lambda start: start[0], default=(None, ""))
    ends = [own.clock(own.last_ns) for own in recordings if own.first_ns is not None]
    placed: list[tuple[SensorLog, Placement]] = []
    syncs: dict[str, Sync] = {}
    for source, found in logs:
        for zero in dict.fromkeys(log.timing.zero for log in found):
            own = [log for log in found if log.timing.zero == zero]
            first = min(int(log.stamp_ns[0]) for log in own)
            last = max(int(log.stamp_ns[-1]) for log in own)
            base, words = base_ns(zero, first, start_ns, start_of)
            synced = source.sync_marker is not None  # which says the drift too
            words += given_words(source.offset_ns, Fraction(0) if synced else source.drift)
            clock = Clock(base + source.offset_ns, source.drift, first)
            if synced:
                if start_ns is not None and zero == "start" and (clock(first) > max(ends) or clock(last) < start_ns):
                    clock = Clock(start_ns - first, Fraction(0), first)
                    words = (f"its first sample at the start of {start_of} as a guess",)
                name, sync = _synchronised(source, own, clock, recordings, config)
                clock, syncs[name] = sync.clock, sync
                found_ns = round(sync.offset_s * 1e9)
                words += (f"{found_ns / 1e6:+.3f} ms and {sync.drift_ppm:+.2f} ppm (sync with {source.sync_marker})",)
            for log in own:
                first_ns, last_ns = int(log.stamp_ns[0]), int(log.stamp_ns[-1])
                place = Placement(
                    log.name, source.label, log.source, "samples", len(log), first_ns, last_ns, log.rate_hz,
                    log.timing, clock, words, source.offset_ns,
                )  # fmt: skip
                placed.append((log, place))
    return placed, syncs


def _synchronised(
    source: Source, logs: Sequence[SensorLog], guess: Clock, recordings: Sequence[_Recording], config: SyncConfig | None
) -> tuple[str, Sync]:
    """The clock found from the marker's motion, read through its recording's clock; of several sensors of one input
    by the one that says most clearly.
    """
    for own in recordings:
        track = recording.open(own.records.path).tracks.get(source.sync_marker or "")
        if track is None:
            continue
        xyz = track.xyz_cam_m.copy()
        xyz[~track.measured] = float("nan")
        stamp_ns = own.clock.all(track.stamp_ns.tolist())
        found: list[tuple[str, Sync]] = []
        errors: list[SyncError] = []
        for log in logs:
            try:
                sync = sync_marker(
                    stamp_ns, xyz, log.stamp_ns, log.values, saturated=log.saturated,
                    guess_ns=guess.offset_ns, config=config,
                )  # fmt: skip
                found.append((log.name, sync))
            except SyncError as error:
                errors.append(SyncError(f"{log.name}: {error}"))
        if not found:
            raise errors[0]
        return max(found, key=lambda pair: pair[1].distinction)
    raise UsageError(f"{source.label}: no recording has a marker {source.sync_marker!r} to synchronise with")


def sync_recording(found: recording.Recording, marker: str, sensor: str, *, config: SyncConfig | None = None) -> Sync:
    """Offset and drift of a sensor that is already in a recording, against a marker's track there.

    `sync.clock` maps the sensor's own stamps (publish times) to the video's; `sync.offset_s` is what to add
    to where it stands in the recording now. Raises UsageError naming what there is, SyncError when there is
    no clear answer.
    """
    if marker not in found.tracks:
        raise UsageError(
            f"{found.path}: no marker {marker!r}; there are: {printable(', '.join(found.tracks)) or 'none'}"
        )
    if sensor not in found.sensors:
        raise UsageError(
            f"{found.path}: no sensor {sensor!r}; there are: {printable(', '.join(found.sensors)) or 'none'}"
        )
    track, samples = found.tracks[marker], found.sensors[sensor]
    xyz = track.xyz_cam_m.copy()
    xyz[~track.measured] = float("nan")
    guess_ns = int(samples.stamp_ns[0] - samples.own_stamp_ns[0])
    sync = sync_marker(track.stamp_ns, xyz, samples.own_stamp_ns, samples.values, guess_ns=guess_ns, config=config)
    return replace(sync, guess_ns=guess_ns)


def first_log_time(records: McapRecords) -> int | None:
    """The log time of the first message, None when there is none."""
    first = next(records.messages(), None)
    return None if first is None else first.log_time
