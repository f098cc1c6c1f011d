"""What the second renderer's world is made of: spheres, capsules, boxes, two planes, daylight, a camera.

Everything stands on a stage: x right, y away from the camera, z up, metres, the ground at z = 0 and the camera above
its origin. `View` says how the camera looks at it; truth is in the camera's optical frame.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera

FloatArray = npt.NDArray[np.float64]
Path = Callable[[FloatArray], FloatArray]
"""Times (N,) in seconds -> places (N, 3) on the stage in metres."""
Rgb = tuple[float, float, float]
"""Linear red, green, blue: an albedo in 0..1, or light where 1 makes white of a white surface."""
Axis = tuple[float, float, float]
Pattern = Literal["plain", "mottled", "printed", "striped", "skin", "cloth"]
Ground = Literal["asphalt", "planks", "grass", "floor"]
Wall = Literal["plaster", "planks", "brick", "hedge"]


@dataclass(frozen=True)
class Paint:
    """A surface. `strength` is how far the pattern changes `albedo` (mottled, skin, cloth) or how wholly it puts
    `second` in its place (printed, striped); `scale` is its features per metre, or the number of stripes. `gloss`
    scales the reflection of a clear coat (0: matt), `exponent` how narrow its highlight is.
    """

    albedo: Rgb
    second: Rgb = (0.02, 0.02, 0.025)
    pattern: Pattern = "plain"
    scale: float = 200.0
    strength: float = 0.0
    gloss: float = 0.0
    exponent: float = 60.0


@dataclass(frozen=True)
class Strap:
    """A band around a sphere that turns with it: the part of a slightly larger sphere (by `thick` of the radius)
    between two planes across `axis`, `half_width` of the radius to either side of `offset` of the radius from the
    centre.
    """

    axis: Axis = (1.0, 0.0, 0.0)
    offset: float = 0.0
    half_width: float = 0.2
    thick: float = 0.04
    paint: Paint = Paint((0.02, 0.02, 0.022), pattern="cloth", scale=900.0, strength=0.4)


@dataclass(frozen=True)
class Sphere:
    """A sphere on a path, turning about `spin_axis`; the `tracked` ones are the session's markers."""

    name: str
    path: Path
    diameter_m: float
    paint: Paint
    spin_axis: Axis = (0.0, 0.0, 1.0)
    spin_rad_s: float = 0.0
    turn_rad: float = 0.0
    strap: Strap | None = None
    tracked: bool = True


@dataclass(frozen=True)
class Capsule:
    """A cylinder with round ends: a limb, a spoke, a tube. `start` and `end` are the paths of its ends' centres."""

    start: Path
    end: Path
    radius_m: float
    paint: Paint


@dataclass(frozen=True)
class Box:
    """A box with its edges along the stage's axes; `half_m` are its half edges."""

    path: Path
    half_m: tuple[float, float, float]
    paint: Paint


@dataclass(frozen=True)
class Patch:
    """A round spot of paint on the ground (x, y) or on the wall (x, z)."""

    on: Literal["ground", "wall"]
    place_m: tuple[float, float]
    radius_m: float
    albedo: Rgb


@dataclass(frozen=True)
class Stage:
    """The ground at z = 0 and a wall `wall_m` away and `wall_height_m` high, over which the sky is seen."""

    ground: Ground = "asphalt"
    ground_albedo: Rgb = (0.16, 0.16, 0.16)
    wall: Wall = "brick"
    wall_albedo: Rgb = (0.30, 0.16, 0.11)
    wall_m: float = 6.0
    wall_height_m: float = 3.0
    patches: tuple[Patch, ...] = ()


@dataclass(frozen=True)
class Daylight:
    """Irradiance on the stage. A surface that faces up gets `sky`, one that faces down `bounce`, others the mean by
    their slope (hemisphere lighting); one square to the sun gets `sun` besides, from `sun_from` (towards it)."""

    sky: Rgb = (0.30, 0.34, 0.42)
    bounce: Rgb = (0.12, 0.11, 0.09)
    sun: Rgb = (0.50, 0.48, 0.43)
    sun_from: Axis = (-0.5, -0.5, 0.7)


@dataclass(frozen=True)
class Glare:
    """Light scattered in the lens: a blurred spot added to the picture, and how much of `colour` it adds at its middle.
    `middle` and `sigma` are in parts of the picture's width and height, and width; 0.0 is none."""

    strength: float = 0.0
    middle: tuple[float, float] = (0.5, 0.5)
    sigma: float = 0.2
    colour: Rgb = (1.0, 0.97, 0.9)
    everywhere: float = 0.0
    """The share of the spot's strength that lies over the whole picture."""


@dataclass(frozen=True)
class View:
    """Where the camera is: `height_m` above the ground, looking along +y, `down_rad` below the horizon."""

    height_m: float = 1.0
    down_rad: float = 0.12

    @cached_property
    def from_stage(self) -> FloatArray:
        """The rotation (3, 3) that takes stage directions to the optical frame: x right, y down, z forward."""
        c, s = np.cos(self.down_rad), np.sin(self.down_rad)
        return np.array([[1.0, 0.0, 0.0], [0.0, -s, -c], [0.0, c, -s]])

    def to_camera(self, xyz_m: FloatArray) -> FloatArray:
        """Places (N, 3) on the stage -> in the optical frame."""
        out: FloatArray = (xyz_m - (0.0, 0.0, self.height_m)) @ self.from_stage.T
        return out

    def to_stage(self, xyz_cam_m: FloatArray) -> FloatArray:
        """Places (N, 3) in the optical frame -> on the stage."""
        out: FloatArray = xyz_cam_m @ self.from_stage + (0.0, 0.0, self.height_m)
        return out


@dataclass(frozen=True)
class Electronics:
    """What the camera does from light to its encoder, each step a switch.

    Light is multiplied by `gain`; a pixel holds `full_well_e` electrons of light 1 before it, so little light means
    much gain means much noise. `read_e` is the read noise in electrons; `noise` False leaves all noise out. `psf_px`
    is the lens blur's sigma, `smooth` the strength of the noise reduction (a bilateral filter's range in code values;
    0 off), `sharpen` that of the unsharp mask with sigma `sharpen_px`, `shoulder` where in linear light the tone
    curve begins to bend away from sRGB's (1: never). `siting` is where chroma lies in 4:2:0: "left" as H.264 has it,
    "centre" as converters from RGB leave it without saying so. `megabits` is the bit rate in Mbit/s at 240 frames/s,
    falling with the frame rate.
    """

    exposure_s: float = 1 / 1000
    readout_s: float = 0.0
    gain: float = 1.0
    full_well_e: float = 9000.0
    read_e: float = 5.0
    noise: bool = True
    psf_px: float = 0.55
    smooth: float = 0.0
    sharpen: float = 0.0
    sharpen_px: float = 1.2
    shoulder: float = 0.7
    siting: Literal["left", "centre"] = "left"
    megabits: float = 60.0


@dataclass(frozen=True)
class DayWorld:
    """Everything a session shows, and when.

    `ticks` are the pictures' container stamps in units of `time_base` seconds, rising from 0. `sample_aspect` is a
    stored pixel's width over its height, written in the container unless `says_aspect` is False; `camera` is in stored
    pixels, so its fx_px is fy_px over the aspect. `edge_samples` rays are cast per pixel where something ends or moves.
    """

    name: str
    camera: Camera
    ticks: tuple[int, ...]
    time_base: Fraction
    spheres: tuple[Sphere, ...]
    capsules: tuple[Capsule, ...] = ()
    boxes: tuple[Box, ...] = ()
    stage: Stage = field(default_factory=Stage)
    daylight: Daylight = field(default_factory=Daylight)
    glare: Glare = field(default_factory=Glare)
    view: View = field(default_factory=View)
    electronics: Electronics = field(default_factory=Electronics)
    sample_aspect: Fraction = Fraction(1)
    says_aspect: bool = True
    edge_samples: int = 40
    seed: int = 0

    def __post_init__(self) -> None:
        if self.camera.model != "none":
            raise ValueError(f"the ray caster has a pinhole camera, not {self.camera.model}")

    @property
    def markers(self) -> tuple[Sphere, ...]:
        """The tracked spheres, in the order they were given."""
        return tuple(sphere for sphere in self.spheres if sphere.tracked)
