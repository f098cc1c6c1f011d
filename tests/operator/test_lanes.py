"""The time line: what is said of each marker on each frame, and what is said over it."""

from pathlib import Path

from spheremcap.core.circle import Circle
from spheremcap.operator.lanes import CODES, Lanes, State

SEEN = State("VERIFIED", Circle(1.0, 2.0, 3.0), 1.5, 5.0, ())
LOST = State("LOST", None, None, 0.25, ("votes", "colour"))


def lanes() -> Lanes:
    made = Lanes(["wrist"], 10, 8)
    for frame in range(11, 16):
        made._take("wrist", frame, SEEN if frame < 14 else LOST)
    return made


def names(made: Lanes) -> list[str]:
    return [CODES[code] for code in made.by_marker["wrist"].status]


def test_a_state_comes_out_as_it_went_in() -> None:
    lane = lanes().by_marker["wrist"]
    assert lane.state(11) == SEEN
    assert lane.state(14) == LOST
    assert lane.state(10) is None
    assert lane.state(9) is None
    assert lane.state(18) is None


def test_runs_and_the_measured_frames_around_a_place() -> None:
    lane = lanes().by_marker["wrist"]
    assert [(start, CODES[code]) for start, code in lane.runs()] == [
        (10, ""), (11, "VERIFIED"), (14, "LOST"), (16, ""),
    ]  # fmt: skip
    assert (lane.measured_before(14), lane.measured_before(11), lane.measured_before(99)) == (13, None, 13)
    assert (lane.measured_from(10), lane.measured_from(13), lane.measured_from(14)) == (11, 13, None)


def test_corrections_lie_over_each_other_and_come_off_in_any_order() -> None:
    made = lanes()
    was = names(made)
    made.correct("wrist", "a", dict.fromkeys(range(13, 16), SEEN))
    made.correct("wrist", "b", dict.fromkeys(range(12, 14), LOST))
    assert names(made)[2:6] == ["LOST", "LOST", "VERIFIED", "VERIFIED"]
    made.remove("wrist", "a")
    assert names(made)[2:6] == ["LOST", "LOST", "LOST", "LOST"]
    made.remove("wrist", "b")
    assert names(made) == was
    made.correct("wrist", "a", {12: LOST})
    made.correct("wrist", "a", {13: LOST})
    assert names(made)[1:4] == ["VERIFIED", "VERIFIED", "LOST"]
    made.remove("wrist", "a")
    made.remove("wrist", "a")
    assert names(made) == was


def test_under_the_topmost_correction_stands_the_one_before_it() -> None:
    made = lanes()
    for by, votes in (("a", 1.0), ("b", 2.0), ("c", 3.0)):
        made.correct("wrist", by, {12: State("VERIFIED", None, None, votes, ())})
    made.remove("wrist", "c")
    assert made.by_marker["wrist"].state(12).vote_sum == 2.0
    made.remove("wrist", "a")
    assert made.by_marker["wrist"].state(12).vote_sum == 2.0


def test_what_the_recording_says_of_a_corrected_frame_waits_under_it() -> None:
    made = Lanes(["wrist"], 10, 8)
    made.correct("wrist", "a", {12: LOST})
    made._take("wrist", 12, SEEN)
    assert made.by_marker["wrist"].state(12) == LOST
    made.remove("wrist", "a")
    assert made.by_marker["wrist"].state(12) == SEEN


def test_all_of_a_recording_is_read_and_reading_can_be_stopped(recording: Path) -> None:
    made = Lanes(["wrist", "elbow"], 0, 130)
    told: list[int] = []
    made.read(recording, lambda name: name, lambda: False, lambda: told.append(1))
    assert made.known_to == 130
    assert told
    runs = {m: [(start, CODES[code]) for start, code in lane.runs()] for m, lane in made.by_marker.items()}
    assert runs["wrist"][:2] == [(0, "SEEDED"), (1, "VERIFIED")]
    assert (40, "ESTIMATED") in runs["wrist"]
    assert (110, "VERIFIED") in runs["elbow"]
    circle = made.by_marker["wrist"].state(20).circle
    assert circle is not None
    assert abs(circle.x_px - 74) < 1
    fresh = Lanes(["wrist"], 0, 130)
    fresh.read(recording, lambda name: name, lambda: True, lambda: None)
    assert fresh.known_to == 0
