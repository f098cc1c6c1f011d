"""What a lost marker was found as: believed at once, or only when the next frames agree."""

from dataclasses import replace

import pytest

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.core.look import Look, Measured
from spheremcap.core.optics import AT_REST
from spheremcap.core.vote import Verdict
from spheremcap.detection.outline import _NO_EDGES, _NONE
from spheremcap.verification.reacquired import Reacquired

LAST = Circle(100.0, 80.0, 20.0)


def look(circle: Circle | None, votes: float, doubts: tuple[str, ...] = ()) -> Look:
    """One that nothing speaks against but these doubts."""
    claim = circle and Measured(
        circle, (0.1, 0.1, 0.1), None, None, 0.8, "colour", _NO_EDGES, _NONE, _NONE, AT_REST, 1.0, None  # type: ignore[arg-type]
    )  # fmt: skip
    patch = Patch.__new__(Patch)
    return Look(LAST, patch, (), (), None, claim, None, (), votes, Verdict.VERIFIED, doubts)  # type: ignore[arg-type]


def found(again: Reacquired, *looks: Look) -> list[tuple[str, ...]]:
    return [one.doubts for one in again.confirmed(looks, LAST)]


@pytest.mark.parametrize(("r_px", "votes"), [(20.0, 4.51), (24.0, 4.51), (16.5, 4.51), (40.0, 4.91)])
def test_one_as_large_as_it_was_or_with_nearly_all_votes_is_believed_at_once(r_px, votes):
    assert found(Reacquired(), look(Circle(300, 80, r_px), votes)) == [()]


@pytest.mark.parametrize(("r_px", "votes"), [(20.0, 4.5), (25.0, 4.9), (16.0, 4.9)])
def test_another_has_to_be_there_on_three_frames_in_a_row(r_px, votes):
    again = Reacquired()
    for shift, doubts in ((0, ("unconfirmed",)), (5, ("unconfirmed",)), (9, ())):
        assert found(again, look(Circle(300 + shift, 80, r_px), votes)) == [doubts]
    assert found(again, look(Circle(309, 80, r_px), votes)) == [("unconfirmed",)]  # lost once more: all begins anew


@pytest.mark.parametrize("between", [look(None, 0.0, ("no outline",)), look(Circle(300, 80, 30), 4.2, ("colour",))])
def test_a_frame_without_it_begins_anew(between):
    again, there = Reacquired(), look(Circle(300, 80, 30), 4.2)
    assert found(again, there) == found(again, there) == [("unconfirmed",)]
    assert found(again, between) == [between.doubts]
    assert found(again, there) == found(again, there) == [("unconfirmed",)]
    assert found(again, there) == [()]


@pytest.mark.parametrize("other", [Circle(300 + 91, 80, 30), Circle(300, 80, 37.0), Circle(300, 80, 24.0)])
def test_one_elsewhere_or_of_another_size_does_not_agree(other):
    again = Reacquired()
    there = look(Circle(300, 80, 30), 4.2)
    found(again, there), found(again, there)
    assert found(again, look(other, 4.2)) == [("unconfirmed",)]


def test_a_look_that_is_doubted_already_keeps_its_own_reasons():
    other = look(Circle(20, 20, 30), 4.9, ("colour",))
    assert found(Reacquired(), other, look(Circle(300, 80, 30), 4.2)) == [("colour",), ("unconfirmed",)]


def test_it_changes_nothing_of_a_look_but_the_doubts():
    one = look(Circle(300, 80, 30), 4.2)
    (after,) = Reacquired().confirmed([one], LAST)
    assert replace(after, doubts=()) == one
