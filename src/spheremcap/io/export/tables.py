"""Tables as CSV, as CSV for workbooks, and as Parquet: batches of columns, a row at a time."""

import csv
import importlib
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.errors import UsageError

Columns = Mapping[str, npt.NDArray[Any]]

_UNITS = {
    "_mps": "m/s", "_rad_s": "rad/s", "_px": "px", "_ns": "ns", "_ms": "ms", "_m": "m", "_s": "s", "_hz": "Hz",
    "_deg": "deg", "_ppm": "ppm",
}  # fmt: skip
"""By the ending of a column's name; the first that fits."""
_NO_ENDING = {
    "vote_sum": "of 6", "mean_vote_sum": "of 6", "visible": "of 1", "measured": "of 1", "lowest_measured": "of 1",
}  # fmt: skip


def write_csv(path: Path, first: Columns, rest: Iterator[Columns], start_ns: int) -> int:
    rows = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(first)
        for columns in itertools.chain([first], rest):
            cells = [_cells(column) for column in columns.values()]
            writer.writerows(zip(*cells, strict=True))
            rows += len(cells[0])
    return rows


def write_excel(path: Path, first: Columns, rest: Iterator[Columns], start_ns: int) -> int:
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


def write_parquet(path: Path, first: Columns, rest: Iterator[Columns], start_ns: int, *, packed: bool = False) -> int:
    """`packed` takes a third less room: for what is kept, and read by programs of these days."""
    pa, pq = arrow()
    schema = parquet_schema(first)
    rows = 0
    with pq.ParquetWriter(path, schema, **(_packing(first) if packed else {})) as writer:
        for columns in itertools.chain([first], rest):
            arrays = [pa.array(np.ma.getdata(c), _arrow_type(pa, c), mask=_absent(c)) for c in columns.values()]
            table = pa.Table.from_arrays(arrays, schema=schema)
            if len(table):  # else there would be a group of no rows
                writer.write_table(table)
            rows += len(table)
    return rows


def parquet_schema(columns: Columns) -> Any:
    """The pyarrow.Schema of columns, units in the fields' metadata. Raises UsageError when pyarrow is not installed."""
    pa, _ = arrow()
    return pa.schema(
        pa.field(name, _arrow_type(pa, column), metadata={"unit": unit} if (unit := _unit_of(name)) else None)
        for name, column in columns.items()
    )


def arrow() -> tuple[Any, Any]:
    """pyarrow and pyarrow.parquet. Raises UsageError when they are not installed."""
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise UsageError("Parquet needs pyarrow: pip install 'spheremcap[parquet]', or export .csv") from None


def _packing(columns: Columns) -> dict[str, Any]:
    """Texts by their place in a list, for few differ; floats byte by byte, for their first bytes are alike."""
    return {
        "compression": "zstd",
        "use_dictionary": [name for name, column in columns.items() if column.dtype.kind == "U"],
        "use_byte_stream_split": [name for name, column in columns.items() if column.dtype.kind == "f"],
    }


def _cells(column: npt.NDArray[Any]) -> list[Any]:
    """Python values, which csv writes with all their digits; "" where there is no value."""
    values = column.tolist()
    return ["" if value != value else value for value in values] if column.dtype.kind == "f" else values


def _absent(column: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Where there is no value: NaN, "", and what is masked (as integers have it)."""
    absent = np.ma.getmaskarray(column)
    if column.dtype.kind == "f":
        return absent | np.isnan(column)
    return absent | (column == "") if column.dtype.kind == "U" else absent


def _arrow_type(pa: Any, column: npt.NDArray[Any]) -> Any:
    return {"f": pa.float64, "i": pa.int64, "U": pa.string}[column.dtype.kind]()


def _unit_of(column: str) -> str:
    """The unit of a column by its name; "" where it has none."""
    for ending, unit in _UNITS.items():
        if column.endswith(ending):
            return unit
    return _NO_ENDING.get(column, "")
