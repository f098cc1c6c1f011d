"""How far away a marker is by the size of its outline alone, and how steady that is.

The Kalman filter has to allow for the most that a hand accelerates: at 30 frames a second that is a third of the
distance from one frame to the next. A marker whose size has changed little does not jump, so a part of it that looks
like a smaller whole is known for what it is.
"""

import math

import numpy as np

from spheremcap.core.compiled import F8, array, inner, kernel
from spheremcap.core.time import NS_PER_S

_RATES = np.array([0.02, 0.06, 0.2, 0.6, 2.0, 6.0])
"""How fast the logarithm of the distance usually changes, standard deviation in 1/s: one model each."""
_KEEPS_S = 0.6  # time within which a rate forgets itself
_MEMORY = 30.0  # measurements after which the evidence for a model has faded
_TAILS = 4.0  # degrees of freedom of Student's t for what is measured: one wrong outline does not decide


class SizeTrack:
    """The logarithm of one marker's distance and its rate, under several usual rates at once, each weighed by how well
    it foretold what was measured (Magill 1965; Bar-Shalom et al. 2001, section 11.6.2).

    A rate is an Ornstein-Uhlenbeck process: it forgets itself, so that a marker that is not seen does not run away.
    """

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._models, self._scores = np.zeros((len(_RATES), 5)), np.zeros(len(_RATES))

    def start(self, stamp_ns: int, range_m: float, sd: float) -> None:
        """Begin at a distance, metres, with this relative deviation; what was learnt of the rates is kept."""
        self._stamp_ns = stamp_ns
        self._models[:] = math.log(range_m), 0.0, sd * sd, 0.0, 0.0
        self._models[:, 4] = _RATES**2

    def expect(self, stamp_ns: int) -> tuple[float, float]:
        """The distance at a later stamp, metres, and its relative deviation."""
        mean, variance = _expected(self._models, self._scores, (stamp_ns - self._stamp_ns) / NS_PER_S)
        return math.exp(mean), math.sqrt(variance)

    def update(self, stamp_ns: int, range_m: float, sd: float) -> None:
        """Take in a distance that was measured, metres, with its relative deviation."""
        _update(self._models, self._scores, (stamp_ns - self._stamp_ns) / NS_PER_S, math.log(range_m), sd * sd)
        self._stamp_ns = stamp_ns


@inner
def _moved(model, dt_s, usual):
    """A model's value, rate and their covariance (00, 01, 11) after `dt_s`; a falling stamp moves nothing."""
    value, rate, p00, p01, p11 = model[0], model[1], model[2], model[3], model[4]
    lapse, power = max(dt_s, 0.0) / _KEEPS_S, usual * usual
    kept = math.exp(-lapse)
    way = _KEEPS_S * (1.0 - kept)
    strayed = power * _KEEPS_S * _KEEPS_S * max(0.0, 2.0 * lapse - 3.0 + 4.0 * kept - kept * kept)
    return (
        value + way * rate,
        kept * rate,
        p00 + 2.0 * way * p01 + way * way * p11 + strayed,
        kept * (p01 + way * p11) + power * _KEEPS_S * (1.0 - kept) ** 2,
        kept * kept * p11 + power * (1.0 - kept * kept),
    )


@kernel(None, array(F8, 2), array(F8, 1), F8)
def _expected(models, scores, dt_s):
    """Mean and variance of the models' mixture after `dt_s`."""
    best = scores.max()
    total, mean, square = 0.0, 0.0, 0.0
    for k in range(len(scores)):
        value, _, p00, _, _ = _moved(models[k], dt_s, _RATES[k])
        weight = math.exp(scores[k] - best)
        total, mean, square = total + weight, mean + weight * value, square + weight * (p00 + value * value)
    mean /= total
    return mean, max(square / total - mean * mean, 1e-12)


@kernel(None, F8[:, ::1], F8[::1], F8, F8, F8)
def _update(models, scores, dt_s, measured, variance):
    """`SizeTrack.update` of every model (K, 5) and its score (K,), the logarithm of its weight."""
    for k in range(len(scores)):
        value, rate, p00, p01, p11 = _moved(models[k], dt_s, _RATES[k])
        spread, off = p00 + variance, measured - value
        scores[k] *= 1.0 - 1.0 / _MEMORY
        scores[k] -= 0.5 * (math.log(spread) + (_TAILS + 1.0) * math.log(1.0 + off * off / spread / _TAILS))
        gain, turn = p00 / spread, p01 / spread
        models[k, 0], models[k, 1] = value + gain * off, rate + turn * off
        models[k, 2], models[k, 3], models[k, 4] = (1.0 - gain) * p00, (1.0 - gain) * p01, p11 - turn * p01
