"""Angles and lengths of known triangles; their standard deviations against what scattered positions make of them."""

import numpy as np
import pytest

from spheremcap.analysis import arms
from spheremcap.analysis.arms import Joint
from spheremcap.analysis.smoother import Motion

RNG = np.random.default_rng(3)
DRAWS = 20_000


def joint(xyz, covariance=None, *, there=None, name="m"):
    xyz = np.atleast_2d(np.asarray(xyz, np.float64))
    spread = np.zeros((len(xyz), 3, 3)) + (0.0 if covariance is None else covariance)
    zero = np.zeros((len(xyz), 3))
    motion = Motion(xyz, zero, zero, zero, spread, spread, spread, spread)
    use = np.ones(len(xyz), np.bool_) if there is None else np.array(there)
    return Joint(name, motion, use, use)


WRIST, ELBOW, SHOULDER = (0.1, 0.3, 0.2), (-0.1, 0.35, 0.35), (0.0, 0.2, 0.6)
HIPS = (-0.05, 0.12, 0.1), (-0.05, -0.12, 0.12)
SHOULDERS = (0.05, 0.2, 0.6), (0.06, -0.2, 0.63)


def test_a_straight_arm_has_180_degrees_and_a_right_angle_90():
    found = arms.joint_angle(
        joint([(0.3, 0, 0), (0, 0.3, 0), (0.3, 0, 0)]), joint(np.zeros((3, 3))),
        joint([(-0.2, 0, 0), (0.4, 0, 0), (0.1, 0, 0.1)]),
    )  # fmt: skip
    np.testing.assert_allclose(found.value, (180, 90, 45), atol=1e-9)


def test_elevations_lean_and_tilt_have_the_signs_that_they_say():
    up = arms.elevation(joint([(0, 0, 0)] * 4), joint([(1, 0, 1), (0, 1, -1), (0, -2, 0), (1, 1, np.sqrt(2))]))
    np.testing.assert_allclose(up.value, (45, -45, 0, 45), atol=1e-9)
    hips = joint([(0, 0.1, 0)] * 3), joint([(0, -0.1, 0)] * 3)
    shoulders = (
        joint([(0.5, 0.2, 0.5), (-0.5, 0.2, 0.5), (0, 0.2, 0.4)]),
        joint([(0.5, -0.2, 0.5), (-0.5, -0.2, 0.5), (0, 0, 0.6)]),
    )
    np.testing.assert_allclose(arms.lean(hips, shoulders).value, (45, -45, 0), atol=1e-9)
    left, right = joint([(0, 0.2, 0.6)]), joint([(0, -0.2, 0.5)])
    assert arms.tilt(left, right).value[0] == pytest.approx(np.degrees(np.arctan2(0.1, 0.4)))
    assert arms.tilt(right, left).value[0] == pytest.approx(-np.degrees(np.arctan2(0.1, 0.4)))


KINDS = {
    "distance": (lambda a, b, c, *_: arms.distance(a, b), 3),
    "elevation": (lambda a, b, c, *_: arms.elevation(a, b), 3),
    "joint angle": (arms.joint_angle, 3),
    "lean": (lambda a, b, c, d: arms.lean((a, b), (c, d)), 4),
}


@pytest.mark.parametrize("kind", KINDS)
def test_standard_deviations_are_those_of_scattered_positions(kind):
    function, count = KINDS[kind]
    places = (WRIST, ELBOW, SHOULDER) if count == 3 else (*HIPS, *SHOULDERS)
    roots = [RNG.normal(0, 0.0015, (3, 3)) for _ in places]
    told = function(*(joint(xyz, root @ root.T) for xyz, root in zip(places, roots, strict=True)))
    scattered = function(
        *(joint(xyz + RNG.standard_normal((DRAWS, 3)) @ root.T) for xyz, root in zip(places, roots, strict=True))
    )
    assert told.sd[0] == pytest.approx(scattered.value.std(), rel=0.03)
    assert told.value[0] == pytest.approx(scattered.value.mean(), abs=told.sd[0] / 10)


def test_a_vectors_size_and_its_deviation():
    root = RNG.normal(0, 0.05, (3, 3))
    there = np.ones(1, np.bool_)
    told = arms.size_of(np.array([[2.0, -1.0, 2.0]]), (root @ root.T)[None], there)
    drawn = np.linalg.norm((2.0, -1.0, 2.0) + RNG.standard_normal((DRAWS, 3)) @ root.T, axis=1)
    assert told.value[0] == 3
    assert told.sd[0] == pytest.approx(drawn.std(), rel=0.03)


def test_a_value_is_there_where_all_its_markers_are():
    a, b, c, d = (
        joint(np.tile(xyz, (5, 1)), np.eye(3) * 1e-6, there=[k != n for n in range(5)])
        for k, xyz in enumerate((WRIST, ELBOW, SHOULDER, (0.3, -0.4, 0.2)))
    )
    for found, seen in (
        (arms.distance(a, b), [0, 0, 1, 1, 1]),
        (arms.elevation(a, b), [0, 0, 1, 1, 1]),
        (arms.joint_angle(a, b, c), [0, 0, 0, 1, 1]),
        (arms.lean((a, b), (c, d)), [0, 0, 0, 0, 1]),
    ):
        np.testing.assert_array_equal(np.isfinite(found.value), np.array(seen, np.bool_))
        np.testing.assert_array_equal(np.isfinite(found.sd), np.array(seen, np.bool_))
