"""All markers over one source of frames: seeds, the order of things, requests, and the fixed-lag smoother."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from pydantic import Field

from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, OperatorRequest, SmoothedPose, Status
from spheremcap.core.frame import Frame
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.core.stage import StageConfig
from spheremcap.errors import UsageError
from spheremcap.positioning.kalman import Moment, smooth


class SessionConfig(StageConfig):
    """How far the smoother looks ahead; memory and the output's delay grow with it, nothing else does."""

    smoother_lag_frames: int = Field(60, ge=1, le=2000, description="frames after a pose that may still improve it")


@dataclass
class _Lane:
    """One marker's chain and what the session remembers of it."""

    chain: MarkerChain
    seeds: deque[Seed]
    seeded: bool = False
    status: Status | None = None
    stretch: int = 0  # grows with every start of the filter: smoothing never crosses it
    moments: deque[tuple[int, int, Moment]] = field(default_factory=deque)  # (frame index, stretch, moment)
    first_miss_stamp_ns: int = 0
    first_miss_frame: int = 0


class Session:
    """Tracks several markers through frames in order, each by its own chain, each frame decoded once.

    `camera` must fit the frames' size; `metric` False means it is only assumed and no metres are given out.
    `keep_view` says for which estimates the stages' pictures are kept. Raises UsageError for a
    seed of an unknown marker, or for a marker without a seed.
    """

    def __init__(
        self,
        camera: Camera,
        markers: Sequence[MarkerSpec],
        seeds: Sequence[Seed],
        chain: ChainConfig | None = None,
        config: SessionConfig | None = None,
        *,
        exposure_s: float = 0.0,
        metric: bool = True,
        readout_s: float | None = None,
        keep_view: Callable[[MarkerEstimate], bool] = lambda estimate: False,
    ) -> None:
        self._keep_view = keep_view
        self.config = config or SessionConfig()
        chain = chain or ChainConfig()
        self._acceleration = chain.kalman.acceleration_mps2
        names = [m.name for m in markers]
        for seed in seeds:
            if seed.marker not in names:
                raise UsageError(f"seed for marker {seed.marker!r}, which is not among {', '.join(names) or 'none'}")
        self._lanes: dict[str, _Lane] = {}
        for marker in markers:
            own = deque(sorted((s for s in seeds if s.marker == marker.name), key=lambda s: s.frame_index))
            if not own:
                raise UsageError(
                    f"marker {marker.name!r} has no seed; give one: --seed {marker.name}@FRAME=X,Y,R (pixels)"
                )
            self._lanes[marker.name] = _Lane(MarkerChain(marker, camera, chain, exposure_s, metric, readout_s), own)
        self._metric = metric

    def run(self, frames: Iterable[Frame]) -> Iterator[FrameResult]:
        """One FrameResult a frame, in order, each held back until the smoother's lag has passed.

        Raises UsageError when a seed lies outside the picture or on a frame that never came.
        """
        lag = self.config.smoother_lag_frames
        pending: deque[FrameResult] = deque()
        count = 0
        for frame in frames:
            count += 1
            pending.append(self._frame(frame))
            # Smoothing in blocks of one lag costs each pose two backward steps, whatever the lag.
            if len(pending) >= 2 * lag:
                yield from self._release(pending, lag)
        yield from self._release(pending, len(pending))
        for name, lane in self._lanes.items():
            for seed in lane.seeds:
                raise UsageError(
                    f"seed of {name} on frame {seed.frame_index}: the source has {count} frames"
                    + (f" (0 to {count - 1})" if count else "")
                )

    def _frame(self, frame: Frame) -> FrameResult:
        found: dict[str, MarkerEstimate] = {}
        # A nearer marker hides a farther one, and a lost one is not looked for where others are.
        for name, lane in sorted(self._lanes.items(), key=lambda item: item[1].chain.range_m):
            taken = [e.circle for e in found.values() if e.circle is not None and e.status.measured]
            estimate = self._step(lane, frame, taken)
            if estimate is not None:
                found[name] = estimate
        estimates, requests, views = [], [], []
        for name, lane in self._lanes.items():
            if name not in found:
                continue
            estimates.append(found[name])
            requests += self._note(lane, found[name])
            if lane.chain.view is not None and self._keep_view(found[name]):
                views.append(lane.chain.view)
        return FrameResult(frame.index, frame.stamp_ns, tuple(estimates), (), tuple(requests), tuple(views))

    def _step(self, lane: _Lane, frame: Frame, taken: Sequence[Circle]) -> MarkerEstimate | None:
        """The chain's estimate on this frame, given the circles of others; None before the marker's first seed."""
        if lane.seeds and lane.seeds[0].frame_index <= frame.index:
            seed = lane.seeds.popleft()
            circle = seed.circle
            inside = 0 <= circle.x_px <= frame.width_px - 1 and 0 <= circle.y_px <= frame.height_px - 1
            if not inside or circle.r_px < 1:
                raise UsageError(
                    f"seed of {seed.marker} on frame {seed.frame_index}: circle x={circle.x_px:g} y={circle.y_px:g} "
                    f"r={circle.r_px:g} is outside the {frame.width_px}x{frame.height_px} picture"
                )
            lane.seeded = True
            return lane.chain.seed(frame, circle)
        return lane.chain.step(frame, keep_view=True, taken=taken) if lane.seeded else None

    def _note(self, lane: _Lane, estimate: MarkerEstimate) -> list[OperatorRequest]:
        """Keep the filter's state for smoothing; ask for a person when the marker has become lost."""
        if estimate.status is Status.SEEDED or lane.status in (None, Status.LOST, Status.OUT_OF_VIEW):
            lane.stretch += 1
        moment = lane.chain.moment
        if moment is not None and self._metric:
            lane.moments.append((estimate.frame_index, lane.stretch, moment))
        if not estimate.status.measured and (lane.status is None or lane.status.measured):
            lane.first_miss_frame, lane.first_miss_stamp_ns = estimate.frame_index, estimate.stamp_ns
        lost = estimate.status is Status.LOST and lane.status is not Status.LOST
        before, lane.status = lane.status, estimate.status
        if not lost:
            return []
        reason = (
            "did not come back into the picture"
            if before is Status.OUT_OF_VIEW
            else f"{lane.chain.misses} frames in a row without a verified circle"
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
            )
        ]

    def _release(self, pending: deque[FrameResult], count: int) -> Iterator[FrameResult]:
        """The oldest `count` results with their smoothed poses."""
        smoothed: dict[int, list[SmoothedPose]] = {}
        if count == 0:
            return
        last = pending[count - 1].frame_index
        for name, lane in self._lanes.items():
            for index, moment in _smoothed(list(lane.moments), self._acceleration):
                if index <= last:
                    pose = SmoothedPose(
                        name,
                        index,
                        moment.stamp_ns,
                        moment.xyz_cam_m,
                        moment.covariance[:3, :3],
                        moment.velocity_cam_mps,
                    )
                    smoothed.setdefault(index, []).append(pose)
            while lane.moments and lane.moments[0][0] <= last:
                lane.moments.popleft()
        for _ in range(count):
            result = pending.popleft()
            yield replace(result, smoothed=tuple(smoothed.get(result.frame_index, ())))


def _smoothed(moments: Sequence[tuple[int, int, Moment]], acceleration_mps2: float) -> Iterator[tuple[int, Moment]]:
    """Frame index and smoothed moment of each, stretch by stretch."""
    start = 0
    for k in range(1, len(moments) + 1):
        if k == len(moments) or moments[k][1] != moments[start][1]:
            stretch = moments[start:k]
            for (index, _, _), moment in zip(
                stretch, smooth([m for _, _, m in stretch], acceleration_mps2), strict=True
            ):
                yield index, moment
            start = k
