"""A recording with a person's answers in it: what they change is tracked again, all else is copied as it is.

The recording holds the track without any answer, its base: on channels of its own, or, where answers changed it before,
under /replaced. So whatever has been answered, the base can be had back, and all answers are put in anew: what comes
out depends on base and answers alone.
"""

import itertools
import json
import tomllib
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import cast

from spheremcap.config import Settings, answers_in, seeds_toml
from spheremcap.core.camera import Camera
from spheremcap.core.estimate import MarkerEstimate, OperatorRequest, Status
from spheremcap.core.frame import Frame
from spheremcap.core.marker import Answer, Hidden, Keep, Seed
from spheremcap.errors import SettingsError, SourceError, UsageError
from spheremcap.io import _pb, messages, overlays
from spheremcap.io.join import OutMessage
from spheremcap.io.mcap_images import TimeBase
from spheremcap.io.mcap_log import (
    OUTCOME_METADATA,
    RUN_METADATA,
    TRAIL_NS,
    Scene,
    debug_messages,
    font_px,
    marker_messages,
    run_id,
    schema_id,
)
from spheremcap.io.mcap_records import McapRecords, Piece, RawMessage
from spheremcap.io.messages import Message
from spheremcap.io.output import records_output
from spheremcap.io.pictures import open_pictures
from spheremcap.io.recording import request_of, runs_of
from spheremcap.io.rewrite import ChunkWriter
from spheremcap.io.sources import fingerprint
from spheremcap.io.states import FrameStates, as_before, channels_before, is_answered
from spheremcap.io.topics import ANSWERED, REPLACED, Topics, topics_of
from spheremcap.session import check_answers, hidden_estimate
from spheremcap.stretch import Corrected, KeepView, Stretch, Terms, base_seeds, correct

ANSWERS = "answers"
"""The line of a run's metadata that says what was answered."""
_SEEDS, _SETTINGS = "seeds.toml", "settings.toml"
ViewKeeper = Callable[[Settings], KeepView]


@dataclass
class RetrackReport:
    """What `retrack` did. `stretches` says in a line each what the answers changed; `frames` were tracked again for
    that; `statuses` is by how much the numbers of frames have changed, by marker; `requests` are still open.

    One that was `stopped` left what it had written in `part` (None: it had written nothing).
    """

    output: Path
    stretches: list[str] = field(default_factory=list)
    frames: int = 0
    statuses: dict[str, Counter[Status]] = field(default_factory=dict)
    requests: int = 0
    lost: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stopped: bool = False
    part: Path | None = None

    @property
    def complete(self) -> bool:
        """Nothing was lost, and no marker is lost at the end."""
        return not self.lost and not self.stopped


def camera_fact(camera: Camera, metric: bool) -> str:
    """What a recording says of the camera that it was tracked with, to the last digit."""
    return json.dumps(asdict(camera) | {"metric": metric})


def _camera_of(fact: str) -> tuple[Camera, bool]:
    """The camera, and whether its metres may be given out. Raises ValueError, TypeError or KeyError."""
    numbers = json.loads(fact)
    metric = bool(numbers.pop("metric"))
    return Camera(**numbers | {"distortion": tuple(numbers["distortion"])}), metric


class Run:
    """One camera's run in a recording: what it was tracked with and what was found, without any answer.

    `answers` are those that the recording has now, its first circles among them. `name` goes before its markers' names
    where a recording has several cameras.
    """

    def __init__(self, records: McapRecords, id_: str, facts: Mapping[str, str], settings: str, seeds: str) -> None:
        self.id, self.facts, self.settings_toml, self.seeds_toml = id_, facts, settings, seeds
        self.name = facts.get("name", "")
        records_own = (r.metadata for r in records.metadata if r.name == RUN_METADATA + id_)
        self.own_facts: dict[str, str] = next(records_own, {})  # without those of its outcome
        topics = topics_of(facts)
        if topics is None or "camera" not in facts:
            raise SourceError(f"{records.path}: an earlier version wrote it: track it again, and correct that")
        self.topics: Topics = topics
        try:
            self.settings = Settings.model_validate(tomllib.loads(settings))
            self.answers = answers_in(tomllib.loads(seeds), _SEEDS)
            self.camera, self.metric = _camera_of(facts["camera"])
        except (ValueError, TypeError, KeyError, SettingsError) as error:
            raise SourceError(f"{records.path}: what it says of its settings cannot be read: {error}") from error
        self.specs = tuple(marker.spec() for marker in self.settings.markers)
        self.states = FrameStates(records, topics, [spec.name for spec in self.specs])

    def terms(self, view_keeper: ViewKeeper) -> Terms:
        """How it was tracked."""
        known = self.settings.camera
        return Terms(
            self.camera, self.metric, self.specs, self.settings.chain, self.settings.session, known.exposure_s,
            known.readout_s, self.states.first_index, self.states.last_index, lambda: view_keeper(self.settings),
        )  # fmt: skip


def runs_in(records: McapRecords) -> list[Run]:
    """The runs of a recording, by the settings and seeds that go with each. Raises SourceError where there is none."""
    facts = runs_of(records)
    texts = [
        (a.name, a.data.decode("utf-8", "replace")) for a in records.attachments() if a.name in (_SEEDS, _SETTINGS)
    ]
    found: dict[str, Run] = {}
    for (name, settings), (after, seeds) in itertools.pairwise(texts):
        if (name, after) != (_SETTINGS, _SEEDS):
            continue
        for id_, lines in facts.items():
            is_its = id_ == run_id(lines.get("version", ""), input_of(lines), settings, seeds)
            if is_its and id_ not in found:
                found[id_] = Run(records, id_, lines, settings, seeds)
    if not found:
        raise SourceError(f"{records.path}: no run of spheremcap track is in it: only what it wrote can be corrected")
    return list(found.values())


def input_of(facts: Mapping[str, str]) -> str:
    return facts.get("input_sha256") or facts.get("input_name", "")


def merged_answers(run: Run, given: Sequence[Answer]) -> list[Answer]:
    """What was given, begun by the circles that the run began with. Raises UsageError where one of them is another."""
    first = base_seeds(run.answers)
    merged = list(given)
    for seed in reversed(first):
        same = [
            a for a in merged if isinstance(a, Seed) and (a.marker, a.frame_index) == (seed.marker, seed.frame_index)
        ]
        if any(one.circle != seed.circle for one in same):
            raise UsageError(
                f"{seed.marker} was tracked from another circle on frame {seed.frame_index}: where that is to change, "
                "track it again, or give the right circle on the frame after it"
            )
        own = [a for a in merged if isinstance(a, Seed) and a.marker == seed.marker]
        if not same or own[0] is not same[0]:
            merged = [*same, *(a for a in merged if a not in same)] if same else [seed, *merged]
    return merged


def check(run: Run, answers: Sequence[Answer], path: Path) -> None:
    """Raises UsageError for answers that do not fit the recording."""
    names = [spec.name for spec in run.specs]
    check_answers(answers, names, run.camera.width_px, run.camera.height_px)
    first, last = run.states.first_index, run.states.last_index
    for answer in answers:
        if not first <= answer.frame_index <= last:
            raise UsageError(
                f"{path}: seed of {answer.marker} on frame {answer.frame_index}: there are frames {first} to {last}"
            )


# --- the frames ---


class Footage:
    """The frames that a run was tracked on, by its own indices and stamps. `note` says where they are not the same.

    Without `source` the recording's own pictures are taken where they are those of the input, else the input beside
    it, else the recording's own after all. Raises SourceError where there are none, or the input is another.
    """

    def __init__(self, run: Run, records: McapRecords, source: Path | None, checked: bool, files: ExitStack) -> None:
        self._states = run.states
        self._shift_ns: int | None = None
        self._right: Future[None] | None = None
        self.note = ""
        own = _own_pictures(run, records)
        beside = records.path.parent / run.facts.get("input_name", "")
        if source is None and own is not None and own.exact:
            self.pictures = files.enter_context(open_pictures(records.path, topic=own.topic, time=own.time))
            return
        path = source or beside
        if source is None and not _fits(path, run.facts):
            if own is None:
                raise SourceError(
                    f"{records.path}: the pictures that it was tracked on are needed: put {beside.name} beside it, or "
                    "say with --source where it is"
                )
            self.note = (
                f"tracked on the recording's own pictures, which were encoded once: {beside.name} is not beside it"
            )
            self.pictures = files.enter_context(open_pictures(records.path, topic=own.topic, time=own.time))
            return
        if not checked:
            if not _fits(path, run.facts):
                raise SourceError(f"{path}: is not what {records.path} was tracked on: another size, or not there")
            pool = files.enter_context(ThreadPoolExecutor(1, "hash"))
            self._right = pool.submit(_compare_hash, path, run.facts, records.path)
        rate = run.facts.get("rate")
        topic, time = run.facts.get("image_topic"), cast(TimeBase, run.facts.get("image_time", "header"))
        self.pictures = files.enter_context(
            open_pictures(path, topic=topic, time=time, rate=None if rate is None else Fraction(rate))
        )

    @property
    def path(self) -> Path:
        return self.pictures.path

    def at(self, index: int) -> Frame | None:
        """The frame of that index with the stamp that the recording has; None where it cannot be decoded."""
        if not self.pictures.first_index <= index < self.pictures.count:
            return None
        frame = self.pictures.frame(index)
        if frame is None:
            return None
        if self._shift_ns is None:
            states = self._states
            self._shift_ns = states.stamp_ns(states.count - 1) - self.pictures.stamp_ns(states.last_index)
        if self._shift_ns:
            frame = copy(frame)
            frame.stamp_ns += self._shift_ns
        return frame

    def confirm(self) -> None:
        """Wait until the input is known to be the very one. Raises SourceError where it is not."""
        if self._right is not None:
            self._right.result()


@dataclass(frozen=True)
class _Own:
    """The recording's own pictures, and whether they are those of the input, to the pixel and by the same numbers."""

    topic: str
    time: TimeBase
    exact: bool


def _own_pictures(run: Run, records: McapRecords) -> _Own | None:
    counts: Counter[str] = Counter()
    for channel in records.channels.values():
        counts[channel.topic] += records.counts.get(channel.id, 0)
    topic = run.facts.get("image_topic", "")
    if counts[topic]:
        return _Own(topic, cast(TimeBase, run.facts.get("image_time", "header")), True)
    for topic in (run.topics.video, run.topics.image):
        if counts[topic] == run.states.last_index + 1:  # none was lost, so messages go by the frames' numbers
            return _Own(topic, "header", run.facts.get("video", "").startswith("video passed through"))
    return None


def _fits(path: Path, facts: Mapping[str, str]) -> bool:
    """Whether a file or folder of the input's name and size is there."""
    try:
        if path.is_dir():
            return bool(facts.get("rate"))
        return path.is_file() and str(path.stat().st_size) == facts.get("input_size")
    except OSError:
        return False


def _compare_hash(path: Path, facts: Mapping[str, str], recording: Path) -> None:
    if fingerprint(path)[1] != facts.get("input_sha256"):
        raise SourceError(f"{path}: is not what {recording} was tracked on: its content is another")


# --- what was asked and answered ---


def said(answer: Answer) -> str:
    """An answer in words: "circle on frame 162, anna"."""
    frames = f"frame {answer.frame_index}"
    if not isinstance(answer, Seed):
        frames = f"frames {answer.frame_index} to {answer.to_frame_index}"
    what = {Seed: "circle", Hidden: "hidden", Keep: "kept"}[type(answer)]
    return f"{what} on {frames}" + (f", {answer.author}" if answer.author else "")


def lost_marker(place: str, marker: str, last: MarkerEstimate | None) -> str:
    """What to look at, and what to give, for a marker that is lost at the end and was measured `last` there."""
    told = f"{place}{marker} is LOST at the end"
    if last is None or last.circle is None:
        return f"{told}: it was never found after its seed; look whether the seed is on it"
    c, frame = last.circle, last.frame_index
    return (
        f"{told}, last seen on frame {frame} at {c.x_px:.0f},{c.y_px:.0f} with radius {c.r_px:.0f}: look where it "
        f"comes back after that, and run again with --seed {place}{marker}@FRAME=X,Y,R for that frame as well"
    )


_Request = tuple[str, int, int]


def _key(request: OperatorRequest) -> _Request:
    return request.marker, request.frame_index, request.raised_at_frame_index


def _answered(
    asked: Sequence[OperatorRequest],
    corrected: Corrected,
    answers: Sequence[Answer],
    lost_before: Callable[[int], bool],
) -> dict[_Request, str]:
    """What a person said to each request of a marker, "" where nobody did.

    An answer is to a request when it speaks of the frames that the request is about, or when its circle's stretch has
    them; and it is to the last one before it when the marker was LOST until then, as `lost_before` says of a frame.
    """
    found: dict[_Request, str] = {}
    for request in asked:
        about = request.frame_index, request.raised_at_frame_index
        there = [answer for answer in answers if answer.frame_index <= about[1] and _last(answer) >= about[0]]
        stretches = [stretch for index in about if (stretch := corrected.stretch_at(index)) is not None]
        there += [stretch.answer for stretch in stretches if request not in stretch.requests]
        found[_key(request)] = said(there[0]) if there else ""
    for answer in answers:
        before = [request for request in asked if request.raised_at_frame_index <= answer.frame_index]
        latest = max(before, key=lambda request: request.raised_at_frame_index, default=None)
        if latest is not None and not found[_key(latest)] and lost_before(answer.frame_index):
            found[_key(latest)] = said(answer)
    return found


def _last(answer: Answer) -> int:
    return answer.frame_index if isinstance(answer, Seed) else answer.to_frame_index


# --- the recording, written anew ---


class _Spans:
    """Spans of log time, both ends included."""

    def __init__(self, spans: Iterable[tuple[int, int]]) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        for start, end in sorted(spans):
            if self._ends and start <= self._ends[-1]:
                self._ends[-1] = max(self._ends[-1], end)
            else:
                self._starts.append(start)
                self._ends.append(end)

    def meet(self, start: int, end: int) -> bool:
        """Whether anything from `start` to `end` is in one."""
        k = bisect_right(self._starts, end) - 1
        return k >= 0 and self._ends[k] >= start


class _Rewriting:
    """What of one run's messages changes: those of the base come in, those with all answers go out."""

    def __init__(
        self, run: Run, records: McapRecords, answers: Sequence[Answer], corrected: Mapping[str, Corrected],
        footage: Footage | None, writer: ChunkWriter,
    ) -> None:  # fmt: skip
        self.run, self._corrected, self._footage, self._writer = run, corrected, footage, writer
        self._topics, self._states = run.topics, run.states
        self._base = {c.topic: c for c in reversed(records.channels.values()) if not is_answered(c.metadata)}
        self._roles = self._roles_in(records)
        self._font_px = font_px(run.camera if self._topics.calibration in self._base else None)
        self._spans, self._scene_spans = self._changed()
        self._scene, self._scene_number = Scene(run.specs, self._topics.optical_frame), -1
        self._told = self._answered(records, answers)
        self._log = self._log_lines()
        self.statuses = {name: Counter[Status]() for name in corrected}
        """By how much the numbers of frames change."""

    @property
    def open_requests(self) -> int:
        """How many requests nobody has answered."""
        return sum(not text for text in self._told.values())

    def changes(self, piece: Piece) -> bool:
        """Whether anything of this run in this piece of the file becomes another."""
        if piece.channels is not None:
            ours = [self._roles[id_] for id_ in piece.channels & self._roles.keys()]
            if not ours:
                return False
            if any(role == "late" for role, _ in ours) or (
                self._corrected and any(role == "asked" for role, _ in ours)
            ):
                return True
        return self._scene_spans.meet(piece.start, piece.end)

    def rewritten(self, raw: RawMessage) -> Iterator[OutMessage] | None:
        """What a message of this run becomes; None for one of another."""
        if raw.channel.id not in self._roles:
            return None
        role, marker = self._roles[raw.channel.id]
        if role == "late":
            if is_answered(raw.channel.metadata):
                return iter(())
            channel = self._base[raw.channel.topic.removeprefix(REPLACED)]
            raw = raw._replace(channel=channel, data=as_before(raw))
            role, marker = self._roles[channel.id]
        if role == "asked":
            return self._request(raw)
        number = self._number(raw)
        if role == "frame" and number is not None:
            return self._frame(raw, number)
        if role == "scene":
            return iter([self._replaced(raw) if self._scene_spans.meet(raw.log_time, raw.log_time) else _same(raw)])
        if number is None:
            return iter([_same(raw)])
        index = self._states.index(number)
        if role == "overview" and any(one.at(index) is not None for one in self._corrected.values()):
            return self._overview(raw, index)
        if role == "marker" and self._corrected[marker].at(index) is not None:
            return iter([self._replaced(raw)])
        return iter([_same(raw)])

    def estimates(self, number: int) -> dict[str, MarkerEstimate]:
        """The markers on a frame after all answers."""
        index = self._states.index(number)
        base, found = self._states.at(index), {}
        for spec in self.run.specs:
            name = spec.name
            stands = self._corrected[name].at(index) if name in self._corrected else None
            if isinstance(stands, Stretch):
                found[name] = stands.estimate(index)
            elif stands is None:
                if name in base:
                    found[name] = base[name]
            elif name in base or self._corrected[name].stretch_at(index) is not None:
                found[name] = hidden_estimate(stands, index, self._states.stamp_ns(number))
        return found

    # -- messages ---------------------------------------------------------------------------------------------------

    def _frame(self, raw: RawMessage, number: int) -> Iterator[OutMessage]:
        """A frame begins with its annotations; all that is new of it comes behind them."""
        topics, index, log_time, stamp = self._topics, self._states.index(number), raw.log_time, raw.publish_time
        standing = {name: one.at(index) for name, one in self._corrected.items()}
        standing = {name: stands for name, stands in standing.items() if stands is not None}
        if not standing:
            yield _same(raw)
            yield from self._scene_of(number, log_time, stamp)
            return
        after, base = self.estimates(number), self._states.at(index)
        yield self._replaced(raw)
        drawn = messages.annotations(stamp, after.values(), self._font_px)
        yield self._new(topics.annotations, log_time, stamp, drawn)
        results = {name: stands[index] for name, stands in standing.items() if isinstance(stands, Stretch)}
        for name in (name for name in standing if name in after):
            poses = results[name].smoothed if name in results else ()
            for topic, message in marker_messages(after[name], next(iter(poses), None), topics):
                yield self._new(topic, log_time, stamp, message)
            self.statuses[name][after[name].status] += 1
            if name in base:
                self.statuses[name][base[name].status] -= 1
        yield from self._scene_of(number, log_time, stamp)
        for result in results.values():
            for request in result.requests:
                answered = replace(request, answered=self._told.get(_key(request), ""))
                yield self._new(topics.requests, log_time, stamp, messages.request(answered))
            for topic, message in debug_messages(result, topics):
                yield self._new(topic, log_time, stamp, message)
        for text in self._log.get(index, ()):
            yield self._new(topics.log, log_time, stamp, messages.log(stamp, "INFO", text))

    def _scene_of(self, number: int, log_time: int, stamp_ns: int) -> Iterator[OutMessage]:
        """All markers in space, where a path of theirs has changed; what was a second before is followed too."""
        if not self._scene_spans.meet(log_time, log_time):
            return
        states = self._states
        if number != self._scene_number + 1 or self._scene_number < 0:
            self._scene = Scene(self.run.specs, self._topics.optical_frame)
            first = states.numbers_from(states.log_time(number) - TRAIL_NS)
            for before in range(first, number):
                self._scene.after(states.stamp_ns(before), self.estimates(before).values())
        self._scene_number = number
        scene = self._scene.after(stamp_ns, self.estimates(number).values())
        if scene is not None:
            yield self._new(self._topics.scene, log_time, stamp_ns, scene)

    def _request(self, raw: RawMessage) -> Iterator[OutMessage]:
        request = request_of(raw)
        answered = self._told.get(_key(request), "")
        if not answered:
            yield _same(raw)
            return
        yield self._replaced(raw)
        message = messages.request(replace(request, answered=answered))
        yield self._new(raw.channel.topic, raw.log_time, raw.publish_time, message)

    def _overview(self, raw: RawMessage, index: int) -> Iterator[OutMessage]:
        frame = None if self._footage is None else self._footage.at(index)
        number = self._states.number(index)
        yield self._replaced(raw)
        if frame is not None and number is not None:
            step = overlays.overview_step(frame.width_px)
            drawn = overlays.overview_picture(frame.reduced(step), step, self.estimates(number).values())
            message = messages.image(raw.publish_time, drawn, self._topics.optical_frame)
            yield self._new(raw.channel.topic, raw.log_time, raw.publish_time, message)

    def _new(self, topic: str, log_time: int, stamp_ns: int, message: Message) -> OutMessage:
        """A message that rests on an answer, on a channel of its own."""
        writer = self._writer
        channel = writer.register_channel(topic, "protobuf", schema_id(writer, type(message)), dict(ANSWERED))
        return OutMessage(log_time, stamp_ns, 0, channel, message.SerializeToString())

    def _replaced(self, raw: RawMessage) -> OutMessage:
        """A message that an answer has put others in the place of: it is kept beside them."""
        writer, message = self._writer, _pb.Replaced(data=raw.data)
        channel = writer.register_channel(REPLACED + raw.channel.topic, "protobuf", schema_id(writer, type(message)))
        return OutMessage(raw.log_time, raw.publish_time, raw.sequence, channel, message.SerializeToString())

    def _number(self, raw: RawMessage) -> int | None:
        """The number of the frame that a message is of; None for one that is of none."""
        there = [n for n in self._states.numbers_at(raw.log_time) if n < self._states.count]
        if len(there) > 1:  # times did not rise: the frame's own stamp tells them apart
            there = [n for n in there if self._states.stamp_ns(n) == raw.publish_time] or there
        return there[0] if there else None

    # -- what changes -----------------------------------------------------------------------------------------------

    def _roles_in(self, records: McapRecords) -> dict[int, tuple[str, str]]:
        """What each channel of this run is for, and for which marker; "late" is what answers have put there."""
        t = self._topics
        roles = {t.annotations: ("frame", ""), t.scene: ("scene", ""), t.requests: ("asked", ""),
                 t.overview: ("overview", "")}  # fmt: skip
        for spec in self.run.specs:
            role = ("marker" if spec.name in self._corrected else "other", spec.name)
            mine = (t.state, t.votes, t.pose, t.smoothed, t.debug)
            roles |= {topic(spec.name): role for topic in mine}
        found = {}
        for channel in records.channels.values():
            if channel.topic.startswith(f"{REPLACED}/"):
                if channel.topic.removeprefix(REPLACED) in {*roles, t.log}:
                    found[channel.id] = ("late", "")
            elif is_answered(channel.metadata) and channel.topic in {*roles, t.log}:
                found[channel.id] = ("late", "")
            elif channel.topic in roles:
                found[channel.id] = roles[channel.topic]
        return found

    def _changed(self) -> tuple[_Spans, _Spans]:
        """When frames change, and when the scene does, where paths are drawn for a while."""
        states, ranges = self._states, list[tuple[int, int]]()
        for one in self._corrected.values():
            spans = [(hidden.frame_index, hidden.to_frame_index) for hidden in one.hidden]
            spans += [(stretch.frames[0], stretch.frames[-1]) for stretch in one.stretches if len(stretch)]
            for first, last in spans:
                start, end = states.next_number(first), states.next_number(last + 1) - 1
                if start <= end:
                    ranges.append((states.log_time(start), states.log_time(end)))
        trail_ns = TRAIL_NS if self.run.metric else 0
        return _Spans(ranges), _Spans((start, end + trail_ns) for start, end in ranges)

    def _answered(self, records: McapRecords, answers: Sequence[Answer]) -> dict[_Request, str]:
        """What was said to each request of the run, "" to those that are open."""
        ids = set(channels_before(records, self._topics.requests))
        topics = {self._topics.requests, REPLACED + self._topics.requests}
        asked: dict[str, list[OperatorRequest]] = {spec.name: [] for spec in self.run.specs}
        for raw in records.messages(topics) if ids else ():
            if raw.channel.id in ids:
                request = request_of(raw._replace(data=as_before(raw)))
                asked.setdefault(request.marker, []).append(request)
        told: dict[_Request, str] = {}
        begun = base_seeds(answers)
        for name, requests in asked.items():
            one = self._corrected.get(name)
            if one is None:
                told |= {_key(request): "" for request in requests}
                continue
            own = [answer for answer in answers if answer.marker == name and answer not in begun]
            raised = [*requests, *(request for stretch in one.stretches for request in stretch.requests)]
            told |= _answered(raised, one, own, self._lost_before(name))
        return told

    def _lost_before(self, marker: str) -> Callable[[int], bool]:
        """Whether the marker was LOST on the frame before one, after all answers."""

        def lost(frame_index: int) -> bool:
            number = self._states.next_number(frame_index) - 1
            estimate = self.estimates(number).get(marker) if number >= 0 else None
            return estimate is not None and estimate.status is Status.LOST

        return lost

    def _log_lines(self) -> dict[int, list[str]]:
        """What the log says, by the frame on which it says so: the first of each stretch and of what is hidden."""
        lines: dict[int, list[str]] = {}
        for one in self._corrected.values():
            for hidden in one.hidden:
                first = max(hidden.frame_index, self._states.first_index)
                lines.setdefault(first, []).append(f"{one.marker}: {said(hidden)}")
            for stretch in one.stretches:
                if len(stretch):
                    lines.setdefault(stretch.frames[0], []).append(told_of(stretch))
        return lines


def _same(raw: RawMessage) -> OutMessage:
    return OutMessage(raw.log_time, raw.publish_time, raw.sequence, raw.channel.id, raw.data)


def told_of(stretch: Stretch) -> str:
    """A stretch in a line."""
    if not len(stretch):
        return f"{stretch.marker}: {said(stretch.answer)}: {stretch.before}"
    first, last = stretch.frames[0], stretch.frames[-1]
    ends = f"{stretch.before}; {stretch.after}"
    return f"{stretch.marker}: frames {first} to {last} by the {said(stretch.answer)} ({ends})"


# --- the jobs ---


@contextmanager
def opened(path: Path) -> Iterator[tuple[McapRecords, list[Run]]]:
    """A recording and its runs. Raises SourceError for one that is damaged or that we did not write."""
    with McapRecords(path) as records:
        if records.lost:
            raise SourceError(
                f"{path}: is damaged ({records.lost[0]}): make it whole first: spheremcap recover {path} -o OTHER.mcap"
            )
        yield records, runs_in(records)


def by_run(runs: Sequence[Run], answers: Sequence[Answer], path: Path) -> list[list[Answer]]:
    """Each run's own answers, merged with its first circles and checked. With several runs a marker's name begins with
    its camera's. Raises UsageError."""
    own: list[list[Answer]] = [[] for _ in runs]
    for answer in answers:
        camera, _, marker = answer.marker.rpartition("/") if len(runs) > 1 else ("", "", answer.marker)
        names = [run.name if len(runs) > 1 else "" for run in runs]
        if camera not in names:
            raise UsageError(f"{path}: seed of {answer.marker!r}: which camera? There are {', '.join(names)}")
        own[names.index(camera)].append(replace(answer, marker=marker))
    merged = [merged_answers(run, some) for run, some in zip(runs, own, strict=True)]
    for run, some in zip(runs, merged, strict=True):
        check(run, some, path)
    return merged


def answered_markers(answers: Sequence[Answer]) -> list[str]:
    """The markers of which more was said than where they begin."""
    begun = base_seeds(answers)
    return list(dict.fromkeys(answer.marker for answer in answers if answer not in begun))


def stretch_of(
    recording: Path, answer: Seed, *, others: Sequence[Answer], source: Path | None, view_keeper: ViewKeeper,
    go_on: Callable[[], bool],
) -> Stretch:  # fmt: skip
    """What one circle changes, given the recording's answers and `others`; nothing is written."""
    with opened(recording) as (records, runs), ExitStack() as files:
        given = dict.fromkeys([*(a for run in runs for a in _named(run, runs)), *others, answer])
        for run, answers in zip(runs, by_run(runs, list(given), recording), strict=True):
            marker = answer.marker.removeprefix(f"{run.name}/") if len(runs) > 1 else answer.marker
            only = replace(answer, marker=marker)
            if only not in answers:
                continue
            if only in base_seeds(answers):
                raise UsageError(f"{recording}: {said(answer)} is where {answer.marker} began: nothing changes")
            footage = Footage(run, records, source, True, files)
            corrected = correct(marker, answers, run.terms(view_keeper), run.states.at, footage.at, go_on, only)
            return next(stretch for stretch in corrected.stretches if stretch.answer == only)
    raise UsageError(f"{recording}: no camera has {answer.marker}")


def _named(run: Run, runs: Sequence[Run]) -> list[Answer]:
    """A run's answers by the names that they have in a seeds file."""
    return [replace(a, marker=f"{run.name}/{a.marker}") for a in run.answers] if len(runs) > 1 else run.answers


def retrack(
    recording: Path, output: Path, answers: Sequence[Answer], *, source: Path | None, checked: bool,
    view_keeper: ViewKeeper, inputs: Sequence[Path], overwrite: bool, progress: Callable[[int, int | None], None],
    stop: Callable[[], bool],
) -> RetrackReport:  # fmt: skip
    """As `api.retrack`; `checked` says that the source is known to be the input."""
    report = RetrackReport(output)

    def go_on() -> bool:
        report.stopped = report.stopped or stop()
        if not report.stopped:
            report.frames += 1
            progress(report.frames, None)
        return not report.stopped

    with opened(recording) as (records, runs), ExitStack() as files:
        done: list[tuple[Run, list[Answer], dict[str, Corrected], Footage | None]] = []
        for run, own in zip(runs, by_run(runs, answers, recording), strict=True):
            markers = answered_markers(own)
            begun = base_seeds(own)
            circles = any(isinstance(answer, Seed) and answer not in begun for answer in own)
            footage = Footage(run, records, source, checked, files) if circles else None
            terms = run.terms(view_keeper)
            found = {}
            for marker in markers:
                at = footage.at if footage is not None else lambda index: None
                found[marker] = correct(marker, own, terms, run.states.at, at, go_on)
            if report.stopped:
                return report
            done.append((run, own, found, footage))
            report.notes += [footage.note] if footage is not None and footage.note else []
            for one in found.values():
                report.stretches += [told_of(stretch) for stretch in one.stretches if len(stretch)]
                report.stretches += [f"{one.marker}: {said(hidden)}" for hidden in one.hidden]
                report.lost += [told_of(stretch) for stretch in one.stretches if not len(stretch)]
        given = [recording, *([source] if source is not None else []), *inputs]
        with records_output(
            output, lambda file: ChunkWriter(file, records.schemas, records.channels), given, overwrite, records.profile
        ) as writer:
            work = [_Rewriting(run, records, own, found, footage, writer) for run, own, found, footage in done]
            renamed = _write_facts(records, done, writer)
            for piece in records.pieces:
                report.stopped = report.stopped or stop()
                if report.stopped:
                    break
                progress(report.frames, None)
                _write_piece(records, piece, work, writer)
            for _, _, _, footage in done:
                if footage is not None:
                    footage.confirm()
            report.lost += _write_outcomes(records, done, work, renamed, report.stopped, writer)
            writer.complete = not report.stopped
            report.part = writer.part if report.stopped and writer.counts else None
            report.notes += writer.notes
        for one_run, rewriting in zip(runs, work, strict=True):
            place = f"{one_run.name}/" if one_run.name else ""
            report.statuses |= {place + name: counts for name, counts in rewriting.statuses.items()}
            report.requests += rewriting.open_requests
    return report


def _write_piece(records: McapRecords, piece: Piece, work: Sequence[_Rewriting], writer: ChunkWriter) -> None:
    """One chunk: as it is, where nothing in it changes."""
    stored = None if any(run.changes(piece) for run in work) else records.stored(piece)
    if stored is not None:
        writer.copy(piece, *stored)
        return
    out: list[OutMessage] = []
    for raw in records.messages_of(piece):
        changed = (made for run in work if (made := run.rewritten(raw)) is not None)
        found = next(changed, None)
        out += [_same(raw)] if found is None else found
    defined = records.defined_in(piece) if piece.compression is not None else ()
    writer.write(out, "zstd" if piece.compression is None else piece.compression, defined)


_Done = Sequence[tuple[Run, list[Answer], dict[str, Corrected], Footage | None]]


def _write_facts(records: McapRecords, done: _Done, writer: ChunkWriter) -> dict[str, str]:
    """Metadata and attachments, with the runs' new answers; the runs' new ids by their old ones."""
    renamed, seeds = {}, {}
    for run, own, found, _ in done:
        text = seeds_toml(own)
        seeds[run.id] = text
        renamed[run.id] = run_id(run.facts.get("version", ""), input_of(run.facts), run.settings_toml, text)
        lines = [told_of(stretch) for one in found.values() for stretch in one.stretches]
        lines += [f"{one.marker}: {said(hidden)}" for one in found.values() for hidden in one.hidden]
        facts = {key: told for key, told in run.own_facts.items() if key != ANSWERS}
        writer.add_metadata(RUN_METADATA + renamed[run.id], facts | ({ANSWERS: "; ".join(lines)} if lines else {}))
    for record in records.metadata:
        if record.name.removeprefix(RUN_METADATA) not in renamed and not record.name.startswith(OUTCOME_METADATA):
            writer.add_metadata(record.name, record.metadata)
    texts = [(a.name, a.data) for a in records.attachments() if a.name in (_SEEDS, _SETTINGS)]
    place = -1
    for attachment in records.attachments():
        if attachment.name in (_SEEDS, _SETTINGS):
            place += 1
            before = texts[place - 1] if place else ("", b"")
            for run, _, _, _ in done:
                whole = [before, (attachment.name, attachment.data)]
                if whole == [(_SETTINGS, run.settings_toml.encode()), (_SEEDS, run.seeds_toml.encode())]:
                    attachment = replace(attachment, data=seeds[run.id].encode())
        writer.add_attachment(attachment)
    return renamed


def _write_outcomes(
    records: McapRecords, done: _Done, work: Sequence[_Rewriting], renamed: Mapping[str, str], stopped: bool,
    writer: ChunkWriter,
) -> list[str]:  # fmt: skip
    """How each run ended, with its answers; and what is lost of them, a line each."""
    lost: list[str] = []
    for record in records.metadata:
        id_ = record.name.removeprefix(OUTCOME_METADATA)
        if id_ == record.name:
            continue
        facts = dict(record.metadata)
        for (run, _, found, _), rewriting in zip(done, work, strict=True):
            if run.id != id_:
                continue
            place, lines = (
                f"{run.name}/" if run.name else "",
                [line for line in facts.get("lost", "").split("; ") if line],
            )
            for one in found.values():
                lines = _lost_at_the_end(run, one, rewriting, place, lines)
            facts["lost"] = "; ".join(lines)
            lost += lines
        facts["complete"] = "no" if stopped else facts.get("complete", "yes")
        writer.add_metadata(OUTCOME_METADATA + renamed.get(id_, id_), facts)
    return lost


def _lost_at_the_end(run: Run, one: Corrected, rewriting: _Rewriting, place: str, lines: list[str]) -> list[str]:
    """The outcome's lines with what is so of this marker where an answer changed its last frame."""
    states = run.states
    if one.at(states.last_index) is None:
        return lines
    lines = [line for line in lines if not line.startswith(f"{place}{one.marker} is LOST at the end")]
    stretch = one.stretch_at(states.last_index)
    at_last = rewriting.estimates(states.count - 1).get(one.marker)
    if stretch is not None and at_last is not None and at_last.status is Status.LOST:
        found = (stretch.estimate(index) for index in reversed(stretch.frames))
        lines.append(lost_marker(place, one.marker, next((e for e in found if e.status.measured), None)))
    return lines
