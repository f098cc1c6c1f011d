"""Constant-velocity Kalman filter in 3D on true time stamps, with a gate, and its RTS smoother (filterpy).

State (x, y, z, vx, vy, vz) in the camera's optical frame, metres and metres a second. Thesis section 3.3.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from filterpy.kalman import KalmanFilter, rts_smoother
from pydantic import Field
from scipy.stats import chi2

from spheremcap.core.stage import StageConfig
from spheremcap.core.time import NS_PER_S

FloatArray = npt.NDArray[np.float64]

_FASTEST_MPS = 100.0  # no marker's speed is less sure than this


class KalmanConfig(StageConfig):
    """Racing wrists accelerate up to about 100 m/s^2 at the hand rim, about 60 between."""

    enabled: bool = Field(True, description="false predicts the last position (ablation)")
    acceleration_mps2: float = Field(60.0, gt=0, description="standard deviation of the unknown acceleration; ours")
    start_speed_mps: float = Field(3.0, gt=0, description="standard deviation of the speed at a seed; ours")
    gate_probability: float = Field(0.9999, gt=0.5, lt=1, description="share of true measurements inside the gate")


@dataclass(frozen=True, slots=True)
class Moment:
    """The filter at one stamp: state (6,) and covariance (6, 6), after the update when there was one.

    `widened` is the factor by which the predicted covariance was widened before that update; 1 when it was not.
    """

    stamp_ns: int
    state: FloatArray
    covariance: FloatArray
    widened: float = 1.0

    @property
    def xyz_cam_m(self) -> FloatArray:
        return self.state[:3]

    @property
    def velocity_cam_mps(self) -> FloatArray:
        return self.state[3:]


class Track3D:
    """One marker's filter: predict to a stamp, then update or leave it. Not started until `start`."""

    def __init__(self, config: KalmanConfig) -> None:
        self.config = config
        self._gate = float(chi2.ppf(config.gate_probability, 3))
        self._filter = KalmanFilter(dim_x=6, dim_z=3)
        self._filter.H = np.eye(3, 6)
        self._stamp_ns: int | None = None
        self._widened = 1.0

    @property
    def started(self) -> bool:
        return self._stamp_ns is not None

    def start(
        self,
        stamp_ns: int,
        xyz_cam_m: FloatArray,
        covariance_m2: FloatArray,
        velocity_cam_mps: FloatArray | None = None,
    ) -> None:
        """Begin at a measured place; the velocity, when not given, is zero with the configured deviation."""
        self._filter.x = np.concatenate([xyz_cam_m, np.zeros(3) if velocity_cam_mps is None else velocity_cam_mps])
        self._filter.P = np.zeros((6, 6))
        self._filter.P[:3, :3] = covariance_m2
        self._filter.P[3:, 3:] = np.eye(3) * self.config.start_speed_mps**2
        self._stamp_ns, self._widened = stamp_ns, 1.0

    def stop(self) -> None:
        """Forget the state: the marker is lost."""
        self._stamp_ns = None

    def predict(self, stamp_ns: int) -> Moment:
        """Move the state to `stamp_ns` and return it. Raises RuntimeError when not started."""
        if self._stamp_ns is None:
            raise RuntimeError("the filter has not been started")
        dt_s = (stamp_ns - self._stamp_ns) / NS_PER_S
        f, q = transition(dt_s, self.config.acceleration_mps2)
        if not self.config.enabled:
            f = np.eye(6)
        self._filter.predict(F=f, Q=q)
        self._stamp_ns, self._widened = stamp_ns, 1.0
        return self.now

    @property
    def now(self) -> Moment:
        assert self._stamp_ns is not None
        return Moment(self._stamp_ns, np.array(self._filter.x).ravel(), np.array(self._filter.P), self._widened)

    def distance2(self, xyz_cam_m: FloatArray, covariance_m2: FloatArray) -> float:
        """Squared Mahalanobis distance of a measurement from the prediction (normalised innovation squared)."""
        innovation = xyz_cam_m - np.asarray(self._filter.x).ravel()[:3]
        return float(innovation @ np.linalg.solve(self._filter.P[:3, :3] + covariance_m2, innovation))

    def inside_gate(self, xyz_cam_m: FloatArray, covariance_m2: FloatArray) -> bool:
        """Whether a measurement is one that `gate_probability` of true ones would resemble."""
        return self.distance2(xyz_cam_m, covariance_m2) <= self._gate

    def update(self, xyz_cam_m: FloatArray, covariance_m2: FloatArray) -> Moment:
        """Take a measurement in at the predicted stamp.

        One outside the gate says that the state was surer than it had reason to be: its covariance is widened first.
        """
        surprise = self.distance2(xyz_cam_m, covariance_m2) / self._gate
        if surprise > 1:
            fastest = _FASTEST_MPS**2 / float(np.diag(self._filter.P)[3:].max())
            self._widened = min(surprise, max(1.0, fastest))
            self._filter.P = self._filter.P * self._widened
        self._filter.update(xyz_cam_m, R=covariance_m2)
        self._filter.P = (self._filter.P + self._filter.P.T) / 2
        return self.now


def transition(dt_s: float, acceleration_mps2: float) -> tuple[FloatArray, FloatArray]:
    """F and Q (6, 6) of constant velocity over `dt_s` with a random acceleration that is constant in between."""
    f = np.eye(6)
    f[:3, 3:] = np.eye(3) * dt_s
    gain = np.concatenate([np.eye(3) * (dt_s * dt_s / 2), np.eye(3) * dt_s])
    return f, gain @ gain.T * acceleration_mps2**2


def smooth(moments: list[Moment], acceleration_mps2: float) -> list[Moment]:
    """Rauch-Tung-Striebel smoothing of filtered moments in order of time (filterpy's rts_smoother)."""
    if len(moments) < 2:
        return list(moments)
    steps = []
    for a, b in pairwise(moments):
        f, q = transition((b.stamp_ns - a.stamp_ns) / NS_PER_S, acceleration_mps2)
        steps.append((f, q + (b.widened - 1) * (f @ a.covariance @ f.T + q)))
    fs, qs = zip(*steps, steps[-1], strict=True)  # step k leads from k to k + 1; the last is never used
    states, covariances, _, _ = rts_smoother(
        np.array([m.state for m in moments]), np.array([m.covariance for m in moments]), list(fs), list(qs)
    )
    return [Moment(m.stamp_ns, x, (p + p.T) / 2) for m, x, p in zip(moments, states, covariances, strict=True)]
