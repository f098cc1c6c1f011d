"""What is true of a marker on a frame, and what writes a rendered session: the nouns that both renderers share."""

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrImage
from spheremcap.core.time import ticks_to_ns
from spheremcap.synth.ahead import ahead

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse in pixels: centre, semi-axes a >= b, and the angle of a from +x towards +y in radians."""

    x_px: float
    y_px: float
    a_px: float
    b_px: float
    angle_rad: float


@dataclass(frozen=True, slots=True)
class MarkerTruth:
    """What is true of one marker on one frame.

    `circle` (pixels) has the outline's centroid and area, `ellipse` its second moments too, `centre_px` is
    the 3D centre's projection; None when the sphere is behind the camera or beyond 80 degrees off axis.
    `xyz_cam_m` (3,) and `velocity_cam_mps` (3,) are in the shaking camera's optical frame. `visible` in [0,
    1] is the part of the outline's area that is inside the picture and not covered; `in_picture` is whether
    the circle's centre is.
    """

    marker: str
    circle: Circle | None
    ellipse: Ellipse | None
    centre_px: tuple[float, float] | None
    xyz_cam_m: FloatArray
    velocity_cam_mps: FloatArray
    visible: float
    in_picture: bool


@dataclass(frozen=True, slots=True)
class Container:
    """How a session is written down: its camera, clock and encoder, and its markers.

    `ticks` are container stamps in units of `time_base` seconds; `markers` are (name, diameter in metres); `megabits`
    is Mbit/s at 240 frames/s. `sample_aspect` is what the stream says of a pixel's shape (None: nothing). A person
    gives a marker's seed on the first frame that shows `clear` of its outline.
    """

    camera: Camera
    exposure_s: float
    readout_s: float
    ticks: tuple[int, ...]
    time_base: Fraction
    markers: tuple[tuple[str, float], ...]
    megabits: float
    sample_aspect: Fraction | None = None
    clear: float = 1.0


class Rendered(ABC):
    """A session in memory, any frame on its own and the same every time: what either renderer makes of a scenario."""

    @property
    @abstractmethod
    def container(self) -> Container:
        """How the session is written down."""

    @property
    def beside(self) -> Mapping[str, str]:
        """More files of truth, texts by name: they are written beside the video."""
        return {}

    @abstractmethod
    def planes(self, picture: BgrImage) -> npt.NDArray[np.uint8]:
        """The (height * 3 / 2, width) Y, Cb, Cr planes of a picture, BT.709 limited range, 4:2:0."""

    @abstractmethod
    def _frame(self, index: int) -> tuple[BgrImage, int, list[MarkerTruth]]:
        """A frame's picture, not encoded, its stamp, and the truth of every marker. Runs in any thread."""

    def __len__(self) -> int:
        return len(self.container.ticks)

    def stamp_ns(self, index: int) -> int:
        """The frame's container stamp in ns."""
        return ticks_to_ns(self.container.ticks[index], self.container.time_base)

    def frames(
        self, count: int | None = None, workers: int | None = None
    ) -> Generator[tuple[BgrImage, int, list[MarkerTruth]], None, None]:
        """(picture, stamp_ns, truth of every marker) of the first `count` frames in order, not encoded.

        They are rendered ahead in `workers` threads (None: one a core, 8 at most), and are the same whatever their
        number.
        """
        return ahead(self._frame, len(self) if count is None else min(count, len(self)), workers)
