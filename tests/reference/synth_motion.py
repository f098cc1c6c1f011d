"""The loops of `spheremcap.synth.motion` as NumPy says them: what the compiled ones must equal."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def harmonics(t_s, cadence_hz, c0, a, b):
    """c0 + sum over k of a_k cos(k w t) + b_k sin(k w t), (N, 3)."""
    angle = 2 * np.pi * cadence_hz * np.outer(t_s, np.arange(1, len(a) + 1))
    return c0 + np.cos(angle) @ a + np.sin(angle) @ b


def shaking(t_s, frequencies_hz, rotation_rad, translation_m):
    """Rotation vectors (N, 3) in radians and translations (N, 3) in metres of the mount."""
    phase = 2 * np.pi * np.outer(t_s, frequencies_hz)
    weight = 1.0 / np.arange(1, len(frequencies_hz) + 1)
    turn = np.sin(phase[:, None] + np.arange(3)[:, None] * 2.1) @ weight
    shift = np.sin(phase[:, None] + np.arange(3)[:, None] * 1.3 + 0.7) @ weight
    return turn * rotation_rad, shift * translation_m


def shaken(xyz_cam_m, t_s, frequencies_hz, rotation_rad, translation_m):
    """Positions (N, 3) in the shaking camera's frame."""
    turn, shift = shaking(t_s, frequencies_hz, rotation_rad, translation_m)
    return xyz_cam_m + shift + np.cross(turn, xyz_cam_m)


def tangent_rays(centre_cam_m: FloatArray, radius_m: float, phi_rad: FloatArray) -> FloatArray:
    """Unit rays (N, 3) that touch spheres with centres (N, 3), at the angles phi (N,) around their axes."""
    centre = np.asarray(centre_cam_m, np.float64)
    distance = np.sqrt(np.einsum("ij,ij->i", centre, centre))[:, None]
    axis = centre / distance
    # right = (0, 1, 0) x axis and down = axis x right, both of unit length, written out: np.cross is slow.
    x, y, z = axis.T
    across = np.hypot(x, z)
    right = np.stack([z / across, np.zeros_like(x), -x / across], axis=1)
    down = np.stack([-x * y / across, across, -y * z / across], axis=1)
    sin = radius_m / distance
    cos = np.sqrt(1 - sin * sin)
    rays: FloatArray = cos * axis + sin * (np.cos(phi_rad)[:, None] * right + np.sin(phi_rad)[:, None] * down)
    return rays
