"""The session's page: quality first, then strokes, left against right, for coaches and biomechanists, on paper too."""

import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files

import numpy as np

from spheremcap.analysis.cycles import Band
from spheremcap.analysis.figures import band_figures, dot_figures, path_figure, speed_figure
from spheremcap.analysis.findings import Findings
from spheremcap.analysis.markup import document, listed, number, percent, plural, section
from spheremcap.analysis.page_quality import chair_part, clocks_part, lengths_part, quality_part
from spheremcap.analysis.page_strokes import means_part, sentences_part, strokes_part, timing_part
from spheremcap.analysis.settings import SIDES
from spheremcap.core.time import LARGEST_RELATIVE_NS, NS_PER_S, format_time

_NAMED = 8
"""Strokes that a note names one by one."""
_STROKE_NOTE = re.compile(r"(left|right) hand, stroke (\d+): (.*)", re.DOTALL)
_COUNTED = re.compile(r"\b\d+ frames are missing")


def page(found: Findings, bands: Sequence[Band]) -> str:
    """The page, self-contained: no script, no other file, the same bytes for the same findings."""
    name = escape(found.session.name)
    css = (files("spheremcap.analysis") / "page.css").read_text(encoding="utf-8")
    content = [
        f"<h1>{name}</h1>", f'<p class="sub">{_when(found)}</p>', _box(found),
        section(
            "How good the recording is",
            [quality_part(found), lengths_part(found), chair_part(found), clocks_part(found)],
        ),
        section("Strokes", [means_part(found), sentences_part(found), timing_part(found)]),
        section("Left against right", _figures(found, bands)),
        section("All strokes", [strokes_part(found)]),
    ]  # fmt: skip
    return document(
        f"{name}: strokes",
        css,
        content,
        "Made by spheremcap. Left and right are the athlete's. A dash (–) is a value that there is not.",
    )


def _when(found: Findings) -> str:
    stamps = found.stamp_ns
    if not len(stamps):
        return "No frames."
    first = int(stamps[0])
    start = f"{format_time(first)[:19].replace('T', ' ')} UTC" if first > LARGEST_RELATIVE_NS else ""
    lasts = (int(stamps[-1]) - first) / NS_PER_S
    words = [start or "The recording does not say when it was", _lasts(lasts), f"{plural(len(stamps), 'frame')}"]
    if len(stamps) > 1:
        step_s = float(np.median(np.diff(stamps))) / NS_PER_S
        words.append(f"{number(1 / step_s, 2)} frames a second")
    return " · ".join(words)


def _lasts(seconds: float) -> str:
    if seconds < 60:
        return f"{number(seconds, 1)} s"
    whole = round(seconds)
    return f"{whole // 60} min {whole % 60} s"


def _box(found: Findings) -> str:
    """The page in short: what is well, what to watch, what could not be had."""
    said = []
    if found.quality:
        least = min(found.quality, key=lambda q: q.measured)
        if least.measured < 1:
            share = np.floor(least.measured * 1e3) / 1e3
            said.append(
                f"Every marker was measured on at least {percent(share)} of its frames ({escape(least.marker)} on the "
                "fewest)."
            )
        else:
            said.append("Every marker was measured on all of its frames.")
    asked = sum(q.requests for q in found.quality)
    if asked:
        said.append(
            f"{plural(asked, 'question')} of the tracker {'is' if asked == 1 else 'are'} open: answering in "
            "<code>annotate</code> and then <code>retrack</code> may give more frames."
        )
    loose = [escape(length.segment) for length in found.lengths if not length.constant]
    if loose:
        said.append(f"No constant length: {listed(loose)}. See the segment lengths before you trust angles and speeds.")
    for side in SIDES:
        hand = found.hands.get(side)
        if hand is not None:
            whole = sum(s.cycle_s is not None and s.push_s is not None for s in hand.strokes)
            said.append(
                f"{side.capitalize()} hand: {plural(len(hand.strokes), 'stroke')} found, {whole} of them whole "
                "(contact, release and the next contact seen)."
            )
    if not found.hands:
        said.append("No strokes could be told. The reasons are below.")
    notes = _grouped(found.notes)
    parts = [
        '<section class="box">\n<h2>What to make of it</h2>\n<ul>',
        *(f"<li>{line}</li>" for line in said),
        "</ul>",
    ]
    if notes:
        parts += ["<h3>What could not be had</h3>\n<ul>", *(f"<li>{escape(line)}</li>" for line in notes), "</ul>"]
    else:
        parts.append("<p>Nothing that the markers support is missing.</p>")
    return "\n".join(parts) + "\n</section>"


def _grouped(notes: Sequence[str]) -> list[str]:
    """Notes, those on single strokes put together where they say the same."""
    alike: dict[tuple[str, str], list[str]] = {}
    for note in notes:
        match = _STROKE_NOTE.fullmatch(note)
        if match is None:
            alike.setdefault(("", note), []).append("")
        else:
            alike.setdefault((match[1], _COUNTED.sub("frames are missing", match[3])), []).append(match[2])
    lines = []
    for (side, said), numbers in alike.items():
        if not side:
            lines.append(said)
            continue
        more = len(numbers) - _NAMED
        named = listed(numbers) if more <= 1 else f"{', '.join(numbers[:_NAMED])} and {more} more"
        lines.append(f"{side} hand, {'stroke' if len(numbers) == 1 else 'strokes'} {named}: {said}")
    return lines


def _figures(found: Findings, bands: Sequence[Band]) -> list[str]:
    parts = []
    if found.arms:
        parts.append(
            "<p>In all figures the left hand is blue, its lines solid; the right hand is orange, its lines dashed.</p>"
        )
    for title, drawn, nothing in (
        ("Path of the wrist", [path_figure(found)], "No wrist goes along a rim: no path about the axle is drawn."),
        ("Speed", [speed_figure(found)], "There is no speed of a wrist to draw."),
    ):
        parts.append(f"<h3>{title}</h3>" + ("".join(drawn) or f"<p>{nothing}</p>"))
    cycles = band_figures(bands)
    parts.append(
        "<h3>The mean cycle</h3>"
        + (
            "<p>From contact (0 %) to the next contact (100 %). Line: mean over cycles; band: one standard deviation "
            "over "
            f'cycles to either side; upright line: release, in the mean.</p><div class="pair">{"".join(cycles)}</div>'
            if cycles
            else "<p>No hand has two whole strokes: there is no mean cycle.</p>"
        )
    )
    dots = dot_figures(found)
    parts.append(
        "<h3>Contact and release, stroke by stroke</h3>"
        + (
            f'<div class="pair">{"".join(dots)}</div>'
            if dots
            else "<p>There are no contact and release angles: either there are no strokes, or nothing says what is "
            "up.</p>"
        )
    )
    return parts
