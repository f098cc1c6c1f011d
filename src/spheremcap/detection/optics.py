"""What a camera's shutter and lens are, learnt from the settled outlines of all its markers.

Only claims that were accepted teach anything, and what they teach is used only when the evidence for it is beyond
doubt: a learnt parameter that is wrong does more harm than one that is left out.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from spheremcap.core.compiled import F8, I8, array, inner, kernel
from spheremcap.core.linear import inverse3
from spheremcap.core.look import Measured
from spheremcap.core.optics import Optics, bounded_blur

FloatArray = npt.NDArray[np.float64]
Misfits = Callable[[FloatArray, Sequence[float], Sequence[float]], FloatArray | None]
"""How badly softnesses and exposures explain the profiles across a claim's outline (`Outline.misfits`)."""

EXPOSURES = (0.0, 0.15, 0.3, 0.5, 0.75, 1.0)
"""Exposure times that are tried, in frame intervals."""
LENSES = (1.0, 1.3, 1.6, 2.0, 2.4, 3.0, 3.6)
"""Softnesses that are tried with each of them, in units of the settings' `blur_sigma_px`."""
BLUR_SHOWS_PX = 5.0  # motion in a frame interval from which blur can be told
_CLEAR = 0.6  # share of the outline that a claim has to show to teach anything
_BEYOND_DOUBT = 7.0  # standard deviations: what shading makes of an outline has reached six on a global shutter
_LOOKS = 12  # as many looks are taken closely together; later ones are few
_OFTEN, _SELDOM = 12, 64  # after so many claims of a moving marker a look is taken: first, and later
_SOFT = 0.3  # how unlikely a soft lens is: added to the misfit, times the squared logarithm of its softness
_LATEST = 24  # so many looks are remembered
_SLOW_LOOKS = (3, 8, 24, 72, 216, 648)  # after so many clear claims a look is taken whether it moves or not
_SHARED = 16.0  # claims that share an error: neighbours in time
_LEAST_CLAIMS = 60  # for a regression to be believed
_WORST_CONDITION = 1e6  # of its normal equations


class OpticsLearner:
    """One camera's optics as far as they are given or known by now; `learn` is called in the order of settling."""

    def __init__(self, exposure_s: float, readout_s: float | None, learn_blur: bool, rows: int) -> None:
        """`exposure_s` 0 and `readout_s` None are not known; `learn_blur` False leaves the lens as the settings say;
        `rows` is the picture's height in pixels."""
        self.rows = rows
        self._given_exposure_s, self._given_readout_s = exposure_s, readout_s
        self._lenses = LENSES if learn_blur else (1.0,)
        self._contest: _Contest | None = None  # of softness and exposure
        self._moving = self._clear = 0
        self._seed_softness = 1.0
        self._stretch: dict[str, _Stretch] = {}
        self._readout: tuple[float, float] | None = None
        self._best: tuple[float, float] | None = None  # as `_likeliest` had it; None when that may have changed

    def now(self, interval_s: float) -> Optics:
        """The optics for frames that are `interval_s` apart."""
        exposure, softness = self._likeliest()
        return Optics(self._given_exposure_s or exposure * interval_s, *self._readout_s(interval_s), softness)

    def _likeliest(self) -> tuple[float, float]:
        """Exposure, in intervals, and softness."""
        if self._best is None:
            self._best = (0.0, self._seed_softness) if self._contest is None else self._contest.best()
        return self._best

    def _readout_s(self, interval_s: float) -> tuple[float, float]:
        """The readout time and its standard deviation, seconds: zero until the evidence is beyond doubt."""
        if self._given_readout_s is not None:
            return self._given_readout_s, 0.0
        if self._readout is None:
            return 0.0, interval_s / 3**0.5
        found, sd = self._readout
        if abs(found) > _BEYOND_DOUBT * sd and abs(found) <= 1.2 * interval_s:
            return found, sd
        return 0.0, min(math.hypot(found, sd), interval_s / 3**0.5)

    def seeded(self, claim: Measured) -> None:
        """A seed's outline says how soft the lens is until settled claims say more."""
        if self._contest is None and claim.visible > _CLEAR:
            self._seed_softness, self._best = claim.motion.softness, None

    def learn(self, marker: str, claim: Measured, rate_px: FloatArray, interval_s: float, misfits: Misfits) -> None:
        """Learn from a marker's accepted claim; it moves at `rate_px` (2,), px/s, in frames `interval_s` apart."""
        if claim.visible < _CLEAR:
            return
        self._clear += 1
        way_px = rate_px * interval_s
        due = self._clear in _SLOW_LOOKS
        if math.hypot(way_px[0], way_px[1]) > BLUR_SHOWS_PX:
            self._moving += 1
            every = _OFTEN if self._moving <= _OFTEN * _LOOKS else _SELDOM
            due = due or self._moving <= 3 or self._moving % every == 0
        if due and math.hypot(*bounded_blur(way_px, claim.circle)) >= math.hypot(*way_px):
            given = self._given_exposure_s / interval_s
            exposures = (given,) if given > 0 else EXPOSURES
            found = misfits(way_px, self._lenses, exposures)
            if found is not None:
                self._contest = self._contest or _Contest(self._lenses, exposures)
                self._contest.add(found)
                self._best = None
        if self._given_readout_s is None and claim.proposer == "prediction":
            own = self._stretch.setdefault(marker, _Stretch())
            own.add(claim, rate_px / max(1, self.rows - 1))
            if own.claims >= _LEAST_CLAIMS and own.claims % 8 == 0:
                own.regress()
                self._readout = _pooled(self._stretch.values())


class _Contest:
    """Which softness and exposure explain outlines best together, over the latest looks."""

    def __init__(self, softnesses: Sequence[float], exposures: Sequence[float]) -> None:
        self._softnesses, self._exposures = softnesses, exposures
        self._misfits: deque[FloatArray] = deque(maxlen=_LATEST)

    def add(self, misfits: FloatArray) -> None:
        """Take in one look's `Outline.misfits`."""
        self._misfits.append(misfits)

    def best(self) -> tuple[float, float]:
        """The exposure and the softness that are likeliest; no exposure unless one is better by more than the looks, of
        which there are three at least, disagree, and leaves less than any softness alone."""
        looks = np.stack(self._misfits)
        plain = looks.mean(axis=0)
        looks = looks + _SOFT * np.log(self._softnesses)[:, None] ** 2
        mean = looks.mean(axis=0)
        i, j = np.unravel_index(int(mean.argmin()), mean.shape)
        still = int(mean[:, 0].argmin())
        gain = looks[:, still, 0] - looks[:, i, j]
        sure = len(looks) >= 3 and gain.mean() > 2 * gain.std() / len(looks) ** 0.5
        if not sure or plain[i, j] >= plain[:, 0].min():
            return self._exposures[0], self._softnesses[still]
        return _lowest(self._exposures, mean[i], int(j)), self._softnesses[int(i)]


def _lowest(values: Sequence[float], misfit: FloatArray, k: int) -> float:
    """Where the parabola through the lowest, k-th, of the misfits and its neighbours is lowest."""
    if not 0 < k < len(values) - 1:
        return values[k]
    (x0, x1, x2), (y0, y1, y2) = values[k - 1 : k + 2], misfit[k - 1 : k + 2].tolist()
    fall, rise = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    bend = (rise - fall) / (x2 - x0)
    vertex = (x0 + x1) / 2 - fall / (2 * bend) if bend > 0 else x1
    return float(np.clip(vertex, (x0 + x1) / 2, (x1 + x2) / 2))


@dataclass
class _Stretch:
    """How one marker's outline is stretched and sheared, against its speed: least squares of c0 + c1 |v| + readout v
    for each of the two, so that neither uneven light nor a streak of the wrong length passes for a rolling shutter."""

    claims: int = 0
    sums: FloatArray = field(default_factory=lambda: np.zeros((2, 4, 4)))
    readouts: list[tuple[float, float]] = field(default_factory=list)
    """What stretch and shear said when last regressed, where they could tell: seconds, and the variance."""

    def add(self, claim: Measured, rate_rows: FloatArray) -> None:
        """`rate_rows` (2,) is the speed in pixels a second and row."""
        self.claims += 1
        _add_stretch(
            claim.edges.points_px, claim.edges_outside_px, claim.edge_weights, claim.circle.x_px, claim.circle.y_px,
            claim.motion.lean, rate_rows, self.sums,
        )  # fmt: skip

    def regress(self) -> None:
        both = [_readout_of(sums, self.claims) for sums in self.sums]
        self.readouts = [(found, variance) for found, variance in both if math.isfinite(variance)]


def _pooled(markers: Iterable[_Stretch]) -> tuple[float, float] | None:
    """The readout time that all markers agree on and its standard deviation, seconds; None until they can tell."""
    like = power = 0.0
    for one in markers:
        for found, variance in one.readouts:
            like += found / variance
            power += 1 / variance
    return None if power == 0 else (like / power, power**-0.5)


@kernel(None, array(F8, 2), I8)
def _readout_of(sums, claims):
    """The last of three unknowns of normal equations (4, 4), and its variance; infinite when they cannot tell."""
    scale, flat, inverse, found = np.empty(3), np.empty((3, 3)), np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        scale[i] = math.sqrt(max(sums[i, i], 1e-30))
    spread = 0.0
    for i in range(3):
        for j in range(3):
            flat[i, j] = sums[i, j] / (scale[i] * scale[j])
            spread += flat[i, j] * flat[i, j]
    if inverse3(flat, inverse) <= 0.0:
        return 0.0, np.inf
    back = 0.0
    for i in range(3):
        for j in range(3):
            back += inverse[i, j] * inverse[i, j]
            found[i] += inverse[i, j] / (scale[i] * scale[j]) * sums[j, 3]
    if not math.sqrt(spread * back) < _WORST_CONDITION:
        return 0.0, np.inf
    left_over = sums[3, 3]
    for i in range(3):
        left_over -= sums[i, 3] * found[i]
    left_over = max(left_over, 0.0) / (claims - 3)
    return found[2], _SHARED * left_over * inverse[2, 2] / (scale[2] * scale[2]) + 1e-16


@inner
def stretch_and_shear(points, outside, weights, x, y):
    """How an outline about (x, y) is stretched and sheared by rows, and the weight of each: (stretch, weight, shear,
    weight). Its edge points (N, 2), pixels, lie `outside` (N,) of the fitted outline.

    A row that is late by a pixel a row moves a point by (shear, stretch) for each row; what a sphere's place and size
    explain is taken out first.
    """
    count = len(points)
    basis = np.empty((5, count))  # size, x, y, stretch, shear
    for k in range(count):
        off_x, off_y = points[k, 0] - x, points[k, 1] - y
        length = math.sqrt(off_x * off_x + off_y * off_y)
        root = math.sqrt(weights[k])
        basis[0, k], basis[1, k], basis[2, k] = root, root * off_x / length, root * off_y / length
        basis[3, k], basis[4, k] = basis[2, k] * off_y, basis[1, k] * off_y
    for a in range(5):  # Gram-Schmidt; stretch and shear keep their lengths, and what they share
        for b in range(min(a, 3)):
            both = 0.0
            for k in range(count):
                both += basis[a, k] * basis[b, k]
            for k in range(count):
                basis[a, k] -= both * basis[b, k]
        if a < 3:
            power = 1e-30
            for k in range(count):
                power += basis[a, k] * basis[a, k]
            for k in range(count):
                basis[a, k] /= math.sqrt(power)
    amounts = np.empty(4)
    for a in range(2):
        like, power = 0.0, 1e-12
        for k in range(count):
            like += basis[3 + a, k] * math.sqrt(weights[k]) * outside[k]
            power += basis[3 + a, k] * basis[3 + a, k]
        amounts[2 * a], amounts[2 * a + 1] = like / power, power
    return amounts[0], amounts[1], amounts[2], amounts[3]


@kernel(None, array(F8, 2), array(F8, 1), array(F8, 1), F8, F8, array(F8, 1), array(F8, 1), F8[:, :, ::1])
def _add_stretch(points, outside, weights, x, y, lean, rate_rows, sums):
    """Add a claim to the normal equations (2, 4, 4) of stretch and shear: columns 1, |v|, v and the amount seen."""
    stretch, stretch_weight, shear, shear_weight = stretch_and_shear(points, outside, weights, x, y)
    row = np.empty(4)
    for k in range(2):
        rate = rate_rows[1 - k]
        row[0], row[1], row[2] = 1.0, abs(rate), rate
        row[3] = (stretch if k == 0 else shear) + lean[1 - k]
        weight = stretch_weight if k == 0 else shear_weight
        for i in range(4):
            for j in range(4):
                sums[k, i, j] += weight * row[i] * row[j]
