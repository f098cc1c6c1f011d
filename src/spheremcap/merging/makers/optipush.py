"""Optipush: .data, tab-separated; times in column 1, forces 4-6 and moments 7-9 in the turning rim's axes, angle
10.
"""

from spheremcap.merging.columns import fixed
from spheremcap.merging.log import SensorLog
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.tables import Table, open_table


def matches(table: Table) -> bool:
    """By the ending."""
    return table.path.suffix.lower() == ".data"


def read(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """By the order of the columns; the lines before them are no names."""
    table = open_table(table.path, delimiter=mapping.delimiter or "\t", header=False)
    columns: dict[str, tuple[str | int, ...]] = {"angle": (10,), "force": (4, 5, 6), "moment": (7, 8, 9)}
    units = {"angle": "deg", "force": "N", "moment": "Nm"}
    frame = mapping.model_copy(update={"frame_id": mapping.frame_id or f"{name}_rim"})
    return fixed(table, name, frame, columns, units, column=1, unit="s")
