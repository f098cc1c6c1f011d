"""ColorSmartBoundary: a box in HSV learnt from the marker, a mask, a blob (thesis sections 2.4.2 and 2.4.3)."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig

HUES = 180  # OpenCV's hue circle: 0..179, two degrees a step


class ColourConfig(StageConfig):
    """Both stop rules of eq 2.26; the least half-widths keep a flat seed from making a box of one colour."""

    enabled: bool = Field(True, description="false leaves detection to Hough, KCF and the prediction")
    stop: Literal["coverage", "gain"] = Field("coverage", description="coverage: until `coverage`; gain: eq 2.26")
    coverage: float = Field(0.93, gt=0.5, le=1, description="share of the marker's pixels in the box (section 2.4.3)")
    least_hue: float = Field(6, ge=0, description="least half-width of hue, steps of 2 degrees; ours")
    least_saturation: float = Field(35, ge=0, description="least half-width of saturation, 0..255; ours")
    least_value: float = Field(40, ge=0, description="least half-width of value, 0..255; ours")
    grey_saturation: float = Field(45, ge=0, description="below this mean saturation hue says nothing; ours")
    sample: float = Field(0.8, gt=0, le=1, description="the box is learnt inside this share of the radius; ours")


@dataclass(frozen=True, slots=True)
class ColourBox:
    """Colours of one marker: hue within `hue_half` of `hue_mean` on the circle (0..180), saturation and value in
    closed ranges 0..255. `hue_half` >= 90 takes every hue."""

    hue_mean: float
    hue_half: float
    saturation: tuple[float, float]
    value: tuple[float, float]

    @property
    def volume(self) -> float:
        """Volume in HSV steps (eq 2.26's V)."""
        return (
            min(2 * self.hue_half, HUES) * (self.saturation[1] - self.saturation[0]) * (self.value[1] - self.value[0])
        )

    def mask(self, hsv: npt.NDArray[np.uint8], gain: float = 1.0) -> npt.NDArray[np.uint8]:
        """(h, w) 255 inside the box, 0 outside; `gain` is how much brighter the scene is than when it was learnt."""
        if hsv.size == 0:  # OpenCV refuses it
            return np.zeros(hsv.shape[:2], np.uint8)
        s0, s1 = self.saturation
        v0, v1 = self.value[0] * min(gain, 1.2), self.value[1] * gain
        if v1 > 235:  # a bright marker clips: it may go up to white
            v1, s0 = 255.0, s0 * 0.7
        if self.hue_half >= HUES / 2:
            ranges = [(0.0, HUES - 1.0)]
        else:
            low, high = self.hue_mean - self.hue_half, self.hue_mean + self.hue_half
            ranges = [(low, high)]
            if low < 0:
                ranges = [(0, high), (low + HUES, HUES - 1)]
            elif high >= HUES:
                ranges = [(low, HUES - 1), (0, high - HUES)]
        out = None
        for low, high in ranges:
            part = cv2.inRange(hsv, (float(np.floor(low)), s0, v0), (float(np.ceil(high)), s1, v1))
            out = part if out is None else cv2.bitwise_or(out, part)
        return out  # type: ignore[return-value]


def learn_box(hsv: npt.NDArray[np.uint8], config: ColourConfig) -> ColourBox:
    """The box around the mean of pixels (N, 3), grown with half-widths proportional to sigma (eq 2.21, 2.26).

    Hue is an angle: its mean and deviation are circular. Raises ValueError for no pixels.
    """
    if len(hsv) == 0:
        raise ValueError("no pixels to learn a colour from")
    pixels = hsv.reshape(-1, 3).astype(np.float64)
    angle = pixels[:, 0] * (2 * np.pi / HUES)
    hue_mean = float(np.angle(np.exp(1j * angle).mean()) * HUES / (2 * np.pi)) % HUES
    hue_off = (pixels[:, 0] - hue_mean + HUES / 2) % HUES - HUES / 2
    grey = pixels[:, 1].mean() < config.grey_saturation
    mean = np.array([0.0, pixels[:, 1].mean(), pixels[:, 2].mean()])
    off = np.stack([hue_off, pixels[:, 1] - mean[1], pixels[:, 2] - mean[2]], axis=1)
    sigma = np.maximum(np.sqrt((off**2).mean(axis=0)), 1e-6)
    # The half-width, in sigmas, at which each pixel enters the growing box.
    entry = np.sort((np.abs(off) / sigma).max(axis=1))
    size = entry[-1]
    if config.stop == "coverage":
        size = entry[min(len(entry) - 1, int(np.ceil(config.coverage * len(entry))) - 1)]
    else:
        sizes = np.linspace(0, entry[-1], 101)[1:]
        points = np.searchsorted(entry, sizes, side="right") / len(entry)
        volume = (sizes / entry[-1]) ** 3
        stops = (np.diff(volume, prepend=0) >= np.diff(points, prepend=0)) & (points >= 0.5)
        if stops.any():
            size = sizes[int(stops.argmax())]
    half = np.maximum(size * sigma, (config.least_hue, config.least_saturation, config.least_value))
    low, high = np.maximum(mean - half, 0), np.minimum(mean + half, 255)
    return ColourBox(
        hue_mean,
        HUES / 2 if grey else min(float(half[0]), HUES / 2),
        (float(low[1]), float(high[1])),
        (float(low[2]), float(high[2])),
    )


def disc_pixels(patch: Patch, circle: Circle, share: float) -> npt.NDArray[np.uint8]:
    """HSV pixels (N, 3) of the patch within `share` of the circle's radius (image pixels), inside the picture."""
    return patch.hsv[disc_mask(patch, circle, share)]


def disc_mask(patch: Patch, circle: Circle, share: float) -> npt.NDArray[np.bool_]:
    """(h, w) True within `share` of the circle's radius (image pixels) and inside the picture."""
    local = patch.local(circle)
    height, width = patch.bgr.shape[:2]
    x, y = np.arange(width), np.arange(height)
    x0, y0, x1, y1 = patch.picture
    dx2 = np.where((x >= x0) & (x < x1), (x - local.x_px) ** 2, np.inf)
    dy2 = np.where((y >= y0) & (y < y1), (y - local.y_px) ** 2, np.inf)
    return dx2[None, :] + dy2[:, None] <= max(1.0, share * local.r_px) ** 2


def colour_circle(mask: npt.NDArray[np.uint8], patch: Patch, expected: Circle) -> Circle | None:
    """The blob of `mask` nearest in place and size to `expected`, as a circle in image pixels; None when there is none.

    The circle has the blob's centroid and area; a blob under 15 % of the expected area is noise.
    """
    count, _, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=4)
    best: Circle | None = None
    best_cost = np.inf
    for k in range(1, count):
        area = float(stats[k, cv2.CC_STAT_AREA])
        if area < 0.15 * expected.area_px2:
            continue
        circle = Circle(
            float(centres[k][0]) + patch.window.x,
            float(centres[k][1]) + patch.window.y,
            float(np.sqrt(area / np.pi)),
        )
        cost = circle.distance(expected) / expected.r_px + 2 * abs(np.log(circle.r_px / expected.r_px))
        if cost < best_cost:
            best, best_cost = circle, float(cost)
    return best
