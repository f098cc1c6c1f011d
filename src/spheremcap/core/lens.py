"""`Camera.project` and `Camera.normalise` for compiled loops, a point at a time. `camera` is `Camera.params`."""

import math

import numpy as np

from spheremcap.core.compiled import inner

_STEPS = 12  # of Newton's method, which is quadratic: five are enough inside any picture


@inner
def _bend(camera, a, b):
    """Distorted x/z and y/z of undistorted ones, and the derivatives (xx, xy, yx, yy)."""
    if camera[4] == 0.0:
        return a, b, 1.0, 0.0, 0.0, 1.0
    r2 = a * a + b * b
    if camera[4] == 1.0:
        k1, k2, p1, p2, k3, k4, k5, k6 = (
            camera[5],
            camera[6],
            camera[7],
            camera[8],
            camera[9],
            camera[10],
            camera[11],
            camera[12],
        )
        top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        low = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = top / low
        slope = (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2)) / low - radial * (k4 + r2 * (2.0 * k5 + 3.0 * k6 * r2)) / low
        x = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
        y = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
        cross = 2.0 * a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b
        return (
            x,
            y,
            radial + 2.0 * a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a,
            cross,
            cross,
            radial + 2.0 * b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a,
        )
    r = math.sqrt(r2)
    if r < 1e-9:
        return a, b, 1.0, 0.0, 0.0, 1.0
    theta = math.atan(r)
    t2 = theta * theta
    k1, k2, k3, k4 = camera[5], camera[6], camera[7], camera[8]
    bent = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    rate = (1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))) / (1.0 + r2)
    scale = bent / r
    slope = (rate - scale) / r2
    return a * scale, b * scale, scale + a * a * slope, a * b * slope, a * b * slope, scale + b * b * slope


@inner
def pixel_of(camera, x, y, z):
    """The pixel of a point in the optical frame; NaN at or behind the camera's plane and beyond the lens model."""
    if z <= 1e-9:
        return np.nan, np.nan
    a, b = x / z, y / z
    if not a * a + b * b <= camera[13] * camera[13]:
        return np.nan, np.nan
    a, b, _, _, _, _ = _bend(camera, a, b)
    return a * camera[0] + camera[2], b * camera[1] + camera[3]


@inner
def normal_of(camera, x_px, y_px):
    """Undistorted x/z and y/z of a pixel, by Newton's method; NaN where the model has no ray."""
    wanted_a, wanted_b = (x_px - camera[2]) / camera[0], (y_px - camera[3]) / camera[1]
    if camera[4] == 0.0:
        return wanted_a, wanted_b
    a, b = wanted_a, wanted_b
    for _ in range(_STEPS):
        x, y, xx, xy, yx, yy = _bend(camera, a, b)
        off_a, off_b = wanted_a - x, wanted_b - y
        det = xx * yy - xy * yx
        step_a, step_b = (yy * off_a - xy * off_b) / det, (xx * off_b - yx * off_a) / det
        a, b = a + step_a, b + step_b
        if step_a * step_a + step_b * step_b < 1e-24:
            if a * a + b * b <= camera[13] * camera[13]:
                return a, b
            return np.nan, np.nan
    return np.nan, np.nan
