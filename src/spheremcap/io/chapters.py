"""A video in several files, as cameras write long ones, as one: frames and their times go on from file to file.

The first frame of a chapter comes when the last one of the chapter before ends, by the containers' own stamps and
durations, whatever of it could be decoded; fractions of a nanosecond are carried on.
"""

import os
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from itertools import islice, pairwise
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import av
import av.container

from spheremcap.core.camera import Camera
from spheremcap.core.frame import Frame
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import SourceError
from spheremcap.io.chapter_list import chapters_in as chapters_in
from spheremcap.io.chapter_list import is_list as is_list
from spheremcap.io.chapter_list import write_list as write_list
from spheremcap.io.source import Losses
from spheremcap.io.video import END_OF_TIME_NS, LONGEST_PICTURE_NS, VideoSource, open_video

_APART_S = 2
"""Creation times are whole seconds, and not taken at the first picture: by more than this, something is missing."""


class Chapters:
    """The videos that a list names as one, in its order; also a context manager. No two are open at the same time.

    The time zero is that of the first chapter, as for VideoSource, which says what `start_time_ns` and `packets` are.
    Raises SourceError for a list or a chapter that cannot be read, and for chapters that do not fit together.
    """

    first_index = 0
    topic = ""
    calibration_topic: str | None = None
    calibration: Camera | None = None
    frame_id = ""
    interlaced: bool
    _shape: str

    def __init__(self, path: str | os.PathLike[str], *, start_time_ns: int | None = None, packets: bool = True) -> None:
        self.path = Path(path)
        self.files = tuple(chapters_in(self.path))
        self._packets_wanted = packets
        self.lost: Losses = _Lost()
        created: list[tuple[Path, int, Fraction]] = []
        self._origins: list[int | Fraction] = []
        self._codecs: list[tuple[str, str]] = []
        hints: list[int | None] = []
        after_s = Fraction(0)
        for file in self.files:
            with VideoSource(file, packets=False) as source:
                extent = _extent(file)
                if not self._origins:
                    self._take(source, start_time_ns)
                elif _shape(source) != self._shape:
                    raise SourceError(
                        f"{self.path}: {file} is {_shape(source)}, {self.files[0]} is {self._shape}: "
                        "chapters of one video are alike; track them each by itself"
                    )
                if source.start_time_source == "creation-time":
                    created.append((file, source.start_time_ns, after_s))
                origin: int | Fraction = source.origin_ticks
                if self._origins:
                    origin = min(source.first_ticks, extent.begin) - after_s / extent.time_base
                self._origins.append(origin)
                self._codecs.append((source.codec, source.pixel_format))
                self.interlaced = self.interlaced or source.interlaced
                hints.append(source.frame_count_hint)
                after_s = Fraction(extent.end - origin) * extent.time_base
        self.notes = _contradictions(created)
        """Where the chapters' own times say that they do not follow one another, a line each."""
        known = [hint for hint in hints if hint is not None]
        self.frame_count_hint: int | None = sum(known) if len(known) == len(hints) else None

    def _take(self, source: VideoSource, start_time_ns: int | None) -> None:
        """What the first chapter says for all."""
        self.codec, self.pixel_format, self.interlaced = source.codec, source.pixel_format, False
        self.stated_rate = source.stated_rate
        self.width_px, self.height_px, self.pixel_aspect = source.width_px, source.height_px, source.pixel_aspect
        self.rotation_deg, self.chroma_note = source.rotation_deg, source.chroma_note
        self.start_time_ns = source.start_time_ns if start_time_ns is None else start_time_ns
        self.start_time_source = source.start_time_source if start_time_ns is None else "start-time"
        self._shape, self._decoded = _shape(source), source.decoded

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """A chapter is open only while its frames are read."""

    @property
    def time_source(self) -> str:
        """Where the stamps come from."""
        return self.start_time_source

    @cached_property
    def passthrough_reason(self) -> str | None:
        """Why the packets cannot be handed on as one picture per message; None when those of all chapters can."""
        if not self._packets_wanted:
            return "packets were not asked for"
        for file, (codec, _) in zip(self.files, self._codecs, strict=True):
            if codec != self.codec:
                return f"the codec of {file.name} is {codec}, that of {self.files[0].name} {self.codec}"
        for file in self.files:
            with VideoSource(file) as source:
                if source.passthrough_reason is not None:
                    return f"{file.name}: {source.passthrough_reason}"
        return None

    def chapters(self) -> Iterator[VideoSource]:
        """Each chapter, open until the next one is asked for, with stamps on the time line of all and indices of its
        own."""
        for number in range(len(self.files)):
            with self._opened(number, False) as source:
                yield source

    def _opened(self, number: int, packets: bool) -> VideoSource:
        source = VideoSource(self.files[number], start_time_ns=self.start_time_ns, packets=packets)
        source.origin_ticks = self._origins[number]
        if self._codecs[number] == self._codecs[0]:
            source.decoded = self._decoded
        return source

    def frames(self) -> Generator[Frame, None, None]:
        """All frames, chapter after chapter, as VideoSource gives them; `lost` is complete at the end. Calling again
        starts over."""
        self.lost = lost = _Lost(file=list(self.notes))
        packets = self.passthrough_reason is None
        before = 0
        for number, file in enumerate(self.files):
            with self._opened(number, packets) as source:
                if packets:
                    source.passthrough_reason = None  # known: it need not read its file once more
                count = 0
                try:
                    for frame in source.frames():
                        count = frame.index + 1
                        frame.index += before
                        yield frame
                finally:
                    lost.add(file, source.lost)
                before += count


@dataclass
class _Lost(Losses):
    """The sum of what chapters lost, told for each of them."""

    chapters: list[tuple[Path, Losses]] = field(default_factory=list)

    def add(self, file: Path, lost: Losses) -> None:
        self.chapters.append((file, lost))
        self.undecodable += lost.undecodable
        self.damaged += lost.damaged
        self.restamped += lost.restamped
        self.stopped = self.stopped or lost.stopped
        self.first_reason = self.first_reason or lost.first_reason

    def lines(self) -> list[str]:
        """One line per chapter and kind of loss, for a person."""
        told = [(file, line) for file, lost in self.chapters for line in lost.lines()]
        return self.file + [line if line.startswith(str(file)) else f"{file}: {line}" for file, line in told]


def _shape(source: VideoSource) -> str:
    """What is alike in all chapters: size, orientation and shape of pixels."""
    (width, height), turn = source.decoded.coded_size, source.decoded.orientation
    return (
        f"{width}x{height}"
        + (f" shown {turn.clockwise_deg} degrees clockwise" if turn.clockwise_deg else "")
        + (" mirrored" if turn.transposed ^ turn.flip_x ^ turn.flip_y else "")
        + (f" with pixels {source.pixel_aspect:.6g} times as wide as high" if source.pixel_aspect != 1 else "")
    )


def _contradictions(created: list[tuple[Path, int, Fraction]]) -> list[str]:
    """A line for each two chapters whose creation times are not apart as they are; `created` are these times and how
    long after the first chapter they begin, s. One that has the first's time says nothing by it."""
    own = [one for number, one in enumerate(created) if number == 0 or one[1] != created[0][1]]
    lines = []
    for (before, was_ns, was_s), (file, now_ns, now_s) in pairwise(own):
        late_s = float(Fraction(now_ns - was_ns, NS_PER_S) - (now_s - was_s))
        if abs(late_s) > _APART_S:
            apart = f"{abs(late_s):.0f} s {'later' if late_s > 0 else 'earlier'}"
            lines.append(
                f"by the creation times {file} comes {apart} than it follows {before}: "
                "is a chapter missing, or are they in another order?"
            )
    return lines


class _Extent(NamedTuple):
    """From the first picture's time stamp to the end of the last, in ticks of `time_base` seconds."""

    begin: int
    end: int | Fraction
    time_base: Fraction


def _extent(path: Path) -> _Extent:
    """By the packets: an MP4's first and last ones, all of other files. Raises SourceError where they do not say."""
    container, stream = open_video(path)
    with container:
        time_base = stream.time_base or Fraction(1, NS_PER_S)
        indexed = container.format.name.startswith("mov") and len(stream.index_entries) > 0
        begin, last = _stamps(container, stream, most=1 if indexed else None)
        if indexed:
            last = _stamps(container, stream, stream.index_entries[-1].timestamp)[1]
            if last is None:  # of a file that was cut before
                last = _stamps(container, stream, stream.index_entries[0].timestamp)[1]
        usual = 1 / stream.average_rate / time_base if stream.average_rate else Fraction(1, 1000) / time_base
    if begin is None or last is None or last[0] * time_base * NS_PER_S > END_OF_TIME_NS // 2:
        raise SourceError(
            f"{path}: its time stamps do not say when it ends, so nothing can follow it; "
            "put it into an MP4 first, as in ffmpeg -i IN -c copy OUT.mp4"
        )
    length = last[1] if 0 < last[1] * time_base * NS_PER_S <= LONGEST_PICTURE_NS else usual
    return _Extent(begin, last[0] + length, time_base)


def _stamps(
    container: av.container.InputContainer, stream: av.VideoStream, at: int | None = None, most: int | None = None
) -> tuple[int | None, tuple[int, int] | None]:
    """Time stamp of the first packet from the key frame before `at` on (None: from where the container is), and stamp
    and duration of the last one shown, of as many as `most`. None where there is none; the last one also where the
    clock starts again on the way."""
    begin: int | None = None
    last: tuple[int, int] | None = None
    clock: int | None = None
    a_second = 1 / (stream.time_base or Fraction(1, NS_PER_S))
    shown = (packet for packet in container.demux(stream) if packet.size and not packet.is_discard)
    try:
        if at is not None:
            container.seek(at, stream=stream)
        for packet in islice(shown, most):
            stamp = packet.pts if packet.pts is not None else packet.dts
            if stamp is None:
                continue
            if packet.dts is not None:
                if clock is not None and clock - packet.dts > a_second:
                    return begin, None
                clock = packet.dts
            begin = stamp if begin is None else begin
            last = max(last or (stamp, 0), (stamp, packet.duration or 0))
    except (av.FFmpegError, OSError):
        pass  # what is wrong with the file shows, and is counted, when it is decoded
    return begin, last
