"""How the cells of a table are times: numbers in a unit, dates (year, day or month first) and times of day, to exact
int nanoseconds; and what such stamps count from.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from decimal import Decimal, InvalidOperation
from typing import Literal

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.merging.units import TIME_UNITS, plain

StampArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Zero = Literal["1970", "start", "midnight"]

DAY_NS = 86_400 * NS_PER_S
LATEST_NS = 1 << 62
"""The year 2116: two stamps, and what is between them, fit into 64 bits."""
YEAR_2000_NS = 946_684_800 * NS_PER_S
_HOUR_NS = 3_600 * NS_PER_S

MISSING = frozenset(
    [
        "na", "n/a", "n.a.", "#n/a", "#na", "#nv", "k.a.", "nan", "null", "none", "nil", "-", "--", "---", "?",
        "#div/0!", "#value!", "#wert!", "#ref!", "#bezug!", "#num!", "#zahl!",
        "inf", "-inf", "+inf", "infinity", "-infinity", "+infinity",
    ]
)  # fmt: skip
"""What programs write where there is no number; an infinite one is none either."""

_DAY = r"(\d{1,4})([-/.])(\d{1,2})[-/.](\d{1,4})"
_CLOCK = r"(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,](\d+)|:(\d{3}))?)?(?:\s*([AaPp])\.?[Mm]\.?)?"
_ZONE = r"\s*(Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)?"
_DATE = re.compile(rf"\s*{_DAY}(?:(?:\s*[T_,]\s*|\s+){_CLOCK}{_ZONE})?\s*", re.ASCII | re.IGNORECASE)
_TIME_OF_DAY = re.compile(rf"\s*{_CLOCK}{_ZONE}\s*", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Timing:
    """What a sensor's stamps are: `how` they were read, in words, and the `zero` that they count from: 1970 (a true
    clock), midnight, or the start of the device or of its recording. `zone_assumed`: dates that do not say their zone
    were taken for UTC.
    """

    how: str = ""
    zero: Zero = "1970"
    zone_assumed: bool = False

    def text(self, stamp_ns: int) -> str:
        """A stamp for a person."""
        return format_time(stamp_ns) if self.zero == "1970" else f"{stamp_ns / NS_PER_S:.3f} s"


class NotATimeError(ValueError):
    """The `row`th text is not a time."""

    def __init__(self, row: int) -> None:
        self.row = row


def is_missing(text: str) -> bool:
    """Whether a cell says that there is no value."""
    bare = text.strip()
    return not bare or bare.lower() in MISSING


def is_date(text: str) -> bool:
    """Whether a cell is a date, with a time of day or without: 2025-07-14 10:00:00.5, 14.07.2025, 7/14/25 1:30 PM."""
    found = _DATE.fullmatch(text)
    if found is None:
        return False
    years = [len(found[k]) for k in (1, 4)]
    return (years == [4, years[1]] and years[1] <= 2) or (years[0] <= 2 and (years[1] == 4 or _timed(found, years[1])))


def _timed(found: re.Match[str], digits: int) -> bool:
    """A year of two digits needs a time of day behind it: 1.2.25 may be a version."""
    return digits == 2 and found[5] is not None


def is_time_of_day(text: str) -> bool:
    """Whether a cell is a time of day, with seconds."""
    found = _TIME_OF_DAY.fullmatch(text)
    return found is not None and found[3] is not None


def is_time(text: str) -> bool:
    """Whether a cell is a date or a time of day."""
    return is_date(text) or is_time_of_day(text)


def read_times(texts: Sequence[str], unit: str, *, month_first: bool | None = None) -> tuple[StampArray, Timing]:
    """The stamps (N,) and what they are; `unit` is that of numbers, or "date" for dates and times of day.

    Of 03/04/2025 the day comes first unless another row, AM and PM or `month_first` say otherwise. Times of day that
    begin within the first hour are times since the start; those that begin later count from midnight, and go on
    after the next one. Raises NotATimeError.
    """
    if unit != "date":
        stamp_ns = _numbers(texts, TIME_UNITS[plain(unit)])
        relative = bool(len(stamp_ns)) and int(stamp_ns[0]) < YEAR_2000_NS
        return stamp_ns, Timing(f"in {plain(unit)}", "start" if relative else "1970")
    first = next((text for text in texts if text), "")
    return _times_of_day(texts) if is_time_of_day(first) else _dates(texts, month_first)


def _numbers(texts: Sequence[str], unit_ns: int) -> StampArray:
    out = np.empty(len(texts), np.int64)
    for k, text in enumerate(texts):
        try:
            number = Decimal(text.strip())
            if not number.is_finite() or number.adjusted() > 20:
                raise NotATimeError(k)
            ns = int((number * unit_ns).to_integral_value())
        except InvalidOperation:
            raise NotATimeError(k) from None
        if abs(ns) >= LATEST_NS:
            raise NotATimeError(k)
        out[k] = ns
    return out


def _dates(texts: Sequence[str], month_first: bool | None) -> tuple[StampArray, Timing]:
    found: list[re.Match[str]] = []
    for k, text in enumerate(texts):
        match = _DATE.fullmatch(text)
        if match is None or not is_date(text):
            raise NotATimeError(k)
        found.append(match)
    year_last = [m for m in found if len(m[1]) <= 2]
    order = ""
    if year_last:
        above = {which for m in year_last for which in (1, 3) if int(m[which]) > 12}
        if month_first is None:
            month_first = 3 in above or (not above and any(m[10] for m in year_last))
        sure = above or (year_last[0][2] == ".")
        order = f", {'month' if month_first else 'day'} first" + ("" if sure else " (no row says which)")
    days: dict[tuple[str, str, str], int] = {}
    out = np.empty(len(found), np.int64)
    zones = 0
    for k, match in enumerate(found):
        key = (match[1], match[3], match[4])
        try:
            if key not in days:
                days[key] = _day(key, bool(month_first))
            zones += match[11] is not None
            ns = days[key] * DAY_NS + _clock_ns(match, 5) - _zone_ns(match[11])
            if abs(ns) >= LATEST_NS:
                raise ValueError
            out[k] = ns
        except ValueError:
            raise NotATimeError(k) from None
    assumed = zones < len(found)
    how = f"as dates{order}" + (", no zone, taken for UTC" if assumed else "")
    return out, Timing(how, "1970", assumed)


def _day(parts: tuple[str, str, str], month_first: bool) -> int:
    """Days since 1970."""
    if len(parts[0]) > 2:
        year, month, day = map(int, parts)
    else:
        day, month, year = map(int, parts)
        if month_first:
            day, month = month, day
        if len(parts[2]) == 2:
            year += 2000
    return date(year, month, day).toordinal() - date(1970, 1, 1).toordinal()


def _times_of_day(texts: Sequence[str]) -> tuple[StampArray, Timing]:
    out = np.empty(len(texts), np.int64)
    zones = 0
    for k, text in enumerate(texts):
        match = _TIME_OF_DAY.fullmatch(text)
        if match is None:
            raise NotATimeError(k)
        try:
            out[k] = _clock_ns(match, 1) - _zone_ns(match[7])
        except ValueError:
            raise NotATimeError(k) from None
        zones += match[7] is not None
    if len(out) and out[0] < _HOUR_NS and not zones:
        return out, Timing("as hours:minutes:seconds since the start", "start")
    midnights = np.concatenate([[0], np.cumsum(np.diff(out) < -DAY_NS // 2)]) if len(out) else 0
    assumed = zones < len(out)
    how = "as times of day" + (", no zone, taken for UTC" if assumed else "")
    return out + midnights * DAY_NS, Timing(how, "midnight", assumed)


def _clock_ns(match: re.Match[str], at: int) -> int:
    """Nanoseconds since midnight of the groups from `at` on; digits beyond the ninth are cut off."""
    if match[at] is None:
        return 0
    hour, minute, second = int(match[at]), int(match[at + 1]), int(match[at + 2] or 0)
    half = match[at + 5]
    if half is not None:
        if not 1 <= hour <= 12:
            raise ValueError
        hour = hour % 12 + (12 if half in "pP" else 0)
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError
    decimals = match[at + 3] or match[at + 4] or ""
    return ((hour * 60 + minute) * 60 + second) * NS_PER_S + int(decimals[:9].ljust(9, "0"))


def _zone_ns(zone: str | None) -> int:
    if zone is None or zone[0] not in "+-":
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return int(zone[0] + "1") * (int(digits[:2]) * 60 + int(digits[2:])) * 60 * NS_PER_S
