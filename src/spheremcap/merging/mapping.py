"""The mapping file: how to read one table of unknown layout; and one to start from, for a table that needs it."""

import os
from itertools import pairwise
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from spheremcap.errors import SettingsError, UsageError
from spheremcap.io.toml_file import first_problem, read_toml
from spheremcap.merging.header import VECTORS, meaning
from spheremcap.merging.log import Kind
from spheremcap.merging.tables import Table, number
from spheremcap.merging.times import is_missing, is_time
from spheremcap.merging.units import TIME_UNITS, UNITS, plain


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Rate = Annotated[float, Field(gt=0, le=1e6)]


class TimeMapping(_Strict):
    """Where the stamps come from: a column (name, or number from 1) and its unit, or a rate."""

    column: str | int | None = None
    unit: Literal["ns", "us", "ms", "s", "min", "h", "date", ""] = ""
    month_first: bool | None = Field(default=None, description="for dates such as 03/04/2025")
    rate_hz: Rate | None = None
    start: str = Field(default="", description="ISO 8601 or Unix seconds; added to times that count from zero")


class ColumnMapping(_Strict):
    """Columns (one, or x, y, z; orientation w, x, y, z) of a quantity, their unit, where they saturate."""

    columns: tuple[str | int, ...]
    unit: str = ""
    range: Annotated[float, Field(gt=0)] | None = Field(default=None, description="full scale, in the same unit")
    counts_per_turn: Annotated[float, Field(gt=0)] | None = Field(default=None, description="for an angle in counts")


class TableMapping(_Strict):
    """How to read one table of unknown layout; everything left out is taken from the header where it is
    obvious.
    """

    kind: Kind | None = None
    frame_id: str = ""
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] | None = None
    skip_lines: Annotated[int, Field(ge=0, le=100_000)] = 0
    header: bool | None = None
    time: TimeMapping = TimeMapping()
    columns: dict[str, ColumnMapping] = Field(default_factory=dict)


class UnreadTableError(UsageError):
    """A table that needs a mapping; `mapping` is the text of one to start from."""

    def __init__(self, message: str, mapping: str) -> None:
        super().__init__(message)
        self.mapping = mapping


def load_mapping(path: str | os.PathLike[str]) -> TableMapping:
    """A mapping from TOML. Raises SettingsError naming the key that is wrong."""
    try:
        return TableMapping.model_validate(read_toml(path))
    except ValidationError as error:
        raise SettingsError(f"{path}: {first_problem(error)}") from error


def mapping_to_start_from(table: Table) -> str:
    """The TOML of a mapping, filled in as far as the table's head says; what is not known is there and empty."""
    names = [table.names[k] if k < len(table.names) else "" for k in range(len(table.first_row))]
    labels: list[str | int] = [name if names.count(name) == 1 and name else k + 1 for k, name in enumerate(names)]
    known = [meaning(name, table.units[k]) for k, name in enumerate(names)]
    columns: dict[str, Any] = {}
    for quantity in (*VECTORS, "orientation"):
        axes = "wxyz" if quantity == "orientation" else "xyz"
        there = [next((k for k, m in enumerate(known) if m and m[:2] == (quantity, axis)), None) for axis in axes]
        found = [k for k in there if k is not None]
        if len(found) == len(axes):
            columns[quantity] = _entry(table, labels, found, quantity)
    for quantity in ("angle", "rate", "temperature"):
        at = next((k for k, m in enumerate(known) if m and m.quantity == quantity), None)
        if at is not None:
            columns[quantity] = _entry(table, labels, [at], quantity)
    imu = columns.keys() & {"linear_acceleration", "angular_velocity", "magnetic_field", "orientation"}
    time = next((k for k, m in enumerate(known) if m and m.quantity == "time"), None)
    if time is None:
        time = _first_rising(table)
    if not columns.keys() - {"temperature"}:
        columns = {
            (label if isinstance(label := labels[k], str) else f"column_{label}"): {"columns": [label]}
            for k, cell in enumerate(table.first_row)
            if k != time and not is_time(cell) and (is_missing(cell) or number(cell, table.decimal_comma) is not None)
        }
        kind = "record"
    else:
        kind = "imu" if imu else "wheel"
    timing: dict[str, Any] = {"rate_hz": 100.0}
    if time is not None:
        own = known[time]
        unit = "date" if is_time(table.first_row[time]) else plain(table.unit(time) or (own.unit if own else ""))
        timing = {"column": labels[time], "unit": unit if unit in (*TIME_UNITS, "date") else ""}
    told = [f"# column {k + 1}: {name!r}, first value {table.first_row[k]!r}" for k, name in enumerate(names)]
    return "\n".join(
        [
            f"# How to read {table.path.name}: check it, fill in the units that are empty, give it with --mapping.",
            *told,
            f"# time.unit: {', '.join(TIME_UNITS)}, or date (dates and times of day); without times rate_hz instead",
            *(f"# unit of {q}: {', '.join(UNITS[q])}" for q in columns if q in UNITS and kind != "record"),
            tomli_w.dumps({"kind": kind, "time": timing, "columns": columns}),
        ]
    )


def _entry(table: Table, labels: list[str | int], indices: list[int], quantity: str) -> dict[str, Any]:
    found = meaning(table.names[indices[0]], table.units[indices[0]])
    unit = found.unit if found is not None else ""
    return {"columns": [labels[k] for k in indices], "unit": unit if plain(unit) in UNITS[quantity] else ""}


def _first_rising(table: Table) -> int | None:
    """The first column of times, or whose numbers rise from row to row."""
    for k, cell in enumerate(table.first_row):
        if is_time(cell):
            return k
        numbers = [number(row[k], table.decimal_comma) for row in table.head]
        if len(numbers) > 1 and all(a is not None and b is not None and a < b for a, b in pairwise(numbers)):
            return k
    return None
