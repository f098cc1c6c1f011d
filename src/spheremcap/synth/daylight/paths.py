"""How things move on the stage: sways, throws, pendulums, limbs that come between, wheels."""

from collections.abc import Callable

import numpy as np

from spheremcap.synth.daylight.world import Capsule, FloatArray, Paint, Path

Number = Callable[[FloatArray], FloatArray]
"""Times (N,) in seconds -> numbers (N,)."""
GRAVITY = 9.81
"""m/s**2."""


def still(x: float, y: float, z: float) -> Path:
    """A place."""
    return lambda t: np.tile((x, y, z), (len(t), 1))


def sway(
    rng: np.random.Generator, middle: tuple[float, float, float], size: tuple[float, float, float], hz: float
) -> Path:
    """A smooth wander about `middle`: along each axis a slow sine of `size` metres and a smaller, quicker one."""
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    slow, quick = hz * np.array([1.0, 0.61, 1.37]), hz * np.array([2.27, 1.49, 2.71])

    def at(t: FloatArray) -> FloatArray:
        w = 2 * np.pi * t[:, None]
        out: FloatArray = middle + np.array(size) * (
            0.85 * np.sin(slow * w + phase[0]) + 0.15 * np.sin(quick * w + phase[1])
        )
        return out

    return at


def moved(path: Path, by: Path) -> Path:
    """A path with another one's places added to it."""
    return lambda t: path(t) + by(t)


def from_then(start_s: float, m_s2: tuple[float, float, float]) -> Path:
    """Nowhere until `start_s`, then off with an even acceleration: a thing that leaves."""

    def at(t: FloatArray) -> FloatArray:
        since = np.maximum(t - start_s, 0.0)[:, None]
        out: FloatArray = 0.5 * since**2 * np.array(m_s2)
        return out

    return at


def bounces(flights_s: tuple[float, ...], floor_z: float, across: Path) -> Path:
    """A ball that bounces under gravity: flights of these lengths over and over (a shorter one after each bounce, the
    first again by the hand that throws), the lowest place at `floor_z`; `across` gives x and y."""
    starts = np.concatenate([[0.0], np.cumsum(flights_s)])

    def at(t: FloatArray) -> FloatArray:
        within = np.mod(t, starts[-1])
        k = np.clip(np.searchsorted(starts, within, side="right") - 1, 0, len(flights_s) - 1)
        since = within - starts[k]
        out = across(t)
        out[:, 2] = floor_z + 0.5 * GRAVITY * since * (np.array(flights_s)[k] - since)
        return out

    return at


def pendulum(pivot: tuple[float, float, float], length_m: float, swing_rad: float, away: float, phase: float) -> Path:
    """A ball on a string, swinging across the view by `swing_rad` and by `away` of that towards the camera."""
    rate = np.sqrt(GRAVITY / length_m) * (1 - swing_rad**2 / 16)

    def at(t: FloatArray) -> FloatArray:
        a, b = swing_rad * np.sin(rate * t + phase), away * swing_rad * np.cos(rate * t + phase)
        down = np.sqrt(np.maximum(1 - np.sin(a) ** 2 - np.sin(b) ** 2, 0))
        out: FloatArray = pivot + length_m * np.stack([np.sin(a), np.sin(b), -down], axis=1)
        return out

    return at


def stops(at_s: list[float], values: list[float], move_s: float) -> Number:
    """Values that are reached smoothly at `at_s`, each set off for `move_s` before, and kept until the next."""

    def at(t: FloatArray) -> FloatArray:
        out = np.full(len(t), values[0])
        for s, before, after in zip(at_s[1:], values[:-1], values[1:], strict=True):
            x = np.clip((t - s) / move_s + 1, 0, 1)
            out = out + (after - before) * x * x * x * (10 - 15 * x + 6 * x * x)
        return out

    return at


def limb(base: Path, heading_rad: float, off_m: Number, half_m: float, radius_m: float, paint: Paint) -> Capsule:
    """A limb across the view whose middle is `off_m` from a moving place, along `heading_rad` from x to z; it lies
    square to that, leaning a little in depth."""
    e = np.array([np.cos(heading_rad), 0.0, np.sin(heading_rad)])
    f = np.array([-np.sin(heading_rad), 0.25, np.cos(heading_rad)])

    def end(side: float) -> Path:
        def at(t: FloatArray) -> FloatArray:
            out: FloatArray = base(t) + off_m(t)[:, None] * e + side * half_m * f
            return out

        return at

    return Capsule(end(-1.0), end(1.0), radius_m, paint)


def part_way(path: Path, eye_z_m: float, share: float) -> Path:
    """The place at `share` of the way from the camera to a moving thing."""
    eye = np.array([0.0, 0.0, eye_z_m])
    return lambda t: eye + share * (path(t) - eye)


def beside(path: Path, towards: tuple[float, float, float], metres: float) -> Path:
    """The place so far from a moving thing in a direction: towards the sun it shades the thing."""
    unit = np.array(towards) / np.linalg.norm(towards)
    return lambda t: path(t) + metres * unit


def wheel(
    hub: Path, count: int, reach_m: tuple[float, float], radius_m: float, turn_rad: Number, paint: Paint, tyre: Paint
) -> tuple[Capsule, ...]:
    """Spokes from one distance to another about a hub, in a plane square to y that leans a little, and a rim of as many
    straight pieces as there are spokes, twice as thick."""

    def point(k: int, far_m: float) -> Path:
        def at(t: FloatArray) -> FloatArray:
            angle = turn_rad(t) + 2 * np.pi * k / count
            x, z = far_m * np.cos(angle), far_m * np.sin(angle)
            out: FloatArray = hub(t) + np.stack([x, 0.12 * x, z], axis=1)
            return out

        return at

    spokes = [Capsule(point(k, reach_m[0]), point(k, reach_m[1]), radius_m, paint) for k in range(count)]
    rim = [Capsule(point(k, reach_m[1]), point(k + 1, reach_m[1]), 2 * radius_m, tyre) for k in range(count)]
    return (*spokes, *rim)
