"""The second renderer's scenarios: what each session shows, by name. All of one's randomness comes from its seed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from spheremcap.core.camera import Camera
from spheremcap.synth.daylight.paths import (
    beside,
    bounces,
    from_then,
    limb,
    moved,
    part_way,
    pendulum,
    still,
    stops,
    sway,
    wheel,
)
from spheremcap.synth.daylight.world import (
    Box,
    Capsule,
    Daylight,
    DayWorld,
    Electronics,
    FloatArray,
    Glare,
    Paint,
    Patch,
    Path,
    Sphere,
    Stage,
    Strap,
    View,
)

CAMERA = Camera(1280, 720, 1150.0, 1150.0, 639.5, 359.5, source="made up: a pinhole as narrow as an action camera's")
TALL = Camera(960, 720, 862.5, 1150.0, 479.5, 359.5, source="made up: 1280x720 stored in pixels of 4:3")
VIEW = View(1.0, 0.12)
AHEAD = (0.0, 1.02, 0.88)
"""Near the middle of the picture, where a marker of 45 mm has a radius of 25 px."""
SKIN = Paint((0.42, 0.24, 0.17), pattern="skin", scale=55.0, strength=0.16, gloss=0.25, exponent=18.0)
DARK_SKIN = Paint((0.13, 0.07, 0.045), pattern="skin", scale=55.0, strength=0.16, gloss=0.4, exponent=22.0)
NAVY = Paint((0.03, 0.05, 0.14), pattern="cloth", scale=600.0, strength=0.4)
GREY = Paint((0.30, 0.30, 0.32), pattern="cloth", scale=500.0, strength=0.35)
STEEL = Paint((0.42, 0.43, 0.45), gloss=1.6, exponent=90.0)
TYRE = Paint((0.025, 0.025, 0.027), gloss=0.2)
OVERCAST = Daylight(sky=(0.66, 0.70, 0.76), bounce=(0.20, 0.20, 0.18), sun=(0.0, 0.0, 0.0))
LOW_SUN = Daylight(
    sky=(0.20, 0.25, 0.36), bounce=(0.10, 0.09, 0.07), sun=(0.86, 0.74, 0.55), sun_from=(-0.9, -0.35, 0.4)
)


@dataclass(frozen=True)
class Day:
    """A session that can be rendered: one line on it, its usual length, and how to make it from (rng, frames)."""

    about: str
    frames: int
    make: Callable[[np.random.Generator, int], DayWorld]


def build(name: str, *, seed: int = 0, frames: int | None = None) -> DayWorld:
    """The world of a scenario with `frames` pictures (its usual number when None). Raises KeyError."""
    day = DAYS[name]
    count = day.frames if frames is None else frames
    if count < 1:
        raise ValueError(f"a session needs at least 1 frame, not {count}")
    return replace(day.make(np.random.default_rng([seed, *name.encode()]), count), name=name, seed=seed)


def _world(frames: int, rate: int, *spheres: Sphere, **parts: object) -> DayWorld:
    """A world at `rate` * 1000 / 1001 frames/s; `parts` replace what is in it."""
    usual = DayWorld("", CAMERA, tuple(1001 * k for k in range(frames)), Fraction(1, 1000 * rate), spheres, view=VIEW)
    return replace(usual, **parts)  # type: ignore[arg-type]


def _mottled(r: float, g: float, b: float, gloss: float = 0.1) -> Paint:
    """A rough paint, nearly matt: a coat with more `gloss` mirrors what is around at its rim."""
    return Paint((r, g, b), pattern="mottled", scale=130.0, strength=0.10, gloss=gloss)


def _ball(path: Path, paint: Paint, diameter_m: float = 0.045, **more: object) -> Sphere:
    return replace(Sphere("marker", path, diameter_m, paint, (0.4, 0.5, 0.77), 4.0), **more)  # type: ignore[arg-type]


def _wander(rng: np.random.Generator, hz: float, size: tuple[float, float, float] = (0.34, 0.10, 0.15)) -> Path:
    return sway(rng, AHEAD, size, hz)


def _arm(path: Path, side: float, paint: Paint = SKIN, sleeve: Paint = NAVY) -> tuple[Capsule, Capsule]:
    """A forearm that holds a marker from behind, and a sleeved upper arm that comes from the picture's side."""

    def wrist(t: FloatArray) -> FloatArray:
        return path(t) + np.array([0.012 * side, 0.055, -0.012])

    def elbow(t: FloatArray) -> FloatArray:
        return 0.75 * path(t) + 0.25 * np.array(AHEAD) + np.array([0.23 * side, 0.16, -0.14])

    def shoulder(t: FloatArray) -> FloatArray:
        return elbow(t) + np.array([0.16 * side, 0.20, 0.42])

    return Capsule(wrist, elbow, 0.028, paint), Capsule(elbow, shoulder, 0.04, sleeve)


def _clean(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 0.7)
    return _world(
        frames, 240, _ball(path, _mottled(0.10, 0.42, 0.09)), capsules=_arm(path, 1.0),
        daylight=replace(Daylight(), sun_from=(-0.4, -0.7, 0.8)),
    )  # fmt: skip


def _sun(rng: np.random.Generator, frames: int) -> DayWorld:
    path, light = _wander(rng, 0.8), replace(LOW_SUN, sun_from=(-0.75, -0.25, 0.60))
    # A limb towards the sun lets its shadow come over the marker, half and wholly, and go.
    shade = limb(
        beside(path, light.sun_from, 0.24), 0.7,
        stops([0.0, 0.16, 0.34, 0.5, 0.68, 0.9], [0.3, 0.035, -0.3, -0.03, 0.0, 0.32], 0.1), 0.12, 0.035, DARK_SKIN,
    )  # fmt: skip
    return _world(
        frames, 240, _ball(path, _mottled(0.55, 0.30, 0.02, 0.8)), capsules=(*_arm(path, 1.0, DARK_SKIN, GREY), shade),
        daylight=light, stage=Stage("planks", (0.33, 0.22, 0.13), "plaster", (0.50, 0.48, 0.42)),
        electronics=Electronics(exposure_s=1 / 2500, readout_s=0.0034, gain=1.4, sharpen=0.2),
    )  # fmt: skip


def _strap(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 0.55)
    printed = Paint((0.62, 0.66, 0.03), (0.02, 0.03, 0.10), pattern="printed", strength=0.95, gloss=0.4)
    strap = Strap((0.9, 0.2, 0.4), 0.1, 0.17, 0.05)
    ball = _ball(path, printed, spin_axis=(0.3, 0.2, 0.9), spin_rad_s=3.1, strap=strap)
    return _world(
        frames, 120, ball, capsules=_arm(path, -1.0, SKIN, GREY),
        stage=Stage("grass", (0.12, 0.22, 0.05), "hedge", (0.08, 0.15, 0.04)),
        electronics=Electronics(exposure_s=1 / 500, readout_s=0.006, gain=1.2, sharpen=0.3, megabits=40.0),
    )  # fmt: skip


def _spokes(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 0.5, (0.16, 0.05, 0.10))
    speed = float(rng.uniform(6.0, 8.0))

    def turn(t: FloatArray) -> FloatArray:
        return speed * t + 0.3 * np.sin(4.1 * t)

    comb = wheel(still(-0.05, 0.82, 0.74), 13, (0.04, 0.25), 0.0055, turn, STEEL, TYRE)
    # Two limbs come over a part of the marker in turn.
    near = part_way(path, VIEW.height_m, 0.72)
    over = (
        limb(near, 0.3, stops([0.0, 0.25, 0.48, 0.9], [0.3, 0.036, 0.3, 0.3], 0.09), 0.11, 0.024, SKIN),
        limb(near, 2.2, stops([0.0, 0.62, 0.88, 1.2], [0.3, 0.037, 0.3, 0.3], 0.09), 0.11, 0.026, NAVY),
    )
    return _world(
        frames, 240, _ball(path, _mottled(0.50, 0.03, 0.22, 0.4)), capsules=(*comb, *over),
        daylight=replace(LOW_SUN, sun_from=(0.5, -0.6, 0.6)),
        stage=Stage("asphalt", (0.14, 0.14, 0.15), "planks", (0.26, 0.20, 0.15)),
        electronics=Electronics(exposure_s=1 / 1000, readout_s=0.003, gain=1.3),
    )  # fmt: skip


def _hidden(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 0.6)
    off, at, values, side = 0.22, [0.0], [0.22], 1.0
    time = 24 / 240
    for hidden in (6, 12, 24, 40):
        side = -side
        at += [time, time + (hidden + 5) / 240]
        values += [0.0, side * off]
        time += (hidden + 32) / 240
    over = limb(part_way(path, VIEW.height_m, 0.8), 0.35, stops(at, values, 9 / 240), 0.2, 0.036, SKIN)
    return _world(
        frames, 240, _ball(path, _mottled(0.04, 0.14, 0.48)), capsules=(over,),
        stage=Stage("floor", (0.30, 0.24, 0.16), "plaster", (0.36, 0.42, 0.46)),
        daylight=replace(OVERCAST, sun=(0.12, 0.12, 0.11)),
        electronics=Electronics(exposure_s=1 / 800, readout_s=0.0036, sharpen=0.15),
    )  # fmt: skip


def _small(rng: np.random.Generator, frames: int) -> DayWorld:
    path = sway(rng, (0.0, 4.6, 0.62), (1.1, 0.95, 0.42), 0.35)
    light = Daylight((0.10, 0.12, 0.17), (0.06, 0.05, 0.04), (1.0, 0.90, 0.72), (-0.95, -0.1, 0.25))
    return _world(
        frames, 120, _ball(path, _mottled(0.60, 0.06, 0.03, 0.2)), daylight=light,
        stage=Stage("asphalt", (0.15, 0.15, 0.15), "brick", (0.28, 0.20, 0.15), 9.0, 3.5),
        electronics=Electronics(exposure_s=1 / 1000, readout_s=0.005, gain=1.6, sharpen=0.25),
    )  # fmt: skip


def _dark(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 0.7)
    dim = Daylight((0.028, 0.030, 0.036), (0.010, 0.009, 0.008), (0.012, 0.010, 0.007), (0.5, -0.6, 0.5))
    return _world(
        frames, 240, _ball(path, _mottled(0.08, 0.40, 0.10, 0.3)), capsules=_arm(path, 1.0), daylight=dim,
        stage=Stage("floor", (0.20, 0.18, 0.16), "planks", (0.22, 0.17, 0.13)),
        electronics=Electronics(
            exposure_s=1 / 400, readout_s=0.0036, gain=16.0, full_well_e=7000.0, read_e=4.0, smooth=32.0, sharpen=0.5
        ),
    )  # fmt: skip


def _blur(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 2.2, (0.34, 0.06, 0.13))
    return _world(
        frames, 240, _ball(path, _mottled(0.66, 0.22, 0.02)), daylight=OVERCAST,
        stage=Stage("grass", (0.10, 0.19, 0.05), "hedge", (0.09, 0.14, 0.05)),
        electronics=Electronics(exposure_s=0.8 * 1001 / 240_000, readout_s=0.0036, gain=0.9),
    )  # fmt: skip


def _thrown(rng: np.random.Generator) -> Path:
    return bounces((0.82, 0.70, 0.60, 0.51), 0.05, sway(rng, (0.0, 2.5, 0.0), (0.75, 0.3, 0.0), 0.22))


def _thirty(rng: np.random.Generator, frames: int) -> DayWorld:
    ball = _ball(
        _thrown(rng), Paint((0.70, 0.52, 0.03), (0.5, 0.5, 0.5), "striped", 6.0, 0.35, 0.5), 0.10, spin_rad_s=6.0
    )
    return _world(
        frames, 30, ball, stage=Stage("planks", (0.36, 0.25, 0.15), "plaster", (0.30, 0.36, 0.40), 5.0, 4.0),
        electronics=Electronics(exposure_s=1 / 250, readout_s=0.016, sharpen=0.4, megabits=80.0),
    )  # fmt: skip


def _streak(rng: np.random.Generator, frames: int) -> DayWorld:
    return _world(
        frames, 30, _ball(_thrown(rng), _mottled(0.6, 0.04, 0.05), 0.05),
        stage=Stage("planks", (0.36, 0.25, 0.15), "plaster", (0.30, 0.36, 0.40), 5.0, 4.0),
        electronics=Electronics(exposure_s=1 / 40, readout_s=0.012, sharpen=0.2, megabits=60.0),
    )  # fmt: skip


def _film(rng: np.random.Generator, frames: int) -> DayWorld:
    pivot = (0.0, 1.85, 1.9)
    path = pendulum(pivot, 1.15, 0.34, 0.35, float(rng.uniform(0, 2 * np.pi)))
    string = Capsule(still(*pivot), path, 0.0012, Paint((0.5, 0.5, 0.45)))
    ball = _ball(path, _mottled(0.05, 0.32, 0.42, 0.9), 0.08, spin_rad_s=1.0)
    return _world(
        frames, 24, ball, capsules=(string,), daylight=replace(OVERCAST, sun=(0.2, 0.19, 0.17)),
        stage=Stage("floor", (0.34, 0.28, 0.22), "brick", (0.34, 0.22, 0.16), 4.0, 4.0),
        electronics=Electronics(
            exposure_s=1 / 60, readout_s=0.018, gain=0.9, sharpen=0.9, sharpen_px=1.5, megabits=70.0
        ),
    )  # fmt: skip


def _gone(rng: np.random.Generator, frames: int) -> DayWorld:
    length_s = frames * 1001 / 60_000
    path = moved(_wander(rng, 0.45, (0.26, 0.10, 0.12)), from_then(0.5 * length_s, (2.6, 0.0, 0.0)))
    colour = (0.62, 0.10, 0.04)
    rolls = moved(still(-1.75, 2.8, 0.055), from_then(0.62 * length_s, (1.3, 0.0, 0.0)))
    decoy = Sphere("", rolls, 0.11, _mottled(0.56, 0.12, 0.05), (0.0, 1.0, 0.0), 5.0, tracked=False)
    crate = Box(still(0.62, 2.4, 0.09), (0.13, 0.10, 0.09), Paint((0.54, 0.13, 0.06), pattern="mottled", strength=0.1))
    spots = (
        Patch("ground", (-0.30, 3.1), 0.08, colour),
        Patch("wall", (-0.9, 0.75), 0.07, (0.52, 0.11, 0.05)),
    )
    return _world(
        frames, 60, _ball(path, _mottled(*colour, 0.3)), decoy, boxes=(crate,),
        stage=Stage("asphalt", (0.17, 0.17, 0.17), "plaster", (0.42, 0.40, 0.36), 5.0, 2.6, spots),
        electronics=Electronics(exposure_s=1 / 500, readout_s=0.010, sharpen=0.2),
    )  # fmt: skip


def _glare(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 0.7)
    light = Daylight((0.34, 0.38, 0.44), (0.22, 0.21, 0.19), (0.72, 0.68, 0.60), (-0.3, -0.8, 0.5))
    return _world(
        frames, 240, _ball(path, _mottled(0.16, 0.46, 0.62, 0.6)), daylight=light,
        stage=Stage("floor", (0.52, 0.51, 0.48), "plaster", (0.82, 0.82, 0.80), 3.0, 3.5),
        glare=Glare(0.40, (0.32, 0.25), 0.22, everywhere=0.15),
        electronics=Electronics(exposure_s=1 / 2000, readout_s=0.0036, shoulder=0.6),
    )  # fmt: skip


def _centre(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 0.8)
    return _world(
        frames, 240, _ball(path, _mottled(0.58, 0.02, 0.03, 0.3)), capsules=_arm(path, -1.0),
        daylight=replace(Daylight(), sun_from=(0.6, -0.6, 0.6)),
        stage=Stage("grass", (0.10, 0.24, 0.05), "hedge", (0.07, 0.17, 0.04)),
        electronics=Electronics(exposure_s=1 / 1500, readout_s=0.0, siting="centre"),
    )  # fmt: skip


def _wide_pixels(rng: np.random.Generator, frames: int) -> DayWorld:
    path = _wander(rng, 0.25, (0.30, 0.10, 0.15))
    return _world(
        frames, 50, _ball(path, _mottled(0.30, 0.05, 0.45)), camera=TALL, capsules=_arm(path, 1.0, DARK_SKIN, GREY),
        sample_aspect=Fraction(4, 3),
        stage=Stage("asphalt", (0.2, 0.2, 0.2), "brick", (0.36, 0.30, 0.22)),
        electronics=Electronics(exposure_s=1 / 500, readout_s=0.012, sharpen=0.2),
    )  # fmt: skip


DAYS: dict[str, Day] = {
    "day-clean": Day("one marker on a forearm in plain daylight, a global shutter", 240, _clean),
    "day-sun": Day("a low hard sun; a limb's shadow comes over the marker", 240, _sun),
    "day-strap": Day("a printed ball that turns in a dark strap, 120 frames/s, before grass", 240, _strap),
    "day-spokes": Day("a wheel's spokes turn before the marker and limbs hide a part of it", 240, _spokes),
    "day-hidden": Day("a forearm hides the marker for about 6, 12, 24 and 40 frames", 260, _hidden),
    "day-small": Day("a marker far away, r = 4 to 7 px, lit from one side, 120 frames/s", 240, _small),
    "day-dark": Day("little light: noise, noise reduction and sharpening", 240, _dark),
    "day-blur": Day("up to 20 px of motion blur, the shutter open for 0.8 of the time", 240, _blur),
    "day-thirty": Day("30 frames/s: a ball that is thrown and bounces", 200, _thirty),
    "day-streak": Day("a small ball is thrown in little light: streaks of up to two diameters", 120, _streak),
    "day-film": Day("24 frames/s: a pendulum, strongly sharpened", 200, _film),
    "day-gone": Day("60 frames/s: the marker leaves for good, things of its colour stay or come", 240, _gone),
    "day-glare": Day("a pale marker before a white wall in the sun, with glare in the lens", 240, _glare),
    "day-centre": Day("chroma sited at the centre as converters from RGB leave it, and not said", 240, _centre),
    "day-wide-pixels": Day("stored pixels a third wider than high, said in the stream, 50 frames/s", 200, _wide_pixels),
}
