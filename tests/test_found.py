"""Which proposal is which marker, and what is asked."""

from dataclasses import replace

import pytest

from spheremcap.config import MarkerSettings, Settings, parse_seed
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Hidden, Seed
from spheremcap.detection.hues import name_of
from spheremcap.errors import UsageError
from spheremcap.found import as_seed, assign, rounded
from spheremcap.proposals import Proposal

ORANGE, GREEN, BLUE, RED, GREY = (14.0, 57.0, 112.0, 2.0, None)
LOOKED = "in the first 3 s (frames 0 to 89)"


def thing(hue, score=0.6, x=100.0, frame=0):
    hsv = (0.0, 5.0, 120.0) if hue is None else (hue, 200.0, 180.0)
    circle = Circle(x, 50.123456, 12.0)
    return Proposal(circle, frame, name_of(hsv), hsv, score, f"because {score}", ((frame, circle),))


def settings(**markers):
    listed = tuple(MarkerSettings(name=name, colour=colour) for name, colour in markers.items())
    return Settings(markers=listed)


def found(things, listed, answers=()):
    return assign(things, listed, answers, LOOKED)


def taken(result):
    return {seed.marker: (seed.circle.x_px, seed.frame_index) for seed in result.seeds}


def test_each_marker_gets_the_thing_of_its_colour():
    things = [thing(ORANGE, x=1), thing(GREEN, x=2, frame=7), thing(BLUE, 0.3, x=3)]
    result = found(things, settings(left="green", right="orange", elbow=(100, 125)))
    assert taken(result) == {"right": (1, 0), "left": (2, 7), "elbow": (3, 0)}
    assert all(seed.author == "auto" and not seed.time for seed in result.seeds)
    assert not result.missing
    assert not result.unclear
    assert [m.name for m in result.settings.markers] == ["left", "right", "elbow"]


def test_what_was_taken_why_and_what_was_left_is_told():
    things = [thing(GREEN, 0.6, x=2), thing(ORANGE, 0.5, x=1)]
    result = found(things, settings(left="green"))
    assert result.told == (
        "left is left@0=2,50.12,12 (score 0.60): because 0.6",
        "left alone: orange@0=1,50.12,12 (score 0.50): because 0.5",
    )


def test_a_seed_that_is_told_is_the_seed_that_is_taken():
    odd = replace(thing(GREEN), circle=Circle(100.123456, 7.0 / 3, 11.99999))
    (seed,) = found([odd], settings(left="green")).seeds
    assert parse_seed(as_seed("left", odd)).circle == seed.circle == rounded(odd.circle) == (100.12, 2.33, 12.0)


def test_two_alike_are_asked_and_not_guessed():
    things = [thing(ORANGE, 0.6, x=1), thing(ORANGE, 0.31, x=2)]
    result = found(things, settings(left="orange"))
    assert not result.seeds
    assert result.unclear == (("left", tuple(things)),)


def test_one_that_is_far_ahead_is_taken():
    things = [thing(ORANGE, 0.6, x=1), thing(ORANGE, 0.29, x=2)]
    result = found(things, settings(left="orange"))
    assert taken(result) == {"left": (1, 0)}
    assert not result.unclear


def test_two_markers_of_one_colour_are_asked_even_if_there_is_one_thing():
    one = thing(ORANGE)
    result = found([one], settings(left="orange", right="orange"))
    assert not result.seeds
    assert result.unclear == (("left", (one,)), ("right", (one,)))
    two = [thing(ORANGE, 0.6, x=1), thing(ORANGE, 0.5, x=2)]
    assert [name for name, _ in found(two, settings(left="orange", right="orange")).unclear] == ["left", "right"]


def test_one_that_can_only_be_one_thing_leaves_another_with_the_rest():
    between = thing(9.0, 0.6, x=1)  # red or orange
    result = found([between, thing(ORANGE, 0.6, x=2)], settings(a="orange", b="red"))
    assert taken(result) == {"b": (1, 0), "a": (2, 0)}


def test_a_marker_without_a_colour_gets_what_those_with_one_leave():
    result = found([thing(ORANGE, x=1), thing(GREEN, x=2)], settings(any=None, left="green"))
    assert taken(result) == {"left": (2, 0), "any": (1, 0)}
    assert not result.unclear
    several = found([thing(ORANGE, x=1), thing(GREEN, x=2), thing(BLUE, x=3)], settings(any=None, left="green"))
    assert [name for name, _ in several.unclear] == ["any"]
    assert taken(several) == {"left": (2, 0)}


def test_the_one_thing_of_a_colour_is_the_marker_that_says_so():
    result = found([thing(GREEN)], settings(any=None, left="green"))
    assert taken(result) == {"left": (100, 0)}
    assert not result.unclear
    assert result.missing[0].startswith("any was not found")


def test_a_marker_that_is_not_there_is_said_and_not_made_up():
    result = found([thing(ORANGE, x=1)], settings(left="green", right="orange"))
    assert taken(result) == {"right": (1, 0)}
    assert [m.name for m in result.settings.markers] == ["right"]
    (line,) = result.missing
    assert line.startswith(f"left (green) was not found {LOOKED} and is not tracked")
    assert "--seed left@FRAME=X,Y,R" in line
    assert "likeliest" not in line
    hue = found([thing(ORANGE, x=1)], settings(left=(170, 5), right="orange")).missing[0]
    assert "left (hue 170 to 5)" in hue


@pytest.mark.parametrize(("score", "sure"), [(0.19, True), (0.17, False)])
def test_what_has_hardly_a_third_of_the_best_one_s_score_is_not_taken(score, sure):
    result = found([thing(ORANGE, 0.6), thing(GREEN, score, x=7)], settings(left="green", right="orange"))
    assert ("left" in taken(result)) is sure
    assert bool(result.missing) is not sure
    if not sure:
        assert "likeliest, but hardly: MARKER@0=7,50.12,12, green" in result.missing[0]


@pytest.mark.parametrize(
    ("colour", "score", "sure"),
    [("green", 0.11, True), ("green", 0.09, False), (None, 0.21, True), (None, 0.19, False)],
)
def test_the_colour_that_was_asked_for_makes_surer(colour, score, sure):
    weak = thing(GREEN, score)
    if sure:
        assert taken(found([weak], settings(left=colour))) == {"left": (100, 0)}
    else:
        with pytest.raises(UsageError, match=r"nothing that is surely left.* was found in the first 3 s.*likeliest"):
            found([weak], settings(left=colour))


def test_without_markers_things_are_named_after_their_colours():
    things = [thing(ORANGE, 0.9, x=1), thing(GREEN, 0.8, x=2), thing(ORANGE, 0.5, x=3), thing(BLUE, 0.26, x=4)]
    result = found(things, Settings())
    assert taken(result) == {"orange": (1, 0), "green": (2, 0), "orange_2": (3, 0)}
    assert result.settings.markers == ()
    assert result.told[-1].startswith("left alone: blue@0=4")


def test_nothing_at_all_is_an_error_that_says_what_to_do():
    with pytest.raises(UsageError, match=r"a coloured sphere was found in the first 3 s .*--seed MARKER@FRAME=X,Y,R$"):
        found([], Settings())
    with pytest.raises(UsageError, match=r"surely left \(green\), right was found"):
        found([], settings(left="green", right=None))


def test_what_a_person_seeded_is_neither_sought_nor_taken_for_another():
    things = [thing(ORANGE, x=1), thing(ORANGE, x=200)]
    seed = Seed("left", 0, Circle(3, 50, 12))
    result = found(things, settings(left="orange", right="orange"), [seed, Hidden("left", 5, 9)])
    assert taken(result) == {"right": (200, 0)}
    assert [m.name for m in result.settings.markers] == ["left", "right"]
    nothing = found([], settings(left="orange", right="green"), [seed])
    assert not nothing.seeds
    assert len(nothing.missing) == 1
