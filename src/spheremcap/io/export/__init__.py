"""What a recording has in the files of other programs, one module a format: tables, C3D and TRC."""

import os
from dataclasses import dataclass
from pathlib import Path

from spheremcap.core.stroke import Stroke, StrokeEvent
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.export import c3d, even, tables, trc
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import checked_output, whole_file
from spheremcap.io.recording import damage_line, iter_columns, read_sensors
from spheremcap.io.selection import Selection
from spheremcap.io.strokes import columns_of, has_strokes, read_strokes

POSES, CYCLES, EVENTS = "poses", "cycles", "events"
TABLES = (POSES, CYCLES, EVENTS)
ENDINGS = (".csv", ".parquet", ".c3d", ".trc")


@dataclass(frozen=True)
class Exported:
    """What became of an export: rows or frames written, one line about what could not be read (None: nothing), and
    lines for the user.
    """

    rows: int
    damage: str | None
    notes: tuple[str, ...] = ()


def export_recording(
    recording_path: str | os.PathLike[str],
    out_path: str | os.PathLike[str],
    overwrite: bool = False,
    *,
    wanted: Selection | None = None,
    table: str = POSES,
    excel: bool = False,
    fill_ms: float | None = None,
) -> Exported:
    """Write what a recording has for other programs; the ending of `out_path` says how.

    - .csv (numbers with all their digits, empty where there is no value) or .parquet (null where there is none, each
      column's unit in its metadata): `table` is one of TABLES. Poses have the columns of `Track.columns` and a row a
      marker and frame, cycles and events those of core's `Stroke` and `StrokeEvent`. `excel` makes the CSV one that a
      workbook with decimal commas opens as it is: semicolons, units in the header, and in place of stamps, which have
      more digits than it keeps, seconds from the recording's start and the time of day. Memory stays flat.
    - .c3d or .trc: measured positions in mm on an even grid, as `even.EvenPoints` and the modules say. `fill_ms` fills
      a marker's gaps of at most so long with the recording's smoothed positions, marked as such, in .c3d only.

    It is there whole or not at all. Raises SourceError when the recording cannot be read or does not have what is
    wanted, UsageError when `out_path` is the recording, exists or has another ending, when something is asked of a
    format that it does not have, an extra is not installed or a marker is not there, OutputError when it cannot be
    written.
    """
    out = Path(out_path)
    ending = out.suffix.lower()
    _check(out, ending, table, excel, fill_ms)
    inputs = [Path(recording_path)]
    checked_output(out, inputs, overwrite=overwrite)
    with McapRecords(recording_path) as records:
        chosen = (wanted or Selection()).from_start_of(records)
        if ending in (".c3d", ".trc"):
            return _points(records, chosen, out, inputs, overwrite, fill_ms)
        start_ns = (records.span_ns or (0, 0))[0]
        seen: set[str] = set()
        batches = (
            iter_columns(records, start_ns=chosen.start_ns, end_ns=chosen.end_ns)
            if table == POSES
            else iter([_strokes(records, table)])
        )
        first = next(batches, None)
        if first is None:
            raise even.no_markers(records)

        def rows_of(columns: tables.Columns) -> tables.Columns:
            seen.update(columns["marker"].tolist())
            rows = chosen.rows(columns["stamp_ns"], columns["marker"])
            return {name: column[rows] for name, column in columns.items()}

        write = tables.write_parquet if ending == ".parquet" else tables.write_excel if excel else tables.write_csv
        with whole_file(out, inputs, overwrite=overwrite) as part:
            rows = write(part.path, rows_of(first), map(rows_of, batches), start_ns)
            chosen.check(seen, recording_path)
        return Exported(rows, damage_line(records), part.notes)


def _check(out: Path, ending: str, table: str, excel: bool, fill_ms: float | None) -> None:
    if ending not in ENDINGS:
        raise UsageError(f"{out}: export writes {', '.join(ENDINGS)}, not {ending or 'no ending'!r}")
    if table not in TABLES:
        raise UsageError(f"--table {table}: there are {', '.join(TABLES)}")
    if table != POSES and ending not in (".csv", ".parquet"):
        raise UsageError(f"{out}: --table is for .csv and .parquet; a .c3d has the events by itself")
    if excel and ending != ".csv":
        raise UsageError(f"{out}: --excel is for .csv")
    if fill_ms is None:
        return
    if ending == ".trc":
        raise UsageError(f"{out}: a TRC cannot mark what is filled: export .c3d, or leave the cells blank")
    if ending != ".c3d":
        raise UsageError(f"{out}: --fill is for .c3d; a table has the smoothed positions in columns of their own")
    if not 0 < fill_ms < float("inf"):
        raise UsageError(f"--fill {fill_ms:g}: expected milliseconds above 0")


def _points(
    records: McapRecords, chosen: Selection, out: Path, inputs: list[Path], overwrite: bool, fill_ms: float | None
) -> Exported:
    as_c3d = out.suffix.lower() == ".c3d"
    if as_c3d:
        c3d.library()
    points = even.read_points(records, chosen, fill_ms=fill_ms, most_frames=c3d.MOST_FRAMES if as_c3d else None)
    with whole_file(out, inputs, overwrite=overwrite) as part:
        if as_c3d:
            events, _ = read_strokes(records)
            beside = round(points.period_ns)  # a sample is placed by its nearest
            sensors = read_sensors(records, points.start_ns - beside, points.end_ns + beside)
            notes = c3d.write(part.path, points, events, sensors, fill_ms)
        else:
            notes = trc.write(part.path, points, out.name)
    return Exported(len(points), damage_line(records), (*part.notes, *points.notes, *notes))


def _strokes(records: McapRecords, table: str) -> tables.Columns:
    if not has_strokes(records):
        raise SourceError(f"{records.path}: has no strokes: run `spheremcap analyse` on it first")
    events, strokes = read_strokes(records)
    return columns_of(Stroke, strokes) if table == CYCLES else columns_of(StrokeEvent, events)
