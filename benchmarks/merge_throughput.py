"""Throughput of merge and copy in MB/s, beside plain reading and writing with the mcap package.

usage: python benchmarks/merge_throughput.py [--mb 200]

Two recordings are made: `video` has 60 kB access units at 240 Hz, as a passed-through H.264 recording has,
`samples` 400-byte messages, as sensors send them. Times are the best of three; sizes are those of the message
data.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from spheremcap.io.join import McapStream, merge_streams
from spheremcap.io.mcap_records import McapRecords


def record(path: Path, total: int, size: int, compressible: bool) -> Path:
    """A recording of `total` bytes in messages of `size` bytes; video does not compress, samples do."""
    rng = np.random.default_rng(1)
    block = rng.integers(0, 8 if compressible else 256, size, np.uint8).tobytes()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        ids = [writer.register_channel(f"/{path.stem}/{k}", "x", 0) for k in range(4)]
        for k in range(total // size):
            writer.add_message(ids[k % 4], k * 4_166_667, block[k % 200 :] + block[: k % 200], k, k)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def plain_read(path: Path) -> None:
    with path.open("rb") as file:
        for _ in make_reader(file).iter_messages():
            pass


def plain_copy(path: Path, out: Path) -> None:
    with path.open("rb") as file, out.open("wb") as target:
        writer = Writer(target)
        writer.start()
        ids: dict[int, int] = {}
        for _, channel, message in make_reader(file).iter_messages():
            if channel.id not in ids:
                ids[channel.id] = writer.register_channel(channel.topic, "x", 0)
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def our_read(path: Path) -> None:
    with McapRecords(path) as records:
        for _ in records.messages():
            pass


def our_merge(paths: list[Path], out: Path) -> None:
    opened = [McapRecords(path) for path in paths]
    merge_streams([McapStream(records) for records in opened], out, overwrite=True)
    for records in opened:
        records.close()


def best(run: Callable[[], None]) -> float:
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mb", type=int, default=200, help="size of each recording")
    size_mb = parser.parse_args().mb
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.mcap"
        for name, size, compressible in (("video", 60_000, False), ("samples", 400, True)):
            mb = size_mb if size > 1000 else size_mb // 10
            path = record(Path(folder) / f"{name}.mcap", mb * 1_000_000, size, compressible)
            other = record(Path(folder) / f"{name}2.mcap", mb * 1_000_000, size, compressible)
            rows = {
                "read, mcap package": best(lambda p=path: plain_read(p)),  # type: ignore[misc]
                "read, ours": best(lambda p=path: our_read(p)),  # type: ignore[misc]
                "copy, mcap package": best(lambda p=path: plain_copy(p, out)),  # type: ignore[misc]
                "copy, ours": best(lambda p=path: our_merge([p], out)),  # type: ignore[misc]
                "merge of two, ours": best(lambda p=path, q=other: our_merge([p, q], out)) / 2,  # type: ignore[misc]
            }
            for what, seconds in rows.items():
                rate = mb * 1e6 / size / seconds
                print(f"{name:8} {what:20} {mb / seconds:8.0f} MB/s {rate:10.0f} messages/s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
