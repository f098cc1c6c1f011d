"""Pictures as viewers take them: H.264 in Annex B or JPEG, one picture per message; and small MP4 files.

Every encoder runs with a fixed number of threads, a slice each, and is given no byte that is not set: the same pictures
give the same bytes on every machine.
"""

import itertools
import os
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import TypeGuard

import av
import cv2
import numpy as np
import numpy.typing as npt
from av.video.codeccontext import VideoCodecContext
from av.video.reformatter import ColorRange

from spheremcap.core.frame import BgrImage, EncodedPicture, Frame, yuv_to_bgr_matrix
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import OutputError, UsageError
from spheremcap.io.picture import DecodedFrame

JPEG_QUALITY = 90
_TAGS = {"bt601": 6, "bt709": 1, "bt2020": 9}
"""Colour matrix to FFmpeg's AVColorSpace."""

_Plane = npt.NDArray[np.uint8]
_Planes = tuple[_Plane, _Plane, _Plane]
"""Y, U and V of 4:2:0, U and V where H.264 has them unless it says otherwise: on even columns, between two rows."""


class H264Encoder:
    """Frames in, H.264 out: one Annex B access unit per frame at once, no B-frames, SPS and PPS on every key.

    Size, colour matrix and range are those of the first frame. A decoded 4:2:0 frame's planes are encoded as
    they are (chroma moved when it is not on the left, where viewers look for it), everything else goes through
    BGR to 4:2:0 BT.709. H.264 4:2:0 has even sizes only: an odd width
    or height gets one more column right or row below, repeating the last, so pixel coordinates hold;
    `width_px`, `height_px` (set by the first frame) say what a viewer sees.

    `rate_hint` (frames per second) goes into the stream's level and rate control only; `crf` is libx264's
    constant quality (lower is better, 18-23 usual); a key frame comes every `key_every` frames.
    """

    def __init__(self, *, rate_hint: Fraction | None = None, crf: float = 20.0, key_every: int = 30) -> None:
        self._rate = rate_hint or Fraction(60)
        self._crf, self._key_every = crf, key_every
        self._context: VideoCodecContext | None = None
        self._matrix, self._full_range = "bt709", False
        self._count = 0
        self._size = (0, 0)
        self.width_px = self.height_px = 0

    def encode(self, frame: Frame) -> EncodedPicture:
        """The frame as one access unit. Raises UsageError when its size is not that of the first frame."""
        if self._context is None:
            self._context = self._start(frame)
        if (frame.width_px, frame.height_px) != self._size:
            was = f"{self._size[0]}x{self._size[1]}"
            raise UsageError(
                f"frame {frame.index} is {frame.width_px}x{frame.height_px}, the first was {was}; "
                "start another encoder for another size"
            )
        picture = _picture(self._planes(frame), self._matrix, self._full_range)
        picture.pts, picture.time_base = self._count, 1 / self._rate
        self._count += 1
        try:
            packets = self._context.encode(picture)
        except av.FFmpegError as error:
            raise OutputError(f"frame {frame.index} could not be encoded as H.264 ({error})") from error
        if len(packets) != 1:
            raise OutputError(f"libx264 gave {len(packets)} packets for frame {frame.index}, not 1")
        return EncodedPicture(bytes(packets[0]), "h264", packets[0].is_keyframe)

    def _start(self, frame: Frame) -> VideoCodecContext:
        self._size = (frame.width_px, frame.height_px)
        self.width_px, self.height_px = (
            frame.width_px + frame.width_px % 2,
            frame.height_px + frame.height_px % 2,
        )
        if _is_420(frame):
            self._matrix, self._full_range = frame.matrix, frame.full_range
        keys = f"keyint={self._key_every}:min-keyint={self._key_every}:scenecut=0"
        context = av.CodecContext.create("libx264", "w")
        _set_up(
            context, self.width_px, self.height_px, self._rate, 1 / self._rate, threads=1, crf=self._crf,
            preset="superfast", tune="zerolatency", params=f"bframes=0:{keys}:repeat-headers=1:annexb=1",
        )  # fmt: skip
        _tag(context, self._matrix, self._full_range)
        return context

    def _planes(self, frame: Frame) -> _Planes:
        if _is_420(frame) and (frame.matrix, frame.full_range) == (self._matrix, self._full_range):
            return frame.y, *_left_sited(frame)
        return _to_420(frame.full, self._matrix, self._full_range)


def jpeg_encode(frame: Frame, quality: int = JPEG_QUALITY) -> EncodedPicture:
    """The frame as a JPEG picture; always a key frame."""
    done, data = cv2.imencode(".jpg", frame.full, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise OutputError(f"frame {frame.index} could not be encoded as JPEG")
    return EncodedPicture(data.tobytes(), "jpeg", True)


def write_video(
    path: str | os.PathLike[str],
    pictures: Iterable[BgrImage],
    rate: Fraction,
    *,
    stamps_ns: Sequence[int] | None = None,
    crf: float = 18.0,
    bitrate: int | None = None,
    bframes: int = 0,
    creation_time: str | None = None,
) -> int:
    """Write BGR pictures as an H.264 4:2:0 BT.709 MP4 (or MKV, by the name) and return how many.

    Picture i is at exactly i / `rate` seconds (240000/1001 included), or at `stamps_ns[i]` (from 0 on, rising
    by less than 2 s at a time; MP4 only, whose clock can count nanoseconds). `crf` is libx264's constant
    quality; `bitrate` (bit/s) replaces it. `bframes` above 0 makes a stream that stores its pictures out of
    order. `creation_time` is ISO 8601. Sizes have to be even. Raises OutputError when it cannot be written.
    """
    if stamps_ns is not None and not all(0 < b - a < 2**31 for a, b in itertools.pairwise(stamps_ns)):
        raise UsageError(f"{path}: stamps have to rise, by less than 2 s at a time; MP4 cannot hold others")
    time_base = Fraction(1, NS_PER_S) if stamps_ns is not None else Fraction(1, rate.numerator)
    count = 0
    try:
        with av.open(os.fspath(path), "w") as container:
            if creation_time is not None:
                container.metadata["creation_time"] = creation_time
            stream = None
            for image in pictures:
                if stream is None:
                    stream = container.add_stream("libx264", rate=rate)
                    stream.time_base = time_base
                    context = stream.codec_context
                    _set_up(
                        context, image.shape[1], image.shape[0], rate, time_base, threads=2, crf=crf, bitrate=bitrate,
                        preset="veryfast", params=f"bframes={bframes}:keyint=60",
                    )  # fmt: skip
                    _tag(context, "bt709", False)
                picture = _picture(_to_420(image, "bt709", False), "bt709", False)
                picture.pts = stamps_ns[count] if stamps_ns is not None else count * rate.denominator
                picture.time_base = time_base
                container.mux(stream.encode(picture))
                count += 1
            if stream is not None:
                container.mux(stream.encode(None))
    except (av.FFmpegError, OSError) as error:
        raise OutputError(f"{path}: cannot be written as video ({error})") from error
    return count


def _is_420(frame: Frame) -> TypeGuard[DecodedFrame]:
    return isinstance(frame, DecodedFrame) and frame.uv_step_px == (2, 2)


def _set_up(
    context: VideoCodecContext,
    width_px: int,
    height_px: int,
    rate: Fraction,
    time_base: Fraction,
    *,
    threads: int,
    crf: float,
    preset: str,
    params: str,
    tune: str | None = None,
    bitrate: int | None = None,
) -> None:
    """Set libx264 up before it opens; `params` are x264's own, colon-separated."""
    context.width, context.height, context.pix_fmt = width_px, height_px, "yuv420p"
    context.time_base, context.framerate = time_base, rate
    context.thread_type, context.thread_count = "SLICE", threads
    options = {"preset": preset, "x264-params": params}
    if tune is not None:
        options["tune"] = tune
    if bitrate is None:
        options["crf"] = str(crf)
    else:
        context.bit_rate = bitrate
    context.options = options


def _tag(target: VideoCodecContext | av.VideoFrame, matrix: str, full_range: bool) -> None:
    target.colorspace = _TAGS[matrix]
    target.color_range = int(ColorRange.JPEG if full_range else ColorRange.MPEG)


def _to_420(image: BgrImage, matrix: str, full_range: bool) -> _Planes:
    """A BGR picture's planes; chroma through the narrowest filter that is centred where its samples lie."""
    to_bgr = yuv_to_bgr_matrix(matrix, full_range)
    from_bgr = np.linalg.inv(to_bgr[:, :3])
    y, *uv = cv2.split(cv2.transform(image, np.column_stack([from_bgr, -from_bgr @ to_bgr[:, 3]])))
    across, down = np.array([1, 2, 1]) / 4, np.array([1, 1]) / 2
    u, v = (cv2.sepFilter2D(c, -1, across, down, anchor=(1, 0), borderType=cv2.BORDER_REPLICATE) for c in uv)
    return y, u[::2, ::2], v[::2, ::2]  # type: ignore[return-value]


def _left_sited(frame: DecodedFrame) -> tuple[_Plane, _Plane]:
    """A 4:2:0 frame's own U and V, moved where JPEG's or a turned picture's samples lie elsewhere."""
    ox, oy = frame.uv_origin_px
    if (ox, oy) == (0.0, 0.5):
        return frame.uv
    move = np.array([[1, 0, -ox / 2], [0, 1, (0.5 - oy) / 2]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    u, v = (
        cv2.warpAffine(np.ascontiguousarray(c), move, c.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
        for c in frame.uv
    )
    return u, v  # type: ignore[return-value]


def _picture(planes: _Planes, matrix: str, full_range: bool) -> av.VideoFrame:
    """The planes as a tagged picture; an odd size gets one more column or row, repeating the last."""
    height, width = planes[0].shape
    picture = av.VideoFrame(width + width % 2, height + height % 2, "yuv420p")
    for target, plane in zip(picture.planes, planes, strict=True):
        rows = np.frombuffer(memoryview(target), np.uint8).reshape(target.height, target.line_size)
        height, width = plane.shape
        rows[:height, :width] = plane
        rows[:height, width:] = plane[:, -1:]
        rows[height:] = rows[height - 1]
    _tag(picture, matrix, full_range)
    return picture
