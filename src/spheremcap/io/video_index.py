"""Which packet of a video file is which picture, so that any of them is decoded from its key frame alone.

An MP4's own index is believed for where the packets are; where pictures are stored in another order than they are
shown, a group of pictures says its own time stamps once it is looked at. Files of other kinds have their packets gone
through once, undecoded. A picture of which a file that was cut has only a part is not counted. What is not told by
packets (no time stamps, a packet without a picture, a clock that starts again) is learnt by decoding the file once, and
its pictures are decoded from the start: slow, and right.
"""

import itertools
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, TypeVar

import av
import numpy as np
import numpy.typing as npt

from spheremcap.core.frame import Frame
from spheremcap.core.time import NS_PER_S, ticks_to_ns
from spheremcap.io.annex_b import Packet
from spheremcap.io.picture import UNCONCEALED, Damaged, HeldBack, decoded_once_more
from spheremcap.io.video import END_OF_TIME_NS, INVISIBLE_PICTURES, VideoSource, open_video

_Ints = npt.NDArray[np.int64]
_Flags = npt.NDArray[np.bool_]
_Answer = TypeVar("_Answer")


class NotAsIndexed(Exception):
    """The pictures are others than the packets said."""


class _Group(NamedTuple):
    """A key frame and what is stored behind it up to the next: time stamps of those that are shown, in stored order."""

    key_pts: int
    shown: tuple[int, ...]


class PacketIndex:
    """The pictures of a video file by index, by its packets. Raises NotAsIndexed where they do not tell.

    `count` is how many there are. Not for several threads.
    """

    reordered = 0

    def __init__(self, source: VideoSource) -> None:
        self._source = source
        self._file, self._beside = _File(source.path), _File(source.path)
        self._time_base = self._file.stream.time_base or Fraction(1, NS_PER_S)
        try:
            if source.codec in INVISIBLE_PICTURES or source.interlaced:
                raise NotAsIndexed
            self._stored, self._pts, key, self._shown = self._by_index() or self._by_packets()
            if not len(key) or not key[0]:
                raise NotAsIndexed
            self._keys = np.flatnonzero(key)
            before = np.concatenate([[0], np.cumsum(self._shown)])
            self.count = int(before[-1])
            self._shown_before: list[int] = before[np.append(self._keys, len(key))].tolist()
            """How many shown pictures are stored before each key frame, and before the end."""
            self._group = lru_cache(256)(self._read_group)
            if not self.count or self._leading(0):
                raise NotAsIndexed
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; frames already given stay valid."""
        self._file.close()
        self._beside.close()

    def key_at(self, index: int) -> int:
        """The picture that has to be decoded first for that one: the key frame before it, or the picture itself."""
        return self._first(self._group_of(index))

    def stamp_ns(self, index: int) -> int:
        """When the picture was taken."""
        group = self._group_of(index)
        return self._stamp_ns(self._in_order(group)[index - self._first(group)])

    def frames_from(self, key: int) -> Iterator[Frame]:
        """Frames from a key frame on, to the end of the file. Raises NotAsIndexed at the first that is none of them."""
        group = self._group_of(key)
        index, key_pts, source = self._first(group), self._group(group).key_pts, self._source
        expected = itertools.chain.from_iterable(map(self._in_order, range(group, len(self._keys))))
        for picture, careful in self._decoded(group):
            if picture.pts is not None and picture.pts < key_pts:
                continue  # shown before the key frame: they hang on the group before
            if index == self.count:
                return  # of a file that was cut: the part of a picture at its end
            if picture.pts is None or picture.pts != next(expected, None):
                raise NotAsIndexed
            if (picture.width, picture.height) != source.decoded.coded_size:
                return
            yield source.decoded.frame(index, self._stamp_ns(picture.pts), picture, careful)
            index += 1
        if index != self.count:
            raise NotAsIndexed

    # --- what the file says of its packets ---

    def _by_index(self) -> tuple[_Ints, _Ints | None, _Flags, _Flags] | None:
        """By the container's index, of a container that has a whole one: stored order's stamps, time stamps where they
        are the same, keys, and which are shown."""
        stream = self._file.stream
        entries, name = stream.index_entries, self._file.container.format.name
        if not name.startswith("mov") or not stream.frames or not len(entries):
            return None
        size = self._source.path.stat().st_size
        rows = [(e.timestamp, e.is_keyframe, not e.is_discard) for e in entries if e.pos + e.size <= size]
        first = next((p for p in self._file.container.demux(stream) if p.size), None)
        if first is None or not rows:
            return None
        stored = np.array([row[0] for row in rows], np.int64)
        key, shown = np.array([row[1] for row in rows]), np.array([row[2] for row in rows])
        in_order = not stream.codec_context.has_b_frames and first.pts == first.dts
        if not np.all(np.diff(stored) > 0):
            return None
        return stored, stored if in_order else None, key, shown

    def _by_packets(self) -> tuple[_Ints, _Ints, _Flags, _Flags]:
        """By going through all packets once."""
        self._file.open_again()
        pts, key, shown = array("q"), array("b"), array("b")
        try:
            for packet in self._file.container.demux(self._file.stream):
                if packet.size:
                    if packet.pts is None:
                        raise NotAsIndexed
                    pts.append(packet.pts)
                    key.append(packet.is_keyframe)
                    shown.append(not packet.is_discard)
        except (av.FFmpegError, OSError):
            pass  # the rest cannot be read, by whoever decodes neither
        stamps = np.frombuffer(pts, np.int64)
        if len(np.unique(stamps)) != len(stamps):
            raise NotAsIndexed
        return stamps, stamps, np.frombuffer(key, np.bool_), np.frombuffer(shown, np.bool_)

    # --- groups ---

    def _group_of(self, index: int) -> int:
        group = bisect_right(self._shown_before, index, hi=len(self._keys)) - 1
        while group > 0 and index < self._first(group):
            group -= 1
        return group

    def _first(self, group: int) -> int:
        """Index of the group's first picture from its key frame on."""
        return self._shown_before[group] + self._leading(group)

    def _leading(self, group: int) -> int:
        """How many pictures stored behind the key frame are shown before it."""
        key_pts, shown = self._group(group)
        return sum(pts < key_pts for pts in shown)

    def _in_order(self, group: int) -> list[int]:
        """Time stamps of the pictures from the group's key frame up to the next one's, as they are shown."""
        key_pts, shown = self._group(group)
        stamps = [pts for pts in shown if pts >= key_pts]
        if group + 1 < len(self._keys):
            next_pts, behind = self._group(group + 1)
            stamps += [pts for pts in behind if pts < next_pts]
        return sorted(stamps)

    def _read_group(self, group: int) -> _Group:
        start = int(self._keys[group])
        end = int(self._keys[group + 1]) if group + 1 < len(self._keys) else len(self._stored)
        if self._pts is not None:
            pts = self._pts[start:end]
            return _Group(int(pts[0]), tuple(pts[self._shown[start:end]].tolist()))
        found: list[int] = []
        key_pts: int | None = None
        for packet in itertools.islice(self._packets_from(group, self._beside), end - start):
            if packet.pts is None:
                raise NotAsIndexed
            key_pts = packet.pts if key_pts is None else key_pts
            if not packet.is_discard:
                found.append(packet.pts)
        if key_pts is None or len(set(found)) != len(found):
            raise NotAsIndexed
        return _Group(key_pts, tuple(found))

    # --- decoding ---

    def _stamp_ns(self, pts: int) -> int:
        since_start_ns = ticks_to_ns(pts - self._source.origin_ticks, self._time_base)
        if not 0 <= since_start_ns <= END_OF_TIME_NS - self._source.start_time_ns - 3600 * NS_PER_S:
            raise NotAsIndexed
        return self._source.start_time_ns + since_start_ns

    def _packets_from(self, group: int, file: "_File") -> Iterator[Packet]:
        by_pts = self._pts is self._stored
        return file.packets_from(int(self._stored[self._keys[group]]), by_pts, int(1 / self._time_base))

    def _decoded(self, group: int) -> Iterator[tuple[av.VideoFrame, bool]]:
        """Pictures from a group's key frame on, and whether a careful decoder made them."""

        def read(careful: bool) -> Iterator[tuple[av.VideoFrame, bool]]:
            if careful and self._source.codec in UNCONCEALED:
                raise NotAsIndexed  # some of its pictures are not shown
            file = _File(self._source.path, careful) if careful else self._file
            held = HeldBack[tuple[av.VideoFrame, bool]]()
            try:
                for packet in self._packets_from(group, file):
                    held.goes_in(packet)
                    try:
                        pictures = file.stream.codec_context.decode(packet if packet.size else None)
                    except (av.FFmpegError, ValueError, MemoryError):
                        raise (NotAsIndexed if careful else Damaged) from None
                    for picture in pictures:
                        if picture.is_corrupt and not careful:
                            raise Damaged
                        place, _, _ = held.comes_out(picture.pts)
                        held.hold(place, (picture, careful))
                        yield from held.ready()
                yield from held.rest()
            finally:
                if careful:
                    file.close()

        yield from decoded_once_more(read)


class _File:
    """An open file: pictures are decoded from one while the packets ahead are looked at in another."""

    def __init__(self, path: Path, careful: bool = False) -> None:
        self._path, self._careful = path, careful
        self.container, self.stream = open_video(path, careful)

    def close(self) -> None:
        self.container.close()

    def open_again(self) -> None:
        """At its start."""
        self.close()
        self.container, self.stream = open_video(self._path, self._careful)

    def packets_from(self, stamp: int, by_pts: bool, second: int) -> Iterator[Packet]:
        """The packets from the one with that pts (or dts) on. A container that lands behind it, `second` ticks to a
        second, is asked for an earlier place. Raises NotAsIndexed when there is none.
        """
        for earlier in (0, second, 10 * second, None):
            if earlier is None:
                self.open_again()
            else:
                try:
                    self.container.seek(stamp - earlier, stream=self.stream)
                except (av.FFmpegError, OSError):
                    continue
            found = False
            try:
                for packet in self.container.demux(self.stream):
                    at = packet.pts if by_pts else packet.dts
                    found = found or (packet.size > 0 and at == stamp)
                    if found:
                        yield packet
                    elif packet.is_keyframe and at is not None and at > stamp:
                        break
            except (av.FFmpegError, OSError):
                pass
            if found:
                return
        raise NotAsIndexed


class DecodedIndex:
    """The same for a file that has to be decoded to know: once at the start, and from there again for each picture."""

    reordered = 0

    def __init__(self, source: VideoSource) -> None:
        self._source = source
        with self._opened() as whole:
            self._stamps = {frame.index: frame.stamp_ns for frame in whole.frames()}
        self.count = max(self._stamps) + 1

    def close(self) -> None:
        """Nothing is open between two pictures."""

    def key_at(self, index: int) -> int:
        """Always the first picture."""
        return 0

    def stamp_ns(self, index: int) -> int:
        """When the picture was taken; of one that could not be had, the one before it."""
        while index > 0 and index not in self._stamps:
            index -= 1
        return self._stamps[index]

    def frames_from(self, key: int) -> Iterator[Frame]:
        """All frames."""
        with self._opened() as source:
            yield from source.frames()

    def _opened(self) -> VideoSource:
        again = VideoSource(self._source.path, start_time_ns=self._source.start_time_ns, packets=False)
        again.origin_ticks, again.decoded = self._source.origin_ticks, self._source.decoded
        return again


def index_of(source: VideoSource) -> PacketIndex | DecodedIndex:
    """By the packets where they tell, else by decoding."""
    try:
        return PacketIndex(source)
    except NotAsIndexed:
        return DecodedIndex(source)


class JoinedIndex:
    """The pictures of several videos numbered on from one to the next, each by its own index.

    One whose packets turn out to be no pictures is learnt by decoding before NotAsIndexed is raised: ask again.
    """

    reordered = 0

    def __init__(self, sources: Iterable[VideoSource]) -> None:
        self._sources: list[VideoSource] = []
        self._parts: list[PacketIndex | DecodedIndex] = []
        try:
            for source in sources:
                self._sources.append(source)
                self._parts.append(index_of(source))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the files; frames already given stay valid."""
        for part in self._parts:
            part.close()

    @property
    def count(self) -> int:
        return self._begins[-1]

    @property
    def _begins(self) -> list[int]:
        """Index of each part's first picture, and of the one behind the last."""
        return list(itertools.accumulate((part.count for part in self._parts), initial=0))

    def key_at(self, index: int) -> int:
        """The picture of the same part that has to be decoded first for that one."""
        return self._ask(index, lambda part, own: index - own + part.key_at(own))

    def stamp_ns(self, index: int) -> int:
        """When the picture was taken."""
        return self._ask(index, lambda part, own: part.stamp_ns(own))

    def frames_from(self, key: int) -> Iterator[Frame]:
        """Frames from a key frame on, to the end of the last part."""
        for number in range(self._number(key), len(self._parts)):
            part, begin = self._parts[number], self._begins[number]
            last = -1
            with self._learning(number):
                for frame in part.frames_from(max(0, key - begin)):
                    last = frame.index
                    frame.index += begin
                    yield frame
                if last + 1 != part.count and isinstance(part, PacketIndex):
                    raise NotAsIndexed  # the next part's pictures have other numbers

    def _number(self, index: int) -> int:
        """Which part it is in."""
        return bisect_right(self._begins, index, hi=len(self._parts)) - 1

    def _ask(self, index: int, answer: Callable[[PacketIndex | DecodedIndex, int], _Answer]) -> _Answer:
        """Of the part it is in, by that one's own index; of one behind the last, that of the last."""
        number = self._number(index)
        part = self._parts[number]
        with self._learning(number):
            return answer(part, min(index - self._begins[number], part.count - 1))

    @contextmanager
    def _learning(self, number: int) -> Iterator[None]:
        try:
            yield
        except NotAsIndexed:
            self._parts[number].close()
            self._parts[number] = DecodedIndex(self._sources[number])
            raise
