"""C3D: points in mm with a residual each, events, and the sensors that keep the points' time.

ezc3d lays the file out. What readers do not agree on is then written so that all of them read the same: see `_mark`.
"""

import importlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.stroke import StrokeEvent
from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.errors import OutputError, UsageError
from spheremcap.io.export.even import EvenPoints
from spheremcap.io.output import VERSION
from spheremcap.io.recording import Sensor, match

FloatArray = npt.NDArray[np.float64]

MOST_FRAMES = 65_534
"""A count has 16 bits, and its largest number stands for "more" to some readers. There are ways to say how many more,
but of such a file ezc3d 1.7 reads the first 65,535 frames and says nothing.
"""
_MOST_VALUES = 255  # in one parameter; further ones go into NAME2, NAME3, ...
_MOST_UNITS = 127  # of a residual, which is a signed byte to some readers
_BLOCK = 512  # bytes
_SCALE_AT, _DATA_BLOCK_AT = 12, 16  # bytes of the header

_UNITS = {
    "angular_velocity": "rad/s", "linear_acceleration": "m/s^2", "magnetic_field": "T", "temperature_c": "degC",
    "angle_rad": "rad", "rate_rad_s": "rad/s", "force_n": "N", "moment_nm": "Nm",
}  # fmt: skip


def library() -> Any:
    """ezc3d. Raises UsageError where it is not installed."""
    try:
        return importlib.import_module("ezc3d")
    except ImportError:
        raise UsageError("C3D needs ezc3d: pip install 'spheremcap[c3d]', or export .trc, .csv or .parquet") from None


def write(
    path: Path,
    points: EvenPoints,
    events: Sequence[StrokeEvent],
    sensors: Mapping[str, Sensor],
    fill_ms: float | None = None,
) -> tuple[str, ...]:
    """Write the points, the events in their time and the sensors that fit; notes are for the user.

    Residuals are -1 where a point was not measured (with coordinates 0), 0 where it was filled, which is the format's
    own mark for what is no measurement, and else its standard deviation in mm, in whole POINT:SCALE, at least one.
    """
    mm, sd_mm = 1000 * points.xyz_m, 1000 * points.sd_m
    scale = np.float32(max(np.nanmax(np.abs(mm)) / 32_000, np.nanmax(sd_mm) / _MOST_UNITS))
    analogs, notes = _analogs(points, sensors)
    file = library().c3d()
    point, analog = file["parameters"]["POINT"], file["parameters"]["ANALOG"]
    point["__METADATA__"]["DESCRIPTION"] = points.axes.text
    point["LABELS"]["value"] = list(points.markers)
    point["UNITS"]["value"] = ["mm"]
    point["RATE"]["value"] = [_rate(points.rate_hz, analogs.each)]
    point["SCALE"]["value"] = [-float(scale)]
    file.add_parameter("POINT", "X_SCREEN", points.axes.right)
    file.add_parameter("POINT", "Y_SCREEN", points.axes.up)
    file["data"]["points"] = np.nan_to_num(mm).T
    file["data"]["meta_points"] = {"residuals": np.where(np.isnan(mm[:, :, 0]), -1.0, 0.0).T[None]}
    if analogs.labels:
        analog["LABELS"]["value"] = list(analogs.labels)
        analog["UNITS"]["value"] = list(analogs.units)
        analog["DESCRIPTIONS"]["value"] = list(analogs.descriptions)
        analog["RATE"]["value"] = [analogs.each * point["RATE"]["value"][0]]
        file["data"]["analogs"] = analogs.values[None]
    notes += _add_events(file, points, events)
    file.add_parameter("MANUFACTURER", "SOFTWARE", "spheremcap")
    file.add_parameter("MANUFACTURER", "VERSION", VERSION)
    file.add_parameter("SPHEREMCAP", "AXES", points.axes.text)
    file.add_parameter("SPHEREMCAP", "START", format_time(points.start_ns), "UTC of the first frame, where it is known")
    file.add_parameter("SPHEREMCAP", "RESIDUALS", "-1 not measured; 0 filled; else standard deviation in mm")
    file.add_parameter(
        "SPHEREMCAP", "FILL_MS", float(fill_ms or 0), "gaps up to this are filled from smoothed positions"
    )
    data = _laid_out(file)
    start = _BLOCK * (int(data[_DATA_BLOCK_AT : _DATA_BLOCK_AT + 2].view("<u2")[0]) - 1)
    width = 4 * len(points.markers) + analogs.each * len(analogs.labels)
    if len(data) < start + 4 * width * len(points):
        raise OutputError(f"{path}: ezc3d could not write all of it: free some space for temporary files and run again")
    data[_SCALE_AT : _SCALE_AT + 4].view("<f4")[0] = -scale
    words = data[start : start + 4 * width * len(points)].view("<f4").reshape(len(points), width)
    words[:, 3 : 4 * len(points.markers) : 4] = _mark(points, sd_mm, float(scale))
    path.write_bytes(data.tobytes())
    return notes


def _rate(rate_hz: float, each: int) -> float:
    """The rate as a float of 32 bits, and one of which `each` times it is exact: readers divide one by the other."""
    mantissa, exponent = np.frexp(rate_hz)
    bits = 24 - (each // (each & -each)).bit_length() if each > 1 else 24
    return float(np.ldexp(np.rint(np.ldexp(mantissa, bits)), exponent - bits))


def _mark(points: EvenPoints, sd_mm: FloatArray, scale: float) -> FloatArray:
    """The fourth number of each point (N, M): -1, 0, or the residual in units of `scale`, in two bytes.

    The format has the residual in the lower byte and a mask of cameras in the upper one; ezc3d has them the other way
    round. So both bytes hold the residual. A mask means nothing with one camera.
    """
    units = np.clip(np.rint(np.nan_to_num(sd_mm) / scale), 1, _MOST_UNITS)
    return np.where(points.measured, 257 * units, np.where(points.filled, 0, -1))


def _laid_out(file: Any) -> npt.NDArray[np.uint8]:
    """The bytes of a file of ezc3d's, which it writes under a name that ends in .c3d."""
    with TemporaryDirectory(prefix="spheremcap-") as folder:
        whole = Path(folder) / "points.c3d"
        file.write(str(whole))
        return np.fromfile(whole, np.uint8)


# --- events ---


def _add_events(file: Any, points: EvenPoints, events: Sequence[StrokeEvent]) -> tuple[str, ...]:
    inside = sorted((e for e in events if points.start_ns <= e.stamp_ns < points.end_ns), key=lambda e: e.stamp_ns)
    if not inside:
        return ()
    file.add_parameter("EVENT", "USED", len(inside))
    for first in range(0, len(inside), _MOST_VALUES):
        some = inside[first : first + _MOST_VALUES]
        number = "" if not first else str(first // _MOST_VALUES + 1)
        seconds = [(event.stamp_ns - points.start_ns) / NS_PER_S for event in some]
        file.add_parameter("EVENT", f"TIMES{number}", np.array([[s // 60, s % 60] for s in seconds]).T)
        file.add_parameter("EVENT", f"LABELS{number}", [event.kind.value for event in some])
        file.add_parameter("EVENT", f"CONTEXTS{number}", [event.side.capitalize() for event in some])
    if len(inside) <= _MOST_VALUES:
        return ()
    return (
        f"{len(inside)} events: those after the first {_MOST_VALUES} are in EVENT:LABELS2, TIMES2 and so on, where not "
        "every program looks; shorter pieces (--from, --to) have theirs in one",
    )


# --- sensors as analog channels ---


@dataclass(frozen=True)
class _Analogs:
    """K channels of `each` samples a frame, `values` (K, N * each)."""

    each: int
    labels: tuple[str, ...]
    units: tuple[str, ...]
    descriptions: tuple[str, ...]
    values: FloatArray


@dataclass(frozen=True)
class _Fit:
    """A sensor of which every place of `each` a frame has one sample, and no sample is left over."""

    sensor: Sensor
    each: int
    index: npt.NDArray[np.int64]
    furthest_ms: float


def _analogs(points: EvenPoints, sensors: Mapping[str, Sensor]) -> tuple[_Analogs, tuple[str, ...]]:
    """The sensors that fit, and lines that name the others. C3D has one rate for all channels, a whole multiple of the
    points', and no way to say that a sample is missing.
    """
    out: dict[str, str] = {}
    fits: dict[str, _Fit] = {}
    for name, sensor in sorted(sensors.items()):
        found = _fit(points, sensor)
        if isinstance(found, _Fit):
            fits[name] = found
        else:
            out[name] = found
    counts = Counter(fit.each for fit in fits.values())
    each = max(counts, key=lambda m: (counts[m], m), default=0)
    labels, units, descriptions, values, placed = [], [], [], [], []
    for name, fit in fits.items():
        if fit.each != each:
            out[name] = f"has {fit.each} samples a frame, others have {each}, and a C3D has one rate for all"
            continue
        placed.append(f"{name}: {each} samples a frame, each at most {fit.furthest_ms:.2f} ms off its place in the C3D")
        for path, column in fit.sensor.values.items():
            taken = column[fit.index]
            if np.isfinite(taken).all():
                labels.append(f"{name}.{path}")
                units.append(_UNITS.get(path.partition(".")[0], ""))
                descriptions.append(f"samples at most {fit.furthest_ms:.2f} ms off")
                values.append(taken)
            elif np.isfinite(taken).any():
                out[f"{name}.{path}"] = "is not in every sample"
    notes = [
        f"{name} is left out of the C3D: it {why}; the recording has it (docs/files.md)" for name, why in out.items()
    ]
    stacked = np.stack(values) if values else np.zeros((0, 0))
    if not values:
        return _Analogs(0, (), (), (), stacked), tuple(notes)
    return _Analogs(each, tuple(labels), tuple(units), tuple(descriptions), stacked), (*placed, *notes)


def _fit(points: EvenPoints, sensor: Sensor) -> _Fit | str:
    """How a sensor fits, or why it does not, as "it ..." would go on."""
    span_ns = int(sensor.stamp_ns[-1] - sensor.stamp_ns[0])
    if not span_ns:
        return "has one sample"
    rate_hz = (len(sensor) - 1) * NS_PER_S / span_ns
    each = max(1, round(rate_hz / points.rate_hz))
    step_ns = points.period_ns / each
    places = points.start_ns + np.rint(step_ns * np.arange(each * len(points))).astype(np.int64)
    index = match(sensor.stamp_ns, places, int(step_ns / 2))
    empty = np.count_nonzero(index < 0)
    inside = (sensor.stamp_ns >= places[0] - step_ns / 2) & (sensor.stamp_ns < places[-1] + step_ns / 2)
    over = np.count_nonzero(inside) - (len(index) - empty)
    if empty or over:
        return (
            f"has {rate_hz:.2f} Hz: of {len(places)} places at {each} x {points.rate_hz:.3f} Hz {empty} would have no "
            f"sample, and {over} samples no place"
        )
    return _Fit(sensor, each, index, float(np.abs(sensor.stamp_ns[index] - places).max()) / 1e6)
