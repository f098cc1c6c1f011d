"""Curves of both arms from simulated markers, and what lengths say of the markers."""

import numpy as np
import pytest
from simulated import simulated

from spheremcap.analysis.curves import curves_of, segment_length
from spheremcap.analysis.smoother import Smoother
from spheremcap.synth.strokes import FOREARM_M, UPPER_ARM_M

JOINTS = ("wrist", "elbow", "shoulder")


@pytest.fixture(scope="module")
def made():
    return simulated(seconds=2.5)


@pytest.fixture(scope="module")
def smoothers(made):
    return {(side, joint): Smoother(made.in_chair(side, joint)) for side in ("left", "right") for joint in JOINTS}


@pytest.fixture(scope="module")
def curves(smoothers):
    return curves_of(smoothers, {key: s.track.measured for key, s in smoothers.items()}, chair=True)


def true_angles(made, side):
    wrist, elbow, shoulder = (made.true(side, joint) for joint in JOINTS)
    a, b = wrist - elbow, shoulder - elbow
    cos = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)

    def above(d):
        return np.degrees(np.arctan2(d[:, 2], np.hypot(d[:, 0], d[:, 1])))

    return {"elbow_deg": np.degrees(np.arccos(cos)), "forearm_elevation_deg": above(elbow - wrist),
            "upper_arm_elevation_deg": above(shoulder - elbow)}  # fmt: skip


@pytest.mark.parametrize("side", ["left", "right"])
def test_angles_speeds_and_lengths_are_true_within_what_is_said(made, curves, side):
    arm, part = curves[0][side], slice(20, -20)
    speed = np.linalg.norm(getattr(made.motion, side)._wrist(made.t_s, 1), axis=1)
    true = {**true_angles(made, side), "speed_mps": speed}
    for name, values in true.items():
        field, _, unit = name.rpartition("_")
        error, sd = arm.values[name] - values, arm.values[f"{field}_sd_{unit}"]
        # A speed that changes within milliseconds, as at contact, is smoothed over
        assert np.sqrt(np.mean((error / sd)[part] ** 2)) < (3 if name == "speed_mps" else 2), name
        assert np.median(np.abs(error[part])) < (0.8 if unit == "deg" else 0.08), name
    assert np.median(arm.values["forearm_m"]) == pytest.approx(FOREARM_M, abs=0.001)
    assert np.median(arm.values["upper_arm_m"]) == pytest.approx(UPPER_ARM_M, abs=0.001)
    np.testing.assert_allclose(arm.xyz_m[part], made.true(side, "wrist")[part], atol=0.008)
    assert (arm.marker, arm.side) == (f"{side}_wrist", side)


def test_the_trunk_is_told_by_both_shoulders(made, curves):
    values = curves[1].values
    left, right = made.true("left", "shoulder"), made.true("right", "shoulder")
    np.testing.assert_allclose(
        np.median(values["shoulders_m"]), np.median(np.linalg.norm(left - right, axis=1)), atol=2e-3
    )
    up = np.degrees(np.arctan2((left - right)[:, 2], np.hypot(*(left - right)[:, :2].T)))
    assert np.abs(values["tilt_deg"] - up).max() < 1.5
    assert "lean_deg" not in values  # nobody marked the hips


def test_values_are_only_where_markers_may_be_used(smoothers):
    may_use = {key: s.track.measured.copy() for key, s in smoothers.items()}
    may_use["left", "wrist"][100:110] = False
    may_use["left", "elbow"][200:210] = False
    arms, _ = curves_of(smoothers, may_use, chair=True)
    arm = arms["left"]
    assert np.isnan(arm.xyz_m[100:110]).all()
    assert np.isnan(arm.velocity_mps[100:110]).all()
    assert np.isnan(arm.packed[100:110]).all()
    for name in ("speed_mps", "forearm_m", "elbow_deg"):
        assert np.isnan(arm.values[name][100:110]).all(), name
        assert np.isnan(arm.values[name][200:210]).all() is np.bool_(name != "speed_mps"), name
    assert np.isfinite(arm.values["upper_arm_m"][100:110]).all()
    assert np.isfinite(arms["right"].values["speed_mps"]).all()


def test_without_a_chair_nothing_is_told_that_needs_up(smoothers):
    arms, trunk = curves_of(smoothers, {key: s.track.measured for key, s in smoothers.items()}, chair=False)
    assert {name for name in arms["left"].values if "elevation" in name} == set()
    assert "elbow_deg" in arms["left"].values
    assert set(trunk.values) == {"shoulders_m", "shoulders_sd_m"}


def test_a_wrist_alone_has_speeds_and_no_trunk(smoothers):
    one = {("right", "wrist"): smoothers["right", "wrist"]}
    arms, trunk = curves_of(one, {key: s.track.measured for key, s in one.items()}, chair=True)
    assert (list(arms), trunk) == (["right"], None)
    assert {name.split("_")[0] for name in arms["right"].values} == {"speed", "acceleration", "jerk"}
    assert curves_of({}, {}, chair=True) == ({}, None)


T = np.arange(0, 40, 0.01)


def lengths(change, noise=0.001, seed=0):
    rng = np.random.default_rng(seed)
    return (0.3 + change + noise * rng.standard_normal(len(T))).astype(np.float32), np.full(len(T), noise, np.float32)


def test_a_constant_length_is_called_one():
    found = segment_length("forearm", T, *lengths(0 * T))
    assert found.constant
    assert found.frames == len(T)
    assert found.median_m == pytest.approx(0.3, abs=1e-4)
    assert found.spread == pytest.approx(0.001 / 0.3, rel=0.1)
    assert found.noise == pytest.approx(0.001 / 0.3, rel=0.01)
    assert found.drift < 0.001


def test_a_drift_and_a_marker_that_slips_are_seen():
    drifting = segment_length("forearm", T, *lengths(0.01 * T / 40))
    assert drifting.drift == pytest.approx(0.005 / 0.3, rel=0.2)
    slipping = segment_length("forearm", T, *lengths(0.02 * np.sin(7 * T)))
    assert not slipping.constant
    assert slipping.spread > 0.04


def test_gaps_and_too_few_frames():
    length, sd = lengths(0 * T)
    length[::2] = np.nan
    assert segment_length("forearm", T, length, sd).frames == len(T) // 2
    length[9 * 2 :] = np.nan
    few = segment_length("forearm", T, length, sd)
    assert (few.frames, few.median_m, few.spread, few.constant) == (9, None, None, True)
