"""C3D, of any motion capture system: points in metres, one record a frame; NaN where a point was not seen."""

from pathlib import Path

import numpy as np

from spheremcap.errors import SourceError, UsageError
from spheremcap.merging.columns import even_stamps
from spheremcap.merging.header import field_name
from spheremcap.merging.log import FloatArray, SensorLog, sensor_log
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.times import Timing
from spheremcap.merging.units import factor


def matches(path: Path) -> bool:
    """By the ending."""
    return path.suffix.lower() == ".c3d"


def read(path: Path, name: str, mapping: TableMapping) -> list[SensorLog]:
    """Times come from the file's own rate and the number of its first frame."""
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
    rate_hz = float(parameters["RATE"]["value"][0])
    if not points.shape[1] or not 0 < rate_hz < 1e6:
        raise SourceError(f"{path}: has no points")
    units = parameters.get("UNITS", {}).get("value") or [""]
    scale = factor("length", units[0], f"{path}: POINT:UNITS")
    residual = file["data"].get("meta_points", {}).get("residuals")
    seen = np.ones(points.shape[1:], bool) if residual is None else residual[0] >= 0
    values: dict[str, FloatArray] = {}
    for k, label in enumerate(parameters["LABELS"]["value"][: points.shape[1]]):
        for axis, letter in enumerate("xyz"):
            column = np.where(seen[k], points[axis, k] * scale, np.nan)
            own = f"{field_name(label) or f'point_{k + 1}'}_{letter}_m"
            values[own if own not in values else f"point_{k + 1}_{own}"] = column.astype(np.float64)
    first = int(file["header"]["points"]["first_frame"])
    stamp_ns = even_stamps(first + points.shape[2], rate_hz)[first:]
    timing = Timing(f"frame numbers at {rate_hz:g} Hz", "start")
    return [sensor_log(name, "record", stamp_ns, values, timing, path)]
