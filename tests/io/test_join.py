"""Merging recordings: every record byte for byte, in log-time order, coalesced, in little memory."""

import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, Status
from spheremcap.core.frame import EncodedPicture
from spheremcap.core.marker import MarkerSpec
from spheremcap.errors import UsageError
from spheremcap.io.join import Join, McapStream, Merged, merge_streams
from spheremcap.io.mcap_log import McapLog, RunInfo
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import open_output
from spheremcap.merging.clock import Clock, parse_drift

Row = tuple[str, int, int, int, bytes]


def write(
    path: Path,
    rows: Sequence[Row],
    *,
    metadata: dict[str, dict[str, str]] | None = None,
    attachments: Sequence[tuple[str, bytes]] = (),
    schema: bytes = b"{}",
    channel_metadata: dict[str, str] | None = None,
    profile: str = "",
    chunk_size: int = 300,
) -> Path:
    """A recording by the reference writer; rows are (topic, log_time, publish_time, sequence, data)."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size, compression=CompressionType.ZSTD)
        writer.start(profile=profile, library="another tool")
        schema_id = writer.register_schema("thing", "jsonschema", schema)
        ids: dict[str, int] = {}
        for name, facts in (metadata or {}).items():
            writer.add_metadata(name, facts)
        for topic, log_time, publish_time, sequence, data in rows:
            if topic not in ids:
                ids[topic] = writer.register_channel(topic, "json", schema_id, channel_metadata or {})
            writer.add_message(ids[topic], log_time, data, publish_time, sequence)
        for name, data in attachments:
            writer.add_attachment(1, 2, name, "text/plain", data)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def merge(inputs: Sequence[Path], output: Path, **options: Any) -> Merged:
    with ExitStack() as stack:
        streams = [McapStream(stack.enter_context(McapRecords(path)), **options) for path in inputs]
        return merge_streams(streams, output, overwrite=True)


def rows_of(path: Path) -> list[Row]:
    with path.open("rb") as file:  # in the order of the file
        return [
            (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
            for _, c, m in NonSeekingReader(file).iter_messages(log_time_order=False)
        ]


def rows(topic: str, times: Sequence[int]) -> list[Row]:
    return [(topic, t, t + 7, k, f"{topic}{k}".encode() * 5) for k, t in enumerate(times)]


@settings(max_examples=40, deadline=None)
@given(st.lists(st.lists(st.integers(0, 1000), max_size=60), min_size=1, max_size=4))
def test_merging_keeps_every_message_in_order(tmp_path_factory: pytest.TempPathFactory, times: list[list[int]]) -> None:
    folder = tmp_path_factory.mktemp("merge")
    written = [rows(f"/t{k % 2}", t) for k, t in enumerate(times)]
    paths = [write(folder / f"{k}.mcap", r) for k, r in enumerate(written)]
    merged = merge(paths, folder / "out.mcap")
    found = rows_of(folder / "out.mcap")
    assert Counter(found) == Counter(row for r in written for row in r)
    assert [r[1] for r in found] == sorted(r[1] for r in found)
    assert merged.counts == dict(Counter(r[0] for r in found))
    assert merged.lost == ()


def test_schemas_and_channels_coalesce_as_the_official_tool_does(tmp_path: Path) -> None:
    a = write(tmp_path / "a.mcap", rows("/x", [1, 5]), profile="ros2")
    b = write(tmp_path / "b.mcap", rows("/x", [2, 6]), profile="ros2")
    c = write(tmp_path / "c.mcap", rows("/x", [3]), schema=b"[]", profile="ros2")
    d = write(tmp_path / "d.mcap", rows("/x", [4]), channel_metadata={"k": "v"})
    merge([a, b], tmp_path / "ab.mcap")
    merge([a, b, c, d], tmp_path / "abcd.mcap")
    for name, schemas, channels, profile in (("ab", 1, 1, "ros2"), ("abcd", 2, 3, "")):
        reader = make_reader((tmp_path / f"{name}.mcap").open("rb"))
        summary = reader.get_summary()
        assert summary is not None
        assert (len(summary.schemas), len(summary.channels)) == (schemas, channels)
        assert reader.get_header().profile == profile
        assert reader.get_header().library.startswith("spheremcap/")


def test_metadata_clashes_are_resolved_and_attachments_kept(tmp_path: Path) -> None:
    a = write(tmp_path / "a.mcap", rows("/x", [1]), metadata={"run": {"v": "1"}}, attachments=[("n", b"a")])
    b = write(tmp_path / "b.mcap", rows("/x", [2]), metadata={"run": {"v": "2"}}, attachments=[("n", b"b")])
    c = write(tmp_path / "c.mcap", rows("/x", [3]), metadata={"run": {"v": "1"}, "run#2": {"z": "0"}})
    merged = merge([a, b, c], tmp_path / "out.mcap")
    reader = make_reader((tmp_path / "out.mcap").open("rb"))
    assert {m.name: m.metadata for m in reader.iter_metadata()} == {
        "run": {"v": "1"},
        "run#2": {"v": "2"},
        "run#2#2": {"z": "0"},
    }
    assert merged.renamed == {"run#2": "run", "run#2#2": "run#2"}
    assert [(x.name, x.data) for x in reader.iter_attachments()] == [("n", b"a"), ("n", b"b")]


def test_a_clock_moves_log_times_and_keeps_publish_times(tmp_path: Path) -> None:
    start = 1_700_000_000_000_000_000
    path = write(tmp_path / "imu.mcap", rows("/imu", [start, start + 10**10]))
    clock = Clock(12_500_000, parse_drift("-20ppm"), start)
    with McapRecords(path) as records:
        merge_streams([McapStream(records, clock=clock, prefix="/left")], tmp_path / "out.mcap")
    found = rows_of(tmp_path / "out.mcap")
    assert [(r[0], r[1] - start, r[2] - start) for r in found] == [
        ("/left/imu", 12_500_000, 7),
        ("/left/imu", 10**10 + 12_500_000 - 200_000, 10**10 + 7),
    ]
    metadata = list(make_reader((tmp_path / "out.mcap").open("rb")).iter_metadata())
    assert metadata[0].name.startswith("spheremcap/clock/imu/")
    assert metadata[0].metadata["offset_ns"] == "12500000"
    assert metadata[0].metadata["drift_ppm"] == "-20"


def test_a_stamp_before_1970_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", rows("/x", [10, 20]))
    with McapRecords(path) as records, pytest.raises(UsageError, match="before 1970"):
        merge_streams([McapStream(records, clock=Clock(-15))], tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [path]


def test_a_merge_tells_how_far_it_is_and_can_be_stopped(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", rows("/x", range(5000)) + rows("/y", range(500)))
    out, told = tmp_path / "out.mcap", list[tuple[int, int | None]]()

    def stopped_merge(most: int, **options: Any) -> Merged:
        told.clear()
        with McapRecords(path) as records:
            return merge_streams(
                [McapStream(records, **options)], out,
                progress=lambda *now: told.append(now), stop=lambda: told[-1][0] >= most,
            )  # fmt: skip

    merged = stopped_merge(2000)
    assert merged.stopped
    assert told == [(0, 5500), (1024, 5500), (2048, 5500)]
    assert not out.exists()
    part = tmp_path / "out.mcap.part"
    assert len(rows_of(part)) == sum(merged.counts.values()) == 2048
    assert make_reader(part.open("rb")).get_summary() is not None
    assert merged.part == part
    kept = part.read_bytes()
    nothing = stopped_merge(0)
    assert (nothing.stopped, nothing.part) == (True, None)
    whole = stopped_merge(10_000, topics={"/x"})
    assert not whole.stopped
    assert told[-1] == (4096, 5000)
    assert len(rows_of(out)) == 5000
    assert sorted(tmp_path.iterdir()) == [path, out, part]
    assert part.read_bytes() == kept
    assert f"spheremcap recover {part}" in whole.notes[0]


def test_a_copy_that_is_stopped_stays_so(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", rows("/x", range(5000)))
    with McapRecords(path) as records, open_output(tmp_path / "out.mcap", [path]) as writer:
        join = Join(writer, [McapStream(records)], lambda written: False)
        for limit in (1000, 2000, 3000):
            join.until(limit)
        join.rest()
        assert join.stopped
        assert writer.counts == {"/x": 1024}


def test_outputs_that_exist_or_are_inputs_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", rows("/x", [10, 20]))
    before = path.read_bytes()
    with McapRecords(path) as records:
        with pytest.raises(UsageError, match="is an input"):
            merge_streams([McapStream(records)], path, overwrite=True)
        merge_streams([McapStream(records)], tmp_path / "out.mcap")
        with pytest.raises(UsageError, match="exists"):
            merge_streams([McapStream(records)], tmp_path / "out.mcap")
    assert path.read_bytes() == before


def test_a_damaged_input_gives_what_can_be_read(tmp_path: Path) -> None:
    a = write(tmp_path / "a.mcap", rows("/x", range(0, 400, 2)))
    a.write_bytes(a.read_bytes()[:1500])
    b = write(tmp_path / "b.mcap", rows("/y", range(1, 100, 2)))
    merged = merge([a, b], tmp_path / "out.mcap")
    assert merged.counts["/y"] == 50
    assert 10 < merged.counts["/x"] < 200
    assert any("no footer" in line and "a.mcap" in line for line in merged.lost)


def test_the_merge_is_the_same_bytes_every_time(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"{k}.mcap", rows(f"/{k}", range(k, 500, 3))) for k in range(3)]
    merge(paths, tmp_path / "one.mcap")
    merge(paths, tmp_path / "two.mcap")
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()


CAMERA = Camera(640, 480, 500, 500, 320, 240)
MARKERS = [MarkerSpec("left_wrist")]


def result(k: int, stamp_ns: int) -> FrameResult:
    estimate = MarkerEstimate("left_wrist", k, stamp_ns, Status.SEEDED, Circle(100, 100, 20))
    return FrameResult(k, stamp_ns, (estimate,))


def our_recording(path: Path, start_ns: int) -> Path:
    info = RunInfo(input_name=path.stem)
    with McapLog(path, camera=CAMERA, markers=MARKERS, run=info) as log:
        for k in range(20):
            log.write(result(k, start_ns + k * 4_166_667), EncodedPicture(b"\xff\xd8\xff", "jpeg", True))
    return path


def test_our_messages_are_interleaved_with_a_copy(tmp_path: Path) -> None:
    """The way `track` adds to the input: everything that is in it, and ours at its place in time."""
    source = write(
        tmp_path / "in.mcap",
        rows("/front/image", [10**9 + k * 10**7 for k in range(20)]) + rows("/other", [5, 10**12]),
        metadata={"about": {"a": "b"}},
        chunk_size=10_000,
    )
    with McapRecords(source) as records, open_output(tmp_path / "out.mcap", [records.path]) as writer:
        join = Join(writer, [McapStream(records)])
        log = McapLog(writer, camera=CAMERA, markers=MARKERS, run=RunInfo(input_name="in.mcap"))
        for k in range(20):
            join.until(10**9 + k * 10**7)
            log.write(result(k, 10**9 + k * 10**7), None)
        log.close()
        join.rest()
    found = rows_of(tmp_path / "out.mcap")
    assert [r[1] for r in found] == sorted(r[1] for r in found)
    copied = [r for r in found if r[0] in ("/front/image", "/other")]
    assert Counter(copied) == Counter(rows_of(source))
    assert sum(r[0] == "/markers/left_wrist/state" for r in found) == 20
    names = [m.name for m in make_reader((tmp_path / "out.mcap").open("rb")).iter_metadata()]
    assert "about" in names


def test_copying_some_topics_only(tmp_path: Path) -> None:
    path = write(tmp_path / "in.mcap", rows("/a", [1, 2]) + rows("/b", [3]), metadata={"m": {}})
    merged = merge([path], tmp_path / "out.mcap", topics={"/b"}, extras=False)
    assert merged.counts == {"/b": 1}
    summary = make_reader((tmp_path / "out.mcap").open("rb")).get_summary()
    assert summary is not None
    assert [c.topic for c in summary.channels.values()] == ["/b"]
    assert summary.metadata_indexes == []


def test_two_recordings_of_ours_and_a_third_keep_every_count(tmp_path: Path) -> None:
    ours = [our_recording(tmp_path / f"{k}.mcap", 10**9 + k * 10**6) for k in range(2)]
    third = write(tmp_path / "third.mcap", rows("/x", range(10**9, 10**9 + 10**8, 10**6)))
    wanted = Counter(r[0] for path in (*ours, third) for r in rows_of(path))
    merged = merge([*ours, third], tmp_path / "out.mcap")
    found = rows_of(tmp_path / "out.mcap")
    assert merged.counts == dict(wanted) == dict(Counter(r[0] for r in found))
    assert [r[1] for r in found] == sorted(r[1] for r in found)
    reader = make_reader((tmp_path / "out.mcap").open("rb"))
    names = [m.name for m in reader.iter_metadata()]
    assert len(names) == len(set(names)) == 6
    summary = reader.get_summary()
    assert summary is not None
    schemas = [s.name for s in summary.schemas.values()]
    assert len(schemas) == len(set(schemas))


MEASURE = """
import resource, sys
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import open_output
from spheremcap.io.join import McapStream, merge_streams
base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
merge_streams([McapStream(McapRecords(p)) for p in sys.argv[2:]], sys.argv[1])
print(base // 1024, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


def large(path: Path, megabytes: int) -> Path:
    block = bytes(range(256)) * 400
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        ids = [writer.register_channel(f"/{path.stem}/{k}", "x", 0) for k in range(3)]
        for k in range(megabytes * 10):
            data = k.to_bytes(4, "little") + block[: 100_000 - 4]
            writer.add_message(ids[k % 3], 10**9 + k * 10**6, data, k, k)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


@pytest.mark.slow
def test_two_gigabytes_merge_within_300_megabytes(tmp_path: Path) -> None:
    paths = [large(tmp_path / "a.mcap", 2000), large(tmp_path / "b.mcap", 200)]
    out = tmp_path / "out.mcap"
    command = [sys.executable, "-c", MEASURE, str(out), *map(str, paths)]
    _, peak_mb = map(int, subprocess.run(command, capture_output=True, check=True, text=True).stdout.split())
    summary = make_reader(out.open("rb")).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 22_000
    assert peak_mb < 300
