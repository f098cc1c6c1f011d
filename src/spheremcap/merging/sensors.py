"""Sensor files as typed samples in SI units: IMUs, instrumented wheels, encoders, motion capture, anything
tabular.

Column layouts are those the makers' own programs export (`makers`, one file each); where a file does not say its units
and its maker does, that is used, and otherwise a mapping has to. Stamps are int nanoseconds of the sensor's own clock.
"""

import os
from dataclasses import replace
from pathlib import Path

from spheremcap.errors import SourceError, UsageError
from spheremcap.merging.columns import read_table
from spheremcap.merging.header import topic_name
from spheremcap.merging.log import SensorLog
from spheremcap.merging.makers import FILES, TABLES
from spheremcap.merging.mapping import TableMapping, UnreadTableError, mapping_to_start_from
from spheremcap.merging.tables import Table, open_table

TABLE_ENDINGS = (".csv", ".tsv", ".txt", ".data", ".xlsx", ".parquet", ".c3d")


def read_sensors(
    path: str | os.PathLike[str],
    *,
    name: str | None = None,
    mapping: TableMapping | None = None,
    rate_hz: float | None = None,
) -> list[SensorLog]:
    """All sensors in a file or folder; `name` (by default the file's) goes into their topics and frames.

    `rate_hz` is for files without times (SMARTwheel, C3D has its own). A folder may be an NGIMU or x-IMU3
    session, or hold any of the known files.

    Raises SourceError for what cannot be read (file, line, column) and UsageError for what has to be said; an
    UnreadTableError has a mapping to start from.
    """
    path = Path(path)
    name = name or path.stem
    if path.is_dir():
        return _read_folder(path, name, mapping, rate_hz)
    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    given = mapping or TableMapping()
    if rate_hz is not None:
        given = given.model_copy(update={"time": given.time.model_copy(update={"rate_hz": rate_hz})})
    for matches, read in FILES:
        if matches(path):
            return read(path, name, given)
    table = open_table(path, delimiter=given.delimiter, skip_lines=given.skip_lines, header=given.header)
    try:
        return [_read(table, name, given)]
    except UsageError as error:
        if mapping is not None:
            raise
        raise UnreadTableError(str(error), mapping_to_start_from(table)) from error


def _read(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    if not mapping.columns and mapping.kind != "record":
        for matches, read in TABLES:
            if matches(table):
                return read(table, name, mapping)
    return read_table(table, name, mapping)


def _read_folder(path: Path, name: str, mapping: TableMapping | None, rate_hz: float | None) -> list[SensorLog]:
    """Every table in the folder and in those in it; names are NAME for the main one, NAME_FILE for the
    others.
    """
    found: list[SensorLog] = []
    files = sorted(p for p in path.rglob("*") if p.is_file() and p.suffix.lower() in TABLE_ENDINGS)
    devices = {p.parent for p in files}
    for file in files:
        try:
            logs = read_sensors(file, mapping=mapping, rate_hz=rate_hz)
        except SourceError as error:
            if "no row of numbers" in str(error):  # settings and notes lie beside the data
                continue
            raise
        place = name if len(devices) == 1 else f"{name}_{topic_name(file.parent.name)}"
        main = file.stem.lower() in ("sensors", "inertial") or len(files) == 1
        for log in logs:
            own = place if main else f"{place}_{topic_name(file.stem)}"
            found.append(replace(log, name=own, frame_id=place))
    if not found:
        raise SourceError(f"{path}: no sensor file in this folder (CSV, TXT, DATA, Excel, Parquet or C3D)")
    return found
