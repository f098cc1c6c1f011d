"""The course of a marker, and what the recording says of it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.io.course import STATUSES, Course

FRAMES = range(0, 30)
TOLD = st.dictionaries(st.sampled_from(FRAMES), st.sampled_from(STATUSES[1:]), max_size=30)
MEASURED = ("SEEDED", "VERIFIED")


def course_of(told: dict[int, str]) -> Course:
    course = Course()
    for frame in sorted(told):
        course.add(frame, told[frame])
    return course


def read(course: Course) -> dict[int, str]:
    return {frame: STATUSES[number] for frame in range(-2, 40) if (number := course.number_at(frame))}


@given(TOLD)
def test_a_course_says_what_was_put_in_and_comes_back_from_its_text(told: dict[int, str]) -> None:
    course = course_of(told)
    assert read(course) == told
    assert bool(course) == bool(told)
    again = Course.from_text(course.text())
    assert again == course
    assert read(again) == told


@given(TOLD, TOLD)
def test_what_lies_over_it_stands_where_it_says_something(under: dict[int, str], over: dict[int, str]) -> None:
    assert read(course_of(under).under(course_of(over))) == under | over


@given(TOLD, st.integers(-1, 31), st.integers(-1, 31))
def test_measured_frames_around_a_place(told: dict[int, str], first: int, last: int) -> None:
    course, measured = course_of(told), sorted(frame for frame, status in told.items() if status in MEASURED)
    assert course.measured_before(first) == max((f for f in measured if f < first), default=None)
    assert course.measured_from(first) == min((f for f in measured if f >= first), default=None)
    assert course.measured_on(first, last) == sum(first <= f <= last for f in measured)


def test_an_hour_is_a_few_words() -> None:
    course = Course.of(0, 0, "SEEDED")
    for frame in range(1, 864_000):
        course.add(frame, "VERIFIED" if frame < 700_000 else "LOST")
    course.add(700_000, "VERIFIED")  # not behind all that there are
    assert course.text() == "0:SEEDED 1:VERIFIED 700000:LOST 864000:"
    assert course.runs() == [(0, 1), (1, 2), (700_000, 4), (864_000, 0)]


@pytest.mark.parametrize("text", ["0:SEEN 5:", "0:LOST", "4:LOST 3:", "x:LOST 3:", "0", "0:LOST 0:"])
def test_what_is_no_course_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"course|invalid literal"):
        Course.from_text(text)
