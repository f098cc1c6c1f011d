"""Markers' measured positions, read for analysis in little memory: 50 bytes a frame."""

from array import array
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.estimate import Status
from spheremcap.io import _pb
from spheremcap.io.mcap_records import McapRecords, RawMessage
from spheremcap.io.recording import STATE, UNREADABLE, int64_ns, schema_names, track_name

_UPPER = (0, 1, 2, 4, 5, 8)
"""The numbers of a row-major 3 x 3 matrix that a symmetric one is told by: xx, xy, xz, yy, yz, zz."""
_WIDTH = 10
_NOTHING = [float("nan")] * _WIDTH
_MEASURED = {_pb.MarkerState.Status.Value(status.value) for status in Status if status.measured} | {1, 2}
_BRIDGED = {_pb.MarkerState.Status.Value(Status.ESTIMATED.value), 3}
"""Their numbers, and those of before viewers' colours went by them."""


@dataclass(frozen=True)
class Poses:
    """One marker's frames by rising log time. Arrays are of N frames, NaN where a position was not measured.

    `stamp_ns` (N,) is the log time, `xyz_cam_m` (N, 3) float32 in the camera's optical frame, `covariance_m2` (N, 6)
    float32 its covariance (xx, xy, xz, yy, yz, zz), `row_px` (N,) float32 the measured circle's row. `bridged` (N,) is
    where the filter stood in.
    """

    marker: str
    stamp_ns: npt.NDArray[np.int64]
    xyz_cam_m: npt.NDArray[np.float32]
    covariance_m2: npt.NDArray[np.float32]
    row_px: npt.NDArray[np.float32]
    bridged: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """(N,) where there is a position that was measured."""
        return np.isfinite(self.xyz_cam_m[:, 0])


class PoseRows:
    """All markers' poses while a recording is read."""

    def __init__(self) -> None:
        self._rows: dict[str, tuple[array[int], array[float], array[int]]] = {}
        self._by_channel: dict[int, tuple[str, tuple[array[int], array[float], array[int]]]] = {}

    def add(self, raw: RawMessage) -> None:
        """Take in a state. Raises UNREADABLE, and then has added nothing."""
        state, stamp_ns = _pb.MarkerState.FromString(raw.data), int64_ns(raw.log_time)
        marker = state.marker
        known = self._by_channel.get(raw.channel.id)
        if known is None or known[0] != marker:
            name = track_name(raw.channel.topic, marker)
            known = marker, self._rows.setdefault(name, (array("q"), array("f"), array("b")))
            self._by_channel[raw.channel.id] = known
        stamps, numbers, stood_in = known[1]
        stamps.append(stamp_ns)
        status, covariance = state.status, state.covariance
        if status in _MEASURED and len(covariance) == 9 and state.HasField("position"):
            p = state.position
            xx, xy, xz, _, yy, yz, _, _, zz = covariance
            numbers.extend((p.x, p.y, p.z, xx, xy, xz, yy, yz, zz, state.circle.y_px))
        else:
            numbers.extend(_NOTHING)
        stood_in.append(status in _BRIDGED)

    def poses(self) -> dict[str, Poses]:
        """What was read, by marker."""
        found = {}
        for name, (stamps, numbers, stood_in) in self._rows.items():
            table = np.frombuffer(numbers, np.float32).reshape(-1, _WIDTH)
            found[name] = Poses(
                name, np.frombuffer(stamps, np.int64), table[:, :3], table[:, 3:9], table[:, 9],
                np.frombuffer(stood_in, np.bool_),
            )  # fmt: skip
        return found


def read_poses(records: McapRecords) -> dict[str, Poses]:
    """All markers' poses; `records` counts what does not decode."""
    names, rows = schema_names(records), PoseRows()
    states = {c.topic for c in records.channels.values() if names[c.id] == STATE}
    for raw in records.messages(states) if states else ():
        if names.get(raw.channel.id) == STATE:
            try:
                rows.add(raw)
            except UNREADABLE as error:
                records.undecodable(raw.channel.topic, error)
    return rows.poses()


def without_focal(poses: Poses, focal_sd: float) -> npt.NDArray[np.float32]:
    """The covariances (N, 6) without what the focal length's relative uncertainty adds to each, as that is the same
    error on all frames."""
    if not focal_sd:
        return poses.covariance_m2
    packed = poses.covariance_m2.copy()
    for k, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        packed[:, k] -= poses.xyz_cam_m[:, i] * poses.xyz_cam_m[:, j] * np.float32(focal_sd**2)
    return packed
