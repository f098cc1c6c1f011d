"""Tables that are not text: Excel's .xlsx as rows of cells, Parquet as columns."""

from collections.abc import Sequence
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import format_time
from spheremcap.errors import SourceError, UsageError

FloatArray = npt.NDArray[np.float64]

EXCEL = ".xlsx"
COLUMNAR = (".parquet", ".pq")


def open_sheet(path: Path, rows: int | None) -> list[list[str]]:
    """The cells of the first `rows` rows (None: all) as texts. Parquet has its names as the first row."""
    if path.suffix.lower() == EXCEL:
        return _excel(path, rows)
    data = _parquet(path)
    if not data.num_rows:
        raise SourceError(f"{path}: has no rows")
    head = data.slice(0, min(10, rows or 10))
    cells = [_parquet_texts(head.column(k)) for k in range(len(data.column_names))]
    return [list(data.column_names), *(list(row) for row in zip(*cells, strict=True))]


def read_sheet(path: Path, wanted: Sequence[int], times: Sequence[int]) -> tuple[list[str], FloatArray]:
    """A Parquet file's times as texts and the wanted columns (N, len(wanted)). Raises SourceError."""
    data = _parquet(path)
    columns = []
    for k in wanted:
        try:
            columns.append(np.asarray(data.column(k).to_numpy(zero_copy_only=False), np.float64))
        except (ValueError, TypeError) as error:
            raise SourceError(f"{path}: column {k + 1} ({data.column_names[k]}) is not one of numbers") from error
    values = np.stack(columns, axis=1) if columns else np.empty((data.num_rows, 0))
    texts = [_parquet_texts(data.column(k)) for k in times]
    return [" ".join(row) for row in zip(*texts, strict=True)], values


def _excel(path: Path, rows: int | None) -> list[list[str]]:
    """The first sheet that has any cells."""
    try:
        import openpyxl
    except ImportError as error:
        raise UsageError(f"{path}: Excel files need openpyxl: pip install 'spheremcap[xlsx]'") from error
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            for sheet in book.worksheets:
                sheet.reset_dimensions()  # some programs state them wrongly
                found = [[_excel_text(cell) for cell in row] for row in sheet.iter_rows(max_row=rows, values_only=True)]
                if any(any(row) for row in found):
                    return found
        finally:
            book.close()
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # openpyxl raises whatever zipfile, the XML parser and its own conversions raise
        raise SourceError(f"{path}: is not a readable .xlsx file ({' '.join(str(error).split())})") from error
    raise SourceError(f"{path}: has no cells")


def _excel_text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime | time):
        return value.isoformat(sep=" ") if isinstance(value, datetime) else value.isoformat()
    if isinstance(value, timedelta):
        hours, rest = divmod(round(value.total_seconds() * 1_000_000), 3_600_000_000)
        return f"{hours}:{rest // 60_000_000:02}:{rest % 60_000_000 / 1e6:09.6f}"
    return repr(value) if isinstance(value, int | float) else str(value)


def _parquet_texts(column: Any) -> list[str]:
    """The cells as texts; time stamps as dates with nine decimals, whatever their resolution."""
    if str(column.type).startswith("timestamp"):
        return [
            format_time(ns) if ns is not None else "" for ns in column.cast("timestamp[ns]").cast("int64").to_pylist()
        ]
    return [
        "" if value is None else value.isoformat() if hasattr(value, "isoformat") else str(value)
        for value in column.to_pylist()
    ]


def _parquet(path: Path) -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError(f"{path}: Parquet needs pyarrow: pip install 'spheremcap[parquet]'") from error
    try:
        return pyarrow.parquet.read_table(path)
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise SourceError(f"{path}: is not a readable Parquet file ({' '.join(str(error).split())})") from error
