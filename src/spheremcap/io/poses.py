"""Markers' measured positions, read for analysis in little memory: 57 bytes a frame."""

from array import array
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.estimate import Status
from spheremcap.io import _pb
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import STATE, UNREADABLE, int64_ns, schema_names, track_name

_UPPER = (0, 1, 2, 4, 5, 8)
"""The numbers of a row-major 3 x 3 matrix that a symmetric one is told by: xx, xy, xz, yy, yz, zz."""


@dataclass(frozen=True)
class Poses:
    """One marker's frames by rising log time. Arrays are of N frames, NaN where a position was not measured.

    `stamp_ns` (N,) is the log time, `xyz_cam_m` (N, 3) float32 in the camera's optical frame, `covariance_m2` (N, 6)
    float32 its covariance (xx, xy, xz, yy, yz, zz), `circle_px` (N, 3) float32 the measured circle: x, y, r.
    `bridged` (N,) is where the filter stood in.
    """

    marker: str
    stamp_ns: npt.NDArray[np.int64]
    xyz_cam_m: npt.NDArray[np.float32]
    covariance_m2: npt.NDArray[np.float32]
    circle_px: npt.NDArray[np.float32]
    bridged: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """(N,) where there is a position that was measured."""
        return np.isfinite(self.xyz_cam_m[:, 0])


def read_poses(records: McapRecords, topics: Collection[str] | None = None) -> dict[str, Poses]:
    """All markers' poses, or those of some topics of states; `records` counts what does not decode."""
    names = schema_names(records)
    states = {c.topic for c in records.channels.values() if names[c.id] == STATE}
    wanted = states if topics is None else states & set(topics)
    measured = {_pb.MarkerState.Status.Value(status.value) for status in Status if status.measured} | {1, 2}
    bridged = {_pb.MarkerState.Status.Value(Status.ESTIMATED.value), 3}
    rows: dict[str, tuple[array[int], array[float], array[int]]] = {}
    nothing = [float("nan")] * 12
    parse = _pb.MarkerState.FromString
    for raw in records.messages(wanted) if wanted else ():
        if names.get(raw.channel.id) != STATE:
            continue
        try:
            state, stamp_ns = parse(raw.data), int64_ns(raw.log_time)
        except UNREADABLE as error:
            records.undecodable(raw.channel.topic, error)
            continue
        name = track_name(raw.channel.topic, state.marker)
        if name not in rows:
            rows[name] = array("q"), array("f"), array("b")
        stamps, numbers, stood_in = rows[name]
        stamps.append(stamp_ns)
        covariance = state.covariance
        if state.status in measured and state.HasField("position") and len(covariance) == 9:
            p, c = state.position, state.circle
            numbers.extend((p.x, p.y, p.z, *[covariance[k] for k in _UPPER], c.x_px, c.y_px, c.r_px))
        else:
            numbers.extend(nothing)
        stood_in.append(state.status in bridged)
    found = {}
    for name, (stamps, numbers, stood_in) in rows.items():
        table = np.frombuffer(numbers, np.float32).reshape(-1, 12)
        found[name] = Poses(
            name, np.frombuffer(stamps, np.int64), table[:, :3], table[:, 3:9], table[:, 9:],
            np.frombuffer(stood_in, np.int8).astype(np.bool_),
        )  # fmt: skip
    return found


def without_focal(poses: Poses, focal_sd: float) -> npt.NDArray[np.float32]:
    """The covariances (N, 6) without what the focal length's relative uncertainty adds to each, as that is the same
    error on all frames."""
    packed = poses.covariance_m2.copy()
    for k, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        packed[:, k] -= poses.xyz_cam_m[:, i] * poses.xyz_cam_m[:, j] * np.float32(focal_sd**2)
    return packed
