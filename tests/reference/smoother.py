"""The jerk that wanders, filtered and smoothed as a textbook has it, in seconds: the compiled one must equal it."""

import math

import numpy as np


def transition(dt_s, density):
    """F (12, 12) of the state p, v, a, j of three axes each, and what white snap adds to its covariance."""
    f = np.array([[dt_s ** (n - m) / math.factorial(n - m) if n >= m else 0.0 for n in range(4)] for m in range(4)])
    q = np.empty((4, 4))
    for m in range(4):
        for n in range(4):
            power = 7 - m - n
            q[m, n] = density * dt_s**power / (power * math.factorial(3 - m) * math.factorial(3 - n))
    return np.kron(f, np.eye(3)), np.kron(q, np.eye(3))


def begun(xyz_m, start_sd):
    """State and covariance at a measured place of whose motion nothing is known."""
    return np.concatenate([xyz_m, np.zeros(9)]), np.diag(np.repeat(np.square(start_sd), 3))


def updated(x, p, z, r):
    """State and covariance with a position z of covariance r, and the logarithm of its likelihood."""
    h = np.eye(3, 12)
    s = h @ p @ h.T + r
    gain = p @ h.T @ np.linalg.inv(s)
    y = z - h @ x
    log = -0.5 * (y @ np.linalg.solve(s, y) + np.linalg.slogdet(s)[1])
    rest = np.eye(12) - gain @ h
    return x + gain @ y, rest @ p @ rest.T + gain @ r @ gain.T, log  # Joseph's form


def likelihood(t_s, xyz_m, covariance_m2, density, start_sd):
    """The logarithm of the likelihood of the measured positions (NaN: none), up to a constant."""
    total, last = 0.0, None
    for t, z, r in zip(t_s, xyz_m, covariance_m2, strict=True):
        if np.isnan(z[0]):
            continue
        if last is None:
            x, p = begun(z, start_sd)
        else:
            f, q = transition(t - last, density)
            x, p = f @ x, f @ p @ f.T + q
        last = t
        x, p, log = updated(x, p, z, r)
        total += log
    return total


def smooth(t_s, xyz_m, covariance_m2, density, start_sd):
    """Smoothed states (N, 12) and covariances (N, 12, 12) at the times (Rauch, Tung, Striebel 1965)."""
    first = int(np.flatnonzero(np.isfinite(xyz_m[:, 0]))[0])
    x, p = begun(xyz_m[first], start_sd)
    states, spreads, ahead = [], [], []
    for k, (z, r) in enumerate(zip(xyz_m, covariance_m2, strict=True)):
        if k:
            f, q = transition(t_s[k] - t_s[k - 1], density)
            x, p = f @ x, f @ p @ f.T + q
            ahead.append((f, x, p))
        if np.isfinite(z[0]):
            x, p, _ = updated(x, p, z, r)
        states.append(x)
        spreads.append(p)
    for k in range(len(states) - 2, -1, -1):
        f, x, p = ahead[k]
        gain = spreads[k] @ f.T @ np.linalg.inv(p)
        states[k] = states[k] + gain @ (states[k + 1] - x)
        spreads[k] = spreads[k] + gain @ (spreads[k + 1] - p) @ gain.T
    return np.array(states), np.array(spreads)
