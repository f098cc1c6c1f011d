"""What is round and of a colour of its own on one frame, with no prior at all.

Blobs of one hue and Hough's circles say where to look, the edge step at a first glance whether there is an outline, and
the colours inside and around it whether that is a thing of its own.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrImage, Frame, Patch
from spheremcap.core.optics import AT_REST
from spheremcap.core.sampling import cut_bgr
from spheremcap.detection.appearance import Appearance, contrast
from spheremcap.detection.colour import HUES, ColourConfig, blobs, disc_pixels, hsv_mask
from spheremcap.detection.hough import vote_circles
from spheremcap.detection.outline import Outline

_LONGER_SIDE_PX = 640  # to which a picture is reduced before blobs are sought
_HUE_STEP, _HUE_HALF = 12, 12.5  # the hues of one mask, steps of 2 degrees: neighbours overlap by half
_SATURATIONS = (30.0, 60.0, 100.0, 150.0)  # least saturation of a mask: a marker may stand before its own hue, paler
_LEAST_VALUE = 40.0
_LEAST_PIXELS = 8
_LEAST_FILL, _LEAST_WIDTH = 0.4, 0.5  # of a blob: its area over that of its circle, its width over its length
_LARGEST = 0.25  # of the picture's height: half a blob's length
_HOUGH_STEPS = (1, 2, 4, 8)  # the picture is reduced by each of these
_HOUGH_R_PX = (4.5, 9.0)  # and circles of these radii are sought in it
_HOUGH_KEEP = 12
_ALIKE = 0.75  # Dice from which two circles are worth one glance
_SAME = 0.5  # Dice from which two outlines are one
_SOFT = replace(AT_REST, softness=2.4)  # a glance allows for some blur
_LEAST_VISIBLE = 0.25  # share of an outline at a glance
_CLEAR_CONTRAST = 30.0  # colour difference from which more of it tells no more
_PART_R, _PART_CLEAR = (
    0.6,
    0.4,
)  # of a larger spot's radius and clearness, up to and from which one in it is a part of it
_LARGE_PX, _VIVID = 10.0, 100.0  # radius, and saturation, from which more tells no more
_PATCH_SIDE, _PATCH_REACH = 40, 2.0  # pixels along a side of what is kept of a spot, and radii that it reaches


@dataclass(frozen=True, slots=True)
class Spot:
    """Something round on a frame, at a glance.

    `visible` is the share of its outline with an edge, `inside` and `around` the shares of its own colours in it and in
    a ring around it, `contrast` how far the colours around it differ from its own (`appearance.contrast`), `hsv` its
    colour: mean hue (0..180, steps of 2 degrees), median saturation and value (0..255).
    """

    circle: Circle
    visible: float
    inside: float
    around: float
    contrast: float
    hsv: tuple[float, float, float]

    @property
    def clear(self) -> float:
        """How clearly it is a thing of its own, 0..1: much of an outline, and its colours inside and not around it."""
        own = max(0.0, self.inside - self.around)
        return self.visible * own * min(1.0, self.contrast / _CLEAR_CONTRAST)

    @property
    def promise(self) -> float:
        """How likely it is to be a marker by its looks, 0..1: small things and pale ones that are round are common."""
        return self.clear * math.sqrt(min(1.0, self.circle.r_px / _LARGE_PX)) * min(1.0, 0.3 + self.hsv[1] / _VIVID)


def spots(frame: Frame, outline: Outline, most: int) -> list[Spot]:
    """The round things on a frame that promise most, at most so many, the best first; `outline` is of spheres of any
    size before the frame's camera."""
    tried: list[Circle] = []
    found: list[Spot] = []
    for circle in (*_by_colour(frame), *_by_shape(frame)):
        if any(circle.dice(other) > _ALIKE for other in tried):
            continue
        tried.append(circle)
        spot = spot_at(frame, circle, outline)
        if spot is not None:
            found.append(spot)
    found.sort(key=lambda spot: -spot.promise)
    kept: list[Spot] = []
    for spot in found:
        if not any(spot.circle.dice(other.circle) > _SAME or _is_part(spot, other) for other in kept):
            kept = [other for other in kept if not _is_part(other, spot)]
            kept.append(spot)
        if len(kept) == most:
            break
    return kept


def _is_part(spot: Spot, whole: Spot) -> bool:
    """Whether a spot is a glint or a stripe on a larger one that is about as clear."""
    inner, outer = spot.circle, whole.circle
    lies_in = inner.distance(outer) + 0.5 * inner.r_px < outer.r_px and inner.r_px < _PART_R * outer.r_px
    return lies_in and whole.clear > _PART_CLEAR * spot.clear


def spot_at(frame: Frame, circle: Circle, outline: Outline) -> Spot | None:
    """What is near a circle at a glance; None where there is hardly an outline."""
    glance = outline.sharpened(frame, circle, "seed", 0.25 * circle.r_px, _SOFT, None)
    if glance is None or glance.visible < _LEAST_VISIBLE or not _inside(frame, glance.circle):
        return None
    return described(frame, glance.circle, glance.visible)


def described(frame: Frame, circle: Circle, visible: float) -> Spot:
    """The colours of a circle whose centre is in the picture and of which so much of the outline is seen."""
    step_px = 2 * _PATCH_REACH * circle.r_px / _PATCH_SIDE
    x0, y0 = (centre - (_PATCH_SIDE - 1) / 2 * step_px for centre in (circle.x_px, circle.y_px))
    bgr = cut_bgr(*frame.planes, x0, y0, step_px, _PATCH_SIDE, _PATCH_SIDE)
    patch = Patch.scaled(frame, bgr, x0, y0, step_px)
    colours = Appearance(patch, circle, visible, ColourConfig())
    hsv = disc_pixels(patch, circle, 0.8)
    return Spot(
        circle, visible, colours.inside, colours.around, contrast(patch, circle),
        (colours.box.hue_mean, float(np.median(hsv[:, 1])), float(np.median(hsv[:, 2]))),
    )  # fmt: skip


def _by_colour(frame: Frame) -> Iterator[Circle]:
    """Blobs of one hue that are about as wide as high, the fullest first."""
    step = max(1, round(max(frame.width_px, frame.height_px) / _LONGER_SIDE_PX))
    bgr, first_px = reduced(frame, step)
    hsv: BgrImage = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)  # type: ignore[assignment]
    found: list[tuple[float, Circle]] = []
    for hue in range(0, HUES, _HUE_STEP):
        for saturation in _SATURATIONS:
            limits = np.array([hue, _HUE_HALF, saturation, math.inf, _LEAST_VALUE, math.inf])
            for area, x, y, width, height in blobs(hsv_mask(hsv, limits), True, _LEAST_PIXELS).tolist():
                reach = max(width, height) / 2
                fill = area / (math.pi * (reach + 0.25) ** 2)
                if reach > _LARGEST * len(bgr) or min(width, height) < _LEAST_WIDTH * 2 * reach or fill < _LEAST_FILL:
                    continue
                found.append((fill, Circle(first_px + x * step, first_px + y * step, reach * step)))
    found.sort(key=lambda item: -item[0])
    yield from (circle for _, circle in found)


def _by_shape(frame: Frame) -> Iterator[Circle]:
    """Hough's circles of every size: the only way to a black or a white marker."""
    for step in _HOUGH_STEPS:
        bgr, first_px = reduced(frame, step)
        height, width = bgr.shape[:2]
        if min(height, width) > 4 * _HOUGH_R_PX[1]:
            circles = vote_circles(bgr, 0, 0, width, height, *_HOUGH_R_PX, 2.0, 4.0, 77.0, 8.0, _HOUGH_KEEP)
            yield from (Circle(first_px + x * step, first_px + y * step, r * step) for x, y, r in circles.tolist())


def reduced(frame: Frame, step: int) -> tuple[BgrImage, float]:
    """The picture at 1/`step` size, and where its first pixel lies along both axes, pixels."""
    first_px = (step - 1) / 2
    columns, rows = frame.width_px // step, frame.height_px // step
    return cut_bgr(*frame.planes, first_px, first_px, float(step), columns, rows), first_px


def _inside(frame: Frame, circle: Circle) -> bool:
    return 0 <= circle.x_px <= frame.width_px - 1 and 0 <= circle.y_px <= frame.height_px - 1
