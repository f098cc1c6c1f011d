"""Chapters are the video that they were cut from: frames, times, packets, and any picture by its index."""

import random
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import media
import numpy as np
import pytest
from typer.testing import CliRunner

import clips
from spheremcap import api
from spheremcap.cli import app
from spheremcap.config import Settings, seeds_toml
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame
from spheremcap.core.marker import Seed
from spheremcap.core.time import ticks_to_ns
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.chapters import Chapters, chapters_in, write_list
from spheremcap.io.mcap_images import McapImageSource
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import checked_output
from spheremcap.io.pictures import open_pictures
from spheremcap.io.sources import fingerprint, open_input
from spheremcap.io.video import VideoSource
from spheremcap.io.video_index import DecodedIndex, JoinedIndex, PacketIndex
from spheremcap.io.video_summary import summarise_video

NO_B = {"bf": "0", "g": "4", "crf": "5"}
B = {"bf": "3", "g": "8", "sc_threshold": "0", "crf": "5"}


def split(whole: Path, at: Sequence[int], suffix: str = ".mp4", created: Sequence[str] = ()) -> list[Path]:
    """The video's packets in several files, each of which begins with the key frame stored at such a place and counts
    its time from there."""
    with av.open(str(whole)) as container:
        stream = container.streams.video[0]
        packets = [packet for packet in container.demux(stream) if packet.size]
        files = []
        for number, (begin, end) in enumerate(zip([0, *at], [*at, len(packets)], strict=True)):
            assert packets[begin].is_keyframe
            first = packets[begin].pts
            path = whole.with_name(f"{whole.stem}_{number}{suffix}")
            with av.open(str(path), "w") as out:
                if created:
                    out.metadata["creation_time"] = created[number]
                chapter = out.add_stream_from_template(stream)
                chapter.time_base = stream.time_base
                for packet in packets[begin:end]:
                    packet.pts, packet.dts = packet.pts - first, packet.dts - first
                    packet.stream = chapter
                    out.mux(packet)
            files.append(path)
    return files


def listed(files: Sequence[Path], name: str = "session.ffconcat") -> Path:
    path = files[0].with_name(name)
    path.write_text(write_list(files, path))
    return path


def chapters(folder: Path, count: int = 3, **more: Any) -> list[Path]:
    """Videos of eight different pictures each at 30 frames/s."""
    return split(media.video(folder / "a.mp4", 8 * count, options=NO_B, **more), range(8, 8 * count, 8))


def seen(frames: Sequence[Frame]) -> list[tuple[int, int, bytes]]:
    return [(frame.index, frame.stamp_ns, frame.full.tobytes()) for frame in frames]


KINDS: dict[str, dict[str, Any]] = {
    "h264": {"options": NO_B},
    "h264 with B-frames": {"options": B},
    "hevc": {"codec": "libx265", "options": {"x265-params": "bframes=0:keyint=8:min-keyint=8:log-level=none"}},
    "240000/1001": {"options": NO_B, "rate": Fraction(240000, 1001), "time_base": Fraction(1, 240000), "step": 1001},
    "240 in 1/240000": {"options": NO_B, "rate": Fraction(240), "time_base": Fraction(1, 240000), "step": 1000},
    "240 in 1/90000": {"options": NO_B, "rate": Fraction(240), "time_base": Fraction(1, 90000), "step": 375},
    "30000/1001 in 1/90000": {
        "options": B,
        "rate": Fraction(30000, 1001),
        "time_base": Fraction(1, 90000),
        "step": 3003,
    },
}


@pytest.mark.parametrize("kind", KINDS)
def test_chapters_are_the_video_that_they_were_cut_from(tmp_path: Path, kind: str) -> None:
    more = dict(KINDS[kind])
    if "step" in more:
        more["pts"] = range(0, 24 * more["step"], more.pop("step"))
    whole = media.video(tmp_path / "a.mp4", 24, **more)
    with VideoSource(whole, start_time_ns=clips.START_NS) as source:
        expected = seen(list(source.frames()))
    path = listed(split(whole, [8, 16]))
    with Chapters(path, start_time_ns=clips.START_NS) as source:
        assert (source.frame_count_hint, source.first_index, source.time_source) == (24, 0, "start-time")
        assert seen(list(source.frames())) == expected
        assert seen(list(source.frames())) == expected  # a second time from the start
        assert not source.lost
        assert (source.passthrough_reason is None) == (more["options"] is not B)
    with open_pictures(path, start_time_ns=clips.START_NS) as pictures:
        assert isinstance(pictures._index, JoinedIndex)
        assert all(isinstance(part, PacketIndex) for part in pictures._index._parts)


def test_fractions_of_a_nanosecond_are_carried_on(tmp_path: Path) -> None:
    """Each chapter ends between two nanoseconds."""
    rate = Fraction(240000, 1001)
    files = []
    for number in range(9):
        path = tmp_path / f"{number}.mp4"
        files.append(media.video(path, 4, options=NO_B, rate=rate, pts=range(0, 4004, 1001), time_base=1 / rate / 1001))
    with Chapters(listed(files)) as source:
        assert [frame.stamp_ns for frame in source.frames()] == [ticks_to_ns(index, 1 / rate) for index in range(36)]


@pytest.mark.parametrize(("suffix", "options"), [(".mp4", NO_B), (".mp4", B), (".mkv", B), (".ts", B)])
def test_any_picture_by_its_index_is_that_of_reading_in_order(
    tmp_path: Path, suffix: str, options: dict[str, str]
) -> None:
    files = [
        media.video(tmp_path / f"{9 - n}{suffix}", 11 + n, options=options) for n in range(3)
    ]  # not by their names
    path = listed(files)
    with open_input(path, packets=False) as given:
        expected = seen(list(given.views[0].source.frames()))
    stamps = [stamp for _, stamp, _ in expected]
    steps = np.diff(stamps)
    assert (steps > 30e6).all()
    assert (steps < 36e6).all()
    with open_pictures(path, held_bytes=40_000) as pictures:
        assert pictures.count == 36
        there = range(36)
        for index in [*random.Random(1).sample(there, 36), *reversed(there), *there]:
            frame = pictures.frame(index)
            assert frame is not None
            assert seen([frame]) == [expected[index]]
            assert pictures.stamp_ns(index) == stamps[index]
            assert pictures.index_at(stamps[index]) == index
            assert pictures.key_at(index) <= index
        assert [pictures.key_at(index) for index in (0, 11, 23)] == [0, 11, 23]
        with pytest.raises(UsageError, match="no frame 36"):
            pictures.frame(36)


def test_going_on_over_the_border_decodes_nothing_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    build = PacketIndex.frames_from
    monkeypatch.setattr(PacketIndex, "frames_from", lambda self, key: made.append(key) or build(self, key))
    with open_pictures(listed(chapters(tmp_path))) as pictures:
        assert [pictures.frame(index).index for index in range(24)] == list(range(24))
    assert made == [0, 0, 0]
    with open_pictures(listed(chapters(tmp_path))) as pictures:
        assert pictures.frame(22).index == 22
    assert made[3:] == [4]  # from its key frame, by the chapter's own index


def test_a_first_picture_that_comes_late_follows_at_once(tmp_path: Path) -> None:
    files = [
        media.video(tmp_path / f"{n}.mkv", 3, options=NO_B, time_base=Fraction(1, 1000), pts=[500, 540, 580])
        for n in range(2)
    ]
    with Chapters(listed(files)) as source:
        frames = [frame.stamp_ns // 10**6 for frame in source.frames()]
    assert frames[:3] == [500, 540, 580]
    assert frames[3:] == [580 + 33, 620 + 33, 660 + 33]  # a picture's length at 30 a second is what the file says


def test_pictures_that_an_edit_list_hides_take_no_time(tmp_path: Path) -> None:
    files = [media.hidden_start(tmp_path / f"{n}.mp4", hidden=3) for n in range(3)]
    path = listed(files)
    with Chapters(path) as source:
        frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == [ticks_to_ns(index, Fraction(1, 30)) for index in range(15)]
    with open_pictures(path) as pictures:
        assert [seen([pictures.frame(index)])[0] for index in range(pictures.count)] == seen(frames)


def test_where_chroma_lies_is_what_the_first_chapter_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next ones may begin with a picture that shows nothing of it."""
    answers = iter([True])
    monkeypatch.setattr("spheremcap.io.picture.lies_midway", lambda *planes: next(answers, False))
    with Chapters(listed(chapters(tmp_path))) as source:
        assert "midway" in source.chroma_note
        assert {frame.uv_origin_px for frame in source.frames()} == {(0.5, 0.5)}


def test_the_start_is_that_of_the_first_chapter(tmp_path: Path) -> None:
    times = ["2025-06-01T10:00:00Z", "2025-06-01T10:00:01Z"]
    files = split(media.video(tmp_path / "a.mp4", 16, options=NO_B), [8], created=times)
    with Chapters(listed(files)) as source:
        assert (source.start_time_ns, source.time_source) == (1748772000 * 10**9, "creation-time")
        assert next(source.frames()).stamp_ns == 1748772000 * 10**9
        assert source.notes == []


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (["10:00:00", "10:00:00", "10:00:00"], []),  # the time of the whole
        (["10:00:00", "10:00:02", "10:00:02"], []),
        (["10:00:00", "10:00:01", "10:11:01"], [("a_1.mp4", "a_2.mp4", "660 s later")]),
        (["10:00:00", "10:00:00", "10:11:01"], [("a_0.mp4", "a_2.mp4", "660 s later")]),
        (["10:20:00", "10:00:00", "10:00:01"], [("a_0.mp4", "a_1.mp4", "1200 s earlier")]),
    ],
)
def test_creation_times_that_contradict_are_said(
    tmp_path: Path, times: list[str], said: list[tuple[str, str, str]]
) -> None:
    whole = media.video(tmp_path / "a.mp4", 24, options=NO_B)
    path = listed(split(whole, [8, 16], created=[f"2025-06-01T{time}Z" for time in times]))
    with Chapters(path) as source:
        assert len(list(source.frames())) == 24
        lines = source.lost.lines()
        assert bool(source.lost) == bool(said)
    assert len(lines) == len(said)
    for line, (before, file, apart) in zip(lines, said, strict=True):
        assert f"{tmp_path / file} comes {apart} than it follows {tmp_path / before}: is a chapter missing" in line
    assert list(summarise_video(path).lost) == lines


def test_packets_of_all_chapters_are_handed_on_and_decode(tmp_path: Path) -> None:
    """The chapters' parameter sets differ, as their key frames say."""
    files = [media.video(tmp_path / f"{n}.mp4", 10, options=NO_B | {"refs": str(n + 1)}) for n in range(2)]
    with Chapters(listed(files)) as source:
        frames = list(source.frames())
    assert all(frame.encoded is not None for frame in frames)
    assert [frame.index for frame in frames if frame.encoded.key] == [0, 4, 8, 10, 14, 18]
    decoder = av.CodecContext.create("h264", "r")
    shown = [p for frame in frames for p in decoder.decode(av.Packet(frame.encoded.data))] + decoder.decode(None)
    assert len(shown) == 20
    for frame, picture in zip(frames, shown, strict=True):
        rows = np.frombuffer(memoryview(picture.planes[0]), np.uint8)
        assert np.array_equal(rows.reshape(64, -1)[:, :96], frame.y)


def test_packets_are_handed_on_only_when_those_of_all_chapters_can(tmp_path: Path) -> None:
    plain = media.video(tmp_path / "a.mp4", 8, options=NO_B)
    others = [
        (media.video(tmp_path / "b.mp4", 8, options=B), "b.mp4: the stream reorders its pictures (B-frames)"),
        (
            media.video(tmp_path / "c.mp4", 8, codec="libx265", options=KINDS["hevc"]["options"]),
            "the codec of c.mp4 is hevc, that of a.mp4 h264",
        ),
    ]
    for other, why in others:
        with Chapters(listed([plain, other])) as source:
            assert source.passthrough_reason == why
            assert [frame.encoded for frame in source.frames()] == [None] * 16
    with Chapters(listed([plain, plain.rename(tmp_path / "d.mp4")][1:]), packets=False) as source:
        assert source.passthrough_reason == "packets were not asked for"


# -- damage --------------------------------------------------------------------------------------------------


def test_a_damaged_last_chapter_is_counted(tmp_path: Path) -> None:
    first = media.index_first(tmp_path / "a.mp4", 20)
    last = media.cut(tmp_path / "b.mp4", media.index_first(tmp_path / "whole.mp4", 20), 0.7)
    with Chapters(listed([first, last])) as source:
        frames = list(source.frames())
    assert 25 < len(frames) < 40
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert source.lost.stopped is not None
    assert f"{last}: truncated: it ends after {len(frames) - 20} of 20 pictures" in source.lost.stopped
    assert source.lost.lines()[-1] == source.lost.stopped
    with open_input(listed([first, last])) as given:
        assert len(list(given.views[0].source.frames())) == len(frames)
        assert all(str(last) in line for line in given.lost())


def test_what_is_lost_is_summed_and_told_by_chapter(tmp_path: Path) -> None:
    files = [media.bad_packets(tmp_path / f"{n}.mp4", bad) for n, bad in enumerate([[3], [], [0, 5, 11]])]
    path = listed(files)
    with Chapters(path) as source:
        frames = list(source.frames())
        assert source.lost.undecodable == 4
        assert source.lost.lines() == [
            f"{files[0]}: 1 picture could not be decoded: missing",
            f"{files[2]}: 3 pictures could not be decoded: missing",
        ]
    assert [frame.index for frame in frames] == list(range(32))
    step = Fraction(1, 30)
    places = [place for place in range(36) if place not in (3, 24, 29, 35)]  # a missing picture leaves its time
    assert [frame.stamp_ns for frame in frames] == [ticks_to_ns(place, step) for place in places]
    with open_pictures(path) as pictures:
        for index in (*range(31, -1, -1), *range(32)):
            pictures.frame(min(index, pictures.count - 1))
        assert pictures.count == 32
        assert [type(part) for part in pictures._index._parts] == [DecodedIndex, PacketIndex, DecodedIndex]
        for expected in frames:
            found = pictures.frame(expected.index)
            assert seen([found]) == seen([expected])


def test_after_a_chapter_that_was_cut_the_next_one_follows(tmp_path: Path) -> None:
    files = [
        media.cut(tmp_path / "a.mp4", media.index_first(tmp_path / "whole.mp4", 20), 0.7),
        media.index_first(tmp_path / "b.mp4", 5),
    ]
    path = listed(files)
    with Chapters(path) as source:
        frames = list(source.frames())
    assert "truncated" in source.lost.lines()[1]
    steps = np.diff([frame.stamp_ns for frame in frames])
    assert (steps[:-5] > 33e6).all() and (steps[:-5] < 34e6).all()  # noqa: PT018
    assert 33e6 < steps[-5] < 68e6  # over the picture of which there is only a part
    with open_pictures(path) as pictures:
        assert [seen([pictures.frame(index)])[0] for index in range(pictures.count)] == seen(frames)


@pytest.mark.parametrize("kind", ["bare", "restarted"])
def test_a_chapter_that_does_not_say_when_it_ends_is_refused(tmp_path: Path, kind: str) -> None:
    if kind == "bare":
        path = media.video(tmp_path / "a.h264", 8, options=NO_B)
    else:
        path = tmp_path / "b.ts"
        path.write_bytes(media.video(tmp_path / "a.ts", 8, options=NO_B, pts=range(900, 1300, 50)).read_bytes() * 2)
    with pytest.raises(SourceError, match="its time stamps do not say when it ends"):
        Chapters(listed([path]))


@pytest.mark.parametrize(
    ("other", "shape"),
    [
        (lambda path: media.video(path, 3, size=(64, 48)), "64x48"),
        (lambda path: media.rotated(path, 180), "96x64 shown 180 degrees clockwise"),
        (lambda path: media.rotated(path, 0, hflip=True), "96x64 mirrored"),
        (
            lambda path: media.video(path, 3, prepare=lambda s: setattr(s, "sample_aspect_ratio", Fraction(4, 3))),
            "96x64 with pixels 1.33333 times as wide as high",
        ),
    ],
    ids=["size", "turned", "mirrored", "aspect"],
)
def test_chapters_that_are_not_alike_are_refused(tmp_path: Path, other: Any, shape: str) -> None:
    first, second = media.plain(tmp_path / "a.mp4", 3), other(tmp_path / "b.mp4")
    with pytest.raises(SourceError) as caught:
        Chapters(listed([first, second]))
    assert f"{second} is {shape}, {first} is 96x64: " in str(caught.value)


# -- the list ------------------------------------------------------------------------------------------------

NAMES = ["GOPR0001.MP4", "it's a day.mp4", "day two/'quoted'.mp4", r"back\slash.mp4", "ü.mp4"]


def test_a_list_that_is_written_names_the_files_to_us_and_to_ffmpeg(tmp_path: Path) -> None:
    (tmp_path / "day two").mkdir()
    (tmp_path / "lists").mkdir()
    files = [media.plain(tmp_path / name, 2) for name in NAMES]
    beside, elsewhere = tmp_path / "a.ffconcat", tmp_path / "lists" / "b.FFCONCAT"
    for path in (beside, elsewhere):
        path.write_text(write_list(files, path), encoding="utf-8")
        assert chapters_in(path) == files
        with av.open(str(path), format="concat", options={"safe": "0"}) as container:
            assert sum(1 for _ in container.decode(video=0)) == 2 * len(files)
    assert "file 'GOPR0001.MP4'\n" in beside.read_text()
    assert str(tmp_path) not in beside.read_text()
    assert f"file '{tmp_path}/GOPR0001.MP4'\n" in elsewhere.read_text()
    with pytest.raises(UsageError, match="line break"):
        write_list([tmp_path / "a\nb.mp4"], beside)


def test_a_list_may_have_comments_blank_lines_and_any_of_ffmpegs_quotes(tmp_path: Path) -> None:
    for name in ("a.mp4", "b c.mp4", "d'e.mp4"):
        media.plain(tmp_path / name, 2)
    path = tmp_path / "list.ffconcat"
    path.write_bytes(
        "\ufeff# made by hand\r\n\r\nffconcat  version 1.0\r\n  file a.mp4\r\n# another\r\n"
        "file b\\ c.mp4 \r\n file\t 'd'\\''e.mp4'".encode()
    )
    assert [file.name for file in chapters_in(path)] == ["a.mp4", "b c.mp4", "d'e.mp4"]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (None, "no such file"),
        ("", "is empty"),
        ("file a.mp4", "line 1 is 'file a.mp4'; a list of chapters begins with the line ffconcat version 1.0"),
        ("ffconcat version 2.0", "begins with the line ffconcat version 1.0"),
        ("#\nffconcat version 1.0\n", "names no file; expected lines such as file 'GOPR0001.MP4'"),
        ("ffconcat version 1.0\n\nfile a.mp4\ninpoint 3", "line 4 is 'inpoint 3'; expected lines such as file "),
        ("ffconcat version 1.0\nfile", "line 2 is 'file'; expected one name"),
        ("ffconcat version 1.0\nfile a.mp4 b.mp4", "expected one name, as in file 'GOPR0001.MP4'"),
        ("ffconcat version 1.0\nfile 'a.mp4", "expected one name, as in file 'GOPR0001.MP4'"),
        ("ffconcat version 1.0\nfile ''", "is a folder, not a video"),
        ("ffconcat version 1.0\nfile gone.mp4", "gone.mp4: no such file"),
        ("ffconcat version 1.0\nfile a.mp4\nfile a.mp4", "line 3: a.mp4 is there twice"),
        ("ffconcat version 1.0\nfile x.ffconcat", "line 2 names a list, x.ffconcat: name the video files themselves"),
        ("ffconcat version 1.0\nfile other.ffconcat", "line 2 names a list, other.ffconcat"),
        ("ffconcat version 1.0\nfile a\0b", "no such file"),
        ("ffconcat version 1.0\nfile " + "a" * 5000, "cannot be opened"),
        ("ffconcat version 1.0\nfile notes.txt", "a text file"),
        ("ffconcat version 1.0\n" + "#" * (1 << 20), "larger than 1 MB"),
    ],
)
def test_what_is_no_list_of_videos_is_said_in_one_line(tmp_path: Path, lines: str | None, said: str) -> None:
    media.plain(tmp_path / "a.mp4", 2)
    (tmp_path / "notes.txt").write_text("these are notes\n" * 50)
    path = tmp_path / "x.ffconcat"
    if lines is not None:
        path.write_bytes(lines.encode())
    with pytest.raises(SourceError) as caught, open_input(path):
        pass
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600 + 5000 * ("a" * 5000 in (lines or ""))


# -- where a video works -------------------------------------------------------------------------------------


def test_the_fingerprint_is_of_the_chapters_in_their_order(tmp_path: Path) -> None:
    files = chapters(tmp_path, 2)
    once = fingerprint(listed(files))
    assert once[0] == sum(file.stat().st_size for file in files)
    path = listed(files, "other.ffconcat")
    path.write_text("# the same\n" + path.read_text())
    assert fingerprint(path) == once
    assert fingerprint(listed(files[::-1]))[1] != once[1]
    files[1].write_bytes(files[1].read_bytes()[:-1] + b"x")
    assert fingerprint(path)[1] != once[1]


def clip_in_two(folder: Path) -> tuple[Path, Path]:
    """The balls in one file and in two."""
    whole = clips.write_clip(folder / "clip.mp4", 24)
    again = folder / "whole.mp4"  # with a key frame to cut at
    with av.open(str(whole)) as source, av.open(str(again), "w") as out:
        out.metadata["creation_time"] = "2025-06-01T10:00:00Z"
        stream = out.add_stream("libx264", rate=240, options={"bf": "0", "g": "12", "sc_threshold": "0", "crf": "12"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for frame in source.decode(video=0):
            assert (frame.width, frame.height) == (320, 240)
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    times = ["2025-06-01T10:00:00Z"] * 2
    return again, listed(split(again, [12], created=times))


def test_it_is_tracked_as_the_whole_is_and_tracked_again_by_its_source(tmp_path: Path) -> None:
    whole, path = clip_in_two(tmp_path)
    found = {}
    for source in (whole, path):
        done = CliRunner().invoke(
            app, ["track", str(source), "-o", str(source.with_suffix(".mcap")), "--seed", clips.seed("orange")]
        )
        assert done.exit_code == 0, done.output
        found[source] = clips.decoded(source.with_suffix(".mcap"))
    assert list(map(str, found[path]["/markers/orange/state"])) == list(map(str, found[whole]["/markers/orange/state"]))
    assert [p.data for p in found[path]["/camera/video"]] == [p.data for p in found[whole]["/camera/video"]]
    with McapRecords(path.with_suffix(".mcap")) as records:
        assert len(list(McapImageSource(records, "/camera/video").frames())) == 24
    seeds = tmp_path / "seeds.toml"
    begun, later = (Seed("orange", index, Circle(100 + 2.5 * index, 90 + index, 18)) for index in (0, 14))
    seeds.write_text(seeds_toml([begun, later]))
    arguments = ["retrack", str(path.with_suffix(".mcap")), "--seeds", str(seeds), "--source", str(path)]
    done = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "again.mcap")])
    assert done.exit_code == 0, done.output
    last = chapters_in(path)[1]
    last.write_bytes(last.read_bytes()[:-1] + b"x")
    done = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "third.mcap")])
    assert isinstance(done.exception, UsageError)
    assert "is not what" in str(done.exception)


def test_markers_are_found_in_it(tmp_path: Path) -> None:
    whole, path = clip_in_two(tmp_path)
    found = [api.find(source, Settings()) for source in (whole, path)]
    assert found[0].seeds
    assert found[0].seeds == found[1].seeds


def test_info_says_the_files(tmp_path: Path) -> None:
    files = chapters(tmp_path, 2)
    done = CliRunner().invoke(app, ["info", "--check", str(listed(files))])
    assert done.exit_code == 0, done.output
    size = sum(file.stat().st_size for file in files) / 1e6
    assert f"session.ffconcat: {size:.1f} MB, 16 frames decoded, 30 frames/s (30)" in done.output
    assert "2 files: a_0.mp4, a_1.mp4" in done.output
    assert "96x64 h264 yuv420p" in done.output
    assert "first to last picture: 0.500000 s" in done.output
    assert "goes into a recording as it is" in done.output


def test_no_output_is_a_chapter(tmp_path: Path) -> None:
    files = chapters(tmp_path, 2)
    path = listed(files)
    for place in (*files, path):
        with pytest.raises(UsageError, match="is an input"):
            checked_output(place, [path], overwrite=True)
