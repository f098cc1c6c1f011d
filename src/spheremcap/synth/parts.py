"""What a rendered session is made of: balls, cards, an athlete, a backdrop, light, sensor, shaking mount."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera
from spheremcap.synth.kinematics import Path, chair_to_camera, joint_chair_m
from spheremcap.synth.motion import shaken, shaking

FloatArray = npt.NDArray[np.float64]
Signal = Callable[[FloatArray], FloatArray]
"""Times (N,) in seconds -> values (N,)."""


@dataclass(frozen=True)
class Ball:
    """A sphere on a path. `colour` is its sRGB (red, green, blue) in 0..255 under full light.

    `tracked` ones are the session's markers; the others are distractors. `gloss` is the strength of the
    specular spot, `ambient` the part of the light that comes from everywhere (1: no shading at all), `grain`
    the relative strength of the surface's own mottling.
    """

    name: str
    path: Path
    colour: tuple[int, int, int]
    diameter_m: float = 0.04
    tracked: bool = True
    gloss: float = 0.35
    ambient: float = 0.35
    grain: float = 0.06


@dataclass(frozen=True)
class Card:
    """A flat rectangle that faces the camera: an occluder when it is nearer than a ball, scenery when
    farther.

    `path` gives (N, 3) of times (N,): centre x and y in pixels and the angle of its long side in radians.
    `texture` is "" for one colour or the name of a photograph.
    """

    path: Callable[[FloatArray], FloatArray]
    half_px: tuple[float, float]
    depth_m: float
    colour: tuple[int, int, int] = (60, 60, 66)
    texture: str = ""


@dataclass(frozen=True)
class Hoop:
    """A closed line that is fixed to the chair: points (N, 3) in the optical frame of the camera at rest."""

    xyz_m: FloatArray
    thick_m: float
    colour: tuple[int, int, int]


@dataclass(frozen=True)
class Athlete:
    """A racer's body behind the markers: trunk, head and two arms.

    The joints are those of the recording, `start_s` into the cycle, or on the paths of `joints`, by name. Round the
    limbs, at the joints, are straps that are `strap_m` wide (0: none); `hoops` are the chair's wheels.
    """

    start_s: float = 0.0
    skin: tuple[int, int, int] = (176, 128, 104)
    jersey: tuple[int, int, int] = (36, 44, 70)
    joints: Mapping[str, Path] | None = None
    strap_m: float = 0.0
    hoops: tuple[Hoop, ...] = ()

    def joint(self, name: str) -> Path:
        """The path of the middle of a limb's end: a little behind its marker, which sits on the limb's outside."""
        if self.joints is not None:
            return self.joints[name]
        return lambda t_s: chair_to_camera(joint_chair_m(name, t_s + self.start_s) - (0.025, 0.0, 0.0))


@dataclass(frozen=True)
class Backdrop:
    """A mirrored, enlarged photograph that drifts behind everything, by up to `drift_px` from its middle."""

    photograph: str = "motorcycle"
    enlarge: float = 2.0
    drift_px: tuple[float, float] = (60.0, 25.0)
    drift_hz: tuple[float, float] = (0.5, 0.37)
    brightness: float = 1.0


@dataclass(frozen=True)
class Light:
    """One distant lamp that wanders, and the scene's brightness over time (1: white is just white)."""

    level: Signal | None = None
    wander_hz: float = 0.4
    direction: tuple[float, float, float] = (-0.45, -0.75, -0.55)
    """From the scene to the lamp, optical frame; the default shines from above left and behind the camera."""


@dataclass(frozen=True)
class Sensor:
    """Exposure, read-out and what the camera's electronics do.

    `readout_s` is the time from the first row's exposure to the last one's (0: global shutter). `full_well_e`
    is the electrons of a white pixel, `read_e` the read noise in electrons, `psf_px` the lens blur's sigma,
    `sharpen` the strength of the camera's unsharp mask. `noise` False leaves noise and sharpening out.
    """

    exposure_s: float = 1 / 960
    readout_s: float = 0.0036
    full_well_e: float = 4000.0
    read_e: float = 8.0
    psf_px: float = 0.6
    sharpen: float = 0.25
    noise: bool = True


@dataclass(frozen=True)
class Vibration:
    """The mount's shaking: sums of sines; rotation in mrad and translation in mm, about and along x, y, z."""

    rotation_mrad: float = 0.0
    translation_mm: float = 0.0
    frequencies_hz: tuple[float, ...] = (17.3, 31.1, 58.7)

    def move(self, xyz_cam_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """Positions (N, 3) in the resting camera's frame -> in the shaking camera's frame at times (N,)."""
        if self.rotation_mrad == 0 and self.translation_mm == 0:
            return xyz_cam_m
        # p + turn x p + shift: the angles are small.
        return shaken(np.ascontiguousarray(xyz_cam_m), np.ascontiguousarray(t_s), *self._params)

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotation vectors (N, 3) in radians and translations (N, 3) in metres at times (N,)."""
        return shaking(np.ascontiguousarray(t_s), *self._params)

    @cached_property
    def _params(self) -> tuple[FloatArray, float, float]:
        return np.array(self.frequencies_hz, np.float64), self.rotation_mrad * 1e-3, self.translation_mm * 1e-3


@dataclass(frozen=True)
class World:
    """Everything a session shows, and when: what a scenario makes and `Scene` renders.

    `ticks` are the pictures' container stamps in units of `time_base` seconds, rising from 0. `beside` are texts that
    are written beside the video, by the names of their files.
    """

    name: str
    camera: Camera
    ticks: tuple[int, ...]
    time_base: Fraction
    balls: tuple[Ball, ...]
    cards: tuple[Card, ...] = ()
    athlete: Athlete | None = None
    backdrop: Backdrop = field(default_factory=Backdrop)
    light: Light = field(default_factory=Light)
    sensor: Sensor = field(default_factory=Sensor)
    vibration: Vibration = field(default_factory=Vibration)
    seed: int = 0
    beside: Mapping[str, str] = field(default_factory=dict)

    @property
    def markers(self) -> tuple[Ball, ...]:
        """The tracked balls, in the order they were given."""
        return tuple(ball for ball in self.balls if ball.tracked)
