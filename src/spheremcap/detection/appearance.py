"""What a marker looked like when a person showed it, at the brightness it has by now.

The last verified picture may drift with what is followed; this one cannot.
"""

import math
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.compiled import BGR, F8, I8, inner, kernel
from spheremcap.core.frame import Patch
from spheremcap.core.sampling import hsv_of
from spheremcap.detection.colour import (
    HUES,
    LIMITS,
    ColourBox,
    ColourConfig,
    box_mask,
    disc_mask,
    disc_pixels,
    in_box,
    learn_box,
    less_sure_of_hue,
)

Mask = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]
Limits = FloatArray

_INSIDE, _RING = 0.8, (1.15, 1.5)  # radii up to which, and between which, contrast is taken
_CLEAR = 0.6  # share of the outline from which a circle's brightness is the marker's
_WHOLE = 0.9  # share of the outline of a circle that nothing hides
_KNOWN = 0.8  # share of it in the box from which there is nothing to learn


@inner
def _ranked(histogram, rank):
    """The value at place `rank`, from 0, of the sorted ones that a histogram (256,) counts."""
    below, value = histogram[0], 0
    while below <= rank and value < 255:
        value += 1
        below += histogram[value]
    return float(value)


@inner
def _median(histogram, count):
    return 0.5 * (_ranked(histogram, (count - 1) // 2) + _ranked(histogram, count // 2)) if count > 0 else np.nan


@kernel(None, BGR, I8, I8, I8, I8, F8, F8, F8, F8, LIMITS)
def ring_colours(bgr, x0, y0, x1, y1, x, y, beyond, within, limits):
    """Of the pixels of a patch (h, w, 3) BGR that lie inside the picture, columns x0..x1-1 and rows y0..y1-1, and
    further than `beyond` from (x, y) but not further than `within`, in patch pixels (`beyond` < 0: from the centre):

    how many there are; how many have a colour within the limits; the lower quartile, the median and the upper quartile
    of their value max(B, G, R), 0..255; the median value of those within the limits. NaN where there are none.
    """
    all_of, own_of = np.zeros(256, np.int64), np.zeros(256, np.int64)
    count = own = 0
    for i in range(max(y0, int(np.ceil(y - within))), min(y1, int(np.floor(y + within)) + 1)):
        for j in range(max(x0, int(np.ceil(x - within))), min(x1, int(np.floor(x + within)) + 1)):
            away2 = (j - x) ** 2 + (i - y) ** 2
            if away2 > within * within or away2 <= beyond * abs(beyond):
                continue
            hue, saturation, value = hsv_of(float(bgr[i, j, 0]), float(bgr[i, j, 1]), float(bgr[i, j, 2]))
            count += 1
            all_of[int(value)] += 1
            if in_box(limits, hue, saturation, value):
                own += 1
                own_of[int(value)] += 1
    if count == 0:
        return 0, 0, np.nan, np.nan, np.nan, np.nan
    quarter = count // 4
    low, high = _ranked(all_of, quarter), _ranked(all_of, 3 * quarter)
    return count, own, low, _median(all_of, count), high, _median(own_of, own)


def contrast(patch: Patch, circle: Circle) -> float:
    """How far the colours in a ring around a circle (image pixels) are from those inside, in the median over the ring:
    CIE 1976 colour difference in L*a*b*. NaN where no pixel of either is in the picture.
    """
    own, ring = _lab(patch, circle)
    return math.nan if own is None else _apart(own, ring)


def _lab(patch: Patch, circle: Circle) -> tuple[FloatArray | None, FloatArray]:
    """The median colour (3,) inside a circle and all (N, 3) in the ring around it, CIE 1976 L*a*b*; None where no pixel
    of either is in the picture."""
    inside = disc_mask(patch, circle, _INSIDE)
    ring = disc_mask(patch, circle, _RING[1]) & ~disc_mask(patch, circle, _RING[0])
    if not inside.any() or not ring.any():
        return None, np.zeros((0, 3))
    lab = cv2.cvtColor(patch.bgr.astype(np.float32) / 255, cv2.COLOR_BGR2Lab).astype(float)
    return np.median(lab[inside], axis=0), lab[ring]


def _apart(own: FloatArray, ring: FloatArray) -> float:
    """The median colour difference between one colour (3,) and others (N, 3), all in L*a*b*."""
    return float(np.median(np.linalg.norm(ring - own, axis=1)))


class Appearance:
    """The seed's colours. `box` is its colour box, `gain` the marker's brightness over the seed's; `visible` is the
    share of the outline that the seed showed, 0 for none, `inside` and `around` the seed's own `shares`."""

    def __init__(self, patch: Patch, circle: Circle, visible: float, config: ColourConfig) -> None:
        """Learn from a seed's circle (image pixels). Raises ValueError when none of it is inside the picture."""
        pixels = disc_pixels(patch, circle, config.sample)
        self._seeded = less_sure_of_hue(learn_box(pixels, config), pixels)
        self._take(self._seeded)
        self.gain = 1.0
        self.visible = visible
        self._value = max(1.0, float(np.median(pixels[:, 2])))
        self._bgr = np.median(patch.bgr[disc_mask(patch, circle, config.sample)], axis=0)
        self.inside, self.around = self.shares(patch, circle)

    def follow(self, patch: Patch, circle: Circle, visible: float) -> None:
        """Take the brightness of a verified circle in where enough of its outline is `visible`: what hides it may be as
        dark. Where all is, the box grows by what light and sharpness have made of the seed's hue, within bounds."""
        _, own, _, _, _, value = self._colours(patch, circle, -1.0, 0.6, self._any_value)
        if own > 8 and visible > _CLEAR:
            self.gain += 0.5 * (self._gain_of(value) - self.gain)
        if visible > _WHOLE:
            count, own, *_ = self._colours(patch, circle, -1.0, _INSIDE, self.box.limits(self.gain))
            if own < _KNOWN * count:
                self._grow(disc_pixels(patch, circle, _INSIDE))

    def _grow(self, pixels: Mask) -> None:
        """Take the saturations and values of HSV pixels (N, 3) of the seed's hue into the box, on each side at most
        half of the seed's own range."""
        hue_off = np.abs((pixels[:, 0] - self.box.hue_mean + HUES / 2) % HUES - HUES / 2)
        own = pixels[hue_off <= self.box.hue_half]
        if len(own) < 0.5 * len(pixels):
            return
        grown = []
        for channel, scale, (low, high), (now_low, now_high) in (
            (1, 1.0, self._seeded.saturation, self.box.saturation),
            (2, self.gain, self._seeded.value, self.box.value),
        ):
            room, (least, most) = 0.5 * (high - low), np.percentile(own[:, channel] / scale, (4, 96)).tolist()
            grown.append((min(now_low, max(least, low - room, 0.0)), max(now_high, min(most, high + room, 255.0))))
        self._take(replace(self.box, saturation=grown[0], value=grown[1]))

    def _take(self, box: ColourBox) -> None:
        self.box, self._any_value = box, replace(box, value=(0.0, 255.0)).limits()

    def limits(self, patch: Patch, near: Circle) -> Limits:
        """The limits (6,) that the marker's colours keep on this patch (`ColourBox.limits`); the exposure may have
        changed, so the brightness is looked up once more at `near` (image pixels)."""
        limits = self.box.limits(self.gain)
        count, own, _, value, _, _ = self._colours(patch, near, -1.0, 0.6, limits)
        if own < 0.3 * count:
            again = self.box.limits(self._gain_of(value))
            if self._colours(patch, near, -1.0, 0.6, again)[1] > 0.5 * count:
                return again
        return limits

    def mask(self, patch: Patch, near: Circle) -> Mask:
        """The colour mask (h, w) of the patch, 0 or 255, by `limits`."""
        return box_mask(patch.bgr, self.limits(patch, near))

    def shares(self, patch: Patch, circle: Circle) -> tuple[float, float]:
        """Shares of pixels in the seed's own colours, inside the circle and in a ring around it, at the exposure that
        suits the inside best; 0 where no pixel is in the picture. A claim on a part of the marker has its colour all
        around."""
        limits = self.box.limits(self.gain)
        count, own, low, _, high, _ = self._colours(patch, circle, -1.0, 0.9, limits)
        if count == 0:
            return 0.0, 0.0
        if own < 0.8 * count:
            # Another exposure, as the brighter or the darker half of the disc has it when a part is hidden.
            for value in (low, high):
                other = self.box.limits(self._gain_of(value))
                more = self._colours(patch, circle, -1.0, 0.9, other)[1]
                if more > own:
                    own, limits = more, other
        ring, ring_own, _, _, _, _ = self._colours(patch, circle, 1.1, 1.35, limits)
        return own / count, ring_own / ring if ring else 0.0

    def unlike(self, patch: Patch, circle: Circle) -> float:
        """How far the median colour inside a circle is from the seed's, as bright as the marker is by now, over how far
        it is from what is around (`contrast`): of a dark marker hue and saturation say little, and light
        changes both. Infinite where no pixel is in the picture."""
        own, ring = _lab(patch, circle)
        if own is None:
            return math.inf
        seeded = np.minimum(self._bgr * self.gain / 255, 1).astype(np.float32)
        seeded = cv2.cvtColor(seeded[None, None], cv2.COLOR_BGR2Lab)[0, 0]
        return float(np.linalg.norm(own - seeded) / max(_apart(own, ring), 1e-6))

    def _gain_of(self, value: float) -> float:
        return min(max(value / self._value, 0.1), 4.0)

    @staticmethod
    def _colours(
        patch: Patch, circle: Circle, beyond: float, within: float, limits: Limits
    ) -> tuple[int, int, float, float, float, float]:
        """`ring_colours` between two shares of the circle's radius; the centre's own pixels always count."""
        x, y, r = patch.local(circle)
        inner_px = max(1.0, beyond * r) if beyond > 0 else -1.0
        return ring_colours(patch.bgr, *patch.picture, x, y, inner_px, max(1.0, within * r), limits)
