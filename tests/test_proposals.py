"""Coloured spheres with no seed at all."""

import math
import re

import numpy as np
import pytest

from scenes import BLUE, CAMERA, GREEN, ORANGE, Cover, ball_at, bgr_frame, picture, truth
from spheremcap import api
from spheremcap.chain import ChainConfig
from spheremcap.config import Settings
from spheremcap.proposals import propose

PERIOD_NS = 10_000_000
EVERY = 40
"""Frames from one look to the next."""


def mover(index, x=60.0, y=70.0, r=14, rgb=ORANGE):
    """Two pixels a frame to the right."""
    return ball_at(x + 2 * index, y, r, rgb=rgb)


def film(count, *balls, covers=(), shift=lambda index: (0, 0)):
    """Frames of 0.01 s; each ball is a function of the frame's number that may say None."""
    for index in range(count):
        shown = [ball for ball in (of(index) for of in balls) if ball is not None]
        image = picture(*shown, covers=covers, noise_seed=index, shift=shift(index))
        yield bgr_frame(image, index, PERIOD_NS)


def proposed(frames):
    return propose(frames, CAMERA, ChainConfig())


def resting(x, y, r, rgb):
    return lambda index: ball_at(x, y, r, rgb=rgb)


def test_a_moving_ball_is_proposed_first_with_where_and_why():
    found = proposed(film(EVERY + 6, mover, resting(250, 180, 14, BLUE)))
    first = found[0]
    assert first.colour == "orange"
    assert first.frame_index == 0
    assert first.circle.dice(truth(mover(0))) > 0.9
    assert [index for index, _ in first.seen] == [0, EVERY]
    assert first.seen[1][1].dice(truth(mover(EVERY))) > 0.9
    assert first.seen[0][1] == first.circle
    assert re.search(r"round, (9\d|100)% of the outline seen; orange, with a colour difference of \d+", first.reason)
    assert "seen at 2 of 2 looks" in first.reason
    assert "moves against the background" in first.reason
    other = next(p for p in found if p.colour == "blue")
    assert other.reason.endswith("; at rest")
    assert other.score < 0.7 * first.score
    assert all(0 <= p.score <= 1 for p in found)


def test_nothing_is_proposed_where_there_is_nothing():
    assert all(p.score < 0.15 for p in proposed(film(8)))  # flecks of the backdrop
    assert proposed([]) == []
    assert proposed([bgr_frame(np.full((240, 320, 3), 90, np.uint8))]) == []


def test_a_ball_that_comes_later_begins_where_it_is_first_seen():
    found = proposed(film(2 * EVERY + 6, lambda index: mover(index - EVERY) if index >= EVERY else None))
    assert found[0].frame_index == EVERY
    assert found[0].circle.dice(truth(mover(0))) > 0.9
    assert "seen at 2 of 3 looks" in found[0].reason


def test_what_is_there_whenever_one_looks_comes_before_what_was_there_once():
    once = lambda index: mover(index, 60, 180, 14, GREEN) if index < EVERY else None  # noqa: E731
    found = proposed(film(2 * EVERY + 6, mover, once))
    assert [p.colour for p in found[:2]] == ["orange", "green"]
    assert found[1].score < 0.8 * found[0].score


def test_a_camera_that_moves_makes_nothing_move():
    still = proposed(film(8, resting(150, 100, 14, ORANGE), shift=lambda index: (3 * index, 0)))
    assert still[0].colour == "orange"
    assert "moves with the background" in still[0].reason
    moving = proposed(film(8, lambda index: ball_at(150 - 3 * index, 100, 14), shift=lambda index: (3 * index, 0)))
    assert "moves against the background" in moving[0].reason
    assert moving[0].score > 1.3 * still[0].score


def test_a_colour_that_the_picture_is_full_of_speaks_against_it():
    covers = tuple(Cover(x, 150, x + 36, 230, ORANGE) for x in range(10, 300, 50))
    alone, among = proposed(film(8, mover)), proposed(film(8, mover, covers=covers))
    assert among[0].circle.dice(truth(mover(0))) > 0.8
    assert among[0].score < 0.8 * alone[0].score
    share = [int(re.search(r"and (\d+)% of all", p.reason)[1]) for p in (alone[0], among[0])]
    assert share[0] > 80
    assert share[1] < 40


def test_two_of_one_colour_are_two():
    found = proposed(film(2 * EVERY + 6, mover, lambda index: mover(index, 30, 180, 20)))
    assert [p.colour for p in found[:2]] == ["orange", "orange"]
    assert sorted(round(p.circle.r_px) for p in found[:2]) == [14, 20]
    for p in found[:2]:
        ys = {round(circle.y_px) for _, circle in p.seen}
        assert len(ys) == 1  # neither took a sight of the other


def test_a_single_frame_will_do_but_tells_less():
    one = proposed(film(1, mover))
    assert one[0].circle.dice(truth(mover(0))) > 0.9
    assert "seen at 1 of 1 look;" in one[0].reason
    assert one[0].score < proposed(film(8, mover))[0].score


def test_frames_are_gone_through_once_and_the_result_is_the_same_again():
    frames = film(8, mover, resting(250, 180, 14, BLUE))
    found = proposed(frames)
    assert next(frames, None) is None
    assert proposed(film(8, mover, resting(250, 180, 14, BLUE))) == found


def test_as_a_function_it_needs_no_camera():
    found = api.propose(film(8, mover), Settings())
    assert found[0].circle.dice(truth(mover(0))) > 0.9
    assert api.propose(iter(()), Settings()) == []
    assert math.isclose(found[0].score, api.propose(film(8, mover), Settings(), CAMERA)[0].score, rel_tol=0.05)


@pytest.mark.parametrize("rgb", [ORANGE, GREEN, BLUE])
def test_one_of_which_a_part_is_hidden_is_proposed(rgb):
    found = proposed(film(8, lambda index: mover(index, rgb=rgb), covers=(Cover(0, 79, 319, 100),)))
    assert found[0].circle.dice(truth(mover(0))) > 0.75
