"""Where things are at a time, in compiled loops: a recorded joint, the shaking mount, a sphere's outline."""

import math

import numpy as np

from spheremcap.core.compiled import F8, array, inner, kernel
from spheremcap.core.lens import pixel_of

_LINE, _TABLE = array(F8, 1), array(F8, 2)


@kernel(None, _LINE, F8, _LINE, _TABLE, _TABLE)
def harmonics(t_s, cadence_hz, c0, a, b):
    """c0 + sum over k of a_k cos(k w t) + b_k sin(k w t), (N, 3), at times (N,); c0 (3,), a and b (K, 3)."""
    out = np.empty((len(t_s), 3))
    for i in range(len(t_s)):
        angle = 2.0 * math.pi * cadence_hz * t_s[i]
        cos, sin = math.cos(angle), math.sin(angle)
        c, s = 1.0, 0.0
        x, y, z = c0[0], c0[1], c0[2]
        for k in range(len(a)):
            c, s = c * cos - s * sin, s * cos + c * sin
            x += c * a[k, 0] + s * b[k, 0]
            y += c * a[k, 1] + s * b[k, 1]
            z += c * a[k, 2] + s * b[k, 2]
        out[i, 0], out[i, 1], out[i, 2] = x, y, z
    return out


@inner
def _sway(t_s, frequencies_hz, step, start):
    """sum over k of sin(2 pi f_k t + axis * step + start) / (k + 1) for the axes 0, 1, 2."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(len(frequencies_hz)):
        phase = 2.0 * math.pi * frequencies_hz[k] * t_s + start
        x += math.sin(phase) / (k + 1.0)
        y += math.sin(phase + step) / (k + 1.0)
        z += math.sin(phase + 2.0 * step) / (k + 1.0)
    return x, y, z


@kernel(None, _LINE, _LINE, F8, F8)
def shaking(t_s, frequencies_hz, rotation_rad, translation_m):
    """Rotation vectors (N, 3) in radians and translations (N, 3) in metres of the mount at times (N,)."""
    turn, shift = np.empty((len(t_s), 3)), np.empty((len(t_s), 3))
    for i in range(len(t_s)):
        a, b, c = _sway(t_s[i], frequencies_hz, 2.1, 0.0)
        turn[i, 0], turn[i, 1], turn[i, 2] = a * rotation_rad, b * rotation_rad, c * rotation_rad
        x, y, z = _sway(t_s[i], frequencies_hz, 1.3, 0.7)
        shift[i, 0], shift[i, 1], shift[i, 2] = x * translation_m, y * translation_m, z * translation_m
    return turn, shift


@kernel(None, _TABLE, _LINE, _LINE, F8, F8)
def shaken(xyz_cam_m, t_s, frequencies_hz, rotation_rad, translation_m):
    """Positions (N, 3) from the resting camera's frame into the shaking camera's: p + turn x p + shift."""
    out = np.empty((len(t_s), 3))
    for i in range(len(t_s)):
        x, y, z = xyz_cam_m[i, 0], xyz_cam_m[i, 1], xyz_cam_m[i, 2]
        a, b, c = _sway(t_s[i], frequencies_hz, 2.1, 0.0)
        a, b, c = a * rotation_rad, b * rotation_rad, c * rotation_rad
        u, v, w = _sway(t_s[i], frequencies_hz, 1.3, 0.7)
        out[i, 0] = x + u * translation_m + (b * z - c * y)
        out[i, 1] = y + v * translation_m + (c * x - a * z)
        out[i, 2] = z + w * translation_m + (a * y - b * x)
    return out


@kernel(None, _TABLE, F8, _LINE)
def touched(centres_cam_m, radius_m, camera):
    """Pixels (N, 2) of the rays that touch spheres with centres (N, 3), at the angles 2 pi k / N around their axes;
    NaN where the lens has no pixel. `camera` is `Camera.params`."""
    count = len(centres_cam_m)
    out = np.empty((count, 2))
    for k in range(count):
        phi = 2.0 * math.pi * k / count
        x, y, z = centres_cam_m[k, 0], centres_cam_m[k, 1], centres_cam_m[k, 2]
        distance = math.sqrt(x * x + y * y + z * z)
        sin = radius_m / distance
        cos = math.sqrt(1.0 - sin * sin)
        x, y, z = x / distance, y / distance, z / distance
        across = math.hypot(x, z)
        # right = (0, 1, 0) x axis and down = axis x right, both of unit length
        right, down = sin * math.cos(phi) / across, sin * math.sin(phi) / across
        u = cos * x + right * z - down * x * y
        v = cos * y + down * across * across
        w = cos * z - right * x - down * y * z
        out[k, 0], out[k, 1] = pixel_of(camera, u, v, w)
    return out
