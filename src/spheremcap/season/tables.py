"""The tables of a session, and of all sessions together: one data set, hive partitions by session, a page beside it."""

import os
import shutil
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from glob import escape
from pathlib import Path
from secrets import token_hex

import numpy as np

from spheremcap.core.estimate import Status
from spheremcap.core.stroke import Stroke, StrokeEvent
from spheremcap.errors import SourceError, SpheremcapError, UsageError
from spheremcap.io.export import tables
from spheremcap.io.export.tables import Columns
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import output_error, whole_file
from spheremcap.io.recording import Track, damage_line, iter_columns
from spheremcap.io.strokes import columns_of, has_strokes, read_strokes
from spheremcap.season.manifest import Season
from spheremcap.season.outcome import (
    RECORDING,
    REPORT,
    RUN,
    SESSIONS,
    TABLES,
    ClockOutcome,
    Outcome,
    others_in,
    read_outcome,
    read_season,
)
from spheremcap.season.page import page
from spheremcap.season.rows import NOT_RUN, columns_of_rows, floats, integers, rows_of, share_of, texts

POSES, STROKES, EVENTS, QUALITY, CLOCKS = "poses", "strokes", "events", "quality", "clocks"
NO_TABLES = "its tables could not be read, nor made again from its recording"

Progress = Callable[[int, int | None], None]

_PART = ".part"
_AGAIN = "is being run again just now: make the tables when that is done"
_HELD_BYTES = 4 << 20
_ROWS = 65_536
"""Rows of poses that are packed, and read, together."""
_NAMED = 8
"""Sessions that a line names one by one."""
_MEASURED = [status.value for status in Status if status.measured]


# --- one session ---


def write_session_tables(recording: Path, folder: Path, outcome: Outcome) -> str | None:
    """Write a session's tables into `folder`: poses, quality and clocks, and where somebody has looked for strokes in
    the recording also strokes and events, NAME.parquet each; they have no rows where there is nothing.

    Markers, requests and clocks are those of `outcome`. Memory stays flat. Returns a line about what of the recording
    could not be read, None where all could be. Raises UsageError where pyarrow is not installed, SourceError for what
    is no recording, OutputError.
    """
    kinds = _kinds()
    seen = _Seen()
    with McapRecords(recording, held_bytes=_HELD_BYTES) as records:
        _write(folder, POSES, kinds[POSES], seen.through(_grouped(iter_columns(records))))
        if has_strokes(records):
            events, strokes = read_strokes(records)
            _write(folder, EVENTS, columns_of(StrokeEvent, events))
            _write(folder, STROKES, columns_of(Stroke, strokes))
        damage = damage_line(records)
    _write(folder, QUALITY, _quality(outcome, seen))
    _write(folder, CLOCKS, _clocks(outcome.clocks))
    return damage


def _write(folder: Path, table: str, first: Columns, rest: Iterable[Columns] = ()) -> None:
    with whole_file(folder / f"{table}.parquet", overwrite=True) as part:
        tables.write_parquet(part.path, first, iter(rest), 0, packed=True)


class _Seen:
    """Sums over the measured rows of each marker, while they go by."""

    def __init__(self) -> None:
        self._sums = defaultdict[tuple[str, str], float](float)
        self._counts = Counter[tuple[str, str]]()

    def through(self, batches: Iterator[Columns]) -> Iterator[Columns]:
        for columns in batches:
            measured = np.isin(columns["status"], _MEASURED)
            for marker in np.unique(columns["marker"]).tolist():
                own = measured & (columns["marker"] == marker)
                for name in ("r_px", "vote_sum"):
                    values = columns[name][own]
                    there = ~np.isnan(values)
                    self._sums[marker, name] += float(values[there].sum())
                    self._counts[marker, name] += int(there.sum())
            yield columns

    def mean(self, marker: str, name: str) -> float:
        """NaN where it has no value."""
        count = self._counts[marker, name]
        return self._sums[marker, name] / count if count else np.nan


def _grouped(batches: Iterator[Columns]) -> Iterator[Columns]:
    """The same rows, more of them together."""
    waiting: list[Columns] = []
    for columns in batches:
        waiting.append(columns)
        if sum(len(one["stamp_ns"]) for one in waiting) >= _ROWS:
            yield _joined(waiting)
            waiting = []
    if waiting:
        yield _joined(waiting)


def _joined(batches: list[Columns]) -> Columns:
    return {name: np.concatenate([columns[name] for columns in batches]) for name in batches[0]}


def _quality(outcome: Outcome, seen: _Seen) -> Columns:
    """A row a marker; `measured` is the share of its frames, 0 to 1, NaN without frames. Radius and vote sum are means
    over the frames that were measured."""
    markers = outcome.markers
    open_ = Counter(asked.marker for asked in outcome.requests if not asked.answered)
    answered = Counter(asked.marker for asked in outcome.requests if asked.answered)
    return {
        "marker": texts(m.marker for m in markers),
        "frames": integers(m.frames for m in markers),
        "measured": floats(map(share_of, markers)),
        **{
            f"{status.value.lower()}_frames": integers(m.frames_by_status.get(status.value, 0) for m in markers)
            for status in Status
        },
        "longest_gap_frames": integers(m.longest_gap_frames for m in markers),
        "longest_gap_s": floats(m.longest_gap_s for m in markers),
        "open_requests": integers(open_[m.marker] for m in markers),
        "answered_requests": integers(answered[m.marker] for m in markers),
        "mean_r_px": floats(seen.mean(m.marker, "r_px") for m in markers),
        "mean_vote_sum": floats(seen.mean(m.marker, "vote_sum") for m in markers),
    }


def _clocks(clocks: tuple[ClockOutcome, ...]) -> Columns:
    """A row a sensor. What `sync` found is NaN and "" where it was not asked."""
    return {
        "sensor": texts(c.sensor for c in clocks),
        "samples": integers(c.samples for c in clocks),
        "first_ns": integers(c.first_ns for c in clocks),
        "last_ns": integers(c.last_ns for c in clocks),
        "added": texts(c.added for c in clocks),
        "residual_ms": floats(c.residual_ms for c in clocks),
        "error_ms": floats(c.error_ms for c in clocks),
        "windows": texts(c.windows for c in clocks),
        "drift_ppm": floats(c.drift_ppm for c in clocks),
    }


def _kinds() -> dict[str, Columns]:
    """The columns of each table, without rows."""
    nobody = Outcome(session="", status="done", version="")
    return {
        POSES: _no_track().columns(), STROKES: columns_of(Stroke, ()), EVENTS: columns_of(StrokeEvent, ()),
        QUALITY: _quality(nobody, _Seen()), CLOCKS: _clocks(()),
    }  # fmt: skip


def _no_track() -> Track:
    whole, text, three, square = np.zeros(0, np.int64), np.zeros(0, np.str_), np.zeros((0, 3)), np.zeros((0, 3, 3))
    return Track(
        marker="", stamp_ns=whole, frame=whole, status=text, verdict=text, proposer=text, reasons=text,
        circle_px=three, circle_sd_px=three, claim_px=three,
        xyz_cam_m=three, covariance_m2=square, velocity_cam_mps=three,
        smoothed_xyz_cam_m=three, smoothed_covariance_m2=square, smoothed_velocity_cam_mps=three,
        vote_sum=np.zeros(0), visible=np.zeros(0),
    )  # fmt: skip


# --- all sessions ---


@dataclass
class SeasonReport:
    """What became of a season's tables: how many sessions it has and how many of them ended how (`not run` among
    them), whose tables were `made_again`, for they were not there or damaged, what the person should know (its notes,
    these among them), and what could not be had (lost). One that was `stopped` has changed nothing."""

    output: Path
    sessions: int = 0
    ended: Counter[str] = field(default_factory=Counter)
    made_again: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    stopped: bool = False


def season_tables(
    out: Path, output: Path, *, overwrite: bool, progress: Progress, stop: Callable[[], bool]
) -> SeasonReport:  # fmt: skip
    """Put the tables of all sessions that `dataset run` has made in `out` into the folder `output`:

    - TABLE/session=NAME/TABLE.parquet for poses, quality, clocks, strokes and events of each session that is done;
      they are the session's own files under a second name where the file system has that, else copies
    - sessions.parquet: a row for every session of the season, run or not
    - report.html: the page

    The same sessions give the same bytes. `output` is there whole, or as it was. Raises UsageError where it exists and
    `overwrite` is False, where it was not made by this, or pyarrow is not installed; SourceError where no season was
    run into `out`, or a session is being run again; OutputError.
    """
    tables.arrow()
    season = read_season(out)
    target = _checked(out, output, season, overwrite)
    report = SeasonReport(output, len(season.plans), notes=_noted(out, target, season))
    outcomes: dict[str, Outcome] = {}
    part = _hidden(target)
    try:
        part.mkdir()
        for number, plan in enumerate(season.plans):
            progress(number, len(season.plans))
            if stop():
                report.stopped = True
                return report
            outcome = _taken(out / plan.name, part, report)
            report.ended[NOT_RUN if outcome is None else outcome.status] += 1
            if outcome is not None:
                outcomes[plan.name] = outcome
        if again := report.made_again:
            report.notes.append(f"tables that were not there, or damaged, are made again: {_listed(again)}")
        rows = rows_of(season, outcomes)
        tables.write_parquet(part / SESSIONS, columns_of_rows(rows), iter(()), 0, packed=True)
        (part / REPORT).write_text(page(season.name, season.description, rows), encoding="utf-8", newline="\n")
        _publish(part, target)
    except OSError as error:
        raise output_error(error, output) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return report


def _taken(folder: Path, part: Path, report: SeasonReport) -> Outcome | None:
    """How a session ended, and its tables into the data set; None where it was not run."""
    outcome = read_outcome(folder)
    if outcome is None:
        if (folder / RUN).exists():
            report.notes.append(f"{folder.name}: its {RUN} is damaged, or of another version: run it again")
        return None
    if outcome.status == "failed":
        return outcome
    found, again = _tables_in(folder / TABLES, outcome, outcome.files), part / ".again"
    if (size := outcome.files.get(RECORDING)) is not None and size != _size(folder / RECORDING):
        report.lost.append(f"{folder.name}: its recording is not what it was: run it again")
    try:
        if found is None:
            again.mkdir()
            damage = write_session_tables(folder / RECORDING, again, outcome)
            found = _tables_in(again, outcome, {})
            if found is None:
                raise SourceError(f"{folder / RECORDING}: has no strokes, and {RUN} says that it has")
            report.made_again.append(folder.name)
            report.lost += [f"{folder.name}: {damage}"] if damage is not None else []
        for table, path in found.items():
            place = part / table / f"session={folder.name}"
            place.mkdir(parents=True)
            _link(path, place / f"{table}.parquet")
    except SpheremcapError as error:
        report.lost.append(f"{folder.name}: {NO_TABLES}: {error}")
        return outcome.model_copy(update={"status": "lost", "lost": (*outcome.lost, NO_TABLES)})
    except FileNotFoundError as error:
        raise SourceError(f"{folder}: {_AGAIN}") from error
    finally:
        shutil.rmtree(again, ignore_errors=True)
    now = read_outcome(folder)
    if now is None or now.key != outcome.key:
        raise SourceError(f"{folder}: {_AGAIN}")
    return outcome


def _tables_in(folder: Path, outcome: Outcome, sizes: Mapping[str, int]) -> dict[str, Path] | None:
    """A session's tables; None where one is missing that should be there, cannot be read, or is another one than was
    made."""
    pa, pq = tables.arrow()
    found = {}
    for table, columns in _kinds().items():
        path = folder / f"{table}.parquet"
        if table in (STROKES, EVENTS) and not outcome.strokes and not path.exists():
            continue
        try:
            size = path.stat().st_size
            if sizes.get(f"{TABLES}/{path.name}", size) != size:
                return None
            if pq.read_schema(path) != tables.parquet_schema(columns):
                return None
        except (OSError, pa.ArrowException):
            return None
        found[table] = path
    return found


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def _link(path: Path, place: Path) -> None:
    """The same file under a second name, or a copy."""
    try:
        os.link(path, place)
    except OSError:
        shutil.copyfile(path, place)


def _noted(out: Path, target: Path, season: Season) -> list[str]:
    """What there is that does not go in."""
    notes = []
    if gone := [folder.name for folder in others_in(out, season)]:
        notes.append(f"left out, for the season has them no more: {_listed(gone)}")
    left = sorted(target.parent.glob(f".{escape(target.name)}.*{_PART}"))
    notes += [f"{path} is what an interrupted run left: delete it" for path in left]
    return notes


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names) if more <= 1 else f"{', '.join(names[:_NAMED])} and {more} more"


def _checked(out: Path, output: Path, season: Season, overwrite: bool) -> Path:
    """The folder that `output` means, links followed. Raises UsageError where it may not be written."""
    target, place = Path(os.path.realpath(output)), Path(os.path.realpath(out))
    if target.is_relative_to(place):
        inside = target.relative_to(place).parts
        if not inside or inside[0] in {plan.name for plan in season.plans}:
            raise UsageError(f"{output}: the season was run into it: name another folder")
    if not os.path.lexists(target):
        return target
    if not overwrite:
        raise UsageError(f"{output} exists already: name another folder or pass --overwrite")
    if not target.is_dir():
        raise UsageError(f"{output} is a file: name a folder")
    there = {entry.name for entry in os.scandir(target)}
    if not there >= {SESSIONS, REPORT}:
        raise UsageError(f"{output} is no folder of a season's tables: it is not replaced; name another")
    if foreign := sorted(there - {SESSIONS, REPORT, *_kinds()}):
        raise UsageError(f"{output} is not replaced, for it has what is not of here: {_listed(foreign)}")
    return target


def _publish(part: Path, target: Path) -> None:
    """The folder under its final name, in place of the one that is there. Raises OSError; then that one stays."""
    if not target.exists():
        part.rename(target)
        return
    old = _hidden(target)
    target.rename(old)
    try:
        part.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _hidden(target: Path) -> Path:
    """A name beside a folder that nothing has yet."""
    return target.with_name(f".{target.name}.{token_hex(8)}{_PART}")
