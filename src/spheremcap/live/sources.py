"""What gives pictures as time goes on: a camera of this machine, a stream, or a video file in real time.

Whoever tracks is given the newest picture. Those that came while it was busy are skipped, and counted.
"""

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import closing
from fractions import Fraction
from pathlib import Path
from urllib.parse import urlsplit

import av

from spheremcap.core.camera import Camera
from spheremcap.core.frame import Frame
from spheremcap.core.time import NS_PER_S, ticks_to_ns
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.picture import DecodedPictures
from spheremcap.io.source import Losses, Source
from spheremcap.io.video import VideoSource

Stop = Callable[[], bool]
STREAMS = ("rtsp", "rtsps")
_STREAM = {"rtsp_transport": "tcp", "probesize": "32"}
"""How FFmpeg opens a stream. By itself it looks at a second of it first, which then comes at once and late."""
_SILENT_S = 10.0
"""A device or stream that gives nothing for so long has ended."""
_TURN_S = 0.05


def open_live(source: str, stop: Stop, seeded: Collection[int], start_time_ns: int | None = None) -> Source:
    """The source that a person named: `camera:0`, `rtsp://…` or a video file. Close it after use.

    Its frames end where `stop` says so. `seeded` are the frames that are not skipped, as somebody gave circles on
    them. `start_time_ns` is for files. Raises SourceError where there are no pictures, UsageError for a camera that
    has no number.
    """
    kind, _, rest = source.partition(":")
    if kind == "camera":
        if not rest.isdecimal():
            raise UsageError(f"{source}: which camera? Expected its number, as in camera:0")
        return DeviceSource(f"camera {int(rest)}", *_device(int(rest)), stop, seeded)
    if kind in STREAMS:
        return DeviceSource(f"{kind} {urlsplit(source).hostname}", source, None, stop, seeded)
    return PacedVideo(Path(source), stop, seeded, start_time_ns)


class PacedVideo(VideoSource):
    """A video file that gives its pictures when they are due, as a camera would."""

    def __init__(self, path: Path, stop: Stop, seeded: Collection[int], start_time_ns: int | None = None) -> None:
        super().__init__(path, start_time_ns=start_time_ns, packets=False)
        self._stop, self._seeded = stop, seeded

    def frames(self) -> Generator[Frame, None, None]:
        """Those frames that are newest when they are asked for."""
        with closing(newest(self._paced(), self._stop, self._seeded, self._skip)) as frames:
            yield from frames

    def _paced(self) -> Iterator[Frame]:
        began: tuple[float, int] | None = None
        for frame in super().frames():
            began = began or (time.monotonic(), frame.stamp_ns)
            due = began[0] + (frame.stamp_ns - began[1]) / NS_PER_S
            while (left_s := due - time.monotonic()) > 0:
                if self._stop():
                    return
                time.sleep(min(left_s, _TURN_S))
            yield frame

    def _skip(self) -> None:
        self.lost.skipped += 1


class DeviceSource:
    """A camera or stream that FFmpeg opens; the first picture's stamp is this machine's clock, and the stream's own
    time counts from there (of an RTSP stream, whose first picture has no time of its own, from the second). `name` is
    what the recording and errors call it: an address may hold a password.
    """

    topic = ""
    calibration_topic: str | None = None
    calibration: Camera | None = None
    frame_id = ""
    first_index = 0
    frame_count_hint: int | None = None
    passthrough_reason: str | None = "the pictures are live"
    time_source = "this machine's clock at the first picture"

    def __init__(self, name: str, address: str, kind: str | None, stop: Stop, seeded: Collection[int]) -> None:
        self.path = Path(name)
        self.lost = Losses()
        self._stop, self._seeded = stop, seeded
        options = _STREAM if kind is None and address.startswith(STREAMS) else {}
        try:
            self._container = av.open(address, format=kind, options=options, timeout=_SILENT_S)
        except (av.FFmpegError, OSError, ValueError) as error:
            raise SourceError(f"{name}: cannot be opened: {_reason(error)}") from None
        try:
            self._stream = self._container.streams.video[0]
            self._pictures = self._container.decode(self._stream)
            self._first = next(self._pictures)
        except (av.FFmpegError, OSError, IndexError, StopIteration) as error:
            self._container.close()
            raise SourceError(f"{name}: gives no picture: {_reason(error)}") from None
        self._began_ns = time.time_ns()
        self.codec: str = self._stream.codec_context.codec.canonical_name
        rate = self._stream.average_rate
        self.stated_rate: Fraction | None = rate if rate and Fraction(1, 1000) <= rate <= 1_000_000 else None
        self._decoded = DecodedPictures(self._first)
        self.width_px, self.height_px = self._decoded.width_px, self._decoded.height_px
        self.chroma_note = self._decoded.chroma_note
        self.pixel_aspect = float(self._stream.sample_aspect_ratio or 1)

    def close(self) -> None:
        """Let go of the camera; frames already given stay valid."""
        self._container.close()

    def frames(self) -> Generator[Frame, None, None]:
        """Those frames that are newest when they are asked for; `lost` is complete at their end."""
        with closing(newest(self._taken(), self._stop, self._seeded, self._skip)) as frames:
            yield from frames

    def _taken(self) -> Iterator[Frame]:
        first, last_ns = self._first, -1
        known = None if first.pts is None else (self._began_ns, first.pts)  # a moment by both clocks
        yield self._frame(0, self._began_ns, first)
        for index in range(1, sys.maxsize):
            try:
                picture = next(self._pictures)
            except StopIteration:
                return
            except (av.FFmpegError, OSError) as error:
                self.lost.stopped = f"{self.path}: reading stopped after {index} pictures: {_reason(error)}"
                return
            if (picture.width, picture.height) != self._decoded.coded_size:
                self.lost.stopped = (
                    f"{self.path}: the picture size changes after {index} pictures; the rest is left out"
                )
                return
            stamp_ns = time.time_ns()
            if picture.pts is not None and picture.time_base is not None:
                known = known or (stamp_ns, picture.pts)
                stamp_ns = known[0] + ticks_to_ns(picture.pts - known[1], picture.time_base)
            if stamp_ns <= last_ns:
                stamp_ns = last_ns + 1
                self.lost.restamped += 1
            last_ns = stamp_ns
            yield self._frame(index, stamp_ns, picture)

    def _frame(self, index: int, stamp_ns: int, picture: av.VideoFrame) -> Frame:
        return self._decoded.frame(index, stamp_ns, picture, False)

    def _skip(self) -> None:
        self.lost.skipped += 1


def newest(
    frames: Iterator[Frame], stop: Stop, seeded: Collection[int], skip: Callable[[], None]
) -> Generator[Frame, None, None]:
    """Frames that a thread takes as they come, until `stop` says so; `skip` is called for each that is passed over.

    A seeded one waits, and so do those that come behind it no longer than until a newer one comes. What `frames`
    raises comes out at its place. Closing this waits for the thread.
    """
    waiting: deque[Frame] = deque()
    there = threading.Condition()
    ended = left = False
    failed: list[BaseException] = []

    def take() -> None:
        nonlocal ended
        try:
            for frame in frames:
                with there:
                    if left or stop():
                        return
                    if waiting and waiting[-1].index not in seeded:
                        waiting.pop()
                        skip()
                    waiting.append(frame)
                    there.notify()
        except BaseException as error:
            failed.append(error)
        finally:
            with there:
                ended = True
                there.notify()

    thread = threading.Thread(target=take, name="camera")
    thread.start()
    try:
        while not stop():
            with there:
                if not waiting and not ended:
                    there.wait(_TURN_S)
                if waiting:
                    frame = waiting.popleft()
                elif ended:
                    break
                else:
                    continue
            yield frame
        if failed:
            raise failed[0]
    finally:
        left = True
        thread.join()


def _device(number: int) -> tuple[str, str]:
    """FFmpeg's address and format of a camera of this machine."""
    if sys.platform == "darwin":
        return str(number), "avfoundation"
    if sys.platform == "win32":
        raise UsageError("camera:N is for Linux and macOS; give an rtsp:// address")
    return f"/dev/video{number}", "v4l2"


def _reason(error: BaseException) -> str:
    """What an error says, without the address, in which a password may stand."""
    return str(getattr(error, "strerror", None) or type(error).__name__)
