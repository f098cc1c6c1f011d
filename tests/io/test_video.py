"""VideoSource against FFmpeg's own conversion, exact times, awkward files, and packets handed on."""

import itertools
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import media
import numpy as np
import pytest
from av.video.reformatter import Interpolation

from spheremcap.core.frame import BgrFrame, Frame, Window, YuvFrame
from spheremcap.core.time import ticks_to_ns
from spheremcap.errors import SourceError
from spheremcap.io.encode import write_video
from spheremcap.io.video import VideoSource

REAL = Path(__file__).parents[3] / "shared" / "real"
ACCURATE = Interpolation.BILINEAR | Interpolation.ACCURATE_RND


def frames(path: Path, **more: Any) -> tuple[list[Frame], VideoSource]:
    with VideoSource(path, **more) as source:
        return list(source.frames()), source


def stamps(path: Path) -> list[int]:
    return [frame.stamp_ns for frame in frames(path)[0]]


def ffmpeg_pictures(path: Path, matrix: str, full_range: bool) -> list[Any]:
    """What FFmpeg itself makes of the file, as BGR arrays (stored orientation).

    By way of 4:4:4: swscale's short cut from subsampled YUV to BGR drops fractions and is 1 to 3 levels dark.
    """
    value = 2 if full_range else 1
    with av.open(str(path)) as container:
        stream = next(s for s in container.streams.video if not s.disposition & 0x400)
        pictures = []
        for frame in container.decode(stream):
            if not frame.format.is_rgb:
                frame = frame.reformat(format="yuv444p", interpolation=ACCURATE)
            colour = {"src_colorspace": matrix, "src_color_range": value, "dst_color_range": 2}
            pictures.append(frame.to_ndarray(format="bgr24", interpolation=ACCURATE, **colour))
        return pictures


def difference(a: Any, b: Any) -> Any:
    return np.abs(np.asarray(a, np.int16) - np.asarray(b, np.int16))


# -- colour and position -------------------------------------------------------------------------------------


FORMATS = [
    ("libx264", "yuv420p", "mp4"),
    ("libx264", "yuv422p", "mp4"),
    ("libx264", "yuv444p", "mp4"),
    ("libx264", "yuv420p10le", "mp4"),
    ("ffv1", "yuv422p10le", "mkv"),
    ("ffv1", "yuv440p", "mkv"),
    ("ffv1", "yuv411p", "mkv"),
    ("ffv1", "yuv410p", "mkv"),
    ("ffv1", "yuva420p", "mkv"),
    ("rawvideo", "nv12", "nut"),
    ("rawvideo", "nv21", "nut"),
    ("rawvideo", "yuyv422", "nut"),
    ("ffv1", "bgr0", "mkv"),
]


@pytest.mark.parametrize(("codec", "pixel_format", "suffix"), FORMATS)
def test_every_pixel_format_gives_the_colours_ffmpeg_gives(
    tmp_path: Path, codec: str, pixel_format: str, suffix: str
) -> None:
    options = {"crf": "2"} if codec == "libx264" else {}
    path = media.video(tmp_path / f"v.{suffix}", 3, codec=codec, pixel_format=pixel_format, options=options)
    got, source = frames(path)
    assert source.pixel_format == pixel_format
    assert len(got) == 3
    for frame, expected in zip(got, ffmpeg_pictures(path, "ITU601", False), strict=True):
        off = difference(frame.full, expected)
        assert off.mean() < 1.5, pixel_format
        assert difference(frame.full, media.picture(frame.index)).mean() < 4  # and the colours are the true ones


@pytest.mark.parametrize(
    ("matrix", "name", "tag"), [("ITU709", "bt709", 1), ("ITU601", "bt601", 5), ("BT2020", "bt2020", 9)]
)
@pytest.mark.parametrize("full_range", [False, True])
def test_matrix_and_range_are_those_of_the_stream(
    tmp_path: Path, matrix: str, name: str, tag: int, full_range: bool
) -> None:
    path = media.video(tmp_path / "v.mp4", 2, options={"crf": "2"}, matrix=tag, full_range=full_range)
    got, _ = frames(path)
    assert (got[0].matrix, got[0].full_range) == (name, full_range)  # type: ignore[attr-defined]
    expected = ffmpeg_pictures(path, matrix, full_range)[0]
    assert difference(got[0].full, expected).mean() < 1.2


def test_a_full_range_jpeg_video_is_read_as_full_range_with_centred_chroma(tmp_path: Path) -> None:
    path = media.video(tmp_path / "v.avi", 2, codec="mjpeg", pixel_format="yuvj420p", full_range=True)
    got, _ = frames(path)
    assert isinstance(got[0], YuvFrame)
    assert got[0].uv_origin_px == (0.5, 0.5)
    assert difference(got[0].full, ffmpeg_pictures(path, "ITU601", True)[0]).mean() < 1.5


def test_untagged_video_is_bt709_from_720_rows_on_and_bt601_below(tmp_path: Path) -> None:
    for size, name in [((64, 720), "bt709"), ((64, 64), "bt601")]:
        path = media.video(tmp_path / "v.mp4", 1, size=size, matrix=2)
        assert frames(path)[0][0].matrix == name  # type: ignore[attr-defined]


@pytest.mark.parametrize("pixel_format", ["gray", "gray10le"])
def test_gray_video_is_gray(tmp_path: Path, pixel_format: str) -> None:
    path = media.video(tmp_path / "v.mkv", 1, codec="ffv1", pixel_format=pixel_format, full_range=True)
    image = frames(path)[0][0].full
    assert difference(image, ffmpeg_pictures(path, "ITU601", True)[0]).max() <= 2
    assert np.ptp(image.astype(int), axis=2).max() <= 1


def test_a_palette_gif_is_read(tmp_path: Path) -> None:
    path = media.video(tmp_path / "v.gif", 3, codec="gif", pixel_format="bgr8")
    got, _ = frames(path)
    assert all(isinstance(frame, BgrFrame) for frame in got)
    assert difference(got[1].full, media.picture(1)).mean() < 30  # 256 colours


def test_odd_sizes_and_padded_rows(tmp_path: Path) -> None:
    path = media.video(tmp_path / "v.mkv", 2, codec="ffv1", size=(97, 65))
    got, source = frames(path)
    assert (source.width_px, source.height_px) == (97, 65)
    assert got[0].full.shape == (65, 97, 3)
    assert difference(got[0].full, ffmpeg_pictures(path, "ITU601", False)[0]).mean() < 1.5


WINDOWS = [Window(0, 0, 20, 20), Window(13, 7, 31, 22), Window(50, 33, 30, 40), Window(-9, -5, 25, 25)]


def check_patches(frame: Frame) -> None:
    full = frame.full
    for window in WINDOWS:
        rows = np.clip(np.arange(window.y, window.y + window.height), 0, frame.height_px - 1)
        columns = np.clip(np.arange(window.x, window.x + window.width), 0, frame.width_px - 1)
        inside = window.clipped(frame.width_px, frame.height_px)
        y, x = inside.y - window.y, inside.x - window.x
        part = np.s_[y : y + inside.height, x : x + inside.width]
        assert difference(frame.patch(window)[part], full[rows[:, None], columns][part]).max() <= 1


@pytest.mark.parametrize(("turn", "clockwise"), [(0, 0), (90, 270), (180, 180), (-90, 90)])
@pytest.mark.parametrize("mirrored", [False, True])
def test_rotated_and_mirrored_video_is_upright(tmp_path: Path, turn: int, clockwise: int, mirrored: bool) -> None:
    path = media.rotated(tmp_path / "v.mp4", turn, **({"hflip": True} if mirrored else {}))
    got, source = frames(path)
    stored = ffmpeg_pictures(path, "ITU601", False)[0]
    # av_display_matrix_flip mirrors what av_display_rotation_set has turned.
    upright = np.rot90(stored, turn // 90)
    if mirrored:
        upright = displayed_by_matrix(path, stored)
    else:
        assert source.rotation_deg == clockwise
    assert (source.height_px, source.width_px) == upright.shape[:2] == got[0].full.shape[:2]
    assert difference(got[0].full, upright).mean() < 1.5
    assert difference(got[0].full, upright).max() < 25
    check_patches(got[0])
    lying = frames(without_matrix(path, tmp_path / "lying.ts"))[0][0].full
    same = displayed_by_matrix(path, lying) if turn or mirrored else lying
    assert difference(got[0].full, same).max() <= 1  # the chroma grid turns with the picture
    if turn or mirrored:
        assert source.passthrough_reason == "the picture is stored rotated or mirrored"


def without_matrix(path: Path, to: Path) -> Path:
    """The same packets where no display matrix goes: another encoding need not have the same pixels."""
    with av.open(str(path)) as read, av.open(str(to), "w", format="mpegts") as written:
        stream = written.add_stream_from_template(read.streams.video[0])
        for packet in read.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                written.mux(packet)
    return to


def displayed_by_matrix(path: Path, stored: Any) -> Any:
    """Every pixel moved by the display matrix on its own, as its definition says."""
    with av.open(str(path)) as container:
        matrix = next(container.decode(video=0)).side_data["DISPLAYMATRIX"]  # type: ignore[typeddict-item]
    a, b, _, c, d = np.sign(np.frombuffer(matrix, np.int32)[:5])
    height, width = stored.shape[:2]
    q, p = np.mgrid[:height, :width]
    x, y = a * p + c * q, b * p + d * q
    x, y = x - x.min(), y - y.min()
    shown = np.zeros((y.max() + 1, x.max() + 1, 3), np.uint8)
    shown[y, x] = stored
    return shown


@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p", "yuv444p"])
def test_a_patch_is_the_crop_of_the_whole_picture(tmp_path: Path, pixel_format: str) -> None:
    path = media.video(tmp_path / "v.mp4", 1, pixel_format=pixel_format)
    frame = frames(path)[0][0]
    assert isinstance(frame, YuvFrame)
    assert frame.uv_origin_px == (0.0, 0.5 if pixel_format == "yuv420p" else 0.0)  # H.264: left
    check_patches(frame)


def test_planes_are_views_of_the_decoders_memory_and_outlive_the_source(tmp_path: Path) -> None:
    path = media.video(tmp_path / "v.mp4", 8, options={"crf": "2"})
    with VideoSource(path) as source:
        got = list(source.frames())
    assert isinstance(got[2], YuvFrame)
    assert not got[2].y.flags.owndata
    assert not got[2].y.flags.writeable
    for frame in got:  # all eight still hold their own picture
        assert difference(frame.full, media.picture(frame.index)).mean() < 4


# -- time and order ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [Fraction(240000, 1001), Fraction(30000, 1001), Fraction(25)])
def test_constant_rates_are_exact_to_the_nanosecond(tmp_path: Path, rate: Fraction) -> None:
    path = media.plain(tmp_path / "v.mp4", 30, rate=rate)
    got, source = frames(path)
    assert [f.stamp_ns for f in got] == [ticks_to_ns(i, 1 / rate) for i in range(30)]
    assert [f.index for f in got] == list(range(30))
    assert source.stated_rate == rate
    assert source.frame_count_hint == 30


def test_variable_rate_keeps_every_stamp(tmp_path: Path) -> None:
    wanted = [0, 7, 33_000_001, 50_000_000, 1_200_000_003]
    write_video(tmp_path / "v.mp4", (media.picture(i) for i in range(5)), Fraction(30), stamps_ns=wanted)
    assert stamps(tmp_path / "v.mp4") == wanted


def test_b_frames_come_in_presentation_order(tmp_path: Path) -> None:
    path = media.plain(tmp_path / "v.mp4", 20, bframes=3, crf=5)
    got, source = frames(path)
    assert source.passthrough_reason is not None
    assert "B-frames" in source.passthrough_reason
    assert [f.stamp_ns for f in got] == [ticks_to_ns(i, Fraction(1, 30)) for i in range(20)]
    for frame in got:
        assert difference(frame.full, media.picture(frame.index)).mean() < 5
        assert frame.encoded is None


def test_pictures_an_edit_list_hides_are_not_shown(tmp_path: Path) -> None:
    got, source = frames(media.hidden_start(tmp_path / "v.mp4", hidden=3))
    assert len(got) == 5
    assert got[0].stamp_ns == 0
    assert difference(got[0].full, media.picture(3)).mean() < 6
    assert source.passthrough_reason == "an edit list hides some of its pictures"
    assert not source.lost


def test_a_late_first_picture_stays_late(tmp_path: Path) -> None:
    path = media.video(tmp_path / "v.mkv", 3, time_base=Fraction(1, 1000), pts=[500, 540, 580])
    assert stamps(path) == [500_000_000, 540_000_000, 580_000_000]


def test_a_transport_streams_clock_starts_anywhere_so_its_first_picture_is_the_start(tmp_path: Path) -> None:
    path = media.video(tmp_path / "v.ts", 4, options={"bf": "0"}, pts=[9000, 9001, 9003, 9004])
    assert stamps(path) == [ticks_to_ns(i, Fraction(1, 30)) for i in (0, 1, 3, 4)]


def test_stamps_that_fall_back_are_made_to_rise_and_counted(tmp_path: Path) -> None:
    """Two recordings behind one another in one transport stream: the clock starts again half-way."""
    part = media.video(tmp_path / "p.ts", 8, options={"bf": "0"}, pts=range(900, 940, 5)).read_bytes()
    (tmp_path / "v.ts").write_bytes(part + part)
    got, source = frames(tmp_path / "v.ts")
    assert len(got) == 16
    times = [f.stamp_ns for f in got]
    assert all(b > a for a, b in itertools.pairwise(times))
    assert source.lost.restamped == 1
    assert times[15] - times[8] == times[7] - times[0]


def test_a_bare_stream_without_stamps_is_counted(tmp_path: Path) -> None:
    got, source = frames(media.video(tmp_path / "v.h264", 4, options={"bf": "0"}))
    assert [f.index for f in got] == [0, 1, 2, 3]
    assert source.lost.restamped == 4
    assert all(b.stamp_ns > a.stamp_ns for a, b in itertools.pairwise(got))


def test_start_comes_from_the_caller_then_the_container_then_zero(tmp_path: Path) -> None:
    path = media.plain(tmp_path / "a.mp4", 2, creation_time="2025-06-01T10:00:00Z")
    with VideoSource(path) as source:
        assert (source.start_time_ns, source.start_time_source) == (1748772000 * 10**9, "creation-time")
        assert next(source.frames()).stamp_ns == 1748772000 * 10**9
    with VideoSource(path, start_time_ns=42) as source:
        assert (source.start_time_ns, source.start_time_source) == (42, "start-time")
        assert next(source.frames()).stamp_ns == 42
    with VideoSource(media.plain(tmp_path / "b.mp4", 2)) as source:
        assert (source.start_time_ns, source.start_time_source) == (0, "zero")


def test_reading_twice_gives_the_same_and_each_picture_is_decoded_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = media.plain(tmp_path / "v.mp4", 12)
    with VideoSource(path) as source:
        made: list[int] = []
        build = source.decoded.frame
        monkeypatch.setattr(source.decoded, "frame", lambda *a: made.append(a[0]) or build(*a))
        first = [(f.stamp_ns, f.encoded, f.full.tobytes()) for f in source.frames()]
        assert made == list(range(12))
        assert [(f.stamp_ns, f.encoded, f.full.tobytes()) for f in source.frames()] == first


# -- packets handed on ---------------------------------------------------------------------------------------


def nal_types(data: bytes, codec: str) -> list[int]:
    starts = [i + 3 for i in range(len(data) - 3) if data[i : i + 3] == b"\0\0\1"]
    return [data[i] & 31 if codec == "h264" else data[i] >> 1 & 63 for i in starts]


CODECS = [
    ("libx264", "mp4", {"bf": "0", "g": "4"}, {5}, {7, 8}),
    ("libx264", "ts", {"bf": "0", "g": "4"}, {5}, {7, 8}),
    ("libx264", "mkv", {"bf": "0", "g": "4"}, {5}, {7, 8}),
    ("libx265", "mp4", {"x265-params": "bframes=0:keyint=4:log-level=none"}, {19, 20, 21}, {32, 33, 34}),
]


@pytest.mark.parametrize(("codec", "suffix", "options", "key", "sets"), CODECS)
def test_packets_are_handed_on_as_one_complete_annex_b_picture_each(
    tmp_path: Path, codec: str, suffix: str, options: dict[str, str], key: set[int], sets: set[int]
) -> None:
    path = media.video(tmp_path / f"v.{suffix}", 10, codec=codec, options=options)
    got, source = frames(path)
    assert source.passthrough_reason is None
    name = "h264" if codec == "libx264" else "hevc"
    keys = 0
    for frame in got:
        encoded = frame.encoded
        assert encoded is not None
        assert encoded.format == ("h264" if name == "h264" else "h265")
        assert encoded.data.startswith((b"\0\0\0\1", b"\0\0\1"))
        types = nal_types(encoded.data, name)
        assert encoded.key == bool(key & set(types))
        assert not encoded.key or sets <= set(types)
        keys += encoded.key
    assert got[0].encoded is not None
    assert got[0].encoded.key
    assert keys >= 3
    # A decoder that sees nothing but the messages, one at a time, draws the very same pictures.
    decoder = av.CodecContext.create(name, "r")
    pictures = [p for f in got for p in decoder.decode(av.Packet(f.encoded.data))] + decoder.decode(None)  # type: ignore[union-attr]
    assert len(pictures) == len(got)
    for frame, shown in zip(got, pictures, strict=True):
        rows = np.frombuffer(memoryview(shown.planes[0]), np.uint8)  # type: ignore[union-attr]
        assert np.array_equal(rows.reshape(64, -1)[:, :96], frame.y)  # type: ignore[attr-defined]


def test_parameter_sets_missing_from_later_key_frames_are_put_in(tmp_path: Path) -> None:
    """A transport stream that has SPS and PPS only once, on its first picture."""

    def strip(data: bytes, index: int) -> bytes:
        parts = data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")
        kept = [part for part in parts if part and (index == 0 or part[0] & 31 not in (7, 8))]
        return b"".join(b"\0\0\0\1" + part for part in kept)

    path = tmp_path / "v.ts"
    media.video(path, 10, options={"bf": "0", "g": "4", "x264-params": "repeat-headers=1"}, change=strip)
    with av.open(str(path)) as container:
        raw = [nal_types(bytes(p), "h264") for p in container.demux(video=0) if p.size]
    assert sum(7 in types for types in raw) == 1  # the file is as bad as its story
    got, source = frames(path)
    assert source.passthrough_reason is None
    for frame in got:
        assert frame.encoded is not None
        if frame.encoded.key:
            assert {7, 8, 5} <= set(nal_types(frame.encoded.data, "h264"))


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"codec": "mpeg4"}, "the codec is mpeg4"),
        ({"pixel_format": "yuv422p"}, "the pixel format is yuv422p"),
        ({"pixel_format": "yuv420p10le"}, "the pixel format is yuv420p10le"),
        (
            {"options": {"flags": "+ildct+ilme", "x264-params": "tff=1:bframes=0"}},
            "the pictures are interlaced",
        ),
    ],
)
def test_streams_that_cannot_be_handed_on_say_why(tmp_path: Path, more: dict[str, Any], why: str) -> None:
    got, source = frames(media.video(tmp_path / "v.mp4", 3, **more))
    assert (source.passthrough_reason or "").startswith(why)
    assert all(frame.encoded is None for frame in got)


def test_packets_are_left_alone_when_not_wanted(tmp_path: Path) -> None:
    got, source = frames(media.plain(tmp_path / "v.mp4"), packets=False)
    assert source.passthrough_reason == "packets were not asked for"
    assert got[0].encoded is None


# -- damaged and missing -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["none", "folder", "empty", "text", "noise", "sound", "nomoov"])
def test_files_that_are_no_video_are_one_line_that_names_the_file(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("sound.wav" if kind == "sound" else "notes.txt" if kind == "text" else "file.mp4")
    if kind == "folder":
        path.mkdir()
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_text("these are notes, not a video\n" * 50)
    elif kind == "noise":
        path.write_bytes(np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8).tobytes())
    elif kind == "sound":
        media.sound_only(path)
    elif kind == "nomoov":
        media.cut(path, media.plain(tmp_path / "whole.mp4"), 0.6)
    with pytest.raises(SourceError) as caught:
        VideoSource(path)
    message = str(caught.value)
    expected = {
        "none": "no such file", "folder": "is a folder", "empty": "is empty", "text": "a text file",
        "noise": "not a video", "sound": "no video stream", "nomoov": "without its index",
    }[kind]  # fmt: skip
    assert message.startswith(f"{path}: ")
    assert expected in message
    assert "\n" not in message


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "avi", "flv"])
def test_truncated_files_give_what_can_be_decoded_and_say_so(tmp_path: Path, suffix: str) -> None:
    if suffix == "mp4":
        whole = media.index_first(tmp_path / "whole.mp4")
    else:
        codec = "mjpeg" if suffix == "avi" else "libx264"
        pixel_format = "yuvj420p" if suffix == "avi" else "yuv420p"
        whole = media.video(tmp_path / f"whole.{suffix}", 30, codec=codec, pixel_format=pixel_format)
    everything, intact = frames(whole)
    assert len(everything) == 30
    assert not intact.lost
    got, source = frames(media.cut(tmp_path / f"cut.{suffix}", whole, 0.7))
    assert 5 < len(got) < 30
    assert [f.stamp_ns for f in got] == [f.stamp_ns for f in everything[: len(got)]]
    assert source.lost
    assert source.lost.stopped is not None
    assert "truncated" in source.lost.stopped
    assert all("\n" not in line for line in source.lost.lines())
    for frame, same in list(zip(got, everything, strict=False))[:-3]:
        assert np.array_equal(frame.full, same.full)


def test_an_mp4_cut_between_two_pictures_is_truncated_too(tmp_path: Path) -> None:
    whole = media.index_first(tmp_path / "whole.mp4")
    with av.open(str(whole)) as container:
        ends = [p.pos + p.size for p in container.demux(video=0) if p.size and p.pos is not None]
    (tmp_path / "cut.mp4").write_bytes(whole.read_bytes()[: ends[14]])
    got, source = frames(tmp_path / "cut.mp4")
    assert len(got) == 15
    assert source.lost.stopped is not None
    assert "it ends after 15 of 30 pictures" in source.lost.stopped


def test_a_picture_that_never_comes_out_is_counted_without_an_error_from_the_decoder(tmp_path: Path) -> None:
    """The decoder takes the last packet, a filler without a picture, and says nothing."""

    def fill(data: bytes, index: int) -> bytes:
        return b"\0\0\0\1\x0c\xff\x80" if index == 9 else data

    got, source = frames(media.video(tmp_path / "v.ts", 10, options={"bf": "0"}, change=fill))
    assert len(got) == 9
    assert source.lost.undecodable == 1


def test_a_truncated_transport_stream_is_reported(tmp_path: Path) -> None:
    whole = media.video(tmp_path / "whole.ts", 30, options={"bf": "0"})
    got, source = frames(media.cut(tmp_path / "cut.ts", whole, 0.7))
    assert 5 < len(got) < 30
    assert source.lost


def test_garbage_packets_are_skipped_and_counted(tmp_path: Path) -> None:
    got, source = frames(media.bad_packets(tmp_path / "v.avi", bad=(4, 7)))
    assert [f.stamp_ns for f in got] == [ticks_to_ns(i, Fraction(1, 30)) for i in range(12) if i not in (4, 7)]
    assert [f.index for f in got] == list(range(10))
    assert source.lost.undecodable == 2
    assert source.lost.stopped is None
    assert source.lost.lines() == ["2 pictures could not be decoded: missing"]


def test_a_video_without_one_good_picture_is_an_error(tmp_path: Path) -> None:
    path = media.bad_packets(tmp_path / "v.avi", bad=range(12))
    with pytest.raises(SourceError, match="no picture could be decoded"):
        VideoSource(path)


def test_reading_stops_where_the_picture_size_changes(tmp_path: Path) -> None:
    got, source = frames(media.growing(tmp_path / "v.h264"))
    assert len(got) == 4
    assert source.lost.stopped is not None
    assert "changes from 96x64 to 64x48" in source.lost.stopped


def test_the_video_is_taken_and_not_the_cover(tmp_path: Path) -> None:
    got, source = frames(media.cover_and_video(tmp_path / "v.mp4"))
    assert (source.width_px, source.height_px, len(got)) == (96, 64, 4)


def test_ffmpeg_says_nothing_of_its_own(tmp_path: Path) -> None:
    path = media.cut(tmp_path / "cut.mp4", media.index_first(tmp_path / "w.mp4"), 0.7)
    code = f"from spheremcap.io.video import VideoSource\nlist(VideoSource({str(path)!r}).frames())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout + done.stderr == ""


@pytest.mark.parametrize("name", ["green_ball_toss.mp4", "red_pendulum_portrait.mp4", "yellow_ball_occluded.avi"])
def test_real_clips_read_whole(name: str) -> None:
    if not (REAL / name).exists():
        pytest.skip("the real clips are not here")
    with VideoSource(REAL / name) as source:
        count, last = 0, -1
        for frame in source.frames():
            assert frame.stamp_ns > last
            count, last = count + 1, frame.stamp_ns
        assert count == source.frame_count_hint
        assert not source.lost
