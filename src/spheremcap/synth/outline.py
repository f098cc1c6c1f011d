"""The outline of a sphere in the picture, through any lens and a rolling shutter; its ellipse and circle."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.synth.motion import touched
from spheremcap.synth.truth import Ellipse

FloatArray = npt.NDArray[np.float64]


def seen_outline(
    camera: Camera,
    centre_at: Callable[[FloatArray], FloatArray],
    radius_m: float,
    stamp_s: float,
    row_s: float,
    samples: int = 256,
) -> FloatArray:
    """Outline (samples, 2) in pixels of a moving sphere in one picture; NaN where a ray does not reach it.

    `centre_at` is the path, times (N,) -> (N, 3) in the optical frame; the picture's middle row is exposed at
    `stamp_s` and every row `row_s` after the one above it. Each outline point is where it is when its row is
    exposed.
    """
    middle = (camera.height_px - 1) / 2
    times = np.full(samples, stamp_s)
    # The image of a point moves far less than one row per row time, so this contracts quickly.
    for _ in range(1 if row_s == 0 else 4):
        points: FloatArray = touched(centre_at(times), radius_m, camera.params)
        times = np.where(np.isfinite(points[:, 1]), stamp_s + (points[:, 1] - middle) * row_s, stamp_s)
    return points


def polygon_ellipse(points_px: FloatArray) -> tuple[Ellipse, Circle]:
    """The ellipse with a polygon's (N, 2) centroid and second moments, and its equal-area circle, in pixels.

    For points that lie densely on an ellipse this is that ellipse (N = 256: to 1e-4 of its size, made up
    for).
    """
    origin = points_px.mean(axis=0)
    x, y = (points_px - origin).T
    nx, ny = np.roll(x, -1), np.roll(y, -1)
    cross = x * ny - nx * y
    area = cross.sum() / 2
    cx, cy = ((x + nx) * cross).sum() / (6 * area), ((y + ny) * cross).sum() / (6 * area)
    xx = ((x * x + x * nx + nx * nx) * cross).sum() / (12 * area) - cx * cx
    yy = ((y * y + y * ny + ny * ny) * cross).sum() / (12 * area) - cy * cy
    xy = ((x * ny + 2 * x * y + 2 * nx * ny + nx * y) * cross).sum() / (24 * area) - cx * cy
    values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    # An ellipse has 1 / (N/(2 pi) sin(2 pi/N)) times the area of its inscribed N-gon (even corners).
    step = 2 * np.pi / len(points_px)
    grow = step / np.sin(step)
    a, b = 2 * np.sqrt(values[1]), 2 * np.sqrt(values[0])
    fit = np.sqrt(abs(area) * grow / (np.pi * a * b))
    angle = float(np.arctan2(vectors[1, 1], vectors[0, 1]))
    angle = (angle + np.pi / 2) % np.pi - np.pi / 2
    x_px, y_px = float(origin[0] + cx), float(origin[1] + cy)
    ellipse = Ellipse(x_px, y_px, float(a * fit), float(b * fit), angle)
    return ellipse, Circle(x_px, y_px, float(np.sqrt(abs(area) * grow / np.pi)))
