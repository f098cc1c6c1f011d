"""One dataset out of recordings and sensor files: what `spheremcap merge` and `spheremcap sync` do."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

from spheremcap.errors import UsageError
from spheremcap.io import recording
from spheremcap.io.join import McapStream, Merged, Stream, merge_streams
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import checked_output
from spheremcap.io.sources import is_recording
from spheremcap.merge.clock import Clock
from spheremcap.merge.samples import SensorStream
from spheremcap.merge.sensors import SensorLog, TableMapping, read_sensors
from spheremcap.merge.sync import Sync, SyncConfig, residual_log, sync_marker


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
    """What a merge made: messages by topic, lines for the user, what was lost, and the clocks that were
    found.
    """

    merged: Merged
    notes: tuple[str, ...]
    syncs: Mapping[str, Sync] = field(default_factory=dict)


def merge(
    sources: Sequence[Source],
    output: str | os.PathLike[str],
    *,
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    config: SyncConfig | None = None,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> Dataset:
    """Merge recordings and sensor files by log time into `output`; inputs stay as they are.

    A sensor whose stamps count from zero starts with the first message of the MCAP inputs, and its offset is
    added to that. `inputs` are further files that the output must not be (mappings). `progress` gets messages done and
    expected. `stop` is asked before each input and while they are written: once it says yes the merge ends, and what
    there is stays readable in OUT.part; from then on it has to say yes. Raises a SpheremcapError for inputs that cannot
    be read and clocks that cannot be found.
    """
    given_files = [*(source.path for source in sources), *inputs]
    checked_output(output, given_files, overwrite=overwrite)
    notes: list[str] = []
    syncs: dict[str, Sync] = {}
    with ExitStack() as stack:
        streams: list[Stream] = []
        opened: list[McapRecords] = []
        for source in sources:
            if stop():
                break
            if is_recording(source.path):
                records = stack.enter_context(McapRecords(source.path))
                opened.append(records)
                start_ns = first_log_time(records) or 0
                moved = source.offset_ns or source.drift
                clock = Clock(source.offset_ns, source.drift, start_ns) if moved else None
                streams.append(McapStream(records, clock=clock, prefix=source.prefix))
        starts = [ns for ns in map(first_log_time, opened) if ns is not None]
        for source in sources:
            if stop():
                break
            if is_recording(source.path):
                continue
            for log in read_sensors(source.path, name=source.label, mapping=source.mapping, rate_hz=source.rate_hz):
                notes.extend(log.notes)
                clock, sync = _sensor_clock(source, log, min(starts, default=None), opened, config)
                streams.append(SensorStream(log, clock))
                if log.relative and starts:
                    notes.append(f"{log.name}: its times count from zero, which is the recording's start")
                if sync is not None:
                    syncs[log.name] = sync
                    notes.append(f"{log.name}: {sync.line()}")
                    streams.append(SensorStream(residual_log(sync, log.name), topic=f"/sync/{log.name}/residual"))
        merged = merge_streams(streams, output, inputs=given_files, overwrite=overwrite, progress=progress, stop=stop)
        notes.extend(merged.notes)
        for records in opened:
            if records.unordered:
                notes.append(f"{records.path}: {records.unordered} messages were out of order; sorted by log time")
    return Dataset(merged, tuple(notes), syncs)


def _sensor_clock(
    source: Source,
    log: SensorLog,
    start_ns: int | None,
    opened: Sequence[McapRecords],
    config: SyncConfig | None,
) -> tuple[Clock, Sync | None]:
    """The clock as given, or found from the marker; a relative one starts with the recordings."""
    first = int(log.stamp_ns[0]) if len(log) else 0
    base = start_ns - first if log.relative and start_ns is not None else 0
    given = Clock(base + source.offset_ns, source.drift, first)
    if source.sync_marker is None:
        return given, None
    for records in opened:
        track = recording.open(records.path).tracks.get(source.sync_marker)
        if track is not None:
            xyz = track.xyz_cam_m.copy()
            xyz[~track.measured] = float("nan")
            sync = sync_marker(
                track.stamp_ns, xyz, log.stamp_ns, log.values, saturated=log.saturated,
                guess_ns=given.offset_ns, config=config,
            )  # fmt: skip
            return sync.clock, sync
    raise UsageError(f"{source.label}: no recording has a marker {source.sync_marker!r} to synchronise with")


def sync_recording(path: str | os.PathLike[str], marker: str, sensor: str, *, config: SyncConfig | None = None) -> Sync:
    """Offset and drift of a sensor that is already in a recording, against a marker's track there.

    `sync.clock` maps the sensor's own stamps (publish times) to the video's; `sync.offset_s` is what to add
    to where it stands in the recording now. Raises UsageError naming what there is, SyncError when there is
    no clear answer.
    """
    found = recording.open(path)
    if marker not in found.tracks:
        raise UsageError(f"{path}: no marker {marker!r}; there are: {', '.join(found.tracks) or 'none'}")
    if sensor not in found.sensors:
        raise UsageError(f"{path}: no sensor {sensor!r}; there are: {', '.join(found.sensors) or 'none'}")
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
