"""Movesense: one sensor a file, told by the column or file name; milliseconds, m/s^2, deg/s, uT."""

import re

from spheremcap.errors import UsageError
from spheremcap.merging.columns import fixed
from spheremcap.merging.log import SensorLog
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.tables import Table, split_unit
from spheremcap.merging.units import TIME_UNITS, plain

_SENSORS = (
    ("angular_velocity", "gyro", "deg/s"),
    ("magnetic_field", "mag", "uT"),
    ("linear_acceleration", "acc", "m/s2"),
)


def matches(table: Table) -> bool:
    """By the file's name, as the showcase app gives it, or the folder's."""
    stream = re.search(r"_(acc|gyro|magn|imu\d)_stream$", table.path.stem.lower())
    return "movesense" in str(table.path).lower() or stream is not None


def read(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """The sensor is the first that the names speak of."""
    text = f"{table.path.stem} {' '.join(table.names)}".lower()
    for quantity, mark, unit in _SENSORS:
        if mark in text:
            time = next((k for k, n in enumerate(table.names) if "time" in n.lower()), 0)
            axes = []
            for axis in "xyz":
                found = [k for k, n in enumerate(table.names) if split_unit(n)[0].strip().lower().endswith(axis)]
                if len(found) != 1:
                    raise UsageError(f"{table.path}: no column is obviously {mark} {axis}: give a mapping")
                axes.append(found[0] + 1)
            stated = table.unit(time) if table.names else ""
            time_unit = plain(stated) if plain(stated) in TIME_UNITS else "ms"
            columns: dict[str, tuple[str | int, ...]] = {quantity: tuple(axes)}
            return fixed(table, name, mapping, columns, {quantity: unit}, column=time + 1, unit=time_unit)
    raise UsageError(f"{table.path}: neither its name nor its columns say which sensor it is: give a mapping")
