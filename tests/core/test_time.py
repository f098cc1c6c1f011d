from datetime import UTC, datetime
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.core.time import format_time, parse_time_ns, ticks_to_ns

bases = st.builds(Fraction, st.integers(1, 10**6), st.integers(1, 10**9))
stamps = st.integers(-2_208_988_800 * 10**9, 253_402_300_799 * 10**9)  # years 1900 to 9999


@pytest.mark.parametrize(
    ("ticks", "base", "expected"),
    [
        (1, Fraction(1001, 30000), 33_366_667),  # 29.97: 33 366 666.67
        (30000, Fraction(1001, 30000), 1_001_000_000_000),
        (1, Fraction(1001, 240000), 4_170_833),  # 239.76: 4 170 833.33
        (2, Fraction(1001, 240000), 8_341_667),
        (3, Fraction(1001, 240000), 12_512_500),
        (240000 * 3600, Fraction(1001, 240000), 3_603_600_000_000_000),
        (-1, Fraction(1, 3), -333_333_333),
        (0, Fraction(1, 90000), 0),
        (2**53 + 1, Fraction(1, 10**9), 2**53 + 1),  # a float would lose the last bit
    ],
)
def test_ticks_are_converted_exactly(ticks, base, expected):
    assert ticks_to_ns(ticks, base) == expected


@given(st.integers(-(2**62), 2**62), bases)
def test_no_stamp_is_more_than_half_a_nanosecond_off(ticks, base):
    exact = ticks * base * 10**9
    off = ticks_to_ns(ticks, base) - exact
    assert -Fraction(1, 2) < off <= Fraction(1, 2)  # half goes up


@given(st.integers(-(10**12), 10**12))
def test_equal_steps_never_drift(ticks):
    base = Fraction(1001, 240000)
    assert ticks_to_ns(ticks + 240000, base) - ticks_to_ns(ticks, base) == 1001 * 10**9


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0", 0),
        ("-1.5", -1_500_000_000),
        ("1.5e9", 1_500_000_000_000_000_000),
        ("1748772000.123456789", 1_748_772_000_123_456_789),
        ("1970-01-01T00:00:00Z", 0),
        ("2025-06-01T10:00:00.5Z", 1_748_772_000_500_000_000),
        ("2025-06-01T10:00:00,5Z", 1_748_772_000_500_000_000),
        ("20250601T100000,25+0200", 1_748_764_800_250_000_000),
        ("2025-06-01T10:00:00", 1_748_772_000_000_000_000),
        ("2025-06-01T12:00:00+02:00", 1_748_772_000_000_000_000),
        ("  2025-06-01 10:00:00  ", 1_748_772_000_000_000_000),
    ],
)
def test_a_time_is_iso_or_decimal_seconds(text, expected):
    assert parse_time_ns(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        "yesterday", "", "12:00", "2025-13-01T00:00:00Z", "1/3", "1_000", "nan", "1e400",
        "2025-06-01T10:00:00,", "2025-06-01T10:00:00.5.5", "2025-06-01T10.5", "2025-06-01T10:30,5",
    ],
)  # fmt: skip
def test_what_is_no_time_is_refused(text):
    with pytest.raises(ValueError, match=r".+"):
        parse_time_ns(text)


def test_nanoseconds_written_in_iso_are_kept():
    assert parse_time_ns("2025-06-01T10:00:00.123456789Z") == 1_748_772_000_123_456_789


@given(stamps)
def test_a_printed_time_holds_every_nanosecond(stamp):
    text = format_time(stamp)
    whole, nanos = text.removesuffix("Z").split(".")
    seconds = int(
        (datetime.fromisoformat(whole).replace(tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds()
    )
    assert seconds * 10**9 + int(nanos) == stamp


@given(stamps)
def test_a_printed_time_is_read_back_as_the_same_to_the_microsecond(stamp):
    assert parse_time_ns(format_time(stamp - stamp % 1000)) == stamp - stamp % 1000


def test_an_early_year_has_four_digits():
    assert format_time(-30_610_224_000_000_000_001) == "0999-12-31T23:59:59.999999999Z"


@given(st.integers(0, 4 * 10**18))
def test_decimal_seconds_are_exact(stamp):
    assert parse_time_ns(f"{stamp // 10**9}.{stamp % 10**9:09d}") == stamp


def test_a_known_moment_prints_as_people_write_it():
    assert format_time(1_748_772_000_000_000_007) == "2025-06-01T10:00:00.000000007Z"
