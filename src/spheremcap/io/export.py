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

from spheremcap.errors import SourceError, UsageError
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import checked_output, whole_file
from spheremcap.io.recording import damage_line, iter_columns

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
    recording_path: str | os.PathLike[str], out_path: str | os.PathLike[str], overwrite: bool = False
) -> Exported:
    """Write the tracks of a recording as a table, by log time, with the columns of `Track.columns`.

    The ending of `out_path` says how: .csv (numbers with all their digits, empty where there is no value) or
    .parquet (null where there is none). It is there whole or not at all; memory stays flat.

    Raises SourceError when the recording cannot be read or has no markers, UsageError when `out_path` is the recording,
    exists, has another ending or pyarrow is not installed, OutputError when it cannot be written.
    """
    out = Path(out_path)
    writers = {".csv": _write_csv, ".parquet": _write_parquet}
    write = writers.get(out.suffix.lower())
    if write is None:
        raise UsageError(f"{out}: tracks are exported to .csv or .parquet, not {out.suffix or 'no ending'!r}")
    inputs = [Path(recording_path)]
    checked_output(out, inputs, overwrite=overwrite)
    with McapRecords(recording_path) as records:
        batches = iter_columns(records)
        first = next(batches, None)
        if first is None:
            topics = ", ".join(sorted({c.topic for c in records.channels.values()})) or "none"
            raise SourceError(f"{recording_path}: has no markers of spheremcap in it; its topics: {topics}")
        with whole_file(out, inputs, overwrite=overwrite) as part:
            rows = write(part.path, first, batches)
        return Exported(rows, damage_line(records), part.notes)


def _write_csv(path: Path, first: Columns, rest: Iterator[Columns]) -> int:
    rows = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(first)
        for columns in itertools.chain([first], rest):
            writer.writerows(zip(*(_cells(column) for column in columns.values()), strict=True))
            rows += len(columns["marker"])
    return rows


def _write_parquet(path: Path, first: Columns, rest: Iterator[Columns]) -> int:
    try:
        pa, pq = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise UsageError("Parquet needs pyarrow: pip install 'spheremcap[parquet]', or export .csv") from None
    rows = 0
    schema = pa.schema([(name, _arrow_type(pa, column)) for name, column in first.items()])
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
