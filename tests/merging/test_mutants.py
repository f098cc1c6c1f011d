"""Damaged recordings: whatever a merge makes of them, fewer messages than there were are said."""

import random
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from spheremcap.errors import SpheremcapError
from spheremcap.merging.dataset import Source, merge

COUNT = 60


def whole(path: Path, compression: CompressionType, checksums: bool) -> bytes:
    with path.open("wb") as file:
        writer = Writer(
            file, chunk_size=400, compression=compression, enable_crcs=checksums, enable_data_crcs=checksums
        )
        writer.start()
        schema = writer.register_schema("thing", "jsonschema", b"{}")
        channels = [writer.register_channel(f"/{topic}", "json", schema) for topic in "ab"]
        for k in range(COUNT):
            writer.add_message(channels[k % 2], 10**18 + k, b'{"k": %d}' % k, 10**18)
        writer.finish()  # type: ignore[no-untyped-call]
    return path.read_bytes()


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("checksums", [True, False])
def test_no_mutant_loses_a_message_in_silence(compression: CompressionType, checksums: bool, tmp_path: Path) -> None:
    rng = random.Random(7)
    data = whole(tmp_path / "whole.mcap", compression, checksums)
    merged = 0
    for _ in range(150):
        mutant = bytearray(data)
        for _ in range(rng.choice([1, 1, 2, 4])):
            mutant[rng.randrange(len(mutant))] = rng.randrange(256)
        (tmp_path / "mutant.mcap").write_bytes(mutant)
        try:
            dataset = merge([Source(tmp_path / "mutant.mcap")], tmp_path / "out.mcap", overwrite=True)
        except SpheremcapError:
            continue
        merged += 1
        there = sum(dataset.merged.counts.values())
        assert there == COUNT or dataset.lost, bytes(mutant).hex()
    assert merged > 100
