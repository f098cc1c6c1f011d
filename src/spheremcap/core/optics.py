"""What lens and shutter make of a moving marker: softness, the streak of the exposure, and the lean of rows read one by
one.

A rolling shutter reads a row a little later than the one above it. A marker that goes down is stretched by that, one
that goes up is squeezed, one that goes sideways leans; read as a sphere's size, a wrist at 12 px a frame would be 0.7 %
too near on its way down and as much too far on its way up. A camera that hangs upside down does the opposite: its
readout time is negative.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle

FloatArray = npt.NDArray[np.float64]

_MOST_LEAN = 0.3  # pixels a row
_MOST_BLUR = 3.5  # marker radii: of a longer streak too little is left to be found


@dataclass(frozen=True, slots=True)
class Motion:
    """A marker's motion as its picture has it: `blur_px` (2,) is the way it goes while exposed, `lean` (2,) how much
    farther it has gone a row later, pixels a row, `stretch_sd` the deviation of the vertical lean; `softness` is the
    blur of lens and focus in units of the settings' `blur_sigma_px`."""

    blur_px: FloatArray
    lean: FloatArray
    stretch_sd: float = 0.0
    softness: float = 1.0

    def seen(self, points_px: FloatArray, row_px: float) -> FloatArray:
        """Points (N, 2) of an outline as a global shutter has them, brought to where they are in the picture;
        `row_px` is the row of the outline's middle."""
        return points_px + self.lean * ((points_px[:, 1:] - row_px) / (1 - self.lean[1]))

    def still(self, points_px: FloatArray, row_px: float) -> FloatArray:
        """The inverse of `seen`: points (N, 2) of the picture as a global shutter has them."""
        return points_px - self.lean * (points_px[:, 1:] - row_px)

    def seen_circle(self, circle: Circle) -> Circle:
        """The equal-area circle in the picture of an outline that has this one under a global shutter."""
        return Circle(circle.x_px, circle.y_px, circle.r_px / math.sqrt(1 - self.lean[1]))

    def still_circle(self, circle: Circle) -> Circle:
        """The inverse of `seen_circle`."""
        return Circle(circle.x_px, circle.y_px, circle.r_px * math.sqrt(1 - self.lean[1]))


AT_REST = Motion(np.zeros(2), np.zeros(2))


@dataclass(frozen=True, slots=True)
class Optics:
    """A camera's shutter and lens: exposure time, time from the first row to the last (0: global shutter, negative:
    upside down) with its standard deviation, seconds, and softness as in `Motion`."""

    exposure_s: float = 0.0
    readout_s: float = 0.0
    readout_sd_s: float = 0.0
    softness: float = 1.0

    def motion(self, rate_px: FloatArray, circle: Circle, rows: int) -> Motion:
        """What a marker of this circle looks like that moves at `rate_px` (2,), px/s, in a picture of so many rows."""
        a_row_s = 1 / max(1, rows - 1)
        lean = rate_px * (self.readout_s * a_row_s)
        if max(abs(lean[0]), abs(lean[1])) > _MOST_LEAN:
            lean = np.clip(lean, -_MOST_LEAN, _MOST_LEAN)
        stretch_sd = min(abs(float(rate_px[1])) * self.readout_sd_s * a_row_s, _MOST_LEAN)
        return Motion(bounded_blur(rate_px * self.exposure_s, circle), lean, stretch_sd, self.softness)


def bounded_blur(blur_px: FloatArray, circle: Circle) -> FloatArray:
    """A streak (2,) no longer than what still leaves an outline of this circle."""
    most = _MOST_BLUR * circle.r_px
    return blur_px * (most / max(most, math.hypot(blur_px[0], blur_px[1])))
