import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference import hough as reference
from scenes import BLUE, ORANGE, ball_at, bgr_frame, picture, truth
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.core.sampling import cut_bgr
from spheremcap.detection.hough import HoughConfig, hough_circles, vote_circles

SUB = 16


def perfect_disc(x, y, r, size=90):
    """A white disc on black, anti-aliased from 16 x 16 samples a pixel."""
    at = (np.arange(size * SUB) + 0.5) / SUB - 0.5
    inside = (at[None, :] - x) ** 2 + (at[:, None] - y) ** 2 <= r * r
    level = inside.reshape(size, SUB, size, SUB).mean(axis=(1, 3)) * 200 + 20
    return np.repeat(np.rint(level).astype(np.uint8)[..., None], 3, axis=2)


def whole(image):
    return Patch(BgrFrame(0, 0, image), Window(0, 0, image.shape[1], image.shape[0]))


def error(found, true):
    """Eq 2.19 of the best circle; 1 when there is none."""
    return 1 - found[0].dice(true) if found else 1.0


@pytest.mark.parametrize(("r", "floor"), [(8, 0.12), (12, 0.084), (20, 0.051), (30, 0.034)])
def test_on_perfect_discs_the_error_is_the_floor_that_dp_4_leaves(r, floor):
    rng = np.random.default_rng(r)
    errors = []
    for _ in range(25):
        x, y = 45 + rng.uniform(-2, 2, 2)
        true = Circle(x, y, r + rng.uniform(-0.5, 0.5))
        near = Circle(x + 1, y - 1, r)
        errors.append(error(hough_circles(whole(perfect_disc(x, y, true.r_px)), near, HoughConfig()), true))
    assert np.mean(errors) < 1.6 * floor


def test_the_thesis_optimum_is_the_default():
    config = HoughConfig()
    assert (config.dp, config.min_dist_px, config.param1, config.param2) == (4, 1, 77, 1)


def test_circles_are_in_image_pixels_wherever_the_patch_lies():
    ball = ball_at(200, 130, 20)
    frame = bgr_frame(picture(ball))
    for window in (Window(150, 80, 101, 101), Window(160, 85, 90, 90)):
        found = hough_circles(Patch(frame, window), truth(ball), HoughConfig())
        assert error(found, truth(ball)) < 0.2


@pytest.mark.parametrize("r", [12, 20])
def test_radii_stay_in_the_window_around_the_last_one(r):
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.integers(0, 256, (90, 90, 3)).astype(np.uint8), (0, 0), 1.5)
    found = hough_circles(whole(noise), Circle(45, 45, r), HoughConfig())
    for circle in found:
        assert 0.7 * r <= circle.r_px <= 1.3 * r + 2
    assert len(found) <= HoughConfig().keep


def test_a_flat_picture_has_no_circle():
    assert hough_circles(whole(np.full((60, 60, 3), 90, np.uint8)), Circle(30, 30, 12), HoughConfig()) == ()


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    blur=st.floats(0.8, 3),
    r=st.floats(4, 14),
    dp=st.floats(1, 5),
    threshold=st.integers(10, 200).map(lambda level: level + 0.3),  # no whole gradient lies on it, nor on its half
    least_votes=st.floats(0, 8),
    apart=st.just(0.0) | st.floats(0.01, 9),
    corner=st.tuples(st.integers(0, 9), st.integers(0, 9)),
)
def test_the_compiled_votes_equal_the_reference(seed, blur, r, dp, threshold, least_votes, apart, corner):
    """Same circles to 1e-6 px; the order within equal votes is nobody's."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal((60, 52, 3)), (0, 0), blur)
    bgr = cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    x0, y0 = corner
    how = (0.75 * r, 1.25 * r, dp, apart, threshold, least_votes)
    ours = vote_circles(bgr, x0, y0, 50, 60, *how, 500)
    theirs = reference.vote_circles(bgr[y0:60, x0:50], *how, 500) + np.array([x0, y0, 0])
    if apart > 0:  # which of two close ones goes depends on the order within equal votes
        few = vote_circles(bgr, x0, y0, 50, 60, *how, 1)
        assert len(few) == min(1, len(theirs))
        away = np.hypot(*(ours[:, None, :2] - ours[None, :, :2]).T) + 1e9 * np.eye(len(ours))
        assert (away >= apart * (1 - 1e-12)).all()
        ours = vote_circles(bgr, x0, y0, 50, 60, *how[:3], 0.0, *how[4:], 500)
        theirs = reference.vote_circles(bgr[y0:60, x0:50], *how[:3], 0.0, *how[4:], 500) + np.array([x0, y0, 0])
    assert ours.shape == theirs.shape
    apart_px = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
    assert (apart_px.min(axis=0, initial=1e9) < 1e-6).all()
    assert (apart_px.min(axis=1, initial=1e9) < 1e-6).all()


def test_circles_come_with_the_most_votes_first_and_no_more_than_asked_for():
    """A ball fully in view before one that is half covered."""
    image = np.maximum(perfect_disc(30, 45, 12), perfect_disc(64, 45, 12))
    image[45:, 50:] = 20
    whole_one, half_one = Circle(30, 45, 12), Circle(64, 45, 12)
    found = vote_circles(image, 0, 0, 90, 90, 9.0, 15.0, 2.4, 12.0, 77.0, 0.6, 5)
    assert Circle(*found[0]).dice(whole_one) > 0.9
    assert max(Circle(*row).dice(half_one) for row in found) > 0.8
    assert len(vote_circles(image, 0, 0, 90, 90, 9.0, 15.0, 2.4, 12.0, 77.0, 0.6, 1)) == 1


@pytest.mark.parametrize("rgb", [ORANGE, BLUE])
@pytest.mark.parametrize("r", [7, 12, 20, 34])
def test_a_marker_is_found_at_its_own_scale_whatever_its_size(r, rgb):
    """In a patch where its radius is 12.8 px, a quarter of a radius off and 5 % off in size."""
    errors = []
    for k in range(6):
        ball = ball_at(160 + 0.37 * k, 120 - 0.21 * k, r, rgb=rgb)
        true, frame = truth(ball), bgr_frame(picture(ball, noise_seed=k))
        expected = Circle(true.x_px + 0.2 * r, true.y_px - 0.15 * r, true.r_px * (0.95 + 0.02 * k))
        step = expected.r_px / 12.8
        x0, y0 = expected.x_px - 32 * step, expected.y_px - 32 * step
        patch = Patch.scaled(frame, cut_bgr(*frame.planes, x0, y0, step, 64, 64), x0, y0, step)
        errors.append(error(hough_circles(patch, expected, HoughConfig()), true))
    assert np.mean(errors) < 0.12


def test_the_gradient_threshold_is_in_the_pictures_pixels():
    """The same edges are found or not whether the patch is finer than the picture or not."""
    disc = cv2.GaussianBlur(perfect_disc(45, 45, 20), (0, 0), 1.0)
    steepest = sum(np.abs(cv2.Sobel(disc[:, :, 0], cv2.CV_32F, *axis)) for axis in ((1, 0), (0, 1))).max()
    frame = BgrFrame(0, 0, disc)
    for step in (1.0, 0.5):
        side = int(90 / step)
        patch = Patch.scaled(frame, cut_bgr(*frame.planes, 0.0, 0.0, step, side, side), 0.0, 0.0, step)
        assert hough_circles(patch, Circle(46, 44, 20), HoughConfig(param1=0.75 * steepest)), step
        assert not hough_circles(patch, Circle(46, 44, 20), HoughConfig(param1=1.25 * steepest)), step


def test_a_patch_that_holds_nothing_of_the_circle_has_none():
    image = perfect_disc(45, 45, 12)
    assert hough_circles(whole(image), Circle(-60, 45, 12), HoughConfig()) == ()
    assert hough_circles(whole(image), Circle(45, 300, 12), HoughConfig()) == ()
