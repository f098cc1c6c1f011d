"""What was found as messages by log time: where the chair is, arms and trunk on every frame, strokes and events."""

import heapq
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from scipy.spatial.transform import Rotation

from spheremcap.analysis.chair import ChairFrame
from spheremcap.analysis.curves import ArmCurves
from spheremcap.analysis.findings import Findings
from spheremcap.core.time import NS_PER_S
from spheremcap.io import _pb
from spheremcap.io.messages import Message, time_fields
from spheremcap.io.strokes import event_message, stroke_message

ROOT = "/analysis"
CHAIR = "chair"
"""The chair's coordinate frame."""
_TOLD_EVERY_NS = 2 * NS_PER_S
"""How often a recording says where the chair is, so that a part of it knows."""
_BLOCK = 4096
Stamped = tuple[int, str, Message]
"""Log time, topic, message."""


def messages_of(found: Findings, optical_frame: str, transforms: str) -> Iterator[Stamped]:
    """All messages by log time; `transforms` is the topic that says which frame stands in which."""
    streams: list[Iterable[Stamped]] = []
    frame_id = optical_frame
    if found.chair is not None:
        frame_id = CHAIR
        streams.append(_chair(found, found.chair, optical_frame, transforms))
    for side, arm in found.arms.items():
        streams.append(_arm(found, side, arm, frame_id))
    if found.trunk is not None:
        streams.append(_trunk(found, frame_id))
    for hand in found.hands.values():
        streams.append((e.stamp_ns, f"{ROOT}/{e.side}/events", event_message(e)) for e in hand.events)
        streams.append((s.stamp_ns, f"{ROOT}/{s.side}/strokes", stroke_message(s)) for s in hand.strokes)
    return heapq.merge(*streams, key=lambda stamped: stamped[0])


def _chair(found: Findings, chair: ChairFrame, optical_frame: str, transforms: str) -> Iterator[Stamped]:
    rotation = chair.rotation.T  # the chair's axes in the camera's frame
    translation = dict(zip("xyz", (-rotation @ chair.camera_xyz_chair_m).tolist(), strict=True))
    turn = dict(zip("xyzw", Rotation.from_matrix(rotation).as_quat(canonical=True).tolist(), strict=True))
    for stamp_ns in range(int(found.stamp_ns[0]), int(found.stamp_ns[-1]) + 1, _TOLD_EVERY_NS):
        edge: dict[str, Any] = {
            "timestamp": time_fields(stamp_ns), "parent_frame_id": optical_frame, "child_frame_id": CHAIR,
            "translation": translation, "rotation": turn,
        }  # fmt: skip
        yield stamp_ns, transforms, FrameTransforms(transforms=[edge])  # type: ignore[list-item]
        yield (
            stamp_ns, f"{ROOT}/chair",
            _pb.ChairFrame(
                **edge, covariance=chair.covariance.ravel().tolist(), half_track_m=chair.half_track_m,
                half_track_sd_m=chair.half_track_sd_m, told_by=chair.told_by, misfit=chair.misfit,
                upright=chair.upright,
            ),
        )  # fmt: skip


def _arm(found: Findings, side: str, arm: ArmCurves, frame_id: str) -> Iterator[Stamped]:
    """An ArmSample on each frame on which the wrist may be used."""
    topic = f"{ROOT}/{side}/arm"
    for start in range(0, len(arm.there), _BLOCK):
        part = slice(start, start + _BLOCK)
        index = np.flatnonzero(arm.there[part]) + start
        columns: dict[str, npt.NDArray[Any]] = {name: column[index] for name, column in arm.values.items()}
        columns |= {name: column[index - start] for name, column in found.about(side, part).items()}
        sd = np.sqrt(np.maximum(arm.packed[index][:, [0, 3, 5]], 0))
        places = zip(arm.xyz_m[index].tolist(), sd.tolist(), arm.velocity_mps[index].tolist(), strict=True)
        rows = zip(found.stamp_ns[index].tolist(), arm.measured[index].tolist(), places, _rows(columns), strict=True)
        for stamp_ns, measured, (xyz, xyz_sd, velocity), fields in rows:
            yield stamp_ns, topic, _pb.ArmSample(
                timestamp=time_fields(stamp_ns), frame_id=frame_id, measured=measured, wrist=_xyz(xyz),
                wrist_sd=_xyz(xyz_sd), velocity=_xyz(velocity), **fields,
            )  # fmt: skip


def _trunk(found: Findings, frame_id: str) -> Iterator[Stamped]:
    values = found.trunk.values if found.trunk is not None else {}
    for start in range(0, len(found.stamp_ns), _BLOCK):
        part = slice(start, start + _BLOCK)
        columns = {name: column[part] for name, column in values.items()}
        for stamp_ns, fields in zip(found.stamp_ns[part].tolist(), _rows(columns), strict=True):
            if fields:
                yield stamp_ns, f"{ROOT}/trunk", _pb.TrunkSample(
                    timestamp=time_fields(stamp_ns), frame_id=frame_id, **fields
                )  # fmt: skip


def _rows(columns: Mapping[str, npt.NDArray[Any]]) -> Iterator[dict[str, float]]:
    """Each row's values that are there."""
    names = list(columns)
    for row in zip(*(column.tolist() for column in columns.values()), strict=True):
        yield {name: value for name, value in zip(names, row, strict=True) if value == value}


def _xyz(values: list[float]) -> dict[str, float]:
    return {"x": values[0], "y": values[1], "z": values[2]}
