"""Shimmer (Consensys): DEVICE_Accel_LN_X_CAL with a row of units; of two accelerometers the wide-range one."""

import re

from spheremcap.errors import UsageError
from spheremcap.merging.columns import fixed
from spheremcap.merging.log import SensorLog
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.tables import Table
from spheremcap.merging.times import is_time
from spheremcap.merging.units import TIME_UNITS, UNITS, plain

_WANTED = (
    ("linear_acceleration", ("Accel_WR", "Accel_LN", "Accel")),
    ("angular_velocity", ("Gyro",)),
    ("magnetic_field", ("Mag", "Mag_WR")),
)


def matches(table: Table) -> bool:
    """Whether columns are called calibrated or raw as the maker does it."""
    return any(re.search(r"_(cal|raw|uncal)$", name.lower()) for name in table.names)


def read(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """Only calibrated columns, in the units of the second row."""
    columns: dict[str, tuple[str | int, ...]] = {}
    units: dict[str, str] = {}
    for quantity, stems in _WANTED:
        for stem in stems:
            found = [_ending(table, f"_{stem}_{axis}_CAL") for axis in "XYZ"]
            indices = [k for k in found if k is not None]
            if len(indices) == 3 and quantity not in columns and plain(table.units[indices[0]]) in UNITS[quantity]:
                columns[quantity] = tuple(k + 1 for k in indices)
                units[quantity] = table.units[indices[0]]
    if not columns:
        raise UsageError(f"{table.path}: has no calibrated (CAL) accelerometer, gyroscope or magnetometer with a unit")
    stamped = (k for k, n in enumerate(table.names) if re.search(r"timestamp", n, re.IGNORECASE) and n.endswith("_CAL"))
    time = next(stamped, None)
    if time is None:
        raise UsageError(f"{table.path}: has no Timestamp column")
    unit = "date" if is_time(table.first_row[time]) else plain(table.units[time])
    unit = unit if unit in (*TIME_UNITS, "date") else ""
    return fixed(table, name, mapping, columns, units, column=time + 1, unit=unit)


def _ending(table: Table, ending: str) -> int | None:
    return next((k for k, n in enumerate(table.names) if n.lower().endswith(ending.lower())), None)
