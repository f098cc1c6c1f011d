"""The filter before a camera: what it expects of a frame, how far it looks for what was lost, what it hands out."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from scenes import CAMERA, RADIUS_M
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame
from spheremcap.core.look import EdgePoints, Measured
from spheremcap.core.optics import AT_REST, Optics
from spheremcap.core.time import NS_PER_S
from spheremcap.positioning.kalman import KalmanConfig
from spheremcap.positioning.sphere import PositionConfig, circle_of_sphere
from spheremcap.positioning.whereabouts import Whereabouts, outside_px

CALM = KalmanConfig(acceleration_mps2=2.0)
STEP_NS = 4_000_000


def frame_at(stamp_ns):
    return Frame(0, stamp_ns, CAMERA.width_px, CAMERA.height_px)


def claim(xyz, sd_m=1e-4):
    xyz = np.array(xyz, float)
    edges = EdgePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.intp), np.zeros(0), 48, 1.0)
    circle = circle_of_sphere(xyz, RADIUS_M, CAMERA) or Circle(0, 0, 15)
    return Measured(circle, (0.1,) * 3, xyz, np.eye(3) * sd_m**2, 1.0, "kcf", edges, np.zeros(0), np.zeros(0), AT_REST)


def moving(start, velocity, frames=12, kalman=CALM, camera=CAMERA, position=None):
    """After so many frames at an even speed; the stamp of the last one is `(frames - 1) * STEP_NS`."""
    where = Whereabouts(RADIUS_M, camera, kalman, position or PositionConfig())
    for k in range(frames):
        xyz = np.array(start) + np.array(velocity) * (k * STEP_NS / NS_PER_S)
        if k:
            where.track.predict(k * STEP_NS)
        where.accept(k * STEP_NS, claim(xyz), again=k == 0)
    return where


def expect(where, ahead, optics=None):
    stamp_ns = where.seen.stamp_ns + int(ahead * STEP_NS)
    return where.expect(frame_at(stamp_ns), STEP_NS / NS_PER_S, optics or Optics())


def test_it_is_expected_where_an_even_motion_brings_it():
    where = moving((-0.05, 0.0, 0.8), (1.0, 0.5, 0.0))
    found = expect(where, 1)
    true = circle_of_sphere(np.array([-0.05, 0.0, 0.8]) + np.array([1.0, 0.5, 0.0]) * 0.048, RADIUS_M, CAMERA)
    assert found.circle.distance(true) < 0.1
    np.testing.assert_allclose(found.rate_px, [600 / 0.8, 300 / 0.8], rtol=0.02)
    assert found.reach_px == 0.5 * found.circle.r_px  # sure of it
    assert found.range_m == pytest.approx(np.linalg.norm(where.track.now.xyz_cam_m))
    assert found.range_sd == pytest.approx(np.sqrt(where.track.now.covariance[2, 2]) / 0.8, rel=0.05)


def test_it_is_looked_for_farther_away_the_less_is_known_but_never_beyond_three_radii():
    found = [expect(moving((0, 0, 0.8), (0, 0, 0), kalman=KalmanConfig()), n) for n in (1, 4, 8, 40)]
    spreads = [e.spread_px for e in found]
    assert spreads == sorted(spreads)
    assert found[1].reach_px == pytest.approx(max(3 * found[1].spread_px, 0.5 * found[1].circle.r_px))
    assert found[-1].spread_px > found[-1].circle.r_px
    assert found[-1].reach_px == pytest.approx(3 * found[-1].circle.r_px)


def test_a_lean_and_a_streak_are_those_of_its_speed_and_the_circle_is_as_seen():
    optics = Optics(exposure_s=0.002, readout_s=0.01)
    where = moving((0.0, -0.05, 0.8), (0.0, 1.5, 0.0))
    found, global_one = expect(where, 1, optics), expect(moving((0.0, -0.05, 0.8), (0.0, 1.5, 0.0)), 1)
    np.testing.assert_allclose(found.motion.blur_px, found.rate_px * 0.002)
    lean = 0.01 * found.rate_px[1] / (CAMERA.height_px - 1)
    assert found.motion.lean[1] == pytest.approx(lean)
    assert found.circle.r_px / global_one.circle.r_px == pytest.approx(1 / np.sqrt(1 - lean))


def test_nothing_is_expected_once_it_is_surely_outside_the_picture():
    where = moving((0.03, 0.0, 0.8), (4.0, 0.0, 0.0))  # 12 px a frame
    seen = []
    for n in range(1, 12):
        found = where.expect(frame_at(where.seen.stamp_ns + n * STEP_NS), 0.004, Optics())
        circle = where.image()
        spread_px = np.sqrt(where.track.now.covariance[0, 0]) / where.track.now.state[2] * CAMERA.fx_px
        out = outside_px(frame_at(0), circle)
        assert (found is None) == (out > circle.r_px + 3 * spread_px)
        seen.append(found is None)
    assert seen == sorted(seen)
    assert set(seen) == {False, True}


@pytest.mark.parametrize(("towards", "times"), [(-6.0, 2.0), (6.0, 0.5)])
def test_a_wild_depth_does_not_make_a_wild_circle(towards, times):
    """It comes at the camera, or goes, for so long that its circle would be anything."""
    where = moving((0.0, 0.0, 0.8), (0.0, 0.0, towards))
    found = expect(where, 20 if towards < 0 else 60)
    assert circle_of_sphere(where.track.now.xyz_cam_m, RADIUS_M, CAMERA).r_px != pytest.approx(found.circle.r_px)
    assert found.circle.r_px == pytest.approx(times * where.circle.r_px)


def test_behind_the_camera_there_is_nothing_to_expect():
    where = moving((0.0, 0.0, 0.3), (0.0, 0.0, -6.0), frames=5)
    assert expect(where, 20) is None
    assert where.image() is None
    assert where.gone(frame_at(0))


@pytest.mark.parametrize(("out", "gone"), [(0.25, False), (0.35, True)])
def test_it_is_gone_when_the_filter_is_sure_that_its_middle_is_well_outside(out, gone):
    z = 0.8
    r_px = 600 * RADIUS_M / z
    x = (319 + out * r_px - 159.5) / 600 * z
    assert moving((x, 0, z), (0, 0, 0)).gone(frame_at(0)) == gone
    unsure = moving((x, 0, z), (0, 0, 0))
    unsure.track.predict(unsure.seen.stamp_ns + 40 * STEP_NS)
    vague = Whereabouts(RADIUS_M, CAMERA, KalmanConfig(), PositionConfig())
    vague.accept(0, claim((x, 0, z), sd_m=4.1 * RADIUS_M), again=True)
    assert not vague.gone(frame_at(0))


@pytest.mark.parametrize("again", [False, True])
def test_the_filter_takes_in_what_the_outline_says_by_itself(again):
    """The likeliest place has the filter's own distance in it, which must not be counted again."""
    where, same = (moving((0.0, 0.0, 0.8), (0.0, 0.0, 0.0)) for _ in range(2))
    stamp_ns = where.seen.stamp_ns + STEP_NS
    alone = np.array([0.001, 0.0, 0.81]), np.diag([1e-3, 1e-3, 5e-3]) ** 2
    plain = claim(alone[0])
    likeliest = replace(claim((0.0, 0.0, 0.801)), alone=alone)
    for track in (where, same):
        track.track.predict(stamp_ns)
    surprise = same.track.surprise(*alone)
    assert surprise != pytest.approx(same.track.surprise(likeliest.xyz_cam_m, likeliest.covariance_m2), rel=0.5)
    assert where.surprise(likeliest, None)[0] == pytest.approx(surprise)
    where.accept(stamp_ns, likeliest, again=again)
    same.accept(stamp_ns, replace(plain, covariance_m2=alone[1]), again=again)
    np.testing.assert_array_equal(where.track.now.state, same.track.now.state)
    np.testing.assert_array_equal(where.track.now.covariance, same.track.now.covariance)
    assert where.circle == likeliest.circle


def test_a_claim_without_an_expectation_is_the_outline_alone():
    found = claim((0.0, 0.0, 0.8))
    assert found.outline_alone[0] is found.xyz_cam_m
    assert found.outline_alone[1] is found.covariance_m2


# -- lost ------------------------------------------------------------------------------------------


def test_a_lost_one_is_looked_for_where_an_even_motion_would_have_it():
    where = moving((-0.05, 0.0, 0.8), (1.0, 0.0, 0.0))
    absence = where.absence(frame_at(where.seen.stamp_ns + 25 * STEP_NS), left=False)
    np.testing.assert_allclose(absence.xyz_cam_m, where.seen.xyz_cam_m + np.array([0.1, 0, 0]), atol=2e-3)
    centre = circle_of_sphere(absence.xyz_cam_m, RADIUS_M, CAMERA)
    assert absence.region.holds(centre.x_px, centre.y_px)
    middle = absence.region.x + absence.region.width / 2
    assert middle == pytest.approx(centre.x_px, abs=1.5)


def test_one_that_left_the_picture_is_looked_for_where_it_went_out():
    where = moving((0.0, 0.0, 0.8), (1.0, 0.0, 0.0))
    stamp_ns = where.seen.stamp_ns + 25 * STEP_NS
    went, strayed = (where.absence(frame_at(stamp_ns), left=left) for left in (True, False))
    np.testing.assert_array_equal(went.xyz_cam_m, where.seen.xyz_cam_m)
    assert went.tolerance_m == pytest.approx(strayed.tolerance_m + 0.1, abs=2e-3)  # the way it can have gone and come


def test_one_that_would_be_outside_the_picture_is_looked_for_in_it():
    """Lost with a speed that it did not keep: the place that it would have by now is thousands of pixels away."""
    where = moving((0.15, 0.0, 0.8), (3.0, 0.0, 0.0), kalman=KalmanConfig())
    for away_s in (0.2, 1.0, 10.0):
        frame = frame_at(where.seen.stamp_ns + int(away_s * NS_PER_S))
        absence = where.absence(frame, left=False)
        region = absence.region.clipped(frame.width_px, frame.height_px)
        assert (region.width, region.height) == (frame.width_px, frame.height_px)
        assert absence.circle.distance(where.circle) == 0
        assert where.surprise(claim(where.seen.xyz_cam_m), absence)[0] < 0.1
        assert where.surprise(claim((-0.15, 0.05, 0.8)), absence)[0] < 1


def test_the_longer_it_is_away_the_farther_and_the_larger_it_may_be():
    where = moving((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))
    found = [where.absence(frame_at(where.seen.stamp_ns + int(s * NS_PER_S)), left=False) for s in (0.0, 0.1, 1, 60)]
    for less, more in pairwise(found):
        assert more.tolerance_m > less.tolerance_m
        assert more.growth > less.growth or more.growth == pytest.approx(np.exp(5))
        assert more.region.width >= less.region.width
    assert found[0].growth == pytest.approx(np.exp(0.15))
    assert found[1].growth == pytest.approx(np.exp(0.35))
    assert found[-1].region.width <= 4 * 320 + 3  # bounded, however long


def test_a_claim_is_as_surprising_as_it_is_far_from_where_it_can_be():
    where = moving((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))
    absence = where.absence(frame_at(where.seen.stamp_ns + 10 * STEP_NS), left=False)
    slack = absence.tolerance_m + 3 * np.sqrt(2) * 1e-4
    at_the_edge = claim(absence.xyz_cam_m + np.array([slack, 0, 0]))
    assert where.surprise(at_the_edge, absence) == (pytest.approx(1.0, abs=1e-4), absence.growth)
    surprise, growth = where.surprise(claim((0.0, 0.0, 0.8)), None)
    assert surprise < 0.1
    assert growth == 2.0
    assert where.surprise(claim((0.05, 0.0, 0.8)), None)[0] > 1


def test_the_last_verified_state_stays_while_the_filter_goes_on():
    where = moving((0.0, 0.0, 0.8), (1.0, 0.0, 0.0))
    seen, circle = where.seen, where.circle
    expect(where, 5)
    assert where.seen is seen
    assert where.circle is circle
    assert where.track.now.stamp_ns == seen.stamp_ns + 5 * STEP_NS


def test_starting_again_forgets_the_speed():
    where = moving((0.0, 0.0, 0.8), (1.0, 0.0, 0.0))
    assert where.track.moving_known
    where.accept(where.seen.stamp_ns + STEP_NS, claim((0.1, 0.0, 0.8)), again=True)
    assert not where.track.moving_known
    np.testing.assert_array_equal(where.seen.velocity_cam_mps, 0)


# -- handed out ------------------------------------------------------------------------------------


def test_the_focal_lengths_uncertainty_is_along_the_ray():
    where = moving((0.1, 0.0, 0.8), (0.0, 0.0, 0.0), camera=replace(CAMERA, focal_sd=0.03))
    place = np.array([0.1, -0.2, 0.8])
    np.testing.assert_allclose(
        where.reported(place, np.eye(3) * 1e-6), np.eye(3) * 1e-6 + 9e-4 * np.outer(place, place)
    )


@pytest.mark.parametrize(("formula", "off"), [("edges", 0.0), ("circle", 0.001), ("thesis", 0.02)])
def test_a_formula_changes_what_is_reported_and_not_the_filter(formula, off):
    where = moving((0.1, 0.05, 0.8), (0.0, 0.0, 0.0), position=PositionConfig(formula=formula))
    placed = where.placed(claim((0.1, 0.05, 0.8)))
    assert np.linalg.norm(placed - (0.1, 0.05, 0.8)) <= off or formula == "thesis"
    assert (np.linalg.norm(placed - (0.1, 0.05, 0.8)) > off) == (formula == "thesis")
    np.testing.assert_allclose(where.track.now.xyz_cam_m, (0.1, 0.05, 0.8), atol=1e-6)


@pytest.mark.parametrize(
    ("velocity", "x", "y"),
    [
        ((3.0, 0, 0), (160, 320), None), ((-3.0, 0, 0), (0, 160), None),
        ((0, 3.0, 0), None, (120, 240)), ((0, -3.0, 0), None, (0, 120)),
    ],
)  # fmt: skip
def test_one_that_left_is_looked_for_in_the_half_on_the_side_that_it_went_out_of(velocity, x, y):
    where = moving((0.0, 0.0, 0.8), velocity, frames=8, kalman=KalmanConfig())
    frame = frame_at(where.seen.stamp_ns + 20 * STEP_NS)
    region = where.absence(frame, left=True).region.clipped(frame.width_px, frame.height_px)
    assert region.width > 0
    assert region.height > 0
    if x is not None:
        assert x[0] <= region.x
        assert region.x + region.width <= x[1]
    if y is not None:
        assert y[0] <= region.y
        assert region.y + region.height <= y[1]
    whole = where.absence(frame, left=False).region.clipped(frame.width_px, frame.height_px)
    assert whole.width * whole.height > region.width * region.height


def test_it_says_how_unsure_it_is_sideways_in_radii():
    where = moving((0.0, 0.0, 0.8), (0.5, 0.0, 0.0))
    before = where.unsure_radii
    for k in range(1, 40):
        where.track.predict(where.seen.stamp_ns + k * STEP_NS)
    covariance = where.track.now.covariance
    assert where.unsure_radii == pytest.approx(max(covariance[0, 0], covariance[1, 1]) ** 0.5 / RADIUS_M)
    assert where.unsure_radii > 10 * before


# -- how far away its size says that it is ---------------------------------------------------------


def test_where_its_size_is_the_surer_it_says_how_far_and_how_large():
    """At 30 frames a second the filter's acceleration leaves much more of the distance open."""
    slow, wild = 8 * STEP_NS, KalmanConfig()
    where = Whereabouts(RADIUS_M, CAMERA, wild, PositionConfig())
    for k in range(20):
        if k:
            where.track.predict(k * slow)
        where.accept(k * slow, claim((0.0, 0.0, 0.8)), again=k == 0)
    found = where.expect(frame_at(20 * slow), slow / NS_PER_S, Optics())
    moment = where.track.now
    assert found.range_sd < 0.3 * np.sqrt(moment.covariance[2, 2]) / 0.8
    assert (found.range_m, found.range_sd) == where.size.expect(20 * slow)
    # A part that looks like a smaller whole moves the filter, not this.
    where.track.predict(20 * slow)
    where.accept(20 * slow, claim((0.0, 0.0, 0.96), sd_m=0.07), again=False)
    found = where.expect(frame_at(21 * slow), slow / NS_PER_S, Optics())
    assert found.range_m == pytest.approx(0.8, abs=0.01)
    assert found.circle.r_px == pytest.approx(circle_of_sphere(np.array([0, 0, 0.8]), RADIUS_M, CAMERA).r_px, rel=0.015)


def test_an_outline_of_which_little_shows_tells_hardly_anything_of_the_size():
    """What hides a part stays, and the circle on to which it shrinks is as sure of itself as a whole one."""
    slow, found = 8 * STEP_NS, {}
    for visible in (1.0, 0.8, 0.5):
        where = Whereabouts(RADIUS_M, CAMERA, KalmanConfig(), PositionConfig())
        for k in range(40):
            if k:
                where.track.predict(k * slow)
            seen = claim((0.0, 0.0, 0.8 if k < 15 else 0.88))
            where.accept(k * slow, replace(seen, visible=1.0 if k < 15 else visible), again=k == 0)
        found[visible] = where.size.expect(40 * slow)[0]
    assert found[1.0] == found[0.8] == pytest.approx(0.88, abs=0.005)
    assert found[0.5] < 0.82


def test_a_lost_one_is_expected_as_large_as_it_should_be_anywhere():
    where = moving((0.0, 0.0, 0.8), (0.5, 0.0, -0.4), frames=30)
    absence = where.absence(frame_at(where.seen.stamp_ns + 5 * STEP_NS), left=False)
    assert (absence.range_m, absence.range_sd) == where.size.expect(where.seen.stamp_ns + 5 * STEP_NS)
    assert absence.circle.r_px == pytest.approx(
        where.circle.r_px * np.linalg.norm(where.seen.xyz_cam_m) / absence.range_m
    )
    assert absence.circle.r_px > where.circle.r_px
    found = absence.at(Circle(40.0, 30.0, 5.0), 0.004, 1.6)
    assert found.circle == Circle(40.0, 30.0, absence.circle.r_px)
    assert (found.range_m, found.range_sd) == (absence.range_m, absence.range_sd)
    assert found.motion.softness == 1.6
    assert not np.any(found.motion.blur_px)


def test_one_that_is_away_for_long_is_sought_as_it_was():
    where = moving((0.0, 0.0, 0.8), (0.0, 0.0, -3.0), frames=30)
    absence = where.absence(frame_at(where.seen.stamp_ns + 3600 * NS_PER_S), left=False)
    assert absence.range_sd > 0.3
    assert absence.circle.r_px == where.circle.r_px


# -- followed without an outline -------------------------------------------------------------------


def test_steering_brings_the_filter_sideways_and_leaves_the_distance_and_what_was_seen():
    where = moving((0.0, 0.0, 0.8), (0.0, 0.0, 0.0), kalman=KalmanConfig())
    seen, circle, sized = where.seen, where.circle, where.size.expect(where.seen.stamp_ns)
    for k in range(1, 4):
        where.track.predict(where.seen.stamp_ns + k * 4 * STEP_NS)
        where.steer(circle.shifted(4.0 * k, 0.0).resized(0.7 * circle.r_px))
    image = where.image()
    assert image.x_px == pytest.approx(circle.x_px + 12, abs=2.0)
    assert image.r_px == pytest.approx(circle.r_px, rel=0.01)
    assert where.unsure_radii < 0.5
    assert (where.seen, where.circle) == (seen, circle)
    assert where.size.expect(seen.stamp_ns) == sized
