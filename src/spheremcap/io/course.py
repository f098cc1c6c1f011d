"""The course of a marker: from which frame on it had which status. A recording says it in its metadata, so that hours
are looked over without one of their messages being read.

A run's course is that of its track without any answer; what answers have made of it is in a record beside it, which
says something of the frames that they changed and of no others.
"""

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Mapping

from spheremcap.core.estimate import Status
from spheremcap.io.mcap_records import McapRecords

COURSE_METADATA = "spheremcap/course/"
ANSWERED_METADATA = "spheremcap/course/answered/"

STATUSES = ("", *(status.value for status in Status))
"""A status by its number in a course; 0 is a frame of which nothing is said."""
_NUMBER = {name: number for number, name in enumerate(STATUSES)}
_MEASURED = tuple(_NUMBER[status.value] for status in Status if status.measured)


class Course:
    """Which status a marker has from which frame on; nothing is said of the frames before the first and behind the
    last."""

    def __init__(self) -> None:
        self._starts, self._numbers = array("q"), array("B")
        self._end = 0

    def __bool__(self) -> bool:
        """Whether something is said of any frame."""
        return bool(self._starts)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Course) and self.runs() == other.runs()

    __hash__ = None  # type: ignore[assignment]  # it grows

    @classmethod
    def of(cls, first: int, last: int, status: str) -> "Course":
        """One status on all frames from `first` to `last`."""
        course = cls()
        course._begin(first, _NUMBER[status])
        course._end = last + 1
        return course

    def add(self, frame_index: int, status: str) -> None:
        """The status on one more frame, behind all that there are (else it changes nothing); of frames between nothing
        is said. An unknown status is none."""
        if self._starts and frame_index < self._end:
            return
        if self._starts and frame_index > self._end:
            self._begin(self._end, 0)
        self._begin(frame_index, _NUMBER.get(status, 0))
        self._end = frame_index + 1

    def _begin(self, frame_index: int, number: int) -> None:
        if self._numbers[-1:] != array("B", [number]):
            self._starts.append(frame_index)
            self._numbers.append(number)

    def runs(self) -> list[tuple[int, int]]:
        """(first frame, number of the status) of each run of one status; where the last one ends, one of nothing."""
        runs = list(zip(self._starts, self._numbers, strict=True))
        return [*runs, (self._end, 0)] if runs and runs[-1][1] else runs

    def number_at(self, frame_index: int) -> int:
        """The number of the status on a frame."""
        run = bisect_right(self._starts, frame_index) - 1
        return self._numbers[run] if run >= 0 and frame_index < self._end else 0

    def measured_before(self, frame_index: int) -> int | None:
        """The last frame before that one on which the marker was measured."""
        for run in range(bisect_left(self._starts, frame_index) - 1, -1, -1):
            if self._numbers[run] in _MEASURED:
                return min(frame_index, self._end_of(run)) - 1
        return None

    def measured_from(self, frame_index: int) -> int | None:
        """The first frame from that one on on which the marker was measured."""
        for run in range(max(0, bisect_right(self._starts, frame_index) - 1), len(self._starts)):
            if self._numbers[run] in _MEASURED and self._end_of(run) > frame_index:
                return max(frame_index, self._starts[run])
        return None

    def measured_on(self, first: int, last: int) -> int:
        """On how many of the frames from `first` to `last` the marker was measured."""
        spans = ((self._starts[run], self._end_of(run)) for run, n in enumerate(self._numbers) if n in _MEASURED)
        return sum(max(0, min(end, last + 1) - max(start, first)) for start, end in spans)

    def under(self, top: "Course") -> "Course":
        """This one with another laid over it, where that says something."""
        both = Course()
        for start in sorted({start for course in (self, top) for start, _ in course.runs()}):
            both._begin(start, top.number_at(start) or self.number_at(start))
        both._end = max(self._end, top._end)
        return both

    def text(self) -> str:
        """As in the metadata: "0:SEEDED 1:VERIFIED 240:"."""
        return " ".join(f"{start}:{STATUSES[number]}" for start, number in self.runs())

    @classmethod
    def from_text(cls, text: str) -> "Course":
        """Raises ValueError for what no course says."""
        course = cls()
        for word in text.split():
            start, colon, status = word.partition(":")
            if not colon or status not in _NUMBER or (course._starts and int(start) <= course._starts[-1]):
                raise ValueError(f"no course: {word}")
            course._begin(int(start), _NUMBER[status])
            course._end = int(start)
        if course._numbers and course._numbers[-1]:
            raise ValueError("a course without an end")
        return course

    def _end_of(self, run: int) -> int:
        return self._starts[run + 1] if run + 1 < len(self._starts) else self._end


def course_lines(courses: Mapping[str, Course]) -> dict[str, str]:
    """The lines of a metadata record, by marker."""
    return {marker: course.text() for marker, course in courses.items() if course}


def courses_of(records: McapRecords, id_: str) -> dict[str, Course] | None:
    """The courses of a run's markers with all answers; None where the recording does not say them (an earlier version
    wrote it, or a run that did not end), or not in a way that can be read."""
    said = {record.name: record.metadata for record in records.metadata}
    if COURSE_METADATA + id_ not in said:
        return None
    try:
        courses = {marker: Course.from_text(text) for marker, text in said[COURSE_METADATA + id_].items()}
        for marker, text in said.get(ANSWERED_METADATA + id_, {}).items():
            courses[marker] = courses.get(marker, Course()).under(Course.from_text(text))
    except ValueError:
        return None
    return courses
