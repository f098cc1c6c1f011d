"""The page's figures, as SVG that stands in it: lines and bands, left solid and right dashed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
import numpy.typing as npt

from spheremcap.analysis.cycles import PERCENT, Band
from spheremcap.analysis.findings import Findings
from spheremcap.analysis.markup import figure, plain, ticks
from spheremcap.analysis.settings import SIDES
from spheremcap.core.stroke import EventKind, Stroke, StrokeEvent
from spheremcap.core.time import NS_PER_S

FloatArray = npt.NDArray[np.float64]

BANDS = {
    "speed_mps": "Speed of the wrist, m/s",
    "elbow_deg": "Elbow angle, ° (180 is a straight arm)",
    "forearm_elevation_deg": "Forearm above the horizontal, °",
    "upper_arm_elevation_deg": "Upper arm above the horizontal, °",
    "gap_mm": "Wrist outward of the push's circle, mm",
}
SPEED_S = 10.0
"""So much of the session's start the speed is shown of."""
_POINTS = 1200
"""Points of one curve at most."""
PATHS = 12
"""Strokes whose paths are drawn at most."""
_PANEL = 400.0
"""Size of a path's picture, px."""
_ORDER = (EventKind.CONTACT, EventKind.RELEASE)
DOTS = 250
"""Strokes of one hand with a dot at most."""


@dataclass(frozen=True)
class _Axes:
    """A box in the picture (left, top, right, bottom, px) and what of the data it shows."""

    box: tuple[float, float, float, float]
    x_range: tuple[float, float]
    y_range: tuple[float, float]

    def at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Places in the picture (N, 2)."""
        left, top, right, bottom = self.box
        (x0, x1), (y0, y1) = self.x_range, self.y_range
        px = left + (np.asarray(x, np.float64) - x0) / ((x1 - x0) or 1.0) * (right - left)
        py = bottom - (np.asarray(y, np.float64) - y0) / ((y1 - y0) or 1.0) * (bottom - top)
        return np.stack(np.broadcast_arrays(px, py), axis=-1).reshape(-1, 2)

    def frame(self, x_label: str = "", y_ticks: int = 5, x_ticks: int = 6) -> str:
        """Ticks, their numbers, thin lines across, and what x is."""
        left, _, right, bottom = self.box
        parts = []
        for value in ticks(*self.y_range, y_ticks):
            y = float(self.at(self.x_range[0], value)[0, 1])
            parts.append(f'<path class="grid" d="M{left:.1f} {y:.1f}H{right:.1f}"/>')
            parts.append(f'<text class="tick end" x="{left - 5:.1f}" y="{y + 4:.1f}">{plain(value)}</text>')
        for value in ticks(*self.x_range, x_ticks):
            x = float(self.at(value, self.y_range[0])[0, 0])
            parts.append(f'<path class="axis" d="M{x:.1f} {bottom:.1f}v4"/>')
            parts.append(f'<text class="tick mid" x="{x:.1f}" y="{bottom + 16:.1f}">{plain(value)}</text>')
        parts.append(f'<path class="axis" d="M{left:.1f} {bottom:.1f}H{right:.1f}"/>')
        if x_label:
            parts.append(f'<text class="tick mid" x="{(left + right) / 2:.1f}" y="{bottom + 32:.1f}">{x_label}</text>')
        return "".join(parts)


def polyline(places: FloatArray, look: str) -> str:
    """A line through places (N, 2), px, in one piece from gap to gap; `look` are its classes."""
    seen = np.isfinite(places).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], seen.astype(np.int8), [0]])))
    return "".join(
        f'<polyline class="{look}" points="{_points(places[first:last])}"/>'
        for first, last in edges.reshape(-1, 2)
        if last - first > 1
    )


def _points(places: FloatArray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)


def _mark(place: FloatArray, kind: EventKind, side: str) -> str:
    """Contact is full, release is open; left is round, right is square."""
    x, y = place
    if not (np.isfinite(x) and np.isfinite(y)):
        return ""
    look = f"{side} {'full' if kind is EventKind.CONTACT else 'open'}"
    if side == "left":
        return f'<circle class="{look}" cx="{x:.1f}" cy="{y:.1f}" r="3.2"/>'
    return f'<rect class="{look}" x="{x - 2.9:.1f}" y="{y - 2.9:.1f}" width="5.8" height="5.8"/>'


def _dot(place: FloatArray, side: str) -> str:
    """A stroke's dot: full and round of the left hand, open and square of the right."""
    return _mark(place, EventKind.CONTACT if side == "left" else EventKind.RELEASE, side)


def _legend(x: float, y: float, sides: Sequence[str], *, dots: bool = False) -> str:
    parts = []
    for k, side in enumerate(sides):
        at = x + 80 * k
        parts.append(
            _dot(np.array([at + 20, y - 4]), side) if dots else f'<path class="{side}" d="M{at:.1f} {y - 4:.1f}h26"/>'
        )
        parts.append(f'<text class="tick" x="{at + 31:.1f}" y="{y:.1f}">{side}</text>')
    return "".join(parts)


def _range(values: Sequence[FloatArray], *, zero: bool = False) -> tuple[float, float]:
    """What shows all of some values, with a little room."""
    finite = np.concatenate([v[np.isfinite(v)] for v in values]) if values else np.zeros(0)
    if not len(finite):
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    room = 0.05 * (high - low) or 0.5
    return (min(low, 0.0) if zero else low - room), high + room


def _spread(items: Sequence[Stroke], most: int) -> list[Stroke]:
    """At most so many, spread over all."""
    if len(items) <= most:
        return list(items)
    return [items[int(k)] for k in np.linspace(0, len(items) - 1, most).round()]


# --- wrist paths ---


def path_figure(found: Findings) -> str:
    """The wrists about their axles, in the wheels' planes; "" where no hand goes along a rim."""
    sides = [s for s in SIDES if s in found.hands and s in found.arms and np.isfinite(found.hands[s].push_radius_m)]
    drawn = {side: _path(found, side) for side in sides}
    drawn = {side: one for side, one in drawn.items() if np.isfinite(one[0]).any()}
    if not drawn or found.chair is None:
        return ""
    everything = np.concatenate([path for path, _ in drawn.values()])
    radius = max(found.hands[side].push_radius_m for side in drawn)
    room = np.array([-radius, radius])
    (x0, x1), (y0, y1) = _range([everything[:, 0], room]), _range([everything[:, 1], room])
    scale = min(_PANEL / (x1 - x0), _PANEL / (y1 - y0))
    wide, high = (x1 - x0) * scale, (y1 - y0) * scale
    parts = []
    for k, (side, (path, events)) in enumerate(drawn.items()):
        left = (960 / len(drawn)) * (k + 0.5) - wide / 2
        axes = _Axes((left, 30, left + wide, 30 + high), (x0, x1), (y0, y1))
        parts.append(f'<text class="name" x="{left:.1f}" y="18">{side} hand</text>')
        parts.append(axes.frame("forward of the axle, m"))
        parts.append(_push(axes, found.hands[side].push_radius_m, events, side))
        parts.append(polyline(axes.at(path[:, 0], path[:, 1]), f"{side} thin"))
        parts += [_mark(axes.at(*place)[0], event.kind, side) for event, place in events]
    whole = max(sum(e.kind is EventKind.CONTACT for e, _ in events) for _, events in drawn.values())
    shown = f"up to {PATHS} strokes spread over the session" if whole else "its first seconds"
    up = "" if found.chair.upright else " Nothing says how the camera is tilted: what is drawn upward may not be up."
    caption = (
        "The wrist about the axle (cross), in the wheel's plane, with forward to the right on both sides; metres. "
        f"Lines: the wrist's path ({shown}). Dotted: the circle that the wrist keeps to while it pushes. Thick, "
        f"inside of it: the push, from mean contact to mean release. Full marks: contact; open marks: release.{up}"
    )
    title = "Path of the wrist about the axle, left and right"
    return figure(title, caption, 960, round(high + 70), "".join(parts))


def _push(axes: _Axes, radius_m: float, events: Sequence[tuple[StrokeEvent, FloatArray]], side: str) -> str:
    """The axle, the circle of the pushes about it, and the mean push as an arc inside of it."""
    x, y = axes.at(0.0, 0.0)[0]
    turn = np.radians(np.arange(0, 361, 3))
    parts = [
        f'<path class="axis" d="M{x - 7:.1f} {y:.1f}h14m-7 -7v14"/>',
        polyline(axes.at(radius_m * np.sin(turn), radius_m * np.cos(turn)), "rim"),
    ]
    contact, release = (_mean_turn([place for event, place in events if event.kind is kind]) for kind in _ORDER)
    if contact is not None and release is not None:
        arc = contact + np.linspace(0, (release - contact) % (2 * np.pi), 60)
        inside = 0.88 * radius_m
        parts.append(polyline(axes.at(inside * np.sin(arc), inside * np.cos(arc)), f"{side} arc"))
    return "".join(parts)


def _path(found: Findings, side: str) -> tuple[FloatArray, list[tuple[StrokeEvent, FloatArray]]]:
    """Places (N, 2), forward of the axle and up, of a few strokes (NaN between two), and their events' places."""
    hand, arm = found.hands[side], found.arms[side]
    t_s = (found.stamp_ns - found.stamp_ns[0]) / NS_PER_S
    strokes = _spread([s for s in hand.strokes if s.cycle_s is not None], PATHS)
    spans = []
    for stroke in strokes:
        start = (stroke.stamp_ns - int(found.stamp_ns[0])) / NS_PER_S
        spans.append((start, start + (stroke.cycle_s or 0.0)))
    rows = []
    for start, end in spans or [(0.0, 3.0)]:
        part = slice(int(np.searchsorted(t_s, start)), int(np.searchsorted(t_s, end)) + 1)
        part = slice(part.start, part.stop, max(1, (part.stop - part.start) * len(spans or "1") // (2 * _POINTS)))
        rows += [arm.xyz_m[part].astype(np.float64), np.full((1, 3), np.nan)]
    flat = (np.concatenate(rows) - hand.wheel.hub_m) @ hand.wheel.axes[:2].T
    numbers = {stroke.stroke for stroke in strokes}
    seen = np.isfinite(arm.xyz_m[:, 0])
    events = []
    for event in hand.events:
        if event.stroke in numbers and seen.any():
            at = (event.stamp_ns - int(found.stamp_ns[0])) / NS_PER_S
            near = slice(max(0, int(np.searchsorted(t_s, at)) - 8), int(np.searchsorted(t_s, at)) + 8)
            there = near.start + np.flatnonzero(seen[near])
            if len(there):
                xyz = np.array([np.interp(at, t_s[there], arm.xyz_m[there, k]) for k in range(3)])
                events.append((event, hand.wheel.axes[:2] @ (xyz - hand.wheel.hub_m)))
    return flat, events


def _mean_turn(places: Sequence[FloatArray]) -> float | None:
    """From straight up, of places about the axle, radians."""
    if not places:
        return None
    turned = np.array([np.arctan2(x, y) for x, y in places])
    return float(np.arctan2(np.sin(turned).mean(), np.cos(turned).mean()))


# --- curves ---


def speed_figure(found: Findings) -> str:
    """The wrists' speed over the session's start, with the pushes below; "" where there is none."""
    t_s = (found.stamp_ns - found.stamp_ns[0]) / NS_PER_S if len(found.stamp_ns) else np.zeros(0)
    part = slice(0, int(np.searchsorted(t_s, SPEED_S, "right")))
    part = slice(0, part.stop, -(-part.stop // _POINTS) or 1)
    curves = {
        side: found.arms[side].values["speed_mps"][part].astype(np.float64)
        for side in SIDES
        if side in found.arms and "speed_mps" in found.arms[side].values
    }
    curves = {side: curve for side, curve in curves.items() if np.isfinite(curve).any()}
    if not curves:
        return ""
    end = min(SPEED_S, float(t_s[-1])) or 1.0
    axes = _Axes((45, 28, 945, 250), (0.0, end), _range(list(curves.values()), zero=True))
    parts = [axes.frame("", x_ticks=10), _legend(790, 16, list(curves))]
    parts.append('<text class="name" x="45" y="16">speed of the wrist, m/s</text>')
    parts += [polyline(axes.at(t_s[part], curve), side) for side, curve in curves.items()]
    lanes = {side: 276.0 + 16 * k for k, side in enumerate(curves)}
    for side, y in lanes.items():
        parts.append(f'<text class="tick end" x="40" y="{y + 9:.1f}">{side}</text>')
        for stroke in found.hands[side].strokes if side in found.hands else ():
            start = (stroke.stamp_ns - int(found.stamp_ns[0])) / NS_PER_S
            if stroke.push_s is not None and start < end:
                (x0, _), (x1, _) = axes.at([start, min(end, start + stroke.push_s)], [0.0, 0.0])
                parts.append(
                    f'<rect class="{side} push" x="{x0:.1f}" y="{y:.1f}" width="{x1 - x0:.1f}" height="11"/>'
                    f'<rect class="{side} shade" x="{x0:.1f}" y="28" width="{x1 - x0:.1f}" height="222"/>'
                )
    bottom = 276 + 16 * len(curves)
    parts.append(f'<text class="tick mid" x="495" y="{bottom + 14}">seconds from the first frame</text>')
    caption = (
        f"Speed of the wrist in the chair's frame over the first {end:.0f} seconds. The bars below, and the shade "
        "behind the curves, are the pushes of each hand."
    )
    return figure("Speed of the wrists over the start of the session", caption, 960, bottom + 20, "".join(parts))


def band_figures(bands: Sequence[Band]) -> list[str]:
    """The mean cycles, a figure for each quantity that has one."""
    figures = []
    for quantity, label in BANDS.items():
        own = {band.side: band for band in bands if band.quantity == quantity}
        own = {side: own[side] for side in SIDES if side in own}
        if own:
            figures.append(_bands(label, own))
    return figures


def _bands(label: str, own: Mapping[str, Band]) -> str:
    edges = [edge for band in own.values() for edge in (band.mean - band.sd, band.mean + band.sd)]
    axes = _Axes((48, 30, 468, 200), (0.0, 100.0), _range(edges))
    parts = [f'<text class="name" x="10" y="16">{escape(label)}</text>', axes.frame("% of the cycle")]
    for side, band in own.items():
        around = np.concatenate([axes.at(PERCENT, band.mean + band.sd), axes.at(PERCENT, band.mean - band.sd)[::-1]])
        parts.append(f'<polygon class="{side} band" points="{_points(around[np.isfinite(around).all(axis=1)])}"/>')
    for side, band in own.items():
        parts.append(polyline(axes.at(PERCENT, band.mean), side))
        x = float(axes.at(band.release_percent, axes.y_range[0])[0, 0])
        if np.isfinite(x):
            parts.append(f'<path class="{side} fine" d="M{x:.1f} 30V200"/>')
    parts.append(_legend(320, 16, list(own)))
    counts = " and ".join(f"{band.cycles} of the {side}" for side, band in own.items())
    return figure(f"Mean cycle, {label}", f"Mean of {counts} hand's cycles.", 480, 236, "".join(parts))


# --- strokes by number ---


def dot_figures(found: Findings) -> list[str]:
    """Contact and release angle of each stroke, a figure each."""
    figures = []
    for kind, field, sd_field in (
        (EventKind.CONTACT, "contact_deg", "contact_sd_deg"), (EventKind.RELEASE, "release_deg", "release_sd_deg"),
    ):  # fmt: skip
        rows = {}
        for side in SIDES:
            strokes = (
                [s for s in found.hands[side].strokes if getattr(s, field) is not None] if side in found.hands else []
            )
            if strokes:
                some = _spread(strokes, DOTS)
                rows[side] = np.array([(s.stroke, getattr(s, field), getattr(s, sd_field) or 0.0) for s in some], float)
        if rows:
            figures.append(_dots(kind, rows))
    return figures


def _dots(kind: EventKind, rows: Mapping[str, FloatArray]) -> str:
    word = kind.value.lower()
    values = [edge for row in rows.values() for edge in (row[:, 1] - row[:, 2], row[:, 1] + row[:, 2])]
    last = max(float(row[-1, 0]) for row in rows.values())
    axes = _Axes((48, 30, 468, 200), (-0.5, last + 0.7), _range(values))
    parts = [f'<text class="name" x="10" y="16">{word.capitalize()} angle, °</text>']
    parts.append(axes.frame("number of the stroke"))
    for k, (side, row) in enumerate(rows.items()):
        beside = row[:, 0] + (0.2 * k if last < 60 else 0.0)
        for x, (_, value, sd) in zip(beside, row, strict=True):
            (px, low), (_, high) = axes.at([x, x], [value - sd, value + sd])
            parts.append(f'<path class="{side} fine" d="M{px:.1f} {low:.1f}V{high:.1f}"/>')
            parts.append(_dot(axes.at(x, value)[0], side))
    parts.append(_legend(320, 16, list(rows), dots=True))
    few = " Not every stroke is drawn." if any(len(row) == DOTS for row in rows.values()) else ""
    caption = (
        f"Angle of the wrist about the axle at {word}, from straight up; bars: the uncertainty of the single stroke "
        f"(one standard deviation).{few}"
    )
    return figure(f"{word.capitalize()} angle by stroke", caption, 480, 236, "".join(parts))
