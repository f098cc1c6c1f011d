"""What the chain says of one marker on one frame."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Window
from spheremcap.core.status import Status as Status
from spheremcap.core.view import StageView
from spheremcap.core.vote import Verdict, Vote

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MarkerEstimate:
    """One marker on one frame. None means: there is no such value, and none was made up.

    `circle` (pixels; a perfect sphere's outline is an ellipse, this is its equal-area circle) is the measured one
    when `status.measured`, the Kalman filter's projected one when ESTIMATED, None otherwise. `claim` is what the
    detectors proposed, whatever became of it. `xyz_cam_m` (3,), `covariance_m2` (3, 3) and `velocity_cam_mps` (3,)
    are in the camera's optical frame: measured position and covariance when measured, the filter's when ESTIMATED.
    `circle_sd_px` is the standard deviation of (x, y, r) in pixels. `votes` holds all six whenever a template could
    be searched for, `vote_sum` their sum of overlaps in [0, 6]. `proposer` names the stage whose circle became the
    claim (hough, colour, kcf, prediction, acquire, seed). `visible` is the fraction of the outline with an edge.
    `reasons` are the names of what spoke against the claim (`verification.checks`; "votes", "no outline", "out of
    view", "not found"); empty when VERIFIED, and of a seed what speaks against it ("no outline", "little outline").
    `velocity_cam_mps` is None until two measurements say something of it. `answer_frame` is the frame of a person's
    answer that the estimate rests on; None where that is the marker's first circle. One that was made from that answer
    backwards has the reason "backwards".
    """

    marker: str
    frame_index: int
    stamp_ns: int
    status: Status
    circle: Circle | None = None
    circle_sd_px: tuple[float, float, float] | None = None
    claim: Circle | None = None
    proposer: str = ""
    proposals: tuple[tuple[str, Circle], ...] = ()
    search: Window | None = None
    votes: tuple[Vote, ...] = ()
    vote_sum: float | None = None
    verdict: Verdict | None = None
    visible: float | None = None
    xyz_cam_m: FloatArray | None = field(default=None)
    covariance_m2: FloatArray | None = field(default=None)
    velocity_cam_mps: FloatArray | None = field(default=None)
    reasons: tuple[str, ...] = ()
    answer_frame: int | None = None


@dataclass(frozen=True, slots=True)
class SmoothedPose:
    """A marker's pose after the fixed-lag RTS smoother: position, covariance and velocity in the optical frame."""

    marker: str
    frame_index: int
    stamp_ns: int
    xyz_cam_m: FloatArray
    covariance_m2: FloatArray
    velocity_cam_mps: FloatArray


@dataclass(frozen=True, slots=True)
class OperatorRequest:
    """A person is asked where `marker` is on its first unverified frame; `reason` says why in one line, `reasons` are
    the names of what spoke against the claims since then, most frequent first. `answered` is what a person said to it,
    "" while it is open."""

    marker: str
    frame_index: int
    stamp_ns: int
    raised_at_frame_index: int
    raised_stamp_ns: int
    reason: str
    reasons: tuple[str, ...] = ()
    answered: str = ""


@dataclass(frozen=True, slots=True)
class FrameResult:
    """All that the session says of one frame. `smoothed` holds the poses of this very frame, whose estimates were
    held back until the smoother's lag had passed; `requests` are those raised on this frame; `views` the stages'
    pictures where they were asked for."""

    frame_index: int
    stamp_ns: int
    estimates: tuple[MarkerEstimate, ...]
    smoothed: tuple[SmoothedPose, ...] = ()
    requests: tuple[OperatorRequest, ...] = ()
    views: tuple[StageView, ...] = ()
