"""Constant-velocity Kalman filter in 3D on true time stamps, with a gate, and its RTS smoother.

State (x, y, z, vx, vy, vz) in the camera's optical frame, metres and metres a second. Thesis section 3.3.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.compiled import BOOL, F8, array, inner, kernel
from spheremcap.core.linear import inverse3, product, solve
from spheremcap.core.stage import StageConfig
from spheremcap.core.time import NS_PER_S

FloatArray = npt.NDArray[np.float64]

_FASTEST_MPS = 100.0  # no marker's speed is less sure than this


class KalmanConfig(StageConfig):
    """Racing wrists accelerate up to about 100 m/s^2 at the hand rim, about 60 between."""

    enabled: bool = Field(True, description="false predicts the last position (ablation)")
    acceleration_mps2: float = Field(60.0, gt=0, description="standard deviation of the unknown acceleration; ours")
    acceleration_s: float = Field(0.015, gt=0, description="time over which the acceleration forgets itself; ours")
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
        self._gate = gate_of(config.gate_probability)
        self._state: FloatArray = np.zeros(6)
        self._covariance: FloatArray = np.eye(6)
        self._stamp_ns: int | None = None
        self._widened = 1.0
        self._updates = 0
        self._moment: Moment | None = None  # `now`, until it changes
        self._information: FloatArray = np.eye(3)  # the inverse of the innovation's covariance S, as last asked for
        self._asked: tuple[FloatArray, FloatArray, float] | None = None  # about which measurement, and its distance2

    @property
    def started(self) -> bool:
        return self._stamp_ns is not None

    @property
    def moving_known(self) -> bool:
        """Whether more than one measurement speaks of the velocity; before, it is zero by assumption."""
        return self._updates > 0

    def start(
        self,
        stamp_ns: int,
        xyz_cam_m: FloatArray,
        covariance_m2: FloatArray,
        velocity_cam_mps: FloatArray | None = None,
    ) -> None:
        """Begin at a measured place; the velocity, when not given, is zero with the configured deviation."""
        self._state = np.concatenate([xyz_cam_m, np.zeros(3) if velocity_cam_mps is None else velocity_cam_mps])
        self._covariance = np.zeros((6, 6))
        self._covariance[:3, :3] = covariance_m2
        self._covariance[3:, 3:] = np.eye(3) * self.config.start_speed_mps**2
        self._stamp_ns, self._widened, self._asked, self._moment = stamp_ns, 1.0, None, None
        self._updates = 0 if velocity_cam_mps is None else 1

    def predict(self, stamp_ns: int) -> Moment:
        """Move the state to `stamp_ns` and return it. Raises RuntimeError when not started."""
        if self._stamp_ns is None:
            raise RuntimeError("the filter has not been started")
        dt_s = (stamp_ns - self._stamp_ns) / NS_PER_S
        f, q = transition(dt_s, self.config)
        self._state = f @ self._state
        self._covariance = f @ self._covariance @ f.T + q
        self._stamp_ns, self._widened, self._asked, self._moment = stamp_ns, 1.0, None, None
        return self.now

    @property
    def now(self) -> Moment:
        """The state as it is; it does not change afterwards."""
        assert self._stamp_ns is not None
        if self._moment is None:
            self._moment = Moment(self._stamp_ns, self._state, self._covariance, self._widened)
        return self._moment

    def distance2(self, xyz_cam_m: FloatArray, covariance_m2: FloatArray) -> float:
        """Squared Mahalanobis distance of a measurement from the prediction (normalised innovation squared)."""
        if self._asked is None or self._asked[0] is not xyz_cam_m or self._asked[1] is not covariance_m2:
            found = _distance2(self._state, self._covariance, xyz_cam_m, covariance_m2, self._information)
            self._asked = xyz_cam_m, covariance_m2, found
        return self._asked[2]

    def surprise(self, xyz_cam_m: FloatArray, covariance_m2: FloatArray) -> float:
        """`distance2` over the gate: above 1, fewer than 1 - `gate_probability` of true measurements are as far off."""
        return self.distance2(xyz_cam_m, covariance_m2) / self._gate

    def update(self, xyz_cam_m: FloatArray, covariance_m2: FloatArray) -> Moment:
        """Take a measurement in at the predicted stamp.

        One outside the gate says that the state was surer than it had reason to be: its covariance is widened first.
        """
        surprise = self.surprise(xyz_cam_m, covariance_m2)
        if surprise > 1:
            fastest = _FASTEST_MPS**2 / float(np.diag(self._covariance)[3:].max())
            self._widened = min(surprise, max(1.0, fastest))
            self._covariance, self._asked = self._covariance * self._widened, None
            self.distance2(xyz_cam_m, covariance_m2)
        gain = np.ascontiguousarray(self._covariance[:, :3]) @ self._information  # P H' S^-1: H takes the place alone
        left = np.eye(6)  # I - K H
        left[:, :3] -= gain
        self._state = self._state + gain @ (xyz_cam_m - self._state[:3])
        covariance = left @ self._covariance @ left.T + gain @ covariance_m2 @ gain.T  # Joseph's form
        self._covariance = (covariance + covariance.T) / 2
        self._updates, self._asked, self._moment = self._updates + 1, None, None
        return self.now


@lru_cache(maxsize=16)
def gate_of(probability: float) -> float:
    """The quantile of chi-squared with three degrees of freedom: that share of true measurements is no further off."""
    low, high = 0.0, 1e4
    while low < (middle := (low + high) / 2) < high:
        beyond = math.erfc(math.sqrt(middle / 2)) + math.sqrt(2 * middle / math.pi) * math.exp(-middle / 2)
        low, high = (middle, high) if beyond > 1 - probability else (low, middle)
    return high


@kernel(F8, array(F8, 1), array(F8, 2), array(F8, 1), array(F8, 2), F8[:, ::1])
def _distance2(state, covariance, measured, measured_covariance, information):
    """y' S^-1 y of the innovation y = z - H x with S = H P H' + R, and S^-1 (3, 3) into `information`."""
    spread = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            spread[i, j] = covariance[i, j] + measured_covariance[i, j]
    inverse3(spread, information)
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += (measured[i] - state[i]) * information[i, j] * (measured[j] - state[j])
    return total


@inner
def change_power(dt_s, acceleration_mps2, acceleration_s):
    """How fast the variance of the velocity grows, (m/s)^2 a second, over a step under a random acceleration that
    forgets itself within `acceleration_s` (Singer 1970): over short steps it pushes one way, over long ones it does
    not. That neighbouring short steps push alike is left out: at 480 frames a second the filter is a bit too sure."""
    ratio = abs(dt_s) / acceleration_s
    if ratio < 1e-3:
        return acceleration_mps2 * acceleration_mps2 * abs(dt_s)
    grown = 2.0 * (acceleration_mps2 * acceleration_s) ** 2 * (ratio - 1.0 + math.exp(-ratio))
    return grown / abs(dt_s)


@lru_cache(maxsize=256)
def transition(dt_s: float, config: KalmanConfig) -> tuple[FloatArray, FloatArray]:
    """F and Q (6, 6) of nearly constant velocity over `dt_s`: white acceleration of `change_power` (Bar-Shalom et al.
    2001, eq 6.2.2-12), whose two effects on place and velocity are not one. F is of a marker that stays where it is
    where the filter is not enabled. Kept and shared, so not to be written to.

    An acceleration that is constant over each step instead has a Q of rank 3: the velocity is then taken from the last
    two places alone, and after one wrong place the prediction rings, step by step to either side.
    """
    f = np.eye(6)
    if config.enabled:
        f[:3, 3:] = np.eye(3) * dt_s
    power = change_power.py_func(dt_s, config.acceleration_mps2, config.acceleration_s)
    step = np.array([[abs(dt_s) ** 3 / 3, dt_s * abs(dt_s) / 2], [dt_s * abs(dt_s) / 2, abs(dt_s)]])
    q = power * np.kron(step, np.eye(3))
    f.flags.writeable = q.flags.writeable = False
    return f, q


def smooth(moments: Sequence[Moment], config: KalmanConfig) -> list[Moment]:
    """Rauch-Tung-Striebel smoothing (Rauch, Tung, Striebel 1965) of filtered moments in order of time."""
    if len(moments) < 2:
        return list(moments)
    stamps = [m.stamp_ns for m in moments]
    dt_s = np.diff(stamps) / NS_PER_S
    states, covariances = np.array([m.state for m in moments]), np.array([m.covariance for m in moments])
    widened = np.array([m.widened for m in moments])
    _smooth(states, covariances, dt_s, widened, config.acceleration_mps2, config.acceleration_s, config.enabled)
    return [Moment(stamp, x, p) for stamp, x, p in zip(stamps, states, covariances, strict=True)]


@kernel(None, F8[:, ::1], F8[:, :, ::1], array(F8, 1), array(F8, 1), F8, F8, BOOL)
def _smooth(states, covariances, dt_s, widened, acceleration_mps2, acceleration_s, moving):
    """Backwards over states (N, 6) and covariances (N, 6, 6), in place; `dt_s` (N - 1,) between them.

    Where the filter's prediction of moment k + 1 was widened, the process noise of that step is what widened it.
    """
    noise, step, turned = np.zeros((6, 6)), np.eye(6), np.eye(6)
    forward, predicted, used = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    ahead, change = np.empty(6), np.empty((6, 6))
    for k in range(len(dt_s) - 1, -1, -1):
        dt = dt_s[k]
        power = change_power(dt, acceleration_mps2, acceleration_s)
        for i in range(3):
            step[i, 3 + i] = turned[3 + i, i] = dt if moving else 0.0
            noise[i, i] = power * dt * dt * dt / 3.0
            noise[i, 3 + i] = noise[3 + i, i] = power * dt * dt / 2.0
            noise[3 + i, 3 + i] = power * dt
        product(step, covariances[k], forward)  # F P
        product(forward, turned, predicted)
        for i in range(6):
            ahead[i] = states[k + 1, i]
            for j in range(6):
                predicted[i, j] = used[i, j] = (predicted[i, j] + noise[i, j]) * widened[k + 1]
                ahead[i] -= step[i, j] * states[k, j]
        solve(used, forward)  # the gain P F' (F P F' + Q)^-1, transposed
        for i in range(6):
            for j in range(6):
                states[k, i] += forward[j, i] * ahead[j]
                predicted[i, j] = covariances[k + 1, i, j] - predicted[i, j]
        product(predicted, forward, used)
        for i in range(6):
            for j in range(6):
                change[i, j] = 0.0
                for m in range(6):
                    change[i, j] += forward[m, i] * used[m, j]
        for i in range(6):
            for j in range(6):
                covariances[k, i, j] += 0.5 * (change[i, j] + change[j, i])
