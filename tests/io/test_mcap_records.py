"""Reading whole, unindexed, truncated and damaged MCAP files; the files come from the reference writer."""

import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from spheremcap.errors import SourceError
from spheremcap.io import mcap_records
from spheremcap.io.mcap_records import McapRecords

Key = tuple[str, int, int, int, bytes]


def small_file(
    *,
    compression: CompressionType = CompressionType.NONE,
    chunked: bool = True,
    indexed: bool = True,
) -> bytes:
    """Twelve messages on two topics in several chunks, log times out of order; metadata, an attachment."""
    out = BytesIO()
    writer = Writer(
        out,
        chunk_size=220,
        compression=compression,
        use_chunking=chunked,
        index_types=IndexType.ALL if indexed else IndexType.NONE,
        repeat_channels=indexed,
        repeat_schemas=indexed,
        use_statistics=indexed,
        use_summary_offsets=indexed,
    )
    writer.start(profile="", library="test")
    schema = writer.register_schema("thing", "jsonschema", b'{"type":"object"}')
    a = writer.register_channel("/a", "json", schema, {"k": "v"})
    b = writer.register_channel("/b", "json", 0)
    writer.add_metadata("about", {"x": "1"})
    for k in range(12):
        log_time = 1000 + 10 * k - (25 if k % 5 == 4 else 0)
        writer.add_message((a, b)[k % 2], log_time, b"%d" % k * (20 + k), publish_time=k, sequence=k)
    writer.add_attachment(5, 6, "notes.txt", "text/plain", b"hello")
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def read(tmp_path: Path, data: bytes) -> tuple[list[Key], McapRecords]:
    path = tmp_path / "file.mcap"
    path.write_bytes(data)
    with McapRecords(path) as records:
        found = [(m.channel.topic, m.sequence, m.log_time, m.publish_time, m.data) for m in records.messages()]
        assert sum(records.counts.values()) >= len(found)
        assert [f[2] for f in found] == sorted(f[2] for f in found)
    return found, records


def reference(data: bytes) -> list[Key]:
    return [
        (c.topic, m.sequence, m.log_time, m.publish_time, m.data)
        for _, c, m in make_reader(BytesIO(data)).iter_messages()
    ]


def top_level(data: bytes) -> list[tuple[int, int, int]]:
    """(start, opcode, end) of every record at the top level."""
    position, out = 8, []
    while position + 9 <= len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, position)
        out.append((position, opcode, position + 9 + length))
        position += 9 + length
    return out


VARIANTS = [
    pytest.param({}, id="plain"),
    pytest.param({"compression": CompressionType.ZSTD}, id="zstd"),
    pytest.param({"compression": CompressionType.LZ4}, id="lz4"),
    pytest.param({"indexed": False}, id="unindexed"),
    pytest.param({"chunked": False}, id="unchunked"),
]


@pytest.mark.parametrize("variant", VARIANTS)
def test_whole_file_reads_as_the_reference_does(tmp_path: Path, variant: dict[str, object]) -> None:
    data = small_file(**variant)  # type: ignore[arg-type]
    found, records = read(tmp_path, data)
    wanted = reference(small_file())
    assert sorted(found) == sorted(wanted)
    assert [f[2] for f in found] == [f[2] for f in wanted]
    assert records.lost == []
    assert {(c.topic, c.message_encoding) for c in records.channels.values()} == {
        ("/a", "json"),
        ("/b", "json"),
    }
    assert [s.name for s in records.schemas.values()] == ["thing"]
    assert [(m.name, m.metadata) for m in records.metadata] == [("about", {"x": "1"})]
    assert records.counts == {1: 6, 2: 6}
    with McapRecords(records.path) as again:
        assert [(a.name, a.data, a.log_time, a.create_time) for a in again.attachments()] == [
            ("notes.txt", b"hello", 6, 5)
        ]
        assert [m.sequence for m in again.messages({"/b"})] == [f[1] for f in found if f[0] == "/b"]


@pytest.mark.parametrize("variant", VARIANTS)
def test_cut_anywhere_keeps_all_that_came_before(tmp_path: Path, variant: dict[str, object]) -> None:
    data = small_file(**variant)  # type: ignore[arg-type]
    boundaries = top_level(data)
    cuts = sorted({p for r in boundaries for p in (r[0], r[2])} | set(range(9, len(data), 7)))
    whole = reference(data) if variant.get("indexed", True) else reference(small_file())
    ends: dict[int, int] = {}  # messages wholly inside the first n bytes, counted chunk by chunk
    seen = 0
    for _, opcode, end in boundaries:
        if opcode == 5:
            seen += 1
        ends[end] = seen
    for cut in cuts:
        if cut < 40:
            continue
        try:
            found, records = read(tmp_path, data[:cut])
        except SourceError:
            assert cut < boundaries[1][2]
            continue
        assert set(found) <= set(whole)
        if cut < len(data) - 8:
            assert records.lost, cut
        chunks = [r for r in boundaries if r[1] == 6 and r[2] <= cut]
        if chunks:  # every message of a chunk that is there is read
            inside = 0
            with McapRecords(tmp_path / "file.mcap") as again:
                inside = sum(again.counts.values())
            assert inside == len(found)
            assert len(found) >= sum(len(_messages_in(data, r)) for r in chunks)
        elif variant.get("chunked") is False:
            assert len(found) == max((n for e, n in ends.items() if e <= cut), default=0)


def _messages_in(data: bytes, record: tuple[int, int, int]) -> list[int]:
    """Log times in the message indexes that stand behind a chunk (all files here have the same messages)."""
    times: list[int] = []
    for _, opcode, end in top_level(data):
        if opcode == 7 and end > record[2]:
            break
    position = record[2]
    while data[position] == 7:
        length = struct.unpack_from("<Q", data, position + 1)[0]
        times += [struct.unpack_from("<Q", data, position + 15 + 16 * k)[0] for k in range((length - 6) // 16)]
        position += 9 + length
    return times


def test_cut_inside_an_uncompressed_chunk_keeps_its_whole_messages(tmp_path: Path) -> None:
    data = small_file()
    start, _, end = next(r for r in top_level(data) if r[1] == 6)
    counts = [len(read(tmp_path, data[:cut])[0]) for cut in range(start + 60, end)]
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] == 1  # the second of its two messages lacks the last byte


def test_cut_inside_a_large_zstd_chunk_keeps_the_blocks_before(tmp_path: Path) -> None:
    out = BytesIO()
    writer = Writer(out, chunk_size=1 << 30)
    writer.start()
    channel = writer.register_channel("/a", "x", 0)
    noise = [bytes((k * 7 + i * i * (k + 3)) % 251 for i in range(1000)) for k in range(600)]
    for k in range(600):
        writer.add_message(channel, k, noise[k], k, k)
    writer.finish()  # type: ignore[no-untyped-call]
    data = out.getvalue()
    start, _, end = next(r for r in top_level(data) if r[1] == 6)
    found, records = read(tmp_path, data[: (start + end) // 2])
    assert len(found) > 100
    assert all(f[4] == noise[f[1]] for f in found)
    assert any("does not decompress" in str(loss) or "cut short" in str(loss) for loss in records.lost)


def damaged(change: Callable[[bytearray, list[tuple[int, int, int]]], None], **variant: object) -> bytes:
    data = bytearray(small_file(**variant))  # type: ignore[arg-type]
    change(data, top_level(bytes(data)))
    return bytes(data)


def test_mangled_magic_is_reported_and_read_past(tmp_path: Path) -> None:
    for where, word in ((0, "start"), (-4, "end")):

        def change(data: bytearray, _: list[tuple[int, int, int]], where: int = where) -> None:
            data[where] ^= 0xFF

        found, records = read(tmp_path, damaged(change))
        assert len(found) == 12
        assert any(word in str(loss) for loss in records.lost)


def test_wrong_chunk_checksum_is_reported_and_the_messages_kept(tmp_path: Path) -> None:
    def change(data: bytearray, records: list[tuple[int, int, int]]) -> None:
        _, _, end = [r for r in records if r[1] == 6][1]
        data[end - 2] ^= 0x01

    found, records = read(tmp_path, damaged(change))
    assert len(found) == 12
    assert ["checksum" in str(loss) for loss in records.lost] == [True]


@pytest.mark.parametrize("byte", [1, 3, 8])
def test_wrong_chunk_length_costs_at_most_that_chunk(tmp_path: Path, byte: int) -> None:
    lengths = []

    def change(data: bytearray, records: list[tuple[int, int, int]]) -> None:
        start, _, end = [r for r in records if r[1] == 6][1]
        lengths.append(len(_messages_in(bytes(data), (start, 6, end))))
        data[start + byte] ^= 0x55

    found, records = read(tmp_path, damaged(change))
    assert len(found) >= 12 - lengths[0]
    assert records.lost


def test_garbage_in_a_compressed_chunk_costs_only_what_is_behind_it(tmp_path: Path) -> None:
    def change(data: bytearray, records: list[tuple[int, int, int]]) -> None:
        start, _, _ = [r for r in records if r[1] == 6][1]
        data[start + 60 : start + 70] = b"\xff" * 10

    for compression in (CompressionType.ZSTD, CompressionType.LZ4):
        found, records = read(tmp_path, damaged(change, compression=compression))
        assert len(found) >= 7
        assert sum("does not decompress" in str(loss) for loss in records.lost) == 1
        assert sum("statistics say" in str(loss) for loss in records.lost) == len(records.lost) - 1 > 0


@pytest.mark.parametrize("chunked", [True, False])
def test_wrong_message_length_costs_that_message(tmp_path: Path, chunked: bool) -> None:
    for add in (3, 40, 5000):

        def change(data: bytearray, _: list[tuple[int, int, int]], add: int = add) -> None:
            at = data.index(b"666666") - 31  # the header of message 6
            data[at + 1 : at + 9] = struct.pack("<Q", struct.unpack_from("<Q", data, at + 1)[0] + add)

        found, records = read(tmp_path, damaged(change, chunked=chunked))
        assert {f[1] for f in found} >= set(range(12)) - {6}, add
        assert records.lost


def test_every_single_byte_error_is_survived(tmp_path: Path) -> None:
    data = small_file()
    for at in range(0, len(data), 5):
        hurt = bytearray(data)
        hurt[at] ^= 0xA5
        found, _ = read(tmp_path, bytes(hurt))
        assert len(found) >= 6, at


NOISE = st.binary(min_size=1, max_size=60)
HEADERS = st.builds(lambda kind, size: struct.pack("<BQ", kind, size), st.integers(0, 255), st.integers(0, 2**64 - 1))


@st.composite
def soups(draw: st.DrawFn) -> tuple[bytes, bool]:
    """Records of a small file in any order, some cut or changed, with noise between; and whether all are whole."""
    compression = draw(st.sampled_from([CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4]))
    file = small_file(compression=compression, chunked=draw(st.booleans()), indexed=draw(st.booleans()))
    records = [file[start:end] for start, _, end in top_level(file)]
    hurt = draw(st.booleans())
    out = [file[:8]]
    for _ in range(draw(st.integers(1, 25))):
        kind = draw(st.integers(0, 5)) if hurt else 5
        record = draw(st.sampled_from(records))
        at = draw(st.integers(0, len(record) - 1))
        if kind == 0:
            record = draw(st.one_of(NOISE, HEADERS))
        elif kind == 1:
            record = record[:at]
        elif kind == 2:
            record = record[:at] + draw(st.binary(min_size=1, max_size=8)) + record[at + 1 :]
        out.append(record)
    return b"".join(out), not hurt


GENUINE = {f[1:] for f in reference(small_file())}


@settings(max_examples=300, deadline=None)
@given(soups())
def test_no_soup_of_records_is_too_strange(tmp_path_factory: pytest.TempPathFactory, soup: tuple[bytes, bool]) -> None:
    data, whole = soup
    path = tmp_path_factory.getbasetemp() / "soup.mcap"
    path.write_bytes(data)
    try:
        records = McapRecords(path)
    except SourceError:  # nothing in it is a record: then nothing but noise was put in
        assert not whole
        return
    with records:
        found = list(records.messages())
        assert list(records.messages()) == found
        assert len(list(records.attachments())) <= len(data)
        records.check_data()
    assert [m.log_time for m in found] == sorted(m.log_time for m in found)
    if whole:
        assert {m[1:] for m in found} <= GENUINE


def test_the_checksum_of_the_data_section_is_compared_when_asked_for(tmp_path: Path) -> None:
    out = BytesIO()
    writer = Writer(out, compression=CompressionType.NONE, enable_crcs=False, enable_data_crcs=True)
    writer.start()
    channel = writer.register_channel("/a", "json", 0)
    writer.add_message(channel, 5, b"hello" * 20, 5)
    writer.add_metadata("about", {"x": "1"})
    writer.finish()
    for data, lost in ((out.getvalue(), 0), (out.getvalue().replace(b"hello", b"hullo", 1), 1)):
        _, records = read(tmp_path, data)
        assert records.lost == []
        with McapRecords(tmp_path / "file.mcap") as opened:
            opened.check_data()
            assert len(opened.lost) == lost


def test_a_metadata_record_that_became_another_kind_is_missed(tmp_path: Path) -> None:
    data = bytearray(small_file())
    start = next(start for start, opcode, _ in top_level(bytes(data)) if opcode == 12)
    data[start] = 0x90  # a private record, which may stand anywhere
    _, records = read(tmp_path, bytes(data))
    assert any("say 1 metadata records, 0 are there" in str(loss) for loss in records.lost)


def test_readings_side_by_side_share_the_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file.mcap"
    path.write_bytes(small_file(compression=CompressionType.ZSTD))
    opened: list[int] = []
    open_piece = McapRecords._open
    monkeypatch.setattr(McapRecords, "_open", lambda self, p, r: opened.append(p.offset) or open_piece(self, p, r))
    with McapRecords(path) as records:
        pairs = list(zip(records.messages({"/a"}), records.messages({"/b"}), strict=True))
        assert len(pairs) == 6
        assert len(opened) == len(set(opened)) == records.chunk_count


def test_what_is_not_an_mcap_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no such file"):
        McapRecords(tmp_path / "absent.mcap")
    for content in (b"", b"RIFF" * 1000, b"\x89MCAP0\r\n"):
        (tmp_path / "x.mcap").write_bytes(content)
        with pytest.raises(SourceError, match=r"not an MCAP file|is empty"):
            McapRecords(tmp_path / "x.mcap")


def test_overlapping_chunks_hold_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten chunks that all span the whole recording: chunks over the limit are read again, order is kept."""
    monkeypatch.setattr(mcap_records, "_HELD_BYTES", 5000)
    out = BytesIO()
    writer = Writer(out, chunk_size=2000)
    writer.start()
    channel = writer.register_channel("/a", "x", 0)
    for k in range(200):
        writer.add_message(channel, (k * 37) % 200, b"x" * 100, k, k)
    writer.finish()  # type: ignore[no-untyped-call]
    found, records = read(tmp_path, out.getvalue())
    assert [f[2] for f in found] == list(range(200))
    assert records.unordered > 0


def test_statistics_that_do_not_parse_are_a_loss(tmp_path: Path) -> None:
    """Without them nobody could say whether all messages are there."""

    def change(data: bytearray, records: list[tuple[int, int, int]]) -> None:
        start = next(start for start, opcode, _ in records if opcode == 0x0B)
        data[start + 9 + 42] ^= 0x40  # the length of the counts by channel

    found, records = read(tmp_path, damaged(change))
    assert len(found) == 12
    assert any("statistics" in loss.what for loss in records.lost)
