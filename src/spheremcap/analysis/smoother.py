"""Position, velocity, acceleration and jerk of one marker from its measured positions, with covariances.

The model is a jerk that wanders: per axis the state (p, v, a, j), driven by white snap of spectral density q; the
three axes are tied together by each measurement's covariance. A Kalman filter goes forward, a Rauch-Tung-Striebel
smoother (1965) backward, so every estimate rests on the measurements before and after it and nothing is differenced. q,
and by how much the measurements are noisier than they say, are those under which the marker's own measurements are the
likeliest. What they scatter by less than they say errs slowly (light, blur, what is behind the marker): smoothing does
not take it away, and the covariances have it.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.compiled import F8, array, inner, kernel

FloatArray = npt.NDArray[np.float64]

_LAP = 160
"""Samples on either side of those that are asked for: what is farther away says nothing of them."""
_DENSITIES = np.geomspace(1e4, 1e13, 10)
_NOISES = np.array([0.25, 0.5, 1.0, 2.0, 4.0])
_SLOW_S = 1.0, 0.045, 0.013, 0.008
"""How long what errs in a position and does not differ from frame to frame takes to come and go, as velocity,
acceleration and jerk see it: it has corners, so the higher ones see shorter times."""
_LEARN = 2400
"""Samples from which density and noise are learnt."""
_UNIT_S = 1 / 200
"""What the filter counts time in, so that a state's numbers are of like size and nothing is lost in their sums."""
_PER_UNIT = _UNIT_S ** np.arange(4.0)
_START_SD = np.array([1.0, 10.0, 300.0, 2e4]) * _PER_UNIT
"""Standard deviations before anything is known: 1 m, 10 m/s, 300 m/s^2, 20,000 m/s^3."""
_FEWEST = 4
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""The elements that a symmetric 3 x 3 matrix is told by, in the order of packed ones."""


@dataclass(frozen=True)
class JointTrack:
    """A marker over N frames, in the chair's frame, or the camera's where there is no chair.

    `stamp_s` (N,) are the frames' times and `t_s` (N,) when the marker was seen on each, both rising, from a common
    start. `xyz_m` (N, 3) is where it was measured, NaN where it was not, `packed` (N, 6) the covariance (xx, xy, xz,
    yy, yz, zz), both float32.
    """

    marker: str
    stamp_s: FloatArray
    t_s: FloatArray
    xyz_m: npt.NDArray[np.float32]
    packed: npt.NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """(N,) where there is a position."""
        return np.isfinite(self.xyz_m[:, 0])

    def covariance(self, part: slice = slice(None)) -> FloatArray:
        """(M, 3, 3) of a part's positions, m^2."""
        return unpacked(self.packed[part])


def unpacked(packed: npt.NDArray[np.float32]) -> FloatArray:
    """Symmetric matrices (M, 3, 3) of their elements (M, 6) as in `PAIRS`."""
    out = np.empty((len(packed), 3, 3))
    for k, (i, j) in enumerate(PAIRS):
        out[:, i, j] = out[:, j, i] = packed[:, k]
    return out


@dataclass(frozen=True)
class Motion:
    """A marker's motion on M frames: (M, 3) each, metres and seconds, and the covariances (M, 3, 3) of each."""

    xyz_m: FloatArray
    velocity_mps: FloatArray
    acceleration_mps2: FloatArray
    jerk_mps3: FloatArray
    xyz_m2: FloatArray
    velocity_cov: FloatArray
    acceleration_cov: FloatArray
    jerk_cov: FloatArray


class Smoother:
    """The motion of a track, worked out where it is asked for.

    `density` is q in m^2/s^7, `noise` the factor on the measurements' stated standard deviations. Raises ValueError
    where fewer than four positions are measured.
    """

    def __init__(self, track: JointTrack) -> None:
        self.track = track
        if track.measured.sum() < _FEWEST:
            raise ValueError(f"{track.marker}: {int(track.measured.sum())} measured positions are too few")
        self._first = int(np.argmax(track.measured))
        self.density, self.noise = self._learnt()

    def motion(self, part: slice) -> Motion:
        """The motion at the stamps of some frames."""
        low, high = max(0, part.start - _LAP), min(len(self.track), part.stop + _LAP)
        t, xyz, whiten, seen = self._given(slice(low, high))
        moved = (self.track.stamp_s[low:high] - self.track.t_s[low:high]) / _UNIT_S
        states, spreads = _smooth(t, xyz, whiten / self.noise, seen, self.density * _UNIT_S**7, moved, _START_SD)
        own = slice(part.start - low, part.stop - low)
        states, spreads = states[own], spreads[own]
        full = np.empty((4, len(states), 3, 3))
        for k, (i, j) in enumerate(PAIRS):
            for order in range(4):
                full[order, :, i, j] = full[order, :, j, i] = spreads[:, 6 * order + k] / _PER_UNIT[order] ** 2
        slow = self._slow(part)
        for order in range(4):
            full[order] += slow / _SLOW_S[order] ** (2 * order)
        position, velocity, acceleration, jerk = (states[:, 3 * k : 3 * k + 3] / _PER_UNIT[k] for k in range(4))
        return Motion(position, velocity, acceleration, jerk, full[0], full[1], full[2], full[3])

    def _slow(self, part: slice) -> FloatArray:
        """What of the positions' covariances does not differ from frame to frame, and so is not smoothed away, (M, 3,
        3); where nothing is measured, that of the measured frame before."""
        index = np.where(self.track.measured[part], np.arange(part.start, part.stop), self._first)
        packed = self.track.packed[np.maximum.accumulate(index)]
        return max(0.0, 1 - self.noise**2) * unpacked(packed)

    def _given(self, part: slice) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Times in units, positions, what whitens them and whether they are there, of a part."""
        track = self.track
        seen = track.measured[part]
        whiten = _whitened(track.covariance(part), seen)
        t = np.ascontiguousarray(track.t_s[part] - track.t_s[part.start]) / _UNIT_S
        return t, np.ascontiguousarray(track.xyz_m[part], np.float64), whiten, seen.astype(np.float64)

    def _learnt(self) -> tuple[float, float]:
        """q and noise that make the best measured stretch of `_LEARN` samples the likeliest."""
        counts = np.concatenate([[0], np.cumsum(self.track.measured)])
        length = min(_LEARN, len(self.track))
        first = int(np.argmax(counts[length:] - counts[:-length]))
        t, xyz, whiten, seen = self._given(slice(first, first + length))
        found = np.array(
            [
                [_likelihood(t, xyz, whiten / noise, seen, density * _UNIT_S**7, _START_SD) for noise in _NOISES]
                for density in _DENSITIES
            ]
        )
        # Between the points of the grid, a parabola in the logarithms
        i, j = np.unravel_index(int(found.argmax()), found.shape)
        return (
            float(np.exp(_peak(np.log(_DENSITIES), found[:, j], int(i)))),
            float(np.exp(_peak(np.log(_NOISES), found[i], int(j)))),
        )


def _whitened(covariance_m2: FloatArray, seen: npt.NDArray[np.bool_]) -> FloatArray:
    """(N, 3, 3) lower matrices W with W C W' = 1: what a measurement is multiplied by to have independent parts."""
    filled = np.where(seen[:, None, None], covariance_m2, np.eye(3))
    filled = filled + 1e-12 * np.eye(3)
    return np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(filled)))


def _peak(x: FloatArray, y: FloatArray, k: int) -> float:
    """Where the parabola through the three points about the largest one has its top."""
    if k in (0, len(x) - 1):
        return float(x[k])
    left, right = y[k] - y[k - 1], y[k] - y[k + 1]
    return float(x[k] + (x[k + 1] - x[k]) / 2 * (left - right) / (left + right)) if left + right > 0 else float(x[k])


_LINE, _TABLE, _STACK = array(F8, 1), array(F8, 2), array(F8, 3)


@inner
def _predict(x, p, dt, q):
    """State (12,), ordered p, v, a, j of three axes each, and covariance (12, 12) after `dt`, in place."""
    d2, d3 = dt * dt / 2.0, dt * dt * dt / 6.0
    for k in range(3):
        x[k] += dt * x[3 + k] + d2 * x[6 + k] + d3 * x[9 + k]
        x[3 + k] += dt * x[6 + k] + d2 * x[9 + k]
        x[6 + k] += dt * x[9 + k]
    for j in range(12):
        for k in range(3):
            p[k, j] += dt * p[3 + k, j] + d2 * p[6 + k, j] + d3 * p[9 + k, j]
            p[3 + k, j] += dt * p[6 + k, j] + d2 * p[9 + k, j]
            p[6 + k, j] += dt * p[9 + k, j]
    for j in range(12):
        for k in range(3):
            p[j, k] += dt * p[j, 3 + k] + d2 * p[j, 6 + k] + d3 * p[j, 9 + k]
            p[j, 3 + k] += dt * p[j, 6 + k] + d2 * p[j, 9 + k]
            p[j, 6 + k] += dt * p[j, 9 + k]
    factorial = (6.0, 2.0, 1.0, 1.0)  # of 3, 2, 1, 0: what is integrated how often
    for m in range(4):
        for n in range(4):
            power = 7 - m - n
            grown = q * dt**power / (power * factorial[m] * factorial[n])
            for k in range(3):
                p[3 * m + k, 3 * n + k] += grown
    for i in range(12):
        for j in range(i):
            p[i, j] = p[j, i]


@inner
def _update(x, p, z, w, gain, k):
    """Takes in component k of a whitened measurement; returns innovation and variance, and K in `gain` (12,)."""
    y, s = 0.0, 1.0
    for j in range(k + 1):
        y += w[k, j] * (z[j] - x[j])
    for i in range(12):
        g = 0.0
        for j in range(k + 1):
            g += p[i, j] * w[k, j]
        gain[i] = g
    for j in range(k + 1):
        s += w[k, j] * gain[j]
    for i in range(12):
        for j in range(12):
            p[i, j] -= gain[i] * gain[j] / s
    for i in range(12):
        gain[i] /= s
        x[i] += gain[i] * y
    return y, s


@inner
def _begin(x, p, z, start):
    """At a measured place with nothing known of its motion, in place."""
    for i in range(12):
        x[i] = z[i] if i < 3 else 0.0
        for j in range(12):
            p[i, j] = 0.0
        p[i, i] = start[i // 3] ** 2


@kernel(F8, _LINE, _TABLE, _STACK, _LINE, F8, _LINE, at_import=False)
def _likelihood(t, xyz_m, whiten, seen, q, start):
    """The logarithm of the likelihood of the measurements, up to a constant."""
    x, p, gain = np.zeros(12), np.zeros((12, 12)), np.zeros(12)
    total, begun, last = 0.0, False, 0.0
    for n in range(len(t)):
        if seen[n] == 0.0:
            continue
        if not begun:
            _begin(x, p, xyz_m[n], start)
            begun = True
        else:
            _predict(x, p, t[n] - last, q)
        last = t[n]
        for k in range(3):
            y, s = _update(x, p, xyz_m[n], whiten[n], gain, k)
            total -= 0.5 * (y * y / s + math.log(s)) - math.log(whiten[n, k, k])
    return total


@inner
def _gain(p, ahead, dt, root, g):
    """The smoother's gain p F' ahead^-1 into `g` (12, 12), by Cholesky's root of `ahead`."""
    for i in range(12):
        for j in range(i + 1):
            total = ahead[i, j]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            root[i, j] = math.sqrt(max(total, 1e-30)) if i == j else total / root[j, j]
    d2, d3 = dt * dt / 2.0, dt * dt * dt / 6.0
    for i in range(12):
        for k in range(3):
            g[i, k] = p[i, k] + dt * p[i, 3 + k] + d2 * p[i, 6 + k] + d3 * p[i, 9 + k]
            g[i, 3 + k] = p[i, 3 + k] + dt * p[i, 6 + k] + d2 * p[i, 9 + k]
            g[i, 6 + k] = p[i, 6 + k] + dt * p[i, 9 + k]
            g[i, 9 + k] = p[i, 9 + k]
        for j in range(12):
            for k in range(j):
                g[i, j] -= root[j, k] * g[i, k]
            g[i, j] /= root[j, j]
        for j in range(11, -1, -1):
            for k in range(j + 1, 12):
                g[i, j] -= root[k, j] * g[i, k]
            g[i, j] /= root[j, j]


@kernel(None, _LINE, _TABLE, _STACK, _LINE, F8, _LINE, _LINE, at_import=False)
def _smooth(t, xyz_m, whiten, seen, q, moved, start):
    """Smoothed states (N, 12) at `t` + `moved`, and the upper triangles of the four 3 x 3 blocks of the covariance
    on its diagonal (N, 24)."""
    count = len(t)
    xs, ps, gain = np.zeros((count, 12)), np.zeros((count, 12, 12)), np.zeros(12)
    x, p = np.zeros(12), np.zeros((12, 12))
    first = 0
    while first < count - 1 and seen[first] == 0.0:
        first += 1
    if seen[first] == 0.0:
        return np.full((count, 12), np.nan), np.full((count, 24), np.nan)
    _begin(x, p, xyz_m[first], start)  # as wide as can be: what comes later says where it was before, too
    for n in range(count):
        if n > 0:
            _predict(x, p, t[n] - t[n - 1], q)
        if seen[n] != 0.0:
            for k in range(3):
                _update(x, p, xyz_m[n], whiten[n], gain, k)
        xs[n], ps[n] = x, p
    ahead, root, g, work = np.zeros((12, 12)), np.zeros((12, 12)), np.zeros((12, 12)), np.zeros((12, 12))
    predicted, moved_to = np.zeros(12), np.zeros(12)
    out, spread = np.zeros((count, 12)), np.zeros((count, 24))
    for n in range(count - 1, -1, -1):
        if n < count - 1:  # x and p are the smoothed ones of n + 1
            dt = t[n + 1] - t[n]
            ahead[:], predicted[:] = ps[n], xs[n]
            _predict(predicted, ahead, dt, q)
            _gain(ps[n], ahead, dt, root, g)
            for i in range(12):
                moved_to[i] = x[i] - predicted[i]
            for i in range(12):
                x[i] = xs[n, i]
                for j in range(12):
                    x[i] += g[i, j] * moved_to[j]
            for i in range(12):
                for j in range(12):
                    total = 0.0
                    for k in range(12):
                        total += g[i, k] * (p[k, j] - ahead[k, j])
                    work[i, j] = total
            for i in range(12):
                for j in range(i, 12):
                    total = ps[n, i, j]
                    for k in range(12):
                        total += work[i, k] * g[j, k]
                    p[i, j] = p[j, i] = total
        d = moved[n]
        for k in range(3):
            out[n, k] = x[k] + d * x[3 + k] + d * d / 2.0 * x[6 + k] + d * d * d / 6.0 * x[9 + k]
            out[n, 3 + k] = x[3 + k] + d * x[6 + k] + d * d / 2.0 * x[9 + k]
            out[n, 6 + k] = x[6 + k] + d * x[9 + k]
            out[n, 9 + k] = x[9 + k]
        place = 0
        for i in range(3):
            for j in range(i, 3):
                for block in range(4):
                    spread[n, 6 * block + place] = p[3 * block + i, 3 * block + j]
                place += 1
    return out, spread
