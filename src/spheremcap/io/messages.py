"""From the nouns to protobuf messages: pure functions, no state, nothing invented for what is None.

Stamps are int nanoseconds. The nouns' pixel coordinates count from the centre of the top-left pixel. Poses are in the
optical frame and have the unit quaternion, w being 1, for a sphere has no orientation.

What goes inside a message is given as a dict of its fields: protobuf makes the inner message in place from it, where
a ready message would be copied, at twice the time. With six markers that is 120 inner messages a frame.
"""

# mypy: disable-error-code="arg-type, list-item"
# The schemas' stubs do not know that a dict will do.

from collections.abc import Collection, Iterable
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from google.protobuf.timestamp_pb2 import Timestamp

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, OperatorRequest, SmoothedPose, Status
from spheremcap.core.frame import EncodedPicture, Window
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.time import NS_PER_S
from spheremcap.io import _pb
from spheremcap.io.calibration import fields_of

FloatArray = npt.NDArray[np.float64]
Rgb = tuple[float, float, float]
LogLevel = Literal["DEBUG", "INFO", "WARNING", "ERROR", "FATAL"]
LEVELS: tuple[LogLevel, ...] = get_args(LogLevel)
"""By gravity."""
Message = Any
"""A protobuf message; its classes are made at run time and have no static type."""
Fields = dict[str, Any]
"""What an inner message holds, by field name; inner messages of it are such dicts again."""

AGREES = 2 / 3
"""Overlap from which one matcher counts as agreeing: its share of TH1 = 4 of 6. Only for `any_agrees`."""
LIFETIME_NS = 100_000_000
"""How long a viewer draws a sphere after its last message, so that a lost marker vanishes."""

STATUS_RGB: dict[Status, Rgb] = {
    Status.SEEDED: (0.306, 0.596, 0.886),  # blue
    Status.VERIFIED: (0.361, 0.839, 0.663),  # green
    Status.ESTIMATED: (0.969, 0.875, 0.443),  # yellow
    Status.LOST: (0.961, 0.467, 0.302),  # orange
    Status.OUT_OF_VIEW: (0.639, 0.584, 0.886),  # purple
}
"""Those that the viewers' State Transitions panel gives the numbers of `MarkerState.Status`."""
MARKER_RGB: tuple[Rgb, ...] = (
    (0.90, 0.30, 0.25),
    (0.20, 0.60, 0.95),
    (0.95, 0.80, 0.20),
    (0.35, 0.80, 0.40),
    (0.75, 0.45, 0.90),
    (0.95, 0.55, 0.15),
    (0.30, 0.80, 0.80),
    (0.85, 0.85, 0.85),
)


def marker_rgb(number: int) -> Rgb:
    """The colour of a camera's marker of this number, from 0: of its circle, its sphere and its curves."""
    return MARKER_RGB[number % len(MARKER_RGB)]


def color(rgb: Rgb, alpha: float) -> Fields:
    """The fields of a foxglove.Color."""
    r, g, b = rgb
    return {"r": r, "g": g, "b": b, "a": alpha}


UPRIGHT: Fields = {"w": 1.0}
"""The rotation that turns nothing."""
_ORIGIN: Fields = {"position": {}, "orientation": UPRIGHT}
OPTICAL_IN_CAMERA: Fields = {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5}
"""The optical frame (x right, y down, z forward) in the camera's own (x forward, y left, z up)."""
_LIFETIME: Fields = {"seconds": LIFETIME_NS // NS_PER_S, "nanos": LIFETIME_NS % NS_PER_S}


def timestamp(stamp_ns: int) -> Message:
    """google.protobuf.Timestamp of int nanoseconds, exactly."""
    return Timestamp(**time_fields(stamp_ns))


def time_fields(stamp_ns: int) -> Fields:
    """The fields of a google.protobuf.Timestamp."""
    seconds, nanos = divmod(stamp_ns, NS_PER_S)
    return {"seconds": seconds, "nanos": nanos}


def stamp_of(message: Message) -> int:
    """Int nanoseconds of a google.protobuf.Timestamp, exactly."""
    return int(message.seconds) * NS_PER_S + int(message.nanos)


def video(stamp_ns: int, picture: EncodedPicture, frame_id: str) -> Message:
    """foxglove.CompressedVideo of one H.264 or H.265 access unit in Annex B."""
    return CompressedVideo(timestamp=time_fields(stamp_ns), frame_id=frame_id, data=picture.data, format=picture.format)


def image(stamp_ns: int, picture: EncodedPicture, frame_id: str) -> Message:
    """foxglove.CompressedImage of one JPEG."""
    return CompressedImage(timestamp=time_fields(stamp_ns), frame_id=frame_id, data=picture.data, format=picture.format)


def calibration(stamp_ns: int, camera: Camera, frame_id: str) -> Message:
    """foxglove.CameraCalibration; as in ROS an integer coordinate is a pixel's centre: no shift."""
    return CameraCalibration(timestamp=time_fields(stamp_ns), frame_id=frame_id, **fields_of(camera))


def transforms(stamp_ns: int, edges: Iterable[tuple[str, str, Fields]]) -> Message:
    """foxglove.FrameTransforms of frames with one origin: parent, child and the child's rotation (`UPRIGHT`, ...)."""
    stamp = time_fields(stamp_ns)
    frames: list[Fields] = [
        {
            "timestamp": stamp,
            "parent_frame_id": parent,
            "child_frame_id": child,
            "translation": {},
            "rotation": rotation,
        }
        for parent, child, rotation in edges
    ]
    return FrameTransforms(transforms=frames)


def point(xyz: FloatArray) -> Fields:
    """The fields of a Vector3 or Point3 from an array (3,)."""
    x, y, z = xyz.tolist()
    return {"x": x, "y": y, "z": z}


def _vector(xyz: FloatArray | None) -> Fields | None:
    return None if xyz is None else point(xyz)


def _numbers(matrix: FloatArray | None) -> list[float] | None:
    return None if matrix is None else matrix.ravel().tolist()


def pose(stamp_ns: int, xyz_cam_m: FloatArray, frame_id: str) -> Message:
    """foxglove.PoseInFrame of a sphere's centre (3,) in metres."""
    return PoseInFrame(
        timestamp=time_fields(stamp_ns),
        frame_id=frame_id,
        pose={"position": point(xyz_cam_m), "orientation": UPRIGHT},
    )


def _circle(circle: Circle | None) -> Fields | None:
    return None if circle is None else {"x_px": circle.x_px, "y_px": circle.y_px, "r_px": circle.r_px}


def _window(window: Window) -> Fields:
    return {"x": window.x, "y": window.y, "width": window.width, "height": window.height}


def state(estimate: MarkerEstimate, smoothed: SmoothedPose | None, frame_id: str) -> Message:
    """spheremcap.MarkerState: everything about one marker on one frame; None stays unset."""
    sd, window = estimate.circle_sd_px, estimate.search
    return _pb.MarkerState(
        timestamp=time_fields(estimate.stamp_ns),
        marker=estimate.marker,
        frame_index=estimate.frame_index,
        status=estimate.status.value,
        circle=_circle(estimate.circle),
        circle_sd=None if sd is None else _circle(Circle(*sd)),
        claim=_circle(estimate.claim),
        proposer=estimate.proposer or None,
        proposals=[{"proposer": name, "circle": _circle(circle)} for name, circle in estimate.proposals],
        search=None if window is None else _window(window),
        vote_sum=estimate.vote_sum,
        verdict=None if estimate.verdict is None else estimate.verdict.value,
        visible=estimate.visible,
        frame_id=frame_id,
        position=_vector(estimate.xyz_cam_m),
        covariance=_numbers(estimate.covariance_m2),
        velocity=_vector(estimate.velocity_cam_mps),
        smoothed_position=None if smoothed is None else _vector(smoothed.xyz_cam_m),
        smoothed_covariance=None if smoothed is None else _numbers(smoothed.covariance_m2),
        smoothed_velocity=None if smoothed is None else _vector(smoothed.velocity_cam_mps),
        reasons=estimate.reasons,
        answer_frame=estimate.answer_frame,
    )


def votes(estimate: MarkerEstimate) -> Message:
    """spheremcap.MarkerVotes: all votes of one marker on one frame, their sum and the best of them."""
    best = max(estimate.votes, key=lambda vote: vote.overlap, default=None)
    return _pb.MarkerVotes(
        timestamp=time_fields(estimate.stamp_ns),
        marker=estimate.marker,
        frame_index=estimate.frame_index,
        votes=[
            {"matcher": v.matcher, "circle": _circle(v.circle), "score": v.score, "overlap": v.overlap}
            for v in estimate.votes
        ],
        sum=estimate.vote_sum,
        verdict=None if estimate.verdict is None else estimate.verdict.value,
        best=best.matcher if best is not None and best.overlap > 0 else None,
        best_overlap=None if best is None else best.overlap,
        any_agrees=None if best is None else best.overlap >= AGREES,
    )


def request(asked: OperatorRequest) -> Message:
    """spheremcap.OperatorRequest."""
    return _pb.OperatorRequest(
        timestamp=time_fields(asked.raised_stamp_ns),
        marker=asked.marker,
        frame_index=asked.frame_index,
        frame_timestamp=time_fields(asked.stamp_ns),
        raised_at_frame_index=asked.raised_at_frame_index,
        reason=asked.reason,
        reasons=asked.reasons,
        answered=asked.answered,
    )


def log(stamp_ns: int, level: LogLevel, text: str) -> Message:
    """foxglove.Log with a line for the user."""
    return Log(timestamp=time_fields(stamp_ns), level=Log.Level.Value(level), message=text, name="spheremcap")


def scene_entity(
    estimate: MarkerEstimate,
    marker: MarkerSpec,
    color_index: int,
    trail: Iterable[Collection[Fields]],
    frame_id: str,
) -> Message | None:
    """foxglove.SceneEntity of a marker: a sphere of its true size, solid when measured, pale when estimated.

    `trail` holds stretches of past positions as `point` gives them, each drawn as one line. None when the marker
    has no position.
    """
    if estimate.xyz_cam_m is None:
        return None
    rgb = marker_rgb(color_index)
    size = marker.diameter_m
    sphere = {
        "pose": {"position": point(estimate.xyz_cam_m), "orientation": UPRIGHT},
        "size": {"x": size, "y": size, "z": size},
        "color": color(rgb, 1.0 if estimate.status.measured else 0.35),
    }
    faint = color(rgb, 0.7)
    lines = [
        {"type": LinePrimitive.LINE_STRIP, "pose": _ORIGIN, "thickness": 2.0, "scale_invariant": True,
         "points": stretch, "color": faint}
        for stretch in trail
        if len(stretch) > 1
    ]  # fmt: skip
    return SceneEntity(
        timestamp=time_fields(estimate.stamp_ns), frame_id=frame_id, id=marker.name, lifetime=_LIFETIME,
        spheres=[sphere], lines=lines,
    )  # fmt: skip
