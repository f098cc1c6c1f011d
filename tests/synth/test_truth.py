"""Truth against independent mathematics: METHOD.md 4a and 4b, and a projection written another way."""

import numpy as np
import pytest

from spheremcap.core.camera import Camera
from spheremcap.synth.outline import polygon_ellipse, seen_outline

FLAT = Camera(1280, 720, 1150.0, 1150.0, 639.5, 359.5)
WIDE = Camera(1280, 720, 585.0, 585.0, 639.5, 359.5, "fisheye", (0.035, -0.012, 0.004, -0.001))
BENT = Camera(1280, 720, 1150.0, 1150.0, 639.5, 359.5, "plumb_bob", (-0.31, 0.17, 0.0, 0.0))
RADIUS_M = 0.02


def still(centre):
    return lambda t_s: np.repeat(np.array([centre], float), len(t_s), axis=0)


@pytest.mark.parametrize("centre", [(0.0, 0.0, 1.0), (0.3, -0.15, 0.8), (-0.5, 0.25, 1.1), (0.02, 0.01, 4.0)])
def test_ellipse_and_area_give_the_sphere_back(centre):
    ellipse, circle = polygon_ellipse(seen_outline(FLAT, still(centre), RADIUS_M, 0.0, 0.0))
    cx, cy = (ellipse.x_px - FLAT.cx_px) / FLAT.fx_px, (ellipse.y_px - FLAT.cy_px) / FLAT.fy_px
    # 4a: from the semi-minor axis.
    b = ellipse.b_px / FLAT.fx_px
    z = RADIUS_M * np.sqrt(1 + 1 / b**2)
    scale = (z**2 - RADIUS_M**2) / z
    np.testing.assert_allclose((cx * scale, cy * scale, z), centre, rtol=2e-5, atol=2e-6)
    # 4b: from area and centre alone.
    s = (circle.r_px / FLAT.fx_px) ** 2
    roots = np.roots([1, 1 + cx**2 + cy**2, -(s**2), -(s**2)])
    u = float(roots.real[(abs(roots.imag) < 1e-12) & (roots.real > 0)][0])
    assert RADIUS_M * np.sqrt(1 + 1 / u) == pytest.approx(centre[2], rel=2e-5)
    assert np.pi * ellipse.a_px * ellipse.b_px == pytest.approx(circle.area_px2, rel=1e-6)


@pytest.mark.parametrize("camera", [FLAT, BENT, WIDE])
def test_outline_rays_touch_the_sphere(camera):
    centre = np.array([0.35, 0.18, 0.9])
    rays = camera.rays(seen_outline(camera, still(centre), RADIUS_M, 0.0, 0.0, 40))
    nearest = np.linalg.norm(np.cross(rays, centre), axis=1)
    np.testing.assert_allclose(nearest, RADIUS_M, rtol=1e-6)


def test_rolling_shutter_shifts_and_stretches_the_outline():
    """A sphere that falls is seen later the lower it is; at even depth the shift is v_rows * row time."""
    speed, row_s = 4.0, 5e-6  # m/s downwards, s

    def falling(t_s):
        return np.stack([0 * t_s, 0.2 + speed * t_s, 1.0 + 0 * t_s], axis=1)

    ellipse, circle = polygon_ellipse(seen_outline(FLAT, falling, RADIUS_M, 0.0, row_s))
    _, still_circle = polygon_ellipse(seen_outline(FLAT, falling, RADIUS_M, 0.0, 0.0))
    per_row = speed * FLAT.fy_px * row_s  # rows it falls while one row is read
    off = still_circle.y_px - 359.5
    assert circle.y_px - 359.5 == pytest.approx(off / (1 - per_row), rel=1e-4)
    assert ellipse.a_px / ellipse.b_px == pytest.approx((1 / (1 - per_row)) * np.sqrt(1 + 0.2**2), rel=2e-3)


def test_ellipse_of_a_dense_polygon_is_that_ellipse():
    phi = np.arange(256) * 2 * np.pi / 256
    x, y = 30 * np.cos(phi), 20 * np.sin(phi)
    turn = 0.4
    points = np.stack([x * np.cos(turn) - y * np.sin(turn) + 700, x * np.sin(turn) + y * np.cos(turn) + 50], axis=1)
    ellipse, circle = polygon_ellipse(points)
    found = (ellipse.x_px, ellipse.y_px, ellipse.a_px, ellipse.b_px, ellipse.angle_rad)
    np.testing.assert_allclose(found, (700, 50, 30, 20, turn), rtol=1e-8)
    assert circle.r_px == pytest.approx(np.sqrt(600), rel=1e-9)
