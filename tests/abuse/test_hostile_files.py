"""Inputs that would take all memory, wait for ever, or are no files at all: one line each, and nothing left behind."""

import contextlib
import os
import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from bombs import chunk, message, recording
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.records import Chunk
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set
from mutants import FAULT, Outcome, run

from clips import write_clip, write_messages, write_recording
from spheremcap.io import mcap_records

SEED = ("--seed", "orange@0=100,90,18")


def one_line(outcome: Outcome, code: int, *words: object) -> None:
    assert outcome.code == code, outcome
    assert FAULT not in outcome.err, outcome
    assert outcome.err.count("\n") == 1, outcome
    for word in words:
        assert str(word) in outcome.err, outcome


# --- chunks ---

MEGABYTE = 1 << 20
ZEROS = bytes(60 * MEGABYTE)
BOMBS = {
    "zstd that says its size": lambda: chunk(message(1) + ZEROS, "zstd", size=MEGABYTE),
    "zstd that does not say it": lambda: chunk(message(1) + ZEROS, "zstd", size=MEGABYTE, says_size=False),
    "lz4": lambda: chunk(message(1) + ZEROS, "lz4", size=MEGABYTE),
    "zstd, the chunk too large for any": lambda: chunk(message(1) + ZEROS, "zstd"),
    "zstd, stated a million times as large": lambda: chunk(message(1) * 1000, "zstd", size=1 << 50),
    "lz4, stated a million times as large": lambda: chunk(message(1) * 1000, "lz4", size=1 << 50),
    "plain, stated a million times as large": lambda: chunk(message(1) * 1000, "", size=1 << 50),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_chunk_takes_no_more_memory_than_it_states_and_than_any_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(mcap_records, "LARGEST_CHUNK_BYTES", 16 * MEGABYTE)
    made: Chunk = BOMBS[name]()
    path = recording(tmp_path / "bomb.mcap", made)
    there = len(message(1) + ZEROS) if made.uncompressed_size != 1 << 50 else 1000 * len(message(1))
    allowed = 1.2 * min(made.uncompressed_size, there, mcap_records.LARGEST_CHUNK_BYTES) + 8 * MEGABYTE
    tracemalloc.start()
    try:
        outcome = run("info", "--check", path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < allowed, (peak / MEGABYTE, allowed / MEGABYTE)
    assert outcome.code == 3, outcome
    assert "chunk of" in outcome.err
    merged = run("merge", path, "-o", tmp_path / "out.mcap")
    assert merged.code == 3
    assert int(merged.out.split()[0]) >= 1  # what comes before the fault is kept


def test_a_chunk_of_its_stated_size_is_no_bomb(tmp_path: Path) -> None:
    for compression in ("zstd", "lz4", ""):
        for says_size in (True, False):
            path = recording(tmp_path / "a.mcap", chunk(message(1) * 50, compression, says_size=says_size))
            outcome = run("info", "--check", path)
            assert (outcome.code, outcome.err) == (0, ""), compression


# --- pictures ---


def png_header(width: int, height: int) -> bytes:
    """A PNG whose header says its size, and whose data are none."""

    def part(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(b"\0" * 1000)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(part(*one) for one in parts)


def jpeg_header(width: int, height: int) -> bytes:
    """A JPEG of 8x8 whose frame header says another size."""
    data = bytearray(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(data)


def webp_header(width: int, height: int) -> bytes:
    body = b"VP8X" + struct.pack("<I", 10) + bytes(4)
    body += (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    return b"RIFF" + struct.pack("<I", 4 + len(body)) + b"WEBP" + body


LARGE = {"png": png_header(60_000, 60_000), "jpeg": jpeg_header(60_000, 60_000), "webp": webp_header(60_000, 60_000)}


def stills(path: Path, *pictures: bytes) -> Path:
    return write_messages(path, "/front/image", [CompressedImage(format="png", data=picture) for picture in pictures])


@pytest.mark.parametrize("kind", LARGE)
def test_a_picture_of_60000_by_60000_is_refused_before_it_takes_memory(tmp_path: Path, kind: str) -> None:
    tracemalloc.start()
    try:
        one_line(
            run("track", stills(tmp_path / "a.mcap", LARGE[kind]), "-o", tmp_path / "out.mcap", *SEED),
            1, "60000x60000", "million pixels",
        )  # fmt: skip
        folder = tmp_path / "pictures"
        folder.mkdir()
        (folder / f"a1.{kind}").write_bytes(LARGE[kind])
        outcome = run("track", folder, "--rate", "30", "-o", tmp_path / "out.mcap", *SEED)
        one_line(outcome, 1, "60000x60000")
        assert tracemalloc.get_traced_memory()[1] < 50 * MEGABYTE
    finally:
        tracemalloc.stop()
    assert not list(tmp_path.glob("out.mcap*"))


def test_one_such_picture_among_good_ones_is_counted(tmp_path: Path) -> None:
    good = cv2.imencode(".png", np.full((240, 320, 3), 90, np.uint8))[1].tobytes()
    outcome = run("track", stills(tmp_path / "a.mcap", good, LARGE["png"], good), "-o", tmp_path / "out.mcap", *SEED)
    assert outcome.code == 3, outcome
    assert "1 picture could not be decoded" in outcome.err


def test_a_seed_on_a_picture_that_cannot_be_read_is_said_before_anything_is_written(tmp_path: Path) -> None:
    good = cv2.imencode(".png", np.full((240, 320, 3), 90, np.uint8))[1].tobytes()
    outcome = run("track", stills(tmp_path / "a.mcap", b"?", b"?", good, good), "-o", tmp_path / "out.mcap", *SEED)
    one_line(outcome, 2, "seed of orange on frame 0", "starts on frame 2")
    assert not list(tmp_path.glob("out*"))


# --- stamps ---


def test_one_stamp_of_another_century_is_said_and_asks_for_no_memory(tmp_path: Path) -> None:
    from spheremcap.merging.sync import SyncError, track_acceleration

    stamps = np.arange(100, dtype=np.int64) * 5_000_000
    stamps[-1] = 2**62
    with pytest.raises(SyncError, match="more than a day: one of its stamps must be damaged"):
        track_acceleration(stamps, np.ones((100, 3)))


def test_a_sensor_without_one_message_that_can_be_read_is_none(tmp_path: Path) -> None:
    from spheremcap.io import recording as recordings
    from spheremcap.io._pb import ImuSample

    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        data = build_file_descriptor_set(ImuSample).SerializeToString()
        channel = writer.register_channel(
            "/sensors/imu", "protobuf", writer.register_schema(ImuSample.DESCRIPTOR.full_name, "protobuf", data)
        )
        for index in range(3):
            writer.add_message(channel, index, b"\xff" * 9, index)
        writer.finish()
    opened = recordings.open(path)
    assert opened.sensors == {}
    assert "/sensors/imu: 3 messages not as the schema says" in str(opened.damage)
    outcome = run("sync", path, "--marker", "orange", "--sensor", "imu")
    assert outcome.code == 2, outcome
    damaged, error = outcome.err.splitlines()
    assert "a.mcap is damaged: /sensors/imu: 3 messages not as the schema says" in damaged
    assert "no marker 'orange'" in error


# --- what is no file ---


@pytest.fixture(params=["missing", "folder", "empty", "pipe", "long name", "text", "mcap of text", "half a magic"])
def no_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    kind: str = request.param
    path = tmp_path / ("x.mcap" if "m" in kind[:4] else "x.mp4")
    if kind == "folder":
        path.mkdir()
    elif kind == "empty":
        path.touch()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "long name":
        path = tmp_path / ("x" * 300 + ".mcap")
    elif kind in ("text", "mcap of text"):
        path.write_text("hello\n" * 100)
    elif kind == "half a magic":
        path.write_bytes(b"\x89MCA")
    return path


@pytest.mark.parametrize("suffix", [".mp4", ".mcap"])
@pytest.mark.parametrize("verb", ["info", "check", "export", "sync", "track"])
def test_what_is_no_file_to_read_is_one_line(no_file: Path, tmp_path: Path, verb: str, suffix: str) -> None:
    path = no_file.with_suffix(suffix)
    with contextlib.suppress(OSError):
        no_file.rename(path)
    out = tmp_path / "out.csv"
    arguments = {
        "info": ["info", path],
        "check": ["info", "--check", path],
        "export": ["export", path, "-o", out],
        "sync": ["sync", path, "--marker", "a", "--sensor", "b"],
        "track": ["track", path, "-o", out.with_suffix(".out"), *SEED],
    }[verb]
    outcome = run(*arguments)
    assert outcome.code in (1, 2), outcome
    one_line(outcome, outcome.code, path.name[:50])
    assert not list(tmp_path.glob("out*"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read_is_one_line(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "a.mp4")
    path.chmod(0)
    one_line(run("info", path), 1, "Permission denied")


def test_settings_and_cameras_that_are_pipes_do_not_wait(tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip.mp4")
    for name, flag in (("s.toml", "-s"), ("c.yaml", "--camera"), ("seeds.toml", "--seeds")):
        os.mkfifo(tmp_path / name)
        seed = () if flag == "--seeds" else SEED
        one_line(run("track", clip, "-o", tmp_path / "o.mcap", *seed, flag, tmp_path / name), 2, name, "regular file")


@pytest.mark.parametrize(("flag", "other"), [("--seeds", "--settings"), ("--settings", "--seeds")])
def test_the_page_keeps_nothing_in_the_input_nor_where_it_cannot(tmp_path: Path, flag: str, other: str) -> None:
    clip = write_clip(tmp_path / "clip.mp4")
    (tmp_path / "link.toml").symlink_to(clip)
    (tmp_path / "round.toml").symlink_to("round.toml")
    os.mkfifo(tmp_path / "pipe.toml")
    for name, words in (
        ("clip.mp4", "is the input"), ("link.toml", "is the input"), ("pipe.toml", "is no regular file"),
        (".", "is no regular file"), ("none/s.toml", "no folder"), ("x" * 300, "cannot be written"),
        ("round.toml", "cannot be written"),
    ):  # fmt: skip
        one_line(run("annotate", clip, "--no-browser", flag, tmp_path / name), 2, words)
    both = tmp_path / "s.toml"
    one_line(run("annotate", clip, "--no-browser", flag, both, other, both), 2, "in one file")


def test_answers_about_frames_that_there_are_not_are_refused(tmp_path: Path) -> None:
    clip, recording_, seeds = write_clip(tmp_path / "clip.mp4"), tmp_path / "r.mcap", tmp_path / "seeds.toml"
    assert run("track", clip, "-o", recording_, *SEED).code == 0
    seeds.write_text("[[seeds]]\nkind = 'hidden'\nmarker = 'orange'\nframe = 3\nto_frame = 99999\n")
    outcome = run("retrack", recording_, "--seeds", seeds, "-o", tmp_path / "o.mcap")
    one_line(outcome, 2, "frames 3 to 99999", "there are frames 0 to 15")
    assert not list(tmp_path.glob("o.mcap*"))


# --- the boundary itself ---


def test_a_fault_of_our_own_is_one_line_with_how_to_report_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("seven\nlines")

    monkeypatch.setattr("spheremcap.io.summary.summarise", broken)
    log = write_recording(tmp_path / "a.mcap", ["/front/image"])
    monkeypatch.delenv("SPHEREMCAP_DEBUG", raising=False)
    outcome = run("info", log)
    assert outcome.code == 1
    assert outcome.err.count("\n") == 1
    assert all(word in outcome.err for word in (FAULT, "ZeroDivisionError", "seven lines", "SPHEREMCAP_DEBUG=1"))
    monkeypatch.setenv("SPHEREMCAP_DEBUG", "1")
    outcome = run("info", log)
    assert outcome.code == 1
    assert outcome.err.startswith("Traceback")
    assert "in broken" in outcome.err
