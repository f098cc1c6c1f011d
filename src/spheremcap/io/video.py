"""Video files as frames: exact stamps, planes as decoded, and the stream's own packets where those will do.

Stamps are `start + pts * time_base`, exact to the nanosecond. The container's own stamps count as they are (a
first picture at 0.5 s is at start + 0.5 s) with two exceptions: where the container's clock starts anywhere
(MPEG-TS and MPEG-PS) or below zero, the first picture displayed is at `start`. A stated rate is used only
where there are no stamps at all (a bare H.264 stream), and that is counted.

A picture whose stamp does not come after the one before it is put half a picture later, and counted; where
the clock falls back by more than a second it was restarted, and everything after is moved on to follow.
"""

import itertools
import os
import re
from collections.abc import Generator, Iterator
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Literal, TypeAlias, cast

import av
import av.container
from av.stream import Discard, Disposition

from spheremcap.core.camera import Camera
from spheremcap.core.frame import Frame
from spheremcap.core.time import NS_PER_S, parse_time_ns, ticks_to_ns
from spheremcap.errors import SourceError, short
from spheremcap.io.annex_b import CODECS, AnnexB, Packet
from spheremcap.io.input_file import checked_input
from spheremcap.io.picture import (
    LARGEST_PX,
    Damaged,
    DecodedPictures,
    HeldBack,
    Shown,
    decoded_once_more,
    set_up_decoder,
)
from spheremcap.io.source import Losses

StartTimeSource = Literal["start-time", "creation-time", "zero"]

_COVERS = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image
_FREE_RUNNING_CLOCKS = ("mpegts", "mpeg")
_TS_PACKET_BYTES = (188, 192, 204)
INVISIBLE_PICTURES = ("vp8",)
"""Codecs with packets that show no picture, so that packets and pictures cannot be counted off."""
LONGEST_PICTURE_NS = 10 * NS_PER_S
END_OF_TIME_NS = (1 << 63) - 1

_Decoded: TypeAlias = "tuple[av.VideoFrame, Packet | None]"
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
        self._container, self._stream = open_video(self.path)
        stream = self._stream
        self.codec: str = stream.codec_context.codec.canonical_name
        rate = stream.average_rate
        self.stated_rate: Fraction | None = rate if rate and Fraction(1, 1000) <= rate <= 1_000_000 else None
        """What the file says its rate is: for people only, dt comes from stamps."""
        self.frame_count_hint: int | None = stream.frames if stream.frames > 0 else None
        self.start_time_ns, self.start_time_source = start_of(self._container, stream, start_time_ns)

        self._careful = False
        self._pictures = self._decode()
        try:
            first = next(self._pictures, None)
        except Damaged:
            self._open_again(careful=True)
            self._pictures = self._decode()
            first = next(self._pictures, None)
        if first is None:
            self.close()
            why = self.lost.stopped or f"{self.lost.undecodable} packets, none of which is a picture"
            raise SourceError(f"{self.path}: no picture could be decoded ({self.codec}; {why})")
        self._peeked: _Decoded | None = first
        picture = first[0]
        self.pixel_format: str = picture.format.name
        self.interlaced = picture.interlaced_frame
        self.decoded = DecodedPictures(picture)
        """Makes frames of the stream's decoded pictures."""
        self.width_px, self.height_px = self.decoded.width_px, self.decoded.height_px
        self.chroma_note = self.decoded.chroma_note
        self.rotation_deg = self.decoded.orientation.clockwise_deg
        """Clockwise turn, 0, 90, 180 or 270, that the stored picture needs and every Frame has had."""
        aspect = float(self._stream.sample_aspect_ratio or 1)
        aspect = aspect if 0.1 <= aspect <= 10 else 1.0
        self.pixel_aspect = 1 / aspect if self.decoded.orientation.transposed else aspect
        """How much wider than high a pixel of a Frame is, as the stream says; 1 where it says nothing."""
        pts = picture.pts or 0
        free = self._container.format.name in _FREE_RUNNING_CLOCKS
        self.origin_ticks: int | Fraction = pts if free or pts < 0 else 0
        """The time stamp that is at `start_time_ns`; of a chapter of several, one long before its first."""
        self.first_ticks: int = (picture.pts if picture.pts is not None else picture.dts) or 0
        """The first picture's time stamp."""

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
        yield from decoded_once_more(self._frames)

    def _frames(self, careful: bool) -> Iterator[Frame]:
        """All frames of one reading. Raises Damaged unless it is `careful`."""
        if self._peeked is None or careful:
            self._open_again(careful)
            pictures: Iterator[_Decoded] = self._decode()
        else:
            pictures = itertools.chain([self._peeked], self._pictures)
        self._peeked = None
        annex_b = AnnexB(self.codec, self._stream) if self.passthrough_reason is None else None
        clock = _Clock(self._stream, self.origin_ticks, END_OF_TIME_NS - self.start_time_ns)
        for index, (picture, packet) in enumerate(pictures):
            if (picture.width, picture.height) != self.decoded.coded_size:
                was, now = self.decoded.coded_size, (picture.width, picture.height)
                self.lost.stopped = (
                    f"{self.path}: the picture size changes from {was[0]}x{was[1]} to {now[0]}x{now[1]} "
                    f"after {index} pictures; the rest is left out"
                )
                return
            since_start_ns, as_stated = clock.stamp(picture)
            self.lost.restamped += not as_stated
            self.lost.damaged += picture.is_corrupt
            try:
                frame = self.decoded.frame(index, self.start_time_ns + since_start_ns, picture, self._careful)
            except (av.FFmpegError, ValueError) as error:
                self.lost.miss(f"picture {index}: its pixels cannot be converted ({short(error)})")
                continue
            if annex_b is not None and packet is not None:
                frame.encoded = annex_b.message(packet)
            yield frame

    @property
    def time_source(self) -> str:
        """Where the stamps come from."""
        return self.start_time_source

    first_index = 0
    # What only a recording has beside its pictures.
    topic = ""
    calibration_topic: str | None = None
    calibration: Camera | None = None
    frame_id = ""

    @cached_property
    def passthrough_reason(self) -> str | None:
        """Why the stream's packets cannot be handed on as one picture per message; None when they can."""
        if not self._packets_wanted:
            return "packets were not asked for"
        if self.codec not in CODECS:
            return f"the codec is {self.codec}, not h264 or hevc"
        if self.pixel_format not in ("yuv420p", "yuvj420p"):
            return f"the pixel format is {self.pixel_format}, not 8-bit 4:2:0"
        if not self.decoded.orientation.upright:
            return "the picture is stored rotated or mirrored"
        if self.interlaced:
            return "the pictures are interlaced"
        if self._stream.codec_context.has_b_frames:
            return "the stream reorders its pictures (B-frames)"
        return _packets_reason(self.path, self.codec)

    def _open_again(self, careful: bool) -> None:
        """At its start."""
        self._container.close()
        self._container, self._stream = open_video(self.path, careful)
        self._careful = careful

    def _decode(self) -> Iterator[_Decoded]:
        """Decode every packet once and give the pictures in presentation order, each with its packet.

        Packets wait under their time stamp until the picture with that stamp is out: those overtaken, or
        that still wait at the end, never became one. Raises Damaged unless the file was opened `careful`; so a picture
        is held back until all that were decoded before it, from which it may be made, are out and not damaged.
        """
        self.lost = lost = Losses()
        container, stream = self._container, self._stream
        reader = container.demux(stream)
        held = HeldBack[_Decoded]()
        last: tuple[int, bool] | None = None  # time stamp of the latest packet, and whether it is cut short
        errors = pictures_out = 0
        one_to_one = self.codec not in INVISIBLE_PICTURES
        shown = Shown(self.codec)
        ended = False
        while not ended:
            try:
                packet = next(reader)
            except StopIteration:
                break
            except (av.FFmpegError, OSError) as error:
                lost.stopped = f"{self.path}: reading stopped after {pictures_out} pictures ({_short(error)})"
                packet = cast(Packet, av.Packet())  # empty: makes the decoder give what it still holds
                ended = True
            if packet.size and packet.pts is not None:
                last = max(last or (packet.pts, False), (packet.pts, packet.is_corrupt))
                if packet.is_keyframe:
                    shown.key(packet.pts)
            held.goes_in(packet)
            try:
                pictures = stream.codec_context.decode(packet if packet.size else None)
            except (av.FFmpegError, ValueError, MemoryError) as error:
                if not self._careful:
                    raise Damaged from error
                pictures, errors = [], errors + 1
                shown.damaged()
            for picture in pictures:
                if picture.is_corrupt:
                    if not self._careful:
                        raise Damaged
                    shown.damaged()
                pictures_out += 1
                one_to_one = one_to_one and not picture.interlaced_frame
                place, own, overtaken = held.comes_out(picture.pts)
                lost.undecodable += overtaken if one_to_one else 0
                if shown(picture.pts if picture.pts is not None else pictures_out):
                    held.hold(place, (picture, own))
                else:
                    lost.miss("damaged, or made from a damaged one")
                yield from held.ready()
        yield from held.rest()
        if one_to_one:
            lost.undecodable += len(held.packets)
        lost.undecodable = max(lost.undecodable, errors)
        lost.stopped = lost.stopped or _cut_short(self.path, container, stream, last, pictures_out)


def open_video(path: Path, careful: bool = False) -> tuple[av.container.InputContainer, av.VideoStream]:
    """Open a file and pick its video stream; every way this can fail is one SourceError.

    Unless it is `careful`, its decoder stops at the first damage (`set_up_decoder`).
    """
    checked_input(path, "a video")
    try:
        # "file:" keeps FFmpeg from reading a colon in the name as a protocol.
        container = av.open(f"file:{path}", metadata_errors="replace")
    except (av.FFmpegError, OSError, ValueError) as error:
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
    size = (best.codec_context.width, best.codec_context.height)
    if size[0] * size[1] > LARGEST_PX:
        container.close()
        raise SourceError(
            f"{path}: pictures of {size[0]}x{size[1]} are too large ({LARGEST_PX >> 20} million pixels at most)"
        )
    set_up_decoder(best.codec_context, careful)
    for stream in container.streams:
        if stream.index != best.index:
            stream.discard = Discard.all
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


def start_of(
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
        if 0 < created_ns < END_OF_TIME_NS // 2:  # after 2116 it is no time of a camera's
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
    container, stream = open_video(path)
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
                annex_b = AnnexB(codec, stream)
                if not annex_b.message(packet).key or not annex_b.complete:
                    return "it does not begin with a key frame and its parameter sets"
    except (av.FFmpegError, OSError):
        pass  # what is wrong with the file shows, and is counted, when it is decoded
    finally:
        container.close()
    return None if previous is not None else "it has no packets"


class _Clock:
    """Strictly increasing nanoseconds from the pictures' time stamps."""

    def __init__(self, stream: av.VideoStream, origin_ticks: int | Fraction, last_ns: int) -> None:
        """No stamp comes after `last_ns`: one that would has been damaged."""
        self._time_base = stream.time_base or Fraction(1, NS_PER_S)
        usual_ns = int(NS_PER_S / stream.average_rate) if stream.average_rate else NS_PER_S // 1000
        self._usual_ns = min(usual_ns, LONGEST_PICTURE_NS)
        self._origin_ticks = origin_ticks
        self._latest_ns = last_ns - 3600 * NS_PER_S
        self._shift_ns = 0
        self._last_ns: int | None = None

    def stamp(self, picture: av.VideoFrame) -> tuple[int, bool]:
        """The picture's time in ns, and whether it is the one the file states."""
        ticks = picture.pts if picture.pts is not None else picture.dts
        length_ns = ticks_to_ns(picture.duration, self._time_base) if picture.duration else self._usual_ns
        if not 0 < length_ns <= LONGEST_PICTURE_NS:
            length_ns = self._usual_ns
        last, stated = self._last_ns, picture.pts is not None
        if ticks is not None and ticks_to_ns(ticks - self._origin_ticks, self._time_base) > self._latest_ns:
            ticks, stated = None, False
        if ticks is None:
            ns = max(0, ticks_to_ns(-self._origin_ticks, self._time_base)) if last is None else last + length_ns
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
