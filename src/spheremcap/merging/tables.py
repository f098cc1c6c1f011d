"""Delimited text, Excel and Parquet as columns of numbers, with every fault located by file, line and column.

Text is UTF-8 (with Windows' Western letters where that fails) or UTF-16. A last line that is cut off is left out and
said; a fault anywhere else is an error.
"""

import codecs
import csv
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spheremcap.errors import SourceError, UsageError
from spheremcap.merging.sheets import COLUMNAR, EXCEL, open_sheet, read_sheet
from spheremcap.merging.times import is_missing, is_time
from spheremcap.merging.units import is_known, is_unit, plain

FloatArray = npt.NDArray[np.float64]

_HEAD_LINES = 200
_COMMA_DECIMAL = re.compile(r"^[+-]?\d+,\d+(?:[eE][+-]?\d+)?$")
_UNIT_IN_NAME = re.compile(r"^(.*?)\s*[\(\[]\s*([^()\[\]]*(?:\([^()]*\)[^()\[\]]*)?)\s*[\)\]]\s*$")
_UNIT_BEHIND = re.compile(r"^(.*?[^\s/])(?:\s+(?:in\s+)?|\s*/\s*\(?)([^\s()]{2,}|[sgmNhC°])\)?$")
_OLD_SHEETS = (".xls", ".xlsb", ".ods", ".numbers")


class Line(NamedTuple):
    """One line of a table: its number from 1, its cells, and whether it has a line end."""

    number: int
    cells: list[str]
    ended: bool = True


@dataclass(frozen=True)
class Table:
    """What the head of a file says: `names` and `units` of the columns ("" where there are none), and how to
    read on. Data lines have `width` cells.

    `preamble` are the lines before the names. `first_line` is the number, from 1, of the first line with
    numbers; `head` are the first of those.
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str, ...]
    preamble: tuple[str, ...]
    delimiter: str
    first_line: int
    width: int
    decimal_comma: bool
    head: tuple[tuple[str, ...], ...]

    @property
    def first_row(self) -> tuple[str, ...]:
        """The first line with numbers."""
        return self.head[0]

    def column(self, wanted: str | int) -> int:
        """The index of a column by its name (case and blanks do not count) or its number from 1."""
        if isinstance(wanted, int):
            if 1 <= wanted <= len(self.first_row):
                return wanted - 1
            raise UsageError(f"{self.path}: there is no column {wanted}, only {len(self.first_row)}")
        if wanted in self.names:
            return self.names.index(wanted)
        bare = [bare_name(name) for name in self.names]
        for candidates in (bare, [bare_name(split_unit(name)[0]) for name in self.names]):
            if bare_name(wanted) in candidates:
                return candidates.index(bare_name(wanted))
        there = ", ".join(filter(None, self.names)) or f"{len(self.first_row)} columns without names"
        raise UsageError(f"{self.path}: there is no column {wanted!r}; there are: {there}")

    def unit(self, index: int) -> str:
        """The unit of a column: from a row of units, or behind its name."""
        return self.units[index] or (split_unit(self.names[index])[1] if self.names else "")

    def title(self, index: int) -> str:
        """A column for a person: `column 2 (acc_x)`."""
        name = f" ({self.names[index]})" if self.names and self.names[index] else ""
        return f"column {index + 1}{name}"

    def where(self, index: int) -> str:
        """A column as an error names it."""
        return f"{self.path}: {self.title(index)}"


@dataclass(frozen=True)
class Columns:
    """What was read: the times' cells (empty without any), `values` (N, columns), the line numbers (N,), and `lost`,
    one line for each kind of loss.
    """

    times: list[str]
    values: FloatArray
    lines: list[int]
    lost: tuple[str, ...] = ()


def bare_name(name: str) -> str:
    """A column's name without what people write differently."""
    return re.sub(r"[\s_\-]+", "", name).lower()


def split_unit(name: str) -> tuple[str, str]:
    """`Gyroscope X (deg/s)`, `v in km/h` or `t/s` to the name and the unit, which is "" when there is none."""
    match = _UNIT_IN_NAME.match(name)
    if match is None:
        match = None if is_known(name) else _UNIT_BEHIND.match(name.strip())
        if match is None or not is_known(match[2]):
            return name, ""
    return match[1].rstrip(" /"), match[2]


def open_table(path: Path, *, delimiter: str | None = None, skip_lines: int = 0, header: bool | None = None) -> Table:
    """Look at the head of a table: delimiter, names, units, first rows of numbers.

    Raises SourceError when there is no row of numbers in it.
    """
    suffix = path.suffix.lower()
    if suffix in _OLD_SHEETS:
        raise SourceError(f"{path}: {suffix} is not read: save it as .xlsx or as CSV")
    if suffix in COLUMNAR:
        names, *head = open_sheet(path, 10)
        return Table(path, tuple(names), ("",) * len(names), (), suffix, 2, len(names), False, tuple(map(tuple, head)))
    if suffix == EXCEL:
        return _table_of(path, open_sheet(path, skip_lines + _HEAD_LINES), suffix, skip_lines, header)
    with _text(path) as file:
        lines = [line.rstrip("\r\n") for _, line in zip(range(skip_lines + _HEAD_LINES), file, strict=False)]
    if delimiter is None:
        stated = next((re.match(r'^"?sep=(.)"?\s*$', line) for line in lines[:2] if "sep=" in line), None)
        delimiter = stated[1] if stated else _delimiter(lines[skip_lines:])
    return _table_of(path, [_split(line, delimiter) for line in lines], delimiter, skip_lines, header)


def _table_of(
    path: Path, lines: Sequence[Sequence[str]], delimiter: str, skip_lines: int, header: bool | None
) -> Table:
    rows = [_trimmed(cells) for cells in lines]
    comma = any(_COMMA_DECIMAL.match(cell) for row in rows for cell in row)
    if comma and delimiter == ",":  # in quotes; 1,024 may be a thousand where others have a point
        comma = not any("." in cell and number(cell, False) is not None for row in rows for cell in row)
    first = next((k for k, row in enumerate(rows) if k >= skip_lines and _is_data(row, comma)), None)
    if first is None:
        raise SourceError(f"{path}: no row of numbers in its first {len(lines)} lines")
    while first > skip_lines and _is_sparse(rows[first - 1], comma):
        first -= 1
    width = max(len(rows[first]), *map(len, rows[first : first + 10]))
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
    head = tuple(tuple((row + [""] * len(units))[: len(units)]) for row in rows[first : first + 10] if any(row))
    preamble = tuple(delimiter.join(row) for row in rows[: max(above, 0)])
    return Table(path, tuple(names), tuple(units), preamble, delimiter, first + 1, width, comma, head)


def _trimmed(cells: Sequence[str]) -> list[str]:
    """Cells without blanks around them, and without the empty one behind a delimiter at the end of the line."""
    row = [cell.strip() for cell in cells]
    while len(row) > 1 and row[-1] == "":
        row.pop()
    return row


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    return next(csv.reader([line], delimiter=delimiter), [])


def _delimiter(lines: Sequence[str]) -> str:
    """The one that splits the last lines of the head into the most numbers."""
    best = (0, ",")
    for candidate in ("\t", ";", ",", " "):
        counts = [
            sum(number(cell, True) is not None or is_time(cell) for cell in _split(line, candidate))
            for line in lines[-10:]
        ]
        numbers = sum(count for count in counts if count > 1)
        if numbers > best[0]:
            best = (numbers, candidate)
    return best[1]


def _is_data(row: Sequence[str], comma: bool) -> bool:
    """Whether most of a row's cells are numbers, after a time."""
    cells = [cell for cell in row if cell]
    numeric = sum(number(cell, comma) is not None for cell in cells)
    dated = sum(map(is_time, cells[:2]))
    absent = sum(map(is_missing, cells)) if numeric + dated else 0
    return len(cells) >= 2 and numeric + absent > 0 and numeric + dated + absent >= max(2, (len(cells) + 1) // 2)


def _is_sparse(row: Sequence[str], comma: bool) -> bool:
    """Whether a row begins with a number or a time, and no cell is a word: data with gaps."""
    if not row or (number(row[0], comma) is None and not is_time(row[0])):
        return False
    return all(is_missing(cell) or number(cell, comma) is not None or is_time(cell) for cell in row)


def number(text: str, comma: bool) -> float | None:
    """A cell's number; None where it is none."""
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return None


class _FaultError(Exception):
    """A line that cannot be read: what is wrong with it."""


def read_columns(table: Table, wanted: Sequence[int], times: Sequence[int] = ()) -> Columns:
    """The cells of the time columns (joined by a blank) and the wanted columns; what is no number to its maker is NaN.

    Raises SourceError with file, line and column for a cell that is not a number and a row that is too short, unless
    it is the last one.
    """
    if table.delimiter in COLUMNAR:
        texts, matrix = read_sheet(table.path, wanted, times)
        there = [k for k in range(len(matrix)) if not times or not is_missing(texts[k])]
        missing = [k + 1 for k in range(len(matrix)) if times and is_missing(texts[k])]
        if not there:
            raise SourceError(f"{table.path}: no line has a time")
        return Columns(
            [texts[k] for k in there if times], matrix[there], [k + 1 for k in there], _untimed(table, missing)
        )
    found = []
    values: list[list[float]] = []
    numbers: list[int] = []
    comma = table.decimal_comma
    last = max([*wanted, *times, 0])
    untimed: list[int] = []
    fault: str | None = None
    cut: Line | None = None
    with _lines(table) as lines:
        for line in lines:
            at, row, ended = line
            if fault is not None:
                if _is_blank(row):
                    continue
                raise SourceError(fault)
            if len(row) <= last or (not ended and len(row) < table.width):
                if _is_blank(row):
                    continue
                fault, cut = f"{table.path}, line {at}: {len(row)} columns, not {table.width}", line
                continue
            try:
                try:
                    own = [float(row[k].replace(",", ".")) if comma else float(row[k]) for k in wanted]
                except ValueError:
                    if _is_blank(row):
                        continue
                    own = [_cell(table, row, k) for k in wanted]
                text = " ".join([row[k].strip() for k in times])
            except _FaultError as error:
                fault, cut = f"{table.path}, line {at}, {error}", line
                continue
            if times and is_missing(text):
                if not _is_blank(row):
                    untimed.append(at)
                continue
            values.append(own)
            numbers.append(at)
            if times:
                found.append(text)
    if not values and fault is None:
        raise SourceError(f"{table.path}: no line has a time")
    lost = _untimed(table, untimed)
    if cut is not None:
        if not values or (cut.ended and len(cut.cells) > last):
            raise SourceError(fault)
        lost += (f"{table.path}: the last line, {cut.number}, is cut off: the {len(values)} before it are kept",)
    array = np.array(values, np.float64).reshape(len(values), len(wanted))
    return Columns(found, array, numbers, lost)


def _untimed(table: Table, lines: Sequence[int]) -> tuple[str, ...]:
    there = f"{len(lines)} lines without a time are" if len(lines) > 1 else "1 line without a time is"
    return (f"{table.path}: {there} left out, the first is line {lines[0]}",) if lines else ()


def _is_blank(row: Sequence[str]) -> bool:
    return not any(cell and not cell.isspace() for cell in row)


def _cell(table: Table, row: Sequence[str], k: int) -> float:
    if is_missing(row[k]):
        return math.nan
    value = number(row[k], table.decimal_comma)
    if value is None:
        raise _FaultError(f"{table.title(k)}: {row[k]!r} is not a number")
    return value


@contextmanager
def _lines(table: Table) -> Iterator[Iterator[Line]]:
    """The lines from the first with numbers on."""
    if table.delimiter == EXCEL:
        rows = open_sheet(table.path, None)[table.first_line - 1 :]
        yield (Line(number, cells) for number, cells in enumerate(rows, table.first_line))
        return
    with _text(table.path) as file:
        for _ in range(table.first_line - 1):
            next(file)
        yield (
            Line(number, _split(line.rstrip("\r\n"), table.delimiter), line[-1:] in "\r\n")
            for number, line in enumerate(file, table.first_line)
        )


def _western(error: UnicodeError) -> tuple[str, int]:
    """Bytes that are not UTF-8 as Windows' Western letters."""
    assert isinstance(error, UnicodeDecodeError)
    return error.object[error.start : error.end].decode("cp1252", "replace"), error.end


codecs.register_error("spheremcap-western", _western)


def _encoding(start: bytes) -> str:
    """By the file's first bytes: UTF-16 has a mark, or a zero in every second byte of its plain letters."""
    if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    zeros = [start[k::2].count(0) for k in (0, 1)]
    if max(zeros) > len(start) // 4 and min(zeros) == 0:
        return "utf-16-be" if zeros[0] else "utf-16-le"
    return "utf-8-sig"


@contextmanager
def _text(path: Path) -> Iterator[Iterator[str]]:
    try:
        with path.open("rb") as raw:
            encoding = _encoding(raw.read(512))
        errors = "spheremcap-western" if encoding == "utf-8-sig" else "replace"
        with path.open(encoding=encoding, errors=errors, newline="") as file:
            yield file
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    except csv.Error as error:
        raise SourceError(f"{path}: is not a table ({error})") from error
