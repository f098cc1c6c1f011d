"""Xsens (Movella) DOT: SampleTimeFine counts microseconds in 32 bits, m/s^2 and deg/s."""

import numpy as np

from spheremcap.errors import SourceError, UsageError
from spheremcap.merging.columns import fixed
from spheremcap.merging.log import SensorLog
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.tables import Table, bare_name, read_columns
from spheremcap.merging.times import NotATimeError, Timing, read_times


def matches(table: Table) -> bool:
    """Whether the maker's counters are among the columns."""
    names = [bare_name(name) for name in table.names]
    return "sampletimefine" in names and "packetcounter" in names


def read(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """Free acceleration has no gravity in it and is left out; the counter's wraps are undone."""
    there = {bare_name(n): n for n in table.names}
    columns: dict[str, tuple[str | int, ...]] = {}
    for quantity, stem in (("linear_acceleration", "acc"), ("angular_velocity", "gyr")):
        if all(f"{stem}{axis}" in there for axis in "xyz"):
            columns[quantity] = tuple(there[f"{stem}{axis}"] for axis in "xyz")
    if all(f"quat{axis}" in there for axis in "wxyz"):
        columns["orientation"] = tuple(there[f"quat{axis}"] for axis in "wxyz")
    if not columns:
        raise UsageError(
            f"{table.path}: has neither Acc, Gyr nor Quat columns (free acceleration has no gravity in it): "
            "export a mode with inertial data"
        )
    units = {"linear_acceleration": "m/s2", "angular_velocity": "deg/s", "orientation": "1"}
    if mapping.time.column is not None or mapping.time.rate_hz is not None:
        return fixed(table, name, mapping, columns, units)
    time = table.column("SampleTimeFine")
    # The same columns, so that both readings leave out the same lines.
    wanted = [table.column(column) for names in columns.values() for column in names]
    counted = read_columns(table, wanted, [time])
    try:
        stamp_ns, _ = read_times(counted.times, "us")
    except NotATimeError as error:
        raise SourceError(
            f"{table.path}, line {counted.lines[error.row]}, {table.title(time)}: is not a count of microseconds"
        ) from None
    ticks = stamp_ns // 1000
    turns = np.concatenate([[0], np.cumsum(np.diff(ticks) < -(1 << 31))]) if len(ticks) else ticks
    wrapped = " (its 32-bit counter began anew, which is undone)" if len(turns) and turns[-1] else ""
    timing = Timing(f"{table.title(time)} in us{wrapped}", "start")
    return fixed(table, name, mapping, columns, units, ((ticks + turns * (1 << 32)) * 1000, timing))
