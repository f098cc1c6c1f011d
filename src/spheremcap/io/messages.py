"""From the nouns to protobuf messages: pure functions, no state, nothing invented for what is None.

Stamps are int nanoseconds. The nouns' pixel coordinates count from the centre of the top-left pixel; viewers
draw annotations from its corner, so annotations (and only they) are shifted by half a pixel. Poses are in the
optical frame and have the unit quaternion, w being 1, for a sphere has no orientation.

What goes inside a message is given as a dict of its fields: protobuf makes the inner message in place from it, where
a ready message would be copied, at twice the time. With six markers that is 120 inner messages a frame.
"""

# mypy: disable-error-code="arg-type, list-item"
# The schemas' stubs do not know that a dict will do.

from collections.abc import Collection, Iterable
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
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
Message = Any
"""A protobuf message; its classes are made at run time and have no static type."""
Fields = dict[str, Any]
"""What an inner message holds, by field name; inner messages of it are such dicts again."""

AGREES = 2 / 3
"""Overlap from which one matcher counts as agreeing: its share of TH1 = 4 of 6. Only for `any_agrees`."""
LIFETIME_NS = 100_000_000
"""How long a viewer draws a sphere after its last message, so that a lost marker vanishes."""

STATUS_RGB: dict[Status, Rgb] = {
    Status.SEEDED: (0.25, 0.65, 1.0),
    Status.VERIFIED: (0.2, 0.9, 0.3),
    Status.ESTIMATED: (1.0, 0.75, 0.1),
    Status.LOST: (1.0, 0.2, 0.2),
    Status.OUT_OF_VIEW: (0.65, 0.65, 0.65),
}
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


def _color(rgb: Rgb, alpha: float) -> Fields:
    r, g, b = rgb
    return {"r": r, "g": g, "b": b, "a": alpha}


_STATUS_COLOR = {status: _color(rgb, 1.0) for status, rgb in STATUS_RGB.items()}
_FAINT_COLOR = {status: _color(rgb, 0.45) for status, rgb in STATUS_RGB.items()}
_LABEL_BACKGROUND = _color((0.0, 0.0, 0.0), 0.45)
_UPRIGHT: Fields = {"w": 1.0}
_ORIGIN: Fields = {"position": {}, "orientation": _UPRIGHT}
_OPTICAL_IN_CAMERA: Fields = {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5}
_LIFETIME: Fields = {"seconds": LIFETIME_NS // NS_PER_S, "nanos": LIFETIME_NS % NS_PER_S}


def timestamp(stamp_ns: int) -> Message:
    """google.protobuf.Timestamp of int nanoseconds, exactly."""
    return Timestamp(**_time(stamp_ns))


def _time(stamp_ns: int) -> Fields:
    seconds, nanos = divmod(stamp_ns, NS_PER_S)
    return {"seconds": seconds, "nanos": nanos}


def stamp_of(message: Message) -> int:
    """Int nanoseconds of a google.protobuf.Timestamp, exactly."""
    return int(message.seconds) * NS_PER_S + int(message.nanos)


def video(stamp_ns: int, picture: EncodedPicture, frame_id: str) -> Message:
    """foxglove.CompressedVideo of one H.264 or H.265 access unit in Annex B."""
    return CompressedVideo(timestamp=_time(stamp_ns), frame_id=frame_id, data=picture.data, format=picture.format)


def image(stamp_ns: int, picture: EncodedPicture, frame_id: str) -> Message:
    """foxglove.CompressedImage of one JPEG."""
    return CompressedImage(timestamp=_time(stamp_ns), frame_id=frame_id, data=picture.data, format=picture.format)


def calibration(stamp_ns: int, camera: Camera, frame_id: str) -> Message:
    """foxglove.CameraCalibration; as in ROS an integer coordinate is a pixel's centre: no shift."""
    return CameraCalibration(timestamp=_time(stamp_ns), frame_id=frame_id, **fields_of(camera))


def transforms(stamp_ns: int, world: str, camera: str, optical: str) -> Message:
    """foxglove.FrameTransforms world -> camera (x forward, y left, z up) -> optical (x right, z forward).

    The camera stands at the world's origin: nothing is known of where it really is.
    """
    stamp = _time(stamp_ns)
    frames: list[Fields] = [
        {
            "timestamp": stamp,
            "parent_frame_id": parent,
            "child_frame_id": child,
            "translation": {},
            "rotation": rotation,
        }
        for parent, child, rotation in ((world, camera, _UPRIGHT), (camera, optical, _OPTICAL_IN_CAMERA))
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
        timestamp=_time(stamp_ns),
        frame_id=frame_id,
        pose={"position": point(xyz_cam_m), "orientation": _UPRIGHT},
    )


def _circle(circle: Circle | None) -> Fields | None:
    return None if circle is None else {"x_px": circle.x_px, "y_px": circle.y_px, "r_px": circle.r_px}


def _window(window: Window) -> Fields:
    return {"x": window.x, "y": window.y, "width": window.width, "height": window.height}


def state(estimate: MarkerEstimate, smoothed: SmoothedPose | None, frame_id: str) -> Message:
    """spheremcap.MarkerState: everything about one marker on one frame; None stays unset."""
    sd, window = estimate.circle_sd_px, estimate.search
    return _pb.MarkerState(
        timestamp=_time(estimate.stamp_ns),
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
        timestamp=_time(estimate.stamp_ns),
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
        timestamp=_time(asked.raised_stamp_ns),
        marker=asked.marker,
        frame_index=asked.frame_index,
        frame_timestamp=_time(asked.stamp_ns),
        raised_at_frame_index=asked.raised_at_frame_index,
        reason=asked.reason,
        reasons=asked.reasons,
        answered=asked.answered,
    )


def log(stamp_ns: int, level: LogLevel, text: str) -> Message:
    """foxglove.Log with a line for the user."""
    return Log(timestamp=_time(stamp_ns), level=Log.Level.Value(level), message=text, name="spheremcap")


def annotations(stamp_ns: int, estimates: Iterable[MarkerEstimate], font_px: float) -> Message:
    """foxglove.ImageAnnotations of a frame: circle, name and status, searched window, a claim that failed.

    Colours say the status (`STATUS_RGB`). A marker without a circle keeps its label: at the searched
    window, or in a list down the left edge when there is none. Every item bears the picture's own stamp, as
    viewers want it.
    """
    stamp = _time(stamp_ns)
    circles: list[Fields] = []
    outlines: list[Fields] = []
    labels: list[Fields] = []
    unplaced = 0
    for estimate in estimates:
        colour, faint = _STATUS_COLOR[estimate.status], _FAINT_COLOR[estimate.status]
        if estimate.circle is not None:
            circles.append(_circle_annotation(stamp, estimate.circle, 2.0, colour))
        if estimate.claim is not None and not estimate.status.measured:
            circles.append(_circle_annotation(stamp, estimate.claim, 1.0, faint))
        if estimate.search is not None:
            outlines.append(_outline(stamp, estimate.search, faint))
        place = _label_place(estimate)
        if place is None:
            unplaced += 1
            place = (font_px / 2, unplaced * 1.5 * font_px)
        text = f"{estimate.marker} {estimate.status.value}"
        if estimate.vote_sum is not None:
            text += f" {estimate.vote_sum:.1f}"
        labels.append(
            {
                "timestamp": stamp, "position": {"x": place[0], "y": place[1]}, "text": text, "font_size": font_px,
                "text_color": colour, "background_color": _LABEL_BACKGROUND,
            }
        )  # fmt: skip
    return ImageAnnotations(timestamp=stamp, circles=circles, points=outlines, texts=labels)


def _circle_annotation(stamp: Fields, circle: Circle, thickness: float, colour: Fields) -> Fields:
    return {
        "timestamp": stamp, "position": {"x": circle.x_px + 0.5, "y": circle.y_px + 0.5},
        "diameter": 2 * circle.r_px, "thickness": thickness, "outline_color": colour,
    }  # fmt: skip


def _outline(stamp: Fields, window: Window, colour: Fields) -> Fields:
    """The window's border; its corners are pixel corners, which is where viewers count from: no shift."""
    x0, y0, x1, y1 = window.x, window.y, window.x + window.width, window.y + window.height
    corners = [{"x": x0, "y": y0}, {"x": x1, "y": y0}, {"x": x1, "y": y1}, {"x": x0, "y": y1}]
    return {
        "timestamp": stamp, "type": PointsAnnotation.LINE_LOOP, "points": corners, "outline_color": colour,
        "thickness": 1.0,
    }  # fmt: skip


def _label_place(estimate: MarkerEstimate) -> tuple[float, float] | None:
    """Bottom left of the label, up and right of the circle, in viewer coordinates."""
    circle = estimate.circle or estimate.claim
    if circle is not None:
        return circle.x_px + 0.5 + 0.8 * circle.r_px, circle.y_px + 0.5 - circle.r_px
    if estimate.search is not None:
        return float(estimate.search.x), float(estimate.search.y)
    return None


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
    rgb = MARKER_RGB[color_index % len(MARKER_RGB)]
    size = marker.diameter_m
    sphere = {
        "pose": {"position": point(estimate.xyz_cam_m), "orientation": _UPRIGHT},
        "size": {"x": size, "y": size, "z": size},
        "color": _color(rgb, 1.0 if estimate.status.measured else 0.35),
    }
    color = _color(rgb, 0.7)
    lines = [
        {"type": LinePrimitive.LINE_STRIP, "pose": _ORIGIN, "thickness": 2.0, "scale_invariant": True,
         "points": stretch, "color": color}
        for stretch in trail
        if len(stretch) > 1
    ]  # fmt: skip
    return SceneEntity(
        timestamp=_time(estimate.stamp_ns), frame_id=frame_id, id=marker.name, lifetime=_LIFETIME,
        spheres=[sphere], lines=lines,
    )  # fmt: skip
