"""What a person's answers change of a track: for each circle a stretch of frames, followed from it both ways in time.

The track without the answers, the base, stays as it is and is only looked at: where its markers were on a frame. A
stretch is a session of one marker, begun at the circle as if nothing else were known: its chain and its optics have no
past. Forwards it goes on until it meets the base, the marker's next circle or the end. Backwards the same kind of
session sees the frames in falling order, a film run in reverse: times are mirrored at the circle, so they still rise;
velocities and the shutter's readout change their sign. It ends where it meets the track, at the marker's circle before,
where a person says that the marker is hidden, and where it is lost: what is on the other side of that is another story.
So is what it finds where it did not expect it, unless it meets the track there.

Inside a stretch all estimates are its own, for one chain's estimates belong together. What a stretch says depends on
base, frames, settings and answers alone, so tracking with all answers at once and answering one after another end in
the same.
"""

import pickle
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from tempfile import SpooledTemporaryFile

from spheremcap.chain import ChainConfig
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, OperatorRequest
from spheremcap.core.frame import Frame
from spheremcap.core.marker import Answer, Hidden, MarkerSpec, Seed
from spheremcap.session import Others, Session, SessionConfig

BACKWARDS = "backwards"
"""The reason of an estimate that was made from an answer backwards in time."""
_MEETS_DICE = 0.8  # overlap from which two measured circles are one and the same
_MEETS_FRAMES = 5  # frames in a row on which they have to be
_ELSEWHERE = "acquire"  # who proposes what was not found where it was expected
_ASTRAY = 1 / 3  # overlap of a person's circle with another marker's from which that one is believed to be astray
_IN_MEMORY_BYTES = 1 << 20

Base = Callable[[int], Mapping[str, MarkerEstimate]]
"""What was found without the answers on a frame, by marker; empty for a frame that never came."""
FrameAt = Callable[[int], Frame | None]
"""The frame of that index; None where it cannot be decoded."""
KeepView = Callable[[MarkerEstimate], bool]


@dataclass(frozen=True)
class Terms:
    """How a recording was tracked, and its frames' range: all that a stretch needs besides base and frames.

    `keep_view` makes what says for which estimates the stages' pictures are kept, anew for each run over frames.
    """

    camera: Camera
    metric: bool
    markers: tuple[MarkerSpec, ...]
    chain: ChainConfig
    session: SessionConfig
    exposure_s: float
    readout_s: float | None
    first_index: int
    last_index: int
    keep_view: Callable[[], KeepView] = lambda: lambda estimate: False


class Stretch:
    """What one circle of a person changes: results of its marker by frame, and what ended it on either side.

    Results wait on disk, however many they are. `before` and `after` are for people: "meets the track on frame 80".
    """

    def __init__(self, answer: Seed) -> None:
        self.answer = answer
        self.before = self.after = ""
        self._file = SpooledTemporaryFile(max_size=_IN_MEMORY_BYTES)  # noqa: SIM115 (goes with this object)
        self._places: dict[int, int] = {}
        self._sorted: list[int] | None = None
        self._requests: list[OperatorRequest] = []
        self._latest: FrameResult | None = None

    @property
    def marker(self) -> str:
        return self.answer.marker

    @property
    def frames(self) -> Sequence[int]:
        """The indices of its frames, rising."""
        if self._sorted is None:
            self._sorted = sorted(self._places)
        return self._sorted

    def __contains__(self, frame_index: int) -> bool:
        return frame_index in self._places

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, frame_index: int) -> FrameResult:
        if self._latest is None or self._latest.frame_index != frame_index:
            self._file.seek(self._places[frame_index])
            self._latest = pickle.load(self._file)
        assert self._latest is not None
        return self._latest

    def __iter__(self) -> Iterator[FrameResult]:
        """Its results by rising frame."""
        return map(self.__getitem__, self.frames)

    def estimate(self, frame_index: int) -> MarkerEstimate:
        """Its marker on one of its frames."""
        return self[frame_index].estimates[0]

    @property
    def requests(self) -> list[OperatorRequest]:
        """Those that were raised on its frames."""
        return [request for request in self._requests if request.raised_at_frame_index in self]

    def add(self, result: FrameResult) -> None:
        """Take in the result of one more frame."""
        self._file.seek(0, 2)
        self._places[result.frame_index] = self._file.tell()
        pickle.dump(result, self._file, pickle.HIGHEST_PROTOCOL)
        self._requests += result.requests
        self._sorted = None

    def leave(self, frames: Iterable[int]) -> None:
        """Give these frames back to the base."""
        for index in frames:
            self._places.pop(index, None)
        self._sorted = None


@dataclass(frozen=True)
class Corrected:
    """One marker after all answers: on each frame the answer that is hidden, the stretch, or the base where that is
    None. A stretch goes before an earlier one where both are, and hidden before all."""

    marker: str
    hidden: tuple[Hidden, ...]
    stretches: tuple[Stretch, ...]

    def at(self, frame_index: int) -> Hidden | Stretch | None:
        """What stands for the base on this frame."""
        for hidden in self.hidden:
            if frame_index in hidden:
                return hidden
        return self.stretch_at(frame_index)

    def stretch_at(self, frame_index: int) -> Stretch | None:
        """The stretch of this frame, hidden or not."""
        return next((stretch for stretch in reversed(self.stretches) if frame_index in stretch), None)


def base_seeds(answers: Sequence[Answer]) -> list[Seed]:
    """The first circle of each marker, in the order in which they were given: where its base begins."""
    first: dict[str, Seed] = {}
    for answer in answers:
        if isinstance(answer, Seed):
            first.setdefault(answer.marker, answer)
    return list(first.values())


def correct(
    marker: str,
    answers: Sequence[Answer],
    terms: Terms,
    base: Base,
    frame_at: FrameAt,
    go_on: Callable[[], bool] = lambda: True,
    only: Seed | None = None,
) -> Corrected:
    """Follow the marker from each of its circles but the first, or from `only` that one; `go_on` is asked before each
    frame.

    Where it says no, the stretches end there and nothing of them may be used.
    """
    own = [answer for answer in answers if answer.marker == marker]
    seeds = [answer for answer in own if isinstance(answer, Seed)]
    hidden = tuple(answer for answer in own if isinstance(answer, Hidden))
    later = sorted(seeds[1:], key=lambda seed: seed.frame_index)
    corrected = Corrected(marker, hidden, tuple(map(Stretch, later)))
    way = _Way(marker, sorted(seed.frame_index for seed in seeds), corrected, terms, base, frame_at, go_on)
    for k, stretch in enumerate(corrected.stretches):
        if only is None or only in [behind.answer for behind in corrected.stretches[k : k + 2]]:
            way.forwards(stretch)
    for stretch in corrected.stretches:
        if only is None or stretch.answer == only:
            way.backwards(stretch)
    return corrected


class _Way:
    """Follows one marker from its circles, each way."""

    def __init__(
        self,
        marker: str,
        borders: Sequence[int],
        corrected: Corrected,
        terms: Terms,
        base: Base,
        frame_at: FrameAt,
        go_on: Callable[[], bool],
    ) -> None:
        self._spec = next(spec for spec in terms.markers if spec.name == marker)
        self._borders, self._corrected, self._terms = borders, corrected, terms
        self._base, self._frame_at, self._go_on = base, frame_at, go_on

    def forwards(self, stretch: Stretch) -> None:
        """From the circle on; where the marker is hidden nobody looks, and it is looked for again behind that."""
        start, terms = stretch.answer.frame_index, self._terms
        k = bisect_right(self._borders, start)
        last = self._borders[k] - 1 if k < len(self._borders) else terms.last_index
        meeting = Meeting(lambda index: self._base(index).get(self._spec.name))
        session = begun(stretch.answer, self._corrected.hidden, terms, self._base, terms.readout_s)
        stretch.after = f"the next circle, on frame {last + 1}" if k < len(self._borders) else "the last frame"

        def frames() -> Iterator[Frame]:
            for index in range(start, last + 1):
                if index != start and not self._go_on():
                    return
                frame = self._frame_at(index)
                if frame is None:
                    continue
                yield copy(frame)
                assert session.latest is not None
                if index > start and meeting.met(session.latest.estimates[0]):
                    stretch.after = f"meets the track on frame {meeting.first}"
                    return

        for result in session.run(frames()) if self._frame_at(start) is not None else ():
            stretch.add(replace(result, estimates=(_resting_on(stretch.answer, result.estimates[0]),)))
        if meeting.agreed:
            stretch.leave(meeting.frames)

    def backwards(self, stretch: Stretch) -> None:
        """From the circle back, as far as the marker is measured; or, if it is not lost before, to where it is hidden:
        the base, which the circle contradicts, is not believed on the few frames between."""
        start, terms = stretch.answer.frame_index, self._terms
        k = bisect_left(self._borders, start)
        last = self._borders[k - 1] if k else terms.first_index - 1
        at = self._frame_at(start)
        if at is None:
            stretch.before = stretch.after = f"frame {start} cannot be decoded"
            return
        twice_ns = 2 * at.stamp_ns
        meeting = Meeting(self._track)
        readout_s = None if terms.readout_s is None else -terms.readout_s
        session = begun(stretch.answer, (), terms, self._base, readout_s)
        stretch.before, reached = f"the circle before, on frame {last}" if k else "the first frame", False

        def frames() -> Iterator[Frame]:
            nonlocal reached
            for index in range(start, last, -1):
                if any(index in hidden for hidden in self._corrected.hidden):
                    stretch.before, reached = f"hidden on frame {index}", index < start
                    return
                if index != start and not self._go_on():
                    return
                frame = self._frame_at(index)
                if frame is None:
                    continue
                mirrored = copy(frame)
                mirrored.stamp_ns = twice_ns - frame.stamp_ns
                yield mirrored
                assert session.latest is not None
                estimate = session.latest.estimates[0]
                if index < start and meeting.met(estimate):
                    stretch.before = f"meets the track on frame {meeting.first}"
                    return
                if not estimate.status.tracked:
                    stretch.before = f"lost on frame {index}"
                    return

        believed, astray, found = start, False, list[int]()
        for result in session.run(frames()):
            if result.frame_index < start:
                stretch.add(_in_reverse(result, stretch.answer, twice_ns))
                found.append(result.frame_index)
                measured, proposer = result.estimates[0].status.measured, result.estimates[0].proposer
                astray = astray or (measured and proposer == _ELSEWHERE)
                believed = result.frame_index if measured and not astray else believed
        if meeting.agreed:
            stretch.leave(meeting.frames)
        elif not reached or astray:
            stretch.leave([index for index in found if index < believed])

    def _track(self, frame_index: int) -> MarkerEstimate | None:
        """The marker on a frame after all forward stretches."""
        stretch = self._corrected.stretch_at(frame_index)
        if stretch is not None:
            return stretch.estimate(frame_index)
        return self._base(frame_index).get(self._spec.name)


def begun(answer: Seed, hidden: Sequence[Hidden], terms: Terms, base: Base, readout_s: float | None) -> Session:
    """The session that follows a marker from a person's circle."""
    spec = next(spec for spec in terms.markers if spec.name == answer.marker)
    return Session(
        terms.camera, [spec], [answer, *hidden], terms.chain, terms.session, exposure_s=terms.exposure_s,
        metric=terms.metric, readout_s=readout_s, keep_view=terms.keep_view(), threads=1,
        others=_others(answer, terms, base),
    )  # fmt: skip


def _others(answer: Seed, terms: Terms, base: Base) -> Others:
    """The other markers' places in the base. Of one that sits where a person says that this marker is, nothing is
    believed."""
    there = base(answer.frame_index)
    astray = {name for name, other in there.items() if other.circle and other.circle.dice(answer.circle) > _ASTRAY}
    astray.add(answer.marker)

    def others(frame_index: int, range_m: float) -> list[Circle]:
        found = (other for name, other in base(frame_index).items() if name not in astray)
        return [e.circle for e in found if e.circle and e.status.measured and _range_m(e, terms) < range_m]

    return others


def _range_m(estimate: MarkerEstimate, terms: Terms) -> float:
    """How far away a measured marker is, as its chain has it; by its size where no metres were given out."""
    if estimate.xyz_cam_m is not None:
        return float((estimate.xyz_cam_m @ estimate.xyz_cam_m) ** 0.5)
    assert estimate.circle is not None
    radius_m = next(spec.radius_m for spec in terms.markers if spec.name == estimate.marker)
    return terms.camera.fx_px * radius_m / estimate.circle.r_px


class Meeting:
    """Whether a stretch has met a track: both measured at one place, some frames in a row."""

    def __init__(self, track: Callable[[int], MarkerEstimate | None]) -> None:
        self._track = track
        self.frames: list[int] = []
        """On which they agree since they last did not."""

    @property
    def agreed(self) -> bool:
        return len(self.frames) >= _MEETS_FRAMES

    @property
    def first(self) -> int:
        """The first frame on which they agree."""
        return self.frames[0]

    def met(self, estimate: MarkerEstimate) -> bool:
        """Take note of one more frame of the stretch."""
        there = self._track(estimate.frame_index)
        if there is not None and _agree(estimate, there):
            self.frames.append(estimate.frame_index)
        else:
            self.frames.clear()
        return self.agreed


def _agree(one: MarkerEstimate, other: MarkerEstimate) -> bool:
    if one.circle is None or other.circle is None or not (one.status.measured and other.status.measured):
        return False
    return one.circle.dice(other.circle) >= _MEETS_DICE


def _resting_on(answer: Seed, estimate: MarkerEstimate) -> MarkerEstimate:
    """The estimate with the answer that it rests on, which is the one by which it is hidden where it is."""
    return estimate if estimate.answer_frame is not None else replace(estimate, answer_frame=answer.frame_index)


def _in_reverse(result: FrameResult, answer: Seed, twice_ns: int) -> FrameResult:
    """A result of the mirrored film on the recording's own time line; `twice_ns` is twice the time of the mirror."""
    stamp_ns = twice_ns - result.stamp_ns
    estimate = result.estimates[0]
    velocity = estimate.velocity_cam_mps
    estimate = replace(
        _resting_on(answer, estimate), stamp_ns=stamp_ns, reasons=(*estimate.reasons, BACKWARDS),
        velocity_cam_mps=None if velocity is None else -velocity,
    )  # fmt: skip
    smoothed = tuple(
        replace(pose, stamp_ns=stamp_ns, velocity_cam_mps=-pose.velocity_cam_mps) for pose in result.smoothed
    )
    return replace(result, stamp_ns=stamp_ns, estimates=(estimate,), smoothed=smoothed, requests=())
