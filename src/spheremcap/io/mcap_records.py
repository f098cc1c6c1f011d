"""Raw MCAP records of any file, whole or damaged: everything that can be read, and a list of what cannot.

The file is surveyed once by its record headers (an index is neither needed nor trusted), then chunks are
opened one at a time as their log times come up, so memory holds a few chunks whatever the file's size. Where
a header makes no sense, the next place at which records follow each other is looked for; a chunk that is cut
short or does not decompress to its end gives the messages before the damage. No chunk takes more memory than it
says it does, nor more than `LARGEST_CHUNK_BYTES`. What was read is compared with what the file's statistics say.

Several readings may go on at once, in threads too: they share the chunks that were opened last.
"""

import heapq
import itertools
import os
import re
import struct
import sys
import threading
import zlib
from array import array
from bisect import bisect_left, bisect_right
from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, Self, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics

from spheremcap.errors import SourceError, printable, short
from spheremcap.io.input_file import MCAP_MAGIC as MAGIC
from spheremcap.io.input_file import checked_input

_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_HELD_BYTES = 64 << 20  # decompressed chunks kept at once; beyond it they are read again when needed
_RUN_BYTES = 1 << 20  # messages outside chunks are taken in runs of this size
LARGEST_CHUNK_BYTES = 128 << 20
_LARGEST_UNKNOWN = 4 << 30  # a record of a kind that is not known is believed in up to this size
_LOCATED_SPANS = 8  # of which it is known where each message is, of one index
_CHAIN = 3  # records that must follow each other before a place counts as found again


@dataclass(frozen=True, slots=True)
class Loss:
    """Something in the file that cannot be read, or not be trusted: at which byte, and what in one line."""

    offset: int
    what: str

    def __str__(self) -> str:
        return f"byte {self.offset}: {self.what}"


class RawMessage(NamedTuple):
    """One message as stored: the file's own channel record, times in ns, data undecoded."""

    channel: Channel
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass(slots=True)
class Piece:
    """A chunk, or a run of messages outside chunks: where its bytes are and what its header says (log times in ns)."""

    offset: int
    length: int
    start: int
    end: int
    record: int = 0  # where a chunk's record begins
    compression: str | None = None  # None: a run of plain records
    size: int = 0
    crc: int = 0
    channels: set[int] | None = None  # from the message indexes behind a chunk; None: not known
    indexes: dict[int, tuple[int, int]] | None = None  # where each of those begins, by channel, and its length
    reported: bool = False
    sorted: bool = False  # its messages that were out of order have been counted


_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL)
_KEPT: dict[int, Callable[[ReadDataStream], Schema | Channel | Metadata]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
}
_Data = bytes | bytearray  # what was decompressed in steps is not copied once more


class _Entries(NamedTuple):
    """The messages of a piece by log time, in flat arrays (a chunk may hold millions): log time, where the message
    record's body starts and ends.
    """

    times: "array[int]"
    starts: "array[int]"
    ends: "array[int]"

    def add(self, log_time: int, start: int, end: int) -> None:
        self.times.append(log_time)
        self.starts.append(start)
        self.ends.append(end)

    def by_time(self) -> "_Entries":
        """Sorted; equal times in the order of the file."""
        order = sorted(range(len(self.times)), key=self.times.__getitem__)
        return _Entries(*(array("Q", map(column.__getitem__, order)) for column in self))


def _no_entries() -> _Entries:
    return _Entries(array("Q"), array("Q"), array("Q"))


_ReadAt = Callable[[int, int], _Data]
_Record = TypeVar("_Record")


class McapRecords:
    """An MCAP file's records: `schemas` and `channels` by the file's own ids, messages in log-time order.

    `lost` lists the damage met so far: framing damage once the file is open, bad chunks once they have been
    read, differences to the file's statistics once messages have been read to their end. `counts` has the number of
    messages by channel id: those that can be read where `all_read` (every chunk was opened), else those that the
    statistics state. `unordered` counts messages that were stored behind a later one of the same chunk; they come
    out in order.

    Decompressed chunks of `held_bytes` at most are kept for the next time, but always one. Raises SourceError when the
    file is not there or holds no MCAP record at all.
    """

    def __init__(self, path: str | os.PathLike[str], *, held_bytes: int = _HELD_BYTES) -> None:
        self.path = Path(path)
        self._held_bytes = held_bytes
        self.profile = ""
        self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: list[Metadata] = []
        self.counts: dict[int, int] = {}
        self.lost: list[Loss] = []
        self.unordered = 0
        self.all_read = False
        self._attachments: list[tuple[int, int]] = []
        self._pieces: list[Piece] = []
        self._statistics: Statistics | None = None
        self._data_end = (0, 0)  # where the data section ends, and its checksum (0: none)
        self._compared: set[int] = set()
        self._undecodable: dict[str, tuple[int, str]] = {}
        self._opened: OrderedDict[int, _Data] = OrderedDict()
        self._opening = threading.Lock()
        checked_input(self.path, "a recording")
        try:
            self._file = open(self.path, "rb", buffering=0)  # noqa: SIM115 (closed by close())
        except OSError as error:
            raise SourceError(f"{self.path}: cannot be opened: {error.strerror}") from error
        self._size = self._file.seek(0, os.SEEK_END)
        self._block = (0, b"")
        try:
            self._survey()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    # --- what the file holds ---

    def attachments(self) -> Iterator[Attachment]:
        """The attachments in file order, read one at a time."""
        for offset, length in self._attachments:
            attachment = _parsed(Attachment.read, self._read(offset, length))
            if attachment is not None:
                yield attachment

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """All readable messages, or those of `topics`, by log time; equal times in the order of the file."""
        given: Counter[int] = Counter()
        for piece_, start, end, data in self._entries(topics):
            channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            given[channel_id] += 1
            channel = self.channels.get(channel_id)
            if channel is None:
                if not piece_.reported:
                    piece_.reported = True
                    self._lose(piece_.offset, f"messages of channel {channel_id}, whose record is missing")
            elif topics is None or channel.topic in topics:
                body = bytes(data[start + _MESSAGE.size : end])
                yield RawMessage(channel, sequence, log_time, publish_time, body)
        self._compare(given, [i for i, c in self.channels.items() if topics is None or c.topic in topics])

    def index_of(self, topic: str) -> "MessageIndex":
        """Where each message of a topic is, in the order of `messages`, by the file's own message indexes.

        A chunk without an index of its own is opened for it.
        """
        return self.index_of_channels(i for i, channel in self.channels.items() if channel.topic == topic)

    def index_of_channels(self, ids: Iterable[int]) -> "MessageIndex":
        """The same of channels by their ids, all together."""
        return MessageIndex(self, frozenset(ids))

    # --- piece by piece ---

    @property
    def pieces(self) -> list[Piece]:
        """The chunks, and the runs of messages outside of them, in the order of the file."""
        return sorted(self._pieces, key=lambda piece: piece.offset)

    def messages_of(self, piece: Piece) -> list[RawMessage]:
        """The messages of one piece by log time. Raises SourceError where a channel's record is missing."""
        data = self._load(piece, report=True)
        entries = self._index(piece, data)
        found = []
        for start, end in zip(entries.starts, entries.ends, strict=True):
            channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            channel = self.channels.get(channel_id)
            if channel is None:
                raise SourceError(f"{self.path}: byte {piece.offset}: channel {channel_id} has no record")
            body = bytes(data[start + _MESSAGE.size : end])
            found.append(RawMessage(channel, sequence, log_time, publish_time, body))
        return found

    def defined_in(self, piece: Piece) -> list[int]:
        """The ids of the channels whose records are in a chunk."""
        data, position, found = self._load(piece, report=True), 0, []
        while position + _HEADER.size <= len(data):
            opcode, length = _HEADER.unpack_from(data, position)
            position += _HEADER.size
            if opcode == Opcode.CHANNEL:
                found.append(int.from_bytes(data[position : position + 2], "little"))
            position += length
        return found

    def stored(self, piece: Piece) -> tuple[bytes, dict[int, tuple[int, int]]] | None:
        """A chunk's record with the message indexes behind it, as they are in the file; and by channel where its index
        begins in them, and how many messages it has. None where there is no chunk, or no index behind it."""
        if not piece.indexes:
            return None
        found = {
            id_: (body - _HEADER.size - piece.record, (length - 6) // 16)
            for id_, (body, length) in piece.indexes.items()
        }
        end = max(body + length for body, length in piece.indexes.values())
        return self._read(piece.record, end - piece.record), found

    @property
    def chunk_count(self) -> int:
        """How many chunks there are."""
        return sum(piece.compression is not None for piece in self._pieces)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log time, by the statistics or, where every chunk was opened, by the messages."""
        if not sum(self.counts.values()):
            return None
        if not self.all_read and self._statistics is not None:
            return self._statistics.message_start_time, self._statistics.message_end_time
        filled = [piece for piece in self._pieces if piece.channels]
        return min(piece.start for piece in filled), max(piece.end for piece in filled)

    def undecodable(self, topic: str, error: Exception) -> None:
        """For who decodes: one more message of `topic` is not what its schema says."""
        count, first = self._undecodable.get(topic, (0, short(error)))
        self._undecodable[topic] = (count + 1, first)

    def damage(self) -> list[str]:
        """All that could not be read so far, a line each: damage of the file, and messages that do not decode."""
        bad = [
            f"{printable(topic)}: {count} message{'s' * (count != 1)} not as the schema says ({first})"
            for topic, (count, first) in self._undecodable.items()
        ]
        return [*map(str, self.lost), *bad]

    def _compare(self, given: Mapping[int, int], channels: Collection[int]) -> None:
        """Say where the statistics state other numbers of messages than were given."""
        if self._statistics is None:
            return
        stated = self._statistics.channel_message_counts
        if not stated and len(channels) == len(self.channels):
            self._differ(-1, "messages", self._statistics.message_count, sum(given.values()))
        for id_ in channels if stated else ():
            self._differ(id_, f"messages on {self.channels[id_].topic}", stated.get(id_, 0), given.get(id_, 0))

    def _compare_records(self, stated: Statistics, seen: Mapping[int, int]) -> None:
        """Say where there are other numbers of records outside the chunks: one that has become another kind is lost."""
        kinds = (
            ("metadata records", stated.metadata_count, Opcode.METADATA),
            ("attachments", stated.attachment_count, Opcode.ATTACHMENT),
            ("chunks", stated.chunk_count, Opcode.CHUNK),
        )
        for what, count, opcode in kinds:
            if count != seen.get(opcode, 0):
                self._lose(self._size, f"the file's own statistics say {count} {what}, {seen.get(opcode, 0)} are there")

    def check_data(self) -> None:
        """Compare the data section's checksum, if it has one; reads the file once more."""
        end, stated = self._data_end
        crc = 0
        for at in range(0, end if stated else 0, 1 << 20):
            crc = zlib.crc32(self._read(at, min(1 << 20, end - at)), crc)
        if crc != stated:
            self._lose(end, "the data section's checksum is wrong")

    def _differ(self, id_: int, what: str, stated: int, given: int) -> None:
        if stated != given and id_ not in self._compared:
            self._compared.add(id_)
            self._lose(self._size, f"the file's own statistics say {stated} {what}, {given} can be read")

    def _entries(self, topics: Collection[str] | None) -> Iterator[tuple[Piece, int, int, _Data]]:
        """Pieces opened as late as their start times allow, their messages merged by log time."""
        waiting = self._pieces
        if topics is not None:
            wanted = {i for i, channel in self.channels.items() if channel.topic in topics}
            waiting = [p for p in waiting if p.channels is None or not p.channels.isdisjoint(wanted)]
        waiting = sorted(waiting, key=lambda p: (p.start, p.offset), reverse=True)
        heap: list[tuple[int, int, int]] = []  # log_time, offset of the piece, index of its next entry
        opened: dict[int, tuple[Piece, _Entries]] = {}
        held: dict[int, _Data] = {}
        while heap or waiting:
            while waiting and (not heap or waiting[-1].start <= heap[0][0]):
                piece = waiting.pop()
                data = self._load(piece, report=True)
                entries = self._index(piece, data)
                if entries.times:
                    opened[piece.offset], held[piece.offset] = (piece, entries), data
                    heapq.heappush(heap, (entries.times[0], piece.offset, 0))
            if not heap:
                return
            _, offset, k = heap[0]
            piece, entries = opened[offset]
            if offset not in held:
                held[offset] = self._load(piece, report=False)
            while len(held) > 1 and sum(map(len, held.values())) > _HELD_BYTES:
                del held[next(o for o in held if o != offset)]
            # This piece goes on until another open one, or the start of a waiting one, comes first.
            other = min(heap[1:3])[:2] if len(heap) > 1 else None
            until = waiting[-1].start if waiting else None
            times, starts, ends = entries
            while k < len(times):
                log_time = times[k]
                if (other is not None and (log_time, offset) > other) or (until is not None and log_time >= until):
                    break
                yield piece, starts[k], ends[k], held[offset]
                k += 1
            if k < len(times):
                heapq.heapreplace(heap, (times[k], offset, k))
            else:
                heapq.heappop(heap)
                del opened[offset], held[offset]

    # --- the survey ---

    def _survey(self) -> None:
        """Walk the record headers once; then, unless the summary says it all, open the chunks."""
        position = len(MAGIC)
        if self._read(0, len(MAGIC)) != MAGIC:
            self._lose(0, "the magic bytes at the start are wrong")
            if not _plausible(self._read, position, self._size):
                position = 0
        in_data, finished, trusted = True, False, not self.lost
        run: Piece | None = None
        chunk: Piece | None = None
        chunks: dict[int, Piece] = {}
        seen: Counter[int] = Counter()
        for opcode, offset, length in _walk(self._read, position, self._size, self._lose):
            seen[opcode] += 1
            if opcode == Opcode.MESSAGE and in_data:
                channel_id, _, log_time, _ = _MESSAGE.unpack(self._read(offset, _MESSAGE.size))
                if run is None or run.offset + run.length != offset - 9 or run.length >= _RUN_BYTES:
                    run = Piece(offset - 9, 0, log_time, log_time, channels=set())
                    self._pieces.append(run)
                run.length = offset + length - run.offset
                run.start, run.end = min(run.start, log_time), max(run.end, log_time)
                if run.channels is not None:
                    run.channels.add(channel_id)
            elif opcode == Opcode.CHUNK:
                chunk = self._chunk(offset, length)
                self._pieces.append(chunk)
                chunks[offset - 9] = chunk
            elif opcode == Opcode.MESSAGE_INDEX and chunk is not None:
                channel_id = struct.unpack("<H", self._read(offset, 2))[0]
                chunk.channels, chunk.indexes = chunk.channels or set(), chunk.indexes or {}
                chunk.channels.add(channel_id)
                chunk.indexes[channel_id] = (offset, length)
            elif opcode == Opcode.CHUNK_INDEX:
                start, end, at = struct.unpack("<QQQ", self._read(offset, 24))
                if at in chunks and (chunks[at].start, chunks[at].end) != (start, end):
                    self._lose(at, "the chunk's times are not those of the index: its messages are sorted anew")
            elif opcode in _KEPT:
                self._keep(opcode, self._read(offset, length), offset)
            elif opcode == Opcode.ATTACHMENT:
                self._keep_attachment(offset, length)
            elif opcode == Opcode.HEADER:
                header = _parsed(Header.read, self._read(offset, length))
                if header is not None:
                    self.profile, self.library = header.profile, header.library
            elif opcode == Opcode.DATA_END:
                in_data = False
                self._data_end = (offset - 9, int.from_bytes(self._read(offset, 4), "little"))
            elif opcode == Opcode.STATISTICS:
                self._statistics = _parsed(Statistics.read, self._read(offset, length))
                if self._statistics is None:
                    self._lose(
                        offset, "the statistics record does not parse: nobody knows how many messages there were"
                    )
            elif opcode == Opcode.FOOTER:
                finished = True
                if not self._summary_intact(offset):
                    trusted, self._statistics = False, None
                if self._read(offset + length, len(MAGIC)) != MAGIC:
                    self._lose(offset + length, "the magic bytes at the end are wrong")
        if not seen:
            raise SourceError(f"{self.path}: is not an MCAP file (no MCAP record in its {self._size} bytes)")
        if self._statistics is not None:
            self._compare_records(self._statistics, seen)
        if not finished:
            self._lose(self._size, "there is no footer: the recording was not finished")
        summary = self._statistics
        if (
            trusted
            and not self.lost
            and summary is not None
            and summary.channel_count == len(self.channels)
            and summary.schema_count == len(self.schemas)
            and len(summary.channel_message_counts) > 0
        ):
            self.counts = dict(summary.channel_message_counts)
        else:
            self._count_all()

    def _count_all(self) -> None:
        """Open every piece once, for its schemas, channels and number of messages."""
        self.counts = {}
        self.all_read = True
        for piece in self._pieces:
            data = self._load(piece, report=True)
            channels = set()
            entries = self._index(piece, data)
            for start in entries.starts:
                channel_id = int.from_bytes(data[start : start + 2], "little")
                channels.add(channel_id)
                self.counts[channel_id] = self.counts.get(channel_id, 0) + 1
            if entries.times:
                piece.start, piece.end = entries.times[0], entries.times[-1]
            piece.channels = channels
        self._compare(self.counts, list(self.channels))

    def _chunk(self, offset: int, length: int) -> Piece:
        """The chunk record at `offset`; `length` may reach past the end of a file that was cut."""
        start, end, size, crc = _CHUNK.unpack(self._read(offset, _CHUNK.size))
        text = int.from_bytes(self._read(offset + _CHUNK.size, 4), "little")
        compression = self._read(offset + _CHUNK.size + 4, text).decode("utf-8", "replace")
        body = offset + _CHUNK.size + 4 + text
        stored = int.from_bytes(self._read(body, 8), "little")
        length = min(stored, self._size - body - 8)
        return Piece(body + 8, length, start, end, offset - _HEADER.size, compression, size, crc)

    def _summary_intact(self, footer: int) -> bool:
        """Whether the summary's checksum is right, or there is none."""
        start, _, crc = struct.unpack("<QQI", self._read(footer, 20))
        if not crc or not 0 < start < footer:
            return True
        if zlib.crc32(self._read(start, footer + 16 - start)) == crc:
            return True
        self._lose(start, "the summary's checksum is wrong: the data section is used instead")
        return False

    def _keep(self, opcode: int, body: _Data, offset: int) -> None:
        """A schema, a channel (of one id the first counts) or a metadata record."""
        record = _parsed(_KEPT[opcode], body)
        if record is None:
            self._lose(offset, f"a {Opcode(opcode).name.lower()} record does not parse")
        elif isinstance(record, Metadata):
            self.metadata.append(record)
        elif isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        elif record.id:
            self.schemas.setdefault(record.id, record)

    def _keep_attachment(self, offset: int, length: int) -> None:
        """Its inner lengths are right already; its checksum is taken a piece at a time."""
        crc, end = 0, offset + length - 4
        for at in range(offset, end, 1 << 20):
            crc = zlib.crc32(self._read(at, min(1 << 20, end - at)), crc)
        stated = int.from_bytes(self._read(end, 4), "little")
        if stated and stated != crc:
            self._lose(offset, "an attachment's checksum is wrong: it is kept as it is")
        self._attachments.append((offset, length))

    # --- chunks ---

    def _load(self, piece: Piece, report: bool) -> _Data:
        """A piece's records, decompressed as far as they can be; those that were opened last are at hand."""
        with self._opening:
            data = self._opened.pop(piece.offset, None)
            if data is None:
                data = self._open(piece, report)
            self._opened[piece.offset] = data
            while len(self._opened) > 1 and sum(map(len, self._opened.values())) > self._held_bytes:
                self._opened.popitem(last=False)
            return data

    def _open(self, piece: Piece, report: bool) -> _Data:
        stored = self._read(piece.offset, min(piece.length, LARGEST_CHUNK_BYTES))
        if piece.compression is None:
            return stored
        data, problem = _decompress(stored, piece.compression, piece.size)
        if problem is None and piece.crc and zlib.crc32(data) != piece.crc:
            problem = "its checksum is wrong: its messages are kept as they are"
        if problem is not None and report and not piece.reported:
            piece.reported = True
            self._lose(piece.offset, f"chunk of {piece.size} bytes: {problem}")
        return data

    def _index(self, piece: Piece, data: _Data) -> _Entries:
        """The messages of a piece by log time; its schemas and channels are kept on the way."""
        entries = _no_entries()
        time_of, start_of, end_of = entries.times.append, entries.starts.append, entries.ends.append
        position, end = 0, len(data)
        while position + 9 <= end:  # the common case, without the checks
            opcode, length = _HEADER.unpack_from(data, position)
            body = position + 9
            position = body + length
            if position > end:
                position = body - 9
                break
            if opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
                time_of(int.from_bytes(data[body + 6 : body + 14], "little"))
                start_of(body)
                end_of(position)
            elif opcode in _IN_CHUNKS and _parsed(_KEPT[opcode], data[body:position]) is not None:
                self._keep(opcode, data[body:position], piece.offset)
            elif opcode <= Opcode.DATA_END:
                position = body - 9
                break
        if position < end:
            lost = (lambda *_: None) if piece.reported else self._lose_in(piece)
            entries = _no_entries()
            for opcode, body, length in _walk(_reader(data), 0, end, lost):
                if opcode == Opcode.MESSAGE:
                    entries.add(int.from_bytes(data[body + 6 : body + 14], "little"), body, body + length)
                elif opcode in _IN_CHUNKS:
                    self._keep(opcode, data[body : body + length], piece.offset)
            piece.reported = True
        backwards = sum(a > b for a, b in itertools.pairwise(entries.times))
        if backwards:
            self.unordered += 0 if piece.sorted else backwards
            piece.sorted = True
            entries = entries.by_time()
        return entries

    def _lose_in(self, piece: Piece) -> Callable[[int, str], None]:
        where = piece.offset
        if piece.compression:
            return lambda at, what: self._lose(where, f"inside the chunk, at its byte {at}: {what}")
        return lambda at, what: self._lose(where + at, what)

    def _lose(self, offset: int, what: str) -> None:
        self.lost.append(Loss(offset, what))

    def _read(self, offset: int, length: int) -> bytes:
        """Up to `length` bytes at `offset`; small reads come from one block of read-ahead."""
        at, block = self._block
        inside = offset - at
        if inside >= 0 and inside + length <= len(block):
            return block[inside : inside + length]
        try:
            if length > 4096:
                return _pread(self._file.fileno(), offset, length)
            block = _pread(self._file.fileno(), offset, 8192)
        except OSError as error:
            raise SourceError(f"{self.path}: byte {offset} cannot be read: {error.strerror}") from error
        self._block = (offset, block)
        return block[:length]


class _Span(NamedTuple):
    """Pieces whose messages lie between each other in time, most often one: their numbers, log times from-to, and how
    many of the messages come before them."""

    pieces: tuple[int, ...]
    start: int
    end: int
    before: int


class _Located(NamedTuple):
    """Messages by log time: that, where each one's record starts in its piece, and the piece's number."""

    times: "array[int]"
    starts: "array[int]"
    pieces: "array[int]"


class MessageIndex:
    """The messages of some channels by their number, from 0 by log time, each found and read in constant time.

    What is kept does not grow with the messages, only with the chunks: where the messages of a chunk are is read from
    the index behind it when one of them is asked for.
    """

    def __init__(self, records: McapRecords, channels: frozenset[int]) -> None:
        self._records = records
        self._channels = channels
        self._located = lru_cache(_LOCATED_SPANS)(self._read_span)
        self._locate(trusting=True)
        counted = sum(records.counts.get(i, 0) for i in self._channels)
        if len(self) != counted:
            self._locate(trusting=False)
        self._promised = len(self)

    def __len__(self) -> int:
        return self._count

    def message(self, number: int) -> RawMessage:
        """The message with that number. Raises IndexError when there is none, SourceError where only the file's index
        says that there is."""
        found = self._message(number)
        if found is None:  # the file's index leads elsewhere: what the chunks hold counts
            self._locate(trusting=False)
            found = self._message(number)
        if found is None:
            raise self._damaged()
        return found

    def log_time(self, number: int) -> int:
        """The log time of a message, ns. Raises as `message`."""
        span, place = self._place(number)
        if place >= len(self._located(span).times):
            self._locate(trusting=False)
            span, place = self._place(number)
        return self._located(span).times[place]

    def before(self, log_time: int) -> int:
        """How many messages are earlier: the number of the first that is not."""
        return self._up_to(bisect_left(self._spans, log_time, key=lambda span: span.end), log_time, bisect_left)

    def until(self, log_time: int) -> int:
        """How many messages are not later."""
        return self._up_to(bisect_right(self._spans, log_time, key=lambda span: span.end), log_time, bisect_right)

    def _up_to(self, span: int, log_time: int, cut: Callable[["array[int]", int], int]) -> int:
        """By the first span that does not end before that time."""
        if span == len(self._spans):
            return self._count
        return self._spans[span].before + cut(self._located(span).times, log_time)

    def _place(self, number: int) -> tuple[int, int]:
        """The span of a message, and its place in there."""
        if self._count <= number < self._promised:  # fewer since the chunks were looked into
            raise self._damaged()
        if not 0 <= number < self._count:
            raise IndexError(f"there is no message {number}")
        span = bisect_right(self._spans, number, key=lambda one: one.before) - 1
        return span, number - self._spans[span].before

    def _damaged(self) -> SourceError:
        return SourceError(
            f"{self._records.path}: is damaged: its index says that there are more messages than can be read"
        )

    def _message(self, number: int) -> RawMessage | None:
        span, place = self._place(number)
        located = self._located(span)
        if place >= len(located.times):
            return None
        log_time = located.times[place]
        if not self._spans[span].start <= log_time <= self._spans[span].end:
            return None
        piece, start = self._records._pieces[located.pieces[place]], located.starts[place]
        data = self._records._load(piece, report=True)
        if start + _HEADER.size + _MESSAGE.size > len(data):
            return None
        opcode, length = _HEADER.unpack_from(data, start)
        body, end = start + _HEADER.size, start + _HEADER.size + length
        if opcode != Opcode.MESSAGE or length < _MESSAGE.size or end > len(data):
            return None
        channel_id, sequence, stored_time, publish_time = _MESSAGE.unpack_from(data, body)
        if channel_id not in self._channels or stored_time != log_time:
            return None
        channel = self._records.channels[channel_id]
        return RawMessage(channel, sequence, log_time, publish_time, bytes(data[body + _MESSAGE.size : end]))

    def _locate(self, trusting: bool) -> None:
        """Go through the pieces; `trusting`, what the file says of them, else what is in them."""
        self._trusting = trusting
        self._located.cache_clear()
        spans: list[_Span] = []
        last, count = -1, 0  # offset of the last piece in the last span; messages so far
        for start, end, offset, number, own in sorted(self._pieces_with(trusting)):
            if spans and (start < spans[-1].end or (start == spans[-1].end and offset < last)):
                both = spans.pop()
                spans.append(_Span((*both.pieces, number), both.start, max(end, both.end), both.before))
                last = max(last, offset)
            else:
                spans.append(_Span((number,), start, end, count))
                last = offset
            count += own
        self._spans, self._count = spans, count

    def _pieces_with(self, trusting: bool) -> Iterator[tuple[int, int, int, int, int]]:
        """Of each piece with messages of ours: first and last log time, offset, number, and how many they are."""
        for number, piece in enumerate(self._records._pieces):
            if piece.channels is not None and piece.channels.isdisjoint(self._channels):
                continue
            if trusting and piece.indexes is not None:
                lengths = (piece.indexes[id_][1] for id_ in self._channels & piece.indexes.keys())
                count, start, end = sum((length - 6) // 16 for length in lengths), piece.start, piece.end
            else:
                times = [log_time for log_time, _ in self._opened(piece)]
                count, start, end = len(times), min(times, default=0), max(times, default=0)
            if count:
                yield start, end, piece.offset, number, count

    def _read_span(self, number: int) -> _Located:
        times, starts, pieces = array("Q"), array("Q"), array("I")
        in_file = sorted(self._spans[number].pieces, key=lambda one: self._records._pieces[one].offset)
        for of in in_file:
            piece = self._records._pieces[of]
            found = self._stated(piece) if self._trusting else None
            for log_time, start in self._opened(piece) if found is None else found:
                times.append(log_time)
                starts.append(start)
                pieces.append(of)
        if any(a > b for a, b in itertools.pairwise(times)):
            order = sorted(range(len(times)), key=times.__getitem__)
            return _Located(
                *(array(column.typecode, map(column.__getitem__, order)) for column in (times, starts, pieces))
            )
        return _Located(times, starts, pieces)

    def _stated(self, piece: Piece) -> list[tuple[int, int]] | None:
        """(log time, where the record starts in the chunk) by the indexes behind a chunk; None when it has none."""
        if piece.indexes is None:
            return None
        found: list[tuple[int, int]] = []
        for id_ in self._channels & piece.indexes.keys():
            body, length = piece.indexes[id_]
            numbers = array("Q", self._records._read(body + 6, (length - 6) // 16 * 16))
            if sys.byteorder == "big":
                numbers.byteswap()
            found += zip(numbers[::2], numbers[1::2], strict=True)
        return sorted(found, key=lambda entry: entry[1])

    def _opened(self, piece: Piece) -> list[tuple[int, int]]:
        """The same by what the chunk holds."""
        data = self._records._load(piece, report=True)
        entries = self._records._index(piece, data)
        return [
            (log_time, start - _HEADER.size)
            for log_time, start in zip(entries.times, entries.starts, strict=True)
            if int.from_bytes(data[start : start + 2], "little") in self._channels
        ]


def _pread(fd: int, offset: int, length: int) -> bytes:
    """os.pread that goes on after a short read (the kernel gives at most 2 GiB at once)."""
    data = os.pread(fd, length, offset)
    while 0 < len(data) < length:
        more = os.pread(fd, length - len(data), offset + len(data))
        if not more:
            break
        data += more
    return data


def _parsed(read: Callable[[ReadDataStream], _Record], body: _Data) -> _Record | None:
    """The record, or None when its bytes do not make one."""
    try:
        return read(ReadDataStream(BytesIO(body)))
    except Exception:  # the reference reader raises whatever its struct, dict and str calls raise
        return None


def _reader(data: _Data) -> _ReadAt:
    return lambda offset, length: data[offset : offset + length]


def _decompress(stored: bytes, compression: str, size: int) -> tuple[_Data, str | None]:
    """The chunk's records and None, or as many of them as come out and what is wrong; never more than `size` bytes."""
    if compression not in ("", "zstd", "lz4"):
        return b"", f"compression {short(compression)} is not known (zstd and lz4 are)"
    if compression == "":
        return stored[:size], None if len(stored) == size else f"{len(stored)} of its bytes are there"
    limit = min(size, LARGEST_CHUNK_BYTES)
    try:
        if size == limit and compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1)
            if len(data) == size:
                return data, None
        # A frame may say its size itself, and is believed by the decompressor: only when it is the chunk's.
        elif size == limit and zstandard.frame_content_size(stored) in (-1, size):
            data = zstandard.ZstdDecompressor().decompress(stored, max_output_size=size)
            if len(data) == size:
                return data, None
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        pass
    out = bytearray()
    try:
        for piece in _decompressed(stored, compression):  # what comes before the fault is kept
            out += piece
            if len(out) > limit:
                del out[limit:]
                more = f"there is more in it than its {size} bytes" if size == limit else "it is too large"
                return out, f"{more}: kept up to {limit}"
    except (zstandard.ZstdError, RuntimeError, EOFError):
        return out, f"it does not decompress beyond {len(out)} bytes"
    return out, None if len(out) == size else f"it does not decompress beyond {len(out)} bytes"


def _decompressed(stored: bytes, compression: str) -> Iterator[bytes]:
    """The bytes in small steps: none of them is large, whatever was compressed."""
    zstd = compression == "zstd"
    stream = zstandard.ZstdDecompressor().decompressobj() if zstd else lz4.frame.LZ4FrameDecompressor()
    for start in range(0, len(stored), 64):
        yield stream.decompress(stored[start : start + 64])
        if stream.eof:
            return


# --- framing ---


def _walk(read: _ReadAt, position: int, end: int, lost: Callable[[int, str], None]) -> Iterator[tuple[int, int, int]]:
    """(opcode, offset of the body, length) of every record; bytes that make no sense are passed over."""
    pending: tuple[int, int, int] | None = None  # a message is held back until what follows it makes sense
    while position + 9 <= end:
        if _plausible(read, position, end):
            if pending is not None:
                yield pending
            opcode, length = _HEADER.unpack(read(position, 9))
            pending = (opcode, position + 9, length)
            if opcode != Opcode.MESSAGE:
                yield pending
                pending = None
            position += 9 + length
            if opcode == Opcode.FOOTER:
                return
            continue
        # A message has no inner length to check: the fault may be in the length of the one before.
        search = position + 1 if pending is None else pending[1] + _MESSAGE.size
        found = _resync(read, search, end)
        if pending is not None:
            if found is None or found >= position:
                yield pending
            else:
                lost(pending[1] - 9, f"a message whose length is wrong ({found - pending[1] + 9} bytes)")
                pending, position = None, found
                continue
            pending = None
        if found is None:
            opcode, length = _HEADER.unpack(read(position, 9))
            if opcode == Opcode.CHUNK and _chunk_header(read, position + 9, length):
                lost(position, "the last chunk is cut short")
                yield opcode, position + 9, length
            else:
                lost(position, f"{end - position} bytes at the end are not a whole record")
            return
        lost(position, f"{found - position} bytes are not MCAP records")
        position = found
    if pending is not None:
        yield pending
    if position < end:
        lost(position, f"{end - position} bytes at the end are not a whole record")


_CANDIDATE = re.compile(rb"(?=[\x01-\x0f][\x00-\xff]{5}\x00\x00\x00)", re.DOTALL)


def _resync(read: _ReadAt, position: int, end: int) -> int | None:
    """The first place from `position` on at which records follow each other."""
    step, overlap = 1 << 20, 8
    while position + 9 <= end:
        block = read(position, step + overlap)
        for match in _CANDIDATE.finditer(block):
            at = position + match.start()
            if match.start() < step and _chained(read, at, end):
                return at
        position += step
    return None


def _chained(read: _ReadAt, position: int, end: int) -> bool:
    for _ in range(_CHAIN):
        if not _plausible(read, position, end, strict=True):
            return False
        opcode, length = _HEADER.unpack(read(position, 9))
        position += 9 + length
        if position == end or opcode == Opcode.FOOTER:
            return True
    return True


_LENGTHS = {Opcode.FOOTER: 20, Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17}
_SMALLEST = {
    Opcode.MESSAGE: 22,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT_INDEX: 48,
    Opcode.STATISTICS: 46,
    Opcode.METADATA_INDEX: 20,
}
# The fields of a record: a number is that many bytes, s/m/d/q a text, map, u32-counted and u64-counted bytes.
_LAYOUT: dict[int, tuple[int | str, ...]] = {
    Opcode.HEADER: ("s", "s"),
    Opcode.SCHEMA: (2, "s", "s", "d"),
    Opcode.CHANNEL: (4, "s", "s", "d"),
    Opcode.CHUNK: (28, "s", "q"),
    Opcode.MESSAGE_INDEX: (2, "d"),
    Opcode.ATTACHMENT: (16, "s", "s", "q", 4),
    Opcode.METADATA: ("s", "d"),
}


def _plausible(read: _ReadAt, position: int, end: int, strict: bool = False) -> bool:
    """Whether a record can start here: it fits and its inner lengths add up (exactly when `strict`)."""
    header = read(position, 9)
    if len(header) < 9:
        return False
    opcode, length = _HEADER.unpack(header)
    if position + 9 + length > end or opcode == 0:
        return False
    if opcode > Opcode.DATA_END:  # private or future records: allowed, but no reason to believe in one
        return not strict and length < _LARGEST_UNKNOWN
    if opcode in _LENGTHS:
        return bool(length == _LENGTHS[opcode]) if strict else bool(length >= _LENGTHS[opcode])
    if opcode in _SMALLEST:
        return bool(length >= _SMALLEST[opcode])
    inner = _inner_length(read, position + 9, length, _LAYOUT[opcode])
    return inner is not None and (inner == length or (not strict and inner < length))


def _inner_length(read: _ReadAt, position: int, limit: int, layout: tuple[int | str, ...]) -> int | None:
    used = 0
    for part in layout:
        if isinstance(part, int):
            used += part
        else:
            width = 8 if part == "q" else 4
            used += width + int.from_bytes(read(position + used, width), "little")
        if used > limit:
            return None
    return used


def _chunk_header(read: _ReadAt, position: int, length: int) -> bool:
    """Whether the body of a cut chunk begins as a chunk does."""
    compression = int.from_bytes(read(position + _CHUNK.size, 4), "little")
    name = read(position + _CHUNK.size + 4, min(compression, 4))
    inner = _inner_length(read, position, length, _LAYOUT[Opcode.CHUNK])
    return name in (b"", b"zstd", b"lz4") and inner == length
