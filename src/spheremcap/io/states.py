"""A run's frames by their index: what its markers were on each, read where it is asked for. `MarkerStates` has them as
they stand, `FrameStates` as they were before a person's answers.

Every frame of a run has one message of annotations, and from a marker's first circle on one state of it, to the last
frame: so the n-th state from the end is of the n-th frame from the end, whatever frames were lost before. Where answers
have put other messages in their place, the ones from before are under /replaced, and count.
"""

from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence

from spheremcap.core.estimate import MarkerEstimate
from spheremcap.errors import SourceError
from spheremcap.io import _pb
from spheremcap.io.mcap_records import McapRecords, MessageIndex, RawMessage
from spheremcap.io.recording import UNREADABLE, StateRow, estimate_of, state_row
from spheremcap.io.topics import ANSWERED, REPLACED, Topics

_HELD_FRAMES = 512


def is_answered(metadata: Mapping[str, str]) -> bool:
    """Whether a channel of this metadata holds what rests on a person's answers."""
    return ANSWERED.items() <= metadata.items()


def as_before(raw: RawMessage) -> bytes:
    """The data of a message as they were before any answer. Raises UNREADABLE."""
    if raw.channel.topic.startswith(f"{REPLACED}/"):
        return bytes(_pb.Replaced.FromString(raw.data).data)
    return raw.data


class FrameStates:
    """The frames of a run, numbered 0 ... `count` - 1 in the order of the recording; and its markers on them by index.

    Raises SourceError when the run has no frames.
    """

    def __init__(self, records: McapRecords, topics: Topics, markers: Sequence[str]) -> None:
        self._records = records
        self._frames = self._before(topics.annotations)
        self._states = {name: self._before(topics.state(name)) for name in markers}
        self._held: OrderedDict[int, dict[str, MarkerEstimate]] = OrderedDict()
        self._known = max(self._states.values(), key=len)
        if len(self._frames) == 0 or len(self._known) == 0:
            raise SourceError(f"{records.path}: nothing was tracked on {topics.annotations}: nothing to correct")
        self.count = self._frames.until(self._known.log_time(len(self._known) - 1))  # a last one may be cut off
        self._offset = self.count - len(self._known)  # frames before the first state of any marker
        if self._offset < 0:
            raise SourceError(f"{records.path}: has {self.count} frames and {len(self._known)} states of a marker")
        self._first_known = self._estimate(self._known, 0).frame_index
        self.first_index = max(0, self._first_known - self._offset)
        self.last_index = self.index(self.count - 1)

    def index(self, number: int) -> int:
        """The frame index of the frame with that number."""
        if number < self._offset:
            return self.first_index + number
        return self._estimate(self._known, number - self._offset).frame_index

    def number(self, frame_index: int) -> int | None:
        """The number of the frame with that index; None for one that is not in the recording."""
        guess = frame_index - self.first_index
        if not 0 <= guess < self.count or self.index(guess) != frame_index:  # frames were lost
            guess = bisect_left(range(self.count), frame_index, key=self.index)
        return guess if guess < self.count and self.index(guess) == frame_index else None

    def next_number(self, frame_index: int) -> int:
        """The number of the first frame with that index or a later one; `count` where there is none."""
        return bisect_left(range(self.count), frame_index, key=self.index)

    def log_time(self, number: int) -> int:
        """The log time of a frame's messages, ns."""
        return self._frames.log_time(number)

    def numbers_at(self, log_time: int) -> range:
        """The numbers of the frames with that log time: one, but where times did not rise."""
        return range(self._frames.before(log_time), self._frames.until(log_time))

    def numbers_from(self, log_time: int) -> int:
        """The number of the first frame with that log time or a later one."""
        return self._frames.before(log_time)

    def stamp_ns(self, number: int) -> int:
        """When the frame was taken, ns."""
        return self._frames.message(number).publish_time

    def at(self, frame_index: int) -> Mapping[str, MarkerEstimate]:
        """What was estimated on a frame without any answer, by marker; empty where there is none."""
        if frame_index not in self._held:
            self._held[frame_index] = self._read(frame_index)
            if len(self._held) > _HELD_FRAMES:
                self._held.popitem(last=False)
        return self._held[frame_index]

    def _read(self, frame_index: int) -> dict[str, MarkerEstimate]:
        number = self.number(frame_index)
        if number is None:
            return {}
        found = {}
        for name, states in self._states.items():
            place = number - self.count + len(states)
            if 0 <= place < len(states):
                estimate = self._estimate(states, place)
                if estimate.frame_index == frame_index:
                    found[name] = estimate
        return found

    def _estimate(self, states: MessageIndex, place: int) -> MarkerEstimate:
        raw = states.message(place)
        try:
            return estimate_of(as_before(raw))
        except UNREADABLE as error:
            raise SourceError(
                f"{self._records.path}: a state on {raw.channel.topic} cannot be read: {error}"
            ) from error

    def _before(self, topic: str) -> MessageIndex:
        return self._records.index_of_channels(channels_before(self._records, topic))


class MarkerStates:
    """One marker on a recording's frames as it stands, with all answers. For several threads."""

    def __init__(self, records: McapRecords, topic: str) -> None:
        self._records = records
        self._messages = records.index_of(topic)

    def first(self) -> StateRow | None:
        """The first one that can be read; None where there is none."""
        return next(filter(None, map(self._row, range(len(self._messages)))), None)

    def between(self, first: int, last: int) -> dict[int, StateRow]:
        """By frame index those from `first` to `last`, as far as they can be read."""
        found: dict[int, StateRow] = {}
        for number in range(self._from(first), len(self._messages)):
            row = self._row(number)
            if row is not None and row.frame_index > last:
                break
            if row is not None and row.frame_index >= first:
                found[row.frame_index] = row
        return found

    def _from(self, frame_index: int) -> int:
        """The number of the first message of that frame or a later one."""
        numbers = range(len(self._messages))
        if numbers and (guess := frame_index - self._frame(0)) in numbers and self._frame(guess) == frame_index:
            return guess  # no frame was lost
        return bisect_left(numbers, frame_index, key=self._frame)

    def _frame(self, number: int) -> int:
        """The frame of a message; of one that cannot be read, that of the one before."""
        while number >= 0:
            row = self._row(number)
            if row is not None:
                return row.frame_index
            number -= 1
        return -1

    def _row(self, number: int) -> StateRow | None:
        raw = self._messages.message(number)
        try:
            return state_row(raw.data, raw.log_time)
        except UNREADABLE as error:
            self._records.undecodable(raw.channel.topic, error)
            return None


def channels_before(records: McapRecords, topic: str) -> Iterable[int]:
    """The ids of the channels that hold a topic as it was before any answer."""
    for channel in records.channels.values():
        if channel.topic == f"{REPLACED}{topic}" or (channel.topic == topic and not is_answered(channel.metadata)):
            yield channel.id
