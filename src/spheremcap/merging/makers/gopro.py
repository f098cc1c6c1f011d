"""GoPro telemetry (GPMF): accelerometer and gyroscope from the data track of a camera's own file.

GPMF is key-length-value, big-endian: a four-letter key, a type letter, the size of one structure, their
number, the data padded to four bytes; type 0 nests. Cameras before the HERO5 have none.
"""

import os
import struct
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error
import numpy as np
import numpy.typing as npt

from spheremcap.core.time import ticks_to_ns
from spheremcap.errors import SourceError
from spheremcap.merging.log import SensorLog, sensor_log
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.times import Timing

_NUMBERS = {
    "b": "i1",
    "B": "u1",
    "s": ">i2",
    "S": ">u2",
    "l": ">i4",
    "L": ">u4",
    "f": ">f4",
    "d": ">f8",
    "j": ">i8",
}
_QUANTITIES = {"ACCL": "linear_acceleration", "GYRO": "angular_velocity"}
_FIRST_ORDER = "ZXY"
"""The order of the axes where a stream does not state it (HERO5 to HERO7)."""

_DEEPEST = 16
"""Cameras nest three deep."""

FloatArray = npt.NDArray[np.float64]
StampArray = npt.NDArray[np.int64]


def matches(path: Path) -> bool:
    """By the ending."""
    return path.suffix.lower() in (".mp4", ".mov", ".360")


def read(path: Path, name: str, mapping: TableMapping) -> list[SensorLog]:
    """One log for each of accelerometer and gyroscope, on the video's own time, from zero."""
    logs = []
    timing = Timing("the telemetry's place in the video", "start")
    for quantity, stamp_ns, values in read_gpmf(path):
        columns = {f"{quantity}.{axis}": values[:, k] for k, axis in enumerate("xyz")}
        own = f"{name}_{'acc' if quantity == 'linear_acceleration' else 'gyro'}"
        logs.append(sensor_log(own, "imu", stamp_ns, columns, timing, path, frame_id=name))
    return logs


def read_gpmf(path: str | os.PathLike[str]) -> list[tuple[str, StampArray, FloatArray]]:
    """(quantity, stamps (N,) from the video's zero, values (N, 3) in m/s^2 or rad/s in the camera's x, y, z).

    A payload's samples are spread evenly over its packet's time, as the camera wrote them. Raises SourceError
    when the file has no telemetry.
    """
    collected: dict[str, list[tuple[StampArray, FloatArray]]] = {}
    try:
        with av.open(str(path)) as container:
            streams = [s for s in container.streams if s.type == "data" and _is_gpmf(s)]
            if not streams:
                raise SourceError(f"{path}: has no GoPro telemetry track (GPMF)")
            for packet in container.demux(streams[0]):
                if packet.size and packet.pts is not None and packet.time_base is not None:
                    _collect(bytes(packet), packet.pts, packet.duration or 0, packet.time_base, collected)
    except (av.error.FFmpegError, OSError) as error:
        raise SourceError(f"{path}: cannot be read ({' '.join(str(error).split())})") from error
    if not collected:
        raise SourceError(f"{path}: its telemetry has neither accelerometer nor gyroscope")
    return [
        (quantity, np.concatenate([s for s, _ in parts]), np.concatenate([v for _, v in parts]))
        for quantity, parts in sorted(collected.items(), reverse=True)
    ]


def _is_gpmf(stream: Any) -> bool:
    return "GoPro MET" in stream.metadata.get("handler_name", "")


def _collect(
    payload: bytes,
    pts: int,
    duration: int,
    time_base: Fraction,
    collected: dict[str, list[tuple[StampArray, FloatArray]]],
) -> None:
    for quantity, values in payload_samples(payload):
        count = len(values)
        stamps = [ticks_to_ns(pts * count + k * duration, time_base / count) for k in range(count)]
        collected.setdefault(quantity, []).append((np.array(stamps, np.int64), values))


def payload_samples(payload: bytes, depth: int = 0) -> Iterator[tuple[str, FloatArray]]:
    """(quantity, values (N, 3) in SI, x, y, z) of every accelerometer and gyroscope stream in one payload.

    A stream whose scale or order of axes makes no sense is left out; a value that is not finite is NaN.
    """
    for key, kind, _, data in _items(payload):
        if kind == "\0" and key == "STRM":
            scale: FloatArray | None = np.ones(1)
            order = _FIRST_ORDER
            for inner, letter, size, body in _items(data):
                if inner == "SCAL":
                    scale = _numbers(body, letter)
                elif inner == "ORIN":
                    order = body.decode("ascii", "replace")[:3]
                elif inner in _QUANTITIES and letter in _NUMBERS:
                    raw = _numbers(body, letter)
                    three = size == 3 * np.dtype(_NUMBERS[letter]).itemsize
                    usable = scale is not None and len(scale) in (1, 3) and bool(np.all(scale != 0))
                    if (
                        raw is not None
                        and scale is not None
                        and three
                        and usable
                        and sorted(order.upper()) == list("XYZ")
                    ):
                        values = _in_axes(raw.reshape(-1, 3) / scale, order)
                        yield _QUANTITIES[inner], np.where(np.isfinite(values), values, np.nan)
        elif kind == "\0" and depth < _DEEPEST:
            yield from payload_samples(data, depth + 1)


def _numbers(body: bytes, letter: str) -> FloatArray | None:
    """The numbers of a type letter; None when there are none, or not a whole number of them."""
    if letter not in _NUMBERS or not body or len(body) % np.dtype(_NUMBERS[letter]).itemsize:
        return None
    with np.errstate(all="ignore"):
        return np.frombuffer(body, _NUMBERS[letter]).astype(np.float64)


def _in_axes(raw: FloatArray, order: str) -> FloatArray:
    """Columns as stored to x, y, z; a small letter is an axis that points the other way."""
    out = np.empty_like(raw)
    for k, letter in enumerate(order):
        out[:, "XYZ".index(letter.upper())] = raw[:, k] if letter.isupper() else -raw[:, k]
    return out


def _items(data: bytes) -> Iterator[tuple[str, str, int, bytes]]:
    """(key, type letter, structure size, data) one after another, up to whatever is cut off."""
    position = 0
    while position + 8 <= len(data):
        key, kind, size, repeat = struct.unpack_from(">4scBH", data, position)
        length = size * repeat
        if key == b"\0\0\0\0" or position + 8 + length > len(data):
            return
        yield (
            key.decode("ascii", "replace"),
            kind.decode("latin-1"),
            size,
            data[position + 8 : position + 8 + length],
        )
        position += 8 + length + -length % 4
