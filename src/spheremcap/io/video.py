"""Video files as frames: exact stamps, planes as decoded, and the stream's own packets where those will do.

Stamps are `start + pts * time_base`, exact to the nanosecond. The container's own stamps count as they are (a
first picture at 0.5 s is at start + 0.5 s) with two exceptions: where the container's clock starts anywhere
(MPEG-TS and MPEG-PS) or below zero, the first picture displayed is at `start`. A stated rate is used only
where there are no stamps at all (a bare H.264 stream), and that is counted.

A picture whose stamp does not come after the one before it is put half a picture later, and counted; where
the clock falls back by more than a second it was restarted, and everything after is moved on to follow.

Colour is what the stream says. Where it says nothing: BT.709 from 720 rows on, else BT.601, limited range, as
players do; gray is full range, as FFmpeg has it. Rows and columns are those of the picture as displayed.
"""

import itertools
import os
import re
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, Literal, TypeAlias, cast

import av
import av.container
import av.filter
import av.logging
import numpy as np
import numpy.typing as npt
from av.bitstream import BitStreamFilterContext
from av.stream import Discard, Disposition
from av.video.format import VideoFormat
from av.video.reformatter import VideoReformatter

from spheremcap.core.frame import BgrFrame, EncodedPicture, Frame, YuvFrame, yuv_to_bgr_matrix
from spheremcap.core.time import NS_PER_S, parse_time_ns, ticks_to_ns
from spheremcap.errors import SourceError

av.logging.set_level(None)  # FFmpeg's own log says nothing a user can use; errors are told once, in one line.

Plane = npt.NDArray[np.uint8]
StartTimeSource = Literal["start-time", "creation-time", "zero"]

_COVERS = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image
_FREE_RUNNING_CLOCKS = ("mpegts", "mpeg")
_TS_PACKET_BYTES = (188, 192, 204)
_ANNEX_B = {"h264": ("h264_mp4toannexb", "h264"), "hevc": ("hevc_mp4toannexb", "h265")}
"""Codec to its bitstream filter and to the name viewers know."""
_INVISIBLE_PICTURES = ("vp8",)
"""Codecs with packets that show no picture, so that packets and pictures cannot be counted off."""
_MATRICES = {1: "bt709", 4: "bt601", 5: "bt601", 6: "bt601", 7: "bt709", 9: "bt2020", 10: "bt2020"}
"""FFmpeg's AVColorSpace to the matrix; SMPTE 240M (7) is nearest to BT.709."""
_FULL_RANGE, _LIMITED_RANGE = 2, 1  # AVColorRange
_SUBSAMPLING = {(4, 4): "410", (4, 1): "411", (2, 2): "420", (2, 1): "422", (1, 2): "440", (1, 1): "444"}
_SEMI_PLANAR = {"nv12": 0, "nv21": 1, "nv16": 0, "nv24": 0, "nv42": 1}
"""8-bit formats with U and V in one plane, and which of the two is U."""


@dataclass
class Losses:
    """What could not be had from a video, counted as its frames are read; truthy when anything was lost."""

    undecodable: int = 0
    """Packets that never became a picture."""
    damaged: int = 0
    """Pictures kept although the decoder had to patch them."""
    restamped: int = 0
    """Pictures without a time stamp of their own, or with one that did not come after the picture before."""
    stopped: str | None = None
    """Why reading ended before the video's end, in one line; None when it did not."""

    def __bool__(self) -> bool:
        return bool(self.undecodable or self.damaged or self.stopped)

    def lines(self) -> list[str]:
        """One line per kind of loss, for a person."""
        kinds = (
            (self.undecodable, "could not be decoded: missing"),
            (self.damaged, "damaged: kept as the decoder patched them"),
            (self.restamped, "without a usable time stamp: given one from their neighbours"),
        )
        lines = [f"{count} picture{'s' * (count != 1)} {what}" for count, what in kinds if count]
        if self.stopped:
            lines.append(self.stopped)
        return lines


class DecodedFrame(YuvFrame):
    """A YuvFrame that also knows its colour tags: `matrix` (bt601, bt709, bt2020) and `full_range`."""

    matrix: str
    full_range: bool


_Packet: TypeAlias = "av.Packet[av.VideoStream]"
_Decoded: TypeAlias = "tuple[av.VideoFrame, _Packet | None]"
"""A picture and the packet it came from (None when its time stamp does not say which)."""


class VideoSource:
    """A video file as frames in presentation order; also a context manager.

    Parameters
    ----------
    path: any file FFmpeg can read; the largest video stream that is not a cover picture is taken.
    start_time_ns: Unix time of the container's time zero; else its creation time is used, else 0.
    packets: look whether the packets can be handed on as they are, and attach them; reads the file once more.

    Raises SourceError when there is no picture to be had from the file at all.
    """

    def __init__(self, path: str | os.PathLike[str], *, start_time_ns: int | None = None, packets: bool = True) -> None:
        self.path = Path(path)
        self.lost = Losses()
        self._packets_wanted = packets
        self._container, self._stream = _open(self.path)
        stream = self._stream
        self.codec: str = stream.codec_context.codec.canonical_name
        self.stated_rate: Fraction | None = stream.average_rate or None
        """What the file says its rate is: for people only, dt comes from stamps."""
        self.frame_count_hint: int | None = stream.frames or None
        self.duration_hint_s = _duration_s(self._container, stream)
        self.start_time_ns, self.start_time_source = _start(self._container, stream, start_time_ns)

        self._reformatter = VideoReformatter()
        self._pictures = self._decode()
        try:
            first = next(self._pictures)
        except StopIteration:
            self.close()
            why = self.lost.stopped or f"{self.lost.undecodable} packets, none of which is a picture"
            raise SourceError(f"{self.path}: no picture could be decoded ({self.codec}; {why})") from None
        self._peeked: _Decoded | None = first
        picture = first[0]
        self.pixel_format: str = picture.format.name
        self.interlaced = picture.interlaced_frame
        self._coded_size = (picture.width, picture.height)
        self._orientation = _orientation(picture)
        self.rotation_deg = self._orientation.clockwise_deg
        """Clockwise turn, 0, 90, 180 or 270, that the stored picture needs and every Frame has had."""
        flip = self._orientation.transposed
        self.width_px, self.height_px = self._coded_size[::-1] if flip else self._coded_size
        aspect = float(stream.sample_aspect_ratio or 1)
        self.pixel_aspect = 1 / aspect if flip else aspect
        """How much wider than high a pixel of a Frame is, as the stream says; 1 where it says nothing."""
        self._siting = _chroma_siting(picture)
        self._default_matrix = "bt709" if max(picture.height, self.height_px) >= 720 else "bt601"
        pts = picture.pts or 0
        free = self._container.format.name in _FREE_RUNNING_CLOCKS
        self._origin_ticks = pts if free or pts < 0 else 0

    def __enter__(self) -> "VideoSource":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; frames already given stay valid."""
        self._container.close()

    def frames(self) -> Generator[Frame, None, None]:
        """All frames in presentation order, index from 0, each decoded once; `lost` is complete at the end.

        Frames are DecodedFrame (planes as decoded) or, from RGB and palette video, BgrFrame. A frame holds
        its picture's memory, so do not keep all of them. A second call reads the file again from the start.
        """
        if self._peeked is None:
            self._container.close()
            self._container, self._stream = _open(self.path)
            pictures: Iterator[_Decoded] = self._decode()
        else:
            pictures = itertools.chain([self._peeked], self._pictures)
            self._peeked = None
        annex_b = _AnnexB(self.codec, self._stream) if self.passthrough_reason is None else None
        clock = _Clock(self._stream, self._origin_ticks)
        for index, (picture, packet) in enumerate(pictures):
            if (picture.width, picture.height) != self._coded_size:
                was, now = self._coded_size, (picture.width, picture.height)
                self.lost.stopped = (
                    f"{self.path}: the picture size changes from {was[0]}x{was[1]} to {now[0]}x{now[1]} "
                    f"after {index} pictures; the rest is left out"
                )
                return
            since_start_ns, as_stated = clock.stamp(picture)
            self.lost.restamped += not as_stated
            self.lost.damaged += picture.is_corrupt
            frame = self._frame(index, self.start_time_ns + since_start_ns, picture)
            if annex_b is not None and packet is not None:
                frame.encoded = annex_b.message(packet)
            yield frame

    @cached_property
    def passthrough_reason(self) -> str | None:
        """Why the stream's packets cannot be handed on as one picture per message; None when they can."""
        if not self._packets_wanted:
            return "packets were not asked for"
        if self.codec not in _ANNEX_B:
            return f"the codec is {self.codec}, not h264 or hevc"
        if self.pixel_format not in ("yuv420p", "yuvj420p"):
            return f"the pixel format is {self.pixel_format}, not 8-bit 4:2:0"
        if not self._orientation.upright:
            return "the picture is stored rotated or mirrored"
        if self.interlaced:
            return "the pictures are interlaced"
        if self._stream.codec_context.has_b_frames:
            return "the stream reorders its pictures (B-frames)"
        return _packets_reason(self.path, self.codec)

    def _decode(self) -> Iterator[_Decoded]:
        """Decode every packet once and give the pictures in presentation order, each with its packet.

        Packets wait under their time stamp until the picture with that stamp is out: those overtaken, or
        that still wait at the end, never became one.
        """
        self.lost = lost = Losses()
        container, stream = self._container, self._stream
        reader = container.demux(stream)
        waiting: dict[int, _Packet] = {}
        last: tuple[int, bool] | None = None  # time stamp of the latest packet, and whether it is cut short
        errors = pictures_out = 0
        one_to_one = self.codec not in _INVISIBLE_PICTURES
        ended = False
        while not ended:
            try:
                packet = next(reader)
            except StopIteration:
                break
            except (av.FFmpegError, OSError) as error:
                lost.stopped = f"{self.path}: reading stopped after {pictures_out} pictures ({_short(error)})"
                packet = cast(_Packet, av.Packet())  # empty: makes the decoder give what it still holds
                ended = True
            if packet.size and packet.pts is not None:
                last = max(last or (packet.pts, False), (packet.pts, packet.is_corrupt))
                if not packet.is_discard:
                    waiting[packet.pts] = packet
            try:
                pictures = stream.codec_context.decode(packet if packet.size else None)
            except av.FFmpegError:
                pictures, errors = [], errors + 1
            for picture in pictures:
                pictures_out += 1
                one_to_one = one_to_one and not picture.interlaced_frame
                own: _Packet | None = None
                if picture.pts in waiting:
                    own = waiting.pop(picture.pts)
                    overtaken = [pts for pts in waiting if pts < picture.pts]
                    for pts in overtaken:
                        del waiting[pts]
                    lost.undecodable += len(overtaken) if one_to_one else 0
                yield picture, own
        if one_to_one:
            lost.undecodable += len(waiting)
        lost.undecodable = max(lost.undecodable, errors)
        lost.stopped = lost.stopped or _cut_short(self.path, container, stream, last, pictures_out)

    def _frame(self, index: int, stamp_ns: int, picture: av.VideoFrame) -> Frame:
        layout, turn = _layout(picture.format.name), self._orientation
        if layout.convert_to is not None:
            # Only depth and packing change: range, matrix and chroma grid stay those of the stream.
            picture = self._reformatter.reformat(picture, format=layout.convert_to, threads=1)
        width, height = picture.width, picture.height
        if layout.convert_to == "bgr24":
            bgr = _plane(picture, 0, 3 * width, height).reshape(height, width, 3)
            return BgrFrame(index, stamp_ns, np.ascontiguousarray(turn.apply(bgr)))
        (sx, sy), (ox, oy) = layout.step, _chroma_origin(self._siting, layout.step)
        columns, rows = -(-width // sx), -(-height // sy)
        y = _plane(picture, 0, width, height)
        if layout.gray:
            u = v = np.broadcast_to(np.uint8(128), (rows, columns))
        elif layout.u_first is not None:
            both = _plane(picture, 1, 2 * columns, rows).reshape(rows, columns, 2)
            u, v = both[..., layout.u_first], both[..., 1 - layout.u_first]
        else:
            u, v = _plane(picture, 1, columns, rows), _plane(picture, 2, columns, rows)
        if turn.transposed:
            (sx, sy), (ox, oy), (width, height), (columns, rows) = (
                (sy, sx),
                (oy, ox),
                (height, width),
                (rows, columns),
            )
        if turn.flip_x:
            ox = width - 1 - (ox + (columns - 1) * sx)
        if turn.flip_y:
            oy = height - 1 - (oy + (rows - 1) * sy)
        matrix = _MATRICES.get(picture.colorspace, self._default_matrix)
        full_range = picture.color_range == _FULL_RANGE or layout.full_range
        full_range = full_range or (layout.gray and picture.color_range != _LIMITED_RANGE)
        frame = DecodedFrame(
            index, stamp_ns, turn.apply(y), (turn.apply(u), turn.apply(v)), (sx, sy), (ox, oy),
            _to_bgr(matrix, full_range),
        )  # fmt: skip
        frame.matrix, frame.full_range = matrix, full_range
        return frame


def _open(path: Path) -> tuple[av.container.InputContainer, av.VideoStream]:
    """Open a file and pick its video stream; every way this can fail is one SourceError."""
    if not path.exists():
        raise SourceError(f"{path}: no such file; check the name")
    if path.is_dir():
        raise SourceError(f"{path}: is a folder, not a video; name one file in it")
    try:
        size = path.stat().st_size
        if size == 0:
            raise SourceError(f"{path}: is empty (0 bytes); copy it again from the camera")
        # "file:" keeps FFmpeg from reading a colon in the name as a protocol.
        container = av.open(f"file:{path}", metadata_errors="replace")
    except (av.FFmpegError, OSError) as error:
        if _is_mp4_without_index(path):
            raise SourceError(
                f"{path}: an MP4 without its index ('moov'): the recording was never finished; "
                "have the camera repair it, or copy it again"
            ) from error
        raise SourceError(f"{path}: not a video that FFmpeg can read ({_short(error)}); check the file") from error
    videos = [stream for stream in container.streams.video if not stream.disposition & _COVERS]
    if container.format.name == "tty":  # FFmpeg draws any text file as a terminal would
        container.close()
        raise SourceError(f"{path}: a text file, not a video; name a video file")
    if not videos:
        found = ", ".join(sorted({str(stream.type) for stream in container.streams})) or "nothing"
        container.close()
        raise SourceError(f"{path}: no video stream in it (only {found}); name a video file")
    readable = [stream for stream in videos if stream.codec_context is not None]
    if not readable:
        container.close()
        raise SourceError(f"{path}: FFmpeg has no decoder for its video; convert it to H.264 first")
    best = max(readable, key=lambda stream: stream.codec_context.width * stream.codec_context.height)
    for stream in container.streams:
        if stream.index != best.index:
            stream.discard = Discard.all
    best.codec_context.thread_type = "AUTO"
    best.codec_context.thread_count = 0  # one per core
    return container, best


def _is_mp4_without_index(path: Path) -> bool:
    """Whether the top-level boxes start with ftyp and hold no moov."""
    try:
        with open(path, "rb") as file:
            names: list[bytes] = []
            at, end = 0, path.stat().st_size
            while at + 8 <= end and len(names) < 64:
                file.seek(at)
                head = file.read(16)
                size, name = int.from_bytes(head[:4], "big"), head[4:8]
                names.append(name)
                size = int.from_bytes(head[8:16], "big") if size == 1 else size
                at = at + size if size >= 8 else end
    except OSError:
        return False
    return names[:1] == [b"ftyp"] and b"moov" not in names


def _short(error: BaseException) -> str:
    return str(getattr(error, "strerror", None) or error).splitlines()[0]


def _start(
    container: av.container.InputContainer, stream: av.VideoStream, given_ns: int | None
) -> tuple[int, StartTimeSource]:
    """Unix time of the container's zero, and where it is from; a creation time of 1970 or before is unset."""
    if given_ns is not None:
        return given_ns, "start-time"
    for metadata in (container.metadata, stream.metadata):
        try:
            created_ns = parse_time_ns(metadata["creation_time"])
        except (KeyError, ValueError, OverflowError):
            continue
        if created_ns > 0:
            return created_ns, "creation-time"
    return 0, "zero"


def _stated_end_s(container: av.container.InputContainer, stream: av.VideoStream) -> Fraction | None:
    """When the video's last picture ends by the file's own words, seconds after the container's zero."""
    stated = re.fullmatch(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)", stream.metadata.get("DURATION", ""))
    if stated:
        return int(stated[1]) * 3600 + int(stated[2]) * 60 + Fraction(stated[3])
    if container.format.name == "avi" and stream.frames and stream.time_base:
        return stream.frames * stream.time_base
    if container.format.name == "flv" and len(container.streams) == 1 and container.duration:
        return Fraction(container.duration, av.time_base)
    return None


def _duration_s(container: av.container.InputContainer, stream: av.VideoStream) -> float | None:
    if stream.duration and stream.time_base:
        return float(stream.duration * stream.time_base)
    return container.duration / av.time_base if container.duration else None


def _cut_short(
    path: Path,
    container: av.container.InputContainer,
    stream: av.VideoStream,
    last: tuple[int, bool] | None,
    pictures: int,
) -> str | None:
    """Why the file looks truncated, in one line; None when it is whole or there is no way to tell."""
    of = f" of {stream.frames}" if stream.frames > pictures else ""
    story = f"{path}: truncated: it ends after {pictures}{of} pictures; what could be decoded was kept"
    if last is not None and last[1]:
        return story
    size = path.stat().st_size
    if container.format.name == "mpegts" and all(size % length for length in _TS_PACKET_BYTES):
        return story
    if container.format.name.startswith("mov") and len(stream.index_entries):
        entry = stream.index_entries[-1]
        if entry.pos + entry.size > size:
            return story
    stated, time_base = _stated_end_s(container, stream), stream.time_base
    if stated is None or time_base is None or last is None:
        return None
    picture_s = 1 / stream.average_rate if stream.average_rate else Fraction(1, 10)
    return story if last[0] * time_base + 2 * picture_s < stated else None


def _packets_reason(path: Path, codec: str) -> str | None:
    """Read all packets and say why they are not one picture each in display order; None when they are."""
    container, stream = _open(path)
    previous: int | None = None
    try:
        for packet in container.demux(stream):
            if not packet.size:
                continue
            if packet.pts is None:
                return "its packets have no time stamps"
            if packet.is_discard:
                return "an edit list hides some of its pictures"
            if previous is not None and packet.pts <= previous:
                return "the stream reorders its pictures (B-frames)"
            first, previous = previous is None, packet.pts
            if first:
                annex_b = _AnnexB(codec, stream)
                if not annex_b.message(packet).key or not annex_b.complete:
                    return "it does not begin with a key frame and its parameter sets"
    except (av.FFmpegError, OSError):
        pass  # what is wrong with the file shows, and is counted, when it is decoded
    finally:
        container.close()
    return None if previous is not None else "it has no packets"


class _AnnexB:
    """Turns a stream's packets into Annex B messages whose key frames carry their parameter sets."""

    _SETS: ClassVar = {"h264": (7, 8), "hevc": (32, 33, 34)}
    _KEYS: ClassVar = {"h264": (5,), "hevc": tuple(range(16, 22))}
    _DELIMITER: ClassVar = {"h264": 9, "hevc": 35}

    def __init__(self, codec: str, stream: av.VideoStream) -> None:
        filter_name, self.format = _ANNEX_B[codec]
        self._codec = codec
        self._filter = BitStreamFilterContext(filter_name, stream)
        self._known: dict[int, bytes] = {}
        extradata = stream.codec_context.extradata or b""
        if extradata.startswith((b"\0\0\1", b"\0\0\0\1")):
            self._remember(self._split(extradata))

    @property
    def complete(self) -> bool:
        """Whether all kinds of parameter sets were seen."""
        return len(self._known) == len(self._SETS[self._codec])

    def message(self, packet: _Packet) -> EncodedPicture:
        """The packet as one Annex B access unit. Takes packets in stream order, and empties them."""
        may_be_key = packet.is_keyframe
        data = b"".join(bytes(part) for part in self._filter.filter(packet))
        if not may_be_key:
            return EncodedPicture(data, self.format, False)
        units = self._split(data)
        kinds = [kind for kind, _ in units]
        self._remember(units)
        key = any(kind in self._KEYS[self._codec] for kind in kinds)
        missing = [self._known[k] for k in self._SETS[self._codec] if k not in kinds and k in self._known]
        if key and missing:
            first = 1 if kinds[0] == self._DELIMITER[self._codec] else 0
            parts = [unit for _, unit in units]
            parts[first:first] = missing
            data = b"".join(b"\0\0\0\1" + part for part in parts)
        return EncodedPicture(data, self.format, key)

    def _remember(self, units: list[tuple[int, bytes]]) -> None:
        for kind in self._SETS[self._codec]:
            same_kind = [unit for k, unit in units if k == kind]
            if same_kind:
                self._known[kind] = b"\0\0\0\1".join(same_kind)

    def _split(self, data: bytes) -> list[tuple[int, bytes]]:
        """The NAL units of an Annex B byte stream as (type, bytes without start code)."""
        units = []
        at = data.find(b"\0\0\1")
        while at >= 0:
            after = data.find(b"\0\0\1", at + 3)
            unit = data[at + 3 : after if after >= 0 else len(data)].rstrip(b"\0")
            if unit:
                units.append((unit[0] & 31 if self._codec == "h264" else unit[0] >> 1 & 63, unit))
            at = after
        return units


class _Clock:
    """Strictly increasing nanoseconds from the pictures' time stamps."""

    def __init__(self, stream: av.VideoStream, origin_ticks: int) -> None:
        self._time_base = stream.time_base or Fraction(1, NS_PER_S)
        self._usual_ns = int(NS_PER_S / stream.average_rate) if stream.average_rate else NS_PER_S // 1000
        self._origin_ticks = origin_ticks
        self._shift_ns = 0
        self._last_ns: int | None = None

    def stamp(self, picture: av.VideoFrame) -> tuple[int, bool]:
        """The picture's time in ns, and whether it is the one the file states."""
        ticks = picture.pts if picture.pts is not None else picture.dts
        length_ns = ticks_to_ns(picture.duration, self._time_base) if picture.duration else self._usual_ns
        last, stated = self._last_ns, picture.pts is not None
        if ticks is None:
            ns = 0 if last is None else last + length_ns
        else:
            ns = ticks_to_ns(ticks - self._origin_ticks, self._time_base) + self._shift_ns
        if last is not None and ns <= last:
            stated = False
            if last - ns > NS_PER_S:
                self._shift_ns += last + length_ns - ns
                ns = last + length_ns
            else:
                ns = last + max(1, length_ns // 2)
        self._last_ns = ns
        return ns, stated


@dataclass(frozen=True, slots=True)
class _Orientation:
    """How a stored picture becomes the displayed one: transpose, then reverse columns, then rows."""

    transposed: bool = False
    flip_x: bool = False
    flip_y: bool = False

    @property
    def upright(self) -> bool:
        return not (self.transposed or self.flip_x or self.flip_y)

    @property
    def clockwise_deg(self) -> int:
        """The turn in it (a mirror image counts as the turn of its left-right mirror)."""
        if self.transposed:
            return 270 if self.flip_y else 90
        return 180 if self.flip_y else 0

    def apply(self, plane: Plane) -> Plane:
        """A view of the plane (rows, columns, ...) as displayed."""
        if self.transposed:
            plane = plane.swapaxes(0, 1)
        if self.flip_x:
            plane = plane[:, ::-1]
        return plane[::-1] if self.flip_y else plane


def _orientation(picture: av.VideoFrame) -> _Orientation:
    """FFmpeg's display matrix (a b u; c d v; x y w): stored (p, q) is displayed at (ap + cq, bp + dq)."""
    matrix = cast("Mapping[str, Any]", picture.side_data).get("DISPLAYMATRIX")
    if matrix is None:
        return _Orientation()
    a, b, _, c, d = (int(v) for v in np.frombuffer(matrix, np.int32)[:5])
    transposed = abs(b) > abs(a)
    return _Orientation(transposed, (c if transposed else a) < 0, (b if transposed else d) < 0)


@dataclass(frozen=True, slots=True)
class _Layout:
    """How a pixel format's planes are read.

    `step` is the chroma subsampling (x, y); `u_first` which of two samples is U where U and V share a plane;
    `convert_to` the 8-bit format swscale has to make first, None when the planes can be read as they are.
    """

    step: tuple[int, int] = (1, 1)
    u_first: int | None = None
    gray: bool = False
    full_range: bool = False
    convert_to: str | None = None


@cache
def _layout(name: str) -> _Layout:
    pixel = VideoFormat(name, 16, 16)
    step = (16 // pixel.chroma_width(16), 16 // pixel.chroma_height(16))
    if re.fullmatch(r"yuv[aj]?4\d\dp", name):
        return _Layout(step, full_range="yuvj" in name)
    if name in _SEMI_PLANAR:
        return _Layout(step, u_first=_SEMI_PLANAR[name])
    if pixel.is_rgb or pixel.has_palette or name.startswith(("mono", "xyz")):
        return _Layout(convert_to="bgr24")
    if sum(not component.is_alpha for component in pixel.components) == 1:
        return _Layout(gray=True, convert_to=None if name == "gray" else "gray")
    return _Layout(step, convert_to=f"yuv{_SUBSAMPLING[step]}p")


def _plane(picture: av.VideoFrame, index: int, width: int, height: int) -> Plane:
    """Plane `index` as a read-only (height, width) view of the decoder's memory, which it keeps alive."""
    plane = picture.planes[index]
    rows = np.frombuffer(memoryview(plane).toreadonly(), np.uint8).reshape(height, abs(plane.line_size))
    return rows[:: 1 if plane.line_size > 0 else -1, :width]


def _chroma_siting(picture: av.VideoFrame) -> str:
    """Where chroma samples lie (left, center, topleft, ...), which FFmpeg tells only its own filters."""
    graph = av.filter.Graph()
    source = graph.add_buffer(
        width=picture.width,
        height=picture.height,
        format=picture.format,
        time_base=picture.time_base or Fraction(1, NS_PER_S),
    )
    show, sink = graph.add("showinfo"), graph.add("buffersink")
    source.link_to(show)
    show.link_to(sink)
    level = av.logging.get_level()
    try:
        graph.configure()
        av.logging.set_level(av.logging.INFO)
        with av.logging.Capture() as messages:
            graph.push(picture)
            graph.pull()
    except (av.FFmpegError, OSError, ValueError):
        return "unspecified"
    finally:
        av.logging.set_level(level)
    said = re.search(r" cl:(\w+)", "".join(text for _, _, text in messages))
    return said[1] if said else "unspecified"


def _chroma_origin(siting: str, step: tuple[int, int]) -> tuple[float, float]:
    """Luma column and row of the first chroma sample; unspecified is left, as in H.264, HEVC and MPEG-2."""
    sx, sy = step
    x = 0.0 if "left" in siting or siting == "unspecified" else (sx - 1) / 2
    y = 0.0 if "top" in siting else sy - 1.0 if "bottom" in siting else (sy - 1) / 2
    return x, y


_to_bgr = cache(yuv_to_bgr_matrix)
