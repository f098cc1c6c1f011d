"""Sub-pixel outlines of shaded spheres: through MarkerChain.seed, and the edge points themselves."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from reference import edge as reference
from scenes import (
    BLUE,
    CAMERA,
    GREEN,
    LENS_SIGMA_PX,
    ORANGE,
    RADIUS_M,
    Cover,
    ball_at,
    bgr_frame,
    picture,
    to_code,
    to_linear,
    truth,
    yuv_frame,
)
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Patch, Window
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.optics import AT_REST
from spheremcap.detection.colour import ColourConfig, disc_pixels, learn_box
from spheremcap.detection.edge import EdgeConfig, find_edges
from spheremcap.detection.outline import Outline, close_px
from spheremcap.positioning.sphere import PositionConfig, circle_of_sphere, fit_sphere, outline_px

SPEC = MarkerSpec("marker", 2 * RADIUS_M)
COLOURS = (ORANGE, GREEN, BLUE)
STILL = np.zeros(2)
PLACES = [(131.3, 104.8), (166.0, 118.5), (190.72, 131.27), (148.4, 139.9), (175.15, 98.33), (120.85, 121.6)]


def seeded(frame, near):
    return MarkerChain(SPEC, CAMERA, ChainConfig()).seed(frame, near)


def outline_errors(r, frame_of, noise=2.0):
    """(x, y, r) errors in pixels over places, colours and noise; the seed is a careless circle."""
    errors = []
    for k, (x, y) in enumerate(PLACES):
        ball = ball_at(x, y, r, rgb=COLOURS[k % 3])
        true = truth(ball)
        near = Circle(true.x_px + 0.07 * r * (-1) ** k, true.y_px - 0.05 * r, r * (1.04 if k % 2 else 0.97))
        found = seeded(frame_of(picture(ball, noise=noise, noise_seed=k)), near).circle
        errors.append((found.x_px - true.x_px, found.y_px - true.y_px, found.r_px - true.r_px))
    return np.array(errors)


def edges_of(frame, ball, off=(0.6, -0.4), **how):
    """Edge points from an outline a little off the truth."""
    circle = truth(ball)
    xyz = np.array(ball.xyz)
    start = outline_px(xyz, RADIUS_M, CAMERA) + off
    return find_edges(frame, start, circle.r_px, 2.5, STILL, None, EdgeConfig(**how))


# -- the compiled loop and its reference -----------------------------------------------------------


def both(frame: Frame, ball, blur, coarse, limits=None, config=None, thinned=True, shading=None):
    """What the compiled loop finds half a pixel off the truth, and what the reference does, on the rays of both; how
    many rays only one of them has."""
    config, circle = config or EdgeConfig(), truth(ball)
    outline = outline_px(np.array(ball.xyz), RADIUS_M, CAMERA, config.rays) + np.array([0.5, -0.3])
    reach = 0.2 * circle.r_px + 1 if coarse else max(1.5, 0.05 * circle.r_px)
    where = (frame, outline, circle.r_px, reach, np.array(blur, float), limits, config, coarse)
    learnt = {} if shading is None else {"shading": shading}
    ours, other = find_edges(*where, **learnt), reference.find_edges(*where, thinned=thinned, **learnt)
    assert ours is not None
    assert other is not None
    assert ours.rays == other.rays
    _, mine, its = np.intersect1d(ours.ray, other.ray, return_indices=True)
    assert len(mine) > 12
    alone = len(ours.ray) + len(other.ray) - 2 * len(mine)
    return (ours, mine), (other, its), alone


def assert_equal(found):
    """Offsets within 0.01 px and 4 % of their deviation, that within 3 % and 0.2 of its inverse: levels of light are
    looked up in a table of 2,049, where single and double precision may fall on either side of a step. One ray may be
    just good enough for one of the two, and two may be so faint that such a step moves them, or have two shifts that
    fit equally well: either may be the one that the parabola is laid about.
    """
    (ours, mine), (other, its), alone = found
    off = np.abs(ours.offset_px[mine] - other.offset_px[its])
    same = off < 0.01
    assert np.sum(~same) <= 2
    assert off.max() < 0.15
    mine, its = mine[same], its[same]
    assert (off[same] / ours.sd_px[mine]).max() < 0.04
    np.testing.assert_allclose(ours.points_px[mine], other.points_px[its], atol=0.01)
    np.testing.assert_allclose(1 / ours.sd_px[mine], 1 / other.sd_px[its], rtol=0.03, atol=0.2)
    assert alone <= 1
    assert ours.explained == pytest.approx(other.explained, abs=3e-4 if alone == 0 else 5e-3)


@pytest.mark.parametrize("coarse", [False, True])
@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize("r", [6, 8, 12, 20, 30, 45, 70, 100])
def test_the_compiled_edges_equal_the_reference(r, frame_of, coarse):
    """Small ones to ones that fill the picture; still, swept along and across; near enough flat and on texture."""
    for k, blur in enumerate([(0, 0), (6, 3), (0, -14), (-0.3, 0.2)]):
        if np.hypot(*blur) < 3 * r:
            ball = ball_at(157.3, 119.1, r, rgb=COLOURS[k % 3])
            frame = frame_of(picture(ball, noise_seed=r, backdrop=k))
            assert_equal(both(frame, ball, blur, coarse))


@pytest.mark.parametrize(
    "config",
    [
        EdgeConfig(shading=False),
        EdgeConfig(chroma=False),
        EdgeConfig(rays=31, blur_sigma_px=1.3, chroma_sigma_px=0.8),
        EdgeConfig(noise=0.03, balance=0.1, least_contrast=9),
    ],
    ids=["flat", "brightness", "soft", "noisy"],
)
@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
def test_the_compiled_edges_equal_the_reference_with_other_settings(config, frame_of):
    for r in (9, 24):
        ball = ball_at(157.3, 119.1, r, rgb=GREEN)
        assert_equal(both(frame_of(picture(ball, noise_seed=r)), ball, (3, -2), False, config=config))


@pytest.mark.parametrize(("x", "y"), [(3.2, 117.7), (318.0, 121.4), (160.2, 4.9), (158.8, 236.3), (2.9, 3.8)])
@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
def test_the_compiled_edges_equal_the_reference_at_the_pictures_border(x, y, frame_of):
    ball = ball_at(x, y, 34)
    assert_equal(both(frame_of(picture(ball)), ball, (0, 0), False))


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
def test_the_compiled_edges_equal_the_reference_where_colours_are_asked_for(frame_of):
    ball = ball_at(157.3, 119.1, 18)
    frame = frame_of(two_coloured(ball, ORANGE, BLUE))
    found = both(frame, ball, (0, 0), False, limits=colours_of(ball))
    assert_equal(found)
    assert len(found[0][1]) < 32


def test_fewer_places_deep_in_the_marker_move_no_edge_by_a_quarter_of_its_deviation():
    """A large marker's rays are not sampled every half pixel all the way in (docs/method.md); a still one's edges
    then move by less than 0.02 px."""
    for r in (20, 30, 45, 70, 100):
        for k, rgb in enumerate(COLOURS):
            ball = ball_at(157.3, 119.1, r, rgb=rgb)
            frame = bgr_frame(picture(ball, noise_seed=r, backdrop=k))
            for coarse in (False, True):
                (ours, mine), (other, its), alone = both(frame, ball, (0, 0), coarse, thinned=False)
                off = np.abs(ours.offset_px[mine] - other.offset_px[its])
                assert np.sort(off)[-2] < 0.02
                assert np.sort(off / ours.sd_px[mine])[-2] < 0.25
                assert alone == 0


# -- through a seed --------------------------------------------------------------------------------


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize("r", [8, 12, 20, 30])
def test_the_centre_of_a_shaded_sphere_is_found_to_a_tenth_of_a_pixel(r, frame_of):
    errors = outline_errors(r, frame_of)
    assert np.median(np.hypot(errors[:, 0], errors[:, 1])) < 0.1
    assert np.abs(errors[:, :2].mean(axis=0)).max() < 0.1


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize("r", [8, 12, 20, 30])
def test_the_radius_is_biased_by_less_than_a_tenth_of_a_pixel(r, frame_of):
    assert abs(outline_errors(r, frame_of)[:, 2].mean()) < 0.1


@pytest.mark.parametrize(("r", "worst"), [(8, 0.05), (20, 0.03)])
def test_a_blurred_circle_is_not_drawn_in_by_its_curvature(r, worst):
    """Blur of sigma moves a circle's edge inwards by sigma^2 / 2r; flat and free of noise."""
    errors = []
    for k, rgb in enumerate(COLOURS):
        ball = ball_at(150.3 + 5.2 * k, 120.4, r, rgb=rgb)
        true = truth(ball)
        found = seeded(yuv_frame(picture(ball, noise=0, shading=0)), true).circle
        errors.append(found.r_px - true.r_px)
    assert abs(np.mean(errors)) < worst


@pytest.mark.parametrize(("dx", "dy"), [(7, 0), (0, -9), (-23, 14)])
def test_shifting_the_picture_by_whole_pixels_shifts_every_edge_point_by_just_that(dx, dy):
    ball = ball_at(160.3, 119.8, 15)
    still, moved = bgr_frame(picture(ball, noise=0)), bgr_frame(picture(ball, noise=0, shift=(dx, dy)))
    circle = truth(ball)
    outline = outline_px(np.array(ball.xyz), RADIUS_M, CAMERA) + np.array([0.5, 0.3])
    config, move = EdgeConfig(), np.array([dx, dy])
    a = find_edges(still, outline, circle.r_px, 2.0, STILL, None, config)
    b = find_edges(moved, outline + move, circle.r_px, 2.0, STILL, None, config)
    np.testing.assert_allclose(b.points_px, a.points_px + move, atol=1e-6)
    np.testing.assert_allclose(b.sd_px, a.sd_px, atol=1e-9)
    np.testing.assert_array_equal(b.ray, a.ray)


def test_what_lies_further_out_than_the_rays_does_not_move_the_edges():
    ball = ball_at(160.3, 119.8, 15)
    image, circle = picture(ball, noise=0), truth(ball)
    elsewhere = np.random.default_rng(0).integers(0, 256, image.shape).astype(np.uint8)
    rows, columns = np.indices(image.shape[:2])
    near = np.hypot(columns - circle.x_px, rows - circle.y_px) < circle.r_px + 2.0 + 5.0
    outline = outline_px(np.array(ball.xyz), RADIUS_M, CAMERA)
    a, b = (
        find_edges(bgr_frame(seen), outline, circle.r_px, 2.0, STILL, None, EdgeConfig())
        for seen in (image, np.where(near[..., None], image, elsewhere))
    )
    np.testing.assert_array_equal(a.points_px, b.points_px)
    np.testing.assert_array_equal(a.sd_px, b.sd_px)


@pytest.mark.parametrize("rgb", COLOURS)
def test_edge_points_lie_on_the_outline_and_their_deviations_are_honest(rgb):
    residuals = []
    for seed in range(6):
        ball = ball_at(160.3 + seed * 0.37, 119.8, 20, rgb=rgb)
        edges = edges_of(bgr_frame(picture(ball, noise_seed=seed, backdrop=seed)), ball)
        centre = truth(ball)
        away = np.hypot(*(edges.points_px - (centre.x_px, centre.y_px)).T) - centre.r_px
        residuals.append(away / edges.sd_px)
        assert np.abs(away).max() < 1.5
        assert len(edges.points_px) == len(edges.sd_px) == len(edges.ray) == len(edges.offset_px)
        assert edges.rays == 72
    spread = np.median(np.abs(np.concatenate(residuals))) * 1.48
    assert 0.3 < spread < 4


def hidden_from(side, share, circle):
    """A cover over this share of the circle's width."""
    d = (1 - 2 * share) * circle.r_px
    return {
        "left": Cover(0, 0, round(circle.x_px - d), 240),
        "right": Cover(round(circle.x_px + d), 0, 320, 240),
        "top": Cover(0, 0, 320, round(circle.y_px - d)),
        "bottom": Cover(0, round(circle.y_px + d), 320, 240),
    }[side]


SIDES = ("left", "right", "top", "bottom")


@pytest.mark.parametrize("r", [12, 20])
@pytest.mark.parametrize("share", [0.2, 0.5])
def test_the_edges_of_a_part_hidden_sphere_still_give_its_full_circle(r, share):
    errors = []
    for seed, side in enumerate(SIDES):
        ball = ball_at(158.3, 121.6, r)
        true = truth(ball)
        frame = bgr_frame(picture(ball, covers=(hidden_from(side, share, true),), noise_seed=seed))
        outline = outline_px(np.array(ball.xyz), RADIUS_M, CAMERA) + np.array([0.3, -0.15])
        edges = find_edges(frame, outline, r, 1.5, STILL, None, EdgeConfig())
        sd_rad = edges.sd_px / CAMERA.fx_px
        fit = fit_sphere(CAMERA.rays(edges.points_px), sd_rad, RADIUS_M, np.array(ball.xyz) * 1.01, loose=15)
        found = circle_of_sphere(fit.xyz_cam_m, RADIUS_M, CAMERA)
        errors.append((found.distance(true), abs(found.r_px - true.r_px)))
    assert np.mean(errors, axis=0).max() < 0.5
    assert np.max(errors) < 0.8


def part_hidden_step(r, share, side):
    """The chain's estimate on the first frame on which a share of the marker is hidden, and the truth."""
    ball = ball_at(158.3, 121.6, r)
    true = truth(ball)
    chain = MarkerChain(SPEC, CAMERA, ChainConfig())
    chain.seed(bgr_frame(picture(ball, noise_seed=5)), true)
    return chain.step(bgr_frame(picture(ball, covers=(hidden_from(side, share, true),)), 1)), true


@pytest.mark.parametrize("r", [12, 20])
@pytest.mark.parametrize("share", [0.2, 0.35, 0.5])
def test_a_part_hidden_sphere_is_verified_only_with_its_full_circle(r, share):
    for side in SIDES:
        estimate, true = part_hidden_step(r, share, side)
        assert estimate.circle.distance(true) < 0.8
        assert abs(estimate.circle.r_px - true.r_px) < 0.8


def test_a_part_hidden_sphere_is_claimed_with_its_full_circle():
    for r in (12, 20):
        for share, side in ((0.2, "top"), (0.2, "left"), (0.35, "right"), (0.5, "bottom")):
            estimate, true = part_hidden_step(r, share, side)
            assert estimate.claim.distance(true) < 0.8, (r, share, side)


def test_visible_is_the_share_of_the_outline_with_an_edge():
    ball = ball_at(160, 120, 20)
    assert seeded(bgr_frame(picture(ball)), truth(ball)).visible > 0.85


def test_a_sphere_across_the_pictures_border_keeps_its_true_circle():
    ball = ball_at(6.0, 118.4, 18)
    true = truth(ball)
    found = seeded(bgr_frame(picture(ball)), Circle(true.x_px + 0.8, true.y_px - 0.6, true.r_px * 1.03))
    assert found.circle.distance(true) < 0.5
    assert abs(found.circle.r_px - true.r_px) < 0.5


def test_where_there_is_no_contrast_there_are_no_edges():
    ball = ball_at(160, 120, 15)
    flat = bgr_frame(np.full((240, 320, 3), 110, np.uint8))
    found = edges_of(flat, ball)
    assert found is None or len(found.points_px) < 10


def test_an_edge_out_of_reach_is_not_taken_for_one_within():
    ball = ball_at(160.3, 119.8, 20)
    circle = truth(ball)
    edges = edges_of(bgr_frame(picture(ball)), ball, off=(0, 0))
    assert np.abs(edges.offset_px).max() <= 2.5 + 0.5
    small = outline_px(np.array(ball.xyz) * 1.6, RADIUS_M, CAMERA)  # a circle 60 % further in
    inner = find_edges(bgr_frame(picture(ball)), small, circle.r_px / 1.6, 1.5, STILL, None, EdgeConfig())
    if inner is not None:
        fit = fit_sphere(CAMERA.rays(inner.points_px), inner.sd_px / CAMERA.fx_px, RADIUS_M, np.array(ball.xyz) * 1.6)
        found = None if fit is None else circle_of_sphere(fit.xyz_cam_m, RADIUS_M, CAMERA)
        assert found is None or found.r_px < 0.8 * circle.r_px
        assert len(inner.points_px) < 72


def two_coloured(ball, left, right):
    """The picture of a ball that has another colour to the right of its centre."""
    halves = [picture(ball_at(*truth(ball), rgb=rgb), noise_seed=3) for rgb in (left, right)]
    return np.where(np.arange(halves[0].shape[1])[None, :, None] < truth(ball).x_px, *halves)


def colours_of(ball):
    """The limits of an orange marker's colours."""
    circle = truth(ball)
    patch = Patch(bgr_frame(picture(ball_at(*circle))), Window.around(circle, 2 * circle.r_px))
    config = ColourConfig()
    return learn_box(disc_pixels(patch, circle, config.sample), config).limits()


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
def test_edges_of_another_colour_than_the_markers_are_left_out(frame_of):
    ball = ball_at(160.3, 119.8, 15)
    frame, circle = frame_of(two_coloured(ball, ORANGE, BLUE)), truth(ball)
    outline = outline_px(np.array(ball.xyz), RADIUS_M, CAMERA)
    free = find_edges(frame, outline, circle.r_px, 2.0, STILL, None, EdgeConfig())
    edges = find_edges(frame, outline, circle.r_px, 2.0, STILL, colours_of(ball), EdgeConfig())
    assert (free.points_px[:, 0] > circle.x_px + 2).sum() > 15
    assert (edges.points_px[:, 0] < circle.x_px + 2).all()
    assert len(edges.points_px) > 20


def test_the_light_is_mixed_in_linear_intensities():
    """A bright marker on dark and a dark one on bright err alike (edges in coded values would not)."""
    errors = []
    for rgb, gain in (((250, 250, 90), 0.25), ((40, 20, 60), 1.6)):
        found = []
        for k in range(4):
            ball = ball_at(150.3 + 3.3 * k, 119.8, 18, rgb=rgb)
            true = truth(ball)
            image = picture(ball, noise_seed=k, shading=0.0, gain=gain if rgb[0] < 100 else 1.0)
            found.append(seeded(bgr_frame(image), true).circle.r_px - true.r_px)
        errors.append(np.mean(found))
    assert abs(errors[0] - errors[1]) < 0.12


# -- brightness and chroma each by themselves ------------------------------------------------------


def plain(circle, inside, outside, noise=1.0, seed=0, way=(0.0, 0.0)):
    """An evenly coloured disc before an even background, sRGB (red, green, blue), mixed in light and blurred; it goes
    that `way` (2,) while exposed."""
    fine = (np.arange(6) + 0.5) / 6 - 0.5
    x = (np.arange(320)[:, None] + fine).ravel() - circle.x_px
    y = (np.arange(240)[:, None] + fine).ravel() - circle.y_px
    times = 1 + int(3 * np.hypot(*way))
    cover = np.zeros((240, 320, 1))
    for t in (np.arange(times) + 0.5) / times - 0.5:
        disc = np.hypot(x[None, :] - t * way[0], y[:, None] - t * way[1]) < circle.r_px
        cover += disc.reshape(240, 6, 320, 6).mean(axis=(1, 3))[..., None] / times
    light = cover * to_linear(np.array(inside[::-1])) + (1 - cover) * to_linear(np.array(outside[::-1]))
    coded = to_code(cv2.GaussianBlur(light, (0, 0), LENS_SIGMA_PX))
    coded += np.random.default_rng(seed).normal(0, noise, coded.shape)
    return np.clip(np.rint(coded), 0, 255).astype(np.uint8)


AS_BRIGHT = ((200, 100, 60), (125, 125, 125))  # 0.299 r + 0.587 g + 0.114 b is 125 for both
AS_COLOURED = ((190, 150, 110), (130, 90, 50))  # every channel differs by 60


def offs_of_plain(colours, frame_of, r, **config):
    """How far outside the true circle (N,) the edge points lie that are found from half a pixel off it."""
    circle = Circle(160.3, 119.8, r)
    outline = circle.r_px * np.stack([f(np.arange(72) * np.pi / 36) for f in (np.cos, np.sin)], axis=1)
    outline += (circle.x_px + 0.5, circle.y_px - 0.4)
    found = find_edges(frame_of(plain(circle, *colours)), outline, r, 2.5, STILL, None, EdgeConfig(**config))
    return np.zeros(0) if found is None else np.hypot(*(found.points_px - (circle.x_px, circle.y_px)).T) - r


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize("r", [12, 30])
@pytest.mark.parametrize("colours", [AS_BRIGHT, AS_COLOURED], ids=["by chroma", "by brightness"])
def test_a_marker_is_found_by_chroma_alone_or_by_brightness_alone(colours, r, frame_of):
    off = offs_of_plain(colours, frame_of, r)
    assert len(off) > 64
    assert abs(off.mean()) < 0.1
    assert np.sqrt((off**2).mean()) < 0.15


@pytest.mark.parametrize("radii", [0.5, 1, 1.5, 2, 2.5, 3])
@pytest.mark.parametrize("r", [12, 24])
def test_a_streak_shows_the_marker_where_it_was_in_the_middle_of_the_exposure(r, radii):
    """Also one longer than the marker's diameter, which covers no place all the time. Along the way its ends are long
    ramps, each of a level of its own: from half a pixel off it comes half as close in one go."""
    circle, way = Circle(160.3, 119.8, r), radii * r * np.array([0.8, -0.6])
    frame = bgr_frame(plain(circle, *AS_COLOURED, way=way))
    outline = Outline(RADIUS_M, CAMERA, EdgeConfig(), PositionConfig())
    for (x, y), within in (((0.3, 0.4), 0.1), ((0.4, -0.3), 0.36)):
        start = Circle(circle.x_px + x, circle.y_px + y, 1.02 * r)
        found = outline.sharpened(frame, start, "prediction", close_px(circle), replace(AT_REST, blur_px=way), None)
        assert found.visible > 0.95
        assert found.circle.distance(circle) < within
        assert abs(found.circle.r_px - r) < 0.2


def test_without_chroma_a_marker_as_bright_as_what_is_behind_it_has_no_edges():
    assert len(offs_of_plain(AS_BRIGHT, bgr_frame, 20, chroma=False)) < 12
    assert len(offs_of_plain(AS_COLOURED, bgr_frame, 20, chroma=False)) > 64


def test_a_background_as_bright_on_one_side_and_as_coloured_on_the_other_costs_no_edges():
    """Each ray weighs brightness and chroma by its own evidence."""
    circle = Circle(160.3, 119.8, 20)
    marker, halves = (200, 100, 60), ((125, 125, 125), (150, 50, 10))
    left, right = (plain(circle, marker, outside) for outside in halves)
    image = np.where(np.arange(320)[None, :, None] < circle.x_px, left, right)
    outline = circle.r_px * np.stack([f(np.arange(72) * np.pi / 36) for f in (np.cos, np.sin)], axis=1)
    outline += (circle.x_px + 0.3, circle.y_px - 0.4)
    found = find_edges(yuv_frame(image), outline, 20, 2.5, STILL, None, EdgeConfig())
    off = np.hypot(*(found.points_px - (circle.x_px, circle.y_px)).T) - 20
    assert len(off) > 62
    assert np.median(np.abs(off)) < 0.15


# -- shading of earlier frames, softness and exposure ------------------------------------------------


@pytest.mark.parametrize(("r", "blur"), [(20.0, (0.0, 0.0)), (12.0, (3.0, 1.0))])
def test_learnt_shading_is_taken_in_as_its_form_in_numpy_does(r, blur):
    rings, turn = np.linspace(0, 1, 25)[:, None], 2 * np.pi * np.arange(EdgeConfig().rays)[None] / EdgeConfig().rays
    shading = (1 + 0.6 * rings * np.cos(turn) - 0.2 * rings**2).astype(np.float32)
    ball = ball_at(150.0, 118.0, r)
    frame = yuv_frame(picture(ball, noise=1.0))
    with_it = both(frame, ball, blur, False, shading=shading)
    assert_equal(with_it)
    without = both(frame, ball, blur, False)
    assert np.abs(with_it[0][0].offset_px.mean() - without[0][0].offset_px.mean()) > 1e-3


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize("share_of_light", [0.0, 0.6])
def test_misfits_are_their_form_in_numpy(frame_of, share_of_light):
    ball, way = ball_at(150.0, 118.0, 18.0), np.array([5.0, 4.0])
    circle, config, frame = truth(ball), EdgeConfig(), frame_of(picture(ball, noise=1.0))
    outline = Outline(RADIUS_M, CAMERA, config, PositionConfig())
    claim = replace(outline.first_look(frame, circle), motion=replace(AT_REST, blur_px=share_of_light * way))
    softnesses, exposures = (1.0, 1.6, 2.4), (0.0, 0.5, 1.0)
    found = outline.misfits(frame, claim, np.empty((0, 0), np.float32), way, softnesses, exposures)
    shown = np.zeros(config.rays, bool)
    shown[claim.edges.ray[claim.edge_weights > 0.3]] = True
    around = outline_px(claim.xyz_cam_m, RADIUS_M, CAMERA, config.rays)
    for i, softness in enumerate(softnesses):
        for j, share in enumerate(exposures):
            squares: list = []
            reference.find_edges(
                frame, around, claim.circle.r_px, close_px(claim.circle), share * way, None, config, way_px=way,
                believed_px=share_of_light * way, squares=squares, sigma_px=softness * config.blur_sigma_px,
            )  # fmt: skip
            expected = np.log(squares[0] + squares[1] + 1e-7)[shown].mean()
            assert found[i, j] == pytest.approx(expected, abs=0.03)


def test_misfits_are_not_asked_where_hardly_any_outline_is_seen():
    ball = ball_at(150.0, 118.0, 18.0)
    frame = bgr_frame(picture(ball))
    outline = Outline(RADIUS_M, CAMERA, EdgeConfig(), PositionConfig())
    claim = outline.clicked(truth(ball))  # it has no edges
    assert outline.misfits(frame, claim, np.empty((0, 0), np.float32), np.array([9.0, 0.0]), (1.0,), (0.0,)) is None
