"""What the shutter makes of a moving marker: the streak of the exposure, and the lean of rows read one by one.

A rolling shutter reads a row a little later than the one above it. A marker that goes down is stretched by that, one
that goes up is squeezed, one that goes sideways leans; read as a sphere's size, a wrist at 12 px a frame would be 0.7 %
too near on its way down and as much too far on its way up.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Motion:
    """A marker's motion as its picture has it: `blur_px` (2,) is the way it goes while exposed, `lean` (2,) how much
    farther it has gone a row later, pixels a row, `stretch_sd` the deviation of the vertical lean."""

    blur_px: FloatArray
    lean: FloatArray
    stretch_sd: float = 0.0

    def seen(self, points_px: FloatArray, row_px: float) -> FloatArray:
        """Points (N, 2) of an outline as a global shutter has them, brought to where they are in the picture;
        `row_px` is the row of the outline's middle."""
        return points_px + self.lean * ((points_px[:, 1:] - row_px) / (1 - self.lean[1]))

    def still(self, points_px: FloatArray, row_px: float) -> FloatArray:
        """The inverse of `seen`: points (N, 2) of the picture as a global shutter has them."""
        return points_px - self.lean * (points_px[:, 1:] - row_px)

    def seen_circle(self, circle: Circle) -> Circle:
        """The equal-area circle in the picture of an outline that has this one under a global shutter."""
        return replace(circle, r_px=circle.r_px / float(np.sqrt(1 - self.lean[1])))

    def still_circle(self, circle: Circle) -> Circle:
        """The inverse of `seen_circle`."""
        return replace(circle, r_px=circle.r_px * float(np.sqrt(1 - self.lean[1])))


AT_REST = Motion(np.zeros(2), np.zeros(2))
_SHARED = 16.0  # edge points that share an error: neighbours on the outline and in time
_MOST_LEAN = 0.3  # pixels a row


class Shutter:
    """The readout time, from the first row to the last: as given, or learnt from how outlines stretch on the way down
    and shrink on the way up (blur does the same to both). Least squares over all frames, with nothing to a whole frame
    interval for a start."""

    def __init__(self, readout_s: float | None, rows: int) -> None:
        self._given_s, self._rows = readout_s, max(1, rows - 1)
        self._like = self._power = 0.0

    def readout_s(self, interval_s: float) -> tuple[float, float]:
        """The readout time and its standard deviation, seconds, with `interval_s` between frames."""
        if self._given_s is not None:
            return self._given_s, 0.0
        power = self._power + 3 / interval_s**2
        return float(np.clip(self._like / power, 0, interval_s)), power**-0.5

    def motion(self, rate_px: FloatArray, exposure_s: float, interval_s: float) -> Motion:
        """What a marker looks like that moves at `rate_px` (2,), px/s, while exposed for `exposure_s`."""
        readout_s, sd_s = self.readout_s(interval_s)
        lean = np.clip(rate_px * (readout_s / self._rows), -_MOST_LEAN, _MOST_LEAN)
        return Motion(rate_px * exposure_s, lean, abs(float(rate_px[1])) * sd_s / self._rows)

    def learn(
        self,
        points_px: FloatArray,
        outside_px: FloatArray,
        weights: FloatArray,
        circle: Circle,
        motion: Motion,
        rate_px: FloatArray,
    ) -> None:
        """Learn from edge points (N, 2) that lie `outside_px` (N,) of the outline fitted with `motion`, of a marker
        that moves at `rate_px` (2,), px/s; `weights` (N,) are the fit's."""
        if self._given_s is not None:
            return
        off = points_px - (circle.x_px, circle.y_px)
        normal = off / np.hypot(off[:, 0], off[:, 1])[:, None]
        root = np.sqrt(weights)
        stretch = root * (normal @ rate_px) * off[:, 1] / self._rows  # pixels outwards for a second of readout
        sphere, _ = np.linalg.qr(np.column_stack([np.ones(len(off)), normal]) * root[:, None])
        stretch -= sphere @ (sphere.T @ stretch)  # what no size and place of a sphere explains
        variance = _SHARED * float((weights * outside_px**2).sum()) / max(1e-9, float(weights.sum())) + 1e-6
        self._like += float(stretch @ (root * (outside_px + (normal @ motion.lean) * off[:, 1]))) / variance
        self._power += float(stretch @ stretch) / variance
