"""A run that a person attends: it pauses at a request, goes back to the answer, and continues from there.

The base goes on as if nobody were there, and beside it, frame by frame, each marker that a person gave a circle of is
followed from there, until it meets the base. Who is lost there is asked for. What is written comes afterwards, from all
answers at once, so an attended run ends in the same recording as one that has its answers beforehand.
"""

from collections import OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Protocol

from spheremcap.core.estimate import FrameResult, MarkerEstimate, OperatorRequest, Status
from spheremcap.core.frame import Frame
from spheremcap.core.marker import Answer, Hidden, Seed
from spheremcap.session import Session
from spheremcap.stretch import FrameAt, Meeting, Terms, begun

_REMEMBERED = 2400  # frames of the base to which an answer may go back and still know of the other markers


@dataclass(frozen=True)
class Asked:
    """What a person is asked, and what is at hand for an answer.

    `estimates` are the marker's last measured one and that on the request's frame, None where there is none.
    `now_index` is the frame that tracking has come to; `frame_at` gives any frame, later ones too, None for one that
    cannot be had. `check` raises UsageError for answers that do not fit.
    """

    request: OperatorRequest
    last_measured: MarkerEstimate | None
    estimate: MarkerEstimate | None
    now_index: int
    frame_at: FrameAt
    check: Callable[[Sequence[Answer]], None] = lambda answers: None


class Operator(Protocol):
    """Whoever puts requests to a person and brings the answers; they are on disk when they are given back."""

    def ask(self, asked: Asked) -> Sequence[Answer]:
        """The answers; none leaves the request open."""


@dataclass
class _Live:
    """A marker that is followed from a person's circle."""

    answer: Seed
    session: Session
    meeting: Meeting
    lost: OperatorRequest | None = None


class Attended:
    """One camera's run that a person attends: call `after` behind every frame of the base."""

    def __init__(
        self, terms: Terms, frame_at: FrameAt, ask: Callable[[Asked], Sequence[Answer]], answers: Sequence[Answer] = ()
    ) -> None:
        """`answers` are those given beforehand, without the markers' first circles."""
        self._terms, self._frame_at, self._ask = terms, frame_at, ask
        self._hidden = [answer for answer in answers if isinstance(answer, Hidden)]
        self._coming = [answer for answer in answers if isinstance(answer, Seed)]
        self._base: OrderedDict[int, Mapping[str, MarkerEstimate]] = OrderedDict()
        self._measured: dict[str, MarkerEstimate] = {}
        self._live: dict[str, _Live] = {}

    def after(self, frame: Frame, base: FrameResult) -> None:
        """Take in what the base says of a frame, and ask where a marker is lost."""
        self._base[frame.index] = {estimate.marker: estimate for estimate in base.estimates}
        if len(self._base) > _REMEMBERED:
            self._base.popitem(last=False)
        for seed in [seed for seed in self._coming if seed.frame_index == frame.index]:
            self._begin(seed)
        asked = deque(request for request in base.requests if request.marker not in self._live)
        for marker, live in list(self._live.items()):
            self._step(live, frame)
            if live.lost is not None and live.lost.raised_at_frame_index == frame.index:
                asked.append(live.lost)
            if marker in self._live and live.session.latest is not None:
                self._remember(live.session.latest.estimates[0])
        for estimate in base.estimates:
            if estimate.marker not in self._live:
                self._remember(estimate)
        while asked:
            request = asked.popleft()
            if any(h.marker == request.marker and request.raised_at_frame_index in h for h in self._hidden):
                continue
            there = self._at(request.frame_index).get(request.marker)
            last = self._measured.get(request.marker)
            answers = self._ask(Asked(request, last, there, frame.index, self._frame_at))
            asked += self._taken_in(answers, frame)

    def _remember(self, estimate: MarkerEstimate) -> None:
        if estimate.status.measured:
            self._measured[estimate.marker] = estimate

    def _taken_in(self, answers: Sequence[Answer], now: Frame) -> list[OperatorRequest]:
        """Go back to each circle and follow its marker from there up to now; requests of those that are lost now."""
        self._hidden += [answer for answer in answers if isinstance(answer, Hidden)]
        seeds = sorted((a for a in answers if isinstance(a, Seed)), key=lambda seed: seed.frame_index)
        self._coming += [seed for seed in seeds if seed.frame_index > now.index]
        lost = []
        for seed in (seed for seed in seeds if seed.frame_index <= now.index):
            if not self._begin(seed):
                continue
            live = self._live[seed.marker]
            for index in range(seed.frame_index, now.index + 1):
                frame = now if index == now.index else self._frame_at(index)
                if frame is not None:
                    self._step(live, frame)
                if self._live.get(seed.marker) is not live:
                    break
            else:
                if live.lost is not None:
                    lost.append(live.lost)
        return lost

    def _begin(self, seed: Seed) -> bool:
        """Follow a marker from this circle, if it is not followed from a later one already."""
        before = self._live.get(seed.marker)
        if before is not None and before.answer.frame_index > seed.frame_index:
            return False
        own = [hidden for hidden in self._hidden if hidden.marker == seed.marker]
        session = begun(seed, own, self._terms, self._at, self._terms.readout_s)
        meeting = Meeting(lambda index: self._at(index).get(seed.marker))
        self._live[seed.marker] = _Live(seed, session, meeting)
        return True

    def _at(self, frame_index: int) -> Mapping[str, MarkerEstimate]:
        return self._base.get(frame_index, {})

    def _step(self, live: _Live, frame: Frame) -> None:
        """One more frame of a marker that is followed: it ends where it meets the base."""
        result = live.session.take(copy(frame))
        if not result.estimates:  # its circle's frame did not come
            return
        estimate = result.estimates[0]
        if estimate.status is not Status.LOST:
            live.lost = None
        live.lost = next(iter(result.requests), live.lost)
        if frame.index > live.answer.frame_index and live.meeting.met(estimate):
            del self._live[live.answer.marker]
