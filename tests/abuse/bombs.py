"""Recordings made by hand whose chunks are not what they say they are."""

import struct
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Schema
from mcap.writer import MCAP0_MAGIC


def recording(path: Path, *chunks: Chunk) -> Path:
    """An MCAP of these chunks, with a JSON channel 1 on /a, and no summary."""
    builder = RecordBuilder()
    Header("", "by hand").write(builder)
    Schema(id=1, name="thing", encoding="jsonschema", data=b"{}").write(builder)
    Channel(id=1, topic="/a", message_encoding="json", metadata={}, schema_id=1).write(builder)
    for chunk in chunks:
        chunk.write(builder)
    DataEnd(0).write(builder)
    Footer(0, 0, 0).write(builder)
    path.write_bytes(MCAP0_MAGIC + builder.end() + MCAP0_MAGIC)
    return path


def message(stamp_ns: int, data: bytes = b"{}") -> bytes:
    """A message record on channel 1."""
    return struct.pack("<BQHIQQ", 5, 22 + len(data), 1, 0, stamp_ns, stamp_ns) + data


def chunk(records: bytes, compression: str, *, size: int | None = None, says_size: bool = True) -> Chunk:
    """The records compressed; `size` is what the chunk states, `says_size` whether the zstd frame states its own."""
    if compression == "zstd":
        data = zstandard.ZstdCompressor(write_content_size=says_size).compress(records)
    elif compression == "lz4":
        data = lz4.frame.compress(records)
    else:
        data = records
    stated = len(records) if size is None else size
    return Chunk(
        compression=compression, data=data, message_start_time=1, message_end_time=9, uncompressed_crc=0,
        uncompressed_size=stated,
    )  # fmt: skip
