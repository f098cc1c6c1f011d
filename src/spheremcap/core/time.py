"""Time is int nanoseconds; container stamps are converted as exact rationals, never through floats."""

import re
from datetime import UTC, datetime, timedelta
from fractions import Fraction

NS_PER_S = 1_000_000_000


def ticks_to_ns(ticks: int, time_base: Fraction) -> int:
    """Convert container ticks to nanoseconds, rounded half up from the exact rational.

    `ticks` counts units of `time_base` seconds (a PTS of an FFmpeg stream); the result may be negative.
    """
    numerator = ticks * time_base.numerator * NS_PER_S
    denominator = time_base.denominator
    return (2 * numerator + denominator) // (2 * denominator)


def parse_time_ns(text: str) -> int:
    """Parse ISO 8601 (`2025-06-01T10:00:00.5Z`; no zone means UTC) or decimal Unix seconds, to ns since 1970.

    Decimal digits are kept exactly to the nanosecond. Raises ValueError when `text` is neither.
    """
    text = text.strip()
    try:
        return int(Fraction(text) * NS_PER_S)
    except (ValueError, ZeroDivisionError):
        pass
    fraction = re.search(r"\.(\d{1,9})", text)
    stamp = datetime.fromisoformat(text if fraction is None else text.replace(fraction[0], "", 1))
    if stamp.tzinfo is None:
        stamp = stamp.replace(tzinfo=UTC)
    delta = stamp - datetime(1970, 1, 1, tzinfo=UTC)
    return (delta.days * 86_400 + delta.seconds) * NS_PER_S + (int(fraction[1].ljust(9, "0")) if fraction else 0)


def format_time(stamp_ns: int) -> str:
    """ISO 8601 in UTC with all nine decimals, for people; exact for every stamp from year 1 on."""
    seconds, nanos = divmod(stamp_ns, NS_PER_S)
    whole = (datetime(1970, 1, 1) + timedelta(seconds=seconds)).isoformat()
    return f"{whole}.{nanos:09d}Z"
