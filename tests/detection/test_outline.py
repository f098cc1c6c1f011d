"""Outlines measured: how sure a circle is said to be, and that this does not depend on where one began to look."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import BLUE, CAMERA, GREEN, ORANGE, RADIUS_M, Ball, Cover, ball_at, bgr_frame, picture, truth, yuv_frame
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch, Window
from spheremcap.core.look import Expected
from spheremcap.core.optics import AT_REST, Motion
from spheremcap.detection.colour import ColourConfig, disc_pixels, learn_box
from spheremcap.detection.edge import EdgeConfig
from spheremcap.detection.outline import Outline, clearness, close_px
from spheremcap.positioning.sphere import PositionConfig, circle_of_sphere

WIDE = Camera(640, 480, 1200.0, 1200.0, 319.5, 239.5)


def outline(camera=CAMERA, rays=48, **position):
    return Outline(RADIUS_M, camera, EdgeConfig(rays=rays), PositionConfig(**position))


def measured(ball, covers=(), motion=AT_REST, camera=CAMERA, seed=0, **how):
    frame = yuv_frame(picture(ball, covers=covers, camera=camera, noise_seed=seed))
    circle = truth(ball, camera)
    return outline(camera, **how).sharpened(frame, circle, "prediction", close_px(circle), motion, None)


def expected(ball, range_sd=0.005, off=0.0, camera=CAMERA):
    """What a filter expects that is sure of the distance to a share `range_sd`, and wrong by a share `off`."""
    circle, range_m = truth(ball, camera), float(np.linalg.norm(ball.xyz)) * (1 + off)
    return Expected(circle, 1.0, range_m, range_sd, np.zeros(2), 1 / 240, AT_REST, 0.5 * circle.r_px)


# -- how sure --------------------------------------------------------------------------------------


@pytest.mark.parametrize("xyz", [(0.0, 0.0, 0.7), (0.3, 0.2, 0.8), (-0.1, 0.28, 0.6)])
def test_the_circles_deviations_are_the_covariance_seen_in_the_picture(xyz):
    """By the numerical derivative of the sphere's circle; far off the axis x, y and r hang together."""
    camera = Camera(800, 600, 500.0, 500.0, 399.5, 299.5)
    ball = Ball(xyz)
    found = measured(ball, camera=camera)

    def circle(place):
        c = circle_of_sphere(place, RADIUS_M, camera)
        return np.array([c.x_px, c.y_px, c.r_px])

    h = 1e-5
    jacobian = np.column_stack(
        [(circle(found.xyz_cam_m + h * e) - circle(found.xyz_cam_m - h * e)) / (2 * h) for e in np.eye(3)]
    )
    expected = np.sqrt(np.diag(jacobian @ found.covariance_m2 @ jacobian.T))
    np.testing.assert_allclose(found.circle_sd_px, expected, rtol=0.15)


@pytest.mark.parametrize("hidden", [0.45, 0.6])
def test_a_hidden_part_makes_the_radius_less_sure(hidden):
    """What hides it may pass for its outline: a tenth of the radius for all of the outline, beyond a fifth of it."""
    ball = ball_at(160, 120, 20)
    edge_x = round(160 + 20 * np.cos(np.pi * hidden))
    whole, part = measured(ball), measured(ball, covers=(Cover(edge_x, 60, 250, 180),))
    assert whole.visible > 0.9
    assert part.visible < 0.7
    least = 0.1 * (0.8 - part.visible) * 20
    assert part.circle_sd_px[2] > least > 2 * whole.circle_sd_px[2]
    along = part.xyz_cam_m / np.linalg.norm(part.xyz_cam_m)
    relative = np.sqrt(along @ part.covariance_m2 @ along) / np.linalg.norm(part.xyz_cam_m)
    assert relative > least / 20


def test_more_rays_over_the_same_pixels_do_not_make_it_surer():
    ball = ball_at(160, 120, 9)
    few, many = (
        np.mean([measured(ball, seed=seed, rays=rays, systematic_px=0.0).circle_sd_px for seed in range(5)], axis=0)
        for rays in (48, 192)
    )
    np.testing.assert_allclose(many, few, rtol=0.25)
    alone = measured(ball, rays=192, systematic_px=0.0, shared_px=0.0).circle_sd_px
    assert max(np.array(alone) / many) < 0.35  # as it would be if each ray were a witness of its own


def test_what_all_edge_points_share_is_added():
    ball = ball_at(160, 120, 25)
    plain, shared = measured(ball, systematic_px=0.0), measured(ball, systematic_px=0.5)
    np.testing.assert_allclose(
        np.square(shared.circle_sd_px) - np.square(plain.circle_sd_px), [0.25, 0.25, 0.25], rtol=0.02
    )


def test_an_unknown_readout_makes_the_radius_less_sure():
    ball = ball_at(160, 120, 20)
    sure, unsure = measured(ball), measured(ball, motion=Motion(np.zeros(2), np.zeros(2), stretch_sd=0.04))
    assert unsure.circle == sure.circle
    added = unsure.circle_sd_px[2] ** 2 - sure.circle_sd_px[2] ** 2
    assert np.sqrt(added) == pytest.approx(0.5 * 0.04 * sure.circle.r_px, rel=0.02)
    np.testing.assert_allclose(unsure.circle_sd_px[:2], sure.circle_sd_px[:2], rtol=0.02)


# -- given what the filter expects -----------------------------------------------------------------


def half_hidden(seed, known):
    ball = ball_at(160.3, 119.8, 20)
    frame = yuv_frame(picture(ball, covers=(Cover(160, 60, 250, 180),), noise_seed=seed, backdrop=seed))
    circle = truth(ball)
    start = circle.shifted(0.4, -0.3).resized(circle.r_px * 1.02)
    what = expected(ball) if known else None
    found = outline().sharpened(frame, start, "prediction", close_px(circle), AT_REST, None, what)
    return found, circle, ball


def test_an_expected_distance_makes_the_radius_of_a_half_hidden_ball_right():
    free, held = (
        np.array([found.circle.r_px - true.r_px for found, true, _ in (half_hidden(s, known) for s in range(6))])
        for known in (False, True)
    )
    assert np.sqrt((held**2).mean()) < 0.5 * np.sqrt((free**2).mean())
    assert np.abs(held).max() < 0.1


def test_the_outline_alone_is_what_it_would_be_without_the_expectation_and_less_sure():
    for seed in range(4):
        free, held = half_hidden(seed, False)[0], half_hidden(seed, True)[0]
        along = held.xyz_cam_m / np.linalg.norm(held.xyz_cam_m)
        place, covariance = held.outline_alone
        distance = np.linalg.norm(held.xyz_cam_m)
        assert np.linalg.norm(place - held.xyz_cam_m) > 1e-4
        own = np.sqrt(along @ covariance @ along)
        assert own > 0.01 * distance  # a half-hidden outline may be off by so much
        assert abs(np.linalg.norm(place) - np.linalg.norm(free.xyz_cam_m)) < 0.5 * own
        # The likeliest place is as sure as both witnesses together, of which one is the distance to 0.5 and 1 %. One
        # frame is surer than the filter may take it for: what hides the half is alike in the next ones.
        known, once = np.hypot(0.005, 0.01) * distance, np.sqrt(along @ free.covariance_m2 @ along)
        assert along @ held.covariance_m2 @ along == pytest.approx(1 / (1 / once**2 + 1 / known**2), rel=0.05)
        assert own**2 > 3 * once**2
        assert held.circle_sd_px[2] < 0.8 * free.circle_sd_px[2]


def test_where_nothing_is_expected_the_outline_alone_is_the_place():
    found = half_hidden(0, False)[0]
    np.testing.assert_allclose(found.outline_alone[0], found.xyz_cam_m, atol=1e-6)
    more = found.outline_alone[1] - found.covariance_m2
    along = found.xyz_cam_m / np.linalg.norm(found.xyz_cam_m)
    assert along @ more @ along > 0.99 * np.trace(more) > 0  # of its distance alone


def test_an_outline_seen_as_a_whole_is_as_sure_to_the_filter_as_it_says():
    ball = ball_at(160.3, 119.8, 20)
    found = outline().first_look(yuv_frame(picture(ball)), truth(ball))
    assert found.visible > 0.8
    np.testing.assert_array_equal(found.outline_alone[1], found.covariance_m2)


def test_a_wrong_expected_distance_hardly_moves_an_outline_that_is_seen_as_a_whole():
    ball = ball_at(160.3, 119.8, 20)
    frame, circle = yuv_frame(picture(ball)), truth(ball)
    free, held = (
        outline().sharpened(frame, circle, "prediction", close_px(circle), AT_REST, None, known)
        for known in (None, expected(ball, range_sd=0.01, off=0.04))
    )
    assert abs(held.circle.r_px - free.circle.r_px) < 0.05 * 0.04 * circle.r_px


# -- the marker's colours --------------------------------------------------------------------------


def test_edges_count_whose_colour_is_within_the_loosened_limits():
    """The marker in half the light that its colours were learnt in, a little more: within the loosened limits."""
    ball = ball_at(160.3, 119.8, 20)
    frame, circle = yuv_frame(picture(ball, noise=0)), truth(ball)
    patch = Patch(frame, Window.around(circle, 2 * circle.r_px))
    limits = learn_box(disc_pixels(patch, circle, 0.8), ColourConfig()).limits()
    darker = limits * np.array([1, 1, 1.3, 1.3, 1.5, 1.5])  # as learnt where it was brighter and of more colour
    for asked in (limits, darker):
        found = outline().sharpened(frame, circle, "prediction", close_px(circle), AT_REST, asked)
        assert found.visible > 0.9
    other = limits + np.array([90, 0, 0, 0, 0, 0])
    assert outline().sharpened(frame, circle, "prediction", close_px(circle), AT_REST, other) is None


# -- where one began -------------------------------------------------------------------------------


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize("r_px", [20, 39, 41, 50, 80])
def test_a_start_a_little_off_leads_to_the_same_circle(r_px, frame_of):
    """Large markers are sampled less densely, which must not let an edge jump to the other side of its start."""
    ball = ball_at(320.3, 240.2, r_px, camera=WIDE)
    true, frame = truth(ball, WIDE), frame_of(picture(ball, camera=WIDE, noise_seed=1))
    found = [
        outline(WIDE).sharpened(frame, true.shifted(d, 0.5 * d), "prediction", close_px(true), AT_REST, None).circle
        for d in (0.0, 0.3, 0.6, -0.4)
    ]
    for circle in found:
        assert circle.distance(true) < 0.2
        assert abs(circle.r_px - true.r_px) < 0.12
        assert circle.distance(found[0]) < 0.1


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize("r_px", [15, 30, 50, 80])
def test_a_start_too_small_and_one_too_large_lead_to_the_same_radius(r_px, frame_of):
    """From 3 % off either way, over texture and with shading: what is left of the 6 % is less than a quarter."""
    for seed, rgb in enumerate((ORANGE, GREEN, BLUE)):
        ball = ball_at(320.3, 240.2, r_px, camera=WIDE, rgb=rgb)
        true, frame = truth(ball, WIDE), frame_of(picture(ball, camera=WIDE, noise_seed=seed, backdrop=seed))
        small, large = (
            outline(WIDE).sharpened(frame, true.resized(s * true.r_px), "prediction", close_px(true), AT_REST, None)
            for s in (0.97, 1.03)
        )
        assert abs(large.circle.r_px - small.circle.r_px) < 0.25 * 0.06 * true.r_px
        assert small.visible > 0.7
        assert large.visible > 0.7


def test_a_lean_is_taken_out_and_the_circle_is_the_one_as_seen():
    """The same picture under two suppositions: what is seen stays, what it would be at rest does not."""
    ball = ball_at(160, 120, 20)
    still, falling = measured(ball), measured(ball, motion=Motion(np.zeros(2), np.array([0.0, 0.05])))
    assert falling.circle.r_px == pytest.approx(still.circle.r_px, abs=0.1)
    assert falling.xyz_cam_m[2] / still.xyz_cam_m[2] == pytest.approx(1 / np.sqrt(0.95), rel=0.005)


def test_of_two_proposals_the_one_with_the_longer_outline_is_claimed():
    """A smaller circle within shows all of its outline, the marker half of its own: the longer one it is."""
    ball, mark = ball_at(160, 120, 24), ball_at(157, 120, 17, rgb=(30, 60, 160), radius_m=0.0145)
    frame = yuv_frame(picture(ball, mark, covers=(Cover(176, 60, 260, 180),)))
    proposals = (("prediction", Circle(160, 120, 24)), ("hough", Circle(157, 120, 17)))
    looks = [outline().longest(frame, order, AT_REST, None, None) for order in (proposals, (proposals[0],))]
    assert outline().sharpened(frame, proposals[1][1], "hough", 4.4, AT_REST, None).visible > looks[0].visible
    for claim in looks:
        assert claim.circle.dice(truth(ball)) > 0.9


@pytest.mark.parametrize("size", [0.78, 1.35])
@pytest.mark.parametrize("seen", ["whole", "half"])
def test_a_proposal_of_another_size_is_believed_where_it_is_a_whole(size, seen):
    """A ball that falls away from the camera is a fifth smaller a frame later, whatever was expected."""
    ball, usual = ball_at(160, 120, 24), Circle(161, 121, 24 / size)
    frame = yuv_frame(picture(ball, covers=(Cover(166, 60, 260, 180),) if seen == "half" else ()))
    what = replace(expected(ball, off=size - 1), circle=usual, reach_px=40.0)
    proposals = (("prediction", usual), ("colour", Circle(159, 120, 23)))
    claim = outline().longest(frame, proposals, AT_REST, None, what)
    right = claim is not None and claim.circle.dice(truth(ball)) > 0.98
    assert right is (seen == "whole")


def test_of_a_streak_no_other_size_is_tried(monkeypatch):
    """What colours say of its size is the streak's."""
    tried = []
    monkeypatch.setattr(Outline, "sharpened", lambda self, *given: tried.append(given[6]))  # what is expected
    ball, usual = ball_at(160, 120, 24), Circle(161, 121, 30)
    proposals, what = (("colour", Circle(159, 120, 23)),), expected(ball)
    for blur_px, sizes in ((29.9, [what, None]), (30.1, [what])):
        tried.clear()
        motion = replace(AT_REST, blur_px=np.array([blur_px, 0.0]))
        frame = yuv_frame(picture(ball))
        outline().longest(frame, (("kcf", usual), *proposals), motion, None, what)
        assert tried[1:] == sizes


def test_of_what_the_pictures_border_cuts_off_no_other_size_is_believed():
    for cut, right in ((21, True), (8, False)):
        ball = ball_at(cut, 120, 24)
        frame, usual = yuv_frame(picture(ball)), Circle(cut, 121, 24 / 0.84)
        what = replace(expected(ball, off=-0.16), circle=usual, reach_px=40.0)
        claim = outline().longest(frame, (("prediction", usual), ("colour", Circle(cut, 120, 23))), AT_REST, None, what)
        assert (claim is not None and claim.circle.dice(truth(ball)) > 0.98) is right, (cut, claim and claim.circle)


def test_no_outline_is_less_clear_than_any():
    assert clearness(None) < clearness(measured(ball_at(160, 120, 20)))
