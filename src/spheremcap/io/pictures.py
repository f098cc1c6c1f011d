"""Any picture of an input by its index: the very frame that its source gives when it is read from the start.

A picture is decoded from the key frame before it, and those on the way stay decoded as long as there is room, so that
a step to a neighbour, backwards too, costs nothing. Opening reads one picture and the container's index.
"""

import os
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Protocol, Self, TypeVar

from spheremcap.core.camera import Camera
from spheremcap.core.frame import BgrFrame, Frame, YuvFrame
from spheremcap.errors import UsageError
from spheremcap.io.chapters import Chapters
from spheremcap.io.folder import PictureFolder
from spheremcap.io.mcap_images import McapImageSource, TimeBase
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.source import Source
from spheremcap.io.sources import FromMcap, open_input
from spheremcap.io.video import VideoSource
from spheremcap.io.video_index import DecodedIndex, JoinedIndex, NotAsIndexed, index_of

HELD_BYTES = 96 << 20
"""Decoded pictures that are kept: 70 of 1280x720."""
_Answer = TypeVar("_Answer")


class _Index(Protocol):
    """What each kind of input knows of its pictures. Frames come at most `reordered` after later ones."""

    reordered: int

    @property
    def count(self) -> int: ...

    def key_at(self, index: int) -> int: ...

    def stamp_ns(self, index: int) -> int: ...

    def frames_from(self, key: int) -> Iterator[Frame]: ...

    def close(self) -> None: ...


class Pictures:
    """The pictures of a video, a folder or an image topic by index; a context manager. One thread at a time.

    Indices and stamps are those of the input's frames read in order: `first_index` ... `count` - 1, where some may be
    missing in a folder or a damaged recording. What a decoder patched looks the same each time that it is looked up,
    but may not look as when read in order. `source` is what was opened, for its size, rate and calibration.
    """

    def __init__(self, source: Source, index: _Index, files: ExitStack, held_bytes: int) -> None:
        self.source = source
        self.width_px, self.height_px = source.width_px, source.height_px
        self.first_index = source.first_index
        self.held_bytes = held_bytes
        """Of decoded pictures that are kept."""
        self._index, self._files = index, files
        self._held: OrderedDict[int, Frame] = OrderedDict()
        self._bytes = 0
        self._running: Iterator[Frame] = iter(())
        self._last: int | None = None  # index of the frame that `_running` gave last

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; frames already given stay valid."""
        self._index.close()
        self._files.close()
        self._running = iter(())
        self._held.clear()
        self._bytes = 0

    @property
    def path(self) -> Path:
        """What was opened."""
        return self.source.path

    @property
    def calibration(self) -> Camera | None:
        """The camera found beside the pictures; None when there is none."""
        return self.source.calibration

    @property
    def count(self) -> int:
        """One more than the last index."""
        return self._index.count

    def stamp_ns(self, index: int) -> int:
        """When a picture was taken, as its frame says. Raises UsageError for an index that there is not."""
        self._check(index)
        return self._known(lambda: self._index.stamp_ns(index))

    def index_at(self, stamp_ns: int) -> int:
        """The last picture taken at that time or before it; the first one where there is none."""
        indices = range(self.first_index, self.count)
        return max(self.first_index, indices.start + bisect_right(indices, stamp_ns, key=self.stamp_ns) - 1)

    def key_at(self, index: int) -> int:
        """The nearest picture, that one or one before it, which is decoded without any other."""
        self._check(index)
        return max(self.first_index, self._known(lambda: self._index.key_at(index)))

    def holds(self, index: int) -> bool:
        """Whether the frame is decoded already."""
        return index in self._held

    def frame(self, index: int, stop: Callable[[], bool] = lambda: False) -> Frame | None:
        """The frame with that index; None where it could not be decoded, and where `stop`, asked before each frame on
        the way, said so (what was decoded until then is kept). Raises UsageError for an index that there is not.
        """
        self._check(index)
        return self._known(lambda: self._decoded(index, stop))

    def _decoded(self, index: int, stop: Callable[[], bool]) -> Frame | None:
        if index in self._held:
            self._held.move_to_end(index)
            return self._held[index]
        key = self._index.key_at(index)
        if self._last is None or not key <= self._last + 1 <= index:
            self._running, self._last = self._index.frames_from(key), None
        while not stop():
            frame = next(self._running, None)
            if frame is None:
                self._last = None
                return None
            self._keep(frame)
            self._last = frame.index
            if frame.index == index:
                return frame
            if frame.index > index + self._index.reordered:
                return None
        return None

    def _keep(self, frame: Frame) -> None:
        before = self._held.pop(frame.index, None)
        self._held[frame.index] = frame
        self._bytes += _size(frame) - (_size(before) if before is not None else 0)
        while self._bytes > self.held_bytes and len(self._held) > 1:
            self._bytes -= _size(self._held.popitem(last=False)[1])

    def _check(self, index: int) -> None:
        if not self.first_index <= index < self.count:
            raise UsageError(
                f"{self.path}: there is no frame {index}: {self.first_index} to {self.count - 1} are there"
            )

    def _known(self, ask: Callable[[], _Answer]) -> _Answer:
        """An answer of the index; of a video whose packets turn out to be no pictures, of what decoding it says."""
        while True:
            try:
                return ask()
            except NotAsIndexed:
                self._held.clear()
                self._bytes, self._last = 0, None
                if isinstance(self.source, VideoSource):
                    self._index.close()
                    self._index = DecodedIndex(self.source)


def open_pictures(
    path: str | os.PathLike[str],
    *,
    topic: str | None = None,
    time: TimeBase = "header",
    start_time_ns: int | None = None,
    rate: Fraction | None = None,
    held_bytes: int = HELD_BYTES,
) -> Pictures:
    """Open a video, the list of several, a folder of pictures or an image topic of a recording for looking up pictures
    by index.

    `topic` and `time` are for recordings (None: the only image topic there is), `rate` for folders, `start_time_ns` for
    both but recordings, as in `open_input`. No more than `held_bytes` of decoded pictures are kept, but always one. A
    packet in the middle of a video that turns out to be no picture is met when it is decoded; from then on `count` and
    all indices behind it are those of the pictures that there are.
    Raises SourceError for what cannot be read, UsageError where something has to be said.
    """
    given = Path(path)
    choice = FromMcap((topic,) if topic is not None else (), time) if topic is not None or time != "header" else None
    with ExitStack() as files:
        opened = files.enter_context(open_input(given, choice, start_time_ns=start_time_ns, rate=rate, packets=False))
        source = opened.views[0].source
        index: _Index
        if isinstance(source, McapImageSource):
            assert opened.records is not None
            index = _Messages(source, opened.records)
        elif isinstance(source, PictureFolder):
            index = _Numbered(source)
        elif isinstance(source, Chapters):
            index = JoinedIndex(source.chapters())
        else:
            assert isinstance(source, VideoSource)
            index = index_of(source)
        return Pictures(source, index, files.pop_all(), held_bytes)


def recorded_pictures(records: McapRecords, topic: str, time: TimeBase, held_bytes: int = HELD_BYTES) -> Pictures:
    """The pictures of an image topic of a recording that is open already, and that somebody else closes."""
    source = McapImageSource(records, topic, time=time)
    return Pictures(source, _Messages(source, records), ExitStack(), held_bytes)


class _Numbered:
    """The pictures of a folder by what their numbers stand for."""

    reordered = 0

    def __init__(self, source: PictureFolder) -> None:
        self._source = source
        self.count = source.frame_count_hint

    def close(self) -> None:
        """Nothing is open between two pictures."""

    def key_at(self, index: int) -> int:
        return index

    def stamp_ns(self, index: int) -> int:
        return self._source.stamp_ns(index)

    def frames_from(self, key: int) -> Iterator[Frame]:
        return self._source.frames(key)


class _Messages:
    """The pictures of an image topic by the numbers of their messages."""

    reordered = 16  # the most pictures that a stream may store before one that is shown earlier

    def __init__(self, source: McapImageSource, records: McapRecords) -> None:
        self._source = source
        source.forget_first()
        self._messages = records.index_of(source.topic)
        self.count = len(self._messages)
        self._keys: dict[int, bool] = {}

    def close(self) -> None:
        """The recording is closed by whoever opened it."""

    def stamp_ns(self, index: int) -> int:
        return self._source.stamp_ns(self._messages.message(index))

    def key_at(self, index: int) -> int:
        """Without a key frame before it, the first message."""
        while index > 0 and not self._is_key(index):
            index -= 1
        return index

    def _is_key(self, index: int) -> bool:
        if index not in self._keys:
            self._keys[index] = self._source.is_key(self._messages.message(index))
        return self._keys[index]

    def frames_from(self, key: int) -> Iterator[Frame]:
        return self._source.frames_of((i, self._messages.message(i)) for i in range(key, self.count))


def _size(frame: Frame) -> int:
    """Bytes of its pixels."""
    if isinstance(frame, YuvFrame):
        return frame.y.nbytes + sum(plane.nbytes for plane in frame.uv)
    return frame.image.nbytes if isinstance(frame, BgrFrame) else 3 * frame.width_px * frame.height_px
