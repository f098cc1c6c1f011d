"""The few ROS messages that carry pictures and calibrations, read straight from CDR (ROS 2) or ROS 1 bytes.

The field order comes from the schema that is stored with the channel (foxglove_msgs have gained fields over
time); an IDL schema, which is not parsed, falls back on the layout its message has today.
"""

import re
import struct
from typing import Any

import numpy as np

Layout = tuple[tuple[str, str], ...]
"""(type, lower-case name) of each field of a message, in order."""

_HEADER: Layout = (("Header", "header"),)
_CALIBRATION: Layout = (
    ("string", "distortion_model"),
    ("float64[]", "d"),
    ("float64[9]", "k"),
    ("float64[9]", "r"),
    ("float64[12]", "p"),
)
_SIZE: Layout = (("uint32", "height"), ("uint32", "width"))
_FRAME: Layout = (("time", "timestamp"), ("string", "frame_id"))
_TODAY: dict[str, Layout] = {
    "sensor_msgs/Image": (
        *_HEADER,
        *_SIZE,
        ("string", "encoding"),
        ("uint8", "is_bigendian"),
        ("uint32", "step"),
        ("uint8[]", "data"),
    ),
    "sensor_msgs/CompressedImage": (*_HEADER, ("string", "format"), ("uint8[]", "data")),
    "sensor_msgs/CameraInfo": (*_HEADER, *_SIZE, *_CALIBRATION),
    "foxglove_msgs/CompressedImage": (*_FRAME, ("uint8[]", "data"), ("string", "format")),
    "foxglove_msgs/CompressedVideo": (*_FRAME, ("uint8[]", "data"), ("string", "format")),
    "foxglove_msgs/RawImage": (
        *_FRAME,
        ("uint32", "width"),
        ("uint32", "height"),
        ("string", "encoding"),
        ("uint32", "step"),
        ("uint8[]", "data"),
    ),
    "foxglove_msgs/CameraCalibration": (
        *_FRAME,
        ("uint32", "width"),
        ("uint32", "height"),
        *_CALIBRATION,
    ),
}
KNOWN = frozenset(_TODAY)
"""The messages that are read here, as package/Message."""
_TIMES = {"time", "builtin_interfaces/Time", "builtin_interfaces/msg/Time"}
_HEADERS = {"Header", "std_msgs/Header", "std_msgs/msg/Header"}
_NUMBERS = {
    "bool": "B", "byte": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip
_FIELD = re.compile(r"^([\w/]+(?:<=\d+)?(?:\[[<=\d]*\])?)\s+(\w+)\s*(?!\s*=)(.*)$")


def short_name(schema_name: str) -> str:
    """`package/Message` of a ROS 1 or ROS 2 schema name."""
    parts = schema_name.replace("::", "/").split("/")
    return f"{parts[0]}/{parts[-1]}"


def layout_of(schema_name: str, encoding: str, text: str) -> Layout:
    """The fields of a message by its stored definition (ros1msg or ros2msg), or as it is known today."""
    if encoding not in ("ros1msg", "ros2msg"):
        return _today(schema_name)
    fields = []
    for line in re.split(r"^={3,}\s*$", text, maxsplit=1, flags=re.MULTILINE)[0].splitlines():
        line = line.split("#", 1)[0].strip()
        match = _FIELD.match(line)
        if match and "=" not in match[3]:
            fields.append((match[1], match[2].lower()))
    return tuple(fields) or _today(schema_name)


def _today(schema_name: str) -> Layout:
    """Raises ValueError for a message that is not known here."""
    name = short_name(schema_name)
    if name not in _TODAY:
        raise ValueError(f"the message {name} is not known here, and its definition is missing")
    return _TODAY[name]


def read_message(data: bytes, layout: Layout, ros2: bool) -> dict[str, Any]:
    """The fields up to the first of a type not known here; times as int ns, a header as stamp_ns and
    frame_id.

    Raises ValueError when the bytes end early.
    """
    cursor = _Cursor(data, ros2)
    found: dict[str, Any] = {}
    try:
        for kind, name in layout:
            if kind in _HEADERS:
                if not ros2:
                    cursor.number("I")
                found["stamp_ns"] = cursor.time()
                found["frame_id"] = cursor.text()
            elif kind in _TIMES:
                found["stamp_ns" if name in ("timestamp", "stamp") else name] = cursor.time()
            elif kind.startswith("string") and "[" not in kind:
                found[name] = cursor.text()
            elif "[" in kind and (code := _NUMBERS.get(kind.split("[")[0])) is not None:
                count = kind[kind.index("[") + 1 : -1]
                fixed = count.isdigit()
                found[name] = cursor.array(code, int(count) if fixed else None)
            elif kind in _NUMBERS:
                found[name] = cursor.number(_NUMBERS[kind])
            else:
                break
    except (struct.error, IndexError) as error:
        raise ValueError(f"ends after {len(data)} bytes, inside its fields") from error
    return found


class _Cursor:
    """Reads values one after another; CDR aligns them to their size, ROS 1 does not."""

    def __init__(self, data: bytes, cdr: bool) -> None:
        self._data = memoryview(data)
        self._at = 0
        self._largest = 1
        self._order = "<"
        if cdr:
            if len(data) < 4:
                raise ValueError(f"{len(data)} bytes are no CDR message")
            kind = struct.unpack_from(">H", data, 0)[0]
            if kind not in (0, 1, 6, 7):  # plain CDR, versions 1 and 2, big- and little-endian
                raise ValueError(f"CDR representation {kind:#06x} is not supported (plain CDR is)")
            self._order = "<" if kind & 1 else ">"
            self._largest = 4 if kind & 6 else 8
            self._data = self._data[4:]

    def number(self, code: str) -> Any:
        self._align(code)
        value = struct.unpack_from(self._order + code, self._data, self._at)[0]
        self._at += struct.calcsize(code)
        return value

    def time(self) -> int:
        seconds, nanos = self.number("I"), self.number("I")
        return int(seconds) * 1_000_000_000 + int(nanos)

    def text(self) -> str:
        length = self.number("I")
        return bytes(self._take(length)).rstrip(b"\0").decode("utf-8", "replace")

    def array(self, code: str, count: int | None) -> Any:
        if count is None:
            count = self.number("I")
        if count:
            self._align(code)
        taken = self._take(count * struct.calcsize(code))
        if code == "B":
            return bytes(taken)
        return np.frombuffer(taken, self._order + code).astype(np.float64)

    def _align(self, code: str) -> None:
        size = min(struct.calcsize(code), self._largest)
        self._at += -self._at % size

    def _take(self, length: int) -> memoryview:
        if self._at + length > len(self._data):
            raise IndexError
        self._at += length
        return self._data[self._at - length : self._at]
