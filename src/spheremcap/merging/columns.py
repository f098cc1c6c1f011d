"""A table as a sensor's log: which columns are which quantity, in which units, and which are its times."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import NS_PER_S, parse_time_ns
from spheremcap.errors import SourceError, UsageError
from spheremcap.merging.header import VECTORS, field_name, meaning
from spheremcap.merging.log import Kind, SensorLog, sensor_log
from spheremcap.merging.mapping import ColumnMapping, TableMapping, TimeMapping
from spheremcap.merging.tables import Columns, Table, bare_name, number, read_columns, split_unit
from spheremcap.merging.times import (
    LATEST_NS,
    NotATimeError,
    StampArray,
    Timing,
    is_missing,
    is_time,
    is_time_of_day,
    read_times,
)
from spheremcap.merging.units import TIME_UNITS, UNITS, factor, plain

FloatArray = npt.NDArray[np.float64]

_IMU = ("linear_acceleration", "angular_velocity", "magnetic_field", "orientation", "temperature")
_WHEEL = ("angle", "rate", "force", "moment")


def read_table(
    table: Table, name: str, mapping: TableMapping, own: tuple[StampArray, Timing] | None = None
) -> SensorLog:
    """A table by its mapping, and by its header for what the mapping leaves open; `own` stamps replace its times."""
    columns: dict[str, tuple[int, str]] = {}  # value's name -> column, unit
    scales: dict[str, ColumnMapping] = {}
    header = [meaning(n, table.units[k]) for k, n in enumerate(table.names)]
    times = [k for k, m in enumerate(header) if m is not None and m.quantity == "time"]
    plain_names = [bare_name(n) for n in table.names]
    if all(axis in plain_names for axis in "wxyz"):  # a quaternion file of x-io
        header = [meaning(f"q{n}", "1") if n in tuple("wxyz") else header[k] for k, n in enumerate(plain_names)]
    if mapping.columns:
        for quantity, given in mapping.columns.items():
            axes = _axes(quantity, len(given.columns), mapping.kind)
            for axis, wanted in zip(axes, given.columns, strict=True):
                index = table.column(wanted)
                columns[_free(axis, columns)] = (index, given.unit or table.unit(index))
                scales[axis] = given
    elif mapping.kind != "record":
        for k, found in enumerate(header):
            if found is not None and found.quantity in (*_IMU, *_WHEEL):
                columns.setdefault(found.value, (k, found.unit))
    kind = mapping.kind or _kind_of(columns)
    notes: tuple[str, ...] = ()
    if kind == "record":
        if not mapping.columns:
            columns, notes = _record(table, times[:1])
        columns = {axis: c for axis, c in columns.items() if mapping.columns or _is_number(table, c[0])}
    else:
        allowed = _IMU if kind == "imu" else _WHEEL
        columns = {axis: c for axis, c in columns.items() if axis.split(".")[0] in allowed}
    time = None if own is not None else _time_columns(table, mapping.time, times)
    read, stamp_ns, timing = _read(table, mapping, time or (), [k for k, _ in columns.values()], own)
    used = {*(k for k, _ in columns.values()), *(time or times[:1])}
    if not mapping.columns:
        notes += _left_out(table, used)
    values: dict[str, FloatArray] = {}
    saturated: npt.NDArray[np.bool_] | None = None
    for (axis, (index, unit)), column in zip(columns.items(), read.values.T, strict=True):
        given = scales.get(axis, ColumnMapping(columns=()))
        scale = _scale(axis, unit, given, kind, table.where(index))
        if given.range is not None:
            at_end = np.abs(column) >= 0.999 * given.range
            saturated = at_end if saturated is None else saturated | at_end
        with np.errstate(over="ignore"):
            scaled = column * scale
        values[axis] = np.where(np.isinf(scaled), np.nan, scaled)
    return sensor_log(
        name, kind, stamp_ns, values, timing, table.path,
        frame_id=mapping.frame_id, saturated=saturated, notes=notes, lost=read.lost,
    )  # fmt: skip


def fixed(
    table: Table,
    name: str,
    mapping: TableMapping,
    columns: Mapping[str, tuple[str | int, ...]],
    units: Mapping[str, str],
    own: tuple[StampArray, Timing] | None = None,
    **time: Any,
) -> SensorLog:
    """A table whose layout is known, as if a mapping had said it; the user's own time settings come first. The columns
    that are left out are said.
    """
    given = {key: value for key, value in mapping.time.model_dump().items() if value not in (None, "")}
    filled = mapping.model_copy(
        update={
            "time": TimeMapping(**({} if "rate_hz" in given else time) | given),
            "columns": {q: ColumnMapping(columns=c, unit=units[q]) for q, c in columns.items()},
        }
    )
    log = read_table(table, name, filled, own)
    used = {table.column(wanted) for names in columns.values() for wanted in names}
    if filled.time.column is not None:
        used.add(table.column(filled.time.column))
    used.update(k for k, n in enumerate(table.names) if (found := meaning(n, "")) and found.quantity == "time")
    return replace(log, notes=(*log.notes, *_left_out(table, used)))


def even_stamps(count: int, rate_hz: float) -> StampArray:
    """(N,) stamps of samples at a stated rate from zero, each rounded from the exact time."""
    period = Fraction(NS_PER_S) / Fraction(str(rate_hz))
    n, d = period.numerator, period.denominator
    return np.array([(2 * k * n + d) // (2 * d) for k in range(count)], np.int64)


def _left_out(table: Table, used: Collection[int]) -> tuple[str, ...]:
    left = [name for k, name in enumerate(table.names) if name and k not in used]
    return (f"{table.path}: columns that are left out: {', '.join(left)}",) if left else ()


def _axes(quantity: str, count: int, kind: Kind | None) -> list[str]:
    if kind == "record":
        name = field_name(quantity) or "column"
        names = [name] if count == 1 else [f"{name}_{k}" for k in range(count)]
        return names if count != 3 else [f"{name}_{axis}" for axis in "xyz"]
    sizes = {**dict.fromkeys(VECTORS, 3), "orientation": 4}
    known = (*_IMU, *_WHEEL)
    if quantity not in known:
        raise UsageError(f'mapping: {quantity!r} is none of {", ".join(known)} (or say kind = "record")')
    if count != sizes.get(quantity, 1):
        raise UsageError(f"mapping: {quantity} takes {sizes.get(quantity, 1)} columns, not {count}")
    letters = "wxyz" if quantity == "orientation" else "xyz"
    return [quantity] if count == 1 else [f"{quantity}.{axis}" for axis in letters]


def _kind_of(columns: Mapping[str, Any]) -> Kind:
    names = {axis.split(".")[0] for axis in columns}
    if names & {"linear_acceleration", "angular_velocity", "magnetic_field", "orientation"}:
        return "imu"
    return "wheel" if names & {"angle", "rate", "force", "moment"} else "record"


def _record(table: Table, times: Sequence[int]) -> tuple[dict[str, tuple[int, str]], tuple[str, ...]]:
    """Every column of numbers under a name of its own; speeds in m/s, all else as it is."""
    columns: dict[str, tuple[int, str]] = {}
    renamed = []
    for k, title in enumerate(table.names):
        if not title or k in times or not _is_number(table, k):
            continue
        unit = plain(table.unit(k))
        found = meaning(title, table.units[k])
        speed = unit in UNITS["speed"] and "/" in unit
        speed = speed or (found is not None and found.quantity == "speed" and plain(found.unit) in UNITS["speed"])
        if speed:
            unit = unit or (found.unit if found is not None else "")
            wanted = f"{field_name(split_unit(title)[0]).removesuffix('_' + plain(unit).replace('/', '_'))}_mps"
        else:
            wanted, unit = field_name(title) or f"column_{k + 1}", ""
        own = _free(wanted, columns)
        if own != wanted:
            renamed.append(f"{title!r} as {own}")
        columns[own] = (k, unit)
    if not columns:
        raise UsageError(f"{table.path}: its columns have no names: give a mapping (TOML) that says what they are")
    note = (f"{table.path}: columns whose names are alike are kept apart: {', '.join(renamed)}",) if renamed else ()
    return columns, note


def _free(wanted: str, taken: Mapping[str, Any]) -> str:
    """The name, or with a number behind it where it is taken; a sample's own `timestamp` always is."""
    own, number = wanted, 1
    alike = {name.replace("_", "") for name in taken} | {"timestamp"}
    while own.replace("_", "") in alike:
        number += 1
        own = f"{wanted}_{number}"
    return own


def _is_number(table: Table, index: int) -> bool:
    """Whether a column's first value is a number."""
    for row in table.head:
        if not is_missing(row[index]):
            return number(row[index], table.decimal_comma) is not None
    return True


def _scale(axis: str, unit: str, given: ColumnMapping, kind: Kind, where: str) -> float:
    if kind == "record":
        return factor("speed", unit, where) if axis.endswith("_mps") and unit else 1.0
    quantity = axis.split(".")[0]
    if given.counts_per_turn is not None:
        return 2 * np.pi / given.counts_per_turn
    if quantity == "angle" and plain(unit) in ("counts", "count", "ticks", "pulses"):
        raise UsageError(f"{where}: an angle in counts needs counts_per_turn in a mapping")
    return factor(quantity, unit, where)


def _time_columns(table: Table, given: TimeMapping, found: Sequence[int]) -> list[int] | None:
    """The columns of the times: one, or a date and its time of day. None: there is a rate instead."""
    if given.column is not None:
        return [table.column(given.column)]
    if given.rate_hz is not None:
        return None
    if not found:
        found = [k for k, cell in enumerate(table.first_row[:2]) if is_time(cell)]
    if not found:
        there = ", ".join(filter(None, table.names)) or "none has a name"
        raise UsageError(f"{table.path}: no column is obviously the time ({there}): give a mapping, or the rate in Hz")
    cell = table.first_row[found[0]]
    if ":" not in cell and is_time(cell):
        clock = next((k for k in found[1:] if is_time_of_day(table.first_row[k])), None)
        return [found[0]] if clock is None else [found[0], clock]
    day = next((k for k in found[1:] if ":" not in table.first_row[k] and is_time(table.first_row[k])), None)
    return [found[0]] if day is None or not is_time_of_day(cell) else [day, found[0]]


def _read(
    table: Table,
    mapping: TableMapping,
    time: Sequence[int],
    wanted: Sequence[int],
    own: tuple[StampArray, Timing] | None,
) -> tuple[Columns, StampArray, Timing]:
    """The wanted columns and the stamps, from a column or a rate."""
    given = mapping.time
    start_ns, behind = 0, ""
    if given.start:
        try:
            start_ns, behind = parse_time_ns(given.start), f" after {given.start} (mapping)"
            if abs(start_ns) >= LATEST_NS:
                raise ValueError
        except (ValueError, OverflowError) as error:
            raise UsageError(f"mapping: time.start {given.start!r} is neither a date nor Unix seconds") from error
    if not time:
        read = read_columns(table, wanted)
        rate_hz = given.rate_hz or 1.0
        stamp_ns, timing = own or (even_stamps(len(read.values), rate_hz), Timing(f"none: {rate_hz:g} Hz", "start"))
        if len(stamp_ns) != len(read.values):
            raise SourceError(f"{table.path}: has {len(stamp_ns)} times for {len(read.values)} lines")
    else:
        unit: str = given.unit
        if not unit:
            unit = "date" if is_time(table.first_row[time[0]]) else table.unit(time[0])
        if not unit and table.names:
            found = meaning(table.names[time[0]], "")
            unit = found.unit if found is not None else ""
        if unit != "date" and plain(unit) not in TIME_UNITS:
            raise UsageError(f"{table.where(time[0])}: {_time_unit_problem(unit)}")
        read = read_columns(table, wanted, time)
        read, stamp_ns, timing = _stamps(table, read, time, unit, given.month_first)
        timing = Timing(f"{' and '.join(map(table.title, time))} {timing.how}", timing.zero, timing.zone_assumed)
    if behind:
        timing = Timing(timing.how + behind, "1970")
    return read, stamp_ns + start_ns, timing


def _stamps(
    table: Table, read: Columns, time: Sequence[int], unit: str, month_first: bool | None
) -> tuple[Columns, StampArray, Timing]:
    """The times' stamps; a last one that is no time any more is cut off."""
    comma = table.decimal_comma and unit != "date"
    texts = [text.replace(",", ".") for text in read.times] if comma else read.times
    try:
        return read, *read_times(texts, unit, month_first=month_first)
    except NotATimeError as error:
        row = error.row
        where = "" if table.delimiter.startswith(".p") else f", line {read.lines[row]}"
        raise SourceError(
            f"{table.path}{where}, column {time[-1] + 1}: {read.times[row]!r} is not a time ({unit})"
        ) from None


def _time_unit_problem(unit: str) -> str:
    there = ", ".join(TIME_UNITS)
    return f"time unit {unit!r} is none of {there}" if unit else f"the time has no unit; give one of {there}"
