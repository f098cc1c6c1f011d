"""What a lost marker was found as: believed at once, or only when the next frames agree."""

from dataclasses import replace

import pytest

from scenes import BLUE, Cover, ball_at, picture, truth
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.core.look import Look, Measured
from spheremcap.core.optics import AT_REST
from spheremcap.core.vote import Verdict
from spheremcap.detection.colour import ColourConfig, disc_pixels, learn_box
from spheremcap.detection.outline import _NO_EDGES, _NONE
from spheremcap.verification.reacquired import Reacquired

LAST = Circle(100.0, 80.0, 20.0)
EMPTY = BgrFrame(0, 0, picture(noise_seed=1))


def asked(frame=EMPTY, last=LAST):
    """After the marker was last verified on a frame."""
    again = Reacquired()
    again.seen(frame, last)
    return again


def look(circle: Circle | None, votes: float, doubts: tuple[str, ...] = ()) -> Look:
    """One that nothing speaks against but these doubts."""
    claim = circle and Measured(
        circle, (0.1, 0.1, 0.1), None, None, 0.8, "colour", _NO_EDGES, _NONE, _NONE, AT_REST, 1.0, None  # type: ignore[arg-type]
    )  # fmt: skip
    patch = Patch.__new__(Patch)
    return Look(LAST, patch, (), (), None, claim, None, (), votes, Verdict.VERIFIED, doubts)  # type: ignore[arg-type]


def found(again: Reacquired, *looks: Look) -> list[tuple[str, ...]]:
    return [one.doubts for one in again.confirmed(looks)]


@pytest.mark.parametrize(("r_px", "votes"), [(20.0, 4.51), (24.0, 4.51), (16.5, 4.51), (40.0, 4.91)])
def test_one_as_large_as_it_was_or_with_nearly_all_votes_is_believed_at_once(r_px, votes):
    assert found(asked(), look(Circle(300, 80, r_px), votes)) == [()]


@pytest.mark.parametrize(("r_px", "votes"), [(20.0, 4.5), (25.0, 4.9), (16.0, 4.9)])
def test_another_has_to_be_there_on_three_frames_in_a_row(r_px, votes):
    again = asked()
    for shift, doubts in ((0, ("unconfirmed",)), (5, ("unconfirmed",)), (9, ())):
        assert found(again, look(Circle(300 + shift, 80, r_px), votes)) == [doubts]
    assert found(again, look(Circle(309, 80, r_px), votes)) == [("unconfirmed",)]  # lost once more: all begins anew


@pytest.mark.parametrize("between", [look(None, 0.0, ("no outline",)), look(Circle(300, 80, 30), 4.2, ("colour",))])
def test_a_frame_without_it_begins_anew(between):
    again, there = asked(), look(Circle(300, 80, 30), 4.2)
    assert found(again, there) == found(again, there) == [("unconfirmed",)]
    assert found(again, between) == [between.doubts]
    assert found(again, there) == found(again, there) == [("unconfirmed",)]
    assert found(again, there) == [()]


@pytest.mark.parametrize("other", [Circle(300 + 91, 80, 30), Circle(300, 80, 37.0), Circle(300, 80, 24.0)])
def test_one_elsewhere_or_of_another_size_does_not_agree(other):
    again = asked()
    there = look(Circle(300, 80, 30), 4.2)
    found(again, there), found(again, there)
    assert found(again, look(other, 4.2)) == [("unconfirmed",)]


def test_a_look_that_is_doubted_already_keeps_its_own_reasons():
    other = look(Circle(20, 20, 30), 4.9, ("colour",))
    assert found(asked(), other, look(Circle(300, 80, 30), 4.2)) == [("colour",), ("unconfirmed",)]


def test_it_changes_nothing_of_a_look_but_the_doubts():
    one = look(Circle(300, 80, 30), 4.2)
    (after,) = asked().confirmed([one])
    assert replace(after, doubts=()) == one


# -- what stood there before -----------------------------------------------------------------------

BALL, ELSEWHERE = ball_at(230, 150, 22), Circle(80.0, 80.0, 22.0)
CIRCLE = truth(BALL)


def reasons(before, after, last=ELSEWHERE):
    (found,) = asked(BgrFrame(0, 0, before), last).confirmed([after])
    return found.doubts


@pytest.fixture(scope="module")
def limits():
    """A box that holds the ball and nothing else of the scene."""
    frame = BgrFrame(0, 0, picture(BALL))
    return learn_box(disc_pixels(Patch(frame, Window(190, 110, 80, 80)), CIRCLE, 0.8), ColourConfig()).limits()


def there(limits, image, doubts=()):
    """A claim at the ball on a later picture, at half its scale."""
    frame = BgrFrame(5, 5, image)
    patch = Patch.scaled(frame, frame.patch(Window(190, 110, 80, 80))[::2, ::2], 190.0, 110.0, 2.0)
    return replace(look(CIRCLE, 4.9, doubts), patch=patch, limits=limits)


def test_what_stood_there_while_the_marker_was_elsewhere_is_not_it(limits):
    before, now = picture(BALL, noise_seed=1), picture(BALL, noise_seed=2)
    assert reasons(before, there(limits, now)) == ("stood there",)


def test_what_has_come_there_since_may_be_it(limits):
    now = picture(BALL, noise_seed=2)
    half = picture(BALL, covers=(Cover(225, 60, 300, 230),), noise_seed=1)
    assert reasons(picture(noise_seed=1), there(limits, now)) == ()
    assert reasons(picture(ball_at(230, 150, 22, rgb=BLUE), noise_seed=1), there(limits, now)) == ()
    assert reasons(half, there(limits, now)) == ()
    moved = picture(ball_at(240, 144, 22), noise_seed=1)
    assert reasons(moved, there(limits, now)) == ()


def test_background_that_has_not_changed_around_a_part_of_it_does_not_speak_against_it(limits):
    """It comes out from behind a board, which is most of what is seen there, before and after."""
    board = Cover(214, 60, 320, 240, (245, 245, 245))
    before, now = picture(covers=(board,), noise_seed=1), picture(BALL, covers=(board,), noise_seed=2)
    assert reasons(before, there(limits, now)) == ()


def test_a_thing_of_its_colour_without_its_outline_was_not_it(limits):
    """It comes before a wall of its own colour."""
    wall = picture(BALL, covers=(Cover(190, 110, 270, 190, (205, 100, 20)),), noise_seed=1)
    assert reasons(wall, there(limits, picture(BALL, noise_seed=2))) == ()


def test_a_place_that_the_marker_itself_reached_to_is_not_asked_about(limits):
    before, now = picture(BALL, noise_seed=1), picture(BALL, noise_seed=2)
    r_px = CIRCLE.r_px
    near = CIRCLE.shifted(-1.99 * r_px, 0)
    assert reasons(before, there(limits, now), last=near) == ()
    assert reasons(before, there(limits, now), last=CIRCLE.shifted(-2.01 * r_px, 0)) == ("stood there",)


def test_what_is_doubted_already_is_not_asked_where_it_stood(limits):
    before, now = picture(BALL, noise_seed=1), picture(BALL, noise_seed=2)
    assert reasons(before, there(limits, now, doubts=("colour",))) == ("colour",)


def test_where_colour_is_not_asked_nothing_is_said_of_what_stood_there():
    before, now = picture(BALL, noise_seed=1), picture(BALL, noise_seed=2)
    assert reasons(before, there(None, now)) == ()


def test_with_no_looks_nothing_is_confirmed():
    again, there_ = asked(), look(Circle(300, 80, 30), 4.2)
    found(again, there_), found(again, there_)
    assert again.confirmed([]) == []
    assert found(again, there_) == [("unconfirmed",)]
