"""The instants at which a hand takes hold of the rim and lets it go, from the wrist's path about the axle.

While a hand is on the rim its wrist goes round with it; off the rim it goes on its own. Contact is where the one path
turns into the other: its velocity changes within a few milliseconds. At release nothing pushes the hand, so its
velocity goes on, and its acceleration is new. Either is fitted to the measured positions of some hundredths of a second
around it, radius and arc together, weighted by their covariances, with the instant as an unknown between the frames (a
segmented regression, Hinkley 1971); how much worse other instants fit gives its standard deviation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from spheremcap.core.stroke import EventKind

FloatArray = npt.NDArray[np.float64]

_REACH_S = 0.055
"""How far from the instant positions are taken in."""
_SEARCH_S = 0.014
"""How far from the first guess it is looked for."""
_COARSE_S, _FINE_S = 0.002, 0.0002
_FRAMES_SIDE = 4
"""And how many frames at least, for slower cameras."""
_FRAMES_SEARCH = 2.0
_AWAY_S = np.concatenate([[0.0], np.geomspace(0.0002, 0.03, 14)])
_LEAST_SIDE = 3
"""Measured positions that are needed on either side."""
GUESS_SD_S = 0.003
"""How well it is known when the wrist begins and ceases to go along the rim, without a fit."""
EARLY_S, LATE_S = 0.004, 0.012
"""How much earlier than a contact and later than a release that is seen, for a hand comes and goes slowly."""
_MOST_MISSING = 3.5
"""Frames from one measured position to the next, across which an instant is still told."""
_SLOW_S = 0.04
"""How long what errs in a marker's distance stays."""
_SHAKES_M, _SHAKE_S = (0.0, 0.0002, 0.0004, 0.0008), 0.003
"""How far a camera on a chair may shake, and how long it takes for it."""
_SHAKE_EVENTS, _FITS = 24, 1.3
"""How many fits tell how far it does, and how large their misfits over their degrees of freedom may be for it."""
_SOFT_S = 0.003
"""How long a hand takes to be as fast as the rim it has met: flesh and glove give."""
_FREE_RADIUS = 2
"""The column of the speed inward before contact."""
_FREE_S = 0.04
"""How long a hand has to be seen off the rim."""
_MODEL_S = 0.0008
"""What an instant is good to for that: hands are softer or harder than `_SOFT_S`."""
_SLIP_MPS = 0.05
"""How fast a hand on the rim may creep along it."""
_UNKNOWN_MPS = 0.3
"""How fast it may seem to, where the rim's speed is only that of the pushes before and after."""
_ROLL_MPS = 0.15
"""How fast its wrist may roll inward or outward."""
_CLOSING = (0.3, 0.15), (0.3, 0.10)
"""How fast a hand comes in, m/s, and how sure that is: so much, and so much of the rim's speed. Without it a fit could
take the rim for the hand's way to it, for some hundredths of a second after contact."""
_BEND_MPS2 = 8.0
"""How that may change, over two: a wrist rolls out and in again within a push."""
_FREE = 1500.0, 3e4
"""What a free hand's path may have of the third and fourth power of time, m/s^3 and m/s^4."""
_TURN_MPS2 = 10.0
"""How the speed of the rim may change, over two, where the wheel's rate is not known."""


@dataclass(frozen=True, slots=True)
class Instant:
    """A contact or release at `t_s`, the wrist's angle about the axle there, and its speed in the wheel's plane, just
    before contact or at release, with their standard deviations. One that was not `fitted` is where the wrist was first
    or last seen to go along the rim; `by_wheel` says whether a wheel's sensor helped."""

    t_s: float
    sd_s: float
    angle_rad: float
    angle_sd_rad: float
    speed_mps: float
    speed_sd_mps: float
    fitted: bool
    by_wheel: bool


@dataclass(frozen=True)
class Path:
    """What the instants are found in: the way of a hand about the axle, beside that of the wheel.

    Times (N,) in s, radius (N,) and arc (N,) in m of the measured positions with covariances (N, 2, 2), and how far the
    wheel has turned (N,) in rad, as a sensor measured it where it is `by_wheel` (N,), elsewhere as the hand's own
    pushes have it. `white` is the share of the standard deviations that differs from frame to frame; the rest goes
    slowly. `push_radius_m` is the radius on which arcs are counted, `step_s` from frame to frame, `shake_m` how far the
    camera shakes.
    """

    t_s: FloatArray
    radius_m: FloatArray
    arc_m: FloatArray
    covariance: FloatArray
    white: float
    turned_rad: FloatArray
    by_wheel: npt.NDArray[np.bool_]
    push_radius_m: float
    step_s: float
    shake_m: float = 0.0

    def near(self, low_s: float, high_s: float) -> "Path":
        """What of it is from one time to another."""
        part = slice(int(np.searchsorted(self.t_s, low_s)), int(np.searchsorted(self.t_s, high_s, "right")))
        return replace(
            self, t_s=self.t_s[part], radius_m=self.radius_m[part], arc_m=self.arc_m[part],
            covariance=self.covariance[part], turned_rad=self.turned_rad[part], by_wheel=self.by_wheel[part],
        )  # fmt: skip


def instant(path: Path, kind: EventKind, guess_s: float, earliest_s: float, latest_s: float) -> Instant | str:
    """The instant near a guess, between two times that are surely before and after it; or why there is none."""
    found = _fitted(path, kind, guess_s, earliest_s, latest_s)
    if found is None:
        return "too few positions were measured at it"
    if (missing := _missing(path, kind, guess_s, guess_s)) is not None:
        return missing
    fit, times, misfits = found
    sure = path.near(earliest_s, latest_s).t_s
    free_s = guess_s - sure[0] if kind is EventKind.CONTACT else sure[-1] - guess_s
    if free_s < max(_FREE_S, (_LEAST_SIDE + 1) * path.step_s):
        return f"the hand was not seen off the rim {'before' if kind is EventKind.CONTACT else 'after'} it"
    best = int(misfits.argmin())
    if best in (0, len(times) - 1):
        return _unfitted(fit, guess_s)
    times = times[best] + np.arange(-9, 10) * _FINE_S
    misfits = fit.misfits(times)
    best = int(misfits.argmin())
    scale = max(1.0, float(misfits[best]) / fit.freedom)
    sd_s = fit.spread(float(times[best]), scale)
    if sd_s is None:
        return _unfitted(fit, guess_s)
    if (missing := _missing(path, kind, guess_s, float(times[best]))) is not None:
        return missing
    sd_s = float(np.hypot(sd_s, _MODEL_S))
    return Instant(float(times[best]), sd_s, *fit.there(float(times[best]), sd_s, scale), True, fit.by_wheel)


def _unfitted(fit: "_Fit", guess_s: float) -> Instant:
    """The guess itself, as widely as it may be off, where the fit tells nothing."""
    sd_s = max(GUESS_SD_S, fit.path.step_s)
    return Instant(guess_s, sd_s, *fit.there(guess_s, sd_s, 1.0), False, fit.by_wheel)


def shake_of(path: Path, guesses: Sequence[tuple[EventKind, float, float, float]]) -> float:
    """How far the camera shakes, m: the least with which the fits at guesses (kind, guess, earliest, latest) are as
    near to the positions as these should be."""
    some = guesses[:: max(1, len(guesses) // _SHAKE_EVENTS)]
    for shake_m in _SHAKES_M:
        shaken = replace(path, shake_m=shake_m)
        fits = [found for guess in some if (found := _fitted(shaken, *guess)) is not None]
        if not fits or np.median([misfits.min() / fit.freedom for fit, _, misfits in fits]) < _FITS:
            return shake_m
    return _SHAKES_M[-1]


def _fitted(
    path: Path, kind: EventKind, guess_s: float, earliest_s: float, latest_s: float
) -> tuple["_Fit", FloatArray, FloatArray] | None:
    """A fit near a guess, and its misfits for instants around it; None where there are too few positions."""
    reach_s = max(_REACH_S, _FRAMES_SIDE * path.step_s) + _SEARCH_S / 2
    search_s = max(_SEARCH_S, _FRAMES_SEARCH * path.step_s)
    near = path.near(max(guess_s - reach_s, earliest_s), min(guess_s + reach_s, latest_s))
    if len(near.t_s) < 2 * _LEAST_SIDE + 1:
        return None
    low = max(guess_s - search_s, float(near.t_s[_LEAST_SIDE - 1]))
    high = min(guess_s + search_s, float(near.t_s[-_LEAST_SIDE]))
    if high <= low:
        return None
    fit, times = _Fit(near, kind, guess_s), np.arange(low, high + _COARSE_S, _COARSE_S)
    return fit, times, fit.misfits(times)


def _missing(path: Path, kind: EventKind, guess_s: float, at_s: float) -> str | None:
    """Which gap an instant may lie in: the one it is in, or the one that is beside where the wrist was first seen on
    the rim, or last: wherever the fit would have it."""
    seen_s = guess_s - EARLY_S - path.step_s / 2 if kind is EventKind.CONTACT else guess_s + LATE_S + path.step_s / 2
    for beside_s in (seen_s, at_s):
        k = int(np.searchsorted(path.t_s, beside_s))
        gap = float(path.t_s[k] - path.t_s[k - 1]) if 0 < k < len(path.t_s) else 0.0
        if gap > _MOST_MISSING * path.step_s:
            return f"{round(gap / path.step_s) - 1} frames are missing at it"
    return None


def _covariance(path: Path) -> FloatArray:
    """Of all radii and arcs (2 N, 2 N), radius and arc of a position next to each other.

    How far a marker is comes from its outline, and what errs there (shade, blur, what is behind it) stays for some
    frames: so the part that is not white is alike for positions near in time, along the line of sight, which is the
    direction in which a position is least known.
    """
    values, vectors = np.linalg.eigh(path.covariance)
    along = vectors[:, :, 1] * np.sqrt(np.maximum(values[:, 1], 0.0) * max(0.0, 1 - path.white**2))[:, None]
    along *= np.sign(along[:, :1] + 1e-12)  # one way along the line of sight, on all frames
    apart = np.abs(path.t_s[:, None] - path.t_s[None, :]) * np.sqrt(3) / _SLOW_S
    alike = (1 + apart) * np.exp(-apart)  # Matern 3/2
    count = len(path.t_s)
    out = np.einsum("ia,jb,ij->iajb", along, along, alike)
    index = np.arange(count)
    out[index, :, index, :] += path.covariance * min(1.0, path.white) ** 2 + 1e-10 * np.eye(2)
    shakes = path.shake_m**2 * np.exp(-0.5 * (apart * _SLOW_S / np.sqrt(3) / _SHAKE_S) ** 2)
    for k in range(2):
        out[:, k, :, k] += shakes
    return out.reshape(2 * count, 2 * count)


class _Fit:
    """Weighted least squares of both paths for given instants."""

    def __init__(self, path: Path, kind: EventKind, guess_s: float) -> None:
        self.path, self._kind, self._guess_s = path, kind, guess_s
        self.by_wheel = bool(path.by_wheel.all())
        self._guess_sd_s = max(GUESS_SD_S, 0.7 * path.step_s)
        self._root = np.linalg.inv(np.linalg.cholesky(_covariance(path)))
        turned = path.turned_rad * path.push_radius_m
        self._arc0 = float(np.median(path.arc_m - turned))
        values = np.stack([path.radius_m - path.push_radius_m, path.arc_m - turned - self._arc0], axis=1)
        self._values = self._root @ values.ravel()
        self._turned = turned
        speed_mps = abs(float(np.polyfit(path.t_s - path.t_s[0], path.arc_m, 1)[0]))
        (closing, share), (sd, sd_share) = _CLOSING
        self._closing = closing + share * speed_mps, sd + sd_share * speed_mps
        design, self._place, _ = self._design(path.t_s, path.t_s[:1])
        self.freedom = max(1, 2 * len(path.t_s) - design.shape[-1])

    def misfits(self, times: FloatArray) -> FloatArray:
        """Sums of squares (G,) of the residuals for instants (G,)."""
        return self._solve(times)[0]

    def spread(self, time_s: float, scale: float) -> float | None:
        """The standard deviation of the instant, from where the misfit has grown by one; None where it does not."""
        found = []
        for sign in (-1.0, 1.0):
            grown = self._solve(time_s + sign * _AWAY_S)[0]
            enough = grown - grown[0] >= scale
            if not enough.any():
                return None
            k = int(enough.argmax())
            share = (scale + grown[0] - grown[k - 1]) / (grown[k] - grown[k - 1])
            found.append(_AWAY_S[k - 1] + share * (_AWAY_S[k] - _AWAY_S[k - 1]))
        return float(np.mean(found))

    def there(self, time_s: float, sd_s: float, scale: float) -> tuple[float, float, float, float]:
        """The wrist's angle and speed at an instant with its standard deviation, each with its own."""
        times = time_s + np.array([-0.0005, 0.0, 0.0005])
        _, solution, covariance = self._solve(times)
        arc, free = self._place, _FREE_RADIUS if self._kind is EventKind.CONTACT else 1
        turned = np.interp(times, self.path.t_s, self._turned)
        angle = (self._arc0 + solution[:, arc] + turned) / self.path.push_radius_m
        rate = np.gradient(self._turned, self.path.t_s)
        outward = solution[:, free]
        along = solution[:, arc + free] + np.interp(times, self.path.t_s, rate)
        speed = np.hypot(outward, along)
        both = covariance[1][np.ix_([free, arc + free], [free, arc + free])]
        way = np.array([outward[1], along[1]]) / speed[1]
        angle_sd = np.sqrt(scale * covariance[1, arc, arc]) / self.path.push_radius_m
        speed_sd = np.sqrt(scale * way @ both @ way)
        return (
            float(angle[1]), float(np.hypot(angle_sd, (angle[2] - angle[0]) / 0.001 * sd_s)),
            float(speed[1]), float(np.hypot(speed_sd, (speed[2] - speed[0]) / 0.001 * sd_s)),
        )  # fmt: skip

    def _solve(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Misfits (G,), unknowns (G, P) and their covariances (G, P, P) for instants (G,)."""
        design, _, prior = self._design(self.path.t_s, times)
        rows = self._root @ design.reshape(len(times), -1, design.shape[-1])
        turned = rows.transpose(0, 2, 1)
        normal = turned @ rows + np.diag(prior**2 + 1e-9)
        inverse = np.linalg.inv(normal)
        right, known = turned @ self._values[:, None], 0.0
        if self._kind is EventKind.CONTACT:  # radius falls as the hand closes in
            mean, sd = self._closing
            right[:, _FREE_RADIUS, 0] -= mean / sd**2
            known = (mean / sd) ** 2
        solution = inverse @ right
        misfit: FloatArray = self._values @ self._values + known - (solution * right).sum(axis=(1, 2))
        misfit = misfit + ((times - self._guess_s) / self._guess_sd_s) ** 2
        return misfit, solution[:, :, 0], np.asarray(inverse, np.float64)

    def _design(self, t_s: FloatArray, times: FloatArray) -> tuple[FloatArray, int, FloatArray]:
        """(G, N, 2, P) what radius and arc are made of for instants (G,), the column of the arc at the instant, and 1 /
        sd of what is known of each unknown beforehand (0: nothing)."""
        tau = t_s - times[:, None]
        on = tau >= 0 if self._kind is EventKind.CONTACT else tau <= 0
        held, free = np.where(on, tau, 0.0), np.where(on, 0.0, tau)
        one, air, bend = np.ones_like(tau), free, held**2
        slips = 1 / (_SLIP_MPS if self.by_wheel else _UNKNOWN_MPS)
        if self._kind is EventKind.CONTACT:
            gives = held * np.exp(-held / _SOFT_S)
            held, free = held - gives, free + gives
            first, off = [(free, 1 / self._closing[1])], [(air**2, 0.0), (air**3, 0.0)]
        else:
            held = tau
            first, off = [], [(air**2, 0.0), (air**3, 1 / _FREE[0]), (air**4, 1 / _FREE[1])]
        radius = [(one, 0.0), (held, 1 / _ROLL_MPS), *first, *off, (bend, 1 / _BEND_MPS2)]
        first = [(column, 0.0) for column, _ in first]
        arc = [(one, 0.0), (held, slips), *first, *off, *([] if self.by_wheel else [(bend, 1 / _TURN_MPS2)])]
        design = np.zeros((*tau.shape, 2, len(radius) + len(arc)))
        for k, (column, _) in enumerate(radius + arc):
            design[:, :, 0 if k < len(radius) else 1, k] = column
        return design, len(radius), np.array([weight for _, weight in radius + arc])
