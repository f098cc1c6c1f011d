"""What makers' programs write, one file a maker. A new one is a new file and a line here: what says that a file or a
table is the maker's, and how it is read.
"""

from collections.abc import Callable
from pathlib import Path

from spheremcap.merging.log import SensorLog
from spheremcap.merging.makers import axivity, c3d, gopro, movesense, optipush, shimmer, smartwheel, xsens_dot
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.tables import Table

FILES: tuple[tuple[Callable[[Path], bool], Callable[[Path, str, TableMapping], list[SensorLog]]], ...] = (
    (c3d.matches, c3d.read),
    (gopro.matches, gopro.read),
)
"""Files that are no tables, by their name."""

TABLES: tuple[tuple[Callable[[Table], bool], Callable[[Table, str, TableMapping], SensorLog]], ...] = (
    (xsens_dot.matches, xsens_dot.read),
    (shimmer.matches, shimmer.read),
    (movesense.matches, movesense.read),
    (axivity.matches, axivity.read),
    (smartwheel.matches, smartwheel.read),
    (optipush.matches, optipush.read),
)
"""By the head of a table; the first that matches."""
