"""How far away a marker is by its size: what is learnt of how steady it is, and what that is good for."""

import math

import numpy as np
import pytest

from reference.size import Reference
from spheremcap.core.time import NS_PER_S
from spheremcap.positioning.size import _RATES, SizeTrack

STEP_NS = NS_PER_S // 30


def followed(ranges_m, sd=0.003, step_ns=STEP_NS):
    """After these distances, one a frame; the stamp of the last is `(len - 1) * step_ns`."""
    track = SizeTrack()
    track.start(0, ranges_m[0], sd)
    for k, range_m in enumerate(ranges_m[1:], 1):
        track.update(k * step_ns, range_m, sd)
    return track


def test_it_equals_its_matrix_form():
    random = np.random.default_rng(3)
    track, reference = SizeTrack(), Reference(_RATES)
    stamp_ns = 10**9
    track.start(stamp_ns, 1.3, 0.01)
    reference.start(1.3, 0.01)
    for k in range(40):
        step_ns = int(random.integers(2_000_000, 60_000_000))
        dt_s = step_ns / NS_PER_S
        ahead_ns = int(random.integers(0, 400_000_000))
        found = track.expect(stamp_ns + ahead_ns)
        assert found == pytest.approx(reference.expect(ahead_ns / NS_PER_S), rel=1e-9)
        stamp_ns += step_ns
        range_m, sd = 1.3 * math.exp(0.2 * math.sin(0.3 * k) + random.normal(0, 0.01)), 0.002 + 0.02 * random.random()
        track.update(stamp_ns, range_m, sd)
        reference.update(dt_s, range_m, sd)


def test_a_marker_of_steady_size_is_soon_known_not_to_jump():
    """At 30 frames a second the Kalman filter's acceleration alone leaves a third of a metre open."""
    range_m, sd = followed([1.0] * 15).expect(15 * STEP_NS)
    assert range_m == pytest.approx(1.0, abs=1e-3)
    assert sd < 0.01


def test_nothing_is_known_of_it_after_a_seed():
    assert followed([1.0]).expect(STEP_NS)[1] > 0.03


def test_one_that_comes_and_goes_is_left_room():
    ranges_m = 1.0 + 0.3 * np.sin(np.arange(60) * 0.4)
    wild, calm = followed(list(ranges_m)), followed([1.0] * 60)
    assert wild.expect(60 * STEP_NS)[1] > 3 * calm.expect(60 * STEP_NS)[1]


def test_an_approach_goes_on():
    ranges_m = [1.0 * 0.985**k for k in range(30)]
    range_m, _ = followed(ranges_m).expect(30 * STEP_NS)
    assert range_m == pytest.approx(1.0 * 0.985**30, rel=3e-3)


def test_one_that_is_not_seen_does_not_run_away_and_gets_unsure():
    track = followed([1.0 * 0.97**k for k in range(30)])
    last = 0.97**29
    soon, late = track.expect(31 * STEP_NS), track.expect(200 * STEP_NS)
    assert 0.5 * last < late[0] < last
    assert late[1] > 3 * soon[1]


def test_a_part_taken_for_a_smaller_whole_hardly_moves_it():
    """Part-hidden outlines that would have the marker 20 % farther away, with the deviation that such have."""
    track = followed([1.0] * 20)
    for k in range(20, 23):
        track.update(k * STEP_NS, 1.2, 0.09)
    assert track.expect(23 * STEP_NS)[0] < 1.02


def test_what_is_usual_is_kept_when_a_marker_is_found_again():
    track = followed([1.0] * 40)
    track.start(40 * STEP_NS, 1.5, 0.003)
    range_m, sd = track.expect(41 * STEP_NS)
    assert range_m == pytest.approx(1.5, rel=1e-6)
    assert sd < 0.01


def test_falling_and_repeated_stamps_move_nothing():
    track = followed([1.0] * 10)
    assert track.expect(5 * STEP_NS) == track.expect(9 * STEP_NS)
