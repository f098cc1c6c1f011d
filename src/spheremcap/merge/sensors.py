"""Sensor files as typed samples in SI units: IMUs, instrumented wheels, encoders, motion capture, anything
tabular.

Column layouts are those the makers' own programs export; where a file does not say its units and its maker
does, that is used, and otherwise a mapping has to. Stamps are int nanoseconds of the sensor's own clock.
"""

import os
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from spheremcap.core.time import NS_PER_S
from spheremcap.errors import SettingsError, SourceError, UsageError
from spheremcap.merge.gpmf import read_gpmf
from spheremcap.merge.tables import (
    Table,
    bare_name,
    date_ns,
    is_date,
    open_table,
    read_columns,
    split_unit,
    stamps,
)
from spheremcap.merge.units import TIME_UNITS, UNITS, factor, plain

FloatArray = npt.NDArray[np.float64]
StampArray = npt.NDArray[np.int64]
Kind = Literal["imu", "wheel", "record"]

_YEAR_2000_NS = 946_684_800 * NS_PER_S
_VECTORS = ("linear_acceleration", "angular_velocity", "magnetic_field", "force", "moment")
_IMU = ("linear_acceleration", "angular_velocity", "magnetic_field", "orientation", "temperature")
_WHEEL = ("angle", "rate", "force", "moment")


@dataclass(frozen=True)
class SensorLog:
    """One sensor's samples in SI units, by rising stamp.

    `values` has (N,) arrays, NaN where there is none. Of an `imu`: `linear_acceleration.x` (m/s^2, gravity
    included), `angular_velocity.x` (rad/s), `magnetic_field.x` (T), `orientation.w`, `temperature_c`. Of a
    `wheel`: `angle_rad` (unwrapped), `rate_rad_s`, `force.x` (N), `moment.x` (N m). Of a `record` whatever
    its columns are. `saturated` (N,) is None when nothing is known of it. `notes` are lines for the user.
    """

    name: str
    kind: Kind
    stamp_ns: StampArray
    values: Mapping[str, FloatArray]
    frame_id: str
    source: str
    saturated: npt.NDArray[np.bool_] | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def relative(self) -> bool:
        """Whether the stamps count from zero, the start of the sensor's recording, and not from 1970."""
        return bool(len(self.stamp_ns)) and int(self.stamp_ns[0]) < _YEAR_2000_NS

    def vector(self, name: str) -> FloatArray | None:
        """(N, 3) of `linear_acceleration`, `angular_velocity`, ...; None when an axis is missing."""
        axes = [self.values.get(f"{name}.{axis}") for axis in "xyz"]
        return None if any(a is None for a in axes) else np.stack([a for a in axes if a is not None], axis=1)


# --- the mapping ---


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class TimeMapping(_Strict):
    """Where the stamps come from: a column (name, or number from 1) and its unit, or a rate."""

    column: str | int | None = None
    unit: Literal["ns", "us", "ms", "s", "date", ""] = ""
    rate_hz: Annotated[float, Field(gt=0)] | None = None
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
    delimiter: str | None = None
    skip_lines: Annotated[int, Field(ge=0)] = 0
    header: bool | None = None
    time: TimeMapping = TimeMapping()
    columns: dict[str, ColumnMapping] = Field(default_factory=dict)


def load_mapping(path: str | os.PathLike[str]) -> TableMapping:
    """A mapping from TOML. Raises SettingsError naming the key that is wrong."""
    try:
        return TableMapping.model_validate(tomllib.loads(Path(path).read_text(encoding="utf-8")))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise SettingsError(f"{path}: {key}: {first['msg']}") from error


# --- reading ---


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

    Raises SourceError for what cannot be read (file, line, column) and UsageError for what has to be said.
    """
    path = Path(path)
    name = name or path.stem
    if path.is_dir():
        return _read_folder(path, name, mapping, rate_hz)
    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    suffix = path.suffix.lower()
    if suffix == ".c3d":
        return [_read_c3d(path, name)]
    if suffix in (".mp4", ".mov", ".360"):
        return _read_gopro(path, name)
    if mapping is None:
        mapping = TableMapping()
    if rate_hz is not None:
        mapping = mapping.model_copy(update={"time": mapping.time.model_copy(update={"rate_hz": rate_hz})})
    if not mapping.columns and suffix == ".data":
        return [_read_optipush(path, name, mapping)]
    table = open_table(path, delimiter=mapping.delimiter, skip_lines=mapping.skip_lines, header=mapping.header)
    if not mapping.columns and mapping.kind != "record":
        known = _known_layout(table)
        if known is not None:
            return [known(table, name, mapping)]
    return [_read_table(table, name, mapping)]


def _read_folder(path: Path, name: str, mapping: TableMapping | None, rate_hz: float | None) -> list[SensorLog]:
    """Every table in the folder and in those in it; names are NAME for the main one, NAME_FILE for the
    others.
    """
    found: list[SensorLog] = []
    tables = (".csv", ".tsv", ".txt", ".data", ".parquet", ".c3d")
    files = sorted(p for p in path.rglob("*") if p.is_file() and p.suffix.lower() in tables)
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
        raise SourceError(f"{path}: no sensor file in this folder (CSV, TXT, DATA, Parquet or C3D)")
    return found


def topic_name(text: str) -> str:
    """A text as part of a topic: lower case, with _ for everything that is not a letter or digit."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


# --- tables ---

_QUANTITIES: tuple[tuple[str, str], ...] = (
    (r"freeacc\w*|useracc\w*", ""),  # gravity is taken out: not what an accelerometer measures
    (r"linearacceleration|accelerometer|acceleration|accel|acc|a", "linear_acceleration"),
    (r"angularvelocity|angularrate|gyroscope|gyro|gyr|g|omega|w", "angular_velocity"),
    (r"magneticfield|magnetometer|magnetic|mag", "magnetic_field"),
    (r"force|f", "force"),
    (r"moment|torque|t", "moment"),
    (r"m", "moment|magnetic_field"),
)
_AXIS = re.compile(r"^(.*?)([xyz])$")
_TIME_NAME = re.compile(r"^(time|timestamp|t|sampletimefine|epoch|unixtime|datetime|date|elapsed)(ns|us|ms|s)?$")
_SUFFIX_UNITS = (
    ("_mps2", "m/s2"), ("_ms2", "m/s2"), ("_m_s2", "m/s2"), ("_dps", "dps"), ("_deg_s", "deg/s"),
    ("_rad_s", "rad/s"), ("_radps", "rad/s"), ("_ut", "uT"), ("_g", "g"), ("_nm", "Nm"), ("_n", "N"),
    ("_deg", "deg"), ("_rad", "rad"), ("_rpm", "rpm"), ("_ns", "ns"), ("_us", "us"), ("_ms", "ms"),
    ("_s", "s"),
)  # fmt: skip


def _named(name: str, unit: str) -> tuple[str, str, str] | None:
    """(quantity, axis, unit) that a header obviously means, e.g. `Gyroscope X (deg/s)`; None when it does
    not.
    """
    bare, bracket = split_unit(name)
    unit = unit or bracket
    if not unit:
        for ending, meant in _SUFFIX_UNITS:
            if bare.lower().endswith(ending):
                bare, unit = bare[: -len(ending)], meant
                break
    text = bare_name(bare)
    if _TIME_NAME.match(text):
        match = _TIME_NAME.match(text)
        return "time", "", unit or (match[2] or "" if match else "")
    if text in ("angle", "wheelangle", "theta", "encoder", "position", "counts"):
        return "angle", "", unit
    if text in ("rate", "angularrate", "wheelrate", "angularvelocity", "speed", "rpm"):
        return "rate", "", unit or ("rpm" if text == "rpm" else "")
    if text in ("temperature", "temp"):
        return "temperature", "", unit
    if text in ("x", "y", "z") and unit:  # x-IMU3 names its high-g accelerometer's columns so
        quantity = next((q for q in _VECTORS if plain(unit) in UNITS[q]), None)
        return (quantity, text, unit) if quantity is not None else None
    match = _AXIS.match(text)
    if match is not None:
        for pattern, quantity in _QUANTITIES:
            if re.fullmatch(pattern, match[1]):
                if "|" in quantity:
                    quantity = next((q for q in quantity.split("|") if plain(unit) in UNITS[q]), "")
                return (quantity, match[2], unit) if quantity else None
    match = re.match(r"^(?:quaternion|quat|q)([wxyz])$", text)
    if match is not None:
        return "orientation", match[1], "1"
    return None


def _read_table(table: Table, name: str, mapping: TableMapping, own_stamps: StampArray | None = None) -> SensorLog:
    """A table by its mapping, and by its header for what the mapping leaves open; `own_stamps` replace its
    times.
    """
    columns: dict[str, tuple[int, str]] = {}  # value's name -> column, unit
    scales: dict[str, ColumnMapping] = {}
    header = [_named(n, table.units[k]) for k, n in enumerate(table.names)]
    times = [k for k, h in enumerate(header) if h is not None and h[0] == "time"]
    plain_names = [bare_name(n) for n in table.names]
    if all(axis in plain_names for axis in "wxyz"):  # a quaternion file of x-io
        header = [("orientation", n, "1") if n in tuple("wxyz") else header[k] for k, n in enumerate(plain_names)]
    if mapping.columns:
        for quantity, given in mapping.columns.items():
            axes = _axes(quantity, len(given.columns), mapping.kind)
            for axis, wanted in zip(axes, given.columns, strict=True):
                index = table.column(wanted)
                columns[axis] = (index, given.unit or table.unit(index))
                scales[axis] = given
    elif mapping.kind != "record":
        for k, found in enumerate(header):
            if found is not None and found[0] != "time":
                axis = f"{found[0]}.{found[1]}" if found[1] else found[0]
                columns.setdefault(axis, (k, found[2]))
    kind = mapping.kind or _kind_of(columns)
    if kind == "record":
        if not mapping.columns:
            columns = {_field_name(n): (k, "") for k, n in enumerate(table.names) if n and k not in times[:1]}
        if not columns:
            raise UsageError(f"{table.path}: its columns have no names: give a mapping (TOML) that says what they are")
        columns = {axis: columns[axis] for axis in columns if _is_number(table, columns[axis][0])}
    else:
        allowed = _IMU if kind == "imu" else _WHEEL
        columns = {axis: c for axis, c in columns.items() if axis.split(".")[0] in allowed}
    numbers, stamp_ns = _times(table, mapping, times, [k for k, _ in columns.values()], own_stamps)
    values: dict[str, FloatArray] = {}
    saturated: npt.NDArray[np.bool_] | None = None
    for (axis, (index, unit)), column in zip(columns.items(), numbers.T, strict=True):
        given = scales.get(axis, ColumnMapping(columns=()))
        scale = 1.0
        if kind != "record":
            quantity = axis.split(".")[0]
            if given.counts_per_turn is not None:
                scale = 2 * np.pi / given.counts_per_turn
            elif quantity == "angle" and plain(unit) in ("counts", "count", "ticks", "pulses"):
                raise UsageError(f"{table.where(index)}: an angle in counts needs counts_per_turn in a mapping")
            else:
                scale = factor(quantity, unit, table.where(index))
        if given.range is not None:
            at_end = np.abs(column) >= 0.999 * given.range
            saturated = at_end if saturated is None else saturated | at_end
        values[axis] = column * scale
    return _log(name, kind, stamp_ns, values, mapping.frame_id, table.path, saturated)


def _axes(quantity: str, count: int, kind: Kind | None) -> list[str]:
    if kind == "record":
        names = [_field_name(quantity)] if count == 1 else [f"{_field_name(quantity)}_{k}" for k in range(count)]
        return names if count != 3 else [f"{_field_name(quantity)}_{axis}" for axis in "xyz"]
    sizes = {**dict.fromkeys(_VECTORS, 3), "orientation": 4}
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


def _is_number(table: Table, index: int) -> bool:
    try:
        float(table.first_row[index].replace(",", ".") or "nan")
    except (ValueError, IndexError):
        return False
    return True


def _field_name(name: str) -> str:
    """A column's name as a protobuf field: `Temperature (°C)` is temperature_c."""
    bare, unit = split_unit(name)
    text = topic_name(f"{bare} {plain(unit).replace('/', ' per ')}")
    return text if text[:1].isalpha() else f"c_{text}"


def _times(
    table: Table,
    mapping: TableMapping,
    found: Sequence[int],
    wanted: Sequence[int],
    own_stamps: StampArray | None,
) -> tuple[FloatArray, StampArray]:
    """The wanted columns and the stamps, from a column or a rate."""
    given = mapping.time
    start_ns = 0
    if given.start:
        try:
            start_ns = date_ns(given.start)
        except ValueError as error:
            raise UsageError(f"mapping: time.start {given.start!r} is neither a date nor Unix seconds") from error
    if own_stamps is not None or (given.column is None and given.rate_hz is not None):
        _, values = read_columns(table, wanted, None)
        even = even_stamps(len(values), given.rate_hz or 1.0) if own_stamps is None else own_stamps
        return values, even + start_ns
    if given.column is not None:
        time = table.column(given.column)
    elif found:
        time = found[0]
    elif is_date(table.first_row[0]):
        time = 0
    else:
        there = ", ".join(filter(None, table.names)) or "none has a name"
        raise UsageError(f"{table.path}: no column is obviously the time ({there}): give a mapping, or the rate in Hz")
    unit: str = given.unit
    if not unit:
        unit = "date" if is_date(table.first_row[time]) else table.unit(time)
    if not unit and table.names:
        unit = (_named(table.names[time], "") or ("", "", ""))[2]
    texts, values = read_columns(table, wanted, time)
    return values, stamps(table, texts, time, unit) + start_ns


def even_stamps(count: int, rate_hz: float) -> StampArray:
    """(N,) stamps of samples at a stated rate from zero, each rounded from the exact time."""
    period = Fraction(NS_PER_S) / Fraction(str(rate_hz))
    n, d = period.numerator, period.denominator
    return np.array([(2 * k * n + d) // (2 * d) for k in range(count)], np.int64)


def _log(
    name: str,
    kind: Kind,
    stamp_ns: StampArray,
    values: dict[str, FloatArray],
    frame_id: str,
    path: Path,
    saturated: npt.NDArray[np.bool_] | None,
    notes: tuple[str, ...] = (),
) -> SensorLog:
    """Samples by rising stamp, angles unwrapped, rates where there are none, clipping found."""
    backwards = int(np.sum(np.diff(stamp_ns) < 0))
    if backwards:
        notes += (f"{path}: {backwards} stamps go back; the samples are sorted by stamp",)
        order = np.argsort(stamp_ns, kind="stable")
        stamp_ns = stamp_ns[order]
        values = {axis: column[order] for axis, column in values.items()}
        saturated = None if saturated is None else saturated[order]
    named: dict[str, FloatArray] = {}
    for axis, column in values.items():
        if axis == "angle":
            named["angle_rad"] = _unwrapped(column)
        else:
            named[{"rate": "rate_rad_s", "temperature": "temperature_c"}.get(axis, axis)] = column
    if kind == "imu" and saturated is None:
        saturated = _clipped(named)
    return SensorLog(name, kind, stamp_ns, named, frame_id or name, path.name, saturated, notes)


def _unwrapped(angle: FloatArray) -> FloatArray:
    """Angles without the jumps of a full turn; NaN stays."""
    out = angle.copy()
    good = np.isfinite(angle)
    out[good] = np.unwrap(angle[good])
    return out


def _clipped(values: Mapping[str, FloatArray]) -> npt.NDArray[np.bool_] | None:
    """Where an axis stands still at its own extreme for three samples or more, as at its range's end."""
    found: npt.NDArray[np.bool_] | None = None
    for axis, column in values.items():
        least = {"linear_acceleration": 15.0, "angular_velocity": 2.0}.get(axis.split(".")[0])
        if least is None or not len(column):
            continue
        size = np.abs(column)
        top = np.nanmax(size) if np.isfinite(size).any() else 0.0
        at_end = (size == top) & (top >= least)
        three = at_end[:-2] & at_end[1:-1] & at_end[2:]
        flat = np.zeros(len(size), np.bool_)
        for shift in range(3):
            flat[shift : shift + len(three)] |= three
        found = flat if found is None else found | flat
    return found


# --- layouts that do not explain themselves ---

_Reader = Callable[[Table, str, TableMapping], SensorLog]


def _known_layout(table: Table) -> _Reader | None:
    names = [bare_name(name) for name in table.names]
    if "sampletimefine" in names and "packetcounter" in names:
        return _read_xsens_dot
    if any(re.search(r"_(cal|raw|uncal)$", name.lower()) for name in table.names):
        return _read_shimmer
    if "movesense" in str(table.path).lower() or re.search(r"_(acc|gyro|magn|imu\d)_stream$", table.path.stem.lower()):
        return _read_movesense
    if not table.names and is_date(table.first_row[0]) and len(table.first_row) in (4, 7, 10):
        return _read_axivity
    if not table.names and len(table.first_row) >= 24:
        return _read_smartwheel
    return None


def _fixed(
    table: Table,
    name: str,
    mapping: TableMapping,
    columns: Mapping[str, tuple[str | int, ...]],
    units: Mapping[str, str],
    own_stamps: StampArray | None = None,
    **time: Any,
) -> SensorLog:
    """A table whose layout is known, as if a mapping had said it; the user's own time settings come first."""
    given = {key: value for key, value in mapping.time.model_dump().items() if value not in (None, "")}
    filled = mapping.model_copy(
        update={
            "time": TimeMapping(**({} if "rate_hz" in given else time) | given),
            "columns": {q: ColumnMapping(columns=c, unit=units[q]) for q, c in columns.items()},
        }
    )
    return _read_table(table, name, filled, own_stamps)


def _read_xsens_dot(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """Xsens (Movella) DOT: SampleTimeFine counts microseconds in 32 bits, m/s^2 and deg/s; free acceleration
    has no gravity in it and is left out.
    """
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
        return _fixed(table, name, mapping, columns, units)
    time = table.column("SampleTimeFine")
    texts, _ = read_columns(table, (), time)
    ticks = stamps(table, texts, time, "us") // 1000
    turns = np.concatenate([[0], np.cumsum(np.diff(ticks) < -(1 << 31))])
    return _fixed(table, name, mapping, columns, units, (ticks + turns * (1 << 32)) * 1000)


def _read_shimmer(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """Shimmer (Consensys): DEVICE_Accel_LN_X_CAL with a row of units; of two accelerometers the wide-range
    one.
    """
    columns: dict[str, tuple[str | int, ...]] = {}
    units: dict[str, str] = {}
    wanted = (
        ("linear_acceleration", ("Accel_WR", "Accel_LN", "Accel")),
        ("angular_velocity", ("Gyro",)),
        ("magnetic_field", ("Mag", "Mag_WR")),
    )
    for quantity, stems in wanted:
        for stem in stems:
            found = [_ending(table, f"_{stem}_{axis}_CAL") for axis in "XYZ"]
            if all(k is not None for k in found) and quantity not in columns:
                indices = [k for k in found if k is not None]
                if plain(table.units[indices[0]]) in UNITS[quantity]:
                    columns[quantity] = tuple(k + 1 for k in indices)
                    units[quantity] = table.units[indices[0]]
    if not columns:
        raise UsageError(f"{table.path}: has no calibrated (CAL) accelerometer, gyroscope or magnetometer with a unit")
    time = next(
        (k for k, n in enumerate(table.names) if re.search(r"timestamp", n, re.IGNORECASE) and n.endswith("_CAL")),
        None,
    )
    if time is None:
        raise UsageError(f"{table.path}: has no Timestamp column")
    dated = is_date(table.first_row[time])
    unit = "date" if dated else plain(table.units[time])
    return _fixed(
        table,
        name,
        mapping,
        columns,
        units,
        column=time + 1,
        unit=unit if unit in (*TIME_UNITS, "date") else "",
    )


def _ending(table: Table, ending: str) -> int | None:
    return next((k for k, n in enumerate(table.names) if n.lower().endswith(ending.lower())), None)


def _read_movesense(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """Movesense: one sensor a file, told by the column or file name; milliseconds, m/s^2, deg/s, uT."""
    text = f"{table.path.stem} {' '.join(table.names)}".lower()
    for quantity, mark, unit in (
        ("angular_velocity", "gyro", "deg/s"),
        ("magnetic_field", "mag", "uT"),
        ("linear_acceleration", "acc", "m/s2"),
    ):
        if mark in text:
            time = next((k for k, n in enumerate(table.names) if "time" in n.lower()), 0)
            axes = []
            for axis in "xyz":
                found = [k for k, n in enumerate(table.names) if split_unit(n)[0].strip().lower().endswith(axis)]
                if len(found) != 1:
                    raise UsageError(f"{table.path}: no column is obviously {mark} {axis}: give a mapping")
                axes.append(found[0] + 1)
            stated = table.unit(time)
            time_unit = plain(stated) if plain(stated) in TIME_UNITS else "ms"
            return _fixed(
                table,
                name,
                mapping,
                {quantity: tuple(axes)},
                {quantity: unit},
                column=time + 1,
                unit=time_unit,
            )
    raise UsageError(f"{table.path}: neither its name nor its columns say which sensor it is: give a mapping")


def _read_axivity(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """Axivity AX3/AX6 without a header: date, acceleration in g, then angular rate in deg/s."""
    columns: dict[str, tuple[str | int, ...]] = {"linear_acceleration": (2, 3, 4)}
    if len(table.first_row) >= 7:
        columns["angular_velocity"] = (5, 6, 7)
    units = {"linear_acceleration": "g", "angular_velocity": "deg/s"}
    return _fixed(table, name, mapping, columns, units, column=1, unit="date")


def _read_smartwheel(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """SMARTwheel: column 2 counts samples, 4 is the angle in degrees, 19-21 forces in N, 22-24 moments in N
    m.
    """
    rate = mapping.time.rate_hz
    if rate is None:
        raise UsageError(f"{table.path}: a SMARTwheel file has no times: give its rate (240 and 200 Hz both occur)")
    columns: dict[str, tuple[str | int, ...]] = {"angle": (4,), "force": (19, 20, 21), "moment": (22, 23, 24)}
    units = {"angle": "deg", "force": "N", "moment": "Nm"}
    _, counter = read_columns(table, (1,), None)
    samples = counter[:, 0] - counter[0, 0]
    steps = np.diff(samples)
    if not len(steps) or steps.min() < 1 or np.any(steps != np.rint(steps)):
        return _fixed(table, name, mapping, columns, units)
    own_stamps = even_stamps(int(samples[-1]) + 1, rate)[samples.astype(int)]
    log = _fixed(table, name, mapping, columns, units, own_stamps)
    missing = int(samples[-1]) + 1 - len(samples)
    return replace(log, notes=(f"{table.path}: {missing} samples are missing",)) if missing else log


def _read_optipush(path: Path, name: str, mapping: TableMapping) -> SensorLog:
    """Optipush: tab-separated, times in column 1, forces 4-6 and moments 7-9 in the turning rim's axes, angle
    10.
    """
    table = open_table(path, delimiter=mapping.delimiter or "\t", header=False)
    columns: dict[str, tuple[str | int, ...]] = {"angle": (10,), "force": (4, 5, 6), "moment": (7, 8, 9)}
    units = {"angle": "deg", "force": "N", "moment": "Nm"}
    frame = mapping.model_copy(update={"frame_id": mapping.frame_id or f"{name}_rim"})
    return _fixed(table, name, frame, columns, units, column=1, unit="s")


def _read_c3d(path: Path, name: str) -> SensorLog:
    """Motion capture points in metres, one record a frame; NaN where a point was not seen."""
    try:
        import ezc3d  # type: ignore[import-untyped]
    except ImportError as error:
        raise UsageError(f"{path}: C3D needs ezc3d: pip install 'spheremcap[c3d]'") from error
    try:
        file = ezc3d.c3d(str(path))
    except (OSError, RuntimeError, ValueError) as error:
        raise SourceError(f"{path}: is not a readable C3D file ({' '.join(str(error).split())})") from error
    points = file["data"]["points"]
    parameters = file["parameters"]["POINT"]
    rate = float(parameters["RATE"]["value"][0])
    if not points.shape[1] or rate <= 0:
        raise SourceError(f"{path}: has no points")
    units = parameters.get("UNITS", {}).get("value") or [""]
    scale = factor("length", units[0], f"{path}: POINT:UNITS")
    residual = file["data"].get("meta_points", {}).get("residuals")
    seen = np.ones(points.shape[1:], bool) if residual is None else residual[0] >= 0
    values: dict[str, FloatArray] = {}
    for k, label in enumerate(parameters["LABELS"]["value"][: points.shape[1]]):
        for axis, letter in enumerate("xyz"):
            column = np.where(seen[k], points[axis, k] * scale, np.nan)
            values[f"{_field_name(label)}_{letter}_m"] = column.astype(np.float64)
    first = int(file["header"]["points"]["first_frame"])
    stamp_ns = even_stamps(first + points.shape[2], rate)[first:]
    return _log(name, "record", stamp_ns, values, name, path, None)


def _read_gopro(path: Path, name: str) -> list[SensorLog]:
    """GoPro telemetry (GPMF): accelerometer and gyroscope on the video's own time, from zero."""
    logs = []
    for quantity, stamp_ns, values in read_gpmf(path):
        columns = {f"{quantity}.{axis}": values[:, k] for k, axis in enumerate("xyz")}
        own = f"{name}_{'acc' if quantity == 'linear_acceleration' else 'gyro'}"
        logs.append(_log(own, "imu", stamp_ns, columns, name, path, None))
    return logs
