"""The lens for compiled loops against `Camera`."""

import numpy as np
import pytest

from spheremcap.core.camera import Camera
from spheremcap.core.compiled import F8, array, kernel
from spheremcap.core.lens import normal_of, pixel_of

WIDTH, HEIGHT = 1280, 720
CAMERAS = {
    "none": Camera(WIDTH, HEIGHT, 1150.0, 1140.0, 640.3, 355.8),
    "barrel": Camera(WIDTH, HEIGHT, 1150.0, 1140.0, 640.3, 355.8, "plumb_bob", (-0.31, 0.17, 0.001, -0.0007)),
    "barrel_5": Camera(WIDTH, HEIGHT, 800.0, 805.0, 630.3, 365.8, "plumb_bob", (-0.25, 0.09, 0.0004, -0.0003, -0.02)),
    "rational": Camera(
        WIDTH, HEIGHT, 900.0, 905.0, 630.0, 365.0, "plumb_bob", (0.1, -0.05, 4e-4, 3e-4, 0.01, 0.2, -0.02, 0.005)
    ),
    # Its picture's corners lie beyond the fold.
    "folding": Camera(WIDTH, HEIGHT, 900.0, 905.0, 630.0, 365.0, "plumb_bob", (-0.3, 0.0, 0.0, 0.0)),
    "fisheye": Camera(WIDTH, HEIGHT, 560.0, 562.0, 641.0, 352.0, "fisheye", (0.03, -0.012, 0.004, -0.001)),
    "wide fisheye": Camera(WIDTH, HEIGHT, 520.0, 520.0, 641.0, 352.0, "fisheye", (-0.02, 0.004, 0.0, 0.0)),
}


@kernel(None, array(F8, 1), array(F8, 2))
def pixels(camera, xyz):
    out = np.empty((len(xyz), 2))
    for k in range(len(xyz)):
        out[k, 0], out[k, 1] = pixel_of(camera, xyz[k, 0], xyz[k, 1], xyz[k, 2])
    return out


@kernel(None, array(F8, 1), array(F8, 2))
def normals(camera, points):
    out = np.empty((len(points), 2))
    for k in range(len(points)):
        out[k, 0], out[k, 1] = normal_of(camera, points[k, 0], points[k, 1])
    return out


@pytest.mark.parametrize("name", CAMERAS)
def test_pixels_are_those_that_the_camera_projects(name):
    """In the picture, beside it, far out where the model holds no more, at the camera's plane and behind it."""
    camera, rng = CAMERAS[name], np.random.default_rng(1)
    xyz = np.concatenate(
        [
            rng.uniform((-0.6, -0.4, 0.9), (0.6, 0.4, 1.3), (300, 3)),
            rng.uniform((-9, -9, -0.5), (9, 9, 2), (300, 3)),
            [[0, 0, 1], [0, 0, 50], [0.1, 0.1, 0], [0.1, 0.1, -1], [0, 0, 0], [1e-12, 0, 1], [0.1, 0, 1e-10]],
        ]
    )
    expected = camera.project(xyz)
    np.testing.assert_allclose(pixels(camera.params, xyz), expected, atol=1e-8, rtol=1e-11)
    assert np.isnan(expected).any()
    assert np.isfinite(expected[:300]).mean() > 0.9


@pytest.mark.parametrize("name", CAMERAS)
def test_normals_are_those_that_the_camera_gives(name):
    camera, rng = CAMERAS[name], np.random.default_rng(2)
    points = rng.uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (400, 2))
    points = np.concatenate([points, [[camera.cx_px, camera.cy_px], [0, 0], [WIDTH - 1, HEIGHT - 1]]])
    found, expected = normals(camera.params, points), camera.normalise(points)
    clear = ~(np.hypot(*found.T) > 0.9 * camera.holds_to)  # close to a fold OpenCV's iteration hardly moves
    np.testing.assert_array_equal(np.isnan(found[clear]), np.isnan(expected[clear]))
    np.testing.assert_allclose(found[clear], expected[clear], atol=2e-8)
    assert np.isfinite(found).all() or name == "folding"


@pytest.mark.parametrize("name", CAMERAS)
def test_a_normal_is_the_inverse_of_a_pixel_as_far_as_the_model_holds(name):
    """Where a pixel has no ray, there is none, not a wrong one: what comes back is the pixel itself or NaN."""
    camera, rng = CAMERAS[name], np.random.default_rng(3)
    points = rng.uniform((-1500, -1200), (WIDTH + 1500, HEIGHT + 1200), (600, 2))
    found = normals(camera.params, points)
    known = np.isfinite(found).all(axis=1)
    assert (np.isfinite(found[:, 0]) == np.isfinite(found[:, 1])).all()
    xyz = np.column_stack([found[known], np.ones(known.sum())])
    np.testing.assert_allclose(pixels(camera.params, xyz), points[known], atol=1e-6)
    inside = ((points >= 0) & (points <= (WIDTH - 1, HEIGHT - 1))).all(axis=1)
    assert known[inside].all() or name == "folding"
    assert (np.hypot(*found[known].T) <= camera.holds_to).all()


@pytest.mark.parametrize("name", [name for name in CAMERAS if name != "none"])
def test_beyond_what_the_model_holds_for_there_is_neither_pixel_nor_ray(name):
    camera = CAMERAS[name]
    assert np.isfinite(camera.holds_to)
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = camera.holds_to * np.column_stack([np.cos(angles), np.sin(angles)])
    for share, holds in ((0.999, True), (1.001, False), (3.0, False)):
        xyz = np.column_stack([share * circle, np.ones(24)])
        assert (np.isfinite(pixels(camera.params, xyz)) == holds).all()
        assert (np.isfinite(camera.project(xyz)) == holds).all()
    edge = camera.project(np.column_stack([0.99 * circle, np.ones(24)]))
    middle = np.array([camera.cx_px, camera.cy_px])
    assert np.isnan(normals(camera.params, middle + 4 * (edge - middle))).all()


def test_the_model_holds_wherever_the_picture_is():
    for camera in (CAMERAS[name] for name in CAMERAS if name != "folding"):
        corners = np.array([[0, 0], [WIDTH - 1, 0], [0, HEIGHT - 1], [WIDTH - 1, HEIGHT - 1.0]])
        np.testing.assert_allclose(camera.project(camera.rays(corners)), corners, atol=1e-4)
