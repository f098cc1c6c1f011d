"""A wrist about its wheel: radius, angle and distance from the wheel's plane, with covariances."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.analysis.smoother import unpacked

FloatArray = npt.NDArray[np.float64]
_BLOCK = 8192


@dataclass(frozen=True, slots=True)
class Wheel:
    """One rear wheel in the chair's frame: its hub and the axes of its plane, forward, up in it, and outward."""

    hub_m: FloatArray
    axes: FloatArray

    @staticmethod
    def of(side: str, half_track_m: float, camber_rad: float) -> "Wheel":
        """The wheel of a side: its hub half the track from the middle, its top leaning inward by the camber."""
        sign, sin, cos = 1.0 if side == "left" else -1.0, np.sin(camber_rad), np.cos(camber_rad)
        axes = np.array([[1.0, 0.0, 0.0], [0.0, -sign * sin, cos], [0.0, sign * cos, sin]])
        return Wheel(np.array([0.0, sign * half_track_m, 0.0]), axes)


@dataclass(frozen=True)
class AboutAxle:
    """A wrist about its wheel's axle at N times.

    `radius_m` (N,), `angle_rad` (N,) from straight up in the wheel's plane, growing as the wheel turns when the chair
    goes forward and not jumping at a whole turn, `outward_m` (N,) from the wheel's plane; NaN where there is no
    position. `covariance` (N, 2, 2) is that of (radius in m, radius times angle in m).
    """

    radius_m: FloatArray
    angle_rad: FloatArray
    outward_m: FloatArray
    covariance: FloatArray


def about_axle(xyz_m: npt.NDArray[np.float32], packed: npt.NDArray[np.float32], wheel: Wheel) -> AboutAxle:
    """Positions (N, 3) in the chair's frame with covariances (N, 6), as in a `JointTrack`, about a wheel's axle."""
    count = len(xyz_m)
    out = AboutAxle(np.empty(count), np.empty(count), np.empty(count), np.empty((count, 2, 2)))
    for start in range(0, count, _BLOCK):
        part = slice(start, start + _BLOCK)
        u, v, out.outward_m[part] = wheel.axes @ (xyz_m[part] - wheel.hub_m).T
        radius = np.hypot(u, v)
        out.radius_m[part], out.angle_rad[part] = radius, np.arctan2(u, v)
        rows = np.zeros((len(u), 2, 3))
        rows[:, 0, 0], rows[:, 0, 1] = u / radius, v / radius
        rows[:, 1, 0], rows[:, 1, 1] = v / radius, -u / radius
        jacobian = rows @ wheel.axes
        out.covariance[part] = jacobian @ unpacked(packed[part]) @ jacobian.transpose(0, 2, 1)
    seen = np.isfinite(out.angle_rad)
    out.angle_rad[seen] = np.unwrap(out.angle_rad[seen])
    return out
