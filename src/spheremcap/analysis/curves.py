"""What both arms and the trunk do on every frame, worked out once, a few seconds at a time, and kept in float32."""

import itertools
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.analysis import arms
from spheremcap.analysis.arms import Joint, Values
from spheremcap.analysis.rim import AboutAxle, Wheel, about_axle
from spheremcap.analysis.smoother import PAIRS, Smoother

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Curve = npt.NDArray[np.float32]

_BLOCK = 4096
_DRIFT_S = 5.0
"""A length's slow changes are told from windows of so long."""
_DECIDES = 10
"""Frames that a length needs to be told."""


@dataclass(frozen=True)
class ArmCurves:
    """One arm on N frames, from smoothed markers, NaN where there is none; units are those of spheremcap.ArmSample.

    `there` (N,) is where the wrist may be used, `measured` (N,) where it was measured. `xyz_m` (N, 3) is the wrist with
    the covariance `packed` (N, 6) (xx, xy, xz, yy, yz, zz), `velocity_mps` (N, 3) its velocity; `values` has the others
    by their names in the message, each with its `_sd` name.
    """

    side: str
    marker: str
    there: BoolArray
    measured: BoolArray
    xyz_m: Curve
    packed: Curve
    velocity_mps: Curve
    values: Mapping[str, Curve]

    def about(self, wheel: Wheel, part: slice = slice(None)) -> AboutAxle:
        """The smoothed wrist about a wheel's axle, of a part of the frames."""
        return about_axle(self.xyz_m[part], self.packed[part], wheel)


@dataclass(frozen=True)
class TrunkCurves:
    """The trunk on N frames: `values` by their names in spheremcap.TrunkSample."""

    values: Mapping[str, Curve]


ARM_VALUES = {
    "speed": "mps", "acceleration": "mps2", "jerk": "mps3", "elbow": "deg", "forearm_elevation": "deg",
    "upper_arm_elevation": "deg", "forearm": "m", "upper_arm": "m",
}  # fmt: skip
TRUNK_VALUES = {"lean": "deg", "tilt": "deg", "shoulders": "m"}
"""What is worked out, and its unit: the fields are called `elbow_deg` and `elbow_sd_deg`."""


def curves_of(
    smoothers: Mapping[tuple[str, str], Smoother], may_use: Mapping[tuple[str, str], BoolArray], *, chair: bool
) -> tuple[dict[str, ArmCurves], TrunkCurves | None]:
    """Both arms and the trunk from the smoothers of markers by (side, joint), where `may_use` (N,) says.

    Without `chair` nothing is told that needs what is upright or forward.
    """
    count = len(next(iter(smoothers.values())).track) if smoothers else 0
    sides = [side for side in ("left", "right") if (side, "wrist") in smoothers]
    xyz, packed, velocity = (
        {side: np.full((count, width), np.nan, np.float32) for side in sides} for width in (3, 6, 3)
    )
    told: dict[str, dict[str, Curve]] = {side: {} for side in (*sides, "trunk")}
    with ThreadPoolExecutor() as pool:
        for start in range(0, count, _BLOCK):
            part = slice(start, min(start + _BLOCK, count))
            found = pool.map(Smoother.motion, smoothers.values(), itertools.repeat(part))
            motions = dict(zip(smoothers, found, strict=True))
            joints = {
                key: Joint(smoothers[key].track.marker, motion, may_use[key][part], smoothers[key].track.measured[part])
                for key, motion in motions.items()
            }
            for side in sides:
                wrist = joints[side, "wrist"]
                xyz[side][part] = np.where(wrist.there[:, None], wrist.motion.xyz_m, np.nan)
                velocity[side][part] = np.where(wrist.there[:, None], wrist.motion.velocity_mps, np.nan)
                for k, (i, j) in enumerate(PAIRS):
                    packed[side][part, k] = np.where(wrist.there, wrist.motion.xyz_m2[:, i, j], np.nan)
                _keep(told[side], _arm(joints, side, chair), ARM_VALUES, part, count)
            _keep(told["trunk"], _trunk(joints, chair), TRUNK_VALUES, part, count)
    both = {}
    for side in sides:
        key = side, "wrist"
        track = smoothers[key].track
        both[side] = ArmCurves(
            side, track.marker, may_use[key], track.measured, xyz[side], packed[side], velocity[side], told[side]
        )
    return both, TrunkCurves(told["trunk"]) if told["trunk"] else None


def _keep(
    kept: dict[str, Curve], found: Mapping[str, Values], units: Mapping[str, str], part: slice, count: int
) -> None:
    for name, values in found.items():
        for field, column in ((f"{name}_{units[name]}", values.value), (f"{name}_sd_{units[name]}", values.sd)):
            if field not in kept:
                kept[field] = np.full(count, np.nan, np.float32)
            kept[field][part] = column


def _arm(joints: Mapping[tuple[str, str], Joint], side: str, chair: bool) -> dict[str, Values]:
    wrist, motion = joints[side, "wrist"], joints[side, "wrist"].motion
    found = {
        "speed": arms.size_of(motion.velocity_mps, motion.velocity_cov, wrist.there),
        "acceleration": arms.size_of(motion.acceleration_mps2, motion.acceleration_cov, wrist.there),
        "jerk": arms.size_of(motion.jerk_mps3, motion.jerk_cov, wrist.there),
    }
    elbow, shoulder = joints.get((side, "elbow")), joints.get((side, "shoulder"))
    if elbow is not None:
        found["forearm"] = arms.distance(wrist, elbow)
        if chair:
            found["forearm_elevation"] = arms.elevation(wrist, elbow)
    if elbow is not None and shoulder is not None:
        found["upper_arm"] = arms.distance(elbow, shoulder)
        found["elbow"] = arms.joint_angle(wrist, elbow, shoulder)
        if chair:
            found["upper_arm_elevation"] = arms.elevation(elbow, shoulder)
    return found


def _trunk(joints: Mapping[tuple[str, str], Joint], chair: bool) -> dict[str, Values]:
    shoulders = [joints[side, "shoulder"] for side in ("left", "right") if (side, "shoulder") in joints]
    hips = [joints[side, "hip"] for side in ("left", "right") if (side, "hip") in joints]
    found: dict[str, Values] = {}
    if len(shoulders) == 2:
        found["shoulders"] = arms.distance(*shoulders)
        if chair:
            found["tilt"] = arms.tilt(*shoulders)
    if len(shoulders) == 2 and len(hips) == 2 and chair:
        found["lean"] = arms.lean((hips[0], hips[1]), (shoulders[0], shoulders[1]))
    return found


@dataclass(frozen=True)
class SegmentLength:
    """The distance of two markers on one part of the body, over all frames with both.

    `median_m`; `spread` is its robust standard deviation over the frames and `noise` what the positions' own would make
    of it, both as shares of the length; `drift` the largest departure of a five seconds' median. None: too few frames.
    """

    segment: str
    frames: int
    median_m: float | None = None
    spread: float | None = None
    noise: float | None = None
    drift: float | None = None

    @property
    def constant(self) -> bool:
        """Whether the length is, within what its noise and 1 % for skin allow."""
        return self.spread is None or self.noise is None or self.spread <= 2 * self.noise + 0.01


def segment_length(segment: str, t_s: FloatArray, length_m: Curve, sd_m: Curve) -> SegmentLength:
    """What a length (N,) with its standard deviation (N,) is over all frames that have it."""
    there = np.isfinite(length_m)
    frames = int(there.sum())
    if frames < _DECIDES:
        return SegmentLength(segment, frames)
    length, t = length_m[there].astype(np.float64), t_s[there]
    median = float(np.median(length))
    spread = 1.4826 * float(np.median(np.abs(length - median))) / median
    window = ((t - t[0]) // _DRIFT_S).astype(np.int64)
    cuts = np.flatnonzero(np.diff(window)) + 1
    medians = [float(np.median(some)) for some in np.split(length, cuts) if len(some) >= _DECIDES]
    drift = max((abs(m - median) for m in medians), default=0.0) / median
    return SegmentLength(segment, frames, median, spread, float(np.median(sd_m[there])) / median, drift)
