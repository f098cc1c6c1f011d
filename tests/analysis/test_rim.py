"""A wrist about its wheel: known places, left as right, and its covariance against numerical derivatives."""

import numpy as np
import pytest

from spheremcap.analysis.rim import Wheel, about_axle
from spheremcap.synth.strokes import Arm, Manner, motion

CAMBER = float(np.radians(11.0))
NONE = np.zeros((1, 3, 3))


def about(xyz, wheel, covariance=None):
    xyz = np.atleast_2d(np.asarray(xyz, np.float64))
    full = np.zeros((len(xyz), 3, 3)) if covariance is None else covariance
    return about_axle(xyz, full.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]], wheel)


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_places_about_an_upright_wheel(side, sign):
    wheel = Wheel.of(side, 0.3, 0.0)
    np.testing.assert_allclose(wheel.hub_m, (0, sign * 0.3, 0))
    places = [(0, 0.3, 0.2), (0.2, 0.3, 0), (0, 0.3, -0.2), (-0.2, 0.3, 0), (0, 0.37, 0.2), (0, 0.25, 0.2)]
    found = about(np.array(places) * (1, sign, 1), wheel)
    np.testing.assert_allclose(found.radius_m, 0.2)
    # From straight up over forward: as the wheel turns when the chair goes forward, and on without a jump
    np.testing.assert_allclose(np.degrees(found.angle_rad), (0, 90, 180, 270, 360, 360), atol=1e-9)
    np.testing.assert_allclose(found.outward_m, (0, 0, 0, 0, 0.07, -0.05), atol=1e-12)


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_a_cambered_wheels_top_leans_inward(side, sign):
    wheel = Wheel.of(side, 0.3, CAMBER)
    top = (0, sign * (0.3 - 0.2 * np.sin(CAMBER)), 0.2 * np.cos(CAMBER))
    outside = np.array(top) + 0.02 * np.array([0, sign * np.cos(CAMBER), np.sin(CAMBER)])
    found = about([top, outside], wheel)
    np.testing.assert_allclose(found.radius_m, 0.2)
    np.testing.assert_allclose(found.angle_rad, 0, atol=1e-12)
    np.testing.assert_allclose(found.outward_m, (0, 0.02), atol=1e-12)


def test_both_wheels_are_each_others_mirror_and_as_the_rendered_ones():
    made: dict[str, Arm] = {arm.side: arm for arm in motion(Manner(), 1.0, np.random.default_rng(0)).arms}
    uvw = np.random.default_rng(1).uniform(-0.3, 0.3, (30, 3))
    for side in ("left", "right"):
        found = about(made[side].in_chair(uvw), Wheel.of(side, 0.3, CAMBER))
        np.testing.assert_allclose(found.radius_m, np.hypot(uvw[:, 0], uvw[:, 1]))
        np.testing.assert_allclose(np.sin(found.angle_rad), uvw[:, 0] / found.radius_m)
        np.testing.assert_allclose(np.cos(found.angle_rad), uvw[:, 1] / found.radius_m)
        np.testing.assert_allclose(found.outward_m, uvw[:, 2], atol=1e-12)


def test_the_covariance_is_that_of_numerical_derivatives():
    rng = np.random.default_rng(2)
    xyz = rng.uniform(-0.3, 0.3, (20, 3)) + np.array([0, 0.3, 0])
    root = rng.normal(0, 0.002, (20, 3, 3))
    covariance = root @ root.transpose(0, 2, 1)
    wheel = Wheel.of("left", 0.28, CAMBER)
    found = about(xyz, wheel, covariance)
    for k in range(20):
        step = 1e-6
        moved = about(xyz[k] + step * np.concatenate([np.eye(3), -np.eye(3)]), wheel)
        radius, angle = moved.radius_m, found.radius_m[k] * moved.angle_rad
        jacobian = np.stack([radius[:3] - radius[3:], angle[:3] - angle[3:]]) / (2 * step)
        np.testing.assert_allclose(found.covariance[k], jacobian @ covariance[k] @ jacobian.T, rtol=1e-4, atol=1e-12)


def test_a_gap_is_nan_and_the_angle_goes_on_beyond_it():
    angle = np.radians(np.arange(300, 700, 10.0))
    xyz = np.stack([0.2 * np.sin(angle), 0.3 + 0 * angle, 0.2 * np.cos(angle)], axis=1)
    xyz[10:15] = np.nan
    found = about(xyz, Wheel.of("left", 0.3, 0.0))
    seen = np.isfinite(xyz[:, 0])
    assert np.isnan(found.radius_m[~seen]).all()
    assert np.isnan(found.angle_rad[~seen]).all()
    np.testing.assert_allclose(np.diff(found.angle_rad[seen]), np.diff(angle[seen]), atol=1e-9)
