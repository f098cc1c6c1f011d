"""How much wider than high a picture's pixels are, where nobody says: a sphere that is seen as an ellipse shows it."""

import math

import numpy as np

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame
from spheremcap.core.look import Measured
from spheremcap.detection.edge import EdgeConfig
from spheremcap.detection.outline import Outline, clearness
from spheremcap.positioning.sphere import PositionConfig

_TRIED = np.exp(np.linspace(-0.7, 0.7, 11))  # from half to twice as wide as high
_CLOSE = np.exp(np.linspace(-0.14, 0.14, 15))
_HARDLY, _NEARLY = 0.6, 0.9  # shares of the outline that show an edge


def pixel_aspect(frame: Frame, circle: Circle) -> float:
    """How much wider than high pixels are by the outline around a person's circle (pixels): 1 unless, were they square,
    hardly more than half of it would show an edge, and nearly all of it does for others.

    Motion draws a marker out too, but blurs its ends; what hides a part of it leaves no other outline whole.
    """
    square = _seen(frame, circle, 1.0)
    if square is not None and square.visible > _HARDLY:
        return 1.0
    best = max(_TRIED, key=lambda aspect: clearness(_seen(frame, circle, aspect)))
    found = _seen(frame, circle, best)
    if found is None or found.visible < _NEARLY:
        return 1.0
    return float(min(best * _CLOSE, key=lambda aspect: _residual_px(_seen(frame, circle, aspect))))


def _seen(frame: Frame, circle: Circle, aspect: float) -> Measured | None:
    """The outline of a sphere near the circle before a camera with such pixels."""
    width, height = frame.width_px, frame.height_px
    focal_px, squeeze = 1.5 * max(width, height), math.sqrt(aspect)
    camera = Camera(
        width, height, focal_px / squeeze, focal_px * squeeze, (width - 1) / 2, (height - 1) / 2, source="assumed"
    )
    return Outline(0.02, camera, EdgeConfig(), PositionConfig()).first_look(frame, circle, (1.0,))


def _residual_px(seen: Measured | None) -> float:
    """Mean square of how far edge points lie off the outline; infinite where hardly any agree."""
    if seen is None or seen.visible < _NEARLY:
        return math.inf
    return float(np.mean(seen.edges_outside_px[seen.agreeing] ** 2))
