"""Tracks as a table: one row for each marker on each frame, as CSV or Parquet."""

import csv
import importlib
import itertools
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import checked_output, whole_file
from spheremcap.io.recording import damage_line, iter_columns
from spheremcap.io.selection import Selection

Columns = Mapping[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class Exported:
    """What became of an export: rows written, one line about what could not be read (None: nothing), and lines for the
    user.
    """

    rows: int
    damage: str | None
    notes: tuple[str, ...] = ()


def export_tracks(
    recording_path: str | os.PathLike[str],
    out_path: str | os.PathLike[str],
    overwrite: bool = False,
    *,
    wanted: Selection | None = None,
    excel: bool = False,
) -> Exported:
    """Write the tracks of a recording as a table, by log time, with the columns of `Track.columns`.

    The ending of `out_path` says how: .csv (numbers with all their digits, empty where there is no value) or
    .parquet (null where there is none, each column's unit in its metadata). `excel` makes the CSV one that a workbook
    with decimal commas opens as it is: semicolons, units in the header, and in place of stamps, which have more digits
    than it keeps, seconds from the recording's start and the time of day. It is there whole or not at all; memory stays
    flat.

    Raises SourceError when the recording cannot be read or has no markers, UsageError when `out_path` is the recording,
    exists, has another ending or pyarrow is not installed, or a marker is not there, OutputError when it cannot be
    written.
    """
    out = Path(out_path)
    writers = {".csv": _write_excel if excel else _write_csv, ".parquet": _write_parquet}
    write = writers.get(out.suffix.lower())
    if write is None:
        raise UsageError(f"{out}: tracks are exported to .csv or .parquet, not {out.suffix or 'no ending'!r}")
    if excel and write is _write_parquet:
        raise UsageError(f"{out}: --excel is for .csv")
    inputs = [Path(recording_path)]
    checked_output(out, inputs, overwrite=overwrite)
    with McapRecords(recording_path) as records:
        batches = iter_columns(records)
        first = next(batches, None)
        if first is None:
            topics = ", ".join(sorted({c.topic for c in records.channels.values()})) or "none"
            raise SourceError(f"{recording_path}: has no markers of spheremcap in it; its topics: {topics}")
        seen: set[str] = set()
        start_ns = (records.span_ns or (0, 0))[0]
        chosen = (wanted or Selection()).from_start_of(records)

        def rows_of(columns: Columns) -> Columns:
            seen.update(columns["marker"].tolist())
            rows = chosen.rows(columns["stamp_ns"], columns["marker"])
            return {name: column[rows] for name, column in columns.items()}

        with whole_file(out, inputs, overwrite=overwrite) as part:
            rows = write(part.path, rows_of(first), map(rows_of, batches), start_ns)
            chosen.check(seen, recording_path)
        return Exported(rows, damage_line(records), part.notes)


def _write_csv(path: Path, first: Columns, rest: Iterator[Columns], start_ns: int) -> int:
    rows = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(first)
        for columns in itertools.chain([first], rest):
            writer.writerows(zip(*(_cells(column) for column in columns.values()), strict=True))
            rows += len(columns["marker"])
    return rows


def _write_excel(path: Path, first: Columns, rest: Iterator[Columns], start_ns: int) -> int:
    rows = 0
    heads = [f"{name} [{unit}]" if (unit := _unit_of(name)) else name for name in first if name != "stamp_ns"]
    with path.open("w", encoding="utf-8-sig", newline="") as file:
        writer = csv.writer(file, delimiter=";", lineterminator="\r\n")
        writer.writerow(["time [s]", "UTC", *heads])
        for columns in itertools.chain([first], rest):
            stamps = columns["stamp_ns"].tolist()
            cells = [_cells(column) for name, column in columns.items() if name != "stamp_ns"]
            times = [(stamp - start_ns) / NS_PER_S for stamp in stamps]
            lines = zip(times, map(format_time, stamps), *cells, strict=True)
            writer.writerows([_comma(cell) for cell in line] for line in lines)
            rows += len(stamps)
    return rows


def _comma(cell: Any) -> Any:
    """A number with a decimal comma."""
    return repr(cell).replace(".", ",") if isinstance(cell, float) else cell


def _write_parquet(path: Path, first: Columns, rest: Iterator[Columns], start_ns: int) -> int:
    try:
        pa, pq = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise UsageError("Parquet needs pyarrow: pip install 'spheremcap[parquet]', or export .csv") from None
    rows = 0
    schema = pa.schema(
        pa.field(name, _arrow_type(pa, column), metadata={"unit": unit} if (unit := _unit_of(name)) else None)
        for name, column in first.items()
    )
    with pq.ParquetWriter(path, schema) as writer:
        for columns in itertools.chain([first], rest):
            arrays = [pa.array(c.tolist(), _arrow_type(pa, c), mask=_absent(c)) for c in columns.values()]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            rows += len(columns["marker"])
    return rows


def _cells(column: npt.NDArray[Any]) -> list[Any]:
    """Python values, which csv writes with all their digits; "" where there is no value."""
    values = column.tolist()
    return ["" if value != value else value for value in values] if column.dtype.kind == "f" else values


def _absent(column: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    absent = np.zeros(len(column), np.bool_)
    if column.dtype.kind == "f":
        absent[:] = np.isnan(column)
    elif column.dtype.kind == "U":
        absent[:] = column == ""
    return absent


def _arrow_type(pa: Any, column: npt.NDArray[Any]) -> Any:
    return {"f": pa.float64, "i": pa.int64, "U": pa.string}[column.dtype.kind]()


def _unit_of(column: str) -> str:
    """The unit of a column of `Track.columns`, by its name; "" where it has none."""
    for ending, unit in (("_mps", "m/s"), ("_px", "px"), ("_ns", "ns"), ("_m", "m")):
        if column.endswith(ending):
            return unit
    return {"vote_sum": "of 6", "visible": "of 1"}.get(column, "")
