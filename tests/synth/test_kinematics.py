"""The racer moves as issue 3 says racers do."""

import numpy as np
import pytest

from spheremcap.synth.kinematics import cadence_hz, chair_to_camera, joint_chair_m, joint_path, through
from spheremcap.synth.scenarios import NARROW

CYCLE_S = np.arange(0, 1 / cadence_hz(), 1 / 240)


def test_wrist_speed_size_and_time_out_of_view():
    xyz = joint_path("right_wrist")(CYCLE_S)
    speed = np.linalg.norm(np.diff(xyz, axis=0), axis=1) * 240
    assert 6.0 < speed.max() < 7.0
    pixel = NARROW.project(xyz)
    inside = (np.abs(pixel - (639.5, 359.5)) < (640, 360)).all(axis=1)
    assert 0.10 <= 1 - inside.mean() <= 0.20
    r_px = 0.02 * NARROW.fx_px / np.linalg.norm(xyz, axis=1)[inside]
    assert 16 <= r_px.min() < r_px.max() <= 35
    step = np.linalg.norm(np.diff(pixel, axis=0), axis=1)[inside[1:] & inside[:-1]]
    assert 25 <= step.max() <= 35


@pytest.mark.parametrize("joint", ["left_elbow", "right_elbow", "left_shoulder", "right_shoulder"])
def test_elbows_and_shoulders_stay_in_view(joint):
    pixel = NARROW.project(joint_path(joint)(CYCLE_S))
    inside = (np.abs(pixel - (639.5, 359.5)) < (640, 360)).all(axis=1)
    assert inside.mean() > 0.95


def test_left_mirrors_right_and_the_mount_keeps_distances():
    later = CYCLE_S + 0.012
    np.testing.assert_allclose(
        joint_chair_m("left_wrist", later), joint_chair_m("right_wrist", CYCLE_S) * (1, -1, 1), atol=1e-12
    )
    chair = joint_chair_m("right_elbow", CYCLE_S)
    camera = chair_to_camera(chair)
    np.testing.assert_allclose(
        np.linalg.norm(camera - camera[0], axis=1), np.linalg.norm(chair - chair[0], axis=1), atol=1e-12
    )
    # x right, y down, z forward: the athlete's left is on the picture's right, higher is less y.
    assert chair_to_camera(np.array([[0.0, 0.3, 0.3]]))[0, 0] > 0
    assert np.diff(chair_to_camera(np.array([[0.3, 0, 0.1], [0.3, 0, 0.2]]))[:, 1])[0] < 0


def test_through_holds_and_moves():
    at = through(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [1.0], [3.0]]), 0.5)
    np.testing.assert_allclose(at(np.array([0.4, 1.0, 1.49, 1.75, 2.0, 9.0]))[:, 0], (0, 1, 1, 2, 3, 3))
