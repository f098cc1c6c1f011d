"""A marker's shading as it is learnt from verified frames, and what the edges make of it."""

from dataclasses import replace

import numpy as np
import pytest

from reference.shading import Shading as Reference
from scenes import CAMERA, RADIUS_M, ball_at, bgr_frame, picture, truth, yuv_frame
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.optics import AT_REST
from spheremcap.detection.edge import EdgeConfig, find_edges
from spheremcap.detection.outline import Outline, close_px
from spheremcap.detection.shading import _MEMORY, RINGS, Shading
from spheremcap.positioning.sphere import PositionConfig, outline_px

RAYS = 48
PLACE = np.linspace(0, 1, RINGS)[:, None]
TURN = 2 * np.pi * np.arange(RAYS)[None] / RAYS
ALL = np.ones(RAYS, bool)


def lit(side=0.5, level=0.3):
    """A ball brighter on one side, linear light (RINGS, RAYS)."""
    return (level * (1 + side * PLACE * np.cos(TURN))).astype(np.float32)


@pytest.mark.parametrize("clear", [0.95, 0.8, 0.61, 0.3, -0.5])
def test_it_is_its_form_in_numpy(clear):
    rng = np.random.default_rng(int(100 * abs(clear)))
    ours, other = Shading(RAYS), Reference(RAYS, RINGS)
    for frame in range(80):
        light = (lit() * rng.uniform(0.5, 1.5, (RINGS, RAYS))).astype(np.float32)
        shown = rng.random(RAYS) < (0.1 if frame < 4 else 0.7)
        ours.follow(light, shown, clear)
        other.follow(light.astype(np.float64), shown, clear)
        if other.profile is not None:
            np.testing.assert_allclose(ours.profile, other.profile, rtol=2e-5, atol=2e-6)


def test_there_is_nothing_to_tell_before_a_frame_was_seen_nor_of_a_black_one():
    shading = Shading(RAYS)
    assert shading.profile.shape == (0, 0)
    shading.follow(np.zeros((RINGS, RAYS), np.float32), ALL, 0.9)
    shading.follow(lit(), ~ALL, 0.9)
    assert shading.profile.shape == (0, 0)


def test_it_is_over_the_markers_own_level_whatever_the_light():
    dim, bright = Shading(RAYS), Shading(RAYS)
    dim.follow(lit(level=0.1), ALL, 0.9)
    bright.follow(lit(level=0.8), ALL, 0.9)
    np.testing.assert_allclose(dim.profile, bright.profile, rtol=1e-5)
    assert dim.profile[0].mean() == pytest.approx(1.0, abs=0.05)


def test_what_the_background_mixes_into_is_carried_on_and_not_taken():
    """The rings beyond what is clear are of another colour; the profile goes on as the marker's light does."""
    light = lit()
    spoilt = light.copy()
    spoilt[PLACE[:, 0] > 0.8] = 5.0
    shading = Shading(RAYS)
    shading.follow(spoilt, ALL, 0.8)
    np.testing.assert_allclose(shading.profile[-1], light[-1] / 0.3, atol=0.08)


def test_a_side_that_is_hidden_keeps_what_it_had():
    shading = Shading(RAYS)
    for _ in range(10):
        shading.follow(lit(), ALL, 0.9)
    before = shading.profile.copy()
    covered = lit()
    covered[:, :20] = 0.02
    shading.follow(covered, np.arange(RAYS) >= 20, 0.9)
    np.testing.assert_allclose(shading.profile, before, atol=0.02)


def test_new_light_is_learnt_within_its_memory():
    shading = Shading(RAYS)
    for _ in range(3 * _MEMORY):
        shading.follow(lit(0.5), ALL, 0.9)
    for _ in range(3 * _MEMORY):
        shading.follow(lit(-0.5), ALL, 0.9)
    now = Shading(RAYS)
    now.follow(lit(-0.5), ALL, 0.9)
    np.testing.assert_allclose(shading.profile, now.profile, atol=0.06)


@pytest.mark.parametrize(("interval_ns", "looks"), [(4_166_667, 15 + 12), (-4_166_667, 15 + 12), (33_333_333, 40)])
def test_frames_close_together_are_looked_at_one_by_one_only_at_first(interval_ns, looks):
    taken = []

    def light():
        taken.append(1)
        return lit(), ALL, 0.9

    shading = Shading(RAYS)
    for frame in range(40):
        shading.learn(frame * interval_ns, light)
    assert len(taken) == looks
    assert shading.profile.shape == (RINGS, RAYS)


def test_a_shadow_on_the_marker_does_not_move_its_edges():
    """The side in shade is nearly as dark as what is behind it, and its border is an edge of its own."""
    ball = ball_at(160, 120, 20)
    circle = truth(ball)
    x, y = np.meshgrid(np.arange(CAMERA.width_px) - circle.x_px, np.arange(CAMERA.height_px) - circle.y_px)
    image = picture(ball, noise=0).astype(np.float64)
    shade = 1 / (1 + np.exp((x + y - 14) / 1.5)) * 0.6 + 0.4  # on the lower right, over a pixel or two
    image = np.clip(np.rint(image * shade[..., None]), 0, 255).astype(np.uint8)
    frame = yuv_frame(image)
    config = EdgeConfig()
    outline = Outline(RADIUS_M, CAMERA, config, PositionConfig())
    around = outline_px(np.asarray(ball.xyz), RADIUS_M, CAMERA, config.rays)
    claim = outline.clicked(circle)
    shading = Shading(config.rays)
    shading.follow(*outline.light(frame, replace(claim, motion=AT_REST)))

    def off(**how):
        edges = find_edges(frame, around, circle.r_px, close_px(circle), np.zeros(2), None, config, **how)
        return np.abs(edges.offset_px).mean(), len(edges.ray)

    plain, learnt = off(), off(shading=shading.profile)
    assert learnt[0] < plain[0]
    assert learnt[1] >= plain[1]


def test_the_light_of_a_claim_is_read_where_its_marker_is():
    ball = ball_at(160, 120, 20)
    outline = Outline(RADIUS_M, CAMERA, EdgeConfig(), PositionConfig())
    circle = truth(ball)
    claim = outline.first_look(bgr_frame(picture(ball, noise=0)), circle)
    light, shown, clear = outline.light(bgr_frame(picture(ball, noise=0)), claim)
    assert light.shape == (RINGS, RAYS)
    assert shown.sum() == (claim.edge_weights > 0.3).sum()
    assert clear == pytest.approx(1 - (0.5 * claim.motion.softness + 0.775) / claim.circle.r_px, abs=1e-6)
    blurred = replace(claim, motion=replace(claim.motion, blur_px=np.array([6.0, 8.0])))
    assert outline.light(bgr_frame(picture(ball, noise=0)), blurred)[2] == pytest.approx(
        clear - 5 / circle.r_px, abs=0.01
    )
    inside, outside = light[: int(0.8 * RINGS)].mean(), picture(ball, noise=0)[5, 5]
    assert inside > 0.05
    assert len(outside) == 3


def test_a_chain_begins_anew_with_every_seed():
    ball = ball_at(160, 120, 20)
    chain = MarkerChain(MarkerSpec("m", 2 * RADIUS_M), CAMERA, ChainConfig())
    chain.seed(bgr_frame(picture(ball), 0), truth(ball))
    first = chain._stages.shading
    chain.step(bgr_frame(picture(ball, noise_seed=1), 1))
    assert first._looks.max() == 2
    chain.seed(bgr_frame(picture(ball), 2), truth(ball))
    assert chain._stages.shading is not first
