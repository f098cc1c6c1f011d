"""Pixels that are not square, by a marker's outline: said where it is plain, and nowhere else."""

import cv2
import numpy as np
import pytest

from scenes import Cover, ball_at, bgr_frame, picture, truth
from spheremcap.core.circle import Circle
from spheremcap.detection.aspect import pixel_aspect

BALL = ball_at(160, 120, 30)


def squeezed(image, aspect):
    """The picture as it is stored with pixels so much wider than high, and where its ball is then (equal area)."""
    height, width = image.shape[:2]
    wide = max(2, round(width / aspect))
    circle = truth(BALL)
    stored = cv2.resize(image, (wide, height), interpolation=cv2.INTER_AREA if aspect > 1 else cv2.INTER_CUBIC)
    x = (circle.x_px + 0.5) * wide / width - 0.5
    return bgr_frame(stored), Circle(x, circle.y_px, circle.r_px * float(np.sqrt(wide / width)))


@pytest.mark.parametrize("aspect", [0.55, 0.7, 4 / 3, 16 / 11, 1.8])
def test_an_ellipse_says_what_its_pixels_are(aspect):
    frame, circle = squeezed(picture(BALL, noise_seed=2), aspect)
    assert pixel_aspect(frame, circle) == pytest.approx(aspect, rel=0.02)


@pytest.mark.parametrize(("dx", "dy", "grown"), [(3, -2, 1.0), (0, 4, 1.08), (-2, 2, 0.92)])
def test_a_careless_click_says_the_same(dx, dy, grown):
    frame, circle = squeezed(picture(BALL, noise_seed=2), 1.5)
    clicked = Circle(circle.x_px + dx, circle.y_px + dy, circle.r_px * grown)
    assert pixel_aspect(frame, clicked) == pytest.approx(1.5, rel=0.03)


def test_square_pixels_stay_square():
    for seed in range(4):
        assert pixel_aspect(bgr_frame(picture(BALL, noise_seed=seed)), truth(BALL)) == 1.0


@pytest.mark.parametrize(
    "cover", [Cover(160, 60, 240, 180), Cover(90, 120, 230, 200), Cover(150, 60, 170, 180), Cover(90, 60, 145, 180)]
)
def test_what_hides_a_part_of_a_ball_makes_no_ellipse(cover):
    assert pixel_aspect(bgr_frame(picture(BALL, covers=(cover,))), truth(BALL)) == 1.0


@pytest.mark.parametrize("steps", [(12, 0), (0, 20), (14, 14)])
def test_a_ball_drawn_out_by_its_motion_makes_no_ellipse(steps):
    """Its sides are sharp and its ends are not."""
    moments = [
        picture(ball_at(160 + steps[0] * t, 120 + steps[1] * t, 30), noise_seed=1).astype(np.float64)
        for t in np.linspace(-1, 1, 21)
    ]
    frame = bgr_frame(np.mean(moments, axis=0).astype(np.uint8))
    assert pixel_aspect(frame, truth(BALL)) == 1.0


def test_where_there_is_nothing_it_says_nothing():
    assert pixel_aspect(bgr_frame(picture(noise_seed=3)), truth(BALL)) == 1.0
