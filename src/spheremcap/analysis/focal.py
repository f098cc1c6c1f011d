"""The focal length from footage that nobody calibrated: a part of the body that turns in depth has one length.

A sphere's picture gives its place across the line of sight whatever the focal length is, and its distance in proportion
to it. So the distance of two markers on one rigid part comes out the same in all attitudes for the true focal length
only. What is looked for is the factor k on the given camera's focal lengths under which a pair's length varies least,
each weighted by what its positions' covariances make of it. Noise alone makes k too small, for it lengthens what
points in depth; it is taken out by adding more of it and going back to none (SIMEX, Cook and Stefanski 1994). The
standard deviation is that of a bootstrap over stretches of time, as positions near in time err alike; of several pairs
also that of their differences.
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
    told = [_alone(pair, camera) for pair in used]
    factor, sd = _together(np.array([factor for factor, _ in told]), np.array([sd for _, sd in told]))
    lengths, varies, turned = zip(*(_Table(pair, camera).length(factor) for pair in used), strict=True)
    return Focal(factor, sd, lengths, varies, max(turned), _refusal(factor, sd, varies, max(turned)))


def _alone(pair: Pair, camera: Camera) -> tuple[float, float]:
    """What one pair says of the factor, and its standard deviation."""
    rng, table = np.random.default_rng(0), _Table(pair, camera)
    rough, _ = table.factor(table.places)
    plain, moved = table.factor(table.places, rough)
    noisier = [table.factor(table.noisy(rng), plain)[0] for _ in range(5)]
    resampled = [table.least(moved, table.drawn(rng)) for _ in range(_RESAMPLED)]
    return 2 * plain - float(np.mean(noisier)), float(np.std(resampled, ddof=1))


def _together(factors: FloatArray, sds: FloatArray) -> tuple[float, float]:
    """One factor from several: what a pair errs by beside its own scatter (light, a strap that slips) is as large as
    makes them agree (DerSimonian and Laird 1986)."""
    weight = 1 / sds**2
    mean = float((weight * factors).sum() / weight.sum())
    spread = float((weight * (factors - mean) ** 2).sum()) - (len(factors) - 1)
    between = max(0.0, spread / (weight.sum() - (weight**2).sum() / weight.sum())) if len(factors) > 1 else 0.0
    weight = 1 / (sds**2 + between)
    return float((weight * factors).sum() / weight.sum()), float(1 / np.sqrt(weight.sum()))


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


_Places = tuple[FloatArray, FloatArray]


class _Table:
    """A pair, and what does not change from factor to factor."""

    def __init__(self, pair: Pair, camera: Camera) -> None:
        self._pair, self._camera = pair, camera
        self.places: _Places = (pair.first_m, pair.last_m)
        self._stretch = np.unique(pair.t_s // _STRETCH_S, return_inverse=True)[1]

    def noisy(self, rng: np.random.Generator) -> _Places:
        """The places with as much noise again as they have."""
        both = []
        for xyz, covariance in zip(self.places, (self._pair.first_m2, self._pair.last_m2), strict=True):
            root = np.linalg.cholesky(covariance + 1e-12 * np.eye(3))
            both.append(xyz + (root @ rng.standard_normal((len(xyz), 3, 1)))[:, :, 0])
        return both[0], both[1]

    def drawn(self, rng: np.random.Generator) -> FloatArray:
        """How often each frame counts when stretches are drawn anew, (N,)."""
        count = int(self._stretch.max()) + 1
        drawn = np.bincount(rng.integers(0, count, count), minlength=count)
        out: FloatArray = drawn[self._stretch].astype(np.float64)
        return out

    def factor(self, places: _Places, near: float | None = None) -> tuple[float, "_Moved"]:
        """The factor under which the length varies least, of all or of those near one; and the places under some."""
        ends = _WIDEST if near is None else (near * 0.94, near * 1.06)
        grid = np.geomspace(*ends, 13 if near is None else 5)
        moved = _Moved(grid, [self._at(places, float(k)) for k in grid])
        return self.least(moved), moved

    def least(self, moved: "_Moved", counts: FloatArray | None = None) -> float:
        """The factor under which the length varies least; `counts` (N,) is how often a frame counts."""

        def misfit(k: float) -> float:
            length, variance = _lengths(self._pair, *moved.at(k), k)
            weight = (1.0 if counts is None else counts) / variance
            mean = float((weight * length).sum() / weight.sum())
            # As a share of the length: under a factor that shrinks all, all would vary less.
            return float((weight * (length / mean - 1) ** 2).sum() * np.median(variance))

        coarse = [misfit(float(k)) for k in moved.grid]
        best = int(np.clip(np.argmin(coarse), 1, len(coarse) - 2))
        ends = moved.grid[best - 1], moved.grid[best + 1]
        return float(minimize_scalar(misfit, bounds=ends, method="bounded", options={"xatol": 1e-5}).x)

    def length(self, k: float) -> tuple[float, float, float]:
        """The median length under a factor, its robust spread beside the noise as a share, and how far the part turns
        in depth, degrees."""
        first, last = self._at(self.places, k)
        length, variance = _lengths(self._pair, first, last, k)
        median = float(np.median(length))
        own = 1.4826 * float(np.median(np.abs(length - median)))
        attitude = np.degrees(np.arcsin(np.clip(np.abs((last - first)[:, 2]) / length, 0, 1)))
        return (
            median, float(np.sqrt(max(0.0, own**2 - float(np.median(variance))))) / median,
            float(np.percentile(attitude, 95) - np.percentile(attitude, 5)),
        )  # fmt: skip

    def _at(self, places: _Places, k: float) -> _Places:
        first, last = (_at_factor(xyz, r, self._camera, k) for xyz, r in zip(places, self._pair.radii_m, strict=True))
        return first, last


@dataclass(frozen=True)
class _Moved:
    """Both markers' places under some factors, `grid`."""

    grid: FloatArray
    places: list[_Places]

    def at(self, k: float) -> _Places:
        """Under any factor, between the grid's on either side."""
        n = int(np.clip(np.searchsorted(self.grid, k), 1, len(self.grid) - 1))
        share = (k - self.grid[n - 1]) / (self.grid[n] - self.grid[n - 1])
        (a, b), (c, d) = self.places[n - 1], self.places[n]
        return a * (1 - share) + c * share, b * (1 - share) + d * share


def _lengths(pair: Pair, first: FloatArray, last: FloatArray, k: float) -> tuple[FloatArray, FloatArray]:
    """Lengths (N,) and their variances, of places under a factor."""
    d = last - first
    length = np.linalg.norm(d, axis=1)
    way = d / length[:, None]
    stretch = way * np.array([1.0, 1.0, k])  # depths' errors grow as the depths do
    variance = np.einsum("ni,nij,nj->n", stretch, pair.first_m2 + pair.last_m2, stretch)
    return length, np.maximum(variance, 1e-10)


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
