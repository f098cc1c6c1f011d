"""The focal length from footage that nobody calibrated: a part of the body that turns in depth has one length.

A sphere's picture gives its place across the line of sight whatever the focal length is, and its distance in proportion
to it. So the distance of two markers on one rigid part comes out the same in all attitudes for the true focal length
only. What is looked for is the factor k on the given camera's focal lengths under which the lengths of all pairs vary
least, each weighted by what its positions' covariances make of it. Noise alone makes k too small, for it lengthens what
points in depth; it is taken out by adding more of it and going back to none (SIMEX, Cook and Stefanski 1994). The
standard deviation is that of a bootstrap over stretches of time, as positions near in time err alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from spheremcap.core.camera import Camera

FloatArray = npt.NDArray[np.float64]

_WIDEST = 0.5, 2.0
"""Factors that are looked at."""
_MOST = 2400
"""Frames of a pair that are used, spread over the recording."""
_STRETCH_S = 0.5
_RESAMPLED = 40
_LARGEST_SD = 0.02
_RIGID = 0.03
"""How much a length may still vary, as a share, and be called one."""


@dataclass(frozen=True)
class Pair:
    """Two markers on one rigid part at N times (s): positions (N, 3) in the given camera's frame and covariances (N, 3,
    3), of frames on which both were measured; and their radii in metres."""

    name: str
    t_s: FloatArray
    first_m: FloatArray
    last_m: FloatArray
    first_m2: FloatArray
    last_m2: FloatArray
    radii_m: tuple[float, float]


@dataclass(frozen=True)
class Focal:
    """The factor on the given focal lengths, with its standard deviation, the pairs' lengths under it (m) and how much
    they still vary (share). `turned_deg` is through how many degrees the parts turned in depth."""

    factor: float
    sd: float
    lengths_m: tuple[float, ...]
    varies: tuple[float, ...]
    turned_deg: float
    refused: str = ""
    """Why it cannot be relied on; "" where it can."""


def focal_of(pairs: Sequence[Pair], camera: Camera) -> Focal:
    """The factor on a camera's focal lengths under which all pairs are rigid. Raises ValueError without any pair."""
    if not pairs:
        raise ValueError("no pair of markers was measured together")
    used = [_thinned(pair) for pair in pairs]
    rng = np.random.default_rng(0)
    table = _Table(used, camera)
    rough, _ = table.factor(table.places)
    plain, moved = table.factor(table.places, rough)
    noisier = [table.factor(table.noisy(rng), plain)[0] for _ in range(5)]
    factor = 2 * plain - float(np.mean(noisier))
    resampled = [table.least(moved, table.drawn(rng)) for _ in range(_RESAMPLED)]
    sd = float(np.std(resampled, ddof=1))
    lengths, varies, turned = table.lengths(factor)
    return Focal(factor, sd, lengths, varies, turned, _refusal(factor, sd, varies, turned))


def _refusal(factor: float, sd: float, varies: Sequence[float], turned_deg: float) -> str:
    if min(abs(factor - end) for end in _WIDEST) < 0.02 or sd > _LARGEST_SD:
        return (
            f"the markers' parts turn through {turned_deg:.0f} degrees in depth, and that tells the focal length to "
            f"{sd:.1%} only; at most {_LARGEST_SD:.0%} is expected: film a longer stretch in which the forearms point "
            "to the camera and across it, or film a board"
        )
    if max(varies) > _RIGID:
        return (
            f"the distance of the markers still varies by {max(varies):.1%} under the best focal length; at most "
            f"{_RIGID:.0%} is expected of one rigid part: a marker slips, or the two are on different parts"
        )
    return ""


def _thinned(pair: Pair) -> Pair:
    every = slice(None, None, max(1, len(pair.t_s) // _MOST))
    return replace(
        pair, t_s=pair.t_s[every], first_m=pair.first_m[every], last_m=pair.last_m[every],
        first_m2=pair.first_m2[every], last_m2=pair.last_m2[every],
    )  # fmt: skip


_Places = list[tuple[FloatArray, FloatArray]]


class _Table:
    """What does not change from factor to factor."""

    def __init__(self, pairs: Sequence[Pair], camera: Camera) -> None:
        self._pairs, self._camera = pairs, camera
        self.places: _Places = [(pair.first_m, pair.last_m) for pair in pairs]
        self._stretches = [np.unique(pair.t_s // _STRETCH_S, return_inverse=True)[1] for pair in pairs]

    def noisy(self, rng: np.random.Generator) -> _Places:
        """The places with as much noise again as they have."""
        found = []
        for pair in self._pairs:
            both = []
            for xyz, covariance in ((pair.first_m, pair.first_m2), (pair.last_m, pair.last_m2)):
                root = np.linalg.cholesky(covariance + 1e-12 * np.eye(3))
                both.append(xyz + (root @ rng.standard_normal((len(xyz), 3, 1)))[:, :, 0])
            found.append((both[0], both[1]))
        return found

    def drawn(self, rng: np.random.Generator) -> list[FloatArray]:
        """How often each frame counts when stretches are drawn anew."""
        counts = []
        for stretch in self._stretches:
            count = int(stretch.max()) + 1
            counts.append(np.bincount(rng.integers(0, count, count), minlength=count)[stretch].astype(np.float64))
        return counts

    def factor(self, places: _Places, near: float | None = None) -> tuple[float, "_Moved"]:
        """The factor under which the lengths vary least, of all or of those near one; and the places under some."""
        ends = _WIDEST if near is None else (near * 0.94, near * 1.06)
        grid = np.geomspace(*ends, 13 if near is None else 5)
        moved = _Moved(grid, [[_at_factor(xyz, r, self._camera, k) for k in grid] for xyz, r in self._spheres(places)])
        return self.least(moved), moved

    def least(self, moved: "_Moved", counts: Sequence[FloatArray] | None = None) -> float:
        """The factor under which the lengths vary least; `counts` (N,) of each pair is how often a frame counts."""

        def misfit(k: float) -> float:
            total = 0.0
            for number, pair in enumerate(self._pairs):
                length, variance = _lengths(pair, moved.at(2 * number, k), moved.at(2 * number + 1, k), k)
                weight = 1 / variance if counts is None else counts[number] / variance
                mean = float((weight * length).sum() / weight.sum())
                # As shares of the length: under a factor that shrinks all, all would vary less.
                total += float((weight * (length / mean - 1) ** 2).sum() * np.median(variance))
            return total

        coarse = [misfit(float(k)) for k in moved.grid]
        best = int(np.clip(np.argmin(coarse), 1, len(coarse) - 2))
        ends = moved.grid[best - 1], moved.grid[best + 1]
        return float(minimize_scalar(misfit, bounds=ends, method="bounded", options={"xatol": 1e-5}).x)

    def _spheres(self, places: _Places) -> list[tuple[FloatArray, float]]:
        return [
            (xyz, radius)
            for (first, last), pair in zip(places, self._pairs, strict=True)
            for xyz, radius in ((first, pair.radii_m[0]), (last, pair.radii_m[1]))
        ]

    def lengths(self, k: float) -> tuple[tuple[float, ...], tuple[float, ...], float]:
        """The pairs' median lengths, their robust spreads as shares, and how far they turn in depth, degrees."""
        medians, spreads, turned = [], [], []
        for pair in self._pairs:
            first, last = (
                _at_factor(xyz, r, self._camera, k)
                for xyz, r in ((pair.first_m, pair.radii_m[0]), (pair.last_m, pair.radii_m[1]))
            )
            length, variance = _lengths(pair, first, last, k)
            median = float(np.median(length))
            own = 1.4826 * float(np.median(np.abs(length - median)))
            medians.append(median)
            spreads.append(np.sqrt(max(0.0, own**2 - float(np.median(variance)))) / median)
            attitude = np.degrees(np.arcsin(np.clip(np.abs((last - first)[:, 2]) / length, 0, 1)))
            turned.append(float(np.percentile(attitude, 95) - np.percentile(attitude, 5)))
        return tuple(medians), tuple(spreads), max(turned)


def _lengths(pair: Pair, first: FloatArray, last: FloatArray, k: float) -> tuple[FloatArray, FloatArray]:
    """Lengths (N,) and their variances, of places under a factor."""
    d = last - first
    length = np.linalg.norm(d, axis=1)
    way = d / length[:, None]
    stretch = way * np.array([1.0, 1.0, k])  # depths' errors grow as the depths do
    variance = np.einsum("ni,nij,nj->n", stretch, pair.first_m2 + pair.last_m2, stretch)
    return length, np.maximum(variance, 1e-10)


@dataclass(frozen=True)
class _Moved:
    """Places under some factors: (N, 3) for each of `grid`, of each marker."""

    grid: FloatArray
    places: list[list[FloatArray]]

    def at(self, marker: int, k: float) -> FloatArray:
        """Under any factor, between the grid's on either side."""
        n = int(np.clip(np.searchsorted(self.grid, k), 1, len(self.grid) - 1))
        share = (k - self.grid[n - 1]) / (self.grid[n] - self.grid[n - 1])
        return self.places[marker][n - 1] * (1 - share) + self.places[marker][n] * share


def _at_factor(xyz_cam_m: FloatArray, radius_m: float, camera: Camera, k: float) -> FloatArray:
    """Where spheres (N, 3) of a radius that one camera sees would be, were its focal lengths k times as long.

    A sphere's ellipse has the centre c = (X, Y) Z / (Z^2 - R^2) and the area pi s in normalised coordinates, with
    u^3 + (1 + |c|^2) u^2 - s^2 u - s^2 = 0 for u = R^2 / (Z^2 - R^2) (Penne, Ribbens and Roios 2019). The same pixels
    have other normalised coordinates with the other camera, and so has an area.
    """
    z2 = xyz_cam_m[:, 2] ** 2 - radius_m**2
    centre = xyz_cam_m[:, :2] * (xyz_cam_m[:, 2] / z2)[:, None]
    u = radius_m**2 / z2
    far = (centre**2).sum(axis=1)
    area = u * np.sqrt((u + 1 + far) / (u + 1))
    pixels = camera.project(np.column_stack([centre, np.ones(len(centre))]))
    other = replace(camera, fx_px=camera.fx_px * k, fy_px=camera.fy_px * k)
    moved = other.normalise(pixels)
    area = area * _grown(other, pixels) / _grown(camera, pixels)
    far = (moved**2).sum(axis=1)
    for _ in range(30):  # Newton's steps from the value for small spheres
        f = u**3 + (1 + far) * u**2 - area**2 * (u + 1)
        u = np.maximum(u - f / (3 * u**2 + 2 * (1 + far) * u - area**2), 1e-12)
    z = radius_m * np.sqrt(1 + 1 / u)
    xy = moved * ((z**2 - radius_m**2) / z)[:, None]
    return np.column_stack([xy, z])


def _grown(camera: Camera, pixels: FloatArray) -> FloatArray:
    """The area of a pixel in normalised coordinates, (N,)."""
    h = 0.5
    right, down = np.array([h, 0.0]), np.array([0.0, h])
    dx = camera.normalise(pixels + right) - camera.normalise(pixels - right)
    dy = camera.normalise(pixels + down) - camera.normalise(pixels - down)
    out: FloatArray = np.abs(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0])
    return out
