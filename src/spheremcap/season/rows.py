"""The sessions of a season, a row each, run or not: what the table of all of them and the page are made of."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.season.manifest import Plan, Season
from spheremcap.season.outcome import ClockOutcome, MarkerOutcome, Outcome

NOT_RUN = "not run"
ENDINGS = ("failed", NOT_RUN, "lost", "done")
"""How a session ended, what most needs a person first."""


@dataclass(frozen=True)
class SessionRow:
    """A session. None is no such value; a session that was not run, or failed, has none from `frames` on.

    `status` is one of ENDINGS, `reason` why it failed or cannot be run, `lost` what could not be had. `measured` is the
    share of all markers' frames with a measured position, 0 to 1, `lowest_measured` that of the marker with the lowest
    one. `longest_gap_s` is that of all markers, `sync_residual_ms` and `sync_error_ms` are the largest of all sensors.
    Of the fields before `outcome` each is a column.
    """

    session: str
    subject: str
    status: str
    reason: str
    lost: tuple[str, ...]
    videos: tuple[str, ...]
    version: str
    key: str
    frames: int | None = None
    start_ns: int | None = None
    duration_s: float | None = None
    markers: int | None = None
    measured: float | None = None
    lowest_marker: str = ""
    lowest_measured: float | None = None
    longest_gap_s: float | None = None
    open_requests: int | None = None
    answered_requests: int | None = None
    sync_residual_ms: float | None = None
    sync_error_ms: float | None = None
    strokes_left: int | None = None
    strokes_right: int | None = None
    outcome: Outcome | None = None
    """Of a session that is done, with or without losses."""

    @property
    def marker_outcomes(self) -> tuple[MarkerOutcome, ...]:
        return self.outcome.markers if self.outcome is not None else ()

    @property
    def clocks(self) -> tuple[ClockOutcome, ...]:
        return self.outcome.clocks if self.outcome is not None else ()


def rows_of(season: Season, outcomes: Mapping[str, Outcome]) -> list[SessionRow]:
    """The rows of all sessions of a season by name; `outcomes` has those that were run."""
    return [_row(plan, outcomes.get(plan.name)) for plan in season.plans]


def share_of(marker: MarkerOutcome) -> float | None:
    """Share of a marker's frames that were measured, 0 to 1; None without frames."""
    return marker.measured / marker.frames if marker.frames else None


def columns_of_rows(rows: Sequence[SessionRow]) -> dict[str, npt.NDArray[Any]]:
    """The columns of sessions.parquet, each (N,), by name: "" and NaN where there is no value, masked integers."""
    makers: dict[Any, Any] = {int | None: integers, float | None: floats}
    return {
        f.name: makers.get(f.type, texts)([_cell(getattr(row, f.name)) for row in rows])
        for f in fields(SessionRow)
        if f.name != "outcome"
    }


def _cell(value: Any) -> Any:
    return "; ".join(value) if isinstance(value, tuple) else value


def texts(values: Iterable[str | None]) -> npt.NDArray[np.str_]:
    """A column of texts; "" where there is none."""
    return np.array([value or "" for value in values], np.str_)


def floats(values: Iterable[float | None]) -> npt.NDArray[np.float64]:
    """A column of floats; NaN where there is none."""
    return np.array([np.nan if value is None else value for value in values], np.float64)


def integers(values: Iterable[int | None]) -> npt.NDArray[np.int64]:
    """A column of integers; masked where there is none."""
    given = list(values)
    return np.ma.array([value or 0 for value in given], np.int64, mask=[value is None for value in given])


def _row(plan: Plan, outcome: Outcome | None) -> SessionRow:
    if outcome is None:
        names, absent = _names(plan.videos), [*plan.missing, *([plan.seedless] if plan.seedless else [])]
        return SessionRow(plan.name, plan.subject, NOT_RUN, "; ".join(absent), (), names, "", "")
    row = SessionRow(
        plan.name, outcome.subject, outcome.status, outcome.reason, outcome.lost, _names(outcome.videos),
        outcome.version, outcome.key,
    )  # fmt: skip
    return row if outcome.status == "failed" else _ended(row, outcome)


def _ended(row: SessionRow, outcome: Outcome) -> SessionRow:
    """The same with what came out."""
    shares = [(share, marker.marker) for marker in outcome.markers if (share := share_of(marker)) is not None]
    lowest, lowest_marker = min(shares, default=(None, ""))
    residuals = [clock.residual_ms for clock in outcome.clocks if clock.residual_ms is not None]
    errors = [clock.error_ms for clock in outcome.clocks if clock.error_ms is not None]
    asked = len(outcome.open_requests)
    return SessionRow(
        row.session, row.subject, row.status, row.reason, row.lost, row.videos, row.version, row.key,
        frames=outcome.frames, start_ns=outcome.start_ns, duration_s=outcome.duration_s,
        markers=len(outcome.markers), measured=outcome.measured,
        lowest_marker=lowest_marker, lowest_measured=lowest,
        longest_gap_s=max((marker.longest_gap_s for marker in outcome.markers), default=None),
        open_requests=asked, answered_requests=len(outcome.requests) - asked,
        sync_residual_ms=max(residuals, default=None), sync_error_ms=max(errors, default=None),
        strokes_left=outcome.strokes.get("left"), strokes_right=outcome.strokes.get("right"), outcome=outcome,
    )  # fmt: skip


def _names(videos: Iterable[str]) -> tuple[str, ...]:
    """Without folders."""
    return tuple(PurePosixPath(video).name for video in videos)
