"""Strokes of one hand: when it is on the rim, its contacts and releases, and what lies between them."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from spheremcap.analysis.curves import ArmCurves
from spheremcap.analysis.events import EARLY_S, LATE_S, Instant, Path, instant, shake_of
from spheremcap.analysis.rim import AboutAxle, Wheel, about_axle
from spheremcap.analysis.smoother import JointTrack
from spheremcap.core.stroke import EventKind, Stroke, StrokeEvent
from spheremcap.core.time import NS_PER_S

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_ON_RIM_M = 0.012
"""How far from the push's circle a wrist may be while its hand is on the rim."""
_SLIP = 0.15
"""How much slower or faster than the rim a hand on it may be, as a share."""
_FORWARD = 0.3
"""Of its fastest usual rate about the axle, what a hand has to go forward with to push, where it is not known."""
_SLOW_S = 0.08
"""What errs in a marker's distance takes about so long to come and go."""
_LEAVES_MPS = 0.35
"""How fast inward or outward a wrist may move while its hand is on the rim."""
_HOLE_S, _OFF_S = 0.025, 0.0125
"""A push may not be measured for so long within, and seem to be none for so long."""
_SHORTEST_S, _SHORTEST_RAD = 0.030, float(np.radians(20.0))
"""It lasts so long, and goes so far, at least."""
_WRISTS_M = (-0.03, 0.09)
"""How far outward of the rim a wrist on it can be."""
_TELLS = 0.5
"""A push tells the rim's rate where it goes as far as this share of the usual."""
_EXTENT_S = 0.15
"""How far beyond what was first seen of a push it may go on."""
_ROUNDS = 4
_OFF_M = 0.006, 1.0, 0.02
"""How far a push's radius, its arc and its distance from the camera may be off, as far as is known before."""
_STRAYS_M, _AWAY = (0.003, 0.002), 9.0
"""How far in and out a wrist rolls and along the rim it creeps within a push, and how many standard deviations,
squared, off its way it has left the rim: on three frames in a row."""
_BLOCK = 65536
_RECOVERY_END = 0.1
_PATTERN_M = 0.025
"""How far from the push's circle a recovery has to go to be above or below it."""


@dataclass(frozen=True)
class Hand:
    """One hand: its wrist's track of N frames in the chair's frame, whose times count from `start_ns`, by how much it
    is noisier than it says, its smoothed curves, and the wheel.

    `turned_rad` (N,) is how far the wheel has turned when the wrist was seen, None or NaN where that is not known;
    `frame_s` is from frame to frame. `hub_sd_m` and `tilt_sd_rad` say how well the axle's place and what is upright are
    known: they go into angles (None: nothing says what is upright, and there are no angles but a push's own).
    """

    side: str
    start_ns: int
    track: JointTrack
    noise: float
    curves: ArmCurves
    wheel: Wheel
    turned_rad: FloatArray | None
    frame_s: float
    hub_sd_m: float = 0.0
    tilt_sd_rad: float | None = 0.0

    @property
    def marker(self) -> str:
        return self.track.marker

    @property
    def t_s(self) -> FloatArray:
        return self.track.t_s

    def angle_sd_deg(self, sd_rad: float, radius_m: float) -> float:
        """Of an angle from straight up, with what the chair's frame adds."""
        return float(np.degrees(np.sqrt(sd_rad**2 + (self.tilt_sd_rad or 0.0) ** 2 + (self.hub_sd_m / radius_m) ** 2)))


@dataclass(frozen=True)
class HandStrokes:
    """What was found of one hand: the wheel and the push's circle about its hub (NaN: it never goes along a rim),
    events and strokes by time, and what could not be had, in a line each."""

    wheel: Wheel
    push_radius_m: float
    events: tuple[StrokeEvent, ...]
    strokes: tuple[Stroke, ...]
    notes: tuple[str, ...]


def strokes_of(hand: Hand, rim_radius_m: float | None) -> HandStrokes:
    """Contacts, releases and strokes of a hand; `rim_radius_m` bounds where the push's circle is looked for."""
    track, noise = hand.track, hand.noise
    about = about_axle(track.xyz_m, track.packed, hand.wheel)
    rate, leaving, unsure = _going(hand, about)
    turning = None if hand.turned_rad is None else np.gradient(hand.turned_rad, hand.t_s)
    radius = _push_radius(about, _along(rate, turning, unsure), rate, rim_radius_m)
    if radius is None:
        return HandStrokes(hand.wheel, np.nan, (), (), (f"{hand.side} hand: it never goes along a rim",))
    with np.errstate(invalid="ignore"):
        near = (np.abs(about.radius_m - radius) < _ON_RIM_M + 2 * np.sqrt(about.covariance[:, 0, 0])) & ~leaving
    pushes = _pushes(hand, about, near & _along(rate, turning, unsure))
    if not pushes:
        return HandStrokes(hand.wheel, radius, (), (), (f"{hand.side} hand: no push was seen",))
    own = _rim_rate(hand, about, rate, pushes)
    by_wheel = np.isfinite(turning) if turning is not None else np.zeros(len(track), np.bool_)
    turning = own if turning is None else np.where(by_wheel, turning, own)
    pushes = _pushes(hand, about, near & _along(rate, turning, unsure))
    turned = np.concatenate([[0.0], np.cumsum((turning[1:] + turning[:-1]) / 2 * np.diff(hand.t_s))])
    pushes = _whole(hand.t_s, about, pushes, radius, turned)
    there = np.isfinite(about.radius_m)
    seen = slice(None) if there.all() else there  # half an hour of them is not copied without need
    path = Path(
        hand.t_s[seen], about.radius_m[seen], about.angle_rad[seen] * radius, about.covariance[seen], noise,
        turned[seen], by_wheel[seen], radius, hand.frame_s,
    )  # fmt: skip
    guesses = [_guesses(hand.t_s, pushes, k) for k in range(len(pushes))]
    path = replace(path, shake_m=shake_of(path, [guess for both in guesses for guess in both]))
    told = [(instant(path, *contact), instant(path, *release)) for contact, release in guesses]
    events, strokes, notes = [], [], []
    for number, (contact, release) in enumerate(told):
        for kind, found in ((EventKind.CONTACT, contact), (EventKind.RELEASE, release)):
            if isinstance(found, Instant):
                events.append(_event(hand, kind, number, found, radius))
        following = told[number + 1][0] if number + 1 < len(told) else None
        missing = _missing(contact, release)
        notes += [f"{hand.side} hand, stroke {number}: {missing}"] if missing else []
        stroke = _stroke(hand, about, radius, number, contact, release, following, pushes)
        strokes += [stroke] if stroke is not None else []
    return HandStrokes(hand.wheel, radius, tuple(events), tuple(strokes), tuple(notes))


def _going(hand: Hand, about: AboutAxle) -> tuple[FloatArray, BoolArray, FloatArray]:
    """How fast the wrist goes round its axle, rad/s (N,), where it surely goes in or out (N,), and how unsure that rate
    is (N,), from the smoothed motion; NaN and False where there is none. What errs in a marker's distance does so
    slowly, and looks like a motion."""
    count = len(hand.t_s)
    rate, leaving, unsure = np.empty(count), np.empty(count, np.bool_), np.empty(count)
    for start in range(0, count, _BLOCK):
        part = slice(start, start + _BLOCK)
        u, v, _ = hand.wheel.axes @ (hand.curves.xyz_m[part] - hand.wheel.hub_m).T
        du, dv, _ = hand.wheel.axes @ hand.curves.velocity_mps[part].T.astype(np.float64)
        far = np.hypot(u, v)
        slow = np.sqrt(np.diagonal(about.covariance[part], axis1=1, axis2=2)) / _SLOW_S
        slow = np.minimum(np.nan_to_num(slow), _LEAVES_MPS)
        with np.errstate(invalid="ignore"):
            rate[part], unsure[part] = (v * du - u * dv) / far**2, slow[:, 1] / far
            leaving[part] = np.abs((u * du + v * dv) / far) > _LEAVES_MPS + slow[:, 0]
    return rate, leaving, unsure


def _along(rate: FloatArray, turning: FloatArray | None, unsure: FloatArray) -> BoolArray:
    """Where a hand goes round as fast as the rim, as far as rates are sure (N,) in rad/s; where it goes forward well,
    as far as the rim's rate is not known."""
    forward = rate > _FORWARD * float(np.nanpercentile(rate, 90))
    if turning is None:
        return forward
    with np.errstate(invalid="ignore"):
        along = (np.abs(rate - turning) < _SLIP * turning + unsure) & forward
    return np.where(np.isnan(turning), forward, along)


def _push_radius(about: AboutAxle, along: BoolArray, rate: FloatArray, rim_radius_m: float | None) -> float | None:
    """The radius that wrists keep to while they go round with the rim: where most of their way is."""
    fits = along & np.isfinite(about.radius_m)
    if rim_radius_m is not None:
        low, high = (rim_radius_m + more for more in _WRISTS_M)
        fits &= (about.radius_m > low) & (about.radius_m < high)
    if fits.sum() < 10:
        return None
    radius, way = about.radius_m[fits], rate[fits]
    order = np.argsort(radius)
    radius, way = radius[order], np.concatenate([[0.0], np.cumsum(way[order])])
    ends = np.searchsorted(radius, radius + _ON_RIM_M, "right")
    best = int(np.argmax(way[ends] - way[: len(radius)]))
    return float(np.median(radius[best : ends[best]]))


def _rim_rate(hand: Hand, about: AboutAxle, rate: FloatArray, pushes: list[tuple[int, int]]) -> FloatArray:
    """The rim's rate where no wheel tells it, rad/s (N,): the hand's own in the middle of its pushes, for a wheel
    hardly changes its rate within one. Of a push and its neighbours, for one may err; short ones tell nothing."""
    far = np.array([about.angle_rad[last] - about.angle_rad[first] for first, last in pushes])
    whole = [push for push, way in zip(pushes, far, strict=True) if way > _TELLS * float(np.median(far))]
    middles = [(first + (last - first) // 4, last - (last - first) // 4) for first, last in whole]
    usual = [float(np.nanmedian(rate[low : high + 1])) for low, high in middles]
    rates = [float(np.median(usual[max(0, k - 1) : k + 2])) for k in range(len(usual))]
    ends = hand.t_s[np.array(whole)] + np.array([-_EXTENT_S, _EXTENT_S]) / 4
    return np.interp(hand.t_s, ends.ravel(), np.repeat(rates, 2))


def _pushes(hand: Hand, about: AboutAxle, on_rim: BoolArray) -> list[tuple[int, int]]:
    """First and last frames of the stretches on the rim that are pushes."""
    index = np.flatnonzero(on_rim)
    if not len(index):
        return []
    off = np.concatenate([[0], np.cumsum(np.isfinite(about.radius_m) & ~on_rim)])
    allowed = np.where(np.diff(off[index]) > 0, _OFF_S, _HOLE_S) + hand.frame_s
    cuts = np.flatnonzero(np.diff(hand.t_s[index]) > allowed) + 1
    found = []
    for run in np.split(index, cuts):
        first, last = int(run[0]), int(run[-1])
        lasts = hand.t_s[last] - hand.t_s[first]
        if lasts >= _SHORTEST_S and about.angle_rad[last] - about.angle_rad[first] >= _SHORTEST_RAD:
            found.append((first, last))
    return found


def _whole(
    t_s: FloatArray, about: AboutAxle, pushes: list[tuple[int, int]], radius_m: float, turned_rad: FloatArray
) -> list[tuple[int, int]]:
    """Pushes as far as the wrist goes on as it does in their middles: what errs slowly in its distance cuts them up."""
    found: list[tuple[int, int]] = []
    for first, last in pushes:
        if found and last <= found[-1][1]:
            continue
        low, high = first, last
        for _ in range(_ROUNDS):  # the more of a push is known, the better is known where the wrist would be
            low, high = _extent(t_s, about, (low, high), radius_m, turned_rad)
        if found and low <= found[-1][1]:
            low, high = found[-1][0], max(high, found[-1][1])
            found.pop()
        found.append((low, high))
    return found


def _extent(
    t_s: FloatArray, about: AboutAxle, push: tuple[int, int], radius_m: float, turned_rad: FloatArray
) -> tuple[int, int]:
    """First and last frames on which the wrist is where its push's middle says that it would be."""
    first, last = push
    quarter = (last - first) // 4
    low = int(np.searchsorted(t_s, t_s[first] - _EXTENT_S))
    part = slice(low, int(np.searchsorted(t_s, t_s[last] + _EXTENT_S, "right")))
    middle = slice(first + quarter - low, last - quarter + 1 - low)
    radius, arc = about.radius_m[part], (about.angle_rad[part] - turned_rad[part]) * radius_m
    seen = np.isfinite(radius) & np.isfinite(arc)
    if not seen[middle].any():
        return first, last
    off = np.stack([radius, arc], axis=1)
    allowed = np.where(seen[:, None, None], about.covariance[part] + np.diag(np.square(_STRAYS_M)), np.eye(2))
    off = np.where(seen[:, None], off, 0.0)
    off = off - np.median(off[middle][seen[middle]], axis=0)
    off = off - _displaced(off, allowed, middle, seen)
    away = np.einsum("ni,nij,nj->n", off, np.linalg.inv(allowed), off)
    off_rim = np.flatnonzero(seen & (away > _AWAY))
    index = np.flatnonzero(seen)
    place = np.searchsorted(index, off_rim)  # which measured frame each of them is
    runs = place[:-2][(place[2:] - place[:-2]) == 2] if len(place) > 2 else place[:0]
    centre = int(np.searchsorted(index, (first + last) // 2 - low))
    before, after = runs[runs + 2 < centre], runs[runs > centre]
    start = int(index[before[-1] + 3]) if len(before) else first - low
    end = int(index[after[0] - 1]) if len(after) else last - low
    return start + low, end + low


def _displaced(off: FloatArray, covariance: FloatArray, middle: slice, seen: BoolArray) -> FloatArray:
    """What a push's radius and phase, and an error in the distance that stays, make of positions on the rim, (N, 2)."""
    _, vectors = np.linalg.eigh(covariance)
    sight = vectors[:, :, 1] * np.sign(vectors[:, :1, 1] + 1e-12)
    design = np.zeros((len(off), 2, 3))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, :, 2] = sight
    own = np.zeros(len(off), np.bool_)
    own[middle] = seen[middle]
    weight = np.linalg.inv(covariance[own])
    normal = np.einsum("nia,nij,njb->ab", design[own], weight, design[own]) + np.diag(1 / np.square(_OFF_M))
    right = np.einsum("nia,nij,nj->a", design[own], weight, off[own])
    out: FloatArray = design @ np.linalg.solve(normal, right)
    return out


_Guess = tuple[EventKind, float, float, float]


def _guesses(t_s: FloatArray, pushes: list[tuple[int, int]], k: int) -> tuple[_Guess, _Guess]:
    """Of contact and release of a push: kind, where about it is, and times surely before and after it."""
    first, last = (float(t_s[end]) for end in pushes[k])
    before = float(t_s[pushes[k - 1][1]]) if k > 0 else -np.inf
    after = float(t_s[pushes[k + 1][0]]) if k + 1 < len(pushes) else np.inf
    middle = (first + last) / 2
    return (EventKind.CONTACT, first + EARLY_S, before, middle), (EventKind.RELEASE, last - LATE_S, middle, after)


def _event(hand: Hand, kind: EventKind, stroke: int, found: Instant, radius_m: float) -> StrokeEvent:
    upright = hand.tilt_sd_rad is not None
    return StrokeEvent(
        hand.start_ns + round(found.t_s * NS_PER_S), hand.side, hand.marker, kind, stroke, found.sd_s * 1e3,
        _degrees(found.angle_rad) if upright else None,
        hand.angle_sd_deg(found.angle_sd_rad, radius_m) if upright else None,
        found.speed_mps, found.speed_sd_mps,
        "" if not found.fitted else "radius and slip" if found.by_wheel else "radius and angle",
    )  # fmt: skip


def _degrees(angle_rad: float) -> float:
    """From -90 to 270, so that contacts and releases of racers and others alike do not jump by a turn."""
    return float((np.degrees(angle_rad) + 90.0) % 360.0 - 90.0)


def _missing(contact: Instant | str, release: Instant | str) -> str:
    """What of a push is not there, and why."""
    told = (("contact", contact), ("release", release))
    return "; ".join(f"{kind}: {found}" for kind, found in told if isinstance(found, str))


def _stroke(
    hand: Hand, about: AboutAxle, radius_m: float, number: int, contact: Instant | str, release: Instant | str,
    following: Instant | str | None, pushes: list[tuple[int, int]],
) -> Stroke | None:  # fmt: skip
    """From what is known of it; None where neither its contact nor its release is."""
    starts = contact if isinstance(contact, Instant) else release
    if not isinstance(starts, Instant):
        return None
    stroke = Stroke(
        hand.start_ns + round(starts.t_s * NS_PER_S), hand.side, hand.marker, number, missing=_missing(contact, release)
    )
    more: dict[str, float | str | None] = {}
    upright = hand.tilt_sd_rad is not None
    if isinstance(contact, Instant):
        more |= {"contact_mps": contact.speed_mps, "contact_sd_mps": contact.speed_sd_mps}
        if upright:
            more |= {
                "contact_deg": _degrees(contact.angle_rad),
                "contact_sd_deg": hand.angle_sd_deg(contact.angle_sd_rad, radius_m),
            }
    if isinstance(release, Instant) and upright:
        more |= {
            "release_deg": _degrees(release.angle_rad),
            "release_sd_deg": hand.angle_sd_deg(release.angle_sd_rad, radius_m),
        }
    if isinstance(contact, Instant) and isinstance(release, Instant):
        more |= {
            "push_s": release.t_s - contact.t_s,
            "push_sd_s": float(np.hypot(contact.sd_s, release.sd_s)),
            "push_deg": float(np.degrees(release.angle_rad - contact.angle_rad)),
            "push_sd_deg": float(np.degrees(np.hypot(contact.angle_sd_rad, release.angle_sd_rad))),
            "wheel_rad_s": _wheel_rate(hand, contact.t_s, release.t_s),
        }
    end = following if isinstance(following, Instant) else None
    if end is not None and isinstance(release, Instant):
        part = slice(int(np.searchsorted(hand.t_s, release.t_s)), int(np.searchsorted(hand.t_s, end.t_s)))
        late = slice(int(np.searchsorted(hand.t_s, end.t_s - _RECOVERY_END * (end.t_s - release.t_s))), part.stop)
        speed, sd = _mean_speed(hand, late)
        more |= {
            "recovery_s": end.t_s - release.t_s,
            "recovery_sd_s": float(np.hypot(end.sd_s, release.sd_s)),
            "recovery_end_mps": speed,
            "recovery_end_sd_mps": sd,
            "pattern": _pattern(about, radius_m, part),
        }
    if end is not None and isinstance(contact, Instant):
        cycle, sd = end.t_s - contact.t_s, float(np.hypot(end.sd_s, contact.sd_s))
        more |= {"cycle_s": cycle, "cycle_sd_s": sd, "frequency_hz": 1 / cycle, "frequency_sd_hz": sd / cycle**2}
    last = end.t_s if end is not None else float(hand.t_s[pushes[number][1]])
    part = slice(int(np.searchsorted(hand.t_s, starts.t_s)), int(np.searchsorted(hand.t_s, last)))
    seen = hand.track.measured[part]
    return replace(stroke, **more, measured=float(seen.mean()) if len(seen) else 0.0)  # type: ignore[arg-type]


def _wheel_rate(hand: Hand, start_s: float, end_s: float) -> float | None:
    """In the mean between two times, rad/s."""
    if hand.turned_rad is None:
        return None
    ends = np.interp([start_s, end_s], hand.t_s, hand.turned_rad)
    rate = float(ends[1] - ends[0]) / (end_s - start_s)
    return rate if np.isfinite(rate) else None


def _mean_speed(hand: Hand, part: slice) -> tuple[float | None, float | None]:
    """In the mean over measured frames; the sd is that of one frame, for neighbours err alike."""
    speed, sd = (hand.curves.values[name][part][hand.track.measured[part]] for name in ("speed_mps", "speed_sd_mps"))
    if len(speed) < 2:
        return None, None
    return float(speed.mean()), float(np.sqrt((sd**2).mean()))


def _pattern(about: AboutAxle, radius_m: float, part: slice) -> str:
    """The recovery's path class (Boninger et al. 2002 for daily chairs): along the rim, below it, above it, or both;
    and around the axle, as racers go. "" where too little of it was seen."""
    radius, angle = about.radius_m[part], about.angle_rad[part]
    seen = np.isfinite(radius)
    if seen.sum() < 5 or seen.mean() < 0.7:
        return ""
    if float(angle[seen][-1] - angle[seen][0]) > np.pi / 2:
        return "around"
    above, below = radius[seen].max() - radius_m > _PATTERN_M, radius_m - radius[seen].min() > _PATTERN_M
    return {(False, False): "arc", (False, True): "semicircular", (True, False): "single loop"}.get(
        (bool(above), bool(below)), "double loop"
    )
