"""The time line: what a recording says of each marker on each frame, read in the background while the page is open."""

import itertools
import math
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import StateRow, iter_states

CODES = ("", *(status.value for status in Status))
"""Status by its number in a lane; 0 is a frame on which nothing is said."""
_CODE = {name: number for number, name in enumerate(CODES)}
_MEASURED = (_CODE["SEEDED"], _CODE["VERIFIED"])
_ROWS_AT_ONCE = 512


@dataclass(frozen=True, slots=True)
class State:
    """One marker on one frame. `circle` and `distance_m` are None where the recording has none."""

    status: str
    circle: Circle | None
    distance_m: float | None
    vote_sum: float | None
    reasons: tuple[str, ...]


@dataclass
class Lane:
    """One marker on the frames `first` ... `first` + N - 1: arrays of (N,), circles (N, 3) in pixels, NaN for none."""

    first: int
    status: npt.NDArray[np.uint8]
    circle_px: npt.NDArray[np.float32]
    distance_m: npt.NDArray[np.float32]
    vote_sum: npt.NDArray[np.float32]
    reasons: npt.NDArray[np.uint16]
    _sets: list[tuple[str, ...]] = field(default_factory=lambda: [()])
    _numbers: dict[tuple[str, ...], int] = field(default_factory=lambda: {(): 0})

    @classmethod
    def empty(cls, first: int, count: int) -> "Lane":
        """Nothing is said on any of `count` frames."""
        return cls(
            first,
            np.zeros(count, np.uint8),
            np.full((count, 3), np.nan, np.float32),
            np.full(count, np.nan, np.float32),
            np.full(count, np.nan, np.float32),
            np.zeros(count, np.uint16),
        )

    def __len__(self) -> int:
        return len(self.status)

    def holds(self, frame_index: int) -> bool:
        """Whether the frame is one of the lane's."""
        return 0 <= frame_index - self.first < len(self)

    def put(self, frame_index: int, state: State | None) -> None:
        """Set what is said on a frame of the lane's; None for nothing."""
        at = frame_index - self.first
        if state is None:
            self.status[at] = 0
            return
        self.circle_px[at] = state.circle if state.circle is not None else math.nan
        self.distance_m[at] = math.nan if state.distance_m is None else state.distance_m
        self.vote_sum[at] = math.nan if state.vote_sum is None else state.vote_sum
        if state.reasons not in self._numbers and len(self._sets) < 1 << 16:
            self._numbers[state.reasons] = len(self._sets)
            self._sets.append(state.reasons)
        self.reasons[at] = self._numbers.get(state.reasons, 0)
        self.status[at] = _CODE.get(state.status, 0)

    def state(self, frame_index: int) -> State | None:
        """What is said on a frame; None where nothing is."""
        if not self.holds(frame_index) or not self.status[at := frame_index - self.first]:
            return None
        x, y, r = map(float, self.circle_px[at])
        return State(
            CODES[self.status[at]],
            None if math.isnan(r) else Circle(x, y, r),
            _number(self.distance_m[at]),
            _number(self.vote_sum[at]),
            self._sets[self.reasons[at]],
        )

    def runs(self) -> list[tuple[int, int]]:
        """(first frame, status code) of each run of one status."""
        if not len(self):
            return []
        starts = np.flatnonzero(np.diff(self.status)) + 1
        return [(self.first + int(at), int(self.status[at])) for at in (0, *starts)]

    def measured_before(self, frame_index: int) -> int | None:
        """The last frame before that one on which the marker was measured."""
        found = np.flatnonzero(np.isin(self.status[: max(0, frame_index - self.first)], _MEASURED))
        return self.first + int(found[-1]) if len(found) else None

    def measured_from(self, frame_index: int) -> int | None:
        """The first frame from that one on on which the marker was measured."""
        start = max(0, frame_index - self.first)
        found = np.flatnonzero(np.isin(self.status[start:], _MEASURED))
        return self.first + start + int(found[0]) if len(found) else None


class Lanes:
    """The lanes of all markers of a recording. `read` fills them; everything else may be asked meanwhile.

    A correction lies over what the recording says, a later one over an earlier, until it is taken away.
    """

    def __init__(self, markers: Sequence[str], first: int, count: int) -> None:
        self.by_marker = {marker: Lane.empty(first, count) for marker in markers}
        self.known_to = first
        """Frames below are known."""
        self.revision = 0
        self._recorded: dict[str, dict[int, State]] = {marker: {} for marker in markers}  # under corrections
        self._over: dict[str, dict[Hashable, dict[int, State]]] = {marker: {} for marker in markers}
        self._changing = threading.Lock()

    def read(
        self, path: Path, name_of: Callable[[str], str], stop: Callable[[], bool], news: Callable[[], None]
    ) -> None:
        """Read a recording's states from the start to the end, or until `stop`; `name_of` is the lane of a track.

        `news` is called whenever there are more.
        """
        with McapRecords(path) as records:
            rows = iter_states(records)
            while not stop() and (batch := list(itertools.islice(rows, _ROWS_AT_ONCE))):
                with self._changing:
                    for row in batch:
                        self._take(name_of(row.marker), row.frame_index, state_of_row(row))
                    self.known_to = max(self.known_to, batch[-1].frame_index + 1)
                    self.revision += 1
                news()

    def correct(self, marker: str, by: Hashable, states: Mapping[int, State]) -> None:
        """Let `states`, by frame, stand over what is there, until `by` is taken away."""
        with self._changing:
            lane, over = self.by_marker[marker], self._over[marker]
            self._remove(marker, by)
            for frame_index, state in states.items():
                if lane.holds(frame_index):
                    if not any(frame_index in layer for layer in over.values()):
                        recorded = lane.state(frame_index)
                        if recorded is not None:
                            self._recorded[marker][frame_index] = recorded
                    lane.put(frame_index, state)
            over[by] = dict(states)
            self.revision += 1

    def remove(self, marker: str, by: Hashable) -> None:
        """Take away a correction, if there is one: what is under it stands again."""
        with self._changing:
            self._remove(marker, by)
            self.revision += 1

    def _remove(self, marker: str, by: Hashable) -> None:
        lane, over = self.by_marker[marker], self._over[marker]
        for frame_index in over.pop(by, {}):
            if lane.holds(frame_index):
                under = [layer[frame_index] for layer in over.values() if frame_index in layer]
                lane.put(frame_index, under[-1] if under else self._recorded[marker].pop(frame_index, None))

    def _take(self, marker: str, frame_index: int, state: State) -> None:
        lane = self.by_marker.get(marker)
        if lane is None or not lane.holds(frame_index):
            return
        if any(frame_index in layer for layer in self._over[marker].values()):
            self._recorded[marker][frame_index] = state
        else:
            lane.put(frame_index, state)


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
