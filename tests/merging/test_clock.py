"""Offsets and drifts: parsed exactly, applied exactly."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.errors import UsageError
from spheremcap.merging.clock import Clock, parse_drift, parse_offset


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("+12.5ms", 12_500_000),
        ("-3 s", -3_000_000_000),
        ("0.1us", 100),
        ("1.5ns", 2),
        (".25µs", 250),
        ("2min", 120_000_000_000),
        ("1e-3s", 1_000_000),
        ("1700000000.123456789s", 1_700_000_000_123_456_789),
    ],
)
def test_offsets(text: str, ns: int) -> None:
    assert parse_offset(text) == ns


@pytest.mark.parametrize(
    ("text", "ratio"),
    [("-20ppm", Fraction(-20, 10**6)), ("150 ppb", Fraction(150, 10**9)), ("0.01%", Fraction(1, 10**4))],
)
def test_drifts(text: str, ratio: Fraction) -> None:
    assert parse_drift(text) == ratio


@pytest.mark.parametrize("text", ["12.5", "ms", "12,5ms", "5 parsec", "", "nan s", "1..2s"])
def test_what_is_no_quantity_is_named(text: str) -> None:
    with pytest.raises(UsageError, match="is not an offset"):
        parse_offset(text)
    with pytest.raises(UsageError, match="is not a drift"):
        parse_drift(text)


@pytest.mark.parametrize("text", ["1e99s", "-1e20s", "1e999999999s"])
def test_an_offset_of_ages_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="offset"):
        parse_offset(text)


def test_a_drift_beyond_belief_is_refused() -> None:
    with pytest.raises(UsageError, match="no clock's"):
        Clock(drift=Fraction(1, 2))


def test_twenty_ppm_over_ten_minutes_is_twelve_milliseconds() -> None:
    start = 1_700_000_000_000_000_001
    clock = Clock(offset_ns=5, drift=parse_drift("20ppm"), anchor_ns=start)
    assert clock(start) == start + 5
    assert clock(start + 600 * 10**9) == start + 600 * 10**9 + 12_000_000 + 5
    assert clock.all([start, start + 1]).tolist() == [start + 5, start + 6]
    assert clock.lines()["drift_ppm"] == "20"


@given(
    stamp=st.integers(0, 2**62),
    later=st.integers(0, 2**40),
    offset=st.integers(-(2**50), 2**50),
    ppb=st.integers(-(10**6), 10**6),
    anchor=st.integers(0, 2**62),
)
def test_the_mapping_is_exact_and_keeps_order(stamp: int, later: int, offset: int, ppb: int, anchor: int) -> None:
    clock = Clock(offset, Fraction(ppb, 10**9), anchor)
    exact = stamp + offset + Fraction(ppb, 10**9) * (stamp - anchor)
    assert abs(clock(stamp) - exact) <= Fraction(1, 2)
    assert clock(stamp + later) >= clock(stamp)
