"""Outlines measured: how sure a circle is said to be, and that this does not depend on where one began to look."""

import numpy as np
import pytest

from scenes import CAMERA, RADIUS_M, Ball, Cover, ball_at, bgr_frame, picture, truth, yuv_frame
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.optics import AT_REST, Motion
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
    looks = [outline().longest(frame, order, AT_REST, None) for order in (proposals, (proposals[0],))]
    assert outline().sharpened(frame, proposals[1][1], "hough", 4.4, AT_REST, None).visible > looks[0].visible
    for claim in looks:
        assert claim.circle.dice(truth(ball)) > 0.95


def test_no_outline_is_less_clear_than_any():
    assert clearness(None) < clearness(measured(ball_at(160, 120, 20)))
