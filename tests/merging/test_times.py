"""Cells as times: to the nanosecond, whatever the notation; and what such stamps count from."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremcap.merging.times import NotATimeError, is_date, is_time, is_time_of_day, read_times

S = 10**9
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def ns(*date: int) -> int:
    return (datetime(*date, tzinfo=UTC) - EPOCH) // timedelta(seconds=1) * S  # type: ignore[misc,arg-type]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2025-07-14 10:00:00.5", ns(2025, 7, 14, 10) + S // 2),
        ("2025-07-14T10:00:00,123456789Z", ns(2025, 7, 14, 10) + 123_456_789),
        ("2025/7/4 10:00", ns(2025, 7, 4, 10)),
        ("2025-07-11_20:06:00", ns(2025, 7, 11, 20, 6)),
        ("14.07.2025 10:00:00:250", ns(2025, 7, 14, 10) + S // 4),
        ("14.07.2025, 10:00:00", ns(2025, 7, 14, 10)),
        ("14.07.25 10:00:00", ns(2025, 7, 14, 10)),
        ("14.07.2025", ns(2025, 7, 14)),
        ("14/07/2025 10:00:00+02:00", ns(2025, 7, 14, 8)),
        ("7/14/2025 1:30:00 PM", ns(2025, 7, 14, 13, 30)),
        ("7/14/2025 12:30:00 AM", ns(2025, 7, 14, 0, 30)),
        ("7/4/2025 1:30:00 PM", ns(2025, 7, 4, 13, 30)),
        ("4/7/2025 13:30:00", ns(2025, 7, 4, 13, 30)),
        ("29.02.2024 23:59:59.999999999", ns(2024, 2, 29, 23, 59, 59) + 999_999_999),
        ("1999-12-31 23:00:00-01:30", ns(2000, 1, 1, 0, 30)),
    ],
)
def test_dates(text: str, expected: int) -> None:
    assert is_date(text)
    stamp_ns, timing = read_times([text], "date")
    assert stamp_ns.tolist() == [expected]
    assert timing.zero == "1970"


def test_one_row_says_for_all_whether_the_day_comes_first() -> None:
    stamp_ns, timing = read_times(["03/04/2025 10:00:00", "13/04/2025 10:00:00"], "date")
    assert stamp_ns.tolist() == [ns(2025, 4, 3, 10), ns(2025, 4, 13, 10)]
    assert timing.how == "as dates, day first, no zone, taken for UTC"
    stamp_ns, timing = read_times(["03/04/2025 10:00:00", "03/14/2025 10:00:00"], "date")
    assert stamp_ns.tolist() == [ns(2025, 3, 4, 10), ns(2025, 3, 14, 10)]
    assert "month first" in timing.how
    _, timing = read_times(["03/04/2025 10:00:00"], "date")
    assert "day first (no row says which)" in timing.how
    assert "no row" not in read_times(["03.04.2025 10:00:00"], "date")[1].how
    stamp_ns, _ = read_times(["03/04/2025 10:00:00"], "date", month_first=True)
    assert stamp_ns.tolist() == [ns(2025, 3, 4, 10)]
    with pytest.raises(NotATimeError) as caught:
        read_times(["13/04/2025 10:00:00", "03/14/2025 10:00:00"], "date", month_first=False)
    assert caught.value.row == 1


def test_a_zone_that_is_not_said_is_assumed_and_that_is_told() -> None:
    assert read_times(["2025-07-14 10:00:00"], "date")[1].zone_assumed
    assert not read_times(["2025-07-14 10:00:00Z"], "date")[1].zone_assumed
    assert "zone" not in read_times(["2025-07-14 10:00:00+0200"], "date")[1].how


def test_times_of_day_go_on_after_midnight() -> None:
    stamp_ns, timing = read_times(["23:59:59.5", "00:00:00.5", "00:00:01.5"], "date")
    day = 86_400 * S
    assert stamp_ns.tolist() == [day - S // 2, day + S // 2, day + 3 * S // 2]
    assert (timing.zero, timing.zone_assumed) == ("midnight", True)


def test_times_of_day_that_begin_near_zero_are_since_the_start() -> None:
    stamp_ns, timing = read_times(["0:00:12.0", "1:00:00.25"], "date")
    assert stamp_ns.tolist() == [12 * S, 3600 * S + S // 4]
    assert timing.zero == "start"


@pytest.mark.parametrize(("unit", "size"), [("s", S), ("ms", S // 1000), ("us", 1000), ("ns", 1), ("min", 60 * S)])
def test_numbers_in_a_unit(unit: str, size: int) -> None:
    stamp_ns, timing = read_times(["12", "1e3"], unit)
    assert stamp_ns.tolist() == [12 * size, 1000 * size]
    assert timing.zero == "start"
    stamp_ns, timing = read_times(["1752480000.123456789"], "s")
    assert stamp_ns.tolist() == [1_752_480_000_123_456_789]
    assert timing.zero == "1970"


@pytest.mark.parametrize(
    ("texts", "unit"),
    [
        (["1", "nan"], "s"),
        (["1", "inf"], "s"),
        (["1", "1e300"], "s"),
        (["1", "1e999999999"], "s"),
        (["1", "9e9"], "s"),
        (["1", "x"], "ms"),
        (["2025-07-14", "2025-02-30"], "date"),
        (["2025-07-14", "0000-01-01"], "date"),
        (["2025-07-14", "2200-01-01"], "date"),
        (["2025-07-14 10:00:00", "2025-07-14 24:00:00"], "date"),
        (["2025-07-14 10:00:00", "10:00:01"], "date"),
        (["10:00:00", "10:60:00"], "date"),
        (["1:00:00 PM", "13:00:00 PM"], "date"),
    ],
)
def test_what_is_no_time_is_found_by_its_row(texts: list[str], unit: str) -> None:
    with pytest.raises(NotATimeError) as caught:
        read_times(texts, unit)
    assert caught.value.row == 1


@pytest.mark.parametrize("text", ["1.2.25", "1.2", "10:30", "16:9", "", "12", "1-2-3", "2025", "a 10:00:00"])
def test_versions_and_ratios_are_no_times(text: str) -> None:
    assert not is_time(text)


def test_a_time_of_day_needs_its_seconds() -> None:
    assert is_time_of_day("9:05:00")
    assert not is_time_of_day("9:05")


@settings(max_examples=200, deadline=None)
@given(st.lists(st.text(alphabet="0123456789.:/-+ TZapmPM,e", max_size=24), min_size=1, max_size=4), st.booleans())
def test_any_text_is_a_time_or_not(texts: list[str], dated: bool) -> None:
    row = None
    try:
        stamp_ns, _ = read_times(texts, "date" if dated else "s")
        assert len(stamp_ns) == len(texts)
    except NotATimeError as error:
        row = error.row
    assert row is None or 0 <= row < len(texts)
