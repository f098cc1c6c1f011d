"""Strokes of a wheelchair racer with exact contacts and releases: on the rim a hand goes with it, off it on its own.

The chair's frame is that of the analysis: origin midway between the hubs of the rear wheels, x forward, y to the
athlete's left, z up, metres. Angles about the axle are in radians from straight up, growing as the wheel turns when
the chair goes forward. Between pushes the hands, and always the shoulders, follow the recorded athlete
(`racing_kinematics.json`), of whom a circle through the push has its centre at `_HUB_RECORDED_M`. The forearm and the
upper arm keep their lengths; the elbow is as near as they let it to the recorded one.

At contact the wrist comes with a speed of its own and takes on the rim's within a few milliseconds, for a hand is
soft. At release it is cast off: its velocity goes on, and its acceleration is new at once, outward and against its way.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BPoly, CubicSpline

from spheremcap.synth.kinematics import cadence_hz, joint_chair_m, smooth_step

FloatArray = npt.NDArray[np.float64]

_HUB_RECORDED_M = np.array([0.17, 0.0, -0.17])
_PHASES = 0.235, 0.42
"""Where in its cycle the recorded athlete has the hand about where ours are at contact and at release."""
FOREARM_M, UPPER_ARM_M = 0.29, 0.28
"""Between the markers of wrist and elbow, and of elbow and shoulder."""
_SEAT_M = np.array([-0.07, 0.0, -0.07])
"""How much further back and lower our athlete sits than the recorded one, so that straight arms are rare."""
_SOFT_S = 0.004
_BEND_S = 0.15
"""How long a free hand takes to be on its recorded path, and how long before contact it leaves that."""
_CAST_S, _SLOWS_MPS2 = 0.05, 25.0
"""How long a hand is cast off the rim, and by how much that slows it down."""
_STEP_S = 1 / 4000


@dataclass(frozen=True, slots=True)
class Wheels:
    """The rear wheels: radius, radius on which the wrist goes while the hand is on the rim, half the distance of the
    hubs, how far outward of the wheel's plane the wrist is, and camber (the tops lean inward)."""

    radius_m: float = 0.35
    rim_radius_m: float = 0.18
    wrist_radius_m: float = 0.205
    half_track_m: float = 0.30
    outward_m: float = 0.02
    camber_rad: float = float(np.radians(11.0))


@dataclass(frozen=True, slots=True)
class Mount:
    """Where the camera is on the chair: in front, looking back and `down_rad` down, turned by nothing else."""

    xyz_chair_m: tuple[float, float, float] = (1.08, 0.0, 0.80)
    down_rad: float = float(np.radians(30.0))

    @property
    def axes(self) -> FloatArray:
        """The camera's right, down and forward in the chair's frame, (3, 3): it looks back, left is on its right."""
        sin, cos = np.sin(self.down_rad), np.cos(self.down_rad)
        return np.array([[0.0, 1.0, 0.0], [sin, 0.0, -cos], [-cos, 0.0, -sin]])

    def to_camera(self, xyz_chair_m: FloatArray) -> FloatArray:
        """Positions (N, 3) from the chair's frame to the camera's optical frame."""
        out: FloatArray = (np.asarray(xyz_chair_m, np.float64) - self.xyz_chair_m) @ self.axes.T
        return out


@dataclass(frozen=True, slots=True)
class Push:
    """A hand on the rim from `contact_s` to `release_s`, at `contact_rad` first. It comes inward at `closing_mps`,
    along the rim at `share` of the rim's speed; until release the wrist has rolled `roll_m` outward and back.

    A `missed` one never touches: the hand goes by a few centimetres outward. A `braking` one stays where it took hold.
    """

    contact_s: float
    release_s: float
    contact_rad: float
    closing_mps: float = 1.2
    share: float = 0.8
    roll_m: float = 0.004
    leaves_mps2: float = 60.0
    missed: bool = False
    braking: bool = False


@dataclass(frozen=True, slots=True)
class TrueEvent:
    """What a hand did, to the last digit: side, "CONTACT" or "RELEASE", time, angle and speed of the wrist."""

    side: str
    kind: str
    time_s: float
    angle_rad: float
    speed_mps: float


class Arm:
    """One side: where its wrist, elbow and shoulder are, in the chair's frame, and its true events."""

    def __init__(self, side: str, wheels: Wheels, rate: CubicSpline, pushes: Sequence[Push]) -> None:
        self.side, self.wheels, self._pushes = side, wheels, tuple(pushes)
        self._rate, self._turned = rate, rate.antiderivative()
        knots = [(p.contact_s, k + _PHASES[0]) for k, p in enumerate(pushes)]
        knots += [(p.release_s, k + _PHASES[1]) for k, p in enumerate(pushes)]
        times, phases = np.array(sorted(knots)).T
        self._phase = CubicSpline(times, phases)
        self.start_s, self.end_s = float(times[0]), float(times[-1])

    def joint(self, name: str) -> Callable[[FloatArray], FloatArray]:
        """The path of "wrist", "elbow" or "shoulder": times (N,) in s to positions (N, 3) in m."""
        spline: CubicSpline = getattr(self, f"_{name}")
        return lambda t_s: spline(np.asarray(t_s, np.float64))

    @cached_property
    def events(self) -> tuple[TrueEvent, ...]:
        """Contacts and releases by time; speeds just before contact and just after release."""
        found = []
        for push in self._pushes:
            if push.missed or push.braking:
                continue
            turned = float(self._turned(push.release_s) - self._turned(push.contact_s))
            for kind, time_s, angle in (
                ("CONTACT", push.contact_s, push.contact_rad),
                ("RELEASE", push.release_s, push.contact_rad + turned),
            ):
                speed = float(np.linalg.norm(self._wrist(time_s, 1)))
                found.append(TrueEvent(self.side, kind, time_s, angle, speed))
        return tuple(found)

    def in_chair(self, uvw: FloatArray) -> FloatArray:
        """From the wheel's plane (forward, up in it, outward) about the hub to the chair's frame, (N, 3)."""
        sin, cos = np.sin(self.wheels.camber_rad), np.cos(self.wheels.camber_rad)
        u, v, w = uvw.T
        y = self.wheels.half_track_m + cos * w - sin * v
        out: FloatArray = np.stack([u, y if self.side == "left" else -y, cos * v + sin * w], axis=1)
        return out

    # --- paths, as tables of which splines are made ---

    @cached_property
    def _times(self) -> FloatArray:
        return np.arange(self.start_s, self.end_s, _STEP_S)

    @cached_property
    def _wrist(self) -> CubicSpline:
        t, path = self._times, np.empty((len(self._times), 3))
        for push in self._pushes:
            if not push.missed:
                on = (t >= push.contact_s) & (t <= push.release_s)
                path[on] = self._held(push, t[on])
        ends = [p for p in self._pushes if not p.missed]
        for last, following in pairwise(ends):
            off = (t > last.release_s) & (t < following.contact_s)
            path[off] = self._free(last, following, t[off])
        return CubicSpline(t, self.in_chair(path))

    @cached_property
    def _shoulder(self) -> CubicSpline:
        return CubicSpline(self._times, self._recorded("shoulder", self._times))

    @cached_property
    def _elbow(self) -> CubicSpline:
        """On the circle that the two lengths leave, the point nearest to the recorded elbow."""
        t = self._times
        wrist, shoulder, wanted = self._wrist(t), self._shoulder(t), self._recorded("elbow", t)
        between = shoulder - wrist
        d = np.linalg.norm(between, axis=1, keepdims=True)
        along = between / d
        a = (d**2 + FOREARM_M**2 - UPPER_ARM_M**2) / (2 * d)
        across = np.sqrt(np.maximum(FOREARM_M**2 - a**2, 1e-4))
        side = wanted - wrist
        side -= (side * along).sum(axis=1, keepdims=True) * along
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        return CubicSpline(t, wrist + a * along + across * side)

    def _recorded(self, joint: str, t: FloatArray) -> FloatArray:
        """The recorded joint at our phase, in the chair's frame."""
        there = joint_chair_m(f"right_{joint}", self._phase(t) / cadence_hz()) - _HUB_RECORDED_M
        if joint == "shoulder":
            there += _SEAT_M
        if self.side == "left":
            there[:, 1] *= -1
        return there

    def _recorded_uvw(self, t: FloatArray) -> FloatArray:
        """The recorded wrist about the hub, in the wheel's plane."""
        there = self._recorded("wrist", t)
        sin, cos = np.sin(self.wheels.camber_rad), np.cos(self.wheels.camber_rad)
        y = np.abs(there[:, 1]) - self.wheels.half_track_m
        return np.stack([there[:, 0], cos * there[:, 2] - sin * y, sin * there[:, 2] + cos * y], axis=1)

    def _held(self, push: Push, t: FloatArray) -> FloatArray:
        """On the rim: with it, but for what a soft hand takes to be as fast as it is, and for the wrist's rolling."""
        since, rate = t - push.contact_s, float(self._rate(push.contact_s))
        part = since / (push.release_s - push.contact_s)
        gives = since * np.exp(-since / _SOFT_S)
        turned = np.zeros_like(t) if push.braking else self._turned(t) - self._turned(push.contact_s)
        slower = (0.0 if push.braking else push.share - 1.0) * rate
        angle = push.contact_rad + turned + slower * gives
        roll = push.roll_m * np.sin(np.pi * part) ** 4  # it has no speed at either end
        radius = self.wheels.wrist_radius_m - push.closing_mps * gives + roll
        return np.stack(
            [radius * np.sin(angle), radius * np.cos(angle), np.full_like(t, self.wheels.outward_m)], axis=1
        )

    def _free(self, last: Push, following: Push, t: FloatArray) -> FloatArray:
        """Off the rim: the recorded path, bent so that it begins as the push ended and ends as the next one begins."""
        start, end = last.release_s, following.contact_s
        path, bend_s = self._recorded_uvw(t), min(_BEND_S, (end - start) / 2)
        for push, at, step in ((last, start, -1e-4), (following, end, 1e-4)):
            held = self._held(push, at + step * np.arange(4.0))
            velocity = (-11 * held[0] + 18 * held[1] - 9 * held[2] + 2 * held[3]) / (6 * step)
            own = self._recorded_uvw(at + step * np.array([-1, 0, 1]))
            bent = [held[0] - own[1], velocity - (own[2] - own[0]) / (2 * step), np.zeros(3)]
            if push is last and not push.braking:
                outward = held[0] * [1, 1, 0] / self.wheels.wrist_radius_m
                along = velocity / np.linalg.norm(velocity)
                held_in = -(float(self._rate(at)) ** 2) * self.wheels.wrist_radius_m * outward
                bent[2] = held_in - (own[2] - 2 * own[1] + own[0]) / step**2
                since = (t - at)[:, None]
                cast = push.leaves_mps2 * outward - _SLOWS_MPS2 * along
                path += cast * since**2 / 2 * np.exp(-since / _CAST_S) * smooth_step((end - t) / bend_s)[:, None]
            knots = [(at, bent), (at + np.sign(-step) * bend_s, np.zeros((3, 3)))]
            (t0, d0), (t1, d1) = sorted(knots, key=lambda knot: knot[0])
            near = (t >= t0) & (t <= t1)
            path[near] += BPoly.from_derivatives([t0, t1], [d0, d1])(t[near])
        for push in self._pushes:
            if push.missed and start < push.contact_s < end:
                path = self._kept_away(push, path, t)
        return path

    def _kept_away(self, push: Push, path: FloatArray, t: FloatArray) -> FloatArray:
        """A path that goes by the rim where a hand misses it, a few centimetres outward."""
        middle, half = (push.contact_s + push.release_s) / 2, 1.3 * (push.release_s - push.contact_s)
        near = np.clip(1 - ((t - middle) / half) ** 2, 0, 1) ** 2
        radius = np.hypot(path[:, 0], path[:, 1])
        wanted = np.maximum(radius, self.wheels.wrist_radius_m + 0.035)
        grown = 1 + near * (wanted / radius - 1)
        return path * np.stack([grown, grown, np.ones_like(t)], axis=1)


@dataclass(frozen=True)
class Motion:
    """A session's strokes: the wheels, both arms, and how the wheels turn (rad/s over s)."""

    wheels: Wheels
    rate_rad_s: CubicSpline
    left: Arm
    right: Arm

    @property
    def arms(self) -> tuple[Arm, Arm]:
        return self.left, self.right

    def turned_rad(self, t_s: FloatArray) -> FloatArray:
        """How far the wheels have turned since time 0, (N,)."""
        turned = self.rate_rad_s.antiderivative()
        out: FloatArray = turned(t_s) - turned(0.0)
        return out


@dataclass(frozen=True, slots=True)
class Manner:
    """How somebody pushes: cadence in Hz, the wheels' rate in rad/s at the beginning and at the end, the angles in
    degrees of contact and of release, how far the left hand is behind, how much later (degrees) it takes hold, the
    strokes that are missed (side, number), and the stroke that both hands brake instead."""

    cadence_hz: float = 1.87
    rates_rad_s: tuple[float, float] = (20.0, 20.0)
    contact_deg: float = 48.0
    release_deg: float = 198.0
    left_lag_s: float = 0.012
    left_later_deg: float = 0.0
    missed: tuple[tuple[str, int], ...] = ()
    braked: int | None = None
    brake_s: float = 0.9


def motion(manner: Manner, seconds: float, rng: np.random.Generator, wheels: Wheels | None = None) -> Motion:
    """Both arms from a little before time 0 to a little after `seconds`; no two strokes are quite alike."""
    wheels = wheels or Wheels()
    period = 1 / manner.cadence_hz
    count = int(np.ceil(seconds / period)) + 5
    nominal = (np.arange(count) - 2.3) * period
    if manner.braked is not None:
        nominal[manner.braked + 3 :] += manner.brake_s
    t = np.arange(nominal[0] - 2.0, nominal[-1] + 3.0, 0.01)
    rate = np.interp(t, [0.0, seconds], manner.rates_rad_s)
    if manner.braked is not None:
        begins = nominal[manner.braked + 2]
        slowed = np.interp(t, [begins + 0.1, begins + 0.1 + manner.brake_s], [1.0, 0.75])
        rate = rate * slowed
    rate = CubicSpline(t, rate * (1 + 0.02 * np.sin(2 * np.pi * manner.cadence_hz * (t - nominal[0]))))
    arms = []
    for side in ("left", "right"):
        late_s, later = (manner.left_lag_s, manner.left_later_deg) if side == "left" else (0.0, 0.0)
        pushes = []
        for k, start in enumerate(nominal + late_s):
            number = k - 2
            contact_s = float(start + rng.normal(0, 0.008))
            contact = np.radians(manner.contact_deg + later + rng.normal(0, 3.0))
            release = np.radians(manner.release_deg + rng.normal(0, 4.0))
            push_s = float((release - contact) / rate(contact_s + 0.07))
            braking = number == manner.braked
            pushes.append(
                Push(
                    contact_s, contact_s + (manner.brake_s if braking else push_s), float(contact),
                    closing_mps=float(rng.uniform(0.8, 1.6)), share=float(rng.uniform(0.7, 0.9)),
                    roll_m=float(rng.uniform(-0.004, 0.006)), leaves_mps2=float(rng.uniform(45.0, 80.0)),
                    missed=(side, number) in manner.missed, braking=braking,
                )
            )  # fmt: skip
        arms.append(Arm(side, wheels, rate, pushes))
    return Motion(wheels, rate, arms[0], arms[1])
