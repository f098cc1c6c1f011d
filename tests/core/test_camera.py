import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.core.camera import Camera
from spheremcap.core.presets import PRESETS, assumed_camera

WIDTH, HEIGHT = 1280, 720
CAMERAS = {
    "none": Camera(WIDTH, HEIGHT, 1150.0, 1140.0, 640.3, 355.8),
    "plumb_bob": Camera(WIDTH, HEIGHT, 1150.0, 1140.0, 640.3, 355.8, "plumb_bob", (-0.31, 0.17, 0.001, -0.0007)),
    "plumb_bob_8": Camera(
        WIDTH,
        HEIGHT,
        900.0,
        905.0,
        630.0,
        365.0,
        "plumb_bob",
        (0.1, -0.05, 4e-4, 3e-4, 0.01, 0.2, -0.02, 0.005),
    ),
    "plumb_bob_5": Camera(WIDTH, HEIGHT, 800.0, 805.0, 630.3, 365.8, "plumb_bob", (-0.25, 0.09, 4e-4, -3e-4, -0.02)),
    "fisheye": Camera(WIDTH, HEIGHT, 560.0, 562.0, 641.0, 352.0, "fisheye", (0.03, -0.012, 0.004, -0.001)),
}
pixels = st.tuples(st.floats(0, WIDTH - 1), st.floats(0, HEIGHT - 1))


@pytest.mark.parametrize("name", CAMERAS)
@given(pixel=pixels, depth=st.floats(0.05, 50))
def test_a_pixels_ray_projects_back_onto_the_pixel(name, pixel, depth):
    camera = CAMERAS[name]
    ray = np.append(camera.normalise(np.array([pixel]))[0], 1.0) * depth
    assert camera.project(ray[None])[0] == pytest.approx(pixel, abs=1e-4)


@pytest.mark.parametrize("name", CAMERAS)
def test_normalise_undoes_project(name):
    camera = CAMERAS[name]
    a, b = np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(-0.28, 0.28, 7))
    flat = np.stack([a.ravel(), b.ravel()], axis=1)
    points = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
    np.testing.assert_allclose(camera.normalise(camera.project(points)), flat, atol=1e-8)


@pytest.mark.parametrize("name", CAMERAS)
def test_projection_is_opencvs(name):
    camera = CAMERAS[name]
    rng = np.random.default_rng(3)
    points = rng.uniform((-0.4, -0.25, 0.8), (0.4, 0.25, 3), (40, 3))
    zero = np.zeros(3)
    if camera.model == "fisheye":
        expected, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, camera.matrix, np.array(camera.distortion))
    else:
        expected, _ = cv2.projectPoints(points, zero, zero, camera.matrix, np.array(camera.distortion))
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-8)


@pytest.mark.parametrize("name", CAMERAS)
def test_a_pixel_beside_the_picture_has_its_own_ray_or_none(name):
    """Far out a distorted pixel may have no ray at all; it must not be given one of another pixel."""
    camera, rng = CAMERAS[name], np.random.default_rng(4)
    points = rng.uniform((-1500, -1200), (WIDTH + 1500, HEIGHT + 1200), (800, 2))
    normal = camera.normalise(points)
    known = np.isfinite(normal).all(axis=1)
    assert known.sum() > 100
    assert (np.hypot(*normal[known].T) <= camera.holds_to).all()
    there = camera.project(np.column_stack([normal[known], np.ones(known.sum())]))
    np.testing.assert_allclose(there, points[known], atol=1e-3)


@pytest.mark.parametrize("name", [name for name in CAMERAS if name != "none"])
def test_beyond_the_radius_that_the_lens_model_holds_for_there_is_no_pixel(name):
    """A barrel's polynomial turns back: without this, what lies far beside the picture would be seen in it."""
    camera = CAMERAS[name]
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    xyz = np.column_stack([camera.holds_to * np.cos(angles), camera.holds_to * np.sin(angles), np.ones(24)])
    assert np.isfinite(camera.project(xyz * (0.999, 0.999, 1))).all()
    assert np.isnan(camera.project(xyz * (1.001, 1.001, 1))).all()
    assert np.isnan(camera.project(xyz * (40, 40, 1))).all()
    seen = camera.normalise(np.array([[0, 0], [WIDTH - 1, 0], [0, HEIGHT - 1], [WIDTH - 1, HEIGHT - 1.0]]))
    assert camera.holds_to > np.hypot(*seen.T).max()


def test_axes_are_x_right_y_down_z_forward():
    camera = CAMERAS["plumb_bob"]
    middle, right, below = camera.project(np.array([[0, 0, 2.0], [0.1, 0, 2], [0, 0.1, 2]]))
    assert middle == pytest.approx((camera.cx_px, camera.cy_px))
    assert right[0] > middle[0]
    assert below[1] > middle[1]


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_have_length_one(name):
    rays = CAMERAS[name].rays(np.array([[0, 0], [700.0, 31.0], [1279, 719]]))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1)
    assert (rays[:, 2] > 0).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_what_is_behind_the_camera_has_no_pixel(name):
    out = CAMERAS[name].project(np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [0.1, 0.1, 1.0]]))
    assert np.isnan(out[:2]).all()
    assert np.isfinite(out[2]).all()


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("factor", [0.5, 2, 1.5])
def test_a_scaled_camera_sees_the_same_point_at_the_scaled_place(name, factor):
    camera = CAMERAS[name]
    scaled = camera.scaled(int(WIDTH * factor), int(HEIGHT * factor))
    points = np.array([[0.1, -0.2, 1.0], [-0.3, 0.1, 1.4]])
    # Integer coordinates are pixel centres, so it is the edges (x + 0.5) that scale.
    np.testing.assert_allclose(scaled.project(points) + 0.5, (camera.project(points) + 0.5) * factor, atol=1e-9)
    assert (scaled.width_px, scaled.height_px) == (WIDTH * factor, HEIGHT * factor)


def test_scaling_there_and_back_changes_nothing():
    camera = CAMERAS["fisheye"]
    back = camera.scaled(1920, 1080).scaled(WIDTH, HEIGHT)
    np.testing.assert_allclose(back.matrix, camera.matrix, rtol=1e-13)
    assert back.distortion == camera.distortion


@pytest.mark.parametrize(
    ("model", "distortion"),
    [("none", (0.1,)), ("plumb_bob", (0.1, 0.2)), ("plumb_bob", ()), ("fisheye", (0.1,) * 5)],
)
def test_a_wrong_number_of_coefficients_is_refused(model, distortion):
    with pytest.raises(ValueError, match=f"{model} distortion takes .* not {len(distortion)}"):
        Camera(WIDTH, HEIGHT, 1000, 1000, 640, 360, model, distortion)


def test_a_focal_length_must_be_positive():
    with pytest.raises(ValueError, match="positive"):
        Camera(WIDTH, HEIGHT, 0.0, 1000, 640, 360)


def test_narrow_mode_bends_sixty_pixels_at_the_sides():
    camera = PRESETS["gopro-hero4-silver-720p-narrow"]
    edge = camera.rays(np.array([[0.0, camera.cy_px]]))[0]
    straight = camera.cx_px + camera.fx_px * edge[0] / edge[2]
    assert straight == pytest.approx(-60, abs=15)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_say_where_they_come_from_and_how_good_they_are(name):
    camera = PRESETS[name]
    assert len(camera.source) > 40
    assert camera.focal_sd >= 0.03


def test_an_assumed_camera_sees_sixty_degrees_across():
    camera = assumed_camera(1280, 720)
    left, right = camera.rays(np.array([[-0.5, 359.5], [1279.5, 359.5]]))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(60, abs=0.01)
