import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from reference import kalman as reference
from spheremcap.core.time import NS_PER_S
from spheremcap.positioning.kalman import KalmanConfig, Moment, Track3D, change_power, gate_of, smooth, transition

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
def test_the_noise_of_a_step_is_that_of_white_acceleration_added_up_over_it(dt):
    """A push at time s before the end moves the velocity by 1 and the place by s; pushes at different times are
    independent, so that Q is the power times the integral of (s, 1)' (s, 1) over the step."""
    config = KalmanConfig()
    f, q = transition(dt, config)
    np.testing.assert_allclose(f @ [1, 2, 3, 10, 20, 30], [1 + 10 * dt, 2 + 20 * dt, 3 + 30 * dt, 10, 20, 30])
    before_end_s = (np.arange(2000) + 0.5) / 2000 * dt
    pushes = np.stack([before_end_s, np.ones(2000)])
    added = pushes @ pushes.T * dt / 2000
    power = change_power(dt, config.acceleration_mps2, config.acceleration_s)
    np.testing.assert_allclose(q, power * np.kron(added, np.eye(3)), rtol=1e-6)
    scale = np.diag(np.repeat([dt, 1.0], 3))  # so that place and velocity count alike
    assert np.linalg.eigvalsh(np.linalg.inv(scale) @ q @ np.linalg.inv(scale)).min() > 0.05 * q[3, 3]


@pytest.mark.parametrize("dt", [-1 / 240, -0.5])
def test_a_step_back_in_time_has_a_noise_too(dt):
    q, ahead = transition(dt, KalmanConfig())[1], transition(-dt, KalmanConfig())[1]
    np.testing.assert_allclose(np.diag(q), np.diag(ahead))
    np.testing.assert_allclose(q[0, 3], -ahead[0, 3])
    assert np.linalg.eigvalsh(q).min() > 0


def singer(rng, dt, count, config):
    """Velocities (count, 3), from 0, under an acceleration that forgets itself within `acceleration_s`, on a grid of
    `dt` far finer than that."""
    mps2, memory_s = config.acceleration_mps2, config.acceleration_s
    kept = np.exp(-dt / memory_s)
    a, v, out = rng.normal(0, mps2, 3), np.zeros(3), np.empty((count, 3))
    for k in range(count):
        out[k] = v
        after = kept * a + mps2 * np.sqrt(1 - kept**2) * rng.standard_normal(3)
        v, a = v + 0.5 * (a + after) * dt, after
    return out


@pytest.mark.parametrize("steps", [0.05, 1.0, 8.0])
def test_the_velocity_changes_as_much_over_a_step_as_that_of_a_wrist_does(steps):
    """By simulation: the acceleration pushes one way for a while and is another one then."""
    config, rng = KalmanConfig(), np.random.default_rng(7)
    dt = steps * config.acceleration_s
    v = np.array([singer(rng, dt / 200, 201, config)[-1] for _ in range(400)])
    assert transition(dt, config)[1][3, 3] == pytest.approx((v**2).mean(), rel=0.15)


def test_over_short_steps_the_acceleration_is_constant_and_over_long_ones_each_push_is_a_new_one():
    config = KalmanConfig()
    mps2, memory_s = config.acceleration_mps2, config.acceleration_s

    def grown(dt):
        return transition(dt, config)[1][3, 3]

    for short in (1e-7, 0.9e-3 * memory_s, 1.1e-3 * memory_s, 0.01 * memory_s):
        assert grown(short) == pytest.approx((mps2 * short) ** 2, rel=0.005)
    long = 1000 * memory_s
    assert grown(100 * long) == pytest.approx(100 * grown(long), rel=0.002)
    assert grown(long) == pytest.approx(2 * mps2**2 * memory_s * long, rel=0.002)
    assert grown(memory_s) > 5 * 5 * grown(memory_s / 5) * 0.7


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
    assert_covariances(smooth(moments_of_leaps(steps, sd, seed), KalmanConfig()), 1e-6)


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


@pytest.mark.parametrize(("sd_m", "most"), [(2e-4, 1.25), (1e-3, 2.0)], ids=["sideways", "in depth"])
@pytest.mark.parametrize("rate_hz", [24, 60, 240, 480])
def test_errors_are_as_large_as_the_filter_says_at_any_frame_rate(rate_hz, sd_m, most):
    """NEES over the number of dimensions, of the place and of place and velocity, under an acceleration that forgets
    itself as the configuration has it: 1, were the filter's white one the same. Where a step is short against that time
    and the places are poor, so that many steps count, it is too sure by up to `most`."""
    rng, config = np.random.default_rng(rate_hz), KalmanConfig()
    period_ns = NS_PER_S // rate_hz
    fine = max(1, round(period_ns / NS_PER_S / (0.05 * config.acceleration_s)))
    dt = period_ns / NS_PER_S / fine
    of_place, of_state = [], []
    for _ in range(12):
        count = fine * 60
        v = singer(rng, dt, count + 1, config)
        places = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * dt, axis=0)]) + np.array(
            [0, 0, 1.0]
        )
        stamps = [k * period_ns for k in range(60)]
        true = np.concatenate([places, v], axis=1)[: fine * 60 : fine]
        moments = run(stamps, list(true[:, :3] + rng.normal(0, sd_m, (60, 3))), config, np.eye(3) * sd_m**2)
        for moment, state in list(zip(moments, true, strict=True))[15:]:
            off = moment.state - state
            of_place.append(off[:3] @ np.linalg.solve(moment.covariance[:3, :3], off[:3]))
            of_state.append(off @ np.linalg.solve(moment.covariance, off))
    assert 0.8 < np.mean(of_place) / 3 < most
    assert 0.7 < np.mean(of_state) / 6 < most


@pytest.mark.parametrize("rate_hz", [30, 60, 240])
@pytest.mark.parametrize("sd_m", [1e-4, 1e-3])
def test_one_wrong_place_dies_away_and_does_not_ring(rate_hz, sd_m):
    """5 mm once, at a marker at rest: what the next predictions are off by is soon gone, and where it goes to either
    side in turn, less than half as much each time."""
    r = np.eye(3) * sd_m**2
    track = Track3D(KalmanConfig())
    track.start(0, np.array([0, 0, 1.0]), r)
    off = []
    for k in range(1, 61):
        track.predict(k * NS_PER_S // rate_hz)
        if k > 30:
            off.append(track.now.xyz_cam_m[0])
        track.update(np.array([0.005 if k == 30 else 0.0, 0, 1.0]), r)
    off = np.array(off)
    assert abs(off[0]) > 1e-4  # it does believe it, in part
    # The first one has the wrong place behind it, the second one the wrong speed that came of it and the way back.
    for one, two, three in zip(off[1:], off[2:], off[3:], strict=False):
        if one * two < 0 and two * three < 0:
            assert abs(three / two) < 0.5
    assert np.abs(off[12:]).max() < 0.02 * np.abs(off).max()


def test_errors_are_as_large_as_the_filter_says():
    """NEES of the position over 30 runs of an acceleration that is another one at each frame: 3 on average."""
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


def test_the_filter_equals_filterpys():
    config, rng, stamp = KalmanConfig(), np.random.default_rng(5), 0
    ours, theirs = Track3D(config), KalmanFilter(dim_x=6, dim_z=3)
    theirs.H = np.eye(3, 6)
    ours.start(0, np.array([0.1, 0.2, 1.0]), R)
    theirs.x, theirs.P = ours.now.state, ours.now.covariance
    for k in range(60):
        dt_ns = int(rng.integers(1, 4)) * PERIOD_NS
        stamp += dt_ns
        f, q = transition(dt_ns / 1e9, config)
        prior = ours.predict(stamp)
        theirs.predict(F=f, Q=q)
        if k % 7 != 3:
            measured, spread = prior.xyz_cam_m + rng.normal(0, 1e-3, 3), np.diag(rng.uniform(1e-6, 1e-5, 3))
            moment = ours.update(measured, spread)
            assert moment.widened == 1
            theirs.update(measured, R=spread)
        np.testing.assert_allclose(ours.now.state, theirs.x, rtol=1e-9)
        np.testing.assert_allclose(ours.now.covariance, theirs.P, rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize("probability", [0.51, 0.95, 0.999, 0.9999, 0.999999])
def test_the_gate_is_the_quantile(probability):
    assert gate_of(probability) == pytest.approx(chi2.ppf(probability, 3), rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_compiled_smoother_equals_filterpys(seed):
    """Also across steps whose prediction was widened, and uneven or repeated stamps."""
    moments = run_with_leaps(seed, KalmanConfig())
    assert max(m.widened for m in moments) > 1.5
    both = smooth(moments, KalmanConfig()), reference.smooth(moments, KalmanConfig())
    for ours, theirs in zip(*both, strict=True):
        np.testing.assert_allclose(ours.state, theirs.state, atol=1e-9)
        np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=1e-6, atol=1e-12)


def test_where_the_filter_is_off_the_smoother_lets_the_marker_stand_still_too():
    off = KalmanConfig(enabled=False)
    moments = run_with_leaps(0, off)
    still, moving = smooth(moments, off), smooth(moments, KalmanConfig())
    assert not np.allclose(still[5].state, moving[5].state)
    f = transition(0.004, off)[0]
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
    smoothed = smooth(moments, KalmanConfig())
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
    smoothed = smooth(moments, KalmanConfig())
    assert errors(smoothed, truth)[list(gap)].mean() < 0.6 * errors(moments, truth)[list(gap)].mean()


def test_the_last_smoothed_moment_is_the_filters():
    _, moments = noisy_run()
    last = smooth(moments, KalmanConfig())[-1]
    np.testing.assert_allclose(last.state, moments[-1].state, atol=1e-12)
    np.testing.assert_allclose(last.covariance, moments[-1].covariance, atol=1e-12)
    assert last.stamp_ns == moments[-1].stamp_ns


def test_smoothing_never_makes_less_sure():
    _, moments = noisy_run()
    for before, after in zip(moments, smooth(moments, KalmanConfig()), strict=True):
        assert np.trace(after.covariance[:3, :3]) <= np.trace(before.covariance[:3, :3]) * (1 + 1e-9)


def test_smoothing_is_the_least_squares_solution_of_the_whole_stretch():
    """Against one dense solve over a short run with uneven steps: the definition of smoothing."""
    rng = np.random.default_rng(5)
    stamps = [0, 4 * 10**6, 9 * 10**6, 10**7, 30 * 10**6]
    measured = [np.array([0, 0, 1]) + rng.normal(0, SD_M) for _ in stamps]
    config = KalmanConfig(acceleration_mps2=25.0)
    smoothed = smooth(run(stamps, measured, config), config)
    # Solve for the start and for what pushes each step, as independent ones of deviation 1.
    n = len(stamps)
    columns = 6 * n
    states, state = [], np.eye(6, columns)
    states.append(state)
    for k in range(1, n):
        f, q = transition((stamps[k] - stamps[k - 1]) / NS_PER_S, config)
        push = np.zeros((6, columns))
        push[:, 6 * k : 6 * k + 6] = np.linalg.cholesky(q)
        state = f @ state + push
        states.append(state)
    rows, goal = [], []
    for s, z in zip(states, measured, strict=True):
        rows.append(s[:3] / SD_M[:, None])
        goal.append(z / SD_M)
    rows.append(np.eye(6, columns)[3:] / config.start_speed_mps)  # the speed at the start
    goal.append(np.zeros(3))
    rows.append(np.eye(columns)[6:])
    goal.append(np.zeros(columns - 6))
    solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(goal), rcond=None)[0]
    for s, moment in zip(states, smoothed, strict=True):
        np.testing.assert_allclose(moment.state, s @ solution, rtol=1e-5, atol=1e-6)


def test_fewer_than_two_moments_are_left_as_they_are():
    moment = Moment(0, np.zeros(6), np.eye(6))
    assert smooth([], KalmanConfig()) == []
    assert smooth([moment], KalmanConfig()) == [moment]
