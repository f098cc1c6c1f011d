"""The smoother: equal to the textbook's, and its motion is the true one within what it says."""

from dataclasses import replace

import numpy as np
import pytest

from reference import smoother as reference
from spheremcap.analysis.smoother import JointTrack, Smoother, unpacked

RATE_HZ = 240.0
ORDERS = ("xyz_m", "velocity_mps", "acceleration_mps2", "jerk_mps3")
SPREADS = ("xyz_m2", "velocity_cov", "acceleration_cov", "jerk_cov")
START_SD = (1.0, 10.0, 300.0, 2e4)
RAY = np.array([0.3, -0.2, 0.93]) / np.linalg.norm([0.3, -0.2, 0.93])
COVARIANCE = 0.0004**2 * np.eye(3) + (0.003**2 - 0.0004**2) * np.outer(RAY, RAY)
PACKED = COVARIANCE.ravel()[[0, 1, 2, 4, 5, 8]]


def cubic(t, order=0):
    """A path whose jerk is constant, and its derivatives, (N, 3)."""
    powers = np.array([[0.1, -0.4, 1.2], [2.0, 0.5, -1.5], [8.0, -6.0, 3.0], [30.0, 40.0, -25.0]])
    return np.polynomial.polynomial.polyval(t, np.polynomial.polynomial.polyder(powers, order, axis=0)).T


def track(count=400, *, seed=0, irregular=False, gaps=(), late_s=None, path=cubic):
    rng = np.random.default_rng(seed)
    stamp_s = np.arange(count) / RATE_HZ
    if irregular:
        stamp_s = np.sort(stamp_s + rng.uniform(-0.0015, 0.0015, count))
    t_s = stamp_s if late_s is None else stamp_s + late_s
    xyz = path(t_s) + rng.standard_normal((count, 3)) @ np.linalg.cholesky(COVARIANCE).T
    for gap in gaps:
        xyz[gap] = np.nan
    packed = np.tile(PACKED, (count, 1))
    packed[np.isnan(xyz[:, 0])] = np.nan
    return JointTrack("wrist", stamp_s, t_s, xyz.astype(np.float32), packed.astype(np.float32))


def wild(t):
    """Nothing a polynomial is: a hand that goes round."""
    return np.stack([0.2 * np.sin(12 * t), 0.2 * np.cos(12 * t), 0.1 * np.sin(20 * t) + t], axis=1)


def set_to(smoother, density, noise):
    smoother.density, smoother.noise = density, noise
    return smoother


def likely(t_s, xyz_m, covariance_m2, density):
    return reference.likelihood(t_s, xyz_m.astype(np.float64), covariance_m2, density, START_SD)


@pytest.mark.parametrize("density", [1e6, 1e9, 1e11])
def test_it_equals_the_textbook_with_gaps_and_irregular_times(density):
    some = track(90, irregular=True, gaps=(slice(0, 3), slice(30, 41), slice(60, 61), slice(86, 90)), path=wild)
    motion = set_to(Smoother(some), density, 1.7).motion(slice(0, 90))
    covariance = unpacked(some.packed) * 1.7**2 + 1e-12 * np.eye(3)
    states, spreads = reference.smooth(some.t_s, some.xyz_m.astype(np.float64), covariance, density, START_SD)
    for k, (order, spread) in enumerate(zip(ORDERS, SPREADS, strict=True)):
        own = slice(3 * k, 3 * k + 3)
        state, told = states[:, own], spreads[:, own, own]
        sd = np.sqrt(told[:, range(3), range(3)])
        assert (np.abs(getattr(motion, order) - state) < 1e-5 * sd).all(), order
        np.testing.assert_allclose(getattr(motion, spread), told, rtol=1e-5, atol=1e-6 * float((sd**2).max()))


def test_what_makes_positions_likely_equals_the_textbook():
    from spheremcap.analysis import smoother as own

    some = track(80, irregular=True, gaps=(slice(0, 2), slice(30, 36)), path=wild)
    smoother = Smoother(some)
    t, xyz, whiten, seen = smoother._given(slice(0, 80))
    covariance = unpacked(some.packed) + 1e-12 * np.eye(3)
    for density in (1e5, 1e8, 1e11):
        found = own._likelihood(t, xyz, whiten, seen, density * own._UNIT_S**7, own._START_SD)
        assert found == pytest.approx(likely(some.t_s, some.xyz_m, covariance, density), abs=1e-3)


def test_the_learnt_density_and_noise_are_the_likeliest():
    """Positions scatter twice as much as they say: that is found; others make the path less likely."""
    some = track(1200, path=wild, gaps=(slice(200, 230),))
    said = Smoother(replace(some, packed=some.packed / 4))
    assert said.noise == pytest.approx(2.0, rel=0.2)
    assert Smoother(some).noise == pytest.approx(1.0, rel=0.2)
    covariance = unpacked(some.packed)
    best, *others = (
        likely(some.t_s[:400], some.xyz_m[:400], covariance[:400], said.density * factor) for factor in (1, 30, 1 / 30)
    )
    assert best > max(others)


def test_velocity_acceleration_and_jerk_are_true_within_what_is_said():
    off = {name: [] for name in ORDERS}
    part = slice(60, 340)
    for seed in range(12):
        some = track(seed=seed, gaps=(slice(150, 156),))
        motion = Smoother(some).motion(slice(0, 400))
        for k, (order, spread) in enumerate(zip(ORDERS, SPREADS, strict=True)):
            error = getattr(motion, order)[part] - cubic(some.stamp_s[part], k)
            off[order].append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(getattr(motion, spread)[part]), error))
    for order, squares in off.items():
        assert 0.3 < np.sqrt(np.mean(squares) / 3) < 1.3, order
    assert np.abs(motion.velocity_mps - cubic(some.stamp_s, 1))[part].max() < 0.2
    # In one and a half seconds the filter sees far more than the noise of two neighbouring positions
    assert np.sqrt(motion.xyz_m2[part, 2, 2]).max() < 0.0025


def test_covariances_are_symmetric_and_positive_and_grow_in_gaps():
    some = track(300, gaps=(slice(100, 130),), path=wild)
    motion = Smoother(some).motion(slice(0, 300))
    for name in SPREADS:
        spread = getattr(motion, name)
        np.testing.assert_array_equal(spread, spread.transpose(0, 2, 1))
        assert np.linalg.eigvalsh(spread).min() > 0
        assert np.trace(spread[115]) > 1.5 * np.trace(spread[60])


def test_a_part_is_as_of_the_whole():
    some = track(1500, path=wild, gaps=(slice(700, 715),))
    smoother = Smoother(some)
    whole = smoother.motion(slice(0, 1500))
    for part in (slice(0, 50), slice(500, 720), slice(1400, 1500)):
        motion = smoother.motion(part)
        assert len(motion.xyz_m) == part.stop - part.start
        for order, spread in zip(ORDERS, SPREADS, strict=True):
            sd = np.sqrt(getattr(whole, spread)[part][:, range(3), range(3)])
            assert (np.abs(getattr(motion, order) - getattr(whole, order)[part]) < 0.01 * sd).all(), order


def test_the_motion_is_that_of_the_stamp_not_of_when_the_marker_was_seen():
    """A rolling shutter sees a marker up to 8 ms after the stamp."""
    late_s = 0.004 + 0.004 * np.sin(np.arange(400) / 40)
    motion = Smoother(late := track(late_s=late_s)).motion(slice(0, 400))
    part = slice(60, 340)
    error = motion.xyz_m[part] - cubic(late.stamp_s[part])
    moved = np.abs(cubic(late.t_s[part]) - cubic(late.stamp_s[part])).max(axis=0)
    assert (np.abs(error).max(axis=0) < moved / 8).all()
    assert (np.abs(motion.velocity_mps[part] - cubic(late.stamp_s[part], 1)) < 0.25).all()
    assert (np.abs(motion.acceleration_mps2[part] - cubic(late.stamp_s[part], 2)).mean(axis=0) < 4).all()


def test_three_positions_are_too_few():
    some = track(50, gaps=(slice(0, 20), slice(23, 50)))
    assert some.measured.sum() == 3
    assert len(some) == 50
    with pytest.raises(ValueError, match="wrist: 3 measured positions are too few"):
        Smoother(some)


def test_packed_covariances_are_those_of_positions():
    np.testing.assert_allclose(track(5).covariance(slice(1, 3)), np.tile(COVARIANCE, (2, 1, 1)), rtol=1e-6)
