"""Recordings with known positions, events and sensors, for the tests of what is exported."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from recording_data import CAMERA

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, SmoothedPose, Status
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.stroke import EventKind, Stroke, StrokeEvent
from spheremcap.io import _pb
from spheremcap.io.mcap_log import McapLog, schema_id
from spheremcap.io.messages import time_fields
from spheremcap.io.strokes import event_message, stroke_message

START_NS = 1_700_000_000_123_456_789
NAMES = ("left_wrist", "right_wrist")
COVARIANCE_M2 = np.diag([4e-6, 4e-6, 64e-6])
"""Its trace's root is 8.485 mm."""


def stamp(index: float) -> int:
    """Of a frame at 240000/1001 Hz, rounded as a container's would be."""
    return START_NS + round(index * 1001 * 1_000_000_000 / 240_000)


def xyz_m(marker: str, index: int) -> np.ndarray:
    """Where a marker is on a frame: x grows with time, y and z tell markers apart."""
    side = NAMES.index(marker)
    return np.array([0.001 * index - 0.4, 0.1 + side, 3.25 + 0.01 * np.sin(index)])


def write_session(
    path: Path,
    frames: Sequence[int],
    gaps: Mapping[str, Mapping[int, Status]] | None = None,
    *,
    stamps: Mapping[int, int] | None = None,
    strokes: Sequence[Stroke | StrokeEvent] = (),
    imus: Mapping[str, Sequence[int]] | None = None,
    camera: bool = True,
    names: Collection[str] = NAMES,
    analysed: Sequence[tuple[str, int, object]] = (),
) -> Path:
    """A recording of `frames` (numbers on the even grid); markers are VERIFIED where `gaps` says nothing else.

    `imus` are stamps of samples whose x acceleration counts them and whose temperature is never set. `analysed` are
    topics, stamps and messages that an analysis put beside.
    """
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        with McapLog(writer, camera=CAMERA if camera else None, markers=[MarkerSpec(n) for n in names]) as log:
            for index in frames:
                at_ns = (stamps or {}).get(index, stamp(index))
                states = {n: (gaps or {}).get(n, {}).get(index, Status.VERIFIED) for n in names}
                estimates = tuple(_estimate(n, index, at_ns, status, camera) for n, status in states.items())
                smoothed = tuple(
                    SmoothedPose(e.marker, index, at_ns, e.xyz_cam_m + 0.001, COVARIANCE_M2, np.zeros(3))
                    for e in estimates
                    if e.xyz_cam_m is not None
                )
                log.write(FrameResult(index, at_ns, estimates, smoothed), None)
        for noun in strokes:
            event = isinstance(noun, StrokeEvent)
            message = event_message(noun) if event else stroke_message(noun)
            topic = f"/analysis/{noun.side}/{'events' if event else 'strokes'}"
            channel = writer.register_channel(topic, "protobuf", schema_id(writer, type(message)))
            writer.add_message(channel, noun.stamp_ns, message.SerializeToString(), noun.stamp_ns)
        for topic, at_ns, message in analysed:
            channel = writer.register_channel(topic, "protobuf", schema_id(writer, type(message)))
            writer.add_message(channel, at_ns, message.SerializeToString(), at_ns)
        for name, times in (imus or {}).items():
            channel = writer.register_channel(f"/sensors/{name}", "protobuf", schema_id(writer, _pb.ImuSample))
            for k, t in enumerate(times):
                sample = _pb.ImuSample(timestamp=time_fields(t), linear_acceleration={"x": k, "y": -0.5, "z": 9.8125})
                writer.add_message(channel, t, sample.SerializeToString(), t)
        writer.finish()
    return path


def event(kind: EventKind, at_ns: int, side: str = "left") -> StrokeEvent:
    return StrokeEvent(at_ns, side, f"{side}_wrist", kind, 0, 1.5, 30.0, None, 4.5, 0.25, "radius")


def _estimate(marker: str, index: int, at_ns: int, status: Status, camera: bool) -> MarkerEstimate:
    if status in (Status.LOST, Status.OUT_OF_VIEW):
        return MarkerEstimate(marker, index, at_ns, status)
    metric = {"xyz_cam_m": xyz_m(marker, index), "covariance_m2": COVARIANCE_M2} if camera else {}
    return MarkerEstimate(marker, index, at_ns, status, Circle(80, 60, 9), **metric)
