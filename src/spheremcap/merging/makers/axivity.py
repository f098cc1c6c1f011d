"""Axivity AX3 and AX6 without a header: date, acceleration in g, then angular rate in deg/s."""

from spheremcap.merging.columns import fixed
from spheremcap.merging.log import SensorLog
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.tables import Table
from spheremcap.merging.times import is_date


def matches(table: Table) -> bool:
    """A date and three, six or nine numbers, without names."""
    return not table.names and is_date(table.first_row[0]) and len(table.first_row) in (4, 7, 10)


def read(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """By the order of the columns."""
    columns: dict[str, tuple[str | int, ...]] = {"linear_acceleration": (2, 3, 4)}
    if len(table.first_row) >= 7:
        columns["angular_velocity"] = (5, 6, 7)
    units = {"linear_acceleration": "g", "angular_velocity": "deg/s"}
    return fixed(table, name, mapping, columns, units, column=1, unit="date")
