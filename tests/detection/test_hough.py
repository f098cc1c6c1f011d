import cv2
import numpy as np
import pytest

from scenes import ball_at, bgr_frame, picture, truth
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.detection.hough import HoughConfig, hough_circles

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
