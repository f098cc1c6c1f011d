"""A recording written anew chunk by chunk: most of them as they are in the file that they come from, some with other
messages. Ids of schemas and channels stay, so that a chunk can be copied without being opened.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from spheremcap.io.join import OutMessage
from spheremcap.io.mcap_records import McapRecords, Piece, RawMessage

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_BYTES = 22  # of a message record besides its data


class ChunkWriter:
    """Writes an MCAP of whole chunks. `schemas` and `channels` are those of the file that is copied, by its own ids;
    `register_schema` and `register_channel` add to them. Set `complete` to False, and the file stays OUT.part.
    """

    def __init__(self, output: IO[bytes], schemas: Mapping[int, Schema], channels: Mapping[int, Channel]) -> None:
        self._output = output
        self._schemas, self._channels = dict(schemas), dict(channels)
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._span: tuple[int, int] | None = None
        self.counts: Counter[int] = Counter()
        """Messages by channel id."""
        self.complete = True
        self.part: Path | None = None
        self.notes: tuple[str, ...] = ()

    def start(self, profile: str, library: str) -> None:
        """Begin the file."""
        self._output.write(MCAP0_MAGIC)
        self._write(Header(profile, library))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """The id of this schema, a new one when it is new."""
        for id_, schema in self._schemas.items():
            if (schema.name, schema.encoding, schema.data) == (name, encoding, data):
                return id_
        id_ = max(self._schemas, default=0) + 1
        self._schemas[id_] = Schema(id_, data, encoding, name)
        return id_

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] | None = None
    ) -> int:
        """The id of this channel, a new one when it is new."""
        wanted = (topic, message_encoding, schema_id, metadata or {})
        for id_, known in self._channels.items():
            if (known.topic, known.message_encoding, known.schema_id, known.metadata) == wanted:
                return id_
        id_ = max(self._channels, default=0) + 1
        self._channels[id_] = Channel(id_, topic, message_encoding, metadata or {}, schema_id)
        return id_

    def copy(self, piece: Piece, stored: bytes, indexes: Mapping[int, tuple[int, int]]) -> None:
        """A chunk and the message indexes behind it, as `McapRecords.stored` gives them."""
        start = self._output.tell()
        self._output.write(stored)
        chunk_bytes = piece.offset + piece.length - piece.record
        self._chunks.append(
            ChunkIndex(
                chunk_length=chunk_bytes, chunk_start_offset=start, compression=piece.compression or "",
                compressed_size=piece.length, message_start_time=piece.start, message_end_time=piece.end,
                message_index_length=len(stored) - chunk_bytes, uncompressed_size=piece.size,
                message_index_offsets={id_: start + place for id_, (place, _) in indexes.items()},
            )
        )  # fmt: skip
        self._count({id_: count for id_, (_, count) in indexes.items()}, piece.start, piece.end)

    def write(self, messages: Sequence[OutMessage], compression: str, defined: Iterable[int] = ()) -> None:
        """A chunk of these messages; it begins with the records of their channels, and of those `defined` besides."""
        if not messages:
            return
        body, places = RecordBuilder(), dict[int, list[tuple[int, int]]]()
        ids = dict.fromkeys([*defined, *(message.channel_id for message in messages)])
        schema_ids = dict.fromkeys(self._channels[id_].schema_id for id_ in ids)
        for id_ in schema_ids:
            if id_ in self._schemas:
                self._schemas[id_].write(body)
        for id_ in ids:
            self._channels[id_].write(body)
        for log_time, publish_time, sequence, id_, data in messages:
            places.setdefault(id_, []).append((log_time, body.count))
            length = _MESSAGE_BYTES + len(data)
            body.write(_MESSAGE.pack(Opcode.MESSAGE, length, id_, sequence, log_time, publish_time))
            body.write(data)
        plain = body.end()  # type: ignore[no-untyped-call]
        times = [message.log_time for message in messages]
        chunk = Chunk(
            compression, _compressed(plain, compression), max(times), min(times), zlib.crc32(plain), len(plain)
        )
        record = RecordBuilder()
        chunk.write(record)
        chunk_bytes, indexes = record.count, {}
        for id_, entries in places.items():
            indexes[id_] = (record.count, len(entries))
            MessageIndex(id_, entries).write(record)
        whole = record.end()  # type: ignore[no-untyped-call]
        offset = chunk_bytes - len(chunk.data)
        piece = Piece(offset, len(chunk.data), min(times), max(times), 0, compression, len(plain))
        self.copy(piece, whole, indexes)

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Store a record."""
        start = self._output.tell()
        length = self._write(Metadata(name=name, metadata=data))
        self._metadata.append(MetadataIndex(start, length, name))

    def add_attachment(self, attachment: Attachment) -> None:
        """Store a file."""
        start = self._output.tell()
        length = self._write(attachment)
        self._attachments.append(
            AttachmentIndex(
                start, length, attachment.log_time, attachment.create_time, len(attachment.data), attachment.name,
                attachment.media_type,
            )
        )  # fmt: skip

    def finish(self) -> None:
        """Write the summary; the file is whole then."""
        self._write(DataEnd(0))
        start = self._output.tell()
        summary, offsets = RecordBuilder(), list[SummaryOffset]()
        first, last = self._span or (0, 0)
        statistics = Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels),
            channel_message_counts=dict(sorted(self.counts.items())), chunk_count=len(self._chunks),
            message_count=self.counts.total(), message_start_time=first, message_end_time=last,
            metadata_count=len(self._metadata), schema_count=len(self._schemas),
        )  # fmt: skip
        groups: tuple[tuple[Opcode, Iterable[McapRecord]], ...] = (
            (Opcode.SCHEMA, self._schemas.values()),
            (Opcode.CHANNEL, self._channels.values()),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        for opcode, records in groups:
            place = summary.count
            for record in records:
                record.write(summary)
            offsets.append(SummaryOffset(opcode, summary.count - place, start + place))
        offsets_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data = summary.end()  # type: ignore[no-untyped-call]
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start), zlib.crc32(data))
        self._output.write(data)
        self._write(Footer(start, offsets_start, crc))
        self._output.write(MCAP0_MAGIC)

    def _count(self, counts: Mapping[int, int], start_ns: int, end_ns: int) -> None:
        self.counts.update(counts)
        first, last = self._span or (start_ns, end_ns)
        self._span = min(first, start_ns), max(last, end_ns)

    def _write(self, record: McapRecord) -> int:
        builder = RecordBuilder()
        record.write(builder)
        data = builder.end()  # type: ignore[no-untyped-call]
        self._output.write(data)
        return len(data)


def copy_piece(records: McapRecords, piece: Piece, writer: ChunkWriter) -> None:
    """One chunk of a recording as it is; one that is damaged, as far as it can be read."""
    stored = records.stored(piece)
    if stored is not None:
        writer.copy(piece, *stored)
    else:
        write_piece(records, piece, [same(raw) for raw in records.messages_of(piece)], writer)


def write_piece(records: McapRecords, piece: Piece, messages: Sequence[OutMessage], writer: ChunkWriter) -> None:
    """A chunk of other messages in one's place."""
    defined = records.defined_in(piece) if piece.compression is not None else ()
    writer.write(messages, "zstd" if piece.compression is None else piece.compression, defined)


def same(raw: RawMessage) -> OutMessage:
    """A message as it is."""
    return OutMessage(raw.log_time, raw.publish_time, raw.sequence, raw.channel.id, raw.data)


def _compressed(data: bytes, compression: str) -> bytes:
    """As mcap's own writer does it."""
    if compression == "zstd":
        return zstandard.compress(data)
    return bytes(lz4.frame.compress(data)) if compression == "lz4" else data
