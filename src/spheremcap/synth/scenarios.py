"""The scenarios: what each session shows, by name. All of one's randomness comes from its seed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera
from spheremcap.synth.kinematics import JOINTS, Path, joint_path, through, wave
from spheremcap.synth.parts import Athlete, Backdrop, Ball, Card, Light, Sensor, Vibration, World

FloatArray = npt.NDArray[np.float64]
TIME_BASE = Fraction(1, 240_000)
TICKS = 1001
FRAME_S = TICKS / 240_000
NARROW = Camera(
    1280, 720, 1150.0, 1150.0, 639.5, 359.5, "plumb_bob", (-0.31, 0.17, 0.0, 0.0),
    source="published narrow-mode calibration of a HERO4 Silver at 1280 px",
)  # fmt: skip
WIDE = Camera(
    1280, 720, 585.0, 585.0, 639.5, 359.5, "fisheye", (0.035, -0.012, 0.004, -0.001),
    source="made up: an action camera's wide mode, about 118 degrees across",
)  # fmt: skip
GREEN, MAGENTA, ORANGE = (74, 196, 60), (214, 44, 140), (240, 128, 24)
BLUE, YELLOW, CYAN = (36, 92, 214), (234, 208, 36), (40, 190, 200)
RED, WHITE, DARK = (206, 28, 30), (232, 232, 228), (34, 36, 42)
SIX = (GREEN, MAGENTA, ORANGE, BLUE, YELLOW, CYAN)
"""The markers' colours where all joints have one, in the order of `JOINTS`."""
SHARP = Sensor(exposure_s=1 / 4000, full_well_e=9000.0, read_e=6.0)


Maker = Callable[[np.random.Generator, int], World]


@dataclass(frozen=True)
class Scenario:
    """A session that can be rendered: one line on it, its usual length, and how to make it from (rng,
    frames).
    """

    about: str
    frames: int
    make: Maker


def names() -> tuple[str, ...]:
    """The scenarios' names, in the order of the table."""
    return tuple(SCENARIOS)


def describe(name: str) -> str:
    """One line on a scenario. Raises KeyError when there is none of that name."""
    return SCENARIOS[name].about


def build(name: str, *, seed: int = 0, frames: int | None = None) -> World:
    """The world of a scenario with `frames` pictures (its usual number when None). Raises KeyError."""
    scenario = SCENARIOS[name]
    count = scenario.frames if frames is None else frames
    if count < 1:
        raise ValueError(f"a session needs at least 1 frame, not {count}")
    rng = np.random.default_rng([seed, *name.encode()])
    world = scenario.make(rng, count)
    return replace(world, name=name, seed=seed)


# --- paths that are given in the picture ---


def image_path(camera: Camera, place: Callable[[FloatArray], FloatArray]) -> Path:
    """The path of a point from `place`: times (N,) -> (N, 3) x and y in pixels of the undistorted picture, z
    in m.
    """

    def at(t_s: FloatArray) -> FloatArray:
        p = place(np.asarray(t_s, np.float64))
        x, y = (p[:, 0] - camera.cx_px) / camera.fx_px, (p[:, 1] - camera.cy_px) / camera.fy_px
        return np.stack([x * p[:, 2], y * p[:, 2], p[:, 2]], axis=1)

    return at


def loop(
    camera: Camera, rng: np.random.Generator, middle: tuple[float, float], size: tuple[float, float],
    depth: tuple[float, float], hz: float,
) -> Path:  # fmt: skip
    """A smooth closed wander: an ellipse in the picture with a wobble, its depth swinging between two ends in
    m.
    """
    p, q, s, w = rng.uniform(0, 2 * np.pi, 4)

    def place(t: FloatArray) -> FloatArray:
        x = middle[0] + wave(t, size[0], hz, p) + wave(t, 0.15 * size[0], 2.3 * hz, w)
        y = middle[1] + wave(t, size[1], hz, p + 1.3) + wave(t, 0.15 * size[1], 1.7 * hz, q)
        z = (depth[0] + depth[1]) / 2 + wave(t, (depth[1] - depth[0]) / 2, 0.6 * hz, s)
        return np.stack([x, y, z], axis=1)

    return image_path(camera, place)


def even_ticks(frames: int) -> tuple[int, ...]:
    """Container stamps at 240000/1001 frames/s."""
    return tuple(TICKS * k for k in range(frames))


def world(frames: int, *balls: Ball, **parts: object) -> World:
    """A world on the narrow camera at an even rate; `parts` replace what is in it."""
    return replace(World("", NARROW, even_ticks(frames), TIME_BASE, balls), **parts)  # type: ignore[arg-type]


def escort(
    path: Path, stops: list[tuple[int, float]], move: int, heading_rad: float
) -> Callable[[FloatArray], FloatArray]:
    """The path of a card that goes along with a marker of the narrow camera.

    `stops` are (frame, pixels from the marker's centre to the card's, along `heading_rad`): it gets there on
    that frame, having set off `move` frames before, and stays until it sets off for the next.
    """
    times = np.array([frame * FRAME_S for frame, _ in stops])
    away = through(times, np.array([[pixels] for _, pixels in stops]), move * FRAME_S)

    def at(t: FloatArray) -> FloatArray:
        pixel, far = NARROW.project(path(t)), away(t)[:, 0]
        x, y = pixel[:, 0] + far * np.cos(heading_rad), pixel[:, 1] + far * np.sin(heading_rad)
        return np.stack([x, y, np.full(len(t), heading_rad)], axis=1)

    return at


def edge_at(fraction: float) -> float:
    """Where a straight edge has to be, in radii from a disc's centre, to hide this fraction of the disc."""
    u = np.linspace(1, -1, 2001)
    return float(np.interp(fraction, (np.arccos(u) - u * np.sqrt(1 - u * u)) / np.pi, u))


# --- the scenarios ---

RACE_START_S = 0.30
SHAKE = Vibration(rotation_mrad=0.45, translation_mm=0.3)
HALL = Backdrop("motorcycle", 2.2, (14.0, 8.0), (0.9, 1.3))


def _race(frames: int, balls: tuple[Ball, ...], **parts: object) -> World:
    usual: dict[str, object] = {"athlete": Athlete(RACE_START_S), "backdrop": HALL, "vibration": SHAKE}
    return world(frames, *balls, **(usual | parts))


def _clean(rng: np.random.Generator, frames: int) -> World:
    ball = Ball("marker", loop(NARROW, rng, (640, 360), (330, 170), (0.8, 1.3), 0.7), GREEN)
    return world(frames, ball, sensor=SHARP)


def _racing(rng: np.random.Generator, frames: int) -> World:
    colours = (GREEN, MAGENTA)
    return _race(frames, tuple(Ball(n, joint_path(n, RACE_START_S), c) for n, c in zip(JOINTS, colours, strict=False)))


def _blur(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (400, 240), (0.65, 1.1), 2.2)
    return world(frames, Ball("marker", path, MAGENTA), vibration=SHAKE, backdrop=Backdrop("rocket", 2.4))


def _scale(rng: np.random.Generator, frames: int) -> World:
    wander = loop(NARROW, rng, (640, 360), (150, 90), (1.0, 1.0), 0.5)

    def path(t: FloatArray) -> FloatArray:
        there = 0.5 - 0.5 * np.cos(2 * np.pi * t / (frames * FRAME_S))
        out: FloatArray = wander(t) * (0.4 * (2.5 / 0.4) ** there)[:, None]
        return out

    return world(frames, Ball("marker", path, CYAN), backdrop=Backdrop("chelsea", 3.2))


def _partial(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (300, 150), (1.0, 1.0), 0.9)
    r_px, half_px, cards = NARROW.fx_px * 0.02, 110.0, []
    for start, colour in ((30, (150, 108, 86)), (95, (58, 60, 70))):
        stops = [(0, half_px + 8 * r_px)]
        for frame, fraction in zip(range(start, frames, 130), rng.permutation((0.3, 0.4, 0.5, 0.6)), strict=False):
            edge = edge_at(float(fraction))
            stops += [(frame, half_px + edge * r_px), (frame + 50, half_px + 8 * r_px)]
        moving = escort(path, stops, 12, float(rng.uniform(0, 2 * np.pi)))
        cards.append(Card(moving, (half_px, 90.0), 0.5, colour))
    return world(frames, Ball("marker", path, GREEN), cards=tuple(cards))


def _total(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (320, 160), (0.95, 1.1), 0.8)
    away, frame, stops = 200.0, 36, [(0, 200.0)]
    for hidden in (5, 10, 20, 40, 60):
        # It arrives, hides the marker for so long, and goes on to the other side.
        away = -away
        stops += [(frame, 0.0), (frame + hidden + 5, away)]
        frame += hidden + 45
    card = Card(escort(path, stops, 8, float(rng.uniform(0, np.pi))), (36.0, 110.0), 0.5, texture="brick")
    return world(frames, Ball("marker", path, ORANGE), cards=(card,), backdrop=Backdrop("rocket", 2.4))


def _reentry(rng: np.random.Generator, frames: int) -> World:
    p, q = rng.uniform(0, 2 * np.pi, 2)

    def place(t: FloatArray) -> FloatArray:
        x, y = 640 + wave(t, 770, 0.8, p * 0.05), 360 + wave(t, 250, 1.1, q)
        return np.stack([x, y, 1.0 + wave(t, 0.15, 0.5, p)], axis=1)

    return world(
        frames,
        Ball("marker", image_path(NARROW, place), MAGENTA),
        vibration=SHAKE,
        backdrop=Backdrop("coffee", 2.6),
    )


def _passing(path: Path, rng: np.random.Generator, nearest_px: float, nearer: float, hz: float) -> Path:
    """A path that comes by another one, `nearest_px` away at its nearest, at `nearer` times its distance."""
    phase, side = rng.uniform(0, 2 * np.pi), rng.choice((-1.0, 1.0))

    def at(t: FloatArray) -> FloatArray:
        xyz = path(t)
        x, y = wave(t, 320, hz, phase) / NARROW.fx_px, side * nearest_px / NARROW.fx_px
        moved = xyz + np.stack([x * xyz[:, 2], y * xyz[:, 2] + 0 * t, 0 * t], axis=1)
        out: FloatArray = moved * nearer
        return out

    return at


def _similar_shape(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (260, 120), (0.95, 1.15), 0.8)
    others = (
        Ball("", _passing(path, rng, 40, 0.92, 0.9), MAGENTA, tracked=False),
        Ball("", _passing(path, rng, 12, 1.1, 0.65), WHITE, tracked=False),
        Ball("", _passing(path, rng, 28, 1.05, 1.3), BLUE, tracked=False),
    )
    return world(frames, Ball("marker", path, GREEN), *others, backdrop=Backdrop("astronaut", 2.6))


def _similar_colour(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (260, 120), (0.9, 1.1), 0.8)
    cards = []
    for half, hz, dy, shade in (
        ((70.0, 26.0), 0.9, 14.0, 1.0),
        ((30.0, 45.0), 1.3, -60.0, 0.85),
        ((90.0, 14.0), 0.6, 38.0, 1.1),
    ):
        phase = float(rng.uniform(0, 2 * np.pi))

        def at(t: FloatArray, hz: float = hz, dy: float = dy, phase: float = phase) -> FloatArray:
            pixel = NARROW.project(path(t))
            return np.stack([pixel[:, 0] + wave(t, 330, hz, phase), pixel[:, 1] + dy, wave(t, 1.2, 0.5, phase)], axis=1)

        colour = tuple(int(min(255, c * shade)) for c in ORANGE)
        cards.append(Card(at, half, 2.0, colour))  # type: ignore[arg-type]
    return world(frames, Ball("marker", path, ORANGE), cards=tuple(cards))


def _crossing(rng: np.random.Generator, frames: int) -> World:
    p, q = rng.uniform(0, 2 * np.pi, 2)

    def placed(side: float, depth: float) -> Path:
        def place(t: FloatArray) -> FloatArray:
            x = 640 + side * wave(t, 300, 0.75, p)
            y = 360 + side * wave(t, 16, 0.4, q) + wave(t, 140, 0.5, p)
            return np.stack([x, y, depth + 0 * t], axis=1)

        return image_path(NARROW, place)

    balls = (Ball("near", placed(1.0, 0.9), YELLOW), Ball("far", placed(-1.0, 1.15), YELLOW))
    return world(frames, *balls, backdrop=Backdrop("coffee", 2.6))


def _exposure(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (300, 160), (0.85, 1.2), 0.7)
    # Steps at 0.2, 0.3, 0.8 and 0.88 of the session, slow ramps from 0.3 to 0.62 and at its end.
    parts = (0, 0.2, 0.2001, 0.3, 0.3001, 0.5, 0.62, 0.8, 0.8001, 0.88, 0.8801, 1)
    levels = (1.0, 1.0, 2.5, 2.5, 0.4, 0.15, 1.0, 1.0, 2.5, 2.5, 0.3, 1.0)

    def level(t: FloatArray) -> FloatArray:
        part = t / (frames * FRAME_S)
        mains = np.where((part > 0.64) & (part < 0.8), 1 + wave(t, 0.4, 100.0), 1.0)
        out: FloatArray = np.exp(np.interp(part, parts, np.log(levels))) * mains
        return out

    return world(frames, Ball("marker", path, CYAN), light=Light(level))


def _six(rng: np.random.Generator, frames: int) -> World:
    return _race(frames, tuple(Ball(n, joint_path(n, RACE_START_S), c) for n, c in zip(JOINTS, SIX, strict=True)))


def _small(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (330, 180), (3.45, 5.5), 0.7)
    return world(frames, Ball("marker", path, MAGENTA), backdrop=Backdrop("rocket", 2.4))


def _low_light(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (300, 160), (0.8, 1.2), 0.9)
    sensor = Sensor(exposure_s=1 / 480, full_well_e=700.0, read_e=4.0)
    return world(frames, Ball("marker", path, GREEN), sensor=sensor, light=Light(lambda t: np.full(len(t), 0.28)))


def _wide(rng: np.random.Generator, frames: int) -> World:
    # Without its distortion the wide lens' picture would be larger: 62 degrees are 1100 px from the middle.
    balls = (
        Ball("left", loop(WIDE, rng, (330, 360), (420, 260), (0.35, 0.6), 0.7), GREEN),
        Ball("right", loop(WIDE, rng, (950, 360), (420, 260), (0.35, 0.6), 0.6), MAGENTA),
    )
    return world(frames, *balls, camera=WIDE, backdrop=Backdrop("astronaut", 2.6))


def _coloured(colour: tuple[int, int, int], photograph: str, enlarge: float, gloss: float = 0.35) -> Maker:
    def make(rng: np.random.Generator, frames: int) -> World:
        path = loop(NARROW, rng, (640, 360), (320, 180), (0.8, 1.3), 1.0)
        return world(
            frames,
            Ball("marker", path, colour, gloss=gloss),
            backdrop=Backdrop(photograph, enlarge),
            vibration=SHAKE,
        )

    return make


STATIC_M = tuple(
    (x * z, y * z, z)
    for z, row in ((0.7, (-0.38, -0.19, 0.0, 0.19, 0.38)), (1.1, (0.38, 0.19, 0.0, -0.19, -0.38)),
                   (1.6, (-0.38, -0.19, 0.0, 0.19, 0.38)))
    for x, y in zip(row, (0.15, 0.03, -0.15, -0.02, 0.15), strict=True)
)  # fmt: skip
"""The 15 positions of the scenario "static", (x, y, z) in metres: five directions at each of three depths."""
STATIC_MOVE = 24
"""Frames in which the marker of "static" goes from one position to the next; it moves during the last ones.
"""


def _static(rng: np.random.Generator, frames: int) -> World:
    starts = np.linspace(0, frames * FRAME_S, len(STATIC_M), endpoint=False)
    path = through(starts, np.array(STATIC_M), STATIC_MOVE * FRAME_S)
    return world(frames, Ball("marker", path, GREEN), sensor=SHARP)


def _vfr(rng: np.random.Generator, frames: int) -> World:
    path = loop(NARROW, rng, (640, 360), (320, 170), (0.8, 1.2), 0.9)
    # One frame in nine is followed by one to four that were dropped; stamps jitter by up to 0.1 ms.
    gaps = np.where(rng.random(frames) < 1 / 9, rng.integers(2, 6, frames), 1)
    ticks = np.concatenate([[0], np.cumsum(gaps[1:] * TICKS) + rng.integers(-24, 25, frames - 1)])
    return world(frames, Ball("marker", path, BLUE), ticks=tuple(map(int, ticks)), backdrop=Backdrop("grass", 1.5))


SCENARIOS: dict[str, Scenario] = {
    "racing": Scenario(
        "the demo: a racer's wrists on propulsion paths, blur, shaking, leaving the picture", 480, _racing
    ),
    "clean": Scenario("one marker, short exposure, little noise, unhurried", 360, _clean),
    "blur": Scenario("one marker at up to 35 px a frame with an exposure of 1/960 s", 360, _blur),
    "scale": Scenario("from 0.4 m to 2.5 m and back", 480, _scale),
    "partial-occlusion": Scenario("cards hide 30 to 60 % of the marker, about 40 frames at a time", 480, _partial),
    "total-occlusion": Scenario("a card hides the marker for 5, 10, 20, 40 and 60 frames", 480, _total),
    "reentry": Scenario("the marker leaves the picture on both sides and comes back", 480, _reentry),
    "similar-shape": Scenario("balls of the same size and other colours pass in front and behind", 360, _similar_shape),
    "similar-colour": Scenario("cards of the marker's colour pass behind it and beside it", 360, _similar_colour),
    "crossing": Scenario("two markers of the same colour cross, the nearer over the farther", 480, _crossing),
    "exposure": Scenario(
        "exposure steps, slow ramps and 100 Hz flicker, 0.15 to 2.5 times, with clipping", 480, _exposure
    ),
    "six": Scenario("six markers on a racer: wrists, elbows and shoulders", 360, _six),
    "small": Scenario("a marker far away, r = 4 to 7 px", 360, _small),
    "low-light": Scenario("a dark picture with much noise, exposure 1/480 s", 360, _low_light),
    "wide": Scenario("a fisheye lens of 118 degrees, two markers out to its edges", 360, _wide),
    "red": Scenario("a red marker (hue wraps) before red things", 360, _coloured(RED, "motorcycle", 2.2)),
    "white": Scenario("a white marker", 360, _coloured(WHITE, "rocket", 2.4)),
    "dark": Scenario("a dark marker", 360, _coloured(DARK, "chelsea", 3.2, 0.15)),
    "static": Scenario("15 known positions, 0.7 to 1.6 m, held still", 600, _static),
    "vfr": Scenario("variable frame rate: dropped frames and jittering stamps", 360, _vfr),
}
