"""Any picture by its index is the frame that reading from the start gives: pixels, index and stamp."""

import gc
import random
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import media
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

import clips
from spheremcap.core.frame import Frame
from spheremcap.errors import UsageError
from spheremcap.io import pictures
from spheremcap.io.pictures import open_pictures
from spheremcap.io.sources import open_input
from spheremcap.io.video import VideoSource
from spheremcap.io.video_index import DecodedIndex, PacketIndex

REAL = Path(__file__).parents[3] / "shared" / "real"
LIKE_A_PHONE = {"bf": "3", "g": "8", "sc_threshold": "0"}
OPEN_GROUPS = LIKE_A_PHONE | {"x264-params": "open-gop=1"}


def pixels(frame: Frame) -> np.ndarray:
    return frame.reduced(1)


def read_in_order(path: Path, **more: Any) -> dict[int, tuple[int, np.ndarray]]:
    """Stamp and pixels of each frame by index, as tracking sees them."""
    with open_input(path, packets=False, **more) as given:
        return {f.index: (f.stamp_ns, pixels(f)) for f in given.views[0].source.frames()}


def check(path: Path, kind: type | None = None, held_bytes: int = 1 << 20, **more: Any) -> list[int]:
    """Looks every picture up in a jumbled order, then all backwards and forwards; returns the key frames."""
    expected = read_in_order(path, **more)
    with open_pictures(path, held_bytes=held_bytes, **more) as found:
        assert (found.first_index, found.count) == (min(expected), max(expected) + 1)
        there = range(found.first_index, found.count)
        jumbled = random.Random(1).sample(there, len(there))
        for index in [*jumbled, *reversed(there), *there]:
            frame = found.frame(index)
            if index not in expected:
                assert frame is None
                continue
            stamp_ns, image = expected[index]
            assert frame is not None
            assert (frame.index, frame.stamp_ns, found.stamp_ns(index)) == (index, stamp_ns, stamp_ns)
            np.testing.assert_array_equal(pixels(frame), image)
            assert found.index_at(stamp_ns) == index
        if kind is not None:
            assert isinstance(found._index, kind)
        keys = [found.key_at(index) for index in there]
        assert all(key <= index for key, index in zip(keys, there, strict=True))
        return sorted(set(keys))


def test_an_mp4_without_b_frames(tmp_path: Path) -> None:
    assert check(media.index_first(tmp_path / "a.mp4"), PacketIndex) == [0, 5, 10, 15, 20, 25]


@pytest.mark.parametrize("options", [LIKE_A_PHONE, OPEN_GROUPS], ids=["closed", "open"])
@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts"])
def test_pictures_stored_in_another_order_than_they_are_shown(
    tmp_path: Path, options: dict[str, str], suffix: str
) -> None:
    path = media.video(tmp_path / f"a.{suffix}", 30, options=options)
    assert len(check(path, PacketIndex)) >= 3


@pytest.mark.parametrize(("codec", "suffix"), [("libx265", "mp4"), ("mjpeg", "avi"), ("ffv1", "mkv"), ("mpeg4", "mp4")])
def test_other_codecs_and_containers(tmp_path: Path, codec: str, suffix: str) -> None:
    pixel_format = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    check(media.video(tmp_path / f"a.{suffix}", 20, codec=codec, pixel_format=pixel_format, options={"g": "6"}))


def test_pictures_before_their_key_frame_hang_on_the_group_before(tmp_path: Path) -> None:
    """MPEG-2 has open groups, and its decoder gives the pictures before a key frame however broken."""
    options = {"g": "6", "bf": "2", "sc_threshold": "1000000000"}
    check(media.video(tmp_path / "a.mkv", 24, codec="mpeg2video", options=options), PacketIndex)


def test_uneven_times_and_a_start_that_is_not_zero(tmp_path: Path) -> None:
    pts = [600, 650, 651, 700, 900, 2000, 2001, 2002, 2003, 2010]
    path = media.video(tmp_path / "a.mp4", 10, pts=pts, time_base=Fraction(1, 600), options={"bf": "0", "g": "4"})
    check(path, PacketIndex, start_time_ns=clips.START_NS)


def test_pictures_that_an_edit_list_hides_are_not_counted(tmp_path: Path) -> None:
    check(media.hidden_start(tmp_path / "a.mp4"))


def test_a_turned_video(tmp_path: Path) -> None:
    check(media.rotated(tmp_path / "a.mp4", 90), PacketIndex)


def test_without_time_stamps_the_file_is_decoded_once(tmp_path: Path) -> None:
    path = media.video(tmp_path / "a.h264", 9, options={"bf": "0", "g": "4"})
    check(path, DecodedIndex)


def test_once_a_packet_is_known_to_be_no_picture_it_is_not_counted(tmp_path: Path) -> None:
    path = media.bad_packets(tmp_path / "a.mp4", [5])
    expected = read_in_order(path)
    with open_pictures(path) as found:
        assert found.count == 12
        for index in (5, 10, 0, 4, 7):
            np.testing.assert_array_equal(pixels(found.frame(index)), expected[index][1])
        assert found.count == 11


def test_a_file_that_was_cut(tmp_path: Path) -> None:
    check(media.cut(tmp_path / "b.mp4", media.index_first(tmp_path / "a.mp4"), 0.6))


def test_a_picture_size_that_changes_ends_it(tmp_path: Path) -> None:
    check(media.growing(tmp_path / "a.h264"))


def test_a_damaged_time_stamp_is_that_of_reading_in_order(tmp_path: Path) -> None:
    pts = [0, 1, 2, 3, 10**15, 10**15 + 1]
    path = media.video(tmp_path / "a.mkv", 6, pts=pts, options={"bf": "0"}, time_base=Fraction(1, 30))
    check(path, DecodedIndex)


def test_a_folder_whose_numbers_have_a_gap(tmp_path: Path) -> None:
    for number in (3, 4, 6, 7):
        cv2.imwrite(str(tmp_path / f"p_{number:03}.png"), media.picture(number))
    check(tmp_path, rate=Fraction(50))


def video_recording(path: Path, count: int = 24, **options: str) -> Path:
    """H.264 packets of a file as messages."""
    film = media.video(path.with_suffix(".mp4"), count, options={"g": "6", "bf": "0"} | options)
    with VideoSource(film) as source:
        packets = [frame.encoded for frame in source.frames()]
    return clips.write_messages(path, "/camera/video", [CompressedVideo(format="h264", data=p.data) for p in packets])


def test_packets_in_a_recording(tmp_path: Path) -> None:
    assert check(video_recording(tmp_path / "a.mcap")) == [0, 6, 12, 18]


def test_going_from_group_to_group_leaves_no_picture_behind(tmp_path: Path) -> None:
    """One that is tied to itself keeps its decoder's memory, until Python looks for such."""
    with open_pictures(video_recording(tmp_path / "a.mcap"), held_bytes=1) as found:
        gc.collect()
        gc.disable()
        gc.set_debug(gc.DEBUG_SAVEALL)
        try:
            for index in (19, 13, 7, 1):
                assert found.frame(index) is not None
            gc.collect()
            left = [one for one in gc.garbage if isinstance(one, av.VideoFrame)]
        finally:
            gc.set_debug(0)
            gc.garbage.clear()
            gc.enable()
    assert left == []


def test_a_recording_without_its_index(tmp_path: Path) -> None:
    path = video_recording(tmp_path / "a.mcap")
    data = path.read_bytes()
    path.write_bytes(data[: data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")])  # up to the end of the data section
    check(path)


@pytest.mark.parametrize("elsewhere", [lambda starts: starts[7] + 3, lambda starts: starts[8]])
def test_an_index_that_leads_elsewhere_is_not_followed(tmp_path: Path, elsewhere: Callable[[Any], int]) -> None:
    path = video_recording(tmp_path / "a.mcap")
    with open_pictures(path) as found:
        located = found._index._messages._located(0)
    stamps, starts = located.times, located.starts
    data, stamp = path.read_bytes(), stamps[7].to_bytes(8, "little")
    right = stamp + starts[7].to_bytes(8, "little")
    assert data.count(right) == 1
    path.write_bytes(data.replace(right, stamp + elsewhere(starts).to_bytes(8, "little")))
    check(path)


def test_still_pictures_in_a_recording_of_several_topics(tmp_path: Path) -> None:
    path = clips.write_recording(tmp_path / "a.mcap", ["/front/image", "/rear/image"])
    with open_pictures(path, topic="/rear/image") as found:
        assert (found.count, found.key_at(9), found.stamp_ns(9)) == (16, 9, clips.START_NS + 9 * clips.STEP_NS)
        assert found.calibration is not None
    with open_pictures(path, topic="/rear/image", time="log") as found:
        assert found.frame(9).stamp_ns == clips.START_NS + 9 * clips.STEP_NS + clips.LATER_NS


def test_a_message_that_is_no_picture_is_none(tmp_path: Path) -> None:
    image = np.zeros((4, 6, 3), np.uint8)
    messages = [
        RawImage(width=6, height=4, encoding="bgr8", step=18, data=image.tobytes() if k != 2 else b"x")
        for k in range(5)
    ]
    check(clips.write_messages(tmp_path / "a.mcap", "/image", messages))


def test_an_index_that_there_is_not_is_refused(tmp_path: Path) -> None:
    with open_pictures(media.plain(tmp_path / "a.mp4")) as found:
        for index in (-1, 8):
            for ask in (found.frame, found.stamp_ns, found.key_at):
                with pytest.raises(UsageError, match="there is no frame"):
                    ask(index)
        assert found.index_at(-1) == 0
        assert found.index_at(10**18) == 7


def test_opening_decodes_one_picture_and_a_step_decodes_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = media.index_first(tmp_path / "a.mp4")
    made: list[int] = []
    build = pictures.VideoSource.frames
    monkeypatch.setattr(pictures.VideoSource, "frames", lambda *a: made.append(1) or build(*a))
    with open_pictures(path) as found:
        decoded = found.source.decoded
        frame_of = decoded.frame
        monkeypatch.setattr(decoded, "frame", lambda *a: made.append(a[0]) or frame_of(*a))
        found.frame(13)
        assert made == [10, 11, 12, 13]
        for index in (12, 11, 10, 11, 14):
            found.frame(index)
        assert made == [10, 11, 12, 13, 14]
        found.frame(27)
        assert made[5:] == [25, 26, 27]
        assert found.holds(12)
        assert not found.holds(15)


def test_what_is_held_is_bounded_and_the_last_is_always_held(tmp_path: Path) -> None:
    path = media.index_first(tmp_path / "a.mp4")
    one = 96 * 64 * 3 // 2
    with open_pictures(path, held_bytes=3 * one) as found:
        found.frame(4)
        assert [index for index in range(6) if found.holds(index)] == [2, 3, 4]
    with open_pictures(path, held_bytes=1) as found:
        found.frame(4)
        assert [index for index in range(6) if found.holds(index)] == [4]


def test_a_look_that_is_no_longer_wanted_stops_and_goes_on_from_there(tmp_path: Path) -> None:
    with open_pictures(media.video(tmp_path / "a.mp4", 20, options={"bf": "0", "g": "20"})) as found:
        asked = iter([False, False, False, True])
        assert found.frame(15, lambda: next(asked)) is None
        assert [found.holds(i) for i in range(5)] == [True, True, True, False, False]
        assert found.frame(15).index == 15


def test_a_long_file_is_not_read_whole_to_open_it(tmp_path: Path) -> None:
    """What is read of it at the end of the file would fail."""
    path = media.video(
        tmp_path / "a.mp4", 60, options={"bf": "0", "g": "10"}, container_options={"movflags": "faststart"}
    )
    with av.open(str(path)) as container:
        entries = container.streams.video[0].index_entries
        begin, data = entries[50].pos, bytearray(path.read_bytes())
    data[begin:] = bytes(len(data) - begin)
    path.write_bytes(data)
    with open_pictures(path) as found:
        assert found.count == 60
        assert found.frame(45).index == 45


@pytest.mark.parametrize("name", ["green_ball_toss.mp4", "red_pendulum_portrait.mp4", "yellow_ball_occluded.avi"])
def test_clips_of_real_cameras(name: str) -> None:
    path = REAL / name
    if not path.exists():
        pytest.skip(f"{path} is not there: clips of real cameras stay outside the repository")
    expected = {}
    with VideoSource(path, packets=False) as source:
        for frame in source.frames():
            if frame.index % 17 == 0 and frame.index < 200:
                expected[frame.index] = frame.stamp_ns, pixels(frame)
    with open_pictures(path) as found:
        for index in reversed(expected):
            frame = found.frame(index)
            assert frame.stamp_ns == expected[index][0]
            np.testing.assert_array_equal(pixels(frame), expected[index][1])
