"""A damaged stream gives the same pixels every time, however its frames are held, from a file and from a recording."""

import random
from collections import deque
from collections.abc import Iterable
from pathlib import Path

import av
import media
import numpy as np
import pytest
from test_picture import recording

from spheremcap.core.frame import Frame
from spheremcap.io import video, video_index
from spheremcap.io.annex_b import AnnexB
from spheremcap.io.mcap_images import McapImageSource
from spheremcap.io.pictures import open_pictures
from spheremcap.io.video import VideoSource

KINDS = {
    "h264.mp4": {"options": {"bf": "0", "g": "15"}},
    "h264 with B-frames.mkv": {"options": {"bf": "3", "g": "15"}},
    "mpeg4.avi": {"codec": "mpeg4"},
    "mjpeg.avi": {"codec": "mjpeg", "pixel_format": "yuvj420p", "full_range": True},
}


def hurt(data: bytes, seed: int) -> bytes:
    """A few bits of the pictures turned over."""
    chance, found = random.Random(seed), bytearray(data)
    for _ in range(chance.randint(2, 6)):
        found[chance.randrange(len(found) // 5, len(found) * 4 // 5)] ^= 1 << chance.randrange(8)
    return bytes(found)


def pixels(frames: Iterable[Frame], held: int) -> list[tuple[int, int, int]]:
    """Index, stamp and a hash of the pixels, while the last so many frames are held."""
    kept: deque[Frame] = deque(maxlen=held)
    found = []
    for frame in frames:
        kept.append(frame)
        found.append((frame.index, frame.stamp_ns, hash(frame.full.tobytes())))
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_gives_the_same_pixels_every_time(tmp_path: Path, kind: str) -> None:
    whole = media.video(tmp_path / kind, 40, size=(320, 240), **KINDS[kind])
    clean = pixels(VideoSource(whole).frames(), 0)
    path, changed = tmp_path / f"hurt {kind}", 0
    for seed in range(8):
        path.write_bytes(hurt(whole.read_bytes(), seed))
        found = []
        for held in (0, 1, 5, 30):
            with VideoSource(path) as source:
                found.append((pixels(source.frames(), held), source.lost))
                found.append((pixels(source.frames(), held), source.lost))  # once more, from the start
        assert all(one == found[0] for one in found), seed
        changed += found[0][0] != clean
        looked_up = []
        for held in (0, 30):
            with open_pictures(path) as pictures:
                wanted = random.Random(seed).sample(range(pictures.count), 5)
                looked_up.append(pixels(filter(None, map(pictures.frame, wanted)), held))
        assert looked_up[0] == looked_up[1], seed
    assert changed > 2


def test_pictures_shown_before_a_damaged_one_that_they_are_made_from_are_as_one_thread_makes_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = {"bf": "3", "g": "15", "b-pyramid": "none", "b_strategy": "0"}
    for seed in (10, 30, 31, 57):  # of 60, those that showed it
        chance = random.Random(seed)
        at = chance.randrange(16, 24)

        def turn(data: bytes, packet: int, chance: random.Random = chance, at: int = at) -> bytes:
            if packet != at:
                return data
            place, bit = chance.randrange(len(data) // 3, len(data)), 1 << chance.randrange(8)
            return data[:place] + bytes([data[place] ^ bit]) + data[place + 1 :]

        path = media.video(tmp_path / f"{seed}.mkv", 30, size=(320, 240), options=options, change=turn)
        with VideoSource(path) as source:
            found = pixels(source.frames(), 0)
        looked_up = in_order(path)
        monkeypatch.setattr(video, "open_video", lambda path, careful=False, real=video.open_video: real(path, True))
        monkeypatch.setattr(video_index, "open_video", video.open_video)
        with VideoSource(path) as source:
            assert found == pixels(source.frames(), 0), seed
        assert looked_up == in_order(path), seed
        monkeypatch.undo()


def in_order(path: Path) -> list[tuple[int, int, int]]:
    """What looking the pictures up gives, one after another."""
    with open_pictures(path) as pictures:
        return pixels(filter(None, map(pictures.frame, range(pictures.count))), 0)


def test_a_damaged_recording_gives_the_same_pixels_every_time(tmp_path: Path) -> None:
    whole = media.video(tmp_path / "a.mp4", 40, size=(320, 240), options={"bf": "0", "g": "15", "slices": "3"})
    with av.open(str(whole)) as container:
        stream = container.streams.video[0]
        annex_b = AnnexB("h264", stream)
        units = [annex_b.message(packet).data for packet in container.demux(stream) if packet.size]
    for seed in range(12):
        chance, found = random.Random(seed), [bytearray(unit) for unit in units]
        for _ in range(3):
            unit = found[chance.randrange(1, len(found))]
            unit[chance.randrange(len(unit) // 2, len(unit))] ^= 1 << chance.randrange(8)
        path = recording(tmp_path / "a.mcap", [bytes(unit) for unit in found], "h264")
        readings = []
        for held in (0, 2, 30):
            with McapImageSource(path) as source:
                readings.append((pixels(source.frames(), held), source.lost))
        assert all(one == readings[0] for one in readings), seed


def test_a_picture_that_hangs_on_a_damaged_one_is_not_shown_where_the_decoder_conceals_nothing(tmp_path: Path) -> None:
    options = {"preset": "ultrafast", "x265-params": "log-level=none:bframes=0:keyint=10:min-keyint=10:scenecut=0"}

    def cut(data: bytes, packet: int) -> bytes:
        return data[: len(data) // 2] + b"\xff" * (len(data) - len(data) // 2) if packet == 14 else data

    whole = media.video(tmp_path / "a.mkv", 30, codec="libx265", size=(320, 240), options=options)
    path = media.video(tmp_path / "b.mkv", 30, codec="libx265", size=(320, 240), options=options, change=cut)
    with VideoSource(whole) as good, VideoSource(path) as bad:
        expected = {frame.stamp_ns: frame.full for frame in good.frames()}
        found = {frame.stamp_ns: frame.full for frame in bad.frames()}
    stamps = sorted(expected)
    assert sorted(found) == stamps[:14] + stamps[20:]
    assert bad.lost.undecodable == 6
    for stamp_ns, image in found.items():
        np.testing.assert_array_equal(image, expected[stamp_ns])


def test_clean_video_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = []
    monkeypatch.setattr(video, "open_video", lambda *a, real=video.open_video: opened.append(a) or real(*a))
    for name, options in (("a.mp4", {"bf": "0"}), ("b.mkv", {"bf": "3"})):
        opened.clear()
        with VideoSource(media.video(tmp_path / name, 30, options=options), packets=False) as source:
            assert [frame.index for frame in source.frames()] == list(range(30))
        assert len(opened) == 1
