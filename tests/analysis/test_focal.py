"""The focal length from forearms that turn in depth, as spheres' pictures tell it with a wrong one."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import CAMERA, simulated

from spheremcap.analysis.focal import Pair, _at_factor, focal_of

RADIUS_M = 0.02


def wrong(factor):
    """The camera that somebody guessed: the true one has `factor` times its focal length."""
    return replace(CAMERA, fx_px=CAMERA.fx_px / factor, fy_px=CAMERA.fy_px / factor)


def seen(track, factor):
    """A marker's positions (N, 3) and covariances (N, 3, 3) as the wrong camera gives them."""
    xyz = _at_factor(track.xyz_m.astype(np.float64), RADIUS_M, CAMERA, 1 / factor)
    stretch = np.diag([1.0, 1.0, 1 / factor])
    return xyz, stretch @ track.covariance() @ stretch


def pairs(made, factor, ends=("wrist", "elbow"), sides=("left", "right")):
    found = []
    for side in sides:
        (a, a2), (b, b2) = (seen(made.in_camera(side, joint), factor) for joint in ends)
        found.append(Pair(f"{side} {ends[0]} to {ends[1]}", made.t_s, a, b, a2, b2, (RADIUS_M, RADIUS_M)))
    return found


@pytest.fixture(scope="module")
def made():
    return simulated(seconds=8.0, rate_hz=120.0)


@pytest.mark.parametrize("factor", [1.0, 1.05, 1 / 1.05])
def test_a_wrong_focal_length_is_found(made, factor):
    focal = focal_of(pairs(made, factor), wrong(factor))
    assert not focal.refused
    assert abs(focal.factor - factor) < 3 * focal.sd
    assert focal.factor == pytest.approx(factor, rel=0.005)
    assert 0 < focal.sd < 0.01
    np.testing.assert_allclose(focal.lengths_m, 0.29, rtol=0.01)
    assert max(focal.varies) < 0.02
    assert focal.turned_deg > 20


def test_noise_in_depth_does_not_make_it_shorter():
    """Five times the usual noise lengthens what points in depth: the factor would be 1.4 % too small."""
    noisy = replace(simulated(seconds=8.0, rate_hz=120.0, seed=1), along_m=0.015)
    focal = focal_of(pairs(noisy, 1.0), CAMERA)
    assert not focal.refused
    assert focal.factor == pytest.approx(1.0, abs=0.006)
    assert abs(focal.factor - 1) < 3 * focal.sd


def test_a_part_that_hardly_turns_in_depth_is_refused(made):
    rng = np.random.default_rng(0)
    one, other = (np.array([x, 0.05, 1.2]) + 0.0005 * rng.standard_normal((len(made.t_s), 3)) for x in (-0.1, 0.19))
    spread = np.tile(np.diag([0.0005**2] * 3), (len(made.t_s), 1, 1))
    focal = focal_of([Pair("stick", made.t_s, one, other, spread, spread, (RADIUS_M, RADIUS_M))], CAMERA)
    assert "turn through" in focal.refused
    assert "film a longer stretch" in focal.refused


def test_two_markers_that_are_on_no_one_rigid_part_are_refused(made):
    focal = focal_of(pairs(made, 1.0, ends=("wrist", "shoulder")), CAMERA)
    assert focal.refused
    pair = pairs(made, 1.0, sides=("left",))[0]
    slips = pair.first_m + (pair.first_m - pair.last_m) * 0.12 * np.sin(1.7 * made.t_s)[:, None]
    focal = focal_of([replace(pair, first_m=slips)], CAMERA)
    assert "still varies by" in focal.refused or "in depth" in focal.refused


def test_no_pair_is_an_error():
    with pytest.raises(ValueError, match="no pair"):
        focal_of([], CAMERA)


def test_positions_under_another_focal_length_and_back():
    rng = np.random.default_rng(1)
    xyz = np.column_stack([rng.uniform(-0.4, 0.4, (50, 2)), rng.uniform(0.7, 1.6, 50)])
    xyz = xyz[np.isfinite(CAMERA.project(xyz)).all(axis=1)]
    np.testing.assert_allclose(_at_factor(xyz, RADIUS_M, CAMERA, 1.0), xyz, atol=1e-7)
    there = _at_factor(xyz, RADIUS_M, CAMERA, 1.2)
    other = replace(CAMERA, fx_px=CAMERA.fx_px * 1.2, fy_px=CAMERA.fy_px * 1.2)
    np.testing.assert_allclose(_at_factor(there, RADIUS_M, other, 1 / 1.2), xyz, atol=1e-6)
    # A small sphere near the axis is as much farther as the focal length is longer, and as far across
    small = _at_factor(np.array([[0.01, 0.02, 1.0]]), 0.001, CAMERA, 1.2)
    np.testing.assert_allclose(small, [[0.01, 0.02, 1.2]], rtol=2e-3)
