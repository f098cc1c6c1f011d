"""ColorSmartBoundary: the box, the mask, the blob (thesis sections 2.4.2 and 2.4.3)."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference import colour as reference
from scenes import BLUE, GREEN, ORANGE, ball_at, bgr_frame, picture, truth
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.core.sampling import cut_bgr
from spheremcap.detection.colour import (
    ColourBox,
    ColourConfig,
    blobs,
    box_mask,
    colour_circle,
    disc_mask,
    disc_pixels,
    learn_box,
    less_sure_of_hue,
    loosened,
)

FREE = {"least_hue": 0, "least_saturation": 0, "least_value": 0}
THESIS = ColourBox(144.5, 30.5, (17, 82), (69, 223))  # what section 2.4.3 keeps of the golden figure's ranges
BOXES = st.builds(
    ColourBox,
    st.floats(0, 179.9),
    st.floats(0, 100),
    st.tuples(st.floats(0, 127), st.floats(128, 255)),
    st.tuples(st.floats(0, 127), st.floats(128, 255)),
)


def cloud(seed=0, outliers=0.06, hue=100.0, size=4000):
    """HSV pixels like figure 2.9's: most in a blob, a few red ones far off in hue."""
    rng = np.random.default_rng(seed)
    body = rng.normal((hue, 50, 146), (11, 11, 30), (size, 3))
    stray = rng.normal((hue + 60, 25, 90), (6, 6, 20), (int(size * outliers), 3))
    out = np.concatenate([body, stray])
    out[:, 0] %= 180
    return np.rint(np.clip(out, 0, (179, 255, 255))).astype(np.uint8)


def inside(box, pixels):
    return box.mask(pixels[None]).ravel() == 255


def golden_figure(size=20000):
    """Pixels that range over H 0-178, S 11-82, V 44-223, 93 % of them evenly within S 17-82, V 69-223 and a hue so
    narrow that with the strays, all outside H 114-175, the deviations are as 30.5 : 32.5 : 77."""
    rng = np.random.default_rng(11)
    body, strays = int(0.93 * size), int(0.07 * size)
    off = rng.choice((-1, 1), strays) * rng.uniform(31.5, 60, strays)
    narrow = np.sqrt(3 * (30.5**2 / 3 - 0.07 * (off**2).mean()) / 0.93)
    hue = 144.5 + np.concatenate([rng.uniform(-narrow, narrow, body), off])
    rest = rng.uniform((17, 69), (82, 223), (size, 2))
    pixels = np.rint(np.column_stack([hue % 180, rest]))
    pixels[pixels[:, 0] >= 179, 0] = 178
    pixels[-2:] = (0, 11, 44), (178, 11, 44)
    return pixels.astype(np.uint8)


def test_the_golden_figures_ranges_shrink_to_what_holds_ninety_three_per_cent():
    pixels = golden_figure()
    assert pixels.min(axis=0).tolist() == [0, 11, 44]
    assert pixels.max(axis=0).tolist() == [178, 82, 223]
    box = learn_box(pixels, ColourConfig(coverage=0.93, **FREE))
    assert box.hue_mean - box.hue_half == pytest.approx(114, abs=1.5)
    assert box.hue_mean + box.hue_half == pytest.approx(175, abs=1.5)
    assert box.saturation == pytest.approx((17, 82), abs=1.5)
    assert box.value == pytest.approx((69, 223), abs=1.5)
    assert box.volume / (178 * (82 - 11) * (223 - 44)) == pytest.approx(0.270, abs=0.02)


def test_the_golden_figures_ranges_are_what_their_box_lets_through():
    hsv = np.array([[114, 50, 100], [175, 50, 100], [113, 50, 100], [176, 50, 100]], np.uint8)
    assert inside(THESIS, hsv).tolist() == [True, True, False, False]
    hsv = np.array(
        [[144, 17, 69], [144, 82, 223], [144, 16, 100], [144, 83, 100], [144, 50, 68], [144, 50, 224]],
        np.uint8,
    )
    assert inside(THESIS, hsv).tolist() == [True, True, False, False, False, False]


def test_keeping_ninety_three_per_cent_shrinks_the_box():
    """The figure's story: a few stray pixels blow up the ranges; 93 % need a fraction of the volume."""
    pixels = cloud()
    box = learn_box(pixels, ColourConfig(grey_saturation=0, **FREE))
    low, high = pixels.min(axis=0).astype(float), pixels.max(axis=0).astype(float)
    full = np.prod(high - low)
    assert box.volume / full < 0.4
    # the stray red pixels are out, the body is in
    stray = np.abs((pixels[:, 0].astype(float) - 100 + 90) % 180 - 90) > 45
    assert inside(box, pixels)[stray].mean() < 0.1
    assert inside(box, pixels)[~stray].mean() > 0.9


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.6, 0.9), st.integers(50, 500))
def test_coverage_is_the_share_of_pixels_inside_and_the_box_no_larger(seed, coverage, size):
    pixels = cloud(seed, size=size)
    box = learn_box(pixels, ColourConfig(coverage=coverage, grey_saturation=0, **FREE))
    # The mask rounds hue outwards to whole steps, so it may hold a little more.
    assert inside(box, pixels).mean() >= coverage - 1e-9
    smaller = ColourBox(
        box.hue_mean,
        0.9 * box.hue_half - 1,
        tuple(np.interp((0.1, 0.9), (0, 1), box.saturation)),
        tuple(np.interp((0.1, 0.9), (0, 1), box.value)),
    )
    assert inside(smaller, pixels).mean() < max(coverage, 0.93)


def test_half_widths_are_in_the_ratio_of_the_deviations():
    rng = np.random.default_rng(1)
    pixels = np.rint(rng.normal((90, 128, 128), (4, 16, 8), (5000, 3))).clip(0, 255).astype(np.uint8)
    box = learn_box(pixels, ColourConfig(**FREE))
    halves = (box.hue_half, np.ptp(box.saturation) / 2, np.ptp(box.value) / 2)
    assert halves[1] / halves[0] == pytest.approx(4, rel=0.05)
    assert halves[2] / halves[0] == pytest.approx(2, rel=0.05)


def test_growing_stops_where_volume_grows_faster_than_the_share_of_points():
    """Eq 2.26: the box of a dense core with a thin halo ends near the core."""
    rng = np.random.default_rng(2)
    core = rng.uniform(-10, 10, (3000, 3))
    halo = rng.uniform(-60, 60, (150, 3))
    pixels = np.rint(np.concatenate([core, halo]) + np.array([90, 120, 120])).astype(np.uint8)
    box = learn_box(pixels, ColourConfig(stop="gain", **FREE))
    everything = learn_box(pixels, ColourConfig(coverage=1.0, **FREE))
    assert box.hue_half == pytest.approx(10, abs=3)
    assert box.volume < 0.02 * everything.volume
    assert inside(box, pixels).mean() > 0.85


def test_the_growing_boxs_volume_counts_in_three_dimensions():
    """Points whose share grows as the root of the box's size: d(size^3) overtakes it at (1/6)^0.4 = 0.49."""
    rng = np.random.default_rng(7)
    shell = rng.uniform(-1, 1, (30000, 3))
    shell /= np.abs(shell).max(axis=1, keepdims=True)
    pixels = np.rint(shell * rng.uniform(0, 1, (30000, 1)) ** 2 * 85 + np.array([90, 128, 128]))
    pixels[:, 0] = 90 + (pixels[:, 0] - 90) * 0.8  # the hue circle is smaller
    box = learn_box(np.rint(pixels).astype(np.uint8), ColourConfig(stop="gain", **FREE))
    assert np.ptp(box.value) / 170 == pytest.approx(0.49, abs=0.1)


def test_evenly_spread_points_leave_the_rule_no_reason_to_stop_early():
    rng = np.random.default_rng(3)
    pixels = rng.integers((60, 80, 80), (121, 161, 161), (20000, 3)).astype(np.uint8)
    box = learn_box(pixels, ColourConfig(stop="gain", **FREE))
    assert inside(box, pixels).mean() >= 0.5


@pytest.mark.parametrize("hue", [90, 45, 0, 3, 176, 179])
def test_hue_is_an_angle(hue):
    """The same cloud turned to any hue gives the same box turned; red does not fall apart at 0."""
    pixels, middle = cloud(hue=hue, outliers=0), cloud(hue=90, outliers=0)
    config = ColourConfig(grey_saturation=0, **FREE)
    box, there = learn_box(pixels, config), learn_box(middle, config)
    off = (box.hue_mean - hue + 90) % 180 - 90
    assert abs(off) < 0.5
    assert 0 <= box.hue_mean < 180
    assert box.hue_half == pytest.approx(there.hue_half, rel=0.02)
    assert inside(box, pixels).mean() >= 0.93
    across = pixels.copy()
    across[:, 0] = (across[:, 0].astype(int) + 90) % 180
    assert inside(box, across).mean() == 0


@given(st.integers(0, 179), st.floats(0, 29))
def test_the_mask_takes_just_the_hues_within_the_half_width(mean, half):
    box = ColourBox(float(mean), half, (0.0, 255.0), (0.0, 200.0))
    hues = np.arange(180)
    hsv = np.stack([hues, np.full(180, 100), np.full(180, 100)], axis=1).astype(np.uint8)
    away = np.abs((hues - mean + 90) % 180 - 90)
    got = inside(box, hsv)
    assert got[away <= half].all()
    assert not got[away > half + 1].any()


@pytest.mark.parametrize("saturation", [0, 10, 30])
def test_a_grey_marker_takes_every_hue(saturation):
    rng = np.random.default_rng(4)
    pixels = np.stack(
        [rng.integers(0, 180, 500), np.full(500, saturation), rng.integers(100, 140, 500)], axis=1
    ).astype(np.uint8)
    box = learn_box(pixels, ColourConfig())
    hsv = np.stack([np.arange(180), np.full(180, saturation), np.full(180, 120)], axis=1).astype(np.uint8)
    assert inside(box, hsv).all()


def test_a_flat_seed_does_not_make_a_box_of_one_colour():
    pixels = np.full((200, 3), (60, 150, 150), np.uint8)
    config = ColourConfig()
    box = learn_box(pixels, config)
    assert box.hue_half >= config.least_hue
    assert np.ptp(box.saturation) >= 2 * config.least_saturation - 1e-9
    assert np.ptp(box.value) >= 2 * config.least_value - 1e-9
    assert inside(box, np.array([[64, 170, 120]], np.uint8)).all()


def test_no_pixels_are_refused():
    with pytest.raises(ValueError, match="no pixels"):
        learn_box(np.zeros((0, 3), np.uint8), ColourConfig())


def test_a_brighter_scene_is_followed_by_the_gain():
    box = ColourBox(60.0, 8.0, (100.0, 200.0), (80.0, 120.0))
    bright = np.array([[60, 150, 190]], np.uint8)
    assert not inside(box, bright)[0]
    assert box.mask(bright[None], 1.7)[0, 0] == 255
    dark = np.array([[60, 150, 50]], np.uint8)
    assert not inside(box, dark)[0]
    assert box.mask(dark[None], 0.6)[0, 0] == 255


@pytest.mark.parametrize(("top", "saturation", "taken"), [(200, 75, True), (200, 65, False), (180, 75, False)])
def test_a_marker_so_bright_that_it_clips_may_go_pale(top, saturation, taken):
    """From 235 on the channels clip, which takes saturation away: 100 becomes 70. Below it nothing is given."""
    box = ColourBox(60.0, 8.0, (100.0, 200.0), (80.0, float(top)))
    pixel = np.array([[[60, saturation, 225]]], np.uint8)
    assert (box.mask(pixel, 1.25)[0, 0] == 255) == taken
    white = np.array([[[60, 150, 255]]], np.uint8)
    assert (box.mask(white, 1.25)[0, 0] == 255) == (top == 200)


def test_limits_are_half_a_step_outside_the_box_and_none_at_the_ends_of_the_scale():
    box = ColourBox(60.0, 8.0, (100.0, 200.0), (80.0, 120.0))
    assert box.limits().tolist() == [60, 8.5, 99.5, 200.5, 79.5, 120.5]
    assert box.limits(1.5).tolist() == pytest.approx([60, 8.5, 99.5, 200.5, 80 * 1.2 - 0.5, 180.5])
    assert box.limits(2.0).tolist() == pytest.approx([60, 8.5, 69.5, 200.5, 95.5, np.inf])  # 240: it clips
    everything = ColourBox(0.0, 90.0, (0.0, 255.0), (0.0, 255.0)).limits().tolist()
    assert everything == [0, np.inf, -np.inf, np.inf, -np.inf, np.inf]


@settings(deadline=None, max_examples=60)
@given(BOXES, st.floats(0.2, 3), st.integers(0, 10**6))
def test_the_mask_from_bgr_is_the_definition_at_every_pixel(box, gain, seed):
    bgr = np.random.default_rng(seed).integers(0, 256, (9, 14, 3)).astype(np.uint8)
    bgr[0, :5] = [[0, 0, 0], [255, 255, 255], [7, 7, 7], [255, 0, 0], [0, 0, 255]]
    limits = box.limits(gain)
    expected = reference.inside(limits, reference.hsv_of(bgr))
    np.testing.assert_array_equal(box_mask(bgr, limits), 255 * expected)
    np.testing.assert_array_equal(box_mask(bgr[::-1, ::2], limits), 255 * expected[::-1, ::2])


@settings(deadline=None, max_examples=60)
@given(BOXES, st.floats(0.2, 3), st.integers(0, 10**6))
def test_masks_differ_from_opencvs_by_a_step_at_the_limits_at_most(box, gain, seed):
    """Wherever OpenCV's 8-bit HSV and inRange would answer otherwise, the colour is within a step of a limit."""
    bgr = np.random.default_rng(seed).integers(0, 256, (40, 30, 3)).astype(np.uint8)
    hsv = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)
    expected = reference.mask(box, hsv, gain)
    mean, half, *ends = box.limits(gain)
    exact = reference.hsv_of(bgr)
    hue_off = np.abs((exact[..., 0] - mean + 90) % 180 - 90)
    edge = np.abs(hue_off - half) <= 1.5
    for k, (low, high) in enumerate((ends[:2], ends[2:])):
        edge |= np.minimum(np.abs(exact[..., k + 1] - low), np.abs(exact[..., k + 1] - high)) <= 1
    assert ((box_mask(bgr, box.limits(gain)) == expected) | edge).all()
    assert ((box.mask(hsv, gain) == expected) | edge).all()


@settings(deadline=None, max_examples=80)
@given(
    st.integers(0, 10**6), st.integers(1, 30), st.integers(1, 30), st.floats(0.1, 0.9), st.booleans(), st.integers(1, 6)
)
def test_blobs_are_opencvs(seed, height, width, share, diagonal, least):
    mask = 255 * (np.random.default_rng(seed).random((height, width)) < share).astype(np.uint8)
    ours, theirs = blobs(mask, diagonal, least), reference.blobs(mask, diagonal, least)
    assert ours.shape == theirs.shape
    order = [np.lexsort(rows.T[::-1]) for rows in (ours, theirs)]
    np.testing.assert_allclose(ours[order[0]], theirs[order[1]], atol=1e-9)


def test_near_the_outline_hue_may_be_half_as_far_again_off_and_the_rest_fall_to_about_half():
    limits = np.array([60.0, 8.0, 100.0, 200.0, 80.0, 120.0])
    before = limits.copy()
    assert loosened(limits).tolist() == pytest.approx([60.0, 12.0, 60.0, np.inf, 40.0, np.inf])
    np.testing.assert_array_equal(limits, before)  # it is a copy
    everything = ColourBox(0.0, 90.0, (0.0, 255.0), (0.0, 255.0)).limits()
    assert loosened(everything).tolist() == everything.tolist()


@pytest.mark.parametrize(
    ("colour", "taken"),
    [
        ((71.5, 150, 100), True), ((72.5, 150, 100), False), ((48.5, 150, 100), True), ((47.5, 150, 100), False),
        ((60, 61, 100), True), ((60, 59, 100), False), ((60, 255, 100), True),
        ((60, 150, 41), True), ((60, 150, 39), False), ((60, 150, 255), True),
    ],
)  # fmt: skip
def test_a_colour_within_each_loosened_limit_is_taken_and_one_beyond_is_not(colour, taken):
    limits = loosened(np.array([60.0, 8.0, 100.0, 200.0, 80.0, 120.0]))
    assert bool(reference.inside(limits, np.array([colour], float))[0]) == taken


# -- on pictures -----------------------------------------------------------------------------------


@pytest.mark.parametrize("stop", ["coverage", "gain"])
@pytest.mark.parametrize("rgb", [ORANGE, GREEN, BLUE, (220, 30, 45)])
@pytest.mark.parametrize("r", [10, 20])
def test_the_blob_of_a_ball_is_where_the_ball_is(stop, rgb, r):
    ball = ball_at(150.3, 117.8, r, rgb=rgb)
    circle = truth(ball)
    patch = Patch(bgr_frame(picture(ball)), Window.around(circle, 3 * r))
    box = learn_box(disc_pixels(patch, circle, 0.8), ColourConfig(stop=stop))
    found = colour_circle(box.mask(patch.hsv), patch, circle.shifted(2, -3))
    assert found.dice(circle) > 0.85


def test_of_two_blobs_the_nearer_and_likelier_one_is_taken():
    mask = np.zeros((80, 120), np.uint8)
    cv2.circle(mask, (30, 40), 10, 255, -1)
    cv2.circle(mask, (80, 40), 10, 255, -1)
    cv2.circle(mask, (55, 12), 2, 255, -1)
    patch = Patch(BgrFrame(0, 0, np.zeros((200, 200, 3), np.uint8)), Window(20, 30, 120, 80))
    assert colour_circle(mask, patch, Circle(52, 71, 10)).dice(Circle(50, 70, 10)) > 0.9
    assert colour_circle(mask, patch, Circle(97, 69, 10)).dice(Circle(100, 70, 10)) > 0.9
    assert colour_circle(mask, patch, Circle(75, 45, 10)).r_px > 5  # the speck is noise


@pytest.mark.parametrize("step", [0.4, 1.0, 1.7])
def test_the_blob_is_in_image_pixels_at_any_scale_of_the_patch(step):
    ball = ball_at(150.3, 117.8, 18)
    circle, frame = truth(ball), bgr_frame(picture(ball))
    x0, y0, side = circle.x_px - 39.7, circle.y_px - 44.2, int(85 / step)
    patch = Patch.scaled(frame, cut_bgr(*frame.planes, x0, y0, step, side, side), x0, y0, step)
    box = learn_box(disc_pixels(patch, circle, 0.8), ColourConfig())
    found = colour_circle(box_mask(patch.bgr, box.limits()), patch, circle.shifted(2, -3))
    assert found.dice(circle) > 0.85


def test_no_blob_gives_no_circle():
    patch = Patch(BgrFrame(0, 0, np.zeros((50, 50, 3), np.uint8)), Window(0, 0, 50, 50))
    assert colour_circle(np.zeros((50, 50), np.uint8), patch, Circle(25, 25, 10)) is None


def test_disc_pixels_are_those_within_the_share_and_inside_the_picture():
    image = np.random.default_rng(5).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    patch = Patch(BgrFrame(0, 0, image), Window(-5, 10, 60, 40))
    circle = Circle(3.0, 30.0, 10.0)
    mask = disc_mask(patch, circle, 0.8)
    for y in range(40):
        for x in range(60):
            px, py = x - 5, y + 10
            expected = px >= 0 and np.hypot(px - 3, py - 30) <= 8
            assert mask[y, x] == expected
    assert len(disc_pixels(patch, circle, 0.8)) == mask.sum()


def test_a_strap_or_print_of_no_hue_does_not_widen_the_markers_hue():
    """A fifth of the pixels are nearly black, their hues by chance."""
    rng = np.random.default_rng(3)
    ball = np.stack([rng.normal(28, 2, 800), rng.normal(200, 12, 800), rng.normal(190, 20, 800)], axis=1)
    strap = np.stack([rng.uniform(0, 180, 200), rng.uniform(20, 200, 200), rng.uniform(8, 30, 200)], axis=1)
    both = np.clip(np.concatenate([ball, strap]), 0, 255).astype(np.uint8)
    box = learn_box(both, ColourConfig())
    assert box.hue_half < 12
    assert abs(box.hue_mean - 28) < 3


def test_the_less_colour_the_less_its_hue_says():
    """Six levels of noise beside a chroma of 120 and of 12: 3 and 29 degrees, and the box's own."""
    for chroma, degrees in ((120, np.degrees(6 / 120)), (12, np.degrees(6 / 12))):
        pixels = np.tile(np.array([[20, 255, chroma]], np.uint8), (50, 1))
        box = learn_box(pixels, ColourConfig())
        wider = less_sure_of_hue(box, pixels)
        assert 2 * wider.hue_half == pytest.approx(np.hypot(2 * box.hue_half, degrees))
        assert (wider.hue_mean, wider.saturation, wider.value) == (box.hue_mean, box.saturation, box.value)
    black = np.zeros((50, 3), np.uint8)
    assert less_sure_of_hue(learn_box(black, ColourConfig()), black).hue_half == 90
