import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference import kalman as reference
from spheremcap.core.time import NS_PER_S
from spheremcap.positioning.kalman import KalmanConfig, Moment, Track3D, smooth, transition

SD_M = np.array([0.002, 0.001, 0.01])
R = np.diag(SD_M**2)
PERIOD_NS = 4_170_837


def path(t_s):
    """A wrist on the hand rim: 2 Hz, 20 cm."""
    w = 2 * np.pi * 2.0
    return np.array([0.2 * np.sin(w * t_s), 0.1 * np.cos(w * t_s), 1.0 + 0.05 * np.sin(w * t_s)])


def run(stamps, measured, config=None, r=R):
    track = Track3D(config or KalmanConfig())
    track.start(stamps[0], measured[0], r)
    moments = [track.now]
    for stamp, z in zip(stamps[1:], measured[1:], strict=True):
        track.predict(stamp)
        if z is not None:
            track.update(z, r)
        moments.append(track.now)
    return moments


def assert_covariance(p):
    np.testing.assert_allclose(p, p.T, atol=1e-12)
    assert np.linalg.eigvalsh(p).min() > -1e-12


def test_constant_velocity_without_noise_is_followed_exactly():
    velocity, start = np.array([1.5, -0.7, 3.0]), np.array([0.1, 0.2, 1.4])
    stamps = [k * PERIOD_NS for k in range(200)]
    measured = [start + velocity * s / NS_PER_S for s in stamps]
    moments = run(stamps, measured, KalmanConfig(acceleration_mps2=1e-6, start_speed_mps=100.0), r=np.eye(3) * 1e-12)
    np.testing.assert_allclose(moments[-1].velocity_cam_mps, velocity, rtol=1e-5)
    np.testing.assert_allclose(moments[-1].xyz_cam_m, measured[-1], atol=1e-8)


def test_a_known_velocity_is_carried_on_over_any_gap():
    track = Track3D(KalmanConfig())
    velocity = np.array([2.0, 0.5, -1.0])
    track.start(1_000, np.zeros(3) + 1, R, velocity)
    for stamp in (1_000 + 10**7, 1_000 + 10**9):
        moment = track.predict(stamp)
        np.testing.assert_allclose(moment.xyz_cam_m, 1 + velocity * (stamp - 1_000) / NS_PER_S, rtol=1e-12)
        assert moment.stamp_ns == stamp


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=8))
def test_many_small_predictions_go_where_one_large_one_goes(steps):
    one, many = Track3D(KalmanConfig()), Track3D(KalmanConfig())
    for track in (one, many):
        track.start(0, np.ones(3), R, np.array([1.0, 2.0, -3.0]))
    one.predict(sum(steps))
    stamp = 0
    for step in steps:
        stamp += step
        many.predict(stamp)
    np.testing.assert_allclose(many.now.state, one.now.state, rtol=1e-9, atol=1e-9)


def test_dt_comes_from_the_stamps():
    rng = np.random.default_rng(0)
    velocity = np.array([1.0, 0, 0])
    stamps = np.cumsum([0, *rng.choice([10**6, 4 * 10**6, 4 * 10**7], 150)]).tolist()
    measured = [velocity * s / NS_PER_S + (0, 0, 1) for s in stamps]
    moments = run(stamps, measured, KalmanConfig(acceleration_mps2=0.01, start_speed_mps=10), r=np.eye(3) * 1e-8)
    np.testing.assert_allclose(moments[-1].velocity_cam_mps, velocity, atol=1e-3)


@pytest.mark.parametrize("dt", [0.001, 1 / 240, 0.5])
def test_the_random_acceleration_is_constant_between_two_stamps(dt):
    f, q = transition(dt, 60.0)
    np.testing.assert_allclose(f @ [1, 2, 3, 10, 20, 30], [1 + 10 * dt, 2 + 20 * dt, 3 + 30 * dt, 10, 20, 30])
    a = 60.0**2
    for k in range(3):
        assert q[k, k] == pytest.approx(a * dt**4 / 4)
        assert q[k, k + 3] == pytest.approx(a * dt**3 / 2)
        assert q[k + 3, k + 3] == pytest.approx(a * dt**2)
    assert np.linalg.matrix_rank(q) == 3


def moments_of_leaps(steps, sd, seed):
    """A filter that is shown places 10 cm apart, as a rule far outside its gate, at some of its steps of (ns, seen)."""
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((3, 3))
    r = (half @ half.T + np.eye(3) * 0.1) * sd**2
    track = Track3D(KalmanConfig())
    track.start(0, np.ones(3), r)
    stamp, moments = 0, []
    for step, seen in steps:
        stamp += step
        track.predict(stamp)
        if seen:
            track.update(1 + 0.1 * rng.standard_normal(3), r)
        moments.append(track.now)
    return moments


# Widened for such leaps within microseconds, the covariance becomes larger than floats can subtract again.
leaping = st.lists(st.tuples(st.integers(10**6, 2 * 10**8), st.booleans()), min_size=1, max_size=60)


def assert_covariances(moments, within):
    for moment in moments:
        p = moment.covariance
        scale = np.abs(p).max()
        np.testing.assert_allclose(p, p.T, rtol=0, atol=1e-12 * scale)
        assert np.linalg.eigvalsh(p).min() > -within * scale


@settings(deadline=None, max_examples=25)
@given(leaping, st.floats(1e-6, 1.0), st.integers(0, 2**32 - 1))
def test_the_covariance_stays_a_covariance(steps, sd, seed):
    assert_covariances(moments_of_leaps(steps, sd, seed), 1e-9)


@settings(deadline=None, max_examples=25)
@given(leaping, st.floats(1e-4, 1.0), st.integers(0, 2**32 - 1))
def test_so_does_the_smoothed_one(steps, sd, seed):
    assert_covariances(smooth(moments_of_leaps(steps, sd, seed), 60.0), 1e-6)


def test_thousands_of_steps_leave_a_covariance():
    rng = np.random.default_rng(1)
    stamps = [k * PERIOD_NS for k in range(3000)]
    moments = run(stamps, [rng.normal((0, 0, 1), SD_M) for _ in stamps])
    assert_covariance(moments[-1].covariance)


def test_an_update_moves_towards_the_measurement_and_makes_surer():
    track = Track3D(KalmanConfig())
    track.start(0, np.array([0, 0, 1.0]), R)
    before = track.predict(PERIOD_NS)
    after = track.update(np.array([0.005, 0, 1.0]), R)
    assert 0 < after.xyz_cam_m[0] < 0.005
    assert np.trace(after.covariance[:3, :3]) < np.trace(before.covariance[:3, :3])
    assert after.velocity_cam_mps[0] > 0


def test_the_gate_lets_in_what_it_says_and_no_more():
    """Innovations drawn from the filter's own covariance: 90 % inside a 90 % gate."""
    track = Track3D(KalmanConfig(gate_probability=0.9))
    track.start(0, np.array([0, 0, 1.0]), R)
    moment = track.predict(5 * PERIOD_NS)
    s = moment.covariance[:3, :3] + R
    draws = np.random.default_rng(2).multivariate_normal(moment.xyz_cam_m, s, 3000)
    inside = np.mean([track.surprise(z, R) <= 1 for z in draws])
    assert inside == pytest.approx(0.9, abs=0.02)
    distances = [track.distance2(z, R) for z in draws]
    assert np.mean(distances) == pytest.approx(3, abs=0.15)  # chi-squared, three degrees


def test_a_leap_is_outside_the_gate_until_time_has_passed():
    track = Track3D(KalmanConfig())
    track.start(0, np.array([0, 0, 1.0]), R)
    leap = np.array([0.4, 0.0, 1.0])
    track.predict(PERIOD_NS)
    assert track.surprise(leap, R) > 1
    track.predict(60 * PERIOD_NS)
    assert track.surprise(leap, R) <= 1


def test_looking_at_the_gate_changes_nothing():
    track = Track3D(KalmanConfig())
    track.start(0, np.array([0, 0, 1.0]), R)
    before = track.predict(PERIOD_NS)
    track.surprise(np.ones(3), R)
    np.testing.assert_array_equal(track.now.state, before.state)
    np.testing.assert_array_equal(track.now.covariance, before.covariance)


def test_errors_are_as_large_as_the_filter_says():
    """NEES of the position over 30 runs of white-acceleration motion: 3 on average."""
    rng, nees = np.random.default_rng(3), []
    config = KalmanConfig(acceleration_mps2=20.0)
    dt = PERIOD_NS / NS_PER_S
    for _ in range(30):
        x, v = np.array([0, 0, 1.0]), rng.normal(0, 3.0, 3)
        stamps, truth = [0], [x]
        for k in range(1, 40):
            a = rng.normal(0, 20.0, 3)
            x, v = x + v * dt + a * dt * dt / 2, v + a * dt
            stamps.append(k * PERIOD_NS)
            truth.append(x)
        measured = [p + rng.normal(0, SD_M) for p in truth]
        moment = run(stamps, measured, config)[-1]
        error = moment.xyz_cam_m - truth[-1]
        nees.append(error @ np.linalg.solve(moment.covariance[:3, :3], error))
    assert 1.8 < np.mean(nees) < 4.5


def test_a_filter_that_has_not_been_started_says_so():
    track = Track3D(KalmanConfig())
    assert not track.started
    with pytest.raises(RuntimeError, match="not been started"):
        track.predict(0)
    track.start(0, np.ones(3), R)
    assert track.started


def test_the_velocity_is_known_from_the_second_measurement_on():
    track = Track3D(KalmanConfig())
    track.start(0, np.array([0, 0, 1.0]), R)
    track.predict(PERIOD_NS)
    assert not track.moving_known
    track.update(np.array([0, 0, 1.0]), R)
    assert track.moving_known
    track.start(0, np.array([0, 0, 1.0]), R)
    assert not track.moving_known


def test_gate_and_update_share_one_inverse_and_it_is_that_of_their_own_covariances():
    track = Track3D(KalmanConfig())
    track.start(0, np.array([0, 0, 1.0]), R)
    for k, measured in enumerate(([0.001, 0, 1.0], [0.4, 0.1, 1.2], [0.002, 0, 1.0]), 1):
        own = R * k
        prior = track.predict(k * PERIOD_NS)
        innovation = np.array(measured) - prior.xyz_cam_m
        expected = innovation @ np.linalg.solve(prior.covariance[:3, :3] + own, innovation)
        assert track.distance2(np.array(measured), own) == pytest.approx(expected)
        moment = track.update(np.array(measured), own)
        wide = prior.covariance * moment.widened
        gain = wide[:, :3] @ np.linalg.inv(wide[:3, :3] + own)
        np.testing.assert_allclose(moment.state, prior.state + gain @ innovation, atol=1e-12)
        np.testing.assert_allclose(moment.covariance, wide - gain @ wide[:3], atol=1e-9 * np.abs(wide).max())


def test_without_the_filter_the_last_position_is_the_prediction():
    track = Track3D(KalmanConfig(enabled=False))
    track.start(0, np.array([0.1, 0.2, 1.0]), R, np.array([5.0, 5, 5]))
    np.testing.assert_array_equal(track.predict(10**9).xyz_cam_m, [0.1, 0.2, 1.0])


@pytest.mark.parametrize("seed", range(4))
def test_the_compiled_smoother_equals_filterpys(seed):
    """Also across steps whose prediction was widened, and uneven or repeated stamps."""
    moments = run_with_leaps(seed, KalmanConfig())
    assert max(m.widened for m in moments) > 1.5
    for ours, theirs in zip(smooth(moments, 60.0), reference.smooth(moments, 60.0), strict=True):
        np.testing.assert_allclose(ours.state, theirs.state, atol=1e-9)
        np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=1e-6, atol=1e-12)


def test_where_the_filter_is_off_the_smoother_lets_the_marker_stand_still_too():
    moments = run_with_leaps(0, KalmanConfig(enabled=False))
    still, moving = smooth(moments, 60.0, moving=False), smooth(moments, 60.0)
    assert not np.allclose(still[5].state, moving[5].state)
    f = transition(0.004, 60.0, False)[0]
    np.testing.assert_array_equal(f, np.eye(6))


def run_with_leaps(seed, config):
    rng = np.random.default_rng(seed)
    track = Track3D(config)
    track.start(0, np.array([0, 0, 1.0]), R)
    moments, stamp = [track.now], 0
    for k in range(1, 40):
        stamp += int(rng.integers(1, 4)) * PERIOD_NS * (k != 20)
        track.predict(stamp)
        place = np.array([0.02 * k, 0, 1.0]) + rng.normal(0, SD_M, 3) + (0.3 if k in (13, 27) else 0)
        moments.append(track.update(place, R) if k % 5 else track.now)
    return moments


# -- the smoother ----------------------------------------------------------------------------------


def noisy_run(seed=4, gap=()):
    rng = np.random.default_rng(seed)
    stamps = [k * PERIOD_NS for k in range(240)]
    truth = np.array([path(s / NS_PER_S) for s in stamps])
    measured = [None if k in gap else p + rng.normal(0, SD_M) for k, p in enumerate(truth)]
    return truth, run(stamps, measured)


def errors(moments, truth):
    return np.linalg.norm(np.array([m.xyz_cam_m for m in moments]) - truth, axis=1)


def test_smoothing_lowers_the_error_of_position_and_velocity():
    truth, moments = noisy_run()
    smoothed = smooth(moments, KalmanConfig().acceleration_mps2)
    assert np.sqrt((errors(smoothed, truth) ** 2).mean()) < 0.85 * np.sqrt((errors(moments, truth) ** 2).mean())
    true_velocity = np.gradient(truth, PERIOD_NS / NS_PER_S, axis=0)[5:-5]
    velocity_error = [
        np.linalg.norm(np.array([m.velocity_cam_mps for m in ms])[5:-5] - true_velocity, axis=1).mean()
        for ms in (moments, smoothed)
    ]
    assert velocity_error[1] < 0.6 * velocity_error[0]


def test_smoothing_bridges_a_gap_from_both_sides():
    gap = range(100, 112)
    truth, moments = noisy_run(gap=gap)
    smoothed = smooth(moments, KalmanConfig().acceleration_mps2)
    assert errors(smoothed, truth)[list(gap)].mean() < 0.6 * errors(moments, truth)[list(gap)].mean()


def test_the_last_smoothed_moment_is_the_filters():
    _, moments = noisy_run()
    last = smooth(moments, KalmanConfig().acceleration_mps2)[-1]
    np.testing.assert_allclose(last.state, moments[-1].state, atol=1e-12)
    np.testing.assert_allclose(last.covariance, moments[-1].covariance, atol=1e-12)
    assert last.stamp_ns == moments[-1].stamp_ns


def test_smoothing_never_makes_less_sure():
    _, moments = noisy_run()
    for before, after in zip(moments, smooth(moments, KalmanConfig().acceleration_mps2), strict=True):
        assert np.trace(after.covariance[:3, :3]) <= np.trace(before.covariance[:3, :3]) * (1 + 1e-9)


def test_smoothing_is_the_least_squares_solution_of_the_whole_stretch():
    """Against one dense solve over a short run with uneven steps: the definition of smoothing."""
    rng = np.random.default_rng(5)
    stamps = [0, 4 * 10**6, 9 * 10**6, 10**7, 30 * 10**6]
    measured = [np.array([0, 0, 1]) + rng.normal(0, SD_M) for _ in stamps]
    config = KalmanConfig(acceleration_mps2=25.0)
    smoothed = smooth(run(stamps, measured, config), 25.0)
    # Q has rank 3 a step, so solve for the start and the accelerations instead of for the states.
    n = len(stamps)
    columns = 6 + 3 * (n - 1)
    states, state = [], np.eye(6, columns)
    states.append(state)
    for k in range(1, n):
        dt = (stamps[k] - stamps[k - 1]) / NS_PER_S
        f, _ = transition(dt, 25.0)
        gain = np.concatenate([np.eye(3) * dt * dt / 2, np.eye(3) * dt])
        push = np.zeros((6, columns))
        push[:, 6 + 3 * (k - 1) : 9 + 3 * (k - 1)] = gain
        state = f @ state + push
        states.append(state)
    rows, goal = [], []
    for s, z in zip(states, measured, strict=True):
        rows.append(s[:3] / SD_M[:, None])
        goal.append(z / SD_M)
    rows.append(np.eye(6, columns)[3:] / config.start_speed_mps)  # the speed at the start
    goal.append(np.zeros(3))
    rows.append(np.eye(columns)[6:] / 25.0)
    goal.append(np.zeros(columns - 6))
    solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(goal), rcond=None)[0]
    for s, moment in zip(states, smoothed, strict=True):
        np.testing.assert_allclose(moment.state, s @ solution, rtol=1e-5, atol=1e-6)


def test_fewer_than_two_moments_are_left_as_they_are():
    moment = Moment(0, np.zeros(6), np.eye(6))
    assert smooth([], 60.0) == []
    assert smooth([moment], 60.0) == [moment]
