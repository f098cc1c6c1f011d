"""Pictures as frames: decoded ones in their planes, raw bytes, JPEG, PNG and WebP; the same from a file and from MCAP.

Colour is what the stream says. Where it says nothing: BT.709 from 720 rows on, else BT.601, limited range, as players
do; gray is full range, as FFmpeg has it. Raw YUV is BT.601, limited range, as camera drivers send it. Rows and columns
are those of the picture as displayed. No picture of more than `LARGEST_PX` pixels is decoded: what it would take is
looked at before any memory is.
"""

import itertools
import re
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any, Generic, TypeVar, cast

import av
import av.filter
import av.logging
import cv2
import numpy as np
import numpy.typing as npt
from av.video.codeccontext import VideoCodecContext
from av.video.format import VideoFormat
from av.video.reformatter import VideoReformatter

from spheremcap.core.frame import BgrFrame, Frame, YuvFrame, yuv_to_bgr_matrix
from spheremcap.core.time import NS_PER_S
from spheremcap.io.annex_b import Packet
from spheremcap.io.siting import lies_midway

_AV_LOG_QUIET = -8  # AV_LOG_QUIET, below PANIC: FFmpeg's own callback prints nothing


def _quiet() -> None:
    """FFmpeg's own log says nothing a user can use; errors are told once, in one line.

    By FFmpeg's own level, not by `set_level(None)`: what a decoding thread has just begun to log would find no level to
    compare its own with, and print a trace.
    """
    av.logging.set_level(av.logging.PANIC)
    av.logging.set_libav_level(_AV_LOG_QUIET)
    av.logging.restore_default_callback()


_quiet()

Plane = npt.NDArray[np.uint8]

LARGEST_PX = 1 << 26
"""8192 x 8192: twice the pixels of 8K."""
_MATRICES = {1: "bt709", 4: "bt601", 5: "bt601", 6: "bt601", 7: "bt709", 9: "bt2020", 10: "bt2020"}
"""FFmpeg's AVColorSpace to the matrix; SMPTE 240M (7) is nearest to BT.709."""
_FULL_RANGE, _LIMITED_RANGE = 2, 1  # AVColorRange
_SUBSAMPLING = {(4, 4): "410", (4, 1): "411", (2, 2): "420", (2, 1): "422", (1, 2): "440", (1, 1): "444"}
_SEMI_PLANAR = {"nv12": 0, "nv21": 1, "nv16": 0, "nv24": 0, "nv42": 1}
"""8-bit formats with U and V in one plane, and which of the two is U."""


class DecodedFrame(YuvFrame):
    """A YuvFrame that also knows its colour tags: `matrix` (bt601, bt709, bt2020) and `full_range`."""

    def __init__(
        self,
        index: int,
        stamp_ns: int,
        y: Plane,
        uv: tuple[Plane, Plane],
        uv_step_px: tuple[int, int],
        uv_origin_px: tuple[float, float],
        matrix: str,
        full_range: bool,
    ) -> None:
        super().__init__(index, stamp_ns, y, uv, uv_step_px, uv_origin_px, _to_bgr(matrix, full_range))
        self.matrix, self.full_range = matrix, full_range


def check_size(width_px: int, height_px: int) -> None:
    """Raises ValueError for a picture that is too large to be one."""
    if width_px * height_px > LARGEST_PX:
        raise ValueError(
            f"{width_px}x{height_px} are more than the {LARGEST_PX >> 20} million pixels a picture may have"
        )


# --- decoders ---


class Damaged(Exception):
    """A decoder met what it cannot decode."""


_Item = TypeVar("_Item")


def decoded_once_more(read: Callable[[bool], Iterator[_Item]]) -> Iterator[_Item]:
    """What `read(False)` gives, as fast as can be; where that meets damage (raises Damaged), the rest of `read(True)`.

    Decoders fill up what is damaged from pictures that another thread may still be at, or with what their memory held
    before. So that a damaged stream gives the same pixels every time, it is read from the start once more with a
    `careful` decoder: one thread, and no picture held by others. What comes before the damage is the same in both.
    """
    given = 0
    try:
        for item in read(False):
            given += 1
            yield item
        return
    except Damaged:
        pass
    yield from itertools.islice(read(True), given, None)


class HeldBack(Generic[_Item]):
    """Decoded pictures, held back until all that were decoded before them, from which they may be made, are out.

    Where one of those turns out to be damaged, so may be what is held back.
    """

    def __init__(self) -> None:
        self.packets: dict[int, tuple[int, Packet]] = {}
        """By time stamp, those whose pictures are not out, each with its place in the stream."""
        self._held: deque[tuple[int, _Item]] = deque()
        self._places = 0

    def goes_in(self, packet: Packet) -> None:
        """A packet that goes into the decoder."""
        if packet.size and packet.pts is not None and not packet.is_discard:
            self.packets[packet.pts] = self._places, packet
            self._places += 1

    def comes_out(self, pts: int | None) -> "tuple[int, Packet | None, int]":
        """The place of a picture's packet (-1 without one) and the packet; and how many it has overtaken, which never
        become one."""
        if pts not in self.packets:
            return -1, None, 0
        place, own = self.packets.pop(pts)
        overtaken = [other for other in self.packets if other < pts]
        for other in overtaken:
            del self.packets[other]
        return place, own, len(overtaken)

    def hold(self, place: int, item: _Item) -> None:
        """One that is to be shown."""
        self._held.append((place, item))

    def ready(self) -> Iterator[_Item]:
        """Those that need not wait any more."""
        oldest = next(iter(self.packets.values()))[0] if self.packets else self._places
        while self._held and self._held[0][0] < oldest:
            yield self._held.popleft()[1]

    def rest(self) -> Iterator[_Item]:
        """What is held at the end."""
        while self._held:
            yield self._held.popleft()[1]


def set_up_decoder(context: VideoCodecContext, careful: bool) -> VideoCodecContext:
    """Before it opens: it refuses pictures of more than LARGEST_PX pixels, whatever its stream says. A `careful` one
    has one thread and goes on after damage, any other has as many as there are cores and tells all damage."""
    context.thread_type, context.thread_count = "AUTO", int(careful)
    told = {} if careful and context.name not in UNCONCEALED else {"err_detect": "explode"}
    context.options = {**context.options, **told, "max_pixels": str(LARGEST_PX)}
    return context


UNCONCEALED = ("hevc",)
"""Codecs whose decoders fill up what is damaged with whatever their memory holds."""


class Shown:
    """Which pictures of a damaged stream are shown: all, but of UNCONCEALED codecs none that is damaged or comes
    between a damaged one and the next key frame. `order` is any number that rises as pictures are shown.
    """

    def __init__(self, codec: str) -> None:
        self._conceals = codec not in UNCONCEALED
        self._open, self._from = True, -(1 << 63)

    def damaged(self) -> None:
        """The decoder met damage."""
        self._open = self._conceals

    def key(self, order: int) -> None:
        """A key frame goes into the decoder."""
        if not self._open:
            self._open, self._from = True, order

    def __call__(self, order: int) -> bool:
        return self._open and order >= self._from


# --- decoded video ---


class DecodedPictures:
    """The decoded pictures of one stream as frames, upright; size, orientation and chroma siting are the first's.

    `chroma_note` is for the user where that picture shows another siting than the stream says or means; else "".
    """

    def __init__(self, first: av.VideoFrame) -> None:
        self._reformatter = VideoReformatter()
        self.coded_size = (first.width, first.height)
        self.orientation = orientation_of(first)
        turned = self.orientation.transposed
        self.width_px, self.height_px = self.coded_size[::-1] if turned else self.coded_size
        self._siting, self.chroma_note = _chroma_siting(first), ""
        self._default_matrix = "bt709" if max(first.height, self.height_px) >= 720 else "bt601"
        if self._siting in _UNTOLD and self._shows_midway(first):
            self._siting = "center"
            self.chroma_note = (
                "chroma lies midway between two pixels, which the video does not say but its first picture shows"
            )

    def _shows_midway(self, picture: av.VideoFrame) -> bool:
        layout = _layout(picture.format.name)
        if layout.step[0] != 2 or layout.gray or layout.convert_to == "bgr24":
            return False
        try:
            return lies_midway(*self._stored(picture, layout))
        except (av.FFmpegError, ValueError):
            return False

    def _stored(self, picture: av.VideoFrame, layout: "_Layout") -> tuple[Plane, Plane, Plane]:
        """The planes Y, U and V as they lie in the file, 8 bits."""
        if layout.convert_to is not None:
            # Only depth and packing change: range, matrix and chroma grid stay those of the stream.
            picture = self._reformatter.reformat(picture, format=layout.convert_to, threads=1)
        (sx, sy), width, height = layout.step, picture.width, picture.height
        columns, rows = -(-width // sx), -(-height // sy)
        y = _plane(picture, 0, width, height)
        if layout.gray:
            u = v = np.broadcast_to(np.uint8(128), (rows, columns))
        elif layout.u_first is not None:
            both = _plane(picture, 1, 2 * columns, rows).reshape(rows, columns, 2)
            u, v = both[..., layout.u_first], both[..., 1 - layout.u_first]
        else:
            u, v = _plane(picture, 1, columns, rows), _plane(picture, 2, columns, rows)
        return y, u, v

    def frame(self, index: int, stamp_ns: int, picture: av.VideoFrame, copied: bool = False) -> Frame:
        """A DecodedFrame (planes as decoded: the decoder's own memory unless they are to be `copied`) or, from RGB and
        palette video, a BgrFrame. Raises av.FFmpegError or ValueError for a pixel format that cannot be converted.
        """
        layout, turn = _layout(picture.format.name), self.orientation
        if layout.convert_to == "bgr24":
            picture = self._reformatter.reformat(picture, format="bgr24", threads=1)
            bgr = _plane(picture, 0, 3 * picture.width, picture.height).reshape(picture.height, picture.width, 3)
            return BgrFrame(index, stamp_ns, np.ascontiguousarray(turn.apply(bgr)))
        y, u, v = self._stored(picture, layout)
        (sx, sy), (ox, oy) = layout.step, _chroma_origin(self._siting, layout.step)
        (height, width), (rows, columns) = y.shape, u.shape
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
        if copied:
            y, u, v = y.copy(), u.copy(), v.copy()
        planes = turn.apply(y), (turn.apply(u), turn.apply(v))
        return DecodedFrame(index, stamp_ns, *planes, (sx, sy), (ox, oy), matrix, full_range)


@dataclass(frozen=True, slots=True)
class Orientation:
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


def orientation_of(picture: av.VideoFrame) -> Orientation:
    """FFmpeg's display matrix (a b u; c d v; x y w): stored (p, q) is displayed at (ap + cq, bp + dq)."""
    matrix = cast("Mapping[str, Any]", picture.side_data).get("DISPLAYMATRIX")
    if matrix is None:
        return Orientation()
    a, b, _, c, d = (int(v) for v in np.frombuffer(matrix, np.int32)[:5])
    transposed = abs(b) > abs(a)
    return Orientation(transposed, (c if transposed else a) < 0, (b if transposed else d) < 0)


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


_UNTOLD = ("unspecified", "left")
"""What FFmpeg says of a stream that says nothing: H.264's and HEVC's decoders take the standard's default for said."""

_LOG = threading.Lock()  # FFmpeg has one log, whatever the number of sources


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
    try:
        graph.configure()
        with _LOG:
            av.logging.set_level(av.logging.INFO)
            try:
                with av.logging.Capture() as messages:
                    graph.push(picture)
                    graph.pull()
            finally:
                _quiet()
    except (av.FFmpegError, OSError, ValueError):
        return "unspecified"
    said = re.search(r" cl:(\w+)", "".join(text for _, _, text in messages))
    return said[1] if said else "unspecified"


def _chroma_origin(siting: str, step: tuple[int, int]) -> tuple[float, float]:
    """Luma column and row of the first chroma sample; unspecified is left, as in H.264, HEVC and MPEG-2."""
    sx, sy = step
    x = 0.0 if "left" in siting or siting == "unspecified" else (sx - 1) / 2
    y = 0.0 if "top" in siting else sy - 1.0 if "bottom" in siting else (sy - 1) / 2
    return x, y


_to_bgr = cache(yuv_to_bgr_matrix)


# --- raw pictures ---


@dataclass(frozen=True, slots=True)
class RawPicture:
    """Pixels as a message has them: `encoding` is one of RAW_ENCODINGS, `step` the bytes of a row (0: no padding)."""

    encoding: str
    data: bytes
    width: int
    height: int
    step: int = 0


_TO_BGR = {
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "8uc4": (4, cv2.COLOR_BGRA2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8uc1": (1, cv2.COLOR_GRAY2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
    "bgr8": (3, None),
    "8uc3": (3, None),
}
_YUV422 = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}  # the byte the first luma sample is at
RAW_ENCODINGS = (*_TO_BGR, *_YUV422, "nv12")


def raw_frame(index: int, stamp_ns: int, picture: RawPicture) -> Frame:
    """The frame of a raw picture; YUV stays in its planes. Raises ValueError when the data do not fit the
    size.
    """
    kind, width, height = picture.encoding.lower(), picture.width, picture.height
    check_size(width, height)
    channels = 1 if kind == "nv12" else 2 if kind in _YUV422 else _TO_BGR[kind][0]
    rows = height * 3 // 2 if kind == "nv12" else height
    step = picture.step or width * channels
    last = width * channels
    if width <= 0 or height <= 0 or step < last or len(picture.data) < step * (rows - 1) + last:
        raise ValueError(
            f"{len(picture.data)} bytes do not hold {width}x{height} {picture.encoding} with {step} bytes a row"
        )
    if kind in (*_YUV422, "nv12") and width % 2:
        raise ValueError(f"{picture.encoding} pictures have an even width, not {width}")
    data = np.frombuffer(picture.data, np.uint8, min(len(picture.data), step * rows))
    if len(data) < step * rows:
        data = np.pad(data, (0, step * rows - len(data)))
    grid = data.reshape(rows, step)[:, :last]
    if kind == "nv12":
        uv = grid[height:]
        planes = (uv[:, 0::2], uv[:, 1::2])
        return DecodedFrame(index, stamp_ns, grid[:height], planes, (2, 2), (0.0, 0.5), "bt601", False)
    if kind in _YUV422:
        luma = _YUV422[kind]
        planes = (grid[:, 1 - luma :: 4], grid[:, 3 - luma :: 4])
        return DecodedFrame(index, stamp_ns, grid[:, luma::2], planes, (2, 1), (0.0, 0.0), "bt601", False)
    code = _TO_BGR[kind][1]
    pixels = grid if channels == 1 else grid.reshape(height, width, channels)
    image = np.ascontiguousarray(pixels)
    if code is not None:
        try:
            image = cv2.cvtColor(image, code)  # type: ignore[assignment]
        except cv2.error as error:
            raise ValueError(f"{width}x{height} {picture.encoding} cannot be converted ({error.err})") from error
    return BgrFrame(index, stamp_ns, image)


# --- still pictures ---


def still_image(data: bytes) -> npt.NDArray[np.uint8]:
    """(height, width, 3) BGR of a JPEG, PNG or WebP. Raises ValueError when it is none, damaged, or too large."""
    size = _still_size(data)
    if size is None:
        raise ValueError(f"{len(data)} bytes that are no JPEG, PNG or WebP picture")
    check_size(*size)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise ValueError(f"a picture that cannot be decoded ({error.err})") from error
    if image is None:
        raise ValueError(f"{len(data)} bytes of a picture of {size[0]}x{size[1]} that cannot be decoded")
    return image  # type: ignore[return-value]


def is_jpeg(data: bytes) -> bool:
    """Whether the bytes begin as a JPEG does."""
    return data[:3] == b"\xff\xd8\xff"


def is_cut_jpeg(data: bytes) -> bool:
    """Whether it is a JPEG that ends before its picture does: decoders fill up the rest without a word."""
    start = next((at for kind, at in _jpeg_segments(data) if kind == 0xDA), len(data))
    return is_jpeg(data) and data.find(b"\xff\xd9", start) < 0


def _still_size(data: bytes) -> tuple[int, int] | None:
    """Width and height by the header; None when that is none of a JPEG, PNG or WebP."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return width, height
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP" and len(data) >= 30:
        kind, body = data[12:16], data[20:30]
        if kind == b"VP8X":
            return 1 + int.from_bytes(body[4:7], "little"), 1 + int.from_bytes(body[7:10], "little")
        if kind == b"VP8L":
            bits = int.from_bytes(body[1:5], "little")
            return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        return int.from_bytes(body[6:8], "little") & 0x3FFF, int.from_bytes(body[8:10], "little") & 0x3FFF
    return _jpeg_size(data) if is_jpeg(data) else None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """From the frame header (SOF), the first of the segments that has the size."""
    for kind, at in _jpeg_segments(data):
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC) and at + 9 <= len(data):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
    return None


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """(kind, where it starts) of each segment up to the picture's own data; what is inside of one is passed over."""
    at = 2
    while 0 <= (at := data.find(b"\xff", at)) < len(data) - 3:
        kind = data[at + 1]
        alone = kind in (0x00, 0x01, 0xFF) or 0xD0 <= kind <= 0xD8
        if not alone:
            yield kind, at
            if kind == 0xDA:
                return
        at += (1 if kind == 0xFF else 2) if alone else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
