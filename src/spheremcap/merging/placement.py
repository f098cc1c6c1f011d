"""Where each input lies on the common time line, why, and what lies apart from all others.

Every input has one clock, which is computed before anything is read through it. A recording, and a sensor with a true
clock, stands where its stamps say. Stamps that count from the start of a device keep their distance from it, and that
start is taken for the recordings'; times of day are put on the day that brings them nearest to it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.merging.clock import Clock, format_exact, format_offset
from spheremcap.merging.times import DAY_NS, YEAR_2000_NS, Timing, Zero

_QUARTER_NS = 900 * NS_PER_S
_FARTHEST_ZONE_NS = 14 * 3_600 * NS_PER_S


@dataclass(frozen=True)
class Placement:
    """An input's place: how many messages or samples, their first and last own stamp, how those were read, the clock
    that maps them, and in words what it adds. `label` is how flags call the input, `given_ns` its offset as given.
    """

    name: str
    label: str
    input: str
    what: Literal["messages", "samples"]
    count: int
    first_ns: int
    last_ns: int
    rate_hz: float | None
    timing: Timing
    clock: Clock
    added: tuple[str, ...]
    given_ns: int = 0

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp on the common time line."""
        return self.clock(self.first_ns), self.clock(self.last_ns)

    def line(self) -> str:
        """The placement in one line, for a person."""
        rate = "" if self.rate_hz is None else f" at {self.rate_hz:.6g} Hz"
        start, end = map(_time, self.span_ns)
        added = ", ".join(self.added) or "nothing"
        return (
            f"{self.name}: {self.count} {self.what}{rate}, {start} to {end}; times: {self.timing.how}; added: {added}"
        )

    def facts(self) -> dict[str, str]:
        """What a metadata record says of it."""
        start, end = self.span_ns
        return {
            "input": self.input,
            "samples": str(self.count),
            "first_ns": str(start),
            "last_ns": str(end),
            **({} if self.rate_hz is None else {"rate_hz": f"{self.rate_hz:.6g}"}),
            "times": self.timing.how,
            "added": ", ".join(self.added) or "nothing",
        } | self.clock.lines()


def given_words(offset_ns: int, drift: Fraction) -> tuple[str, ...]:
    """Offset and drift as the user gave them, in words; nothing for what is 0."""
    words = (f"{format_offset(offset_ns)} (offset)", f"{format_exact(drift * 10**6)} ppm (drift)")
    return tuple(word for word, there in zip(words, (offset_ns, drift), strict=True) if there)


def base_ns(zero: Zero, first_ns: int, start_ns: int | None, start_of: str) -> tuple[int, tuple[str, ...]]:
    """What is added to stamps that count from `zero` before any offset, and that in words; `start_ns` is where the
    recordings start.
    """
    if zero == "1970" or start_ns is None or start_ns < YEAR_2000_NS:
        if zero == "start" and start_ns:
            return start_ns, (f"{format_offset(start_ns)}, as its zero is taken for the start of {start_of}",)
        return 0, ()
    if zero == "start":
        return start_ns, (f"{_time(start_ns)}, as its zero is taken for the start of {start_of}",)
    days = range(start_ns // DAY_NS - 1, start_ns // DAY_NS + 2)
    midnight = min((day * DAY_NS for day in days), key=lambda ns: abs(ns + first_ns - start_ns))
    return midnight, (f"{_time(midnight)}, the midnight that brings it nearest to the start of {start_of}",)


def apart(placements: Sequence[Placement]) -> list[str]:
    """A line for each input that overlaps neither the first one nor any that overlaps it, and so on."""
    ordered = sorted(placements, key=lambda p: p.span_ns)
    groups: list[list[Placement]] = []
    until = None
    for place in ordered:
        start, end = place.span_ns
        if until is None or start > until:
            groups.append([])
            until = end
        groups[-1].append(place)
        until = max(until, end)
    if len(groups) < 2:
        return []
    main = next(group for group in groups if placements[0] in group)
    inside = min(p.span_ns[0] for p in main), max(p.span_ns[1] for p in main)
    others = " and ".join([*dict.fromkeys(p.name for p in main)][:3])
    return [
        f"{place.name} ({_time(place.span_ns[0])} to {_time(place.span_ns[1])}) does not overlap {others} "
        f"({_time(inside[0])} to {_time(inside[1])}); {_remedy(place, inside)}"
        for place in placements
        if place not in main
    ]


def _remedy(place: Placement, inside: tuple[int, int]) -> str:
    """The offset that would bring an input over the others: whole quarters of an hour where its zone is not known."""
    start, end = place.span_ns
    if place.timing.zone_assumed:
        shift = -((start - inside[0]) // _QUARTER_NS) * _QUARTER_NS
        for zone in (shift, shift - _QUARTER_NS):
            if abs(zone) <= _FARTHEST_ZONE_NS and start + zone <= inside[1] and end + zone >= inside[0]:
                offset = format_offset(zone + place.given_ns)
                return f"its zone is not known: if its clock is local time, --offset {place.label}={offset}"
    offset = format_offset(inside[0] - start + place.given_ns)
    return f"to let both start together, --offset {place.label}={offset}"


def _time(stamp_ns: int) -> str:
    """A date where it is one, else seconds."""
    return format_time(stamp_ns) if YEAR_2000_NS <= stamp_ns < 1 << 63 else f"{stamp_ns / NS_PER_S:.3f} s"
