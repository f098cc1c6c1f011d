"""The time line: what a recording says of each marker, and what is laid over it before it is written.

The course of a marker, its status from frame to frame, is known for the whole recording. What else is said of a frame
is read from the recording when that frame is looked at.
"""

import itertools
import math
import threading
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.io.course import Course
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import StateRow, iter_states, track_name
from spheremcap.io.states import MarkerStates
from spheremcap.stretch import Stretch

_ROWS_AT_ONCE = 4096


@dataclass(frozen=True, slots=True)
class State:
    """One marker on one frame. `circle` and `distance_m` are None where the recording has none."""

    status: str
    circle: Circle | None
    distance_m: float | None
    vote_sum: float | None
    reasons: tuple[str, ...]


class Layer(Protocol):
    """What is said of a marker on some frames instead of what is below."""

    @property
    def course(self) -> Course: ...

    def state(self, frame_index: int) -> State | None:
        """None on a frame of which it says nothing."""


class HiddenLayer:
    """A person said that the marker is not to be seen from `first` to `last`."""

    def __init__(self, first: int, last: int) -> None:
        self._state = State(Status.OUT_OF_VIEW.value, None, None, None, ("hidden",))
        self.course = Course.of(first, last, self._state.status)

    def state(self, frame_index: int) -> State | None:
        return self._state if self.course.number_at(frame_index) else None


class StretchLayer:
    """A stretch that was tracked again; its states are read from where it keeps them."""

    def __init__(self, stretch: Stretch) -> None:
        self.stretch = stretch
        self._reading = threading.Lock()
        self.course = Course()
        for frame_index in stretch.frames:
            self.course.add(frame_index, stretch.estimate(frame_index).status.value)

    def state(self, frame_index: int) -> State | None:
        with self._reading:
            return state_of(self.stretch.estimate(frame_index)) if frame_index in self.stretch else None


class Lane:
    """One marker's part of the time line: `recorded`, and the layers over it, a later one over an earlier."""

    def __init__(self, recorded: Course, states: MarkerStates) -> None:
        self.recorded = recorded
        self._states = states
        self._layers: dict[Hashable, Layer] = {}

    def lay(self, by: Hashable, layer: Layer) -> None:
        """Put a layer over what is there, until `by` is taken away."""
        self._layers = {known: one for known, one in self._layers.items() if known != by} | {by: layer}

    def remove(self, by: Hashable) -> None:
        """Take away a layer, if there is one: what is under it stands again."""
        self._layers = {known: one for known, one in self._layers.items() if known != by}

    @property
    def course(self) -> Course:
        """As it stands."""
        course = self.recorded
        for layer in self._layers.values():
            course = course.under(layer.course)
        return course

    def states(self, first: int, last: int) -> list[State | None]:
        """What is said on the frames from `first` to `last`; None for nothing."""
        layers = list(reversed(self._layers.values()))
        recorded = self._states.between(first, last)
        found = []
        for frame_index in range(first, last + 1):
            over = next((state for layer in layers if (state := layer.state(frame_index)) is not None), None)
            row = recorded.get(frame_index)
            found.append(over if over is not None or row is None else state_of_row(row))
        return found


class Lanes:
    """The lanes of all markers of a recording that is open as `records`; `topics` are those of their states, by marker.

    `courses` are those that the recording says of itself; where it does not (None), `read` goes through it for them
    while everything may be asked.
    """

    def __init__(
        self,
        records: McapRecords,
        topics: Mapping[str, str],
        courses: Mapping[str, Course] | None,
        first: int,
        last: int,
    ) -> None:  # fmt: skip
        known = courses or {}
        self.by_marker = {
            marker: Lane(known.get(marker, Course()), MarkerStates(records, topic)) for marker, topic in topics.items()
        }
        self.known_to = first if courses is None else last + 1
        """Frames below are known."""
        self.revision = 0
        self._records, self._last = records, last
        self._topics = frozenset(topics.values())
        self._marker_of = {track_name(topic, marker): marker for marker, topic in topics.items()}
        self._changing = threading.Lock()

    def read(self, stop: Callable[[], bool], news: Callable[[], None]) -> None:
        """Read the courses of a recording that does not say them, from the start to the end, or until `stop`.

        `news` is called whenever there are more.
        """
        if self.known_to > self._last:
            return
        rows = iter_states(self._records, self._topics)
        while not stop() and (batch := list(itertools.islice(rows, _ROWS_AT_ONCE))):
            with self._changing:
                for row in batch:
                    self.by_marker[self._marker_of[row.marker]].recorded.add(row.frame_index, row.status)
                self.known_to = max(self.known_to, batch[-1].frame_index + 1)
                self.revision += 1
            news()
        if not stop():
            self.known_to = self._last + 1
            self.revision += 1
            news()

    def courses(self) -> dict[str, Course]:
        """Each marker's course as it stands."""
        with self._changing:
            return {marker: lane.course for marker, lane in self.by_marker.items()}

    def correct(self, marker: str, by: Hashable, layer: Layer) -> None:
        """Let a layer stand over what is there, until `by` is taken away."""
        with self._changing:
            self.by_marker[marker].lay(by, layer)
            self.revision += 1

    def remove(self, marker: str, by: Hashable) -> None:
        """Take away a correction, if there is one: what is under it stands again."""
        with self._changing:
            self.by_marker[marker].remove(by)
            self.revision += 1


def state_of_row(row: StateRow) -> State:
    """A recording's row."""
    circle, place = row.circle_px, row.xyz_cam_m
    return State(
        row.status,
        None if math.isnan(circle[2]) else Circle(*circle),
        None if math.isnan(place[2]) else math.hypot(*place),
        _number(row.vote_sum),
        tuple(row.reasons.split(";")) if row.reasons else (),
    )


def state_of(estimate: MarkerEstimate) -> State:
    """An estimate as a recording has it."""
    place = estimate.xyz_cam_m
    return State(
        estimate.status.value,
        estimate.circle,
        None if place is None else float(np.linalg.norm(place)),
        estimate.vote_sum,
        estimate.reasons,
    )


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
