"""A sphere's outline and centre, against closed forms and exact rays (docs/method.md section 4)."""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference import sphere as reference
from reference.sphere import fit_cone
from scenes import Ball, truth
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.positioning.sphere import (
    circle_of_sphere,
    fit_sphere,
    outline_px,
    outline_rays,
    polygon_circle,
    sphere_of_circle,
    thesis_position,
)

R = 0.02
PLAIN = Camera(1280, 720, 1150.0, 1150.0, 639.5, 359.5)
GOPRO = Camera(1280, 720, 1150.0, 1150.0, 639.5, 359.5, "plumb_bob", (-0.31, 0.17, 0.0, 0.0))
FISHEYE = Camera(1280, 720, 560.0, 562.0, 641.0, 352.0, "fisheye", (0.03, -0.012, 0.004, -0.001))
places = st.tuples(st.floats(-0.45, 0.45), st.floats(-0.25, 0.25), st.floats(0.3, 4)).map(
    lambda p: np.array([p[0] * p[2], p[1] * p[2], p[2]])
)
radii = st.floats(0.005, 0.1)


def off_axis(degrees, distance=1.0):
    angle = np.radians(degrees)
    return np.array([np.sin(angle), 0, np.cos(angle)]) * distance


def exact_ellipse(xyz, radius):
    """Centre and semi-axes (minor, major) of the outline in normalised coordinates, in closed form."""
    depth = xyz[2] ** 2 - radius**2
    return (
        xyz[:2] * xyz[2] / depth,
        radius / np.sqrt(depth),
        radius * np.sqrt(xyz @ xyz - radius**2) / depth,
    )


# -- the outline -----------------------------------------------------------------------------------


@given(places, radii)
def test_outline_rays_touch_the_sphere(xyz, radius):
    rays = outline_rays(xyz, radius, 24)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(np.cross(rays, xyz), axis=1), radius, rtol=1e-6)


def test_an_outline_starts_on_the_right_and_runs_clockwise_on_the_screen():
    points = outline_px(np.array([0.1, -0.05, 1.0]), R, PLAIN, 40)
    centre = points.mean(axis=0)
    right, below, left, above = points[[0, 10, 20, 30]] - centre
    assert right[0] > 20
    assert below[1] > 20
    assert left[0] < -20
    assert above[1] < -20


@pytest.mark.parametrize("degrees", [0, 10, 20, 28])
def test_a_spheres_image_is_the_ellipse_of_the_closed_form(degrees):
    xyz = off_axis(degrees)
    flat = PLAIN.normalise(outline_px(xyz, R, PLAIN, 720))
    centre, minor, major = exact_ellipse(xyz, R)
    assert (flat[:, 0].max() - flat[:, 0].min()) / 2 == pytest.approx(major, rel=1e-4)  # stretched away from the axis
    assert (flat[:, 1].max() - flat[:, 1].min()) / 2 == pytest.approx(minor, rel=1e-4)
    assert (flat[:, 0].max() + flat[:, 0].min()) / 2 == pytest.approx(centre[0], abs=1e-6)
    # docs/method.md 4a turned round
    z = R * np.sqrt(1 + 1 / minor**2)
    assert z == pytest.approx(xyz[2], abs=1e-12)
    np.testing.assert_allclose(centre * (z**2 - R**2) / z, xyz[:2], atol=1e-12)


@given(places)
def test_the_equal_area_circle_is_the_closed_forms(xyz):
    found = circle_of_sphere(xyz, R, PLAIN)
    expected = truth(Ball(tuple(xyz)), PLAIN)
    assert found.distance(expected) < 1e-3 * expected.r_px
    assert found.r_px == pytest.approx(expected.r_px, rel=1e-3)


def test_a_regular_polygons_circle_is_the_one_around_it():
    phi = np.arange(7) * 2 * np.pi / 7
    found = polygon_circle(np.stack([5 + 3 * np.cos(phi), -2 + 3 * np.sin(phi)], axis=1))
    assert (found.x_px, found.y_px, found.r_px) == pytest.approx((5, -2, 3))


@pytest.mark.parametrize("z", [-1.0, 0.0, 0.01, R])
def test_a_sphere_not_wholly_before_the_camera_has_no_circle(z):
    assert circle_of_sphere(np.array([0.0, 0.0, z]), R, PLAIN) is None


# -- from a circle ---------------------------------------------------------------------------------


@given(places, radii)
def test_circle_of_sphere_and_back_is_the_same_sphere(xyz, radius):
    # To the accuracy of a polygon of 24 points for an outline that perspective spreads unevenly: its error grows with
    # the square of the angular radius, 2e-5 of the distance for a 4 cm marker at 0.3 m.
    distance = np.linalg.norm(xyz)
    back = sphere_of_circle(circle_of_sphere(xyz, radius, PLAIN), radius, PLAIN)
    assert np.linalg.norm(back - xyz) < distance * (0.008 * (radius / distance) ** 2 + 1e-9)


@pytest.mark.parametrize("camera", [GOPRO, FISHEYE], ids=["plumb_bob", "fisheye"])
@given(xyz=places)
def test_so_it_is_through_a_lens_that_bends(camera, xyz):
    back = sphere_of_circle(circle_of_sphere(xyz, R, camera), R, camera)
    distance = np.linalg.norm(xyz)
    # The image of a sphere is no ellipse then; its area still says where it is to some tenths of a percent.
    assert np.linalg.norm(back - xyz) < 0.006 * distance
    direction = np.linalg.norm(np.cross(back / np.linalg.norm(back), xyz / distance))
    assert direction < 1e-3


@given(places, radii)
def test_penne_finds_the_exact_centre_from_the_exact_area_and_centre(xyz, radius):
    """docs/method.md 4b: the cubic has one positive root, b squared."""
    centre, minor, major = exact_ellipse(xyz, radius)
    f = PLAIN.fx_px
    circle = Circle(PLAIN.cx_px + f * centre[0], PLAIN.cy_px + f * centre[1], f * float(np.sqrt(minor * major)))
    np.testing.assert_allclose(sphere_of_circle(circle, radius, PLAIN), xyz, rtol=1e-9, atol=1e-9)


def test_a_larger_circle_is_nearer():
    z = [sphere_of_circle(Circle(700, 300, r), R, PLAIN)[2] for r in (5, 10, 20, 40, 200)]
    assert (np.diff(z) < 0).all()


BIASES = pytest.mark.parametrize(("degrees", "bias_mm"), [(0, 0), (10, -8), (20, -31), (28, -61)])


@BIASES
def test_ranging_from_a_circles_radius_is_biased_off_the_axis_by_the_stated_figures(degrees, bias_mm):
    """docs/method.md 4, at 1 m, the constant right on the axis: similar triangles (eq 3.10) give a depth."""
    xyz = off_axis(degrees)
    circle = truth(Ball(tuple(xyz), radius_m=R), PLAIN)
    depth = thesis_position(circle, R, PLAIN.fx_px, PLAIN)[2]
    assert (depth / np.cos(np.radians(degrees)) - 1) * 1000 == pytest.approx(bias_mm, abs=1)
    exact = np.linalg.norm(sphere_of_circle(circle, R, PLAIN))
    assert abs(exact - 1) * 1000 < 1e-6


@pytest.mark.parametrize(("degrees", "bias_mm"), [(10, -8), (20, -31), (28, -61)])
def test_the_thesis_position_is_biased_by_those_figures(degrees, bias_mm):
    xyz = off_axis(degrees)
    found = thesis_position(truth(Ball(tuple(xyz), radius_m=R), PLAIN), R, PLAIN.fx_px, PLAIN)
    assert (np.linalg.norm(found) - 1) * 1000 == pytest.approx(bias_mm, abs=1)


def test_the_thesis_own_example():
    # Eq 3.12: r = 20 px, l_o = 1.7 cm gives 102.96 cm.
    xyz = thesis_position(Circle(PLAIN.cx_px, PLAIN.cy_px, 20), 0.017, 1211.27, PLAIN)
    np.testing.assert_allclose(xyz, [0, 0, 1.0296], atol=5e-5)


def test_the_thesis_distance_is_a_depth_on_the_ray_through_the_circles_centre():
    circle = Circle(1100, 100, 20)
    xyz = thesis_position(circle, 0.017, 1211.27, PLAIN)
    assert xyz[2] == pytest.approx(1211.27 * 0.017 / 20)
    np.testing.assert_allclose(PLAIN.project(xyz[None])[0], (1100, 100))


# -- from edge rays --------------------------------------------------------------------------------


@given(places, radii)
def test_the_cone_through_exact_rays_gives_the_exact_centre(xyz, radius):
    """docs/method.md 4c, to 1e-9 of the distance."""
    rays = outline_rays(xyz, radius, 40)
    np.testing.assert_allclose(
        fit_cone(rays, np.ones(40), radius), xyz, atol=1e-9 * np.linalg.norm(xyz) * (0.1 / radius) ** 2
    )


@pytest.mark.parametrize("arc", [180, 120, 60])
def test_a_part_of_the_outline_is_enough(arc):
    xyz = np.array([0.2, -0.1, 1.1])
    rays = outline_rays(xyz, R, 360)[40 : 40 + arc]
    np.testing.assert_allclose(fit_cone(rays, np.ones(arc), R), xyz, atol=1e-8)
    fit = fit_sphere(rays, np.full(arc, 1e-4), R, xyz + np.array([0.002, 0.001, 0.03]))
    np.testing.assert_allclose(fit.xyz_cam_m, xyz, atol=1e-8)


def test_weights_of_the_cone_fit_leave_points_out():
    xyz = np.array([0.2, -0.1, 1.1])
    rays = outline_rays(xyz, R, 72)
    rays[:20] = outline_rays(xyz, R * 1.5, 72)[:20]
    weights = np.ones(72)
    weights[:20] = 0
    np.testing.assert_allclose(fit_cone(rays, weights, R), xyz, atol=1e-8)


@settings(deadline=None, max_examples=50)
@given(places, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.12, 0.12))
def test_the_robust_fit_of_exact_rays_is_exact_from_any_near_start(xyz, dx, dy, dz):
    rays = outline_rays(xyz, R, 60)
    start = xyz * (1 + dz) + np.array([dx * R, dy * R, 0])
    fit = fit_sphere(rays, np.full(60, 0.1 / 1150), R, start, loose=30)
    np.testing.assert_allclose(fit.xyz_cam_m, xyz, atol=1e-5 * xyz[2])


def noisy(rays, sd_rad, rng):
    """Rays with their angle to the sphere's axis disturbed (what an edge detector errs in)."""
    axis = rays.mean(axis=0)
    axis /= np.linalg.norm(axis)
    aside = rays - (rays @ axis)[:, None] * axis
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    out = rays + aside * rng.normal(0, sd_rad, len(rays))[:, None]
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def occluded(kind, rng, xyz, sd):
    """72 noisy rays, 21 of them on something else; their indices."""
    rays = noisy(outline_rays(xyz, R, 72), sd, rng)
    r_px, axis = 23.0, xyz / np.linalg.norm(xyz)
    if kind == "chord":  # a straight edge across the marker
        hidden = (np.arange(21) + int(rng.integers(72))) % 72
        pull = 1 - np.cos(11 * np.pi / 36) / np.cos((np.arange(21) - 10) * np.pi / 36)
    else:
        hidden = rng.choice(72, 21, replace=False)
        pull = rng.uniform(2, 8, 21) / r_px * (1 if kind == "inside" else rng.choice((-1, 1), 21))
    rays[hidden] = (1 - pull)[:, None] * rays[hidden] + pull[:, None] * axis
    return rays / np.linalg.norm(rays, axis=1, keepdims=True), hidden


def assert_robust(kind, seed):
    rng = np.random.default_rng(seed)
    xyz, sd = np.array([0.25, -0.12, 1.0]), 0.1 / 1150
    rays, hidden = occluded(kind, rng, xyz, sd)
    fit = fit_sphere(rays, np.full(72, sd), R, xyz * 1.02 + (0.0005, -0.0005, 0), loose=30)
    error_px = np.linalg.norm(PLAIN.project(fit.xyz_cam_m[None])[0] - PLAIN.project(xyz[None])[0])
    assert error_px < 0.15
    assert abs(fit.xyz_cam_m[2] - xyz[2]) < 0.006
    if kind != "chord":
        assert fit.weights[hidden].max() < 0.2
    assert np.median(fit.weights[np.setdiff1d(np.arange(72), hidden)]) > 0.6


@pytest.mark.parametrize("kind", ["inside", "scattered"])
@pytest.mark.parametrize("seed", range(6))
def test_thirty_per_cent_outliers_do_no_harm(kind, seed):
    assert_robust(kind, seed)


@pytest.mark.xfail(
    strict=True,
    reason="the annealed fit follows an arc of outliers: 1.6 px off; a least-median start gives 0.03 px",
)
def test_an_edge_across_thirty_per_cent_of_the_outline_does_no_harm():
    for seed in range(6):
        assert_robust("chord", seed)


@lru_cache(maxsize=8)
def mean_nees(arc, degrees):
    """Normalised estimation error squared over 150 noisy outlines; 3 when the covariance is right."""
    rng = np.random.default_rng(10)
    xyz, sd = off_axis(degrees), 0.08 / 1150
    nees, errors = [], []
    for _ in range(150):
        rays = noisy(outline_rays(xyz, R, 72)[:arc], sd, rng)
        fit = fit_sphere(rays, np.full(arc, sd), R, xyz + rng.normal(0, (5e-4, 5e-4, 5e-3)), loose=10)
        errors.append(fit.xyz_cam_m - xyz)
        nees.append(errors[-1] @ np.linalg.solve(fit.covariance_m2, errors[-1]))
    assert np.abs(np.mean(errors, axis=0)).max() < 4e-4  # no bias to speak of
    return float(np.mean(nees))


@pytest.mark.parametrize("arc", [72, 36])
@pytest.mark.parametrize("degrees", [0, 25])
def test_the_covariance_is_honest_within_a_factor_of_two(arc, degrees):
    assert 0.5 < mean_nees(arc, degrees) / 3 < 2


@pytest.mark.parametrize("arc", [72, 36])
@pytest.mark.parametrize("degrees", [0, 25])
def test_the_covariance_is_never_too_small_nor_three_times_too_large(arc, degrees):
    assert 0.33 < mean_nees(arc, degrees) / 3 < 2


def test_worse_edges_than_stated_widen_the_covariance():
    rng = np.random.default_rng(11)
    xyz, sd = np.array([0.1, 0.05, 1.0]), 0.03 / 1150
    sizes = []
    for factor in (1, 5):
        fits = [
            fit_sphere(noisy(outline_rays(xyz, R, 72), factor * sd, rng), np.full(72, sd), R, xyz) for _ in range(20)
        ]
        sizes.append(np.mean([np.sqrt(np.trace(f.covariance_m2)) for f in fits]))
    assert sizes[1] > 2 * sizes[0]


def test_half_the_outline_is_known_less_well_than_all_of_it():
    xyz = np.array([0.1, 0.05, 1.0])
    rays = outline_rays(xyz, R, 72)
    whole, half = (fit_sphere(rays[:n], np.full(n, 1e-4), R, xyz).covariance_m2 for n in (72, 36))
    assert np.trace(half) > 2 * np.trace(whole)
    worst = np.linalg.eigh(whole)[1][:, -1]  # depth is always the hardest
    assert abs(worst @ xyz) / np.linalg.norm(xyz) == pytest.approx(1, abs=0.01)


def test_the_fit_does_not_depend_on_where_the_camera_looks():
    """Rays are directions in space: turning them all turns the answer and its covariance."""
    xyz = np.array([0.05, 0.02, 1.0])
    rays = noisy(outline_rays(xyz, R, 72), 5e-5, np.random.default_rng(12))
    angle = 0.35
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    here = fit_sphere(rays, np.full(72, 5e-5), R, xyz)
    there = fit_sphere(rays @ turn.T, np.full(72, 5e-5), R, turn @ xyz)
    np.testing.assert_allclose(there.xyz_cam_m, turn @ here.xyz_cam_m, atol=1e-9)
    np.testing.assert_allclose(there.covariance_m2, turn @ here.covariance_m2 @ turn.T, rtol=1e-5, atol=1e-14)


def test_too_few_points_or_a_wild_start_give_no_fit_and_no_error():
    xyz = np.array([0.0, 0.0, 1.0])
    rays = outline_rays(xyz, R, 72)
    assert fit_sphere(rays[:4], np.full(4, 1e-4), R, xyz) is None
    same = np.repeat(rays[:1], 30, axis=0)
    fit = fit_sphere(same, np.full(30, 1e-4), R, xyz)
    assert fit is None or not np.isfinite(fit.covariance_m2).all() or np.trace(fit.covariance_m2) > 1e-3


# -- with a distance known from elsewhere ----------------------------------------------------------


@lru_cache(maxsize=8)
def short_arcs(degrees, known):
    """Errors in distance and the fits of 40 noisy arcs of so many degrees; `known` by 2 mm at 1 m, or not."""
    rng, xyz, sd = np.random.default_rng(20), np.array([0.2, -0.1, 0.97]), 0.15 / 1150
    errors, fits = [], []
    for turn in range(40):
        rays = np.roll(outline_rays(xyz, R, 72), -5 * turn, axis=0)[: degrees // 5]
        known_m = (np.linalg.norm(xyz), 0.002) if known else None
        fit = fit_sphere(noisy(rays, sd, rng), np.full(len(rays), sd), R, xyz * 1.01, near=True, known_m=known_m)
        errors.append(np.linalg.norm(fit.xyz_cam_m) - np.linalg.norm(xyz))
        fits.append(fit)
    return np.array(errors), fits


@pytest.mark.parametrize("degrees", [60, 90, 120])
def test_a_short_arc_hardly_leaves_the_distance_that_is_known(degrees):
    free, held = short_arcs(degrees, False)[0], short_arcs(degrees, True)[0]
    assert np.abs(held).max() < 0.004
    assert held.std() < 0.25 * free.std()


@pytest.mark.parametrize("degrees", [60, 90, 120])
def test_the_covariance_of_a_short_arc_does_not_know_of_the_distance(degrees):
    """It is that of the rays: within the spread of the residuals, as large as without, and as the free fits scatter."""
    (free, alone), (_, held) = short_arcs(degrees, False), short_arcs(degrees, True)
    along = np.array([0.2, -0.1, 0.97]) / np.linalg.norm([0.2, -0.1, 0.97])
    sds = [np.median([np.sqrt(along @ f.covariance_m2 @ along) for f in fits]) for fits in (alone, held)]
    assert sds[1] / sds[0] == pytest.approx(1, abs=0.4)
    assert sds[1] > 3 * 0.002
    assert sds[1] > 0.4 * free.std()


def test_the_fit_with_a_known_distance_is_the_likeliest_place():
    """Exact rays of one distance, another one known: the place along the ray is their mean by information."""
    xyz, sd = np.array([0.2, -0.1, 0.97]), 0.15 / 1150
    rays, length = outline_rays(xyz, R, 72)[:30], np.linalg.norm(xyz)
    free = fit_sphere(rays, np.full(30, sd), R, xyz, near=True)
    own = np.sqrt(xyz @ free.covariance_m2 @ xyz) / length
    for sd_m in (0.5 * own, own, 3 * own):
        fit = fit_sphere(rays, np.full(30, sd), R, xyz, near=True, known_m=(length + 0.002, sd_m))
        share = own**2 / (own**2 + sd_m**2)
        assert np.linalg.norm(fit.xyz_cam_m) - length == pytest.approx(0.002 * share, rel=0.1)


def test_a_distance_that_is_three_deviations_off_hardly_moves_a_whole_outline():
    rng, xyz, sd = np.random.default_rng(21), np.array([0.2, -0.1, 0.97]), 0.1 / 1150
    length = np.linalg.norm(xyz)
    for _ in range(10):
        rays, sds = noisy(outline_rays(xyz, R, 72), sd, rng), np.full(72, sd)
        free = fit_sphere(rays, sds, R, xyz, near=True)
        held = fit_sphere(rays, sds, R, xyz, near=True, known_m=(length * 1.03, 0.01 * length))
        moved = np.linalg.norm(held.xyz_cam_m) - np.linalg.norm(free.xyz_cam_m)
        own = np.sqrt(xyz @ free.covariance_m2 @ xyz) / length
        assert 0 < moved < 0.5 * own
        assert moved < 0.02 * 0.03 * length


@pytest.mark.parametrize("known_m", [(1.03, 0.004), (1.0, 1e-4), (0.9, 0.5)])
@pytest.mark.parametrize("hold", [None, 0.01])
def test_the_compiled_fit_with_a_known_distance_equals_the_reference(known_m, hold):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        xyz, sd = np.array([0.25, -0.12, 1.0]), 0.1 / 1150
        rays, how = noisy(outline_rays(xyz, R, 72)[:40], sd, rng), {"hold": hold, "near": True, "known_m": known_m}
        ours, theirs = (f(rays, np.full(40, sd), R, xyz * 1.01, **how) for f in (fit_sphere, reference.fit_sphere))
        np.testing.assert_allclose(ours.xyz_cam_m, theirs.xyz_cam_m, atol=1e-9)
        np.testing.assert_allclose(ours.covariance_m2, theirs.covariance_m2, rtol=1e-5, atol=1e-15)


# -- the compiled loops against their readable forms -------------------------------------------------


@given(places, radii)
def test_compiled_outlines_and_circles_equal_the_reference(xyz, radius):
    for camera in (PLAIN, GOPRO, FISHEYE):
        np.testing.assert_allclose(outline_rays(xyz, radius, 48), reference.outline_rays(xyz, radius, 48), atol=1e-14)
        ours, theirs = circle_of_sphere(xyz, radius, camera), reference.circle_of_sphere(xyz, radius, camera)
        assert ours.distance(theirs) < 1e-8
        assert ours.r_px == pytest.approx(theirs.r_px, abs=1e-8)
        back = sphere_of_circle(theirs, radius, camera)
        np.testing.assert_allclose(back, reference.sphere_of_circle(theirs, radius, camera), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("hold", [None, 0.01, 0.1])
@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("kind", ["none", "chord", "inside", "scattered"])
def test_the_compiled_fit_equals_the_reference(hold, near, kind):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        xyz, sd = np.array([0.25, -0.12, 1.0]), 0.1 / 1150
        rays = noisy(outline_rays(xyz, R, 72), sd, rng) if kind == "none" else occluded(kind, rng, xyz, sd)[0]
        sds = rng.uniform(0.5, 3, 72) * sd
        how = {"loose": 15.0, "hold": hold, "near": near}
        start = xyz * 1.015 + (0.0005, -0.0003, 0)
        ours, theirs = fit_sphere(rays, sds, R, start, **how), reference.fit_sphere(rays, sds, R, start, **how)
        np.testing.assert_allclose(ours.xyz_cam_m, theirs.xyz_cam_m, atol=1e-10)
        np.testing.assert_allclose(ours.covariance_m2, theirs.covariance_m2, rtol=1e-6, atol=1e-16)
        np.testing.assert_allclose(ours.weights, theirs.weights, atol=1e-7)
        np.testing.assert_allclose(ours.outside_rad, theirs.outside_rad, atol=1e-12)
