"""The circle that a wrist goes on while its hand is on the rim, found in its path where nothing else tells the axle.

Short stretches of the path propose circles; the one kept is that which the path goes along the farthest, at a rate that
does not change within a push, for that is what a wheel's inertia does and a free hand does not.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_TRIES, _WINDOW_S = 400, 0.080
_ON_M = 0.008
_STEADY = 0.10
"""How much a rate may vary within a push, as a share."""
_SHORTEST_RAD = float(np.radians(40.0))
_RADII_M = 0.12, 0.45
_WRISTS_M = -0.03, 0.09
_ROLL_M, _PLANE_M = 0.005, 0.010
"""How well wrists keep to their circle and to its plane."""
_SAYS = 3
"""A push's positions err alike: so many of them count."""
_FEWEST = 3
"""Fewer pushes than these could be anything."""
_KEPT = 600


@dataclass(frozen=True)
class PushCircle:
    """A push's circle: centre (3,) in the camera's optical frame, radius, and positions (M, 3) on it, which count
    `weight_per_m` each for their distance from the centre and `plane_weight_per_m` for that from the plane."""

    centre_cam_m: FloatArray
    radius_m: float
    xyz_cam_m: FloatArray
    weight_per_m: float
    plane_weight_per_m: float

    @property
    def counts(self) -> float:
        """As how many positions they count."""
        return len(self.xyz_cam_m) * (self.weight_per_m * _ROLL_M) ** 2


def push_circle(
    t_s: FloatArray, xyz_cam_m: FloatArray, velocity_cam_mps: FloatArray, plane: FloatArray,
    rim_radius_m: float | None, turning_rad_s: FloatArray | None = None,
) -> PushCircle | None:  # fmt: skip
    """The circle of a wrist (N, 3) that moves (N, 3), in the plane of `plane`: its forward and its upward axis and its
    normal, (3, 3) rows in the camera's frame. None where the path has none. The wheel's rate helps where it is known.
    """
    p, v = xyz_cam_m @ plane[:2].T, velocity_cam_mps @ plane[:2].T
    low, high = _RADII_M if rim_radius_m is None else (rim_radius_m + _WRISTS_M[0], rim_radius_m + _WRISTS_M[1])
    path = _Path(t_s, p, v, turning_rad_s)
    rng = np.random.default_rng(0)
    best, most = None, 0.0
    for start in rng.uniform(t_s[0], max(t_s[0], t_s[-1] - _WINDOW_S), _TRIES):
        part = slice(int(np.searchsorted(t_s, start)), int(np.searchsorted(t_s, start + _WINDOW_S)))
        found = _circle(p[part]) if part.stop - part.start >= 5 else None
        if found is not None and low < found[2] < high:
            travel = path.travel(*found)[0]
            if travel > most:
                best, most = found, travel
    if best is None:
        return None
    for _ in range(4):
        travel, on, pushes = path.travel(*best)
        refined = _circle(p[on]) if on.sum() >= 10 else None
        if refined is None or not low < refined[2] < high or path.travel(*refined)[0] < 0.8 * travel:
            break
        best = refined
    _, on, pushes = path.travel(*best)
    if pushes < _FEWEST:
        return None
    index = np.flatnonzero(on)
    index = index[:: max(1, len(index) // _KEPT)]
    counts = np.sqrt(min(1.0, _SAYS * pushes / len(index)))
    height = float(np.median(xyz_cam_m[on] @ plane[2]))
    centre = np.array([best[0], best[1], height]) @ plane
    return PushCircle(centre, best[2], xyz_cam_m[index], counts / _ROLL_M, counts / _PLANE_M)


class _Path:
    """A wrist's path in its plane."""

    def __init__(self, t_s: FloatArray, p: FloatArray, v: FloatArray, turning_rad_s: FloatArray | None) -> None:
        self._t_s, self._p, self._v, self._turning = t_s, p, v, turning_rad_s

    def travel(self, x: float, y: float, radius_m: float) -> tuple[float, npt.NDArray[np.bool_], int]:
        """How far it goes along a circle as a rim goes, radians; which positions that are (N,), and in how many
        pushes."""
        d = self._p - (x, y)
        far = np.hypot(d[:, 0], d[:, 1])
        rate = (d[:, 1] * self._v[:, 0] - d[:, 0] * self._v[:, 1]) / np.maximum(far, 1e-3) ** 2
        near = (np.abs(far - radius_m) < _ON_M) & (rate > 1.0)
        if self._turning is not None:
            near &= ~(np.abs(rate - self._turning) > 2 * _STEADY * np.abs(self._turning))
        on, total, pushes = np.zeros(len(near), np.bool_), 0.0, 0
        edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(np.int8), [0]])))
        for first, last in edges.reshape(-1, 2):
            lasts = self._t_s[last - 1] - self._t_s[first]
            mean = float(rate[first:last].mean())
            if lasts * mean < _SHORTEST_RAD:
                continue
            steady = float(np.exp(-((rate[first:last].std() / mean / _STEADY) ** 2)))
            total += lasts * mean * steady
            if steady > 0.3:
                on[first:last] = True
                pushes += 1
        return total, on, pushes


def _circle(p: FloatArray) -> tuple[float, float, float] | None:
    """Centre and radius of the circle through points (M, 2) with the least algebraic distance (Kasa 1976)."""
    middle = p.mean(axis=0)
    q = p - middle
    solution, _, rank, _ = np.linalg.lstsq(np.column_stack([2 * q, np.ones(len(q))]), (q * q).sum(axis=1), rcond=1e-9)
    square = solution[2] + solution[0] ** 2 + solution[1] ** 2
    if rank < 3 or square <= 0:
        return None
    return float(solution[0] + middle[0]), float(solution[1] + middle[1]), float(np.sqrt(square))
