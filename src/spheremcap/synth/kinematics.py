"""Paths of markers: the real joint paths of a wheelchair racer, and simple smooth ones.

A path takes times (N,) in seconds and gives positions (N, 3) in metres in the optical frame of the camera at
rest (x right, y down, z forward). The racer's joints come from `racing_kinematics.json`: six harmonics a
joint, fitted to optical motion capture of the Kinetics Toolkit project (Apache-2.0), in the chair's frame (x
forward, y to the athlete's left, z up).

The camera sits above the front wheel and looks back at the athlete, 10 degrees down, 0.57 m above the wheel's
marker. Measured with it and with the narrow lens, over one push cycle (`tests/synth/test_kinematics.py`): a
wrist moves at up to 6.6 m/s and 28.5 px a frame at 240 fps, a 4 cm marker on it has r = 17-24 px while in the
picture, and it is out of the picture for 15.5 % of the cycle; elbows and shoulders stay inside.
"""

import json
from collections.abc import Callable
from functools import cache
from importlib.resources import files

import numpy as np
import numpy.typing as npt

from spheremcap.synth.motion import harmonics

FloatArray = npt.NDArray[np.float64]
Path = Callable[[FloatArray], FloatArray]
"""Times (N,) in seconds -> positions (N, 3) in metres, optical frame."""

CAMERA_XYZ_CHAIR_M = (1.25, 0.0, 0.30)
CAMERA_DOWN_RAD = float(np.radians(10.0))
_CAMERA_AXES = np.array(
    [
        [0.0, 1.0, 0.0],  # Looking back, the athlete's left is on the picture's right.
        [np.sin(CAMERA_DOWN_RAD), 0.0, -np.cos(CAMERA_DOWN_RAD)],
        [-np.cos(CAMERA_DOWN_RAD), 0.0, -np.sin(CAMERA_DOWN_RAD)],
    ]
)
"""The camera's right, down and forward in the chair's frame."""
JOINTS = ("left_wrist", "right_wrist", "left_elbow", "right_elbow", "left_shoulder", "right_shoulder")
LEFT_LAG_S = 0.012
"""How far the mirrored left joints lag behind the right ones: no athlete pushes with both hands at once."""


@cache
def _joint(name: str) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    data = json.loads((files(__package__) / "racing_kinematics.json").read_text(encoding="utf-8"))
    joint = data["markers"][name]
    c0, a, b = (np.array(joint[key], np.float64) for key in ("c0", "a", "b"))
    return float(data["cadence_hz"]), c0, a, b


def cadence_hz() -> float:
    """Push cycles per second of the recorded athlete."""
    return _joint("right_wrist")[0]


def joint_chair_m(name: str, t_s: FloatArray) -> FloatArray:
    """Positions (N, 3) of a joint in the chair's frame at times (N,).

    The recording has no left wrist and shoulder: they, and the left elbow for consistency, are the right ones
    mirrored (y -> -y) and `LEFT_LAG_S` later.
    """
    left = name.startswith("left_")
    cadence, c0, a, b = _joint(name.replace("left_", "right_"))
    t = np.asarray(t_s, np.float64) - (LEFT_LAG_S if left else 0.0)
    xyz: FloatArray = harmonics(np.ascontiguousarray(t), cadence, c0, a, b)
    if left:
        xyz[:, 1] *= -1
    return xyz


def chair_to_camera(xyz_chair_m: FloatArray) -> FloatArray:
    """Positions (N, 3) from the chair's frame to the optical frame of the mounted camera."""
    out: FloatArray = (np.asarray(xyz_chair_m, np.float64) - CAMERA_XYZ_CHAIR_M) @ _CAMERA_AXES.T
    return out


def joint_path(name: str, start_s: float = 0.0) -> Path:
    """The path of a joint as the mounted camera sees it; `start_s` is where in the cycle time 0 is."""
    return lambda t_s: chair_to_camera(joint_chair_m(name, np.asarray(t_s, np.float64) + start_s))


def wave(t_s: FloatArray, amplitude: float, frequency_hz: float, phase_rad: float = 0.0) -> FloatArray:
    """amplitude * sin(2 pi frequency t + phase), (N,)."""
    out: FloatArray = amplitude * np.sin(2 * np.pi * frequency_hz * np.asarray(t_s, np.float64) + phase_rad)
    return out


def smooth_step(t_s: FloatArray) -> FloatArray:
    """0 before 0, 1 after 1, with zero velocity and acceleration at both ends (minimum jerk), (N,)."""
    s = np.clip(t_s, 0.0, 1.0)
    out: FloatArray = s**3 * (10 - 15 * s + 6 * s * s)
    return out


def through(times_s: FloatArray, points: FloatArray, move_s: float) -> Callable[[FloatArray], FloatArray]:
    """Hold points[k] (K, D) from times_s[k] on, moving to it in the `move_s` seconds before: t (N,) -> (N,
    D).
    """
    times, values = np.asarray(times_s, np.float64), np.asarray(points, np.float64)

    def at(t_s: FloatArray) -> FloatArray:
        t = np.asarray(t_s, np.float64)
        out = np.repeat(values[:1], len(t), axis=0)
        for k in range(1, len(times)):
            out = out + smooth_step((t - times[k] + move_s) / move_s)[:, None] * (values[k] - values[k - 1])
        return out

    return at
