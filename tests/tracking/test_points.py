import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from patches import at_scale

from reference import points as reference
from scenes import ball_at, bgr_frame, picture, truth
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.tracking.points import PointsConfig, geometry_scale

BALL = ball_at(160, 118, 18)
CIRCLE = truth(BALL)


def near(image, circle=CIRCLE):
    return at_scale(BgrFrame(0, 0, image), circle)


def resized(image, ratio, dx=0.0, dy=0.0):
    """The picture scaled about the marker's centre, then moved."""
    x, y = CIRCLE.x_px, CIRCLE.y_px
    m = np.array([[ratio, 0, x + dx - ratio * x], [0, ratio, y + dy - ratio * y]], np.float64)
    return cv2.warpAffine(image, m, image.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def ratio_of(*how):
    found = geometry_scale(*how)
    return None if found is None else found[0]


RATIOS = (0.95, 0.97, 0.99, 1.0, 1.01, 1.03, 1.05)
TEXTURE = np.clip(
    128 + 90 * cv2.GaussianBlur(np.random.default_rng(0).standard_normal((240, 320, 3)), (0, 0), 2) / 0.28,
    0,
    255,
)


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("r_px", [8, 12, 18, 30])
def test_a_textured_picture_scaled_by_a_ratio_gives_that_ratio(ratio, r_px):
    image, circle = TEXTURE.astype(np.uint8), Circle(CIRCLE.x_px, CIRCLE.y_px, r_px)
    found = ratio_of(near(image, circle), circle, near(resized(image, ratio), circle), circle, PointsConfig())
    # All points are just inside the outline, 24 of them: of 16 pixels across, interpolation takes its share.
    assert found == pytest.approx(ratio, abs=0.01 if r_px == 8 else 0.006)


@pytest.mark.parametrize("ratio", RATIOS)
def test_a_smooth_ball_scaled_by_a_ratio_gives_about_that_ratio(ratio):
    image = picture(BALL, noise=1.0)
    found = ratio_of(near(image), CIRCLE, near(resized(image, ratio)), CIRCLE, PointsConfig())
    assert found - 1 == pytest.approx(ratio - 1, rel=0.45, abs=0.006)


@pytest.mark.parametrize(("r_px", "within"), [(8, 0.012), (12, 0.009)])
def test_a_smooth_small_ball_scaled_by_a_ratio_gives_about_that_ratio(r_px, within):
    """The points lie inside the outline and move with it: up to a third too far, the more the smaller the ball."""
    ball = ball_at(160, 118, r_px)
    image, circle = picture(ball, noise=1.0), truth(ball)
    found = ratio_of(near(image, circle), circle, near(resized(image, 1.03), circle), circle, PointsConfig())
    assert found == pytest.approx(1.03, abs=within)


@pytest.mark.parametrize("ratio", [0.96, 1.04])
def test_the_ratio_holds_when_the_marker_moved_and_kcf_was_a_pixel_off(ratio):
    image = picture(BALL, noise=1.0)
    moved = near(resized(image, ratio, 11, -7), CIRCLE.shifted(12, -6))
    found = ratio_of(near(image), CIRCLE, moved, CIRCLE.shifted(12, -6), PointsConfig())
    assert found == pytest.approx(ratio, abs=0.015)


@pytest.mark.parametrize("ratio", [0.97, 1.03])
def test_a_ball_that_comes_nearer_before_a_still_background_grows(ratio):
    nearer = ball_at(160, 118, 18 * ratio)
    found = ratio_of(
        near(picture(BALL)), CIRCLE, near(picture(nearer, noise_seed=1), truth(nearer)), truth(nearer), PointsConfig()
    )
    assert found is not None
    assert 0.4 < (found - 1) / (ratio - 1) < 1.6


@pytest.mark.parametrize(("ratio", "expected"), [(1.05, 1.02), (0.95, 0.98)])
def test_one_step_is_clamped(ratio, expected):
    image = picture(BALL, noise=1.0)
    config = PointsConfig(max_step=0.02)
    assert ratio_of(near(image), CIRCLE, near(resized(image, ratio)), CIRCLE, config) == pytest.approx(expected)


def test_the_deviation_is_that_of_the_ratios():
    """Fifty draws of noise: the ratios scatter by about what they say."""
    small = [geometry_scale(near(picture(BALL, noise=40.0, noise_seed=2 * k)), CIRCLE,
                            near(resized(picture(BALL, noise=40.0, noise_seed=2 * k + 1), 1.02)), CIRCLE,
                            PointsConfig()) for k in range(50)]  # fmt: skip
    ratios, deviations = np.array([found for found in small if found is not None]).T
    assert 0.4 < ratios.std() / deviations.mean() < 2.0
    calm = geometry_scale(
        near(picture(BALL, noise=1.0)), CIRCLE, near(picture(BALL, noise=1.0)), CIRCLE, PointsConfig()
    )
    assert calm[1] < 0.7 * deviations.mean()


def test_there_is_no_ratio_where_there_is_nothing_to_follow():
    flat = near(np.full((240, 320, 3), 120, np.uint8))
    assert ratio_of(flat, CIRCLE, flat, CIRCLE, PointsConfig()) is None


def test_there_is_no_ratio_between_two_different_pictures():
    rng = np.random.default_rng(0)
    other = near(rng.integers(0, 256, (240, 320, 3)).astype(np.uint8))
    assert ratio_of(near(picture(BALL)), CIRCLE, other, CIRCLE, PointsConfig()) is None


def test_coordinates_are_the_images_not_the_patches():
    image = picture(BALL, noise=1.0)
    before, now = bgr_frame(image), bgr_frame(resized(image, 1.03), 1)
    answers = {
        ratio_of(Patch(before, window), CIRCLE, Patch(now, window), CIRCLE, PointsConfig())
        for window in (Window(0, 0, 320, 240), Window(100, 58, 121, 121))
    }
    assert max(answers) - min(answers) < 1e-4


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("guess", [0.95, 1.0, 1.06])
def test_the_two_patches_may_be_at_different_scales(ratio, guess):
    """The second is cut for the radius that was predicted, whatever it is then found to be."""
    image = TEXTURE.astype(np.uint8)
    predicted = Circle(CIRCLE.x_px, CIRCLE.y_px, CIRCLE.r_px * guess)
    now = near(resized(image, ratio), predicted)
    assert ratio_of(near(image), CIRCLE, now, predicted, PointsConfig()) == pytest.approx(ratio, abs=0.006)


def test_points_that_something_else_covers_do_not_come_back():
    """A textured thing covers a third of the marker: where its points seem to go (to 0.06 here) must not count."""
    image = TEXTURE.astype(np.uint8)
    misses = []
    for seed, ratio in enumerate(RATIOS):
        now = resized(image, ratio)
        other = np.random.default_rng(seed + 1).integers(0, 256, (60, 60, 3)).astype(np.float32)
        other = cv2.GaussianBlur(other, (0, 0), 1.5)
        now[90:150, 168:228] = np.clip(128 + 50 * (other - other.mean()) / other.std(), 0, 255).astype(np.uint8)
        found = ratio_of(near(image), CIRCLE, near(now), CIRCLE, PointsConfig(max_step=0.5))
        misses.append(abs(found - ratio))
    assert np.mean(misses) < 0.015


@pytest.mark.parametrize("away", [(3, 0), (0, -3), (-2, 2), (-3, 0), (0, 3)])
@pytest.mark.parametrize("ratio", [0.91, 1.0, 1.09])
def test_three_pixels_of_the_patch_are_not_too_far_to_follow(ratio, away):
    image, step = TEXTURE.astype(np.uint8), 5 * CIRCLE.r_px / 64
    start = CIRCLE.shifted(away[0] * step, away[1] * step)
    found = ratio_of(near(image), CIRCLE, near(resized(image, ratio), start), start, PointsConfig())
    assert found == pytest.approx(ratio, abs=0.008)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 1000), st.floats(8, 24), st.floats(0.95, 1.05), st.floats(-1, 1), st.floats(-1, 1), st.booleans()
)  # fmt: skip
def test_the_kernel_equals_opencvs_lucas_kanade(seed, r_px, ratio, dx, dy, reach):
    """To 0.006 in the ratio: slopes are plain differences here and Scharr's there, and pyramids differ in smoothing."""
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(rng.standard_normal((240, 320, 3)), (0, 0), 0.12 * r_px)
    image = np.clip(128 + 50 * image / image.std(), 0, 255).astype(np.uint8)
    circle = Circle(CIRCLE.x_px + dx, CIRCLE.y_px + dy, r_px)
    before = near(image, circle.shifted(dy, dx))
    now = near(resized(image, ratio, dx, dy), circle.shifted(dx, -dy))
    config = PointsConfig(max_round_trip_px=0.2 if reach else 0.5)
    ours, theirs = (how(before, circle, now, circle, config) for how in (geometry_scale, reference.geometry_scale))
    assert ours[0] == pytest.approx(theirs[0], abs=0.006)
    assert ours[1] == pytest.approx(max(0.002, theirs[1]), abs=0.006)


def test_the_radius_after_is_ratio_times_the_radius_before():
    image = picture(BALL, noise=0)
    off = Circle(CIRCLE.x_px, CIRCLE.y_px, CIRCLE.r_px * 1.1)  # a wrong radius scales by the same ratio
    found = ratio_of(near(image, off), off, near(resized(image, 1.04), off), off, PointsConfig())
    assert found == pytest.approx(1.04, abs=0.02)
