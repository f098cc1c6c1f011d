"""The page's figures: a dot for each session, in a strip for each marker or sensor, so that what is far off is seen."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from spheremcap.analysis.markup import figure, number, percent, plain, ticks
from spheremcap.season.page_usual import Usual, usual_residual, usual_share
from spheremcap.season.rows import SessionRow, share_of

STRIPS = 16
"""Strips in one figure at most."""
_LEFT, _RIGHT, _TOP, _STRIP = 170.0, 640.0, 10.0, 36.0
_BESIDE = 13.0
"""How far from its strip's middle a dot is at most, px."""
_NEAR = 4.0
"""Dots that are so near each other lie above each other, px."""
_LETTERS = 22, 34
"""Of a name that are drawn to the left, and to the right."""

_Strips = Mapping[str, Mapping[str, float]]
"""By the strip's name, each session's value by its name."""


@dataclass(frozen=True)
class _Quantity:
    """What is drawn: what is usual of it, a value and a tick in words, and whether small or large ones are bad."""

    usual: Callable[[Sequence[float]], Usual | None]
    words: Callable[[float], str]
    tick: Callable[[float], str]
    small_is_bad: bool

    def far(self, strip: Mapping[str, float]) -> set[str]:
        """The sessions that are far off."""
        told = self.usual(list(strip.values()))
        if told is None:
            return set()
        sign = 1 if self.small_is_bad else -1
        return {session for session, value in strip.items() if sign * value < sign * told.limit}

    def worst(self, strip: Mapping[str, float]) -> tuple[str, float]:
        """The worst session and its value."""
        sign = 1 if self.small_is_bad else -1
        return min(strip.items(), key=lambda item: (sign * item[1], item[0]))


_SHARES = _Quantity(usual_share, percent, lambda share: plain(100 * share), True)
_RESIDUALS = _Quantity(usual_residual, lambda ms: f"{number(ms, 3)} ms", plain, False)


def shares_figure(rows: Sequence[SessionRow]) -> str:
    """The share measured of every session, of all markers and of each; "" where there is none."""
    every = {row.session: row.measured for row in rows if row.measured is not None}
    markers: dict[str, dict[str, float]] = defaultdict(dict)
    for row in rows:
        for marker in row.marker_outcomes:
            if (share := share_of(marker)) is not None:
                markers[marker.marker][row.session] = share
    if not every:
        return ""
    strips = {"all markers": every, **_worst_ones(markers, _SHARES)}
    lowest = min(value for strip in strips.values() for value in strip.values())
    caption = (
        "Share of its frames on which a marker was measured, %. Each dot is a session, the upright line is the median "
        "session; to the right stands the session with the lowest share. "
        + _more(len(markers), "markers", "the lowest shares") + _orange(strips, _SHARES, "below")
    )  # fmt: skip
    return _figure("Share measured of each session", caption, strips, _SHARES, (_floor(min(lowest, 0.9)), 1.0))


def residuals_figure(rows: Sequence[SessionRow]) -> str:
    """The sync residual of every session, by sensor; "" where there is none."""
    sensors: dict[str, dict[str, float]] = defaultdict(dict)
    for row in rows:
        for clock in row.clocks:
            if clock.residual_ms is not None:
                sensors[clock.sensor][row.session] = clock.residual_ms
    if not sensors:
        return ""
    strips = _worst_ones(sensors, _RESIDUALS)
    highest = max(value for strip in strips.values() for value in strip.values())
    caption = (
        "Sync residual of each session's sensors, ms. Each dot is a session, the upright line is the median session; "
        "to the right stands the session with the largest residual. "
        + _more(len(sensors), "sensors", "the largest residuals") + _orange(strips, _RESIDUALS, "above")
    )  # fmt: skip
    return _figure("Sync residual of each session", caption, strips, _RESIDUALS, (0.0, highest or 1.0))


def _floor(share: float) -> float:
    """A tenth, rounded down."""
    return float(np.floor(10 * share)) / 10


def _worst_ones(strips: _Strips, quantity: _Quantity) -> dict[str, Mapping[str, float]]:
    """By name; where there are too many, those with the worst sessions."""
    sign = 1 if quantity.small_is_bad else -1
    worst = sorted(strips, key=lambda name: (sign * quantity.worst(strips[name])[1], name))
    return {name: strips[name] for name in sorted(worst[:STRIPS])}


def _more(count: int, what: str, why: str) -> str:
    return f"There are {count} {what}: those with {why} are drawn. " if count > STRIPS else ""


def _orange(strips: _Strips, quantity: _Quantity, where: str) -> str:
    far = any(quantity.far(strip) for strip in strips.values())
    return f"Orange: far {where} what is usual, as explained below." if far else ""


def _figure(
    title: str, caption: str, strips: _Strips, quantity: _Quantity, shown: tuple[float, float]
) -> str:  # fmt: skip
    """`shown` is what of the values lies between the left and the right edge."""
    bottom = _TOP + _STRIP * len(strips)

    def at(value: float) -> float:
        return _LEFT + (value - shown[0]) / (shown[1] - shown[0]) * (_RIGHT - _LEFT)

    parts = []
    for tick in ticks(*shown, 6).tolist():
        x = at(tick)
        parts.append(f'<path class="grid" d="M{x:.1f} {_TOP:.1f}V{bottom:.1f}"/>')
        parts.append(f'<text class="tick mid" x="{x:.1f}" y="{bottom + 18:.1f}">{quantity.tick(tick)}</text>')
    for k, (name, strip) in enumerate(strips.items()):
        middle = _TOP + _STRIP * (k + 0.5)
        parts.append(
            f'<text class="tick end" x="{_LEFT - 14:.1f}" y="{middle + 4:.1f}">{_cut(name, _LETTERS[0])}</text>'
        )
        parts.append(_dots({session: at(value) for session, value in strip.items()}, quantity.far(strip), middle))
        x = at(float(np.median(list(strip.values()))))
        parts.append(f'<path class="median" d="M{x:.1f} {middle - 16:.1f}v32"/>')
        session, value = quantity.worst(strip)
        said = f"{_cut(session, _LETTERS[1])}: {quantity.words(value)}"
        parts.append(f'<text class="tick" x="{_RIGHT + 16:.1f}" y="{middle + 4:.1f}">{said}</text>')
    parts.append(f'<path class="axis" d="M{_LEFT:.1f} {bottom:.1f}H{_RIGHT:.1f}"/>')
    return figure(title, caption, 960, round(bottom + 26), "".join(parts))


def _dots(places: Mapping[str, float], far: set[str], middle: float) -> str:
    """Sessions at their places across; those near each other go up and down from the middle."""
    near: dict[int, list[str]] = defaultdict(list)
    for session in sorted(places, key=lambda session: (places[session], session)):
        near[round(places[session] / _NEAR)].append(session)
    drawn: dict[str, dict[str, None]] = {"dots": {}, "dots far": {}}
    for sessions in near.values():
        step = min(4.5, _BESIDE / max(1, len(sessions) // 2))
        for k, session in enumerate(sessions):
            y = middle + step * ((k + 1) // 2) * (1 if k % 2 else -1)
            drawn["dots far" if session in far else "dots"][f"M{places[session]:.0f} {y:.1f}h.01"] = None
    return "".join(f'<path class="{look}" d="{"".join(dots)}"/>' for look, dots in drawn.items() if dots)


def _cut(name: str, letters: int) -> str:
    """A name that is too long without its middle."""
    half = letters // 2
    return escape(name if len(name) <= letters else f"{name[: half - 1]}…{name[-half:]}")
