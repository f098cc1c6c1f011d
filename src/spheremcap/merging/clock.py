"""A sensor's clock against the recording's: offset and drift, in exact integer and rational arithmetic."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from spheremcap.errors import UsageError

StampArray = npt.NDArray[np.int64]

_TIME_UNITS = {
    "ns": 1,
    "us": 1_000,
    "µs": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "min": 60_000_000_000,
    "h": 3_600_000_000_000,
}
_DRIFT_UNITS = {"ppb": Fraction(1, 10**9), "ppm": Fraction(1, 10**6), "%": Fraction(1, 100)}
_QUANTITY = re.compile(r"^\s*([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,2})?)\s*([a-zA-Zµ%]+)\s*$")


@dataclass(frozen=True, slots=True)
class Clock:
    """How a stamp becomes one on the common time line: t + offset_ns + (t - anchor_ns) * drift, rounded half
    up.

    `offset_ns` is what to add at `anchor_ns` (a stamp of the sensor's own clock, usually its first); `drift`
    is what to add per nanosecond since then: +20 ppm is a sensor whose clock runs 20 us a second too slowly.
    """

    offset_ns: int = 0
    drift: Fraction = Fraction(0)
    anchor_ns: int = 0

    def __post_init__(self) -> None:
        if abs(self.drift) > Fraction(1, 10):
            raise UsageError(f"a drift of {float(self.drift):.3g} is no clock's: at most 10 % either way")

    def __call__(self, stamp_ns: int) -> int:
        """The stamp on the common time line, exact for any int."""
        if not self.drift:
            return stamp_ns + self.offset_ns
        n, d = self.drift.numerator, self.drift.denominator
        return stamp_ns + self.offset_ns + (2 * (stamp_ns - self.anchor_ns) * n + d) // (2 * d)

    def all(self, stamps_ns: Iterable[int]) -> StampArray:
        """`__call__` of every stamp, (N,) int64."""
        return np.array([self(int(stamp)) for stamp in stamps_ns], np.int64)

    def lines(self) -> dict[str, str]:
        """What a metadata record says of it."""
        return {
            "offset_ns": str(self.offset_ns),
            "drift_ppm": format_exact(self.drift * 10**6),
            "anchor_ns": str(self.anchor_ns),
            "mapping": "log_time = t + offset_ns + (t - anchor_ns) * drift_ppm / 1e6, t is the publish time",
        }


def format_exact(value: Fraction) -> str:
    """A decimal number where there is an exact one of at most 28 digits, else the fraction."""
    decimal = Decimal(value.numerator) / Decimal(value.denominator)
    return f"{decimal:f}" if Fraction(decimal) == value else str(value)


def format_offset(offset_ns: int) -> str:
    """A text that `parse_offset` reads back exactly: `+12.5ms`, `-2h`."""
    size = abs(offset_ns)
    if size and size % _TIME_UNITS["h"] == 0:
        unit = "h"
    else:
        unit = next((u for u in ("s", "ms", "us") if size >= _TIME_UNITS[u]), "ns")
    return f"{'-' if offset_ns < 0 else '+'}{format_exact(Fraction(size, _TIME_UNITS[unit]))}{unit}"


def parse_offset(text: str) -> int:
    """`+12.5ms`, `-3 s`, `250us` to whole nanoseconds, rounded half up. Raises UsageError."""
    value = _quantity(text, _TIME_UNITS, "an offset", "+12.5ms") * 2
    if abs(value) >= 1 << 63:
        raise UsageError(f"an offset of {text} is no clock's: at most 146 years either way")
    return (value.numerator + value.denominator) // (2 * value.denominator)


def parse_drift(text: str) -> Fraction:
    """`-20ppm`, `150 ppb`, `0.01%` to an exact ratio. Raises UsageError."""
    return _quantity(text, _DRIFT_UNITS, "a drift", "-20ppm")


def _quantity(text: str, units: dict[str, int] | dict[str, Fraction], what: str, example: str) -> Fraction:
    match = _QUANTITY.match(text)
    if match is None or match[2] not in units:
        raise UsageError(f"{text!r} is not {what}: a number and one of {', '.join(units)} are wanted, as in {example}")
    return Fraction(match[1]) * units[match[2]]
