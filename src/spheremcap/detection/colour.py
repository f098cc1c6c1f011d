"""ColorSmartBoundary: a box in HSV learnt from the marker, a mask, a blob (thesis sections 2.4.2 and 2.4.3)."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.compiled import BGR, BOOL, F8, I8, PLANE, array, inner, kernel
from spheremcap.core.frame import Patch
from spheremcap.core.sampling import hsv_of
from spheremcap.core.stage import StageConfig

HUES = 180  # OpenCV's hue circle: 0..179, two degrees a step
_NO_HUE = 0.15  # of the median product of saturation and value: below it a hue is chance
_CHROMA_NOISE = 6.0  # levels by which chroma in video may be off


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

    def limits(self, gain: float = 1.0) -> npt.NDArray[np.float64]:
        """What `in_box` asks for, (6,): hue's mean and half-width, least and greatest saturation, least and greatest
        value; `gain` is how much brighter the scene is than when the box was learnt.

        The box is of colours in whole steps, so a colour between the steps may lie half a step outside. A range that
        ends at 0 or 255, and hue's from 90 on, has no limit there: it is infinite.
        """
        s0, s1 = self.saturation
        v0, v1 = self.value[0] * min(gain, 1.2), self.value[1] * gain
        if v1 > 235:  # a bright marker clips: it may go up to white
            v1, s0 = 255.0, s0 * 0.7
        return np.array(
            [
                self.hue_mean,
                self.hue_half + 0.5 if self.hue_half < HUES / 2 else math.inf,
                s0 - 0.5 if s0 > 0 else -math.inf,
                s1 + 0.5 if s1 < 255 else math.inf,
                v0 - 0.5 if v0 > 0 else -math.inf,
                v1 + 0.5 if v1 < 255 else math.inf,
            ]
        )

    def mask(self, hsv: npt.NDArray[np.uint8], gain: float = 1.0) -> npt.NDArray[np.uint8]:
        """(h, w) 255 inside the box, 0 outside, of a picture (h, w, 3) in OpenCV's 8-bit HSV."""
        return hsv_mask(hsv, self.limits(gain))


LIMITS = array(F8, 1)


def loosened(limits: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Limits (6,) for a single place near the outline, where blur, shade and glare change a colour more than inside.

    Hue may be half as far again off, saturation and value may fall to about half, and neither has an upper limit. Hue
    is what keeps skin out: twice as far lets fingers pass for a yellow ball.
    """
    hue, hue_half, saturation, _, value, _ = limits
    return np.array([hue, 1.5 * hue_half, 0.6 * saturation, math.inf, 0.5 * value, math.inf])


@inner
def in_box(limits, hue, saturation, value):
    """Whether a colour (hue 0..180, saturation and value 0..255, as of `hsv_of`) lies within `ColourBox.limits`."""
    off = abs(hue - limits[0])
    near = min(off, 180.0 - off) <= limits[1]
    return near and limits[2] <= saturation <= limits[3] and limits[4] <= value <= limits[5]


@kernel(None, BGR, LIMITS)
def hsv_mask(hsv, limits):
    """(h, w) uint8, 255 where a picture (h, w, 3) in 8-bit HSV lies within the limits, else 0."""
    height, width = hsv.shape[:2]
    out = np.empty((height, width), np.uint8)
    for i in range(height):
        for j in range(width):
            out[i, j] = 255 if in_box(limits, float(hsv[i, j, 0]), float(hsv[i, j, 1]), float(hsv[i, j, 2])) else 0
    return out


@kernel(None, BGR, LIMITS)
def box_mask(bgr, limits):
    """(h, w) uint8, 255 where a picture (h, w, 3) BGR lies within the limits, else 0.

    Hue and saturation are not rounded to whole steps on the way: a colour within one step of a limit may come out
    otherwise than through OpenCV's 8-bit HSV.
    """
    height, width = bgr.shape[:2]
    out = np.zeros((height, width), np.uint8)
    for i in range(height):
        for j in range(width):
            blue, green, red = float(bgr[i, j, 0]), float(bgr[i, j, 1]), float(bgr[i, j, 2])
            if limits[4] <= max(blue, green, red) <= limits[5]:  # told without dividing, as most that is not the marker
                hue, saturation, value = hsv_of(blue, green, red)
                if in_box(limits, hue, saturation, value):
                    out[i, j] = 255
    return out


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
    # A strap or a print that is nearly black or white has a hue by chance: it must not widen the marker's.
    chroma = pixels[:, 1] * pixels[:, 2]
    hue_off[chroma < _NO_HUE * np.median(chroma)] = 0
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


def less_sure_of_hue(box: ColourBox, hsv: npt.NDArray[np.uint8]) -> ColourBox:
    """The box with the hues that noise in the chroma of pixels (N, 3) adds, independent of their own: the less colour
    they have, the less their hue says."""
    chroma = float(np.median(hsv[:, 1].astype(np.float64) * hsv[:, 2])) / 255
    more = _CHROMA_NOISE / max(chroma, 1.0) * HUES / (2 * np.pi)
    return replace(box, hue_half=min(math.hypot(box.hue_half, more), HUES / 2))


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


@inner
def _root(parent, k):
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel(None, PLANE, BOOL, I8)
def blobs(mask, diagonal, least):
    """(N, 5) float64: pixels, column and row of the centroid, width and height of every connected part of a mask
    (h, w) that has at least `least` pixels; `diagonal` connects pixels that only touch at a corner (8-connectivity).

    Runs of a row are joined with those above that they touch (union-find).
    """
    height, width = mask.shape
    count = 0
    for i in range(height):
        before = 0
        for j in range(width):
            count += mask[i, j] != 0 and before == 0
            before = mask[i, j]
    row, first, end = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    parent = np.arange(count)
    slack = 1 if diagonal else 0
    n = above = here = 0  # runs so far; the first that may touch what comes; the first of this row
    for i in range(height):
        above, here = here, n
        last = here  # one past the row above
        j = 0
        while j < width:
            if mask[i, j] == 0:
                j += 1
                continue
            row[n], first[n] = i, j
            while j < width and mask[i, j] != 0:
                j += 1
            end[n] = j
            while above < last and end[above] + slack <= first[n]:
                above += 1
            k = above
            while k < last and first[k] < j + slack:
                a, b = _root(parent, k), _root(parent, n)
                parent[max(a, b)] = min(a, b)
                k += 1
            n += 1
    area, sums = np.zeros(count, np.int64), np.zeros((count, 2))
    left, right, top, bottom = np.full(count, width), np.zeros(count, np.int64), row.copy(), np.zeros(count, np.int64)
    found = 0
    for k in range(count):
        r, size = _root(parent, k), end[k] - first[k]
        found += area[r] < least <= area[r] + size
        area[r] += size
        sums[r, 0] += size * 0.5 * (first[k] + end[k] - 1)
        sums[r, 1] += size * row[k]
        left[r], right[r], bottom[r] = min(left[r], first[k]), max(right[r], end[k]), row[k] + 1
    out = np.empty((found, 5))
    n = 0
    for k in range(count):
        if parent[k] == k and area[k] >= least:
            out[n, 0], out[n, 1], out[n, 2] = area[k], sums[k, 0] / area[k], sums[k, 1] / area[k]
            out[n, 3], out[n, 4] = right[k] - left[k], bottom[k] - top[k]
            n += 1
    return out


def colour_circle(mask: npt.NDArray[np.uint8], patch: Patch, expected: Circle) -> Circle | None:
    """The blob of `mask` (the patch's) nearest in place and size to `expected`, as a circle in image pixels; None when
    there is none.

    The circle has the blob's centroid and area; a blob under 15 % of the expected area is noise.
    """
    local = patch.local(expected)
    best: Circle | None = None
    best_cost = math.inf
    for area, x, y, _, _ in blobs(mask, False, max(1, math.ceil(0.15 * local.area_px2))).tolist():
        circle = Circle(x, y, math.sqrt(area / math.pi))
        cost = circle.distance(local) / local.r_px + 2 * abs(math.log(circle.r_px / local.r_px))
        if cost < best_cost:
            best, best_cost = circle, cost
    return None if best is None else patch.in_picture(best)
