"""One status after another: every transition, and both sides of every bound."""

from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.core.status import PolicyConfig, Sight, Status, next_status

POLICY = PolicyConfig()
MISSED = Sight(rejected=False, gone=False, misses=1, away_s=0.0, unsure_radii=1.0)
TRACKED = (Status.SEEDED, Status.VERIFIED, Status.ESTIMATED)
AWAY = (Status.LOST, Status.OUT_OF_VIEW)

statuses = st.sampled_from(Status)
sights = st.builds(
    Sight,
    st.booleans(),
    st.booleans(),
    misses=st.integers(1, 50),
    away_s=st.floats(0, 1e4),
    unsure_radii=st.floats(0, 9),
)
policies = st.builds(
    PolicyConfig, lost_after=st.integers(1, 20), immediate=st.booleans(), out_of_view_s=st.floats(0, 100)
)


def test_what_counts_as_measured_and_what_as_tracked():
    assert [s for s in Status if s.measured] == [Status.SEEDED, Status.VERIFIED]
    assert [s for s in Status if s.tracked] == [Status.SEEDED, Status.VERIFIED, Status.ESTIMATED]


@given(statuses, sights, policies)
def test_a_frame_without_a_verified_circle_is_never_called_measured(status, sight, policy):
    assert not next_status(status, sight, policy).measured


@pytest.mark.parametrize("status", TRACKED)
def test_the_filter_stands_in_for_a_frame_without_a_verified_circle(status):
    assert next_status(status, MISSED, POLICY) is Status.ESTIMATED


@pytest.mark.parametrize("status", TRACKED)
@pytest.mark.parametrize("lost_after", [1, 2, 5, 8])
def test_so_many_misses_in_a_row_mean_lost_and_one_fewer_does_not(status, lost_after):
    policy = PolicyConfig(lost_after=lost_after)
    assert next_status(status, replace(MISSED, misses=lost_after), policy) is Status.LOST
    assert next_status(status, replace(MISSED, misses=lost_after + 1), policy) is Status.LOST
    assert next_status(status, replace(MISSED, misses=lost_after - 1), policy) is Status.ESTIMATED


@pytest.mark.parametrize("status", TRACKED)
def test_the_filter_stands_in_however_long_as_long_as_it_knows_the_place_to_a_radius(status):
    for misses in (5, 50, 500):
        assert next_status(status, replace(MISSED, misses=misses, unsure_radii=0.99), POLICY) is Status.ESTIMATED
        assert next_status(status, replace(MISSED, misses=misses, unsure_radii=1.0), POLICY) is Status.LOST
    sure_enough = PolicyConfig(lost_radii=0.5)
    assert next_status(status, replace(MISSED, misses=5, unsure_radii=0.6), sure_enough) is Status.LOST


def test_five_misses_are_the_default():
    assert next_status(Status.VERIFIED, replace(MISSED, misses=4), PolicyConfig()) is Status.ESTIMATED
    assert next_status(Status.VERIFIED, replace(MISSED, misses=5), PolicyConfig()) is Status.LOST


@pytest.mark.parametrize(("status", "misses"), [*product(TRACKED, [1, 5, 50])])
def test_a_marker_that_is_gone_from_the_picture_is_out_of_view_and_not_lost(status, misses):
    for immediate in (False, True):
        sight = replace(MISSED, gone=True, rejected=True, misses=misses)
        assert next_status(status, sight, PolicyConfig(immediate=immediate)) is Status.OUT_OF_VIEW


@pytest.mark.parametrize("status", TRACKED)
def test_the_immediate_policy_loses_it_at_the_first_rejection_and_no_sooner(status):
    immediate = PolicyConfig(immediate=True)
    rejected = replace(MISSED, rejected=True)
    assert next_status(status, rejected, immediate) is Status.LOST
    assert next_status(status, MISSED, immediate) is Status.ESTIMATED  # doubtful
    assert next_status(status, rejected, POLICY) is Status.ESTIMATED


@pytest.mark.parametrize("status", AWAY)
@given(away_s=st.floats(0, 1e4), bound_s=st.floats(0, 1e4), misses=st.integers(1, 1000), rejected=st.booleans())
def test_out_of_view_becomes_lost_after_its_time_and_lost_stays_so_however_long(
    status, away_s, bound_s, misses, rejected
):
    sight = replace(MISSED, misses=misses, away_s=away_s, rejected=rejected)
    expected = Status.LOST if away_s > bound_s else status
    assert next_status(status, sight, PolicyConfig(out_of_view_s=bound_s)) is expected


def test_the_time_out_of_the_picture_ends_after_its_bound():
    policy = PolicyConfig(out_of_view_s=2.0)
    assert next_status(Status.OUT_OF_VIEW, replace(MISSED, away_s=2.0), policy) is Status.OUT_OF_VIEW
    assert next_status(Status.OUT_OF_VIEW, replace(MISSED, away_s=2.000001), policy) is Status.LOST


@given(sights, policies)
def test_once_away_it_is_not_estimated_until_it_was_seen(sight, policy):
    for status in AWAY:
        assert next_status(status, sight, policy) in (Status.LOST, Status.OUT_OF_VIEW)
        assert next_status(Status.LOST, sight, policy) is Status.LOST


@given(st.sampled_from(TRACKED), st.integers(1, 6))
def test_over_a_run_lost_begins_with_the_miss_that_is_one_too_many(status, lost_after):
    for misses in range(1, 30):
        status = next_status(status, replace(MISSED, misses=misses), PolicyConfig(lost_after=lost_after))
        assert (status is Status.LOST) == (misses >= lost_after)
