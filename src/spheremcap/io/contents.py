"""What a recording has for a viewer to show: cameras with their markers, sensors, frames. Found from its own topics."""

import math
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from google.protobuf.message import DecodeError, Message

from spheremcap.core.time import NS_PER_S
from spheremcap.io import _pb
from spheremcap.io.chair import ChairPose, read_chairs
from spheremcap.io.decode import decoder
from spheremcap.io.mcap_images import calibration_topics, image_topics
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import UNREADABLE, numbers_of, runs_of, schema_names, senses
from spheremcap.io.strokes import EVENT, STROKE
from spheremcap.io.topics import MARKERS, REPLACED, WORLD_FRAME, Topics, TopicsBeside, topics_of

FloatArray = npt.NDArray[np.float64]
_ANNOTATIONS = ImageAnnotations.DESCRIPTOR.full_name
_TRANSFORMS = FrameTransforms.DESCRIPTOR.full_name
_ARM = _pb.ArmSample.DESCRIPTOR.full_name
_SAMPLES = 60
"""So many frames of a marker tell where it is, and so many of an arm what is known of it."""


@dataclass(frozen=True)
class CameraContents:
    """A camera whose pictures were tracked. `picture` and `calibration` are topics, "" where there is none.

    `name` is "" for the only one. `world` is the coordinate frame that all others hang on; `xyz_cam_m` (N, 3) are
    positions of its markers here and there in the recording, none without a calibrated camera. `chair` is the chair's
    frame, "" where none hangs on the camera's.
    """

    name: str
    topics: Topics
    picture: str
    calibration: str
    markers: tuple[str, ...]
    world: str
    xyz_cam_m: FloatArray
    chair: str = ""


@dataclass(frozen=True)
class SensorContents:
    """A sensor's topic and the paths of the numbers in its messages, such as `linear_acceleration.x`."""

    topic: str
    numbers: tuple[str, ...]


@dataclass(frozen=True)
class HandContents:
    """What an analysis found of one hand: topics, "" where there is none. `arm` has the numbers that some sample of the
    arm has."""

    name: str
    events: str
    strokes: str
    arm: SensorContents


@dataclass(frozen=True)
class Contents:
    """What there is to show. `topics` are all that have messages; `rate_hz` is how many pictures a second, or 0.
    `hands` are those of a recording that was analysed."""

    cameras: tuple[CameraContents, ...]
    sensors: tuple[SensorContents, ...]
    residuals: tuple[SensorContents, ...]
    topics: frozenset[str]
    rate_hz: float
    hands: tuple[HandContents, ...] = ()


def contents(path: str | os.PathLike[str]) -> Contents:
    """Look what a recording has, without reading it all. Raises SourceError for what is none."""
    with McapRecords(path) as records:
        names = schema_names(records)
        known = {c.topic for c in records.channels.values() if records.counts.get(c.id, 0) and not _replaced(c.topic)}
        channels = [c for c in records.channels.values() if c.topic in known]
        sensing = dict.fromkeys(c.topic for c in channels if senses(c, names[c.id]))
        sync = dict.fromkeys(c.topic for c in channels if c.topic.startswith("/sync/"))
        drawn = {c.topic for c in channels if names[c.id] == _ANNOTATIONS}
        kinds = {c.topic: names[c.id] for c in channels}
        cameras = tuple(_cameras(records, drawn, known, _parents(records), read_chairs(records)))
        rates = [_rate_hz(records, camera.topics.annotations) for camera in cameras]
        return Contents(
            cameras,
            tuple(SensorContents(topic, _numbers(records, topic)) for topic in sensing),
            tuple(SensorContents(topic, _numbers(records, topic)) for topic in sync),
            frozenset(known),
            max(rates, default=0.0),
            tuple(_hands(records, kinds)),
        )


def to_come(topics: Topics, markers: tuple[str, ...], xyz_cam_m: FloatArray, rate_hz: float) -> Contents:
    """What a recording of one camera's JPEG pictures will have. `xyz_cam_m` (N, 3) are places where markers are, none
    without a calibrated camera."""
    calibration = topics.calibration if len(xyz_cam_m) else ""
    camera = CameraContents("", topics, topics.image, calibration, markers, WORLD_FRAME, xyz_cam_m)
    known = {topics.image, topics.annotations, topics.log, topics.requests}
    for marker in markers:
        known |= {topics.state(marker), topics.votes(marker), topics.debug(marker)}
    return Contents((camera,), (), (), frozenset(known), rate_hz)


def _replaced(topic: str) -> bool:
    return topic.startswith(f"{REPLACED}/")


def _cameras(
    records: McapRecords, drawn: Collection[str], known: Collection[str], parents: dict[str, str],
    chairs: Collection[ChairPose],
) -> Iterator[CameraContents]:  # fmt: skip
    """A camera for each topic of annotations of ours; a merge may have put something before all its names."""
    said = [(topics, facts) for facts in runs_of(records).values() if (topics := topics_of(facts)) is not None]
    pictures = [found.topic for found in image_topics(records) if found.topic in known]
    calibrations = [topic for topic in calibration_topics(records) if topic in known]
    found: list[tuple[str, Topics, tuple[str, ...]]] = []
    for annotations in sorted(drawn):
        for own, facts in [*said, (Topics(), {})]:
            before = annotations.removesuffix(own.annotations)
            topics = TopicsBeside(before + own.camera, before + own.root, before + own.transforms)
            markers = _markers(topics, known, facts)
            if annotations.endswith(own.annotations) and markers:
                found.append((annotations.rpartition("/")[0], topics, markers))
                break
    for place, topics, markers in found:
        beside = [topic for topic in pictures if topic.rpartition("/")[0] == place and not topic.endswith("/debug")]
        beside.sort(key=lambda topic: topic not in (topics.video, topics.image))
        calibration = next((topic for topic in calibrations if topic.rpartition("/")[0] == place), "")
        xyz_cam_m, frame_id = _positions(records, [topics.state(marker) for marker in markers])
        yield CameraContents(
            place.strip("/") if len(found) > 1 else "", topics, next(iter(beside), ""), calibration, markers,
            _root(frame_id, parents), xyz_cam_m,
            next((chair.frame_id for chair in chairs if chair.parent_frame_id == frame_id), ""),
        )  # fmt: skip


def _markers(topics: Topics, known: Collection[str], facts: Mapping[str, str]) -> tuple[str, ...]:
    """The markers under a camera's root, in the order of their colours: that in which their run lists them."""
    before, after = f"{topics.root}/{MARKERS}/", "/state"
    inside = [t.removeprefix(before).removesuffix(after) for t in known if t.startswith(before) and t.endswith(after)]
    listed = [fact.split(".")[1] for fact in facts if fact.startswith("marker.")]
    order = {name: number for number, name in enumerate(listed)}
    names = (name for name in inside if "/" not in name)
    return tuple(sorted(names, key=lambda name: (order.get(name, len(order)), name)))


def _positions(records: McapRecords, topics: Iterable[str]) -> tuple[FloatArray, str]:
    """(N, 3) metres in the camera's frame, of some frames of each; and that frame's name."""
    places: list[tuple[float, float, float]] = []
    frame_id = ""
    for topic in topics:
        index = records.index_of(topic)
        for number in np.unique(np.linspace(0, len(index) - 1, _SAMPLES).astype(int)).tolist():
            try:
                state = _pb.MarkerState.FromString(index.message(number).data)
            except (DecodeError, IndexError):
                continue
            frame_id = frame_id or state.frame_id
            if state.HasField("position"):
                places.append((state.position.x, state.position.y, state.position.z))
    xyz = np.array(places).reshape(-1, 3)
    return xyz[np.isfinite(xyz).all(axis=1)], frame_id


def _hands(records: McapRecords, kinds: Mapping[str, str]) -> Iterator[HandContents]:
    """The hands of an analysis by what their topics have; a merge may have put something before all names."""
    found = {topic: kind for topic, kind in sorted(kinds.items()) if kind in (EVENT, STROKE, _ARM)}
    for place in dict.fromkeys(topic.rpartition("/")[0] for topic in found):
        own = {kind: topic for topic, kind in found.items() if topic.rpartition("/")[0] == place}
        arm = own.get(_ARM, "")
        numbers = _numbers_of_some(records, arm) if arm else ()
        name = place.strip("/").replace("analysis/", "")
        yield HandContents(name, own.get(EVENT, ""), own.get(STROKE, ""), SensorContents(arm, numbers))


def _numbers_of_some(records: McapRecords, topic: str) -> tuple[str, ...]:
    """The names of all numbers that some of an arm's samples have."""
    index = records.index_of(topic)
    found: dict[str, None] = {}
    for number in np.unique(np.linspace(0, len(index) - 1, _SAMPLES).astype(int)).tolist():
        try:
            numbers = numbers_of(_pb.ArmSample.FromString(index.message(number).data))
        except (DecodeError, IndexError):
            continue
        found |= dict.fromkeys(name for name, value in numbers.items() if not math.isnan(value))
    return tuple(found)


def _parents(records: McapRecords) -> dict[str, str]:
    """In which frame each stands, by the first message of each topic that says so."""
    names = schema_names(records)
    parents: dict[str, str] = {}
    for topic in sorted({c.topic for c in records.channels.values() if names[c.id] == _TRANSFORMS}):
        first = next(iter(records.messages([topic])), None)
        if first is not None:
            try:
                edges = FrameTransforms.FromString(first.data).transforms
            except DecodeError:
                continue
            parents |= {edge.child_frame_id: edge.parent_frame_id for edge in edges}
    return parents


def _root(frame_id: str, parents: dict[str, str]) -> str:
    """The frame that all hang on, seen from one of them."""
    for _ in range(len(parents)):
        frame_id = parents.get(frame_id, frame_id)
    return frame_id or WORLD_FRAME


def _rate_hz(records: McapRecords, topic: str) -> float:
    """Messages a second, 0 when there are no two."""
    index = records.index_of(topic)
    span_ns = index.log_time(len(index) - 1) - index.log_time(0) if len(index) > 1 else 0
    return (len(index) - 1) * NS_PER_S / span_ns if span_ns > 0 else 0.0


def _numbers(records: McapRecords, topic: str) -> tuple[str, ...]:
    """The paths of all numbers that a topic's first message has."""
    first = next(iter(records.messages([topic])), None)
    if first is None:
        return ()
    try:
        decode = decoder(first.channel, records.schemas.get(first.channel.schema_id))
        message = None if decode is None else decode(first.data)
    except UNREADABLE:
        return ()
    found = numbers_of(message) if isinstance(message, Message) else {}
    return tuple(name for name, value in found.items() if not math.isnan(value))
