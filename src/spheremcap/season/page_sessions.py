"""The page's tables: all sessions, those first that most need somebody's attention, and how well their clocks agree."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from html import escape

from spheremcap.analysis.markup import NONE, explained, heads, number, percent, plural, row, table
from spheremcap.season.outcome import RECORDING, ClockOutcome
from spheremcap.season.page_usual import RULE, Usual, usual_residual
from spheremcap.season.rows import ENDINGS, NOT_RUN, SessionRow

SHOWN_ROWS = 200
"""Rows of a long table that are shown."""
_SHOWN_CLOCKS = 40
"""Sync residuals that are shown although they are as usual."""
_LETTERS = 160
"""Of a reason that stands in a row."""
REPORT = "NAME/" + RECORDING.replace(".mcap", ".report.html")
WORDS = {"failed": "failed", NOT_RUN: "not run", "lost": "done with losses", "done": "done"}


def by_need(rows: Sequence[SessionRow]) -> list[SessionRow]:
    """Those first that most need somebody's attention."""

    def need(row: SessionRow) -> tuple[float | str, ...]:
        share = row.measured if row.measured is not None else -1.0
        return (
            ENDINGS.index(row.status), share, -(row.open_requests or 0), -(row.sync_residual_ms or 0.0), row.session,
        )  # fmt: skip

    return sorted(rows, key=need)


def sessions_part(rows: Sequence[SessionRow]) -> str:
    """Every session, or as many as a person reads."""
    ordered, usual = by_need(rows), usual_residuals(rows)
    clocks = any(one.sync_residual_ms is not None for one in rows)
    strokes = any(one.strokes_left is not None or one.strokes_right is not None for one in rows)
    head = heads(
        "Session", "It is", "Measured", "Marker measured least", "Open questions", "Longest gap",
        *(["Sync residual (error), ms"] if clocks else []), *(["Strokes left, right"] if strokes else []),
    )  # fmt: skip
    lines = []
    for one in _shown(ordered):
        name = named(one.session) + (f" <small>{escape(one.subject)}</small>" if one.subject else "")
        if one.outcome is None:
            word = f'<span class="bad">{WORDS[one.status]} (!)</span>'
            why = one.reason if len(one.reason) <= _LETTERS else f"{one.reason[:_LETTERS]}…"
            cells = [f'<td class="note" colspan="{4 + clocks + strokes}">{escape(why)}</td>']
        else:
            word = WORDS[one.status]
            texts = [_share(one.measured), _lowest(one), _questions(one), _seconds(one.longest_gap_s)]
            texts += [_clocks(one, usual)] if clocks else []
            texts += [_strokes(one)] if strokes else []
            cells = [f"<td>{text}</td>" for text in texts]
        lines.append(f'<tr><th scope="row">{name}</th><td class="ended">{word}</td>{"".join(cells)}</tr>')
    more = len(ordered) - SHOWN_ROWS
    caption = "All sessions" if more <= 0 else f"{SHOWN_ROWS} of {len(ordered)} sessions"
    rest = f"<p>The other {more} sessions are in the file beside this page, sessions.parquet.</p>" if more > 0 else ""
    words = {
        "Measured": "the share of all markers' frames on which the marker was found and accepted.",
        "Open questions": "places where the tracker asked a person and has no answer yet, of all that it asked.",
        "Longest gap": "the longest time on which one of the markers was not measured.",
    }
    if clocks:
        words["Sync residual (error)"] = (
            "how far apart a sensor's clock and the video's are in single windows of the recording, and in brackets "
            "how well the clock is known; (!) where it is far off, a dash where it was not found from motion."
        )
    words["More of one session"] = (
        f"its own page is <code>{REPORT}</code> in the folder that the season was run into, with the session's name "
        "for NAME; it has one where strokes were looked for."
    )
    return (
        table(
            f"{caption}: failed, not run, with losses, done; of each the lowest share measured first.", head, lines,
            "overview ends",
        )
        + rest + explained(words)
    )  # fmt: skip


def named(session: str) -> str:
    """A session's name, which is broken only where it is longer than a line."""
    return f'<span class="name">{escape(session)}</span>'


def _shown(ordered: Sequence[SessionRow]) -> list[SessionRow]:
    """All; where they are too many, a share of each ending, and then those that are first."""
    own = {status: [one for one in ordered if one.status == status] for status in ENDINGS}
    some = {one.session for ones in own.values() for one in ones[: SHOWN_ROWS // len(ENDINGS)]}
    some |= {one.session for one in [one for one in ordered if one.session not in some][: SHOWN_ROWS - len(some)]}
    return [one for one in ordered if one.session in some]


def _share(share: float | None) -> str:
    if share is None:
        return NONE
    wide = 100 * max(0.0, min(1.0, share))
    return f'<span class="bar" aria-hidden="true"><i style="width:{wide:.1f}%"></i></span>{percent(share)}'


def _lowest(one: SessionRow) -> str:
    return NONE if one.lowest_measured is None else f"{escape(one.lowest_marker)} {percent(one.lowest_measured)}"


def _questions(one: SessionRow) -> str:
    if one.open_requests is None:
        return NONE
    asked = one.open_requests + (one.answered_requests or 0)
    return f"{one.open_requests} of {asked}" if asked else "0"


def _seconds(seconds: float | None) -> str:
    return NONE if seconds is None else f"{number(seconds, 2)} s"


def _clocks(one: SessionRow, usual: Mapping[str, Usual]) -> str:
    synced = [clock for clock in one.clocks if clock.residual_ms is not None]
    return "<br>".join(f"{escape(clock.sensor)} {_residual(clock, usual)}" for clock in synced) or NONE


def _residual(clock: ClockOutcome, usual: Mapping[str, Usual]) -> str:
    text = f"{number(clock.residual_ms, 2)} ({number(clock.error_ms, 2)})"
    return f'<span class="bad">{text} (!)</span>' if _is_far(clock, usual) else text


def _strokes(one: SessionRow) -> str:
    sides = (one.strokes_left, one.strokes_right)
    return NONE if sides == (None, None) else ", ".join(NONE if count is None else str(count) for count in sides)


def clocks_part(rows: Sequence[SessionRow]) -> str:
    """How well the sensors' clocks agree with the videos', what is far off first."""
    synced = [(one, clock, clock.residual_ms) for one in rows for clock in one.clocks if clock.residual_ms is not None]
    rest = sum(len(one.clocks) for one in rows) - len(synced)
    if not synced:
        none = "No sensors were merged." if not rest else "No clock was found from motion (<code>sync</code>)."
        return f"<p>{none}</p>"
    usual = usual_residuals(rows)
    ordered = sorted(synced, key=lambda each: (not _is_far(each[1], usual), -each[2], each[0].session, each[1].sensor))
    lines = []
    shown = min(SHOWN_ROWS, max(_SHOWN_CLOCKS, sum(_is_far(clock, usual) for _, clock, _ in synced)))
    for one, clock, residual in ordered[:shown]:
        told = usual.get(clock.sensor)
        verdict = "–" if told is None else "as usual"
        if _is_far(clock, usual):
            verdict = '<span class="bad">(!) far off</span>'
        cells = [
            escape(clock.sensor), f"{number(residual, 3)} ms", NONE if told is None else f"{number(told.median, 3)} ms",
            verdict, NONE if clock.error_ms is None else f"{number(clock.error_ms, 3)} ms",
            escape(clock.windows or NONE), NONE if clock.drift_ppm is None else f"{number(clock.drift_ppm, 1)} ppm",
        ]  # fmt: skip
        lines.append(row(named(one.session), cells))
    more = len(ordered) - shown
    caption = "Sync residuals, what is far off first, then the largest."
    if more > 0:
        caption += f" The other {more} are in the table clocks beside this page."
    head = heads("Session", "Sensor", "Residual", "Usual for it", "It is", "Error", "Windows that agree", "Drift")
    words = {
        "Residual": "how far apart the clocks are in single windows of the recording, as a standard deviation, once "
        "offset and drift are taken away.",
        "Usual for it": "the residual of the median session with this sensor.",
        "Far off": f"{RULE}. Then look whether it is the right log, and whether it is one piece.",
        "Error": "the uncertainty of the clock that was found, at its worse end: all of the sensor's times may be off "
        "by so much, alike.",
    }
    others = f"<p>Of {plural(rest, 'more sensor')} no clock was found from motion: what their times say holds.</p>"
    return table(caption, head, lines, "overview") + (others if rest else "") + explained(words)


def usual_residuals(rows: Sequence[SessionRow]) -> dict[str, Usual]:
    """What is usual of each sensor's residual, for those that enough sessions have."""
    values: dict[str, list[float]] = defaultdict(list)
    for one in rows:
        for clock in one.clocks:
            if clock.residual_ms is not None:
                values[clock.sensor].append(clock.residual_ms)
    return {sensor: told for sensor, own in values.items() if (told := usual_residual(own)) is not None}


def far_clocks(rows: Sequence[SessionRow]) -> int:
    """How many sync residuals are far above what is usual for their sensor."""
    usual = usual_residuals(rows)
    return sum(_is_far(clock, usual) for one in rows for clock in one.clocks)


def _is_far(clock: ClockOutcome, usual: Mapping[str, Usual]) -> bool:
    told = usual.get(clock.sensor)
    return told is not None and clock.residual_ms is not None and clock.residual_ms > told.limit
