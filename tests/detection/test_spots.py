"""What is round and of a colour of its own on one frame."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import BLUE, CAMERA, GREEN, ORANGE, Cover, ball_at, bgr_frame, picture, truth, yuv_frame
from spheremcap.core.circle import Circle
from spheremcap.detection.edge import EdgeConfig
from spheremcap.detection.hues import name_of
from spheremcap.detection.outline import Outline
from spheremcap.detection.spots import Spot, described, spot_at, spots
from spheremcap.positioning.sphere import PositionConfig

OUTLINE = Outline(0.02, CAMERA, EdgeConfig(), PositionConfig())
SPOT = Spot(Circle(100, 100, 20), 0.9, 0.9, 0.1, 40.0, (57.0, 170.0, 160.0))


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
@pytest.mark.parametrize(("rgb", "name"), [(ORANGE, "orange"), (GREEN, "green"), (BLUE, "blue")])
@pytest.mark.parametrize("r", [6, 15, 40])
def test_a_ball_is_the_clearest_thing_wherever_it_is(r, rgb, name, frame_of):
    for x, y in ((60, 70), (255.5, 190.2)):
        ball = ball_at(x, y, r, rgb=rgb)
        found = spots(frame_of(picture(ball, noise_seed=3)), OUTLINE, 5)
        assert found[0].circle.dice(truth(ball)) > 0.8
        assert found[0].promise > 0.5
        assert name_of(found[0].hsv) == name


@pytest.mark.parametrize("rgb", [(235, 235, 230), (20, 20, 22)])
def test_a_ball_without_a_hue_is_found_by_its_shape(rgb):
    ball = ball_at(180, 100, 18, rgb=rgb)
    found = spots(bgr_frame(picture(ball)), OUTLINE, 30)  # after the flecks of the backdrop, which have colours
    assert any(spot.circle.dice(truth(ball)) > 0.8 for spot in found)


def test_several_are_found_and_no_more_than_asked_for():
    balls = [ball_at(60, 60, 14), ball_at(160, 150, 20, rgb=GREEN), ball_at(260, 80, 10, rgb=BLUE)]
    frame = bgr_frame(picture(*balls))
    three = spots(frame, OUTLINE, 3)
    for ball in balls:
        assert sum(spot.circle.dice(truth(ball)) > 0.8 for spot in three) == 1
    assert spots(frame, OUTLINE, 2) == three[:2]
    assert [s.promise for s in three] == sorted((s.promise for s in three), reverse=True)


def test_nothing_is_clear_where_there_is_nothing():
    assert spots(bgr_frame(np.full((240, 320, 3), 120, np.uint8)), OUTLINE, 5) == []
    assert all(spot.promise < 0.65 for spot in spots(bgr_frame(picture()), OUTLINE, 5))  # flecks of the backdrop


def test_a_bar_and_a_card_of_a_marker_s_colour_are_no_spots_before_it():
    ball = ball_at(70, 60, 14)
    covers = (Cover(180, 100, 290, 112, ORANGE), Cover(120, 160, 180, 220, ORANGE))
    found = spots(bgr_frame(picture(ball, covers=covers)), OUTLINE, 5)
    assert found[0].circle.dice(truth(ball)) > 0.8
    assert all(spot.promise < 0.7 * found[0].promise for spot in found[1:])


def test_a_glint_on_a_ball_is_no_spot_of_its_own():
    ball, glint = ball_at(150, 120, 30, rgb=GREEN), ball_at(143, 112, 7, rgb=(235, 250, 235))
    found = spots(bgr_frame(picture(ball, glint)), OUTLINE, 8)
    assert found[0].circle.dice(truth(ball)) > 0.8
    assert not any(spot.circle.dice(truth(glint)) > 0.5 for spot in found)


def test_a_ball_before_a_larger_one_of_another_clearness_stays():
    """Only what lies wholly inside is a part."""
    behind, before = ball_at(150, 120, 30, rgb=GREEN), ball_at(182, 120, 12, rgb=BLUE)
    found = spots(bgr_frame(picture(behind, before)), OUTLINE, 4)
    assert any(spot.circle.dice(truth(before)) > 0.7 for spot in found)


def test_what_is_partly_out_of_the_picture_counts_while_its_centre_is_in():
    inside, outside = ball_at(4, 120, 20), ball_at(-6, 120, 20)
    assert any(s.circle.dice(truth(inside)) > 0.7 for s in spots(bgr_frame(picture(inside)), OUTLINE, 4))
    assert not any(s.circle.dice(truth(outside)) > 0.5 for s in spots(bgr_frame(picture(outside)), OUTLINE, 8))
    assert spot_at(bgr_frame(picture(outside)), truth(outside), OUTLINE) is None


def test_a_glance_finds_an_outline_or_says_none():
    ball = ball_at(150, 120, 18)
    frame = bgr_frame(picture(ball))
    spot = spot_at(frame, truth(ball).shifted(2, -1).resized(19), OUTLINE)
    assert spot is not None
    assert spot.circle.distance(truth(ball)) < 0.5
    assert spot.visible > 0.9
    assert spot_at(bgr_frame(np.full((240, 320, 3), 120, np.uint8)), Circle(150, 120, 18), OUTLINE) is None


def test_a_description_is_of_the_colours_inside_and_around():
    ball = ball_at(150, 120, 18, rgb=BLUE)
    frame = bgr_frame(picture(ball))
    spot = described(frame, truth(ball), 0.8)
    assert (spot.circle, spot.visible) == (truth(ball), 0.8)
    assert spot.inside > 0.85
    assert spot.around < 0.2
    part = described(frame, truth(ball).resized(9), 0.8)
    assert part.around > 0.8


def test_clear_is_round_of_its_own_colour_and_different():
    assert SPOT.clear == pytest.approx(0.9 * 0.8)
    assert replace(SPOT, visible=0.45).clear == pytest.approx(0.45 * 0.8)
    assert replace(SPOT, contrast=15).clear == pytest.approx(0.5 * SPOT.clear)
    assert replace(SPOT, contrast=90).clear == SPOT.clear
    assert replace(SPOT, inside=0.2, around=0.9).clear == 0


def test_the_small_and_the_pale_promise_less():
    assert SPOT.promise == SPOT.clear
    assert replace(SPOT, circle=Circle(100, 100, 2.5)).promise == pytest.approx(0.5 * SPOT.clear)
    assert replace(SPOT, hsv=(57.0, 20.0, 160.0)).promise == pytest.approx(0.5 * SPOT.clear)
    assert replace(SPOT, circle=Circle(100, 100, 50), hsv=(57.0, 255.0, 160.0)).promise == SPOT.clear
