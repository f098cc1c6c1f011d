"""The distance by size with matrices: what the loops of positioning/size.py must equal."""

import math

import numpy as np
from scipy.integrate import quad_vec

KEEPS_S, MEMORY, TAILS = 0.6, 30.0, 4.0


def moved(mean, covariance, dt_s, usual):
    """A value and its rate (2,), an Ornstein-Uhlenbeck process, after `dt_s`, with its noise integrated."""

    def turn(s):
        return np.array([[1.0, KEEPS_S * (1 - math.exp(-s / KEEPS_S))], [0.0, math.exp(-s / KEEPS_S)]])

    push = np.array([[0.0, 0.0], [0.0, 2 * usual**2 / KEEPS_S]])
    noise, _ = quad_vec(lambda s: turn(s) @ push @ turn(s).T, 0.0, dt_s)
    f = turn(dt_s)
    return f @ mean, f @ covariance @ f.T + noise


class Reference:
    """One model a usual rate, as `SizeTrack`."""

    def __init__(self, rates):
        self.rates, self.scores = rates, np.zeros(len(rates))

    def start(self, range_m, sd):
        self.models = [(np.array([math.log(range_m), 0.0]), np.diag([sd**2, r**2])) for r in self.rates]

    def expect(self, dt_s):
        later = [moved(*model, dt_s, rate) for model, rate in zip(self.models, self.rates, strict=True)]
        weights = np.exp(self.scores - self.scores.max())
        weights /= weights.sum()
        means, variances = np.array([m[0] for m, _ in later]), np.array([p[0, 0] for _, p in later])
        mean = weights @ means
        return math.exp(mean), math.sqrt(weights @ (variances + (means - mean) ** 2))

    def update(self, dt_s, range_m, sd):
        for k, rate in enumerate(self.rates):
            mean, covariance = moved(*self.models[k], dt_s, rate)
            h = np.array([[1.0, 0.0]])
            spread = float((h @ covariance @ h.T)[0, 0]) + sd**2
            off = math.log(range_m) - mean[0]
            likely = -0.5 * math.log(spread) - 0.5 * (TAILS + 1) * math.log1p(off**2 / spread / TAILS)
            self.scores[k] = (1 - 1 / MEMORY) * self.scores[k] + likely
            gain = (covariance @ h.T)[:, 0] / spread
            self.models[k] = mean + gain * off, covariance - np.outer(gain, h @ covariance)
