"""Write what the session says of each frame into an MCAP: a new file, or a writer that somebody has open.

Every message's log time, publish time and own stamp are the picture's; log times never go back; nothing in
the file comes from a clock, so the same input and settings give the same bytes.
"""

import hashlib
import heapq
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self
from weakref import WeakKeyDictionary

from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap_protobuf.schema import build_file_descriptor_set

from spheremcap.core.camera import Camera
from spheremcap.core.estimate import FrameResult, MarkerEstimate, SmoothedPose
from spheremcap.core.frame import BgrImage, EncodedPicture
from spheremcap.core.marker import MarkerSpec
from spheremcap.errors import OutputError, UsageError
from spheremcap.io import messages, overlays
from spheremcap.io.annotations import Annotations
from spheremcap.io.calibration import channel_metadata
from spheremcap.io.course import COURSE_METADATA, Course, course_lines
from spheremcap.io.messages import LEVELS, Fields, LogLevel, Message
from spheremcap.io.output import VERSION, Compression, SharedWriter, open_output
from spheremcap.io.topics import Topics

RUN_METADATA = "spheremcap/run/"
OUTCOME_METADATA = "spheremcap/outcome/"

STATIC_PERIOD_NS = 2_000_000_000
"""Calibration and frames are repeated this often, so that a piece cut out of the file still has them."""
SCENE_PERIOD_NS = 15_000_000
"""At most one scene a period: viewers draw 60 a second, and trails at 240 would outweigh the video."""
TRAIL_NS = 1_000_000_000
SEQUENCES_A_FRAME = 16
"""A message's sequence number is its frame's number times this, and a count from 1: numbers rise within a topic, also
where a person's answers put messages between those that are there (they count from half of it on)."""


class SchemaSink(Protocol):
    """Whatever stores schemas."""

    def register_schema(self, name: str, encoding: str, data: bytes) -> int: ...


class Sink(SchemaSink, Protocol):
    """The part of mcap.writer.Writer that a log needs."""

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] = ...
    ) -> int: ...

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int) -> None: ...

    def add_metadata(self, name: str, data: dict[str, str]) -> None: ...

    def add_attachment(self, create_time: int, log_time: int, name: str, media_type: str, data: bytes) -> None: ...


_SCHEMA_DATA: dict[str, bytes] = {}
_SCHEMA_IDS: WeakKeyDictionary[Any, dict[str, int]] = WeakKeyDictionary()


def schema_id(sink: SchemaSink, message_class: Message) -> int:
    """The id of a protobuf class's schema in `sink`, registered on first use: one per type and writer."""
    name: str = message_class.DESCRIPTOR.full_name
    ids = _SCHEMA_IDS.setdefault(sink, {})
    if name not in ids:
        if name not in _SCHEMA_DATA:
            _SCHEMA_DATA[name] = build_file_descriptor_set(message_class).SerializeToString(deterministic=True)
        ids[name] = sink.register_schema(name, "protobuf", _SCHEMA_DATA[name])
    return ids[name]


def run_id(version: str, input_sha256: str, settings_toml: str, seeds_toml: str, name: str = "") -> str:
    """Twelve hex digits that stand for all that decides what is in a recording. Without a hash the input's name counts;
    `name` is the camera's where there are several."""
    parts = (version, input_sha256, settings_toml, seeds_toml, *([name] if name else []))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:12]


@dataclass(frozen=True)
class RunInfo:
    """What explains a recording besides its messages; written as metadata and attachments.

    `input_name` is a file name without folders; `time_source` says where the first stamp comes from (given,
    the container's creation time, 0); `video` how the pictures came in (passed through, encoded and why).
    `more` takes further lines.
    """

    input_name: str = ""
    input_size: int | None = None
    input_sha256: str = ""
    time_source: str = ""
    video: str = ""
    settings_toml: str = ""
    seeds_toml: str = ""
    more: Mapping[str, str] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """Twelve hex digits that stand for input, settings, seeds, version and camera together."""
        name = self.more.get("name", "")
        return run_id(VERSION, self.input_sha256 or self.input_name, self.settings_toml, self.seeds_toml, name)

    def lines(self) -> dict[str, str]:
        """The metadata record's own lines; what is not known is left out."""
        known = {
            "version": VERSION,
            "input_name": self.input_name,
            "input_size": "" if self.input_size is None else str(self.input_size),
            "input_sha256": self.input_sha256,
            "time_source": self.time_source,
            "video": self.video,
        }
        return {key: text for key, text in known.items() if text} | dict(self.more)


class McapLog:
    """Turns each `FrameResult` and its picture into messages, in log-time order, in memory that stays flat.

    `target` is a path, owned as `open_output` does it until `close`; or a writer that the caller has open and finishes
    himself, to which only schemas, channels, messages and (when `run` is given) metadata and attachments are added.
    `picture_px` is (width, height) of the pictures where there is no `camera` to say it.
    Use it as a context manager: an exception leaves a readable OUT.part and nothing under the final name.

    Raises what `open_output` raises.
    """

    def __init__(
        self,
        target: str | Path | Sink,
        *,
        camera: Camera | None,
        markers: Sequence[MarkerSpec],
        picture_px: tuple[int, int] | None = None,
        run: RunInfo | None = None,
        topics: Topics | None = None,
        overwrite: bool = False,
        compression: Compression = "zstd",
    ) -> None:
        self.camera = camera
        self.markers = {marker.name: (index, marker) for index, marker in enumerate(markers)}
        self.topics = topics or Topics()
        self.run = run
        self._file = ExitStack()
        self._owned: SharedWriter | None = None
        if isinstance(target, str | Path):
            self.run = run or RunInfo()
            self._owned = self._file.enter_context(open_output(target, overwrite=overwrite, compression=compression))
            self._sink: Sink = self._owned
        else:
            self._sink = target
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}
        self._frame_index = 0
        self._last_ns: int | None = None
        self._next_static_ns: int | None = None
        self._scene = Scene(markers, self.topics.optical_frame)
        self._pending_log: list[tuple[int, int, int, LogLevel, str]] = []
        self._log_count = 0
        self._courses = {marker.name: Course() for marker in markers}
        self._closed = False
        size_px = picture_px if camera is None else (camera.width_px, camera.height_px)
        self._annotations = Annotations({name: number for name, (number, _) in self.markers.items()}, size_px)

    def write(
        self,
        result: FrameResult,
        picture: EncodedPicture | None,
        overview: BgrImage | None = None,
        overview_step: int = 1,
    ) -> None:
        """Add a frame: its picture as given, and everything the session says of it.

        `overview` (rows, columns, 3) is the frame's `reduced(overview_step)`; it is written with the
        circles burnt in. Frames come in order of their stamps; one that goes back keeps its own stamp and
        publish time, and its log time is the one before.
        """
        stamp, topics, optical = result.stamp_ns, self.topics, self.topics.optical_frame
        self._frame_index = result.frame_index
        self._write_log_until(stamp)
        self._begin(stamp)
        self._write_static(stamp)
        if picture is not None:
            if picture.format in ("h264", "h265"):
                self._add(topics.video, stamp, messages.video(stamp, picture, optical))
            else:
                self._add(topics.image, stamp, messages.image(stamp, picture, optical))
        for request in result.requests:
            self._add(topics.requests, stamp, messages.request(request))
        self._add(topics.annotations, stamp, self._annotations.of(stamp, result.estimates))
        smoothed = {pose.marker: pose for pose in result.smoothed}
        for estimate in result.estimates:
            for topic, message in marker_messages(estimate, smoothed.get(estimate.marker), topics):
                self._add(topic, stamp, message)
            course = self._courses.setdefault(estimate.marker, Course())
            course.add(estimate.frame_index, estimate.status.value)
        scene = self._scene.after(stamp, result.estimates)
        if scene is not None:
            self._add(topics.scene, stamp, scene)
        for topic, message in debug_messages(result, topics):
            self._add(topic, stamp, message)
        if overview is not None:
            drawn = overlays.overview_picture(overview, overview_step, result.estimates)
            self._add(topics.overview, stamp, messages.image(stamp, drawn, topics.debug_frame))

    def log(self, level: LogLevel, text: str, stamp_ns: int) -> None:
        """Add a line for the user; it waits until the frames have come as far as `stamp_ns`.

        Of several at one stamp the gravest is written last, for that is the one that viewers show after a seek.
        """
        self._log_count += 1
        heapq.heappush(self._pending_log, (stamp_ns, LEVELS.index(level), self._log_count, level, text))

    def close(self, outcome: Mapping[str, str] | None = None, *, complete: bool = True) -> None:
        """Finish the recording; `outcome` is kept as metadata (frames read, frames that did not decode, ...).

        With `complete`, OUT.part becomes OUT; without, it stays OUT.part, finished and readable. A writer
        that somebody else has open is left open.
        """
        if self._closed:
            return
        self._closed = True
        with self._file:
            self._finish(outcome or {}, complete)
            if self._owned is not None:
                self._owned.complete = complete

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
            return
        try:
            if not self._closed and not isinstance(error, OutputError):
                self._closed = True
                self._finish({}, complete=False)
        finally:
            self._file.__exit__(kind, error, trace)

    def _begin(self, stamp_ns: int) -> None:
        """Metadata and attachments before the first message, stamped like it."""
        if self._last_ns is not None:
            return
        self._last_ns = stamp_ns
        if self.run is None:
            return
        facts = self.run.lines()
        if self.camera is not None:
            facts["camera_source"] = self.camera.source
            facts["camera_focal_sd"] = repr(self.camera.focal_sd)
        for name, (_, marker) in self.markers.items():
            facts[f"marker.{name}.diameter_m"] = repr(marker.diameter_m)
        self._sink.add_metadata(RUN_METADATA + self.run.id, facts)
        for file, text in (("settings.toml", self.run.settings_toml), ("seeds.toml", self.run.seeds_toml)):
            if text:
                self._sink.add_attachment(stamp_ns, stamp_ns, file, "application/toml", text.encode())

    def _finish(self, outcome: Mapping[str, str], complete: bool) -> None:
        self._write_log_until(None)
        self._begin(self._last_ns or 0)
        if self.run is not None:
            self._sink.add_metadata(COURSE_METADATA + self.run.id, course_lines(self._courses))
            facts = dict(outcome) | {"complete": "yes" if complete else "no"}
            self._sink.add_metadata(OUTCOME_METADATA + self.run.id, facts)

    def _write_log_until(self, stamp_ns: int | None) -> None:
        while self._pending_log and (stamp_ns is None or self._pending_log[0][0] <= stamp_ns):
            stamp, _, _, level, text = heapq.heappop(self._pending_log)
            stamp = max(stamp, self._last_ns or 0)
            self._begin(stamp)
            self._add(self.topics.log, stamp, messages.log(stamp, level, text))

    def _write_static(self, stamp_ns: int) -> None:
        """Calibration and frames, when it is time for them."""
        if self._next_static_ns is not None and stamp_ns < self._next_static_ns:
            return
        self._next_static_ns = stamp_ns + STATIC_PERIOD_NS
        topics = self.topics
        if self.camera is not None:
            message = messages.calibration(stamp_ns, self.camera, topics.optical_frame)
            self._add(topics.calibration, stamp_ns, message, channel_metadata(self.camera))
        self._add(topics.transforms, stamp_ns, messages.transforms(stamp_ns, topics.edges()))

    def _add(self, topic: str, stamp_ns: int, message: Message, metadata: dict[str, str] | None = None) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            schema = schema_id(self._sink, type(message))
            channel = self._channels[topic] = self._sink.register_channel(topic, "protobuf", schema, metadata or {})
        if stamp_ns < 0:
            raise UsageError(f"stamp {stamp_ns} ns is before 1970, which MCAP cannot hold: give a --start-time")
        sequence = max(self._sequences.get(topic, 0), SEQUENCES_A_FRAME * self._frame_index) + 1
        self._sequences[topic] = sequence
        self._last_ns = log_time = max(stamp_ns, self._last_ns or 0)
        self._sink.add_message(channel, log_time, message.SerializeToString(), stamp_ns, sequence)


def marker_messages(
    estimate: MarkerEstimate, pose: SmoothedPose | None, topics: Topics
) -> Iterator[tuple[str, Message]]:
    """What is written of one marker on one frame, by topic: state, votes, and poses where there are any."""
    name, stamp, optical = estimate.marker, estimate.stamp_ns, topics.optical_frame
    yield topics.state(name), messages.state(estimate, pose, optical)
    if estimate.votes:
        yield topics.votes(name), messages.votes(estimate)
    if estimate.xyz_cam_m is not None and estimate.status.measured:
        yield topics.pose(name), messages.pose(stamp, estimate.xyz_cam_m, optical)
    if pose is not None:
        yield topics.smoothed(name), messages.pose(stamp, pose.xyz_cam_m, optical)


def debug_messages(result: FrameResult, topics: Topics) -> Iterator[tuple[str, Message]]:
    """The stages' pictures of a frame, by topic."""
    by_marker = {estimate.marker: estimate for estimate in result.estimates}
    for view in result.views:
        drawn = overlays.stage_picture(view, by_marker.get(view.marker))
        yield topics.debug(view.marker), messages.image(result.stamp_ns, drawn, topics.debug_frame)


class Scene:
    """All markers in space with their paths of the last second, frame after frame; not more often than viewers draw."""

    def __init__(self, markers: Sequence[MarkerSpec], frame_id: str) -> None:
        self._markers = {marker.name: (index, marker) for index, marker in enumerate(markers)}
        self._trails: dict[str, _Trail] = {marker.name: _Trail() for marker in markers}
        self._frame_id = frame_id
        self._next_ns: int | None = None

    def after(self, stamp_ns: int, estimates: Iterable[MarkerEstimate]) -> Message | None:
        """foxglove.SceneUpdate of one more frame; None where it is too early for one, or no marker has a place."""
        due = self._next_ns is None or stamp_ns >= self._next_ns
        entities = []
        for estimate in estimates:
            index, marker = self._markers.get(estimate.marker) or (0, MarkerSpec(estimate.marker))
            trail = self._trails.setdefault(estimate.marker, _Trail())
            trail.follow(estimate, due)
            if due:
                entity = messages.scene_entity(estimate, marker, index, trail.stretches(), self._frame_id)
                if entity is not None:
                    entities.append(entity)
        if due:
            self._next_ns = stamp_ns + SCENE_PERIOD_NS
        return SceneUpdate(entities=entities) if entities else None


class _Trail:
    """A marker's measured positions of the last second, broken wherever it was not measured in between."""

    def __init__(self) -> None:
        self._stretches: deque[tuple[deque[int], deque[Fields]]] = deque()

    def follow(self, estimate: MarkerEstimate, keep: bool) -> None:
        """Take note of a frame; its position is kept only when `keep`, a break always."""
        stretches = self._stretches
        if estimate.xyz_cam_m is None or not estimate.status.measured:
            if stretches and stretches[-1][0]:
                stretches.append((deque(), deque()))
        elif keep:
            if not stretches:
                stretches.append((deque(), deque()))
            stamps, points = stretches[-1]
            stamps.append(estimate.stamp_ns)
            points.append(messages.point(estimate.xyz_cam_m))
        while stretches:
            stamps, points = stretches[0]
            while stamps and stamps[0] < estimate.stamp_ns - TRAIL_NS:
                stamps.popleft()
                points.popleft()
            if stamps:
                break
            stretches.popleft()

    def stretches(self) -> list[deque[Fields]]:
        """The positions as the scene takes them, one list for each unbroken stretch."""
        return [points for _, points in self._stretches]
