"""The time line: what is said of each marker on each frame, and what is laid over it."""

from collections.abc import Callable
from pathlib import Path

import pytest

from spheremcap.core.circle import Circle
from spheremcap.io.course import STATUSES, Course, courses_of
from spheremcap.io.mcap_records import McapRecords
from spheremcap.operator.lanes import HiddenLayer, Lane, Lanes, State

SEEN = State("VERIFIED", Circle(1.0, 2.0, 3.0), 1.5, 5.0, ())
LOST = State("LOST", None, None, 0.25, ("votes", "colour"))
TOPICS = {"wrist": "/markers/wrist/state", "elbow": "/markers/elbow/state"}


class Layer:
    """A state on some frames."""

    def __init__(self, state: State, *frames: int) -> None:
        self._state, self._frames = state, frames
        self.course = Course()
        for frame in frames:
            self.course.add(frame, state.status)

    def state(self, frame_index: int) -> State | None:
        return self._state if frame_index in self._frames else None


class Nothing:
    """A recording that says nothing."""

    def between(self, first: int, last: int) -> dict[int, object]:
        return {}


def lane() -> Lane:
    """Verified on 11 to 13, lost on 14 and 15."""
    recorded = Course()
    for frame in range(11, 16):
        recorded.add(frame, "VERIFIED" if frame < 14 else "LOST")
    return Lane(recorded, Nothing())


def names(made: Lane) -> list[str]:
    return [status[:1] or "-" for status in statuses(made.course, range(10, 17))]


def statuses(course: Course, frames: range) -> list[str]:
    return [STATUSES[course.number_at(frame)] for frame in frames]


def test_layers_lie_over_each_other_and_come_off_in_any_order() -> None:
    made = lane()
    assert "".join(names(made)) == "-VVVLL-"
    made.lay("a", Layer(SEEN, 13, 14, 15))
    made.lay("b", Layer(LOST, 12, 13))
    assert "".join(names(made)) == "-VLLVV-"
    made.remove("a")
    assert "".join(names(made)) == "-VLLLL-"
    made.remove("b")
    assert "".join(names(made)) == "-VVVLL-"
    made.lay("a", Layer(LOST, 12))
    made.lay("a", Layer(LOST, 13))
    assert "".join(names(made)) == "-VVLLL-"
    made.remove("a")
    made.remove("a")
    assert "".join(names(made)) == "-VVVLL-"


def test_under_the_topmost_layer_stands_the_one_before_it() -> None:
    made = lane()
    for by, votes in (("a", 1.0), ("b", 2.0), ("c", 3.0)):
        made.lay(by, Layer(State("VERIFIED", None, None, votes, ()), 12))
    made.remove("c")
    assert [state and state.vote_sum for state in made.states(11, 13)] == [None, 2.0, None]
    made.remove("a")
    assert made.states(12, 12)[0].vote_sum == 2.0


def test_what_is_hidden_says_so_from_its_first_to_its_last_frame() -> None:
    hidden = HiddenLayer(5, 7)
    assert [state and state.reasons for state in map(hidden.state, range(4, 9))] == [
        None, ("hidden",), ("hidden",), ("hidden",), None,
    ]  # fmt: skip
    assert statuses(hidden.course, range(4, 9)) == ["", *["OUT_OF_VIEW"] * 3, ""]


@pytest.fixture
def lanes_of(recording: Path):
    """The lanes of the tracked film, by what it says of itself, or by reading it."""
    with McapRecords(recording) as records:
        (run,) = (r.name for r in records.metadata if r.name.startswith("spheremcap/run/"))
        courses = courses_of(records, run.removeprefix("spheremcap/run/"))
        assert courses is not None
        yield lambda told: Lanes(records, TOPICS, courses if told else None, 0, 129)


def test_the_course_that_a_recording_says_is_the_one_that_its_messages_have(lanes_of: Callable[[bool], Lanes]) -> None:
    told, read = lanes_of(True), lanes_of(False)
    assert (told.known_to, read.known_to) == (130, 0)
    news: list[int] = []
    read.read(lambda: False, lambda: news.append(1))
    assert (read.known_to, bool(news)) == (130, True)
    assert read.courses() == told.courses()
    runs = statuses(told.by_marker["wrist"].course, range(130))
    assert (runs[:2], runs[40]) == (["SEEDED", "VERIFIED"], "ESTIMATED")
    assert statuses(told.by_marker["elbow"].course, range(110, 111)) == ["VERIFIED"]
    told.read(lambda: pytest.fail("it is known already"), lambda: None)


def test_reading_can_be_stopped(lanes_of: Callable[[bool], Lanes]) -> None:
    fresh = lanes_of(False)
    fresh.read(lambda: True, lambda: None)
    assert fresh.known_to == 0


def test_states_are_read_where_they_are_asked_for(lanes_of: Callable[[bool], Lanes]) -> None:
    wrist = lanes_of(True).by_marker["wrist"]
    circles = [state.circle for state in wrist.states(19, 21)]
    assert [circle.x_px for circle in circles] == pytest.approx([60 + 0.7 * frame for frame in (19, 20, 21)], abs=0.5)
    assert wrist.states(128, 133)[2:] == [None] * 4
