"""Patches as the chain cuts them: at the marker's own scale, which is that of KCF's grid with its default padding."""

from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.core.sampling import cut_bgr

GRID_PX, PADDING = 64, 1.5


def whole(frame) -> Patch:
    return Patch(frame, Window(0, 0, frame.width_px, frame.height_px))


def at_scale(frame, circle, side_px=GRID_PX) -> Patch:
    """`side_px` pixels square around the circle, of which 12.8 are a radius."""
    step = 2 * (1 + PADDING) * circle.r_px / GRID_PX
    x0, y0 = (v - (side_px - 1) / 2 * step for v in (circle.x_px, circle.y_px))
    return Patch.scaled(frame, cut_bgr(*frame.planes, x0, y0, step, side_px, side_px), x0, y0, step)


def pixels(image) -> Patch:
    """A picture's pixels as they are."""
    return whole(BgrFrame(0, 0, image))
