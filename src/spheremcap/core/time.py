"""Time is int nanoseconds; container stamps are converted as exact rationals, never through floats."""

import re
from datetime import UTC, datetime, timedelta
from fractions import Fraction

NS_PER_S = 1_000_000_000
LARGEST_RELATIVE_NS = 10**17
"""What is told as a time counts from some start below this, about three years, and from 1970 above it."""


def ticks_to_ns(ticks: int | Fraction, time_base: Fraction) -> int:
    """Convert container ticks to nanoseconds, rounded half up from the exact rational.

    `ticks` counts units of `time_base` seconds (a PTS of an FFmpeg stream, whole unless it is counted from elsewhere);
    the result may be negative.
    """
    numerator = ticks * time_base.numerator * NS_PER_S
    denominator = time_base.denominator
    return (2 * numerator + denominator) // (2 * denominator)


_SECONDS = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,2})?", re.ASCII)
_SPLIT_SECONDS = re.compile(r"(.+[^\d:+-]\d\d:?\d\d:?\d\d)[.,](\d+)(.*)", re.ASCII)
"""ISO 8601 whose seconds have decimals: what is before them, the decimals, the zone."""


def parse_time_ns(text: str) -> int:
    """Parse ISO 8601 (`2025-06-01T10:00:00.5Z`; no zone means UTC) or decimal Unix seconds, to ns since 1970.

    ISO's other decimal sign, the comma, will do as well. Nine decimals are kept exactly, further ones are cut off.
    Raises ValueError when `text` is neither.
    """
    text = text.strip()
    if len(text) < 100 and _SECONDS.fullmatch(text):
        return int(Fraction(text) * NS_PER_S)
    parts = _SPLIT_SECONDS.fullmatch(text)
    whole = text if parts is None else parts[1] + parts[3]
    if "." in whole or "," in whole:  # datetime would take any decimals for those of a second
        raise ValueError(f"{text!r}: only seconds may have decimals")
    stamp = datetime.fromisoformat(whole)
    if stamp.tzinfo is None:
        stamp = stamp.replace(tzinfo=UTC)
    delta = stamp - datetime(1970, 1, 1, tzinfo=UTC)
    nanos = 0 if parts is None else int(parts[2][:9].ljust(9, "0"))
    return (delta.days * 86_400 + delta.seconds) * NS_PER_S + nanos


def format_time(stamp_ns: int) -> str:
    """ISO 8601 in UTC with all nine decimals, for people; exact for every stamp from year 1 on."""
    seconds, nanos = divmod(stamp_ns, NS_PER_S)
    whole = (datetime(1970, 1, 1) + timedelta(seconds=seconds)).isoformat()
    return f"{whole}.{nanos:09d}Z"
