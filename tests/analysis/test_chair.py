"""The chair's frame from each thing that tells it, and what it says of itself."""

import numpy as np
import pytest
from simulated import CAMERA, MOUNT, measured, simulated
from test_circle import circle_of

from spheremcap.analysis.chair import Known, chair_frame
from spheremcap.core.chair import ChairClick
from spheremcap.errors import UsageError
from spheremcap.synth.ride import wheel_points

XYZ, DOWN = MOUNT.xyz_chair_m, MOUNT.down_rad
INCLINOMETER = (DOWN, float(np.radians(0.5)))


@pytest.fixture(scope="module")
def made():
    return simulated()


def clicks_of(made, *, noise_px=0.7, sides=("left", "right"), axle=True, seed=0, camera=CAMERA):
    rng = np.random.default_rng(seed)
    clicks = []
    for side, points in wheel_points(made.motion, MOUNT, camera).items():
        if side not in sides:
            continue
        rim = points.rim_px[np.isfinite(points.rim_px[:, 0])][::2]
        rim = rim + noise_px * rng.standard_normal(rim.shape)
        clicks += [ChairClick(f"{side}_rim", 0, *map(float, place)) for place in rim]
        if axle:
            clicks.append(ChairClick(f"{side}_axle", 0, *map(float, points.hub_px + noise_px * rng.standard_normal(2))))
    return clicks


def points_of(made, places=((0.5, 0.1, 0.1), (0.4, -0.15, 0.2), (0.1, 0.25, 0.35)), seed=0):
    rng = np.random.default_rng(seed)
    out = []
    for place in places:
        xyz, covariance = measured(MOUNT.to_camera(np.array([place])), rng)
        out.append((xyz[0], covariance[0], place, 0.002))
    return out


def off_in_sd(frame):
    """How far turn and place are off the truth, in their own standard deviations, (6,)."""
    turn = frame.rotation @ MOUNT.axes  # a small one, about the chair's axes
    angles = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    off = np.concatenate([angles, frame.camera_xyz_chair_m - XYZ])
    return off / np.sqrt(np.diag(frame.covariance)), off


def ways(made):
    wheels = made.motion.wheels
    usual = {"rim_radius_m": wheels.rim_radius_m, "camber_rad": wheels.camber_rad, "half_track_m": (0.3, 0.0025)}
    circles = {side: circle_of(made, side)[0] for side in ("left", "right")}
    return {
        "tape measure": Known(CAMERA, camera_xyz_chair_m=(XYZ, 0.005), down_rad=INCLINOMETER),
        "clicks": Known(CAMERA, clicks=clicks_of(made), **usual),
        "clicks of one wheel": Known(CAMERA, clicks=clicks_of(made, sides=("left",)), looks_back=True, **usual),
        "markers on the chair": Known(CAMERA, points=points_of(made)),
        "pushes": Known(CAMERA, circles=circles, down_rad=INCLINOMETER, **usual),
        "all": Known(
            CAMERA, camera_xyz_chair_m=(XYZ, 0.005), down_rad=INCLINOMETER, clicks=clicks_of(made),
            points=points_of(made), circles=circles, **usual,
        ),
    }  # fmt: skip


@pytest.mark.parametrize(
    "way", ["tape measure", "clicks", "clicks of one wheel", "markers on the chair", "pushes", "all"]
)
def test_the_camera_is_where_it_is_within_what_is_said(made, way):
    known = ways(made)[way]
    frame = chair_frame(known)
    z, off = off_in_sd(frame)
    assert np.abs(z).max() < 3
    assert np.abs(off[3:]).max() < 0.05
    assert np.degrees(np.abs(off[:3])).max() < 6
    assert frame.upright is (way != "clicks of one wheel")  # a circle is the same however it is turned
    assert frame.misfit < 2
    assert set(frame.told_by) == set(known.told_by())
    assert np.linalg.eigvalsh(frame.covariance).min() > 0
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-9)
    # What is in the camera's frame is put where it is
    np.testing.assert_allclose(frame.place(MOUNT.to_camera(np.array([[0.0, 0.3, 0.0]]))), [[0, 0.3, 0]], atol=0.06)


def test_clicks_tell_the_place_to_millimetres_through_the_lens_distortion(made):
    usual = {"rim_radius_m": 0.18, "camber_rad": made.motion.wheels.camber_rad, "half_track_m": (0.3, 0.0025)}
    frame = chair_frame(Known(CAMERA, clicks=clicks_of(made, noise_px=0.3), **usual))
    assert np.abs(off_in_sd(frame)[1][3:]).max() < 0.015
    bare = type(CAMERA)(1280, 720, 1150.0, 1150.0, 639.5, 359.5)
    blind = chair_frame(Known(bare, clicks=clicks_of(made, noise_px=0.3), **usual))
    assert blind.misfit > 2 * frame.misfit


def test_more_that_is_known_makes_it_surer(made):
    several = ways(made)
    spread = {way: np.diag(chair_frame(known).covariance) for way, known in several.items()}
    for way in ("tape measure", "clicks", "pushes"):
        assert (spread["all"] < spread[way] * 1.5).all()
    assert spread["all"].sum() < 0.5 * min(spread["tape measure"].sum(), spread["pushes"].sum())


def test_nothing_that_tells_the_axle_is_refused(made):
    with pytest.raises(UsageError, match=r"nothing tells where the axle is: give chair\.camera_xyz_chair_m"):
        chair_frame(Known(CAMERA, down_rad=INCLINOMETER, half_track_m=(0.3, 0.01)))
    with pytest.raises(UsageError, match=r"give wheel\.rim_radius_m"):
        chair_frame(Known(CAMERA, clicks=clicks_of(made)))


def test_without_any_tilt_it_is_not_upright(made):
    """One circle about an axle says nothing of how the camera is turned about that axle."""
    circles = {"left": circle_of(made, "left")[0]}
    frame = chair_frame(Known(CAMERA, rim_radius_m=0.18, camber_rad=0.192, circles=circles, looks_back=True))
    assert not frame.upright
    assert np.degrees(frame.tilt_sd_rad) > 3
    assert frame.hub_sd_m() > 0


def test_a_contradiction_is_a_misfit(made):
    usual = {"rim_radius_m": 0.18, "camber_rad": made.motion.wheels.camber_rad, "half_track_m": (0.3, 0.0025)}
    wrong = (XYZ[0], XYZ[1], XYZ[2] + 0.15)
    frame = chair_frame(Known(CAMERA, clicks=clicks_of(made), camera_xyz_chair_m=(wrong, 0.005), **usual))
    assert frame.misfit > 3
    calm = chair_frame(Known(CAMERA, clicks=clicks_of(made), camera_xyz_chair_m=(XYZ, 0.005), **usual))
    assert calm.misfit < 1.5
    assert np.trace(frame.covariance) > np.trace(calm.covariance)


def test_a_camera_that_looks_forward_is_told_by_left_and_right():
    there = {"left_axle": 300.0, "right_axle": 900.0}
    clicks = [ChairClick(on, 0, x, 360.0) for on, x in there.items()]
    known = Known(CAMERA, clicks=clicks, half_track_m=(0.3, 0.01))
    forward = chair_frame(known)
    assert forward.rotation[0, 2] > 0.9  # its axis is the chair's x
    assert forward.camera_xyz_chair_m[0] < 0  # and it is behind the axle
    swapped = [ChairClick(on.on, 0, 1279 - on.x_px, on.y_px) for on in clicks]
    back = chair_frame(Known(CAMERA, clicks=swapped, half_track_m=(0.3, 0.01)))
    assert back.rotation[0, 2] < -0.9
    assert back.camera_xyz_chair_m[0] > 0
    told = chair_frame(Known(CAMERA, camera_xyz_chair_m=((-1.0, 0.0, 0.5), 0.01), looks_back=False))
    np.testing.assert_allclose(told.rotation[:, 0], (0, -1, 0), atol=1e-6)  # the picture's right is the athlete's


def test_covariances_are_turned_with_the_frame(made):
    frame = chair_frame(ways(made)["tape measure"])
    covariance = np.diag([1.0, 2.0, 9.0])[None]
    turned = frame.turn(covariance)[0]
    np.testing.assert_allclose(turned, frame.rotation @ covariance[0] @ frame.rotation.T)
    ahead = frame.rotation[:, 2]
    assert ahead @ turned @ ahead == pytest.approx(9.0)
