"""Coverage-guided fuzzing (atheris, libFuzzer) of what reads bytes: records, GPMF, Annex B, tables.

    pip install '.[fuzz]'
    python benchmarks/abuse/fuzz.py records --seconds 3600 --seed 1

begins with small whole files, prints its seed and what it came to, and stops at the first input for which a reader
raises anything but our own errors, takes more than 10 s or 600 MB, or is not true to what it read. The input is then in
the folder of this run, and belongs into tests/abuse/crashes/READER once the reader is mended.
"""

import argparse
import os
import struct
import sys
import tempfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

try:
    import atheris
except ImportError:
    atheris = None

if atheris is not None and __name__ == "__main__":
    with atheris.instrument_imports(include=["spheremcap.io", "spheremcap.merging"], enable_loader_override=False):
        import spheremcap.io.annex_b
        import spheremcap.io.mcap_records
        import spheremcap.merging.sensors  # noqa: F401

from spheremcap.errors import SpheremcapError
from spheremcap.io.annex_b import is_key_picture, units
from spheremcap.io.mcap_records import McapRecords
from spheremcap.merging.makers.gopro import payload_samples
from spheremcap.merging.sensors import read_sensors

FOLDER = Path(tempfile.mkdtemp(prefix="fuzz", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))


def records(data: bytes) -> None:
    """Everything that a tolerant reader gets is given, or damage is told."""
    path = FOLDER / "a.mcap"
    path.write_bytes(data)
    try:
        with McapRecords(path) as file:
            given = sum(1 for _ in file.messages())
            list(file.attachments())
            for topic in sorted({channel.topic for channel in file.channels.values()}):
                index = file.index_of(topic)
                for number in range(len(index)):
                    index.message(number)
            told = file.damage()
    except SpheremcapError:
        return
    tolerant = 0
    try:
        for record in StreamReader(BytesIO(data)).records:
            tolerant += isinstance(record, Message)
    except Exception:
        pass
    assert told or given >= tolerant, f"{given} messages without a word, a tolerant reader gets {tolerant}"


def gpmf(data: bytes) -> None:
    """Three axes a sample, no infinite values."""
    for quantity, values in payload_samples(data):
        assert quantity in ("linear_acceleration", "angular_velocity")
        assert values.ndim == 2
        assert values.shape[1] == 3
        assert not np.isinf(values).any()


def annex_b(data: bytes) -> None:
    """Units are parts of the stream, in its order, without start codes in them."""
    for format_ in ("h264", "h265"):
        at = 0
        for _, unit in units(data, format_):
            at = data.index(b"\0\0\1" + unit, at) + 3
            assert b"\0\0\1" not in unit
            assert not unit.endswith(b"\0")
    for format_ in ("h264", "h265", "vp9", "av1"):
        is_key_picture(data, format_)


def table(data: bytes) -> None:
    """Stamps are int nanoseconds that do not fall, and each has its values."""
    path = FOLDER / "a.csv"
    path.write_bytes(data)
    try:
        logs = read_sensors(path, rate_hz=100.0 if data[:1] == b"#" else None)
    except SpheremcapError:
        return
    for log in logs:
        assert log.stamp_ns.dtype == np.int64
        assert np.all(np.diff(log.stamp_ns) >= 0)
        assert all(len(values) == len(log.stamp_ns) for values in log.values.values())


READERS: dict[str, Callable[[bytes], None]] = {"records": records, "gpmf": gpmf, "annex_b": annex_b, "table": table}


def beginnings(reader: str) -> list[bytes]:
    """Small whole inputs."""
    if reader == "records":
        found = []
        for compression in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4):
            for chunked in (True, False):
                out = BytesIO()
                writer = Writer(out, chunk_size=200, compression=compression, use_chunking=chunked)
                writer.start()
                schema = writer.register_schema("thing", "jsonschema", b"{}")
                channels = [writer.register_channel(topic, "json", schema) for topic in ("/a", "/b")]
                writer.add_attachment(1, 2, "notes", "text/plain", b"x")
                writer.add_metadata("about", {"a": "b"})
                for k in range(12):
                    writer.add_message(channels[k % 2], k, b'{"a": 1}', k, k)
                writer.finish()  # type: ignore[no-untyped-call]
                found.append(out.getvalue())
        return found
    if reader == "gpmf":
        return [_telemetry(letter, order) for letter in "sf" for order in ("ZXY", "yxZ")]
    if reader == "annex_b":
        code = b"\0\0\0\1"
        h264 = (b"\x67abc", b"\x68de", b"\x65" + bytes(range(40)))
        return [
            b"".join(code + unit for unit in some) for some in (h264, (b"\x40\1x", b"\x26\1y"), (b"\x09\x10", b"\x41z"))
        ]
    return [
        b"time (s),acc_x (g),acc_y (g),acc_z (g)\n" + b"".join(b"%.3f,%d,1,2\n" % (k / 100, k) for k in range(20)),
        "Zeit [s];Geschwindigkeit [km/h]\n0,01;3,5\n0,02;3,6\n0,03;#N/A\n".encode("latin-1"),
        "Datum;Uhrzeit;Drehrate x (°/s)\n01.06.2025;10:00:00,5;1\n01.06.2025;10:00:01,5;2\n".encode("utf-16"),
        b"#\nangle (deg)\n1\n2\n3\n",
        b'timestamp,"w, x",note\n1748772000000,1,"a\n1748772000010,2,b\n1748772000020,3,c\n',
    ]  # fmt: skip


def _telemetry(letter: str, order: str) -> bytes:
    """A GPMF payload with an accelerometer."""

    def item(key: bytes, kind: str, size: int, body: bytes) -> bytes:
        head = struct.pack(">4scBH", key, kind.encode("latin-1"), size, len(body) // size)
        return head + body + bytes(-len(body) % 4)

    width = {"s": 2, "f": 4}[letter]
    body = np.arange(12).astype(f">{'i' if letter == 's' else 'f'}{width}").tobytes()
    stream = item(b"SCAL", "s", 2, struct.pack(">h", 418)) + item(b"ORIN", "c", 1, order.encode())
    stream += item(b"ACCL", letter, 3 * width, body)
    return item(b"DEVC", "\0", 1, item(b"STRM", "\0", 1, stream))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reader", choices=READERS)
    parser.add_argument("--seconds", type=int, default=3600)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if atheris is None:
        raise SystemExit("atheris is missing: pip install '.[fuzz]'")
    corpus = FOLDER / "corpus"
    corpus.mkdir()
    for number, data in enumerate(beginnings(given.reader)):
        (corpus / str(number)).write_bytes(data)
    print(f"{given.reader}: seed {given.seed}, {given.seconds} s, in {FOLDER}", flush=True)
    flags = [
        f"-seed={given.seed}", f"-max_total_time={given.seconds}", f"-artifact_prefix={FOLDER}/", "-max_len=20000",
        "-timeout=10", "-rss_limit_mb=600", "-print_final_stats=1", "-verbosity=0",
    ]  # fmt: skip
    atheris.Setup([sys.argv[0], *flags, os.fspath(corpus)], READERS[given.reader])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
