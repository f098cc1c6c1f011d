"""The smoother as filterpy has it, which the compiled one must equal."""

from itertools import pairwise

import numpy as np
from filterpy.kalman import rts_smoother

from spheremcap.core.time import NS_PER_S
from spheremcap.positioning.kalman import Moment, transition


def smooth(moments, config):
    """Rauch-Tung-Striebel smoothing of filtered moments in order of time; a widened prediction is process noise."""
    if len(moments) < 2:
        return list(moments)
    steps = []
    for a, b in pairwise(moments):
        f, q = transition((b.stamp_ns - a.stamp_ns) / NS_PER_S, config)
        steps.append((f, q + (b.widened - 1) * (f @ a.covariance @ f.T + q)))
    fs, qs = zip(*steps, steps[-1], strict=True)  # step k leads from k to k + 1; the last is never used
    states, covariances, _, _ = rts_smoother(
        np.array([m.state for m in moments]), np.array([m.covariance for m in moments]), list(fs), list(qs)
    )
    return [Moment(m.stamp_ns, x, (p + p.T) / 2) for m, x, p in zip(moments, states, covariances, strict=True)]
