"""Delimited text and Parquet as columns of numbers, with every fault located by file, line and column."""

import csv
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import format_time, parse_time_ns
from spheremcap.errors import SourceError, UsageError
from spheremcap.merge.units import TIME_UNITS, is_unit, plain

FloatArray = npt.NDArray[np.float64]
StampArray = npt.NDArray[np.int64]

_HEAD_LINES = 60
_DATE = re.compile(r"^\d{4}[-/]\d\d?[-/]\d\d?[T _]\d")
_COMMA_DECIMAL = re.compile(r"^[+-]?\d+,\d+(?:[eE][+-]?\d+)?$")
_UNIT_IN_NAME = re.compile(r"^(.*?)\s*[\(\[]\s*([^()\[\]]*(?:\([^()]*\)[^()\[\]]*)?)\s*[\)\]]\s*$")


@dataclass(frozen=True)
class Table:
    """What the head of a file says: `names` and `units` of the columns ("" where there are none), and how to
    read on.

    `preamble` are the lines before the names. `first_line` is the number, from 1, of the first line with
    numbers.
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str, ...]
    preamble: tuple[str, ...]
    delimiter: str
    first_line: int
    decimal_comma: bool
    first_row: tuple[str, ...]

    def column(self, wanted: str | int) -> int:
        """The index of a column by its name (case and blanks do not count) or its number from 1."""
        if isinstance(wanted, int):
            if 1 <= wanted <= len(self.first_row):
                return wanted - 1
            raise UsageError(f"{self.path}: there is no column {wanted}, only {len(self.first_row)}")
        bare = [bare_name(name) for name in self.names]
        for candidates in (bare, [bare_name(split_unit(name)[0]) for name in self.names]):
            if bare_name(wanted) in candidates:
                return candidates.index(bare_name(wanted))
        there = ", ".join(filter(None, self.names)) or f"{len(self.first_row)} columns without names"
        raise UsageError(f"{self.path}: there is no column {wanted!r}; there are: {there}")

    def unit(self, index: int) -> str:
        """The unit of a column: from a row of units, or in brackets behind its name."""
        return self.units[index] or (split_unit(self.names[index])[1] if self.names else "")

    def where(self, index: int) -> str:
        """A column as an error names it."""
        name = f" ({self.names[index]})" if self.names and self.names[index] else ""
        return f"{self.path}: column {index + 1}{name}"


def bare_name(name: str) -> str:
    """A column's name without what people write differently."""
    return re.sub(r"[\s_\-]+", "", name).lower()


def split_unit(name: str) -> tuple[str, str]:
    """`Gyroscope X (deg/s)` to the name and the unit, which is "" when there is none."""
    match = _UNIT_IN_NAME.match(name)
    return (match[1], match[2]) if match else (name, "")


def open_table(path: Path, *, delimiter: str | None = None, skip_lines: int = 0, header: bool | None = None) -> Table:
    """Look at the head of a text file: delimiter, names, units, first row of numbers.

    Raises SourceError when there is no row of numbers in it.
    """
    if path.suffix.lower() in (".parquet", ".pq"):
        return _open_parquet(path)
    with _text(path) as file:
        lines = [line.rstrip("\r\n") for _, line in zip(range(skip_lines + _HEAD_LINES), file, strict=False)]
    if delimiter is None:
        stated = next((re.match(r'^"?sep=(.)"?\s*$', line) for line in lines[:2] if "sep=" in line), None)
        delimiter = stated[1] if stated else _delimiter(lines)
    rows = [[cell.strip() for cell in _split(line, delimiter)] for line in lines]
    comma = delimiter != "," and any(_COMMA_DECIMAL.match(cell) for row in rows for cell in row)
    first = next((k for k, row in enumerate(rows) if k >= skip_lines and _is_data(row, comma)), None)
    if first is None:
        raise SourceError(f"{path}: no row of numbers in its first {len(lines)} lines")
    width = len(rows[first])
    names: list[str] = []
    units = [""] * width
    above = first - 1
    if header is not False:
        named = above >= 1 and len(rows[above - 1]) >= width and all(map(is_unit, rows[above][:width]))
        if named and any(plain(cell) for cell in rows[above]) and any(rows[above - 1]):
            units = (rows[above] + units)[:width]
            above -= 1
        if above >= 0 and len(rows[above]) >= min(width, 2) and not all(c == "" for c in rows[above]):
            names = (rows[above] + [""] * width)[: max(width, len(rows[above]))]
    units += [""] * (len(names) - width)
    return Table(
        path, tuple(names), tuple(units), tuple(lines[: max(above, 0)]), delimiter, first + 1, comma,
        tuple(rows[first]),
    )  # fmt: skip


def _split(line: str, delimiter: str) -> list[str]:
    cells = line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])
    while len(cells) > 1 and cells[-1].strip() == "":  # a delimiter at the end of the line
        cells.pop()
    return cells


def _delimiter(lines: Sequence[str]) -> str:
    """The one that splits the last lines of the head into the most numbers."""
    best = (0, ",")
    for candidate in ("\t", ";", ",", " "):
        numbers = sum(
            _number(cell, candidate != ",") is not None or is_date(cell)
            for line in lines[-10:]
            for cell in _split(line, candidate)
        )
        if numbers > best[0]:
            best = (numbers, candidate)
    return best[1]


def _is_data(row: Sequence[str], comma: bool) -> bool:
    cells = [cell for cell in row if cell]
    numeric = sum(_number(cell, comma) is not None for cell in cells)
    dated = bool(cells) and is_date(cells[0])
    return len(cells) >= 2 and numeric + dated >= max(2, (len(cells) + 1) // 2)


def _number(text: str, comma: bool) -> float | None:
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return None


def read_columns(table: Table, wanted: Sequence[int], time: int | None) -> tuple[list[str], FloatArray]:
    """The time column's texts (empty without one) and the wanted columns, (N, len(wanted)); an empty cell is
    NaN.

    Raises SourceError with file, line and column for a cell that is not a number and a row that is too short.
    """
    if table.delimiter == "parquet":
        return _read_parquet(table, wanted, time)
    times: list[str] = []
    values: list[list[float]] = []
    comma = table.decimal_comma
    last = max([*wanted, -1 if time is None else time])
    with _text(table.path) as file:
        for _ in range(table.first_line - 1):
            next(file)
        reader: Any = (
            (line.split() for line in file) if table.delimiter == " " else csv.reader(file, delimiter=table.delimiter)
        )
        for number, row in enumerate(reader, table.first_line):
            if not any(cell.strip() for cell in row):
                continue
            if len(row) <= last:
                raise SourceError(
                    f"{table.path}, line {number}: {len(row)} columns, of which column {last + 1} is wanted"
                )
            try:
                cells = [row[k].replace(",", ".") for k in wanted] if comma else [row[k] for k in wanted]
                values.append([float(cell) if cell.strip() else math.nan for cell in cells])
            except ValueError:
                bad = next(k for k in wanted if row[k].strip() and _number(row[k], comma) is None)
                name = f" ({table.names[bad]})" if table.names else ""
                raise SourceError(
                    f"{table.path}, line {number}, column {bad + 1}{name}: {row[bad]!r} is not a number"
                ) from None
            if time is not None:
                times.append(row[time].replace(",", ".") if comma else row[time])
    return times, np.array(values, np.float64).reshape(len(values), len(wanted))


def stamps(table: Table, texts: Sequence[str], time: int, unit: str) -> StampArray:
    """Int nanoseconds, exactly, of the time column: numbers in `unit`, or dates (`unit` "date"; no zone is
    UTC).
    """
    if unit == "date":
        parse = date_ns
    else:
        if plain(unit) not in TIME_UNITS:
            raise UsageError(f"{table.where(time)}: {_time_unit_problem(unit)}")
        scale = Decimal(TIME_UNITS[plain(unit)])

        def parse(text: str) -> int:
            return int((Decimal(text) * scale).to_integral_value())

    out = np.empty(len(texts), np.int64)
    for k, text in enumerate(texts):
        try:
            out[k] = parse(text)
        except (ValueError, InvalidOperation, OverflowError):
            line = "" if table.delimiter == "parquet" else f", line {_line_of(table, k)}"
            raise SourceError(f"{table.path}{line}, column {time + 1}: {text!r} is not a time ({unit})") from None
    return out


def is_date(text: str) -> bool:
    """Whether a cell is a date and time."""
    return bool(_DATE.match(text))


def date_ns(text: str) -> int:
    """ISO 8601 with up to nine decimals; also with slashes, as Shimmer writes dates."""
    text = text.strip().replace("/", "-").replace("_", " ", 1)
    match = re.match(r"^(.*:\d\d)\.(\d{7,9})(.*)$", text)
    if match is None:
        return parse_time_ns(text)
    return parse_time_ns(match[1] + match[3]) + int(match[2].ljust(9, "0"))


def _time_unit_problem(unit: str) -> str:
    there = ", ".join(TIME_UNITS)
    return f"time unit {unit!r} is none of {there}" if unit else f"the time has no unit; give one of {there}"


def _line_of(table: Table, row: int) -> int:
    """The line of the row'th row that is not blank."""
    seen = -1
    with _text(table.path) as file:
        for number, line in enumerate(file, 1):
            if number >= table.first_line and line.strip(table.delimiter + " \t\r\n"):
                seen += 1
                if seen == row:
                    return number
    return table.first_line + row


@contextmanager
def _text(path: Path) -> Iterator[Iterator[str]]:
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            yield file
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error


def _open_parquet(path: Path) -> Table:
    data = _parquet(path)
    if not data.num_rows:
        raise SourceError(f"{path}: has no rows")
    names = tuple(data.column_names)
    first = tuple(_parquet_texts(data.column(k).slice(0, 1))[0] for k in range(len(names)))
    return Table(path, names, ("",) * len(names), (), "parquet", 1, False, first)


def _read_parquet(table: Table, wanted: Sequence[int], time: int | None) -> tuple[list[str], FloatArray]:
    data = _parquet(table.path)
    columns = []
    for k in wanted:
        try:
            columns.append(np.asarray(data.column(k).to_numpy(zero_copy_only=False), np.float64))
        except (ValueError, TypeError) as error:
            raise SourceError(f"{table.where(k)}: is not a column of numbers") from error
    values = np.stack(columns, axis=1) if columns else np.empty((data.num_rows, 0))
    return [] if time is None else _parquet_texts(data.column(time)), values


def _parquet_texts(column: Any) -> list[str]:
    """The cells as texts; time stamps as dates with nine decimals, whatever their resolution."""
    if str(column.type).startswith("timestamp"):
        return [format_time(ns) for ns in column.cast("timestamp[ns]").cast("int64").to_pylist()]
    return [value.isoformat() if hasattr(value, "isoformat") else repr(value) for value in column.to_pylist()]


def _parquet(path: Path) -> Any:
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError(f"{path}: Parquet needs pyarrow: pip install 'spheremcap[parquet]'") from error
    try:
        return pyarrow.parquet.read_table(path)
    except (OSError, ValueError) as error:
        raise SourceError(f"{path}: is not a readable Parquet file ({' '.join(str(error).split())})") from error
