"""Scenarios of strokes: what each session shows, by name. All of one's randomness comes from its seed.

"strokes@120" is "strokes" filmed at 120 frames/s: the same strokes, on every second of its frames.
"""

from dataclasses import dataclass, replace

import numpy as np

from spheremcap.core.camera import Camera
from spheremcap.synth.kinematics import JOINTS, Path
from spheremcap.synth.parts import Athlete, Ball, Hoop, Vibration, World
from spheremcap.synth.ride import Ride, circle
from spheremcap.synth.scenarios import FRAME_S, HALL, SHAKE, SIX, TICKS, world
from spheremcap.synth.strokes import Manner, Mount, motion

CAMERA = Camera(
    1280, 720, 880.0, 880.0, 639.5, 359.5, "plumb_bob", (-0.2, 0.05, 0.0, 0.0),
    source="made up: an action camera's medium mode, about 79 degrees across",
)  # fmt: skip
USUAL, LOW = Mount(), Mount((1.08, 0.0, 0.50), float(np.radians(15.0)))
"""Where the camera is. From `LOW` another marker hides a part of the wrist's at nearly every contact and release."""
ROLLERS = Vibration(rotation_mrad=0.1, translation_mm=0.05)
"""How the camera shakes indoors, where the recorded athlete was; on the road it is `SHAKE`."""
RATES = (240, 120, 60)
"""Frames/s, times 1000/1001."""
FRAMES = 2640
_BEHIND_M = np.array([0.025, 0.0, 0.0])
"""How far a limb's middle is behind its marker."""


@dataclass(frozen=True)
class StrokeScenario:
    """A session that can be rendered: one line on it, how the athlete pushes, and where the camera is."""

    about: str
    manner: Manner
    mount: Mount = USUAL
    vibration: Vibration = ROLLERS


def described(name: str) -> StrokeScenario:
    """A scenario, at whatever rate. Raises KeyError."""
    scenario, rate = _parted(name)
    return scenario if rate == RATES[0] else replace(scenario, about=f"{scenario.about}; {rate} frames/s")


def build(name: str, *, seed: int = 0, frames: int | None = None) -> World:
    """The world of a scenario with `frames` pictures (its usual number when None). Raises KeyError."""
    return _made(name, seed, frames)[0]


def ride(name: str, *, seed: int = 0, frames: int | None = None) -> Ride:
    """The strokes of a scenario and their exact truth. Raises KeyError."""
    return _made(name, seed, frames)[1]


def _parted(name: str) -> tuple[StrokeScenario, int]:
    base, at, rate = name.partition("@")
    rates = {str(known): known for known in RATES[1:]} | ({} if at else {"": RATES[0]})
    return STROKES[base], rates[rate]


def _made(name: str, seed: int, frames: int | None) -> tuple[World, Ride]:
    scenario, rate = _parted(name)
    step = RATES[0] // rate
    count = FRAMES // step if frames is None else frames
    if count < 1:
        raise ValueError(f"a session needs at least 1 frame, not {count}")
    rng = np.random.default_rng([seed, *name.partition("@")[0].encode()])
    # A shorter session is the beginning of the whole one.
    moved = motion(scenario.manner, max(FRAMES, count * step) * FRAME_S, rng)
    mount = scenario.mount
    made = Ride(moved, mount, CAMERA, (count - 1) * step * FRAME_S)
    paths = {joint: _path(made, joint) for joint in JOINTS}
    balls = tuple(Ball(joint, paths[joint], colour) for joint, colour in zip(JOINTS, SIX, strict=True))
    shown = world(
        count, *balls, camera=CAMERA, ticks=tuple(step * TICKS * k for k in range(count)), vibration=scenario.vibration,
        backdrop=HALL, athlete=_athlete(made, paths), beside=made.files(), name=name, seed=seed,
    )  # fmt: skip
    return shown, made


def _path(made: Ride, joint: str) -> Path:
    side, _, part = joint.partition("_")
    at = (made.motion.left if side == "left" else made.motion.right).joint(part)
    return lambda t_s: made.mount.to_camera(at(t_s))


def _athlete(made: Ride, paths: dict[str, Path]) -> Athlete:
    """The body on the markers' paths, straps under the markers, and the wheels' tyres, push rims and hubs."""
    behind = made.mount.axes @ _BEHIND_M

    def middle(path: Path) -> Path:
        return lambda t_s: path(t_s) - behind

    hoops = []
    for arm in made.motion.arms:
        for radius, thick, colour in (
            (made.motion.wheels.radius_m, 0.024, (38, 38, 40)),
            (made.motion.wheels.rim_radius_m, 0.016, (62, 64, 68)),
            (0.02, 0.02, (150, 152, 156)),
        ):
            hoops.append(Hoop(made.mount.to_camera(circle(arm, radius, 72)), thick, colour))
    joints = {joint: middle(path) for joint, path in paths.items()}
    return Athlete(joints=joints, hoops=tuple(hoops), strap_m=0.03)


STROKES: dict[str, StrokeScenario] = {
    "strokes": StrokeScenario("a racer's even strokes, six markers on strapped limbs, exact contacts", Manner()),
    "strokes-fast": StrokeScenario(
        "strokes at 2.1 Hz on the road, the wheels at 24 rad/s",
        Manner(cadence_hz=2.1, rates_rad_s=(24.0, 24.0)),
        vibration=SHAKE,
    ),
    "strokes-start": StrokeScenario(
        "strokes from slow to fast, the wheels from 9 to 20 rad/s",
        Manner(cadence_hz=1.5, rates_rad_s=(9.0, 20.0), contact_deg=40.0, release_deg=185.0),
    ),
    "strokes-missed": StrokeScenario(
        "strokes of which either hand misses some",
        Manner(missed=(("left", 3), ("right", 6), ("left", 10), ("right", 10), ("right", 14))),
    ),
    "strokes-brake": StrokeScenario(
        "strokes on the road, and a braking in the middle", Manner(braked=9), vibration=SHAKE
    ),
    "strokes-unequal": StrokeScenario(
        "strokes on the road whose left hand is late and takes hold later",
        Manner(left_lag_s=0.035, left_later_deg=12.0),
        vibration=SHAKE,
    ),
    "strokes-low": StrokeScenario(
        "even strokes seen from lower: markers hide wrists at contact and release", Manner(), LOW
    ),
}
