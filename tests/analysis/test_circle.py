"""The push's circle in a wrist's path of which nothing else is known."""

import numpy as np
import pytest
from simulated import CAMERA, MOUNT, simulated

from spheremcap.analysis.chair import Known
from spheremcap.analysis.circle import push_circle
from spheremcap.analysis.rim import Wheel
from spheremcap.analysis.smoother import Smoother

SIDES = ("left", "right")


@pytest.fixture(scope="module")
def made():
    return simulated()


def circle_of(made, side, *, rim_radius_m=0.18, wheel=True):
    track = made.in_camera(side, "wrist")
    motion = Smoother(track).motion(slice(0, len(track)))
    wheels = made.motion.wheels
    known = Known(CAMERA, looks_back=True, down_rad=(MOUNT.down_rad, 0.01))
    plane = Wheel.of(side, 0.0, wheels.camber_rad).axes @ known.roughly()
    turning = made.motion.rate_rad_s(track.t_s) if wheel else None
    return push_circle(track.t_s, motion.xyz_m, motion.velocity_mps, plane, rim_radius_m, turning), plane


@pytest.mark.parametrize("wheel", [True, False])
@pytest.mark.parametrize("side", SIDES)
def test_the_hub_is_found_in_the_pushes(made, side, wheel):
    circle, plane = circle_of(made, side, wheel=wheel)
    wheels = made.motion.wheels
    arm = getattr(made.motion, side)
    hub = MOUNT.to_camera(arm.in_chair(np.array([[0.0, 0.0, wheels.outward_m]])))[0]
    off = plane @ (circle.centre_cam_m - hub)
    assert np.abs(off).max() < 0.012
    assert circle.radius_m == pytest.approx(wheels.wrist_radius_m, abs=0.008)
    assert 10 < len(circle.xyz_cam_m) <= 1200
    np.testing.assert_allclose(np.linalg.norm((circle.xyz_cam_m - circle.centre_cam_m) @ plane[:2].T, axis=1),
                               circle.radius_m, atol=0.02)  # fmt: skip
    assert circle.weight_per_m > circle.plane_weight_per_m > 0


def test_a_path_without_pushes_has_no_circle(made):
    track = made.in_camera("left", "shoulder")
    motion = Smoother(track).motion(slice(0, len(track)))
    plane = Wheel.of("left", 0.0, 0.19).axes @ Known(CAMERA).roughly()
    assert push_circle(track.t_s, motion.xyz_m, motion.velocity_mps, plane, 0.18) is None
    assert circle_of(made, "left", rim_radius_m=0.35)[0] is None


def test_it_is_the_same_each_time(made):
    one, other = (circle_of(made, "left")[0] for _ in range(2))
    np.testing.assert_array_equal(one.centre_cam_m, other.centre_cam_m)
