"""The metrics against cases worked out by hand."""

import math

import numpy as np
import pytest

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.evaluation.metrics import (
    TruthRow,
    compare,
    failure_frames,
    false_accept_frames,
    missed_frames,
    reacquisitions,
    score,
    stretches,
    table,
)

TRUE = Circle(100.0, 80.0, 20.0)
XYZ = np.array([0.0, 0.0, 2.0])
PERIOD_NS = 4_000_000


def truth(visible: list[float]) -> list[TruthRow]:
    return [TruthRow("m", k, TRUE if v > 0 else None, XYZ, v) for k, v in enumerate(visible)]


def estimates(text: str, circle: Circle = TRUE) -> list[MarkerEstimate]:
    """One letter a frame: S seeded, V verified, W verified far off, E estimated, L lost."""
    out = []
    for k, letter in enumerate(text):
        status = {"S": Status.SEEDED, "E": Status.ESTIMATED, "L": Status.LOST}.get(letter, Status.VERIFIED)
        found = {"L": None, "W": TRUE.shifted(100, 0)}.get(letter, circle)
        out.append(MarkerEstimate("m", k, k * PERIOD_NS, status, circle=found))
    return out


def test_a_perfect_track_scores_perfectly_and_its_seed_does_not_count() -> None:
    row = score([compare(truth([1.0] * 5), estimates("SVVVV"), "m")], requests=0)
    assert (row.frames, row.measured_frames, row.failures, row.false_accepts) == (4, 4, 0, 0)
    assert row.accuracy_pct == pytest.approx(100)
    assert row.missed_pct == 0
    assert row.requests_per_min == 0
    assert row.status_pct == {"SEEDED": 20.0, "VERIFIED": 80.0}


def test_errors_have_the_sign_and_unit_that_they_are_called_by() -> None:
    small = Circle(103.0, 84.0, 19.0)
    row = score([compare(truth([1.0] * 3), estimates("SVV", small), "m")])
    assert row.centre_median_px == pytest.approx(5.0)
    assert row.radius_bias_px == pytest.approx(-1.0)
    assert row.radius_bias_pct == pytest.approx(-5.0)
    assert row.accuracy_pct == pytest.approx(100 * small.dice(TRUE))
    assert row.position_mean_mm is None
    assert row.nees_mean is None


def test_position_errors_in_mm_and_in_percent_of_range() -> None:
    rng = np.random.default_rng(1)
    covariance = np.array([[4e-6, 1e-6, 0.0], [1e-6, 3e-6, 0.0], [0.0, 0.0, 9e-6]])
    errors = rng.multivariate_normal(np.zeros(3), covariance, 4000)
    found = [
        MarkerEstimate("m", k, k, Status.VERIFIED, TRUE, xyz_cam_m=XYZ + e, covariance_m2=covariance)
        for k, e in enumerate(errors)
    ]
    row = score([compare(truth([1.0] * len(errors)), found, "m")])
    assert row.position_mean_mm == pytest.approx(1000 * np.linalg.norm(errors, axis=1).mean())
    assert row.nees_mean == pytest.approx(3, rel=0.1)
    assert row.nees_within_95_pct == pytest.approx(95, abs=1.5)
    assert row.range_sd_pct == pytest.approx(100 * 0.003 / 2, rel=0.1)
    assert row.range_bias_pct == pytest.approx(0, abs=0.01)


def test_a_stretch_without_overlap_is_one_failure() -> None:
    compared = compare(truth([1.0] * 9), estimates("SVLLVWWVL"), "m")
    assert failure_frames(compared) == [2, 5, 8]
    assert score([compared]).failures == 3


def test_a_hidden_marker_cannot_be_failed_and_has_grace_when_it_comes_back() -> None:
    visible = [1.0, 1.0, 0.0, 0.0, 0.2, 0.6, 1.0, 1.0, 1.0]
    assert failure_frames(compare(truth(visible), estimates("SVLLLLLLV"), "m")) == []
    late = compare(truth([*visible, 1.0]), estimates("SVLLLLLLLV"), "m")
    assert failure_frames(late) == [8]


def test_frames_to_reacquire_count_from_the_first_visible_one() -> None:
    visible = [1.0, 0.0, 0.6, 1.0, 1.0, 0.1, 1.0, 1.0, 0.0]
    compared = compare(truth(visible), estimates("SLLWVLLLL"), "m")
    assert reacquisitions(compared) == [(2, 2), (6, None)]
    row = score([compared])
    assert (row.reacquired, row.never_reacquired, row.reacquire_max_frames) == (1, 1, 2)


def test_a_partly_hidden_marker_that_stays_measured_was_never_lost() -> None:
    assert reacquisitions(compare(truth([1.0, 0.4, 0.6]), estimates("SVV"), "m")) == []


def test_false_accepts_are_verified_frames_far_off_or_hidden() -> None:
    compared = compare(truth([1.0, 1.0, 0.0, 0.3, 1.0]), estimates("SWVVE"), "m")
    assert false_accept_frames(compared) == [1, 2]
    assert missed_frames(compared) == [4]
    row = score([compared])
    assert row.false_accepts == 2
    assert row.false_accepts_pct == pytest.approx(50)


def test_visible_accuracy_counts_frames_without_a_circle_as_zero() -> None:
    row = score([compare(truth([1.0] * 5), estimates("SVELL"), "m")])
    assert row.accuracy_pct == pytest.approx(100)
    assert row.accuracy_circle_pct == pytest.approx(100)
    assert row.accuracy_visible_pct == pytest.approx(50)


def test_requests_are_told_by_the_minute_of_recorded_time() -> None:
    frames = 1 + int(30e9 / PERIOD_NS)
    found = [MarkerEstimate("m", k, k * PERIOD_NS, Status.VERIFIED, TRUE) for k in (0, frames - 1)]
    row = score([compare([TruthRow("m", 0, TRUE), TruthRow("m", frames - 1, TRUE)], found, "m")], requests=3)
    assert row.requests_per_min == pytest.approx(6)


def test_truth_before_the_first_seed_is_left_out_and_nothing_gives_an_empty_score() -> None:
    found = [MarkerEstimate("m", 3, 0, Status.SEEDED, TRUE), MarkerEstimate("m", 4, 1, Status.VERIFIED, TRUE)]
    assert len(compare(truth([1.0] * 5), found, "m")) == 2
    empty = score([compare([], [], "m")])
    assert empty.accuracy_pct is None
    assert empty.frames == 0


def test_tables_and_stretches_read_well() -> None:
    row = score([compare(truth([1.0] * 5), estimates("SVVVV"), "m")])
    text = table({"clean": row}, ("accuracy_pct", "failures", "nees_mean"), markdown=True)
    assert text.splitlines()[0].split("|")[2].strip() == "accuracy %"
    assert [c.strip() for c in text.splitlines()[2].split("|")[1:-1]] == ["clean", "100.00", "0", "-"]
    assert stretches([1, 2, 3, 7, 9, 10]) == "1-3, 7, 9-10"
    assert stretches([]) == "-"
    assert not math.isnan(row.centre_mean_px or 0)
