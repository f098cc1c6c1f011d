"""All markers over one source of frames: what a person gives, the order of things, requests, the fixed-lag smoother.

A stream cannot be gone back over: a later seed of a marker starts it again from its frame on. What a person's answers
change in a recording, before their frames too, is `stretch`'s.
"""

import os
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, field, replace

from pydantic import Field

from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, OperatorRequest, SmoothedPose, Status
from spheremcap.core.frame import Frame
from spheremcap.core.look import Look
from spheremcap.core.marker import Answer, Hidden, MarkerSpec, Seed
from spheremcap.core.stage import StageConfig
from spheremcap.core.time import NS_PER_S
from spheremcap.core.view import StageView
from spheremcap.detection.optics import OpticsLearner
from spheremcap.errors import UsageError
from spheremcap.positioning.kalman import KalmanConfig, Moment, smooth


class SessionConfig(StageConfig):
    """How far the smoother looks ahead; memory and the output's delay grow with it, nothing else does."""

    smoother_lag_frames: int = Field(
        60, ge=1, le=2000, description="frames after a pose that may still improve it, up to a quarter second of them"
    )


_HELD_NS = NS_PER_S // 2
"""Recording time of the results that wait for the smoother: what a process that is killed loses besides what is not on
disk yet. At 25 frames/s six frames of what comes after a pose leave less than 1e-5 mm to improve."""


HIDDEN = "hidden, as a person says"
"""The reason of a frame on which a marker is not to be seen, as it was answered."""

Others = Callable[[int, float], Sequence[Circle]]
"""On a frame (its index), circles of markers that another session follows and that are nearer than so many metres."""


@dataclass
class _Lane:
    """One marker's chain and what the session remembers of it."""

    chain: MarkerChain
    seeds: deque[Seed]
    hidden: tuple[Hidden, ...] = ()
    was_hidden: bool = False
    seeded: bool = False
    status: Status | None = None
    stretch: int = 0  # grows with every start of the filter: smoothing never crosses it
    moments: deque[tuple[int, int, Moment]] = field(default_factory=deque)  # (number of the frame, stretch, moment)
    first_miss_stamp_ns: int = 0
    first_miss_frame: int = 0
    against: Counter[str] = field(default_factory=Counter)  # what spoke against the claims since then

    def hides(self, frame: Frame) -> Hidden | None:
        """The answer by which the marker is not to be seen on this frame."""
        return next((hidden for hidden in self.hidden if frame.index in hidden), None)


class Session:
    """Tracks several markers through frames in order, each by its own chain, each frame decoded once.

    `answers` are what a person gave: on frames on which a marker is hidden nobody looks for it, what is kept changes
    nothing. `camera` must fit the frames' size; `metric` False means it is only assumed and no metres are given out.
    `keep_view` says for which estimates the stages' pictures are kept. The markers' looks at a frame run side by side
    in up to `threads` threads (None: as many as there are processors but one, which decodes); results do not depend on
    how many. `others` says what markers that are not this session's hide. `latest` is the last frame's result, not yet
    smoothed. Raises UsageError for a seed of an unknown marker, outside the picture, twice on one frame or where the
    marker is hidden, or for a marker without one.
    """

    def __init__(
        self,
        camera: Camera,
        markers: Sequence[MarkerSpec],
        answers: Sequence[Answer],
        chain: ChainConfig | None = None,
        config: SessionConfig | None = None,
        *,
        exposure_s: float = 0.0,
        metric: bool = True,
        readout_s: float | None = None,
        keep_view: Callable[[MarkerEstimate], bool] = lambda estimate: False,
        threads: int | None = None,
        others: Others = lambda frame_index, range_m: (),
    ) -> None:
        self._keep_view, self._others = keep_view, others
        self.latest: FrameResult | None = None
        self._taken = 0  # frames; indices need not rise
        self.config = config or SessionConfig()
        chain = chain or ChainConfig()
        self._kalman = chain.kalman
        check_answers(answers, [m.name for m in markers], camera.width_px, camera.height_px)
        optics = OpticsLearner(exposure_s, readout_s, chain.edge.learn_blur, camera.height_px)
        self._lanes: dict[str, _Lane] = {}
        for marker in markers:
            own = [a for a in answers if a.marker == marker.name]
            seeds = deque(sorted((a for a in own if isinstance(a, Seed)), key=lambda seed: seed.frame_index))
            if not seeds:
                raise UsageError(
                    f"marker {marker.name!r} has no seed; give one: --seed {marker.name}@FRAME=X,Y,R (pixels)"
                )
            hidden = tuple(a for a in own if isinstance(a, Hidden))
            follower = MarkerChain(marker, camera, chain, metric=metric, optics=optics)
            self._lanes[marker.name] = _Lane(follower, seeds, hidden)
        self._metric = metric
        self._threads = min(threads or max(1, (os.cpu_count() or 2) - 1), len(self._lanes))

    def run(self, frames: Iterable[Frame]) -> Iterator[FrameResult]:
        """One FrameResult a frame, in order, each held back until the smoother's lag has passed.

        Raises UsageError when a seed lies on a frame after the last one.
        """
        lag = self.config.smoother_lag_frames
        pending: deque[tuple[int, FrameResult]] = deque()
        count, last = 0, -1
        with ThreadPoolExecutor(self._threads, "look") if self._threads > 1 else nullcontext() as pool:
            for frame in frames:
                count, last = count + 1, max(last, frame.index)
                result = self.take(frame, pool.map if pool is not None else map)
                pending.append((self._taken, result))
                # Smoothing in blocks of one lag costs each pose two backward steps, whatever the lag.
                if len(pending) >= 2 * lag or result.stamp_ns - pending[0][1].stamp_ns >= _HELD_NS:
                    yield from self._release(pending, (len(pending) + 1) // 2)
            yield from self._release(pending, len(pending))
        for name, lane in self._lanes.items():
            for seed in lane.seeds:
                raise UsageError(
                    f"seed of {name} on frame {seed.frame_index}: the source has {count} frames"
                    + (f" (0 to {last})" if count else "")
                )

    def take(self, frame: Frame, side_by_side: Callable[..., Iterable[tuple[Look, ...]]] = map) -> FrameResult:
        """One more frame's result, not smoothed: for a caller who gives frame by frame, and does not `run`."""
        self._taken += 1
        found: dict[str, MarkerEstimate] = {}
        views: dict[str, StageView] = {}
        requests: list[OperatorRequest] = []
        # A person's word goes before everything that the chains see.
        for name, lane in self._lanes.items():
            seed, missing = _due(lane.seeds, frame.index)
            requests += [_unseen(frame, one) for one in missing]
            if seed is not None:
                lane.seeded = True
                found[name] = lane.chain.seed(frame, seed.circle)
        # A nearer marker hides a farther one, and a lost one is not looked for where others are.
        lanes = [(name, lane) for name, lane in self._lanes.items() if lane.seeded and name not in found]
        lanes.sort(key=lambda item: item[1].chain.range_m)
        for _, lane in lanes:
            lane.chain.predict(frame)
        looks = side_by_side(lambda item: () if item[1].hides(frame) else item[1].chain.look(frame), lanes)
        for (name, lane), seen in zip(lanes, list(looks), strict=True):
            taken = [e.circle for e in found.values() if e.circle is not None and e.status.measured]
            taken += self._others(frame.index, lane.chain.range_m)
            found[name] = lane.chain.settle(frame, seen, taken)
            if hidden := lane.hides(frame):
                found[name] = hidden_estimate(hidden, frame.index, frame.stamp_ns)
            view = lane.chain.view(frame, seen) if seen and self._keep_view(found[name]) else None
            if view is not None:
                views[name] = view
        names = [name for name in self._lanes if name in found]
        for name in names:
            requests += self._note(self._lanes[name], found[name])
        self.latest = FrameResult(
            frame.index, frame.stamp_ns, tuple(found[name] for name in names), (), tuple(requests),
            tuple(views[name] for name in names if name in views),
        )  # fmt: skip
        return self.latest

    def _note(self, lane: _Lane, estimate: MarkerEstimate) -> list[OperatorRequest]:
        """Keep the filter's state for smoothing; ask for a person when the marker has become lost."""
        if estimate.status is Status.SEEDED or lane.status in (None, Status.LOST, Status.OUT_OF_VIEW):
            lane.stretch += 1
        moment, hidden = lane.chain.moment, HIDDEN in estimate.reasons
        if moment is not None and self._metric and not hidden:
            lane.moments.append((self._taken, lane.stretch, moment))
        if not estimate.status.measured:
            if lane.status is None or lane.status.measured or lane.was_hidden:
                lane.first_miss_frame, lane.first_miss_stamp_ns = estimate.frame_index, estimate.stamp_ns
                lane.against.clear()
            lane.against.update(estimate.reasons)
        lost = estimate.status is Status.LOST and lane.status is not Status.LOST
        before, lane.status = lane.status, estimate.status
        was_hidden, lane.was_hidden = lane.was_hidden, hidden
        if not lost:
            return []
        reasons = tuple(name for name, _ in lane.against.most_common())
        reason = (
            "not found where it is no longer hidden"
            if was_hidden
            else "did not come back into the picture"
            if before is Status.OUT_OF_VIEW
            else f"{lane.chain.misses} frames in a row without a verified circle: {', '.join(reasons)}"
        )
        if estimate.vote_sum is not None:
            reason += f"; votes {estimate.vote_sum:.2f} of 6"
        return [
            OperatorRequest(
                estimate.marker,
                lane.first_miss_frame,
                lane.first_miss_stamp_ns,
                estimate.frame_index,
                estimate.stamp_ns,
                reason,
                reasons,
            )
        ]

    def _release(self, pending: deque[tuple[int, FrameResult]], count: int) -> Iterator[FrameResult]:
        """The oldest `count` results with their smoothed poses."""
        smoothed: dict[int, list[SmoothedPose]] = {}
        if count == 0:
            return
        indices = {number: result.frame_index for number, result in pending}
        last = pending[count - 1][0]
        for name, lane in self._lanes.items():
            for number, moment in _smoothed(list(lane.moments), self._kalman):
                if number <= last:
                    covariance = lane.chain.whereabouts.reported(moment.xyz_cam_m, moment.covariance[:3, :3])
                    pose = SmoothedPose(
                        name, indices[number], moment.stamp_ns, moment.xyz_cam_m, covariance, moment.velocity_cam_mps
                    )
                    smoothed.setdefault(number, []).append(pose)
            while lane.moments and lane.moments[0][0] <= last:
                lane.moments.popleft()
        for _ in range(count):
            number, result = pending.popleft()
            yield replace(result, smoothed=tuple(smoothed.get(number, ())))


def _smoothed(moments: Sequence[tuple[int, int, Moment]], kalman: KalmanConfig) -> Iterator[tuple[int, Moment]]:
    """Number of the frame and smoothed moment of each, stretch by stretch."""
    start = 0
    for k in range(1, len(moments) + 1):
        if k == len(moments) or moments[k][1] != moments[start][1]:
            stretch = moments[start:k]
            smoothed = smooth([m for _, _, m in stretch], kalman)
            for (number, _, _), moment in zip(stretch, smoothed, strict=True):
                yield number, moment
            start = k


def hidden_estimate(hidden: Hidden, frame_index: int, stamp_ns: int) -> MarkerEstimate:
    """What stands for a marker on a frame on which a person says that it is not to be seen."""
    return MarkerEstimate(
        hidden.marker, frame_index, stamp_ns, Status.OUT_OF_VIEW, reasons=(HIDDEN,), answer_frame=hidden.frame_index
    )


def check_answers(answers: Sequence[Answer], markers: Sequence[str], width_px: int, height_px: int) -> None:
    """Raises UsageError for an answer about an unknown marker, a seed outside a picture of this size, two on one frame,
    and one where another answer says that the marker is hidden."""
    given: dict[tuple[str, int], Seed] = {}
    for answer in answers:
        if answer.marker not in markers:
            raise UsageError(f"seed for marker {answer.marker!r}, which is not among {', '.join(markers) or 'none'}")
        if not isinstance(answer, Seed):
            continue
        circle = answer.circle
        inside = 0 <= circle.x_px <= width_px - 1 and 0 <= circle.y_px <= height_px - 1
        if not inside or not 1 <= circle.r_px <= max(width_px, height_px):
            raise UsageError(
                f"seed of {answer.marker} on frame {answer.frame_index}: circle x={circle.x_px:g} y={circle.y_px:g} "
                f"r={circle.r_px:g} is outside the {width_px}x{height_px} picture"
            )
        if (answer.marker, answer.frame_index) in given:
            raise UsageError(f"two seeds of {answer.marker} on frame {answer.frame_index}: keep the right one")
        given[answer.marker, answer.frame_index] = answer
    for hidden in (answer for answer in answers if isinstance(answer, Hidden)):
        for seed in given.values():
            if seed.marker == hidden.marker and seed.frame_index in hidden:
                raise UsageError(
                    f"{seed.marker} has a circle on frame {seed.frame_index} and is hidden from frame "
                    f"{hidden.frame_index} to {hidden.to_frame_index}: keep what is right"
                )


def _due(seeds: deque[Seed], index: int) -> tuple[Seed | None, list[Seed]]:
    """The seed of this frame, and those of frames that never came; all of them leave the queue."""
    missing = []
    while seeds and seeds[0].frame_index < index:
        missing.append(seeds.popleft())
    return (seeds.popleft() if seeds and seeds[0].frame_index == index else None), missing


def _unseen(frame: Frame, seed: Seed) -> OperatorRequest:
    """The person who gave a seed on a frame that never came is asked for another."""
    reason = f"its seed's frame {seed.frame_index} did not come (lost or undecodable): give a circle on this one"
    return OperatorRequest(seed.marker, frame.index, frame.stamp_ns, frame.index, frame.stamp_ns, reason)
