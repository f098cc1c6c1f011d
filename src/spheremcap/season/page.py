"""The season's page: what needs attention first, then all sessions; for people who do not program, on paper too."""

import re
from collections import Counter
from collections.abc import Sequence
from html import escape
from importlib.resources import files

from spheremcap.analysis.markup import document, explained, heads, listed, number, percent, plural, row, section, table
from spheremcap.core.time import LARGEST_RELATIVE_NS, format_time
from spheremcap.season.page_figures import residuals_figure, shares_figure
from spheremcap.season.page_sessions import SHOWN_ROWS, WORDS, clocks_part, far_clocks, named, sessions_part
from spheremcap.season.page_usual import SHARES_RULE
from spheremcap.season.rows import ENDINGS, NOT_RUN, SessionRow

_NAMED = 8
"""Sessions that a line names one by one."""
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w])")


def page(name: str, description: str, rows: Sequence[SessionRow]) -> str:
    """The page, self-contained: no script, no other file, the same bytes for the same sessions. `name` and
    `description` are the season's, as text."""
    title = escape(name)
    css = "".join(
        (files(f"spheremcap.{room}") / "page.css").read_text(encoding="utf-8") for room in ("analysis", "season")
    )
    said = f"<p>{escape(description)}</p>" if description else ""
    failed = [(one.session, one.reason) for one in rows if one.status == "failed"]
    waiting = [(one.session, one.reason or "nothing is in its way") for one in rows if one.status == NOT_RUN]
    lost = [(one.session, line) for one in rows for line in one.lost]
    content = [
        f"<h1>{title}</h1>", f'<p class="sub">{_when(rows)}</p>', said, _box(rows),
        section("What failed, and why", [_lines_part(failed, "Why")]) if failed else "",
        section("What was not run", [_lines_part(waiting, "What is in its way")]) if waiting else "",
        section("How much was measured", _overview(rows)),
        section("All sessions", [sessions_part(rows)]),
        section("Clocks", [residuals_figure(list(rows)), clocks_part(rows)]),
        section("What could not be had", [_lines_part(lost, "What") if lost else "<p>Nothing is missing.</p>"]),
    ]  # fmt: skip
    return document(
        f"{title}: all sessions", css, content, "Made by spheremcap. A dash (–) is a value that there is not."
    )


def _when(rows: Sequence[SessionRow]) -> str:
    words = [plural(len(rows), "session")]
    starts = [one.start_ns for one in rows if one.start_ns is not None and one.start_ns > LARGEST_RELATIVE_NS]
    if starts:
        days = [format_time(stamp_ns)[:10] for stamp_ns in (min(starts), max(starts))]
        words.append(" to ".join(dict.fromkeys(days)))
    if (seconds := sum(one.duration_s or 0.0 for one in rows)) > 0:
        words.append(_lasts(seconds))
    if subjects := len({one.subject for one in rows if one.subject}):
        words.append(plural(subjects, "subject"))
    return " · ".join(words)


def _lasts(seconds: float) -> str:
    if seconds < 60:
        return f"{number(seconds, 1)} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def _box(rows: Sequence[SessionRow]) -> str:
    """The page in short."""
    ended = Counter(one.status for one in rows)
    counts = [f"{ended[status]} {WORDS[status]}" for status in reversed(ENDINGS) if ended[status]]
    lines = [f"{plural(len(rows), 'session')}: {listed(counts)}."]
    if ended["failed"]:
        lines.append("Why sessions failed is told below; mended, they run when the season is run again.")
    measured = sum(m.measured for one in rows for m in one.marker_outcomes)
    frames = sum(m.frames for one in rows for m in one.marker_outcomes)
    if frames:
        lines.append(f"Over all sessions and markers {percent(measured / frames)} of the frames were measured.")
    asked = [(one.open_requests, one.session) for one in rows if one.open_requests]
    if asked:
        count, where = sum(number for number, _ in asked), plural(len(asked), "session")
        lines.append(
            f"{plural(count, 'question')} of the tracker {'is' if count == 1 else 'are'} open, in {where}. "
            "<code>spheremcap dataset requests OUT</code> lists them (OUT is the folder that the season was run into). "
            "Every answer may give more measured frames."
        )
    elif frames:
        lines.append("No question of the tracker is open.")
    lines += _worst(rows)
    if far := far_clocks(rows):
        lines.append(
            f"{plural(far, 'sync residual')} {'is' if far == 1 else 'are'} far above what is usual: see the clocks."
        )
    return (
        '<section class="box">\n<h2>What to make of it</h2>\n<ul>'
        + "".join(f"<li>{line}</li>\n" for line in lines)
        + "</ul>\n</section>"
    )


def _worst(rows: Sequence[SessionRow]) -> list[str]:
    """The sessions that are worst at something."""
    lines = []
    low = min(((one.measured, one.session, one) for one in rows if one.measured is not None), default=None)
    if low is not None and low[0] < 1 and len(rows) > 1:
        one = low[2]
        marker = ""
        if len(one.marker_outcomes) > 1 and one.lowest_measured is not None and one.lowest_measured < low[0]:
            marker = f", {escape(one.lowest_marker)} {percent(one.lowest_measured)}"
        lines.append(f"Measured least: {escape(one.session)} ({percent(low[0])}{marker}).")
    asked = max(rows, key=lambda one: (one.open_requests or 0, _last(one)), default=None)
    if asked is not None and asked.open_requests and len(rows) > 1:
        lines.append(f"Most open questions: {escape(asked.session)} ({asked.open_requests}).")
    gap = max(rows, key=lambda one: (one.longest_gap_s or 0.0, _last(one)), default=None)
    if gap is not None and gap.longest_gap_s:
        lines.append(f"Longest gap of a marker: {escape(gap.session)} ({number(gap.longest_gap_s, 2)} s).")
    return lines


def _last(one: SessionRow) -> tuple[int, ...]:
    """Larger for a name that comes earlier."""
    return tuple(-ord(letter) for letter in one.session)


def _overview(rows: Sequence[SessionRow]) -> list[str]:
    drawn = shares_figure(list(rows))
    if not drawn:
        return ["<p>Nothing yet.</p>"]
    return [drawn, explained({"Far below": SHARES_RULE})]


def _lines_part(told: Sequence[tuple[str, str]], head: str) -> str:
    """Lines (session, line), those that say the same together, what most sessions have first."""
    groups = _grouped(told)
    lines = [row(escape(line), [str(len(sessions)), _names(sessions)]) for line, sessions in groups[:SHOWN_ROWS]]
    more = len(groups) - SHOWN_ROWS
    rest = f"<p>{more} more are in the file beside this page, sessions.parquet.</p>" if more > 0 else ""
    caption = (
        "What sessions have in common stands once, with … for numbers and names that differ."
        if len(told) > len(groups)
        else ""
    )
    return table(caption, heads(head, "How often", "Sessions"), lines, "lines") + rest


def _grouped(told: Sequence[tuple[str, str]]) -> list[tuple[str, list[str]]]:
    """Each line with its sessions by name; lines that differ in numbers or the session's name alone are one."""
    alike: dict[str, dict[str, list[str]]] = {}
    for session, line in told:
        general = _NUMBER.sub("…", line.replace(session, "…"))
        alike.setdefault(general, {}).setdefault(line, []).append(session)
    groups = []
    for general, lines in alike.items():
        sessions = sorted(session for some in lines.values() for session in some)
        groups.append((next(iter(lines)) if len(lines) == 1 else general, sessions))
    return sorted(groups, key=lambda group: (-len(group[1]), group[0]))


def _names(sessions: Sequence[str]) -> str:
    counts = Counter(sessions)
    names = [named(name) + (f" ({count} times)" if count > 1 else "") for name, count in counts.items()]
    more = len(names) - _NAMED
    return listed(names) if more <= 1 else f"{', '.join(names[:_NAMED])} and {more} more"
