"""Annex B, how viewers take H.264 and H.265: NAL units behind start codes, walked here and nowhere else."""

from collections.abc import Iterator
from typing import ClassVar, TypeAlias

import av
from av.bitstream import BitStreamFilterContext

from spheremcap.core.frame import EncodedPicture

Packet: TypeAlias = "av.Packet[av.VideoStream]"

CODECS = {"h264": ("h264_mp4toannexb", "h264"), "hevc": ("hevc_mp4toannexb", "h265")}
"""FFmpeg's codec to its bitstream filter and to the name viewers know."""


def units(data: bytes, format_: str) -> Iterator[tuple[int, bytes]]:
    """The NAL units of an Annex B byte stream (h264 or h265) as (type, bytes without start code).

    Zeros before the next start code belong to it or are padding; what is nothing else is no unit.
    """
    at = data.find(b"\0\0\1")
    while at >= 0:
        after = data.find(b"\0\0\1", at + 3)
        unit = data[at + 3 : after if after >= 0 else len(data)].rstrip(b"\0")
        if unit:
            yield (unit[0] & 31 if format_ == "h264" else unit[0] >> 1 & 63), unit
        at = after


def is_key_picture(data: bytes, format_: str) -> bool:
    """Whether an access unit (h264, h265: Annex B; av1; vp9) can be decoded without those before it."""
    if format_ in ("h264", "h265"):
        for kind, _ in units(data, format_):
            if kind == 5 if format_ == "h264" else 16 <= kind <= 21:
                return True
            if kind == 1 if format_ == "h264" else kind < 16:
                return False
        return False
    if format_ == "vp9":
        return bool(data) and not data[0] & 0x0C
    return any(data[at] >> 3 & 15 == 1 for at in (0, 2) if at < len(data))  # AV1: a sequence header


class AnnexB:
    """Turns a file's packets into Annex B messages whose key frames carry their parameter sets."""

    _SETS: ClassVar = {"h264": (7, 8), "hevc": (32, 33, 34)}
    _KEYS: ClassVar = {"h264": (5,), "hevc": tuple(range(16, 22))}
    _DELIMITER: ClassVar = {"h264": 9, "hevc": 35}

    def __init__(self, codec: str, stream: av.VideoStream) -> None:
        filter_name, self.format = CODECS[codec]
        self._codec = codec
        self._filter = BitStreamFilterContext(filter_name, stream)
        self._known: dict[int, bytes] = {}
        extradata = stream.codec_context.extradata or b""
        if extradata.startswith((b"\0\0\1", b"\0\0\0\1")):
            self._remember(list(units(extradata, self.format)))

    @property
    def complete(self) -> bool:
        """Whether all kinds of parameter sets were seen."""
        return len(self._known) == len(self._SETS[self._codec])

    def message(self, packet: Packet) -> EncodedPicture:
        """The packet as one Annex B access unit. Takes packets in stream order, and empties them."""
        may_be_key = packet.is_keyframe
        data = b"".join(bytes(part) for part in self._filter.filter(packet))
        if not may_be_key:
            return EncodedPicture(data, self.format, False)
        found = list(units(data, self.format))
        kinds = [kind for kind, _ in found]
        self._remember(found)
        key = any(kind in self._KEYS[self._codec] for kind in kinds)
        missing = [self._known[k] for k in self._SETS[self._codec] if k not in kinds and k in self._known]
        if key and missing:
            first = 1 if kinds[0] == self._DELIMITER[self._codec] else 0
            parts = [unit for _, unit in found]
            parts[first:first] = missing
            data = b"".join(b"\0\0\0\1" + part for part in parts)
        return EncodedPicture(data, self.format, key)

    def _remember(self, found: list[tuple[int, bytes]]) -> None:
        for kind in self._SETS[self._codec]:
            same_kind = [unit for k, unit in found if k == kind]
            if same_kind:
                self._known[kind] = b"\0\0\0\1".join(same_kind)
