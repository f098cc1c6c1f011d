"""The sessions in a folder: videos with what belongs to them, and the manifest that says so and is read back."""

import os
import re
import shutil
import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from clips import write_messages, write_recording
from spheremcap.errors import SettingsError, SourceError
from spheremcap.io import _pb
from spheremcap.io.encode import write_video
from spheremcap.merging.dataset import Source, merge
from spheremcap.season.finding import Left, find_sessions
from spheremcap.season.manifest import load_season
from spheremcap.season.outcome import RECORDING, RUN
from spheremcap.season.proposed import added_text, manifest_text, not_yet_in

sys.path.insert(0, str(Path(__file__).parents[1] / "io"))
from media import picture

WHEEL = "time_s,angle_rad\n0,0\n0.1,0.2\n0.2,0.3\n"
DAY = "2025-06-01"


def clock(*times: str) -> str:
    """An IMU's table at these times of the day."""
    return "time,acc_x (m/s2),acc_y (m/s2),acc_z (m/s2)\n" + "".join(f"{DAY} {t},0,0,9.8\n" for t in times)


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """Writes a clip of 2 s that began at a time of the day (None: it does not say)."""
    folder = tmp_path_factory.mktemp("clips")
    made: dict[str | None, Path] = {}

    def clip(path: Path, at: str | None = "10:00:00") -> Path:
        if at not in made:
            made[at] = folder / f"{len(made)}.mp4"
            created = None if at is None else f"{DAY}T{at}Z"
            write_video(made[at], [picture(index) for index in range(60)], Fraction(30), creation_time=created)
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(made[at], path)
        return path

    return clip


def lines(leftovers: Sequence[Left]) -> tuple[str, ...]:
    return tuple(left.line for left in leftovers)


def put(path: Path, text: str = WHEEL) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def found_in(folder: Path):
    """What is found in a folder's `videos`; the manifest beside it is read back to the same."""
    manifest = folder / "season.toml"
    finding = find_sessions(folder / "videos", manifest)
    same_again(finding, folder / "videos", manifest)
    return finding


def same_again(finding, folder: Path, manifest: Path):
    text = manifest_text(finding, folder, manifest, "a season")
    manifest.write_text(text, encoding="utf-8")
    season = load_season(manifest)
    assert season.name == "a season"
    assert [plan.name for plan in season.plans] == [session.name for session in finding.sessions]
    for plan, session in zip(season.plans, finding.sessions, strict=True):
        real = os.path.realpath
        assert plan.missing == ()
        assert [Path(real(path)) for path in plan.videos] == [Path(real(path)) for path in session.videos]
        told = [(s.name, Path(real(s.path))) for s in plan.sensors]
        assert told == [(s.name, Path(real(s.path))) for s in session.sensors if s.name not in session.unread]
        for kind in ("settings", "seeds", "analysis"):
            own, there = getattr(session, kind), getattr(plan, kind)
            assert (own is None and kind == "seeds") or own == (there and Path(real(there))), kind
    return text


def by_name(finding):
    return {session.name: session for session in finding.sessions}


def sensors(session):
    return [(sensor.name, sensor.path.name, sensor.why) for sensor in session.sensors]


def test_videos_are_found_by_their_endings_in_all_folders_and_named_after_where_they_lie(tmp_path, clips):
    here = tmp_path / "videos"
    for name in ("run1.mp4", "anna/run1.MOV", "anna/deep/run 2.m4v", "ben/x.MP4"):
        clips(here / name)
    for name in ("run1.lrv", "run1.thm", ".hidden.mp4", ".trash/run9.mp4", "anna/read.me"):
        put(here / name)
    put(here / "marked.mp4")
    finding = found_in(tmp_path)
    assert list(by_name(finding)) == ["anna_deep_run_2", "anna_run1", "ben_x", "run1"]
    assert lines(finding.leftovers) == ("videos/marked.mp4: by its name a rendered video of ours",)
    session = by_name(finding)["run1"]
    assert (session.size, session.rate) == ((96, 64), 30)
    assert session.duration_s == pytest.approx(2, abs=0.05)
    assert session.start_ns == 1_748_772_000 * 10**9


def test_results_of_sessions_are_no_sessions(tmp_path, clips):
    clips(tmp_path / "videos/run1.mp4")
    out = tmp_path / "videos/out"
    for name in ("run1", "run2"):
        clips(out / name / "marked up.mp4")
        put(out / name / RUN, "{}")
        put(out / name / RECORDING)
    put(out / "tables/strokes.csv")
    put(out / "season.csv")
    finding = found_in(tmp_path)
    assert list(by_name(finding)) == ["run1"]
    assert finding.sessions[0].sensors == finding.leftovers == ()
    assert finding.notes == ("videos/out: results of sessions in it are left out: 2",)


def test_a_run_json_of_somebody_else_hides_no_video(tmp_path, clips):
    clips(tmp_path / "videos/anna/run1.mp4")
    put(tmp_path / "videos/anna" / RUN, "{}")
    assert list(by_name(found_in(tmp_path))) == ["anna_run1"]


def test_names_are_made_different_and_valid(tmp_path, clips):
    here = tmp_path / "videos"
    for name in ("run 1.mp4", "run_1.mp4", "Run_1.mp4", "видео.mp4", "x" * 120 + ".mp4", "x" * 121 + ".mp4"):
        clips(here / name)
    names = list(by_name(found_in(tmp_path)))
    assert len({name.casefold() for name in names}) == 6
    assert "session" in names
    assert max(map(len, names)) <= 100


def test_chapters_of_a_gopro_are_joined_in_their_order_and_no_other_videos(tmp_path, clips):
    here = tmp_path / "videos"
    for name in (
        "GP020001.MP4", "GOPR0001.MP4", "GP010001.MP4", "GX020002.MP4", "gx010002.MP4", "GH010002.MP4", "GOPR0003.MP4",
        "other/GP030001.MP4", "clip1.MP4", "clip2.MP4",
    ):  # fmt: skip
        clips(here / name)
    put(here / "GOPR0001_wheel.csv")
    finding = by_name(found_in(tmp_path))
    assert {name: [video.name for video in session.videos] for name, session in finding.items()} == {
        "GOPR0001": ["GOPR0001.MP4", "GP010001.MP4", "GP020001.MP4"],
        "gx010002": ["gx010002.MP4", "GX020002.MP4"],
        "GH010002": ["GH010002.MP4"],
        "GOPR0003": ["GOPR0003.MP4"],
        "other_GP030001": ["GP030001.MP4"],
        "clip1": ["clip1.MP4"],
        "clip2": ["clip2.MP4"],
    }
    assert finding["GOPR0001"].duration_s == pytest.approx(6, abs=0.2)
    assert sensors(finding["GOPR0001"]) == [("wheel", "GOPR0001_wheel.csv", "by name")]
    assert finding["GOPR0001"].notes == finding["gx010002"].notes == ()
    gone = "chapters that are not here: GOPR0001.MP4, GP010001.MP4, GP020001.MP4"
    assert finding["other_GP030001"].notes == (gone,)


def test_a_chapter_that_is_missing_or_of_another_time_is_named(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "GX010001.MP4")
    clips(here / "GX030001.MP4")
    clips(here / "GX010002.MP4", "10:00:00")
    clips(here / "GX020002.MP4", "10:00:02")
    clips(here / "GX030002.MP4", "10:00:30")
    finding = by_name(found_in(tmp_path))
    assert finding["GX010001"].notes == ("chapters that are not here: GX020001.MP4",)
    (line,) = finding["GX010002"].notes
    assert line.startswith("by its creation time GX030002.MP4 comes 26 s later")


def test_sensors_belong_to_a_video_by_their_name(tmp_path, clips):
    here = tmp_path / "videos"
    for name in ("run1.mp4", "run10.mp4", "run1_b.mp4"):
        clips(here / name)
    for name in ("run1_wheel.csv", "run1.csv", "run10-imu.tsv", "run1_b_wheel.csv", "run1/rim.csv", "RUN1 left.csv"):
        put(here / name)
    put(here / "run1_imu/sensors.csv", clock("10:00:00", "10:00:01"))
    put(here / "run1_imu/quaternion.csv", "time,w,x,y,z\n2025-06-01 10:00:00,1,0,0,0\n2025-06-01 10:00:01,1,0,0,0\n")
    put(here / "run12_wheel.csv")
    finding = found_in(tmp_path)
    sessions = by_name(finding)
    assert sorted(sensors(sessions["run1"])) == [
        ("imu", "run1_imu", "by name"),
        ("left", "RUN1 left.csv", "by name"),
        ("rim", "rim.csv", "by name"),
        ("run1", "run1.csv", "by name"),
        ("wheel", "run1_wheel.csv", "by name"),
    ]
    assert sensors(sessions["run10"]) == [("imu", "run10-imu.tsv", "by name")]
    assert sensors(sessions["run1_b"]) == [("wheel", "run1_b_wheel.csv", "by name")]
    assert lines(finding.leftovers) == (
        "videos/run12_wheel.csv: neither its name nor its times say which video it belongs to: name it in sensors",
    )


def test_what_belongs_to_several_videos_by_name_is_in_none(tmp_path, clips):
    clips(tmp_path / "videos/run1.mp4")
    clips(tmp_path / "videos/run1.mov")
    put(tmp_path / "videos/run1_wheel.csv")
    finding = found_in(tmp_path)
    (line,) = lines(finding.leftovers)
    assert line.startswith("videos/run1_wheel.csv: by its name it may belong to videos/run1.mov, videos/run1.mp4: ")
    assert [session.notes[0].split(" has")[0] for session in finding.sessions] == ["run1.mp4", "run1.mov"]


def test_sensors_belong_to_the_only_video_of_their_folder_or_of_the_one_above(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "anna/a.mp4")
    put(here / "anna/wheel.csv")
    put(here / "anna/logs/rim.csv")
    put(here / "anna/2025-06-01/NGIMU 1/sensors.csv", clock("10:00:00", "10:00:01"))
    put(here / "anna/2025-06-01/NGIMU 2/Inertial.csv", clock("10:00:00", "10:00:01"))
    put(here / "anna/2025-06-01/NGIMU 2/notes/other.csv", clock("10:00:00", "10:00:01"))
    clips(here / "anna.mp4")
    clips(here / "ben/a.mp4", None)
    clips(here / "ben/b.mp4", None)
    put(here / "ben/wheel.csv")
    finding = found_in(tmp_path)
    assert sensors(by_name(finding)["anna_a"]) == [
        ("NGIMU_1", "NGIMU 1", "only one here"),
        ("NGIMU_2", "NGIMU 2", "only one here"),
        ("rim", "rim.csv", "only one here"),
        ("wheel", "wheel.csv", "only one here"),
    ]
    assert by_name(finding)["ben_a"].sensors == ()
    assert [line.split(":")[0] for line in lines(finding.leftovers)] == ["videos/ben/wheel.csv"]


def test_sensors_belong_to_the_video_that_they_lie_over_in_time(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "a.mp4", "10:00:00")
    clips(here / "b.mp4", "10:00:40")
    clips(here / "c.mp4", None)
    put(here / "logs/one.csv", clock("10:00:01", "10:00:03"))
    put(here / "logs/both.csv", clock("10:00:01", "10:00:50"))
    put(here / "logs/neither.csv", clock("10:00:10", "10:00:20"))
    put(here / "logs/relative.csv")
    finding = found_in(tmp_path)
    assert sensors(by_name(finding)["a"]) == [("one", "one.csv", "by time")]
    assert by_name(finding)["a"].offsets == {}
    assert [re.sub(r"(?<=: ).*(over \w+ ?\w+|neither).*", r"\1", line) for line in lines(finding.leftovers)] == [
        "videos/logs/both.csv: over videos",
        "videos/logs/neither.csv: over no video",
        "videos/logs/relative.csv: neither",
    ]


def test_a_clock_that_is_off_by_its_zone_is_told_where_there_is_one_answer(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "a.mp4", "10:00:00")
    clips(here / "c.mp4", None)
    put(here / "logs/imu.csv", clock("08:00:01", "08:00:03"))
    put(here / "logs/long.csv", clock("06:00:01", "07:00:03"))
    put(here / "logs/odd.csv", clock("08:05:01", "08:05:03"))
    finding = found_in(tmp_path)
    session = by_name(finding)["a"]
    assert sensors(session) == [("imu", "imu.csv", "by time")]
    assert session.offsets == {"imu": "+2h"}
    assert any('merge.imu.offset = "+2h"' in line for line in session.notes)
    assert [line.split(":")[0] for line in lines(finding.leftovers)] == ["videos/logs/long.csv", "videos/logs/odd.csv"]
    text = (tmp_path / "season.toml").read_text()
    assert '#merge.imu.offset = "+2h"' in text
    (tmp_path / "season.toml").write_text(text.replace("#merge.imu.offset", "merge.imu.offset"))
    plan = next(plan for plan in load_season(tmp_path / "season.toml").plans if plan.name == "a")
    assert plan.sensors[0].how.offset == "+2h"


def test_one_shift_for_several_logs_is_told_from_those_that_suit_one_alone(tmp_path, clips):
    here = tmp_path / "videos"
    for name, at in (("a", "10:00:00"), ("b", "10:15:00"), ("c", "10:30:00")):
        clips(here / f"{name}.mp4", at)
        put(here / f"logs/of_{name}.csv", clock(f"08{at[2:]}", f"08{at[2:-1]}1"))
    for session in found_in(tmp_path).sessions:
        assert sensors(session) == [(f"of_{session.name}", f"of_{session.name}.csv", "by time")]
        assert list(session.offsets.values()) == ["+2h"]


def test_what_we_wrote_is_no_sensor(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "session.mp4")
    put(here / "truth.csv", "frame,stamp_ns,marker,x_px\n0,0,left_wrist,1\n")
    put(here / "events.csv", "side,marker,kind,stamp_ns\nleft,left_wrist,contact,1\n")
    put(here / "tracks.csv", "marker,frame,stamp_ns,status\nleft_wrist,0,0,SEEDED\n")
    put(here / "excel.csv", "time [s];UTC;marker;frame\n0,1;2025;left;1\n")
    for ending in ("events.csv", "strokes.csv", "mean_cycle.csv", "report.html", "layout.json"):
        put(here / f"session.{ending}")
    put(here / "session_out.c3d", "xx SPHEREMCAP xx")
    put(here / "wheel.csv")
    finding = found_in(tmp_path)
    assert sensors(by_name(finding)["session"]) == [("wheel", "wheel.csv", "only one here")]
    assert finding.leftovers == ()


def test_a_table_that_is_not_understood_is_named_and_stands_commented_out(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "run1.mp4")
    put(here / "run1_odd.csv", "a,b\n0,1\n2,0\n")
    put(here / "run1_empty.csv", "")
    put(here / "run1_broken.parquet", "no")
    put(here / "run1_notes.txt", "it rained\n")
    put(here / "run1_wheel.csv")
    finding = found_in(tmp_path)
    (session,) = finding.sessions
    assert session.unread == {"odd", "empty", "broken"}
    (odd,) = (line for line in session.missing if line.startswith("sensor odd: "))
    assert "videos/run1_odd.csv: no column is obviously the time" in odd
    assert 'merge.odd.mapping = "odd.mapping.toml"' in odd
    assert "/tmp" not in " ".join(session.missing)
    text = (tmp_path / "season.toml").read_text()
    assert '    #"videos/run1_odd.csv",' in text
    assert lines(finding.leftovers) == ("videos/run1_notes.txt: no row of numbers in its first 1 lines",)
    (tmp_path / "season.toml").write_text(text.replace('#"videos/run1_odd', '"videos/run1_odd'))
    assert [s.name for s in load_season(tmp_path / "season.toml").plans[0].sensors] == ["odd", "wheel"]


def test_a_session_with_no_table_that_is_understood_has_no_sensors(tmp_path, clips):
    clips(tmp_path / "videos/run1.mp4")
    put(tmp_path / "videos/odd.csv", "a,b\n0,1\n2,0\n")
    found_in(tmp_path)
    assert '\n#sensors = ["videos/odd.csv"]' in (tmp_path / "season.toml").read_text()


def test_only_the_head_of_a_log_that_its_name_tells_is_read(tmp_path, clips):
    clips(tmp_path / "videos/run1.mp4")
    rows = "".join(f"{k},{k}\n" for k in range(20_000))
    log = put(tmp_path / "videos/run1_wheel.csv", f"time_s,angle_rad\n{rows}what is this,1\n2,2\n")
    assert log.stat().st_size > 128 << 10
    assert found_in(tmp_path).sessions[0].unread == frozenset()


def test_of_two_sensors_of_one_name_the_second_has_another(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "run1.mp4")
    put(here / "run1_wheel.csv")
    put(here / "run1-wheel.csv")
    (session,) = found_in(tmp_path).sessions
    assert sensors(session) == [("wheel", "run1-wheel.csv", "by name"), ("wheel_2", "run1_wheel.csv", "by name")]
    assert any("would both be called wheel: the second is wheel_2" in line for line in session.notes)
    assert '"wheel_2=videos/run1_wheel.csv"' in (tmp_path / "season.toml").read_text()


def test_settings_seeds_and_analysis_are_those_beside_the_video(tmp_path, clips):
    here = tmp_path / "videos"
    camera = '[camera]\npreset = "gopro-hero4-black-720p240-narrow"\n'
    for kind in ("settings", "seeds", "analysis"):
        put(here / f"two/a.{kind}.toml", camera if kind == "settings" else "")
        put(here / f"one/{kind}.toml", "")
        put(here / f"two/{kind}.toml", "")
    for name in ("two/a", "two/b", "one/c"):
        clips(here / f"{name}.mp4")
    sessions = by_name(found_in(tmp_path))
    told = {name: [s.settings, s.seeds, s.analysis] for name, s in sessions.items()}
    kinds = ("settings", "seeds", "analysis")
    assert told == {
        "two_a": [here / f"two/a.{kind}.toml" for kind in kinds],
        "two_b": [None, None, None],
        "one_c": [here / f"one/{kind}.toml" for kind in kinds],
    }
    assert [line.split(":")[0] for line in sessions["two_b"].missing] == [*kinds, "seeds", "settings"]
    assert 'settings = "videos/two/settings.toml"' in sessions["two_b"].missing[0]
    assert sessions["one_c"].missing[0].startswith("camera: videos/one/settings.toml names none")
    text = (tmp_path / "season.toml").read_text()
    assert "\nsettings = " not in text.split('name = "two_a"')[1]
    assert '\nanalysis = "videos/two/a.analysis.toml"' in text


def test_settings_of_the_whole_folder_are_defaults(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "a.mp4")
    clips(here / "deep/b.mp4")
    clips(here / "c.mp4")
    put(here / "settings.toml", "")
    put(here / "c.settings.toml", "")
    put(here / "analysis.toml", "")
    put(here / "seeds.toml", "")
    sessions = by_name(found_in(tmp_path))
    assert sessions["deep_b"].settings == here / "settings.toml"
    assert sessions["c"].settings == here / "c.settings.toml"
    assert sessions["a"].seeds is None
    text = (tmp_path / "season.toml").read_text()
    assert text.count('settings = "videos/settings.toml"') == 1
    assert text.count('analysis = "videos/analysis.toml"') == 1
    assert 'settings = "videos/c.settings.toml"' not in text  # which is found beside the video, whatever [defaults] say


def test_what_is_missing_is_said_with_what_to_do(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "it's 1.mp4", None)
    put(here / "it's 1_imu.csv", clock("10:00:00", "10:00:01"))
    put(here / "it's 1.settings.toml", "[camera]\nmisspelt = 1\n")
    (session,) = found_in(tmp_path).sessions
    seeds, settings, start = session.missing
    assert seeds == """seeds: spheremcap annotate 'videos/it'"'"'s 1.mp4', or say auto = true"""
    assert settings.startswith("settings: videos/it's 1.settings.toml: unknown key 'camera.misspelt'")
    assert start.startswith("start time: the video does not say when it was, imu does: start_time = ")
    clips(here / "it's 1.mp4")
    assert len(found_in(tmp_path).sessions[0].missing) == 2


def test_a_video_that_cannot_be_opened_stays_and_says_why(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "run1.mp4")
    put(here / "text.mkv", "no video")
    put(here / "empty.mp4", "")
    (here / "gone.mp4").symlink_to("nowhere.mp4")
    clips(here / "GX010001.MP4")
    put(here / "GX020001.MP4", "")
    sessions = by_name(found_in(tmp_path))
    assert {name: s.missing[0] for name, s in sessions.items() if s.duration_s is None} == {
        "GX010001": "video: videos/GX020001.MP4: is empty (0 bytes); copy it again",
        "empty": "video: videos/empty.mp4: is empty (0 bytes); copy it again",
        "gone": "video: videos/gone.mp4: no such file; check the name",
        "text": "video: videos/text.mkv: not a video that FFmpeg can read (Invalid data found when processing input); "
        "check the file",
    }


def test_folders_of_numbered_pictures_are_videos(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "run1.mp4")
    for name in ("photo_1.png", "photo_2.png", "pictures/f_0001.png", "pictures/f_0002.png", "single/f_1.png",
                 "series/a1.png", "series/b1.png"):  # fmt: skip
        path = here / name
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), picture(0))
    put(here / "pictures/wheel.csv")
    put(here / "pictures/seeds.toml", "")
    finding = found_in(tmp_path)
    session = by_name(finding)["pictures"]
    assert list(by_name(finding)) == ["pictures", "run1"]
    assert session.videos == (here / "pictures",)
    assert session.size == (96, 64)
    assert session.seeds == here / "pictures/seeds.toml"
    assert sensors(session) == [("wheel", "wheel.csv", "by name")]
    assert session.missing[0] == 'rate: how many pictures a second, as in rate = "240"'
    assert [line.split(":")[0] for line in finding.notes] == ["videos", "videos/series"]


def test_recordings_with_pictures_of_somebody_else_are_videos_and_ours_are_not(tmp_path):
    here = tmp_path / "videos"
    here.mkdir()
    write_recording(here / "two.mcap", ["/front/image", "/left/image"], calibrated=False)
    write_messages(here / "one.mcap", "/image", [CompressedImage(), CompressedImage(), CompressedImage()])
    write_messages(here / "ours.mcap", "/markers/a/state", [_pb.MarkerState()])
    merge([Source(here / "one.mcap"), Source(here / "ours.mcap")], here / "tracked.mcap")
    write_recording(here / "calibrated.mcap", ["/front/image"])
    write_recording(here / "log.mcap", [])
    put(here / "damaged.mcap", "no")
    finding = found_in(tmp_path)
    sessions = by_name(finding)
    assert list(sessions) == ["calibrated", "one", "two"]
    assert [line for line in sessions["two"].missing if "topic" in line] == [
        'topic: which of /front/image, /left/image, as in topic = "/front/image"'
    ]
    assert sessions["one"].duration_s == 2
    assert not any("settings" in line for line in sessions["calibrated"].missing)
    assert any("settings" in line for line in sessions["one"].missing)
    assert [line.split(":")[0] for line in lines(finding.leftovers)] == ["videos/damaged.mcap", "videos/log.mcap"]
    assert finding.notes == ("recordings of ours are left out: 2",)


def test_any_name_is_read_back(tmp_path, clips):
    here = tmp_path / 'videos "of" 2025'
    stems = (
        "a [1]",
        "it's",
        'say "hi"',
        "Zoë ü",
        "a=b",
        "back\\slash",
        "new\nline",
        "{name}",
        "100%",
        "#1",
        "*",
        "tab\t",
    )
    for stem in stems:
        clips(here / f"{stem}.mp4")
        put(here / f"{stem}_wheel.csv")
        put(here / f"{stem}.analysis.toml" if stem != "{name}" else here / "x", "")
    finding = find_sessions(here, tmp_path / "season.toml")
    assert len(finding.sessions) == len(stems)
    assert all(len(session.sensors) == 1 for session in finding.sessions)
    same_again(finding, here, tmp_path / "season.toml")
    finding = find_sessions(here, here / "season.toml")
    same_again(finding, here, here / "season.toml")


def test_the_head_of_a_log_ends_with_a_whole_line(tmp_path, clips):
    clips(tmp_path / "videos/run1.mp4")
    table = "# a log of mine\nangle_rad,time\n" + "".join(f"{k:09},{DAY} 10:00:00.{k:06}\n" for k in range(2000))
    assert table[: 64 << 10].endswith(",2025-")
    put(tmp_path / "videos/run1_wheel.csv", table)
    assert found_in(tmp_path).sessions[0].unread == frozenset()


@pytest.mark.skipif(sys.platform != "linux", reason="names are text elsewhere")
def test_a_name_that_is_no_text_is_left_over(tmp_path, clips):
    clips(tmp_path / "videos/run1.mp4")
    shutil.copyfile(tmp_path / "videos/run1.mp4", os.fsencode(tmp_path / "videos") + b"/run\xff.mp4")
    (line,) = lines(found_in(tmp_path).leftovers)
    assert line.endswith("its name is no UTF-8 text, which a manifest is: rename it")


@pytest.mark.parametrize(
    ("manifest", "written"),
    [
        ("season.toml", "study/videos/run1.mp4"),
        ("study/season.toml", "videos/run1.mp4"),
        ("study/videos/season.toml", "run1.mp4"),
        ("study/plan/season.toml", "../videos/run1.mp4"),
        ("other/deep/season.toml", "{tmp}/study/videos/run1.mp4"),
    ],
)
def test_paths_start_at_the_manifest_where_that_is_near(tmp_path, clips, manifest, written):
    videos = tmp_path / "study/videos"
    clips(videos / "run1.mp4")
    put(videos / "run1_wheel.csv")
    path = tmp_path / manifest
    path.parent.mkdir(parents=True, exist_ok=True)
    finding = find_sessions(videos, path)
    text = same_again(finding, videos, path)
    assert f'video = "{written.format(tmp=tmp_path)}"' in text
    assert (
        finding.sessions[0].missing[0]
        == f"seeds: spheremcap annotate {written.format(tmp=tmp_path)}, or say auto = true"
    )


def test_the_examples_are_read_when_they_are_taken_in(tmp_path, clips):
    clips(tmp_path / "videos/run1.mp4")
    clips(tmp_path / "videos/deep/run2.mp4")
    put(tmp_path / "videos/analysis.toml", "")
    found_in(tmp_path)
    path = tmp_path / "season.toml"
    text = re.sub(r"^( *)#(?=\S)", r"\1", path.read_text(), flags=re.MULTILINE)
    assert text.count("[[sessions]]") == 3
    path.write_text(text)
    plans = {plan.name: plan for plan in load_season(path).plans}
    assert list(plans) == ["deep_run2", "run1"]
    assert [plan.subject for plan in plans.values()] == ["anna", ""]
    assert all(plan.auto for plan in plans.values())


def test_links_are_followed_once(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "run1.mp4")
    clips(here / "deep/run2.mp4")
    clips(tmp_path / "elsewhere/run3.mp4")
    clips(here / ".store/key.mp4")
    (here / "again").symlink_to("deep")
    (here / "deep/up").symlink_to("..")
    (here / "deep/self").symlink_to("self")
    (here / "all").symlink_to("/")
    (here / "outside").symlink_to(tmp_path / "elsewhere")
    (here / "a_latest.mp4").symlink_to("deep/run2.mp4")
    (here / "stored.mp4").symlink_to(".store/key.mp4")
    finding = found_in(tmp_path)
    assert list(by_name(finding)) == ["deep_run2", "outside_run3", "run1", "stored"]
    assert lines(finding.leftovers) == ("videos/a_latest.mp4: is a link to videos/deep/run2.mp4",)


def test_a_folder_that_cannot_be_opened_is_named(tmp_path, clips, monkeypatch):
    clips(tmp_path / "videos/run1.mp4")
    put(tmp_path / "videos/locked/x.mp4")
    scandir = os.scandir

    def refused(path):
        if Path(path).name == "locked":
            raise PermissionError(13, "Permission denied")
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refused)
    assert found_in(tmp_path).notes == ("videos/locked: cannot be opened: Permission denied",)


def test_a_folder_without_sessions_is_an_error_of_one_line(tmp_path):
    put(tmp_path / "videos/notes.txt", "none")
    put(tmp_path / "file.mp4")
    for folder, words in (
        ("videos", "no session in it: expected videos (.mp4, .mov"),
        ("nowhere", "no such folder; name the folder that the videos are in"),
        ("file.mp4", "is a file, not a folder"),
    ):
        with pytest.raises(SourceError, match=re.escape(words)) as error:
            find_sessions(tmp_path / folder, tmp_path / "season.toml")
        assert "\n" not in str(error.value)
        assert str(error.value).startswith(str(tmp_path / folder))


def test_a_thousand_videos_are_found_and_told_of(tmp_path, clips):
    first = clips(tmp_path / "videos/run0.mp4")
    for number in range(1, 1000):
        shutil.copyfile(first, first.with_name(f"run{number}.mp4"))
    told = []
    finding = find_sessions(
        tmp_path / "videos", tmp_path / "season.toml", progress=lambda done, total: told.append((done, total))
    )
    assert len(finding.sessions) == 1000
    assert told[0] == (0, 1000)
    assert told[-1] == (1000, 1000)


# --- what comes later ---


def added(folder, manifest):
    """What `init --add` adds, and the manifest as it reads then."""
    new = not_yet_in(manifest, load_season(manifest, growing=True), find_sessions(folder, manifest), folder)
    before = manifest.read_bytes()
    manifest.write_text(added_text(new, manifest, folder), encoding="utf-8", newline="")
    assert manifest.read_bytes().startswith(before.removeprefix(b"\xef\xbb\xbf").rstrip(b"\n"))
    return new, load_season(manifest)


def test_what_came_later_is_added_and_what_somebody_wrote_stays(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    for name in ("a_1", "b_1"):
        clips(here / f"{name}.mp4")
        put(here / f"{name}_wheel.csv")
    put(here / "notes_of_a.csv")
    put(
        manifest,
        '[defaults]\nauto = true  # mine\nsettings = "mine.toml"\n[[overrides]]\nsessions = "a_*"\nsubject = "Ann"\n'
        '[[sessions]]\nname = "a_2"\nvideo = "videos/a_1.mp4"\nsensors = ["wheel=videos/notes_of_a.csv"]',
    )
    put(tmp_path / "mine.toml", "")
    clips(here / "a_2.mp4")
    new, season = added(here, manifest)
    assert [session.name for session in new.sessions] == ["a_2_2", "b_1"]  # a_2 is what the first one is called
    assert lines(new.leftovers) == ()
    plans = {plan.name: plan for plan in season.plans}
    assert {name: plan.subject for name, plan in plans.items()} == {"a_2": "Ann", "a_2_2": "Ann", "b_1": ""}
    assert plans["b_1"].auto
    assert plans["b_1"].settings == str(tmp_path / "mine.toml")
    assert [sensor.name for sensor in plans["b_1"].sensors] == ["wheel"]
    assert plans["a_2"].sensors[0].path.endswith("notes_of_a.csv")
    again, _ = added(here, manifest)
    assert again.sessions == ()


def test_what_defaults_say_is_not_missing_in_what_is_added(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    clips(here / "a.mp4")
    put(here / "a_odd.csv", "one;two\n1;2\n")
    odd = find_sessions(here, manifest).sessions[0]
    assert odd.unread == {"odd"}
    assert [line.partition(":")[0] for line in odd.missing] == ["seeds", "settings", "sensor odd"]
    known = '[[sessions]]\nname = "x"\nvideo = "x.mp4"\n'
    put(manifest, f'[defaults]\nsettings = "s.toml"\n{known}')
    put(tmp_path / "s.toml", "")
    (session,) = added(here, manifest)[0].sessions
    assert [line.partition(":")[0] for line in session.missing] == ["seeds", "sensor odd"]
    put(manifest, f'[defaults]\nauto = true\nmerge.odd.mapping = "m.toml"\n{known}')
    new, season = added(here, manifest)
    assert [line.partition(":")[0] for line in new.sessions[0].missing] == ["settings"]
    assert [sensor.name for sensor in season.plans[0].sensors] == ["odd"]


def test_a_chapter_that_came_later_is_told_of_and_not_added(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    clips(here / "GH010007.MP4")
    manifest.write_text(manifest_text(find_sessions(here, manifest), here, manifest))
    clips(here / "GH020007.MP4")
    new, season = added(here, manifest)
    assert new.sessions == ()
    order = '"videos/GH010007.MP4", "videos/GH020007.MP4"'
    assert new.notes == (f"GH010007: its recording has more chapters now: video = [{order}]",)
    assert len(season.plans) == 1


@pytest.mark.parametrize("how", [{"encoding": "utf-8-sig"}, {"encoding": "utf-16"}, {"newline": "\r\n"}])
def test_a_manifest_may_be_saved_in_any_way(tmp_path, clips, how):
    manifest = tmp_path / "season.toml"
    clips(tmp_path / "videos/a.mp4")
    clips(tmp_path / "videos/b.mp4")
    text = '[[sessions]]\nname = "a"  # ä\nvideo = "videos/a.mp4"\n'
    manifest.write_text(text, **({"encoding": "utf-8"} | how))
    here = tmp_path / "videos"
    new = not_yet_in(manifest, load_season(manifest), find_sessions(here, manifest), here)
    whole = added_text(new, manifest, here)
    assert "# ä" in whole
    assert whole.startswith("\ufeff") == (how == {"encoding": "utf-8-sig"})
    assert ("\r" in whole) == ("newline" in how)
    assert whole.count("\r\n") in (0, whole.count("\n"))
    manifest.write_text(whole, encoding="utf-8", newline="")
    assert [plan.name for plan in load_season(manifest).plans] == ["a", "b"]


def test_sessions_that_nothing_can_be_put_behind(tmp_path, clips):
    manifest = put(tmp_path / "season.toml", 'sessions = [{name = "a", video = "videos/a.mp4"}]\n')
    clips(tmp_path / "videos/b.mp4")
    here = tmp_path / "videos"
    new = not_yet_in(manifest, load_season(manifest), find_sessions(here, manifest), here)
    with pytest.raises(SettingsError, match=r"begin each session with \[\[sessions\]\]"):
        added_text(new, manifest, here)


def test_what_is_said_of_all_counts_more_than_what_lies_in_the_folder(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    known = '[[sessions]]\nname = "x"\nvideo = "x.mp4"\n'
    for name in ("a_1", "b_1", "c_1"):
        clips(here / f"{name}.mp4")
    for name in ("videos/settings.toml", "videos/analysis.toml", "lab.toml", "chair.toml", "videos/c_1.settings.toml"):
        put(tmp_path / name, "")
    general = '[defaults]\nsettings = "lab.toml"\n[[overrides]]\nsessions = "a_*"\n'
    put(manifest, f'{general}auto = true\nanalysis = "chair.toml"\n{known}')
    new, season = added(here, manifest)
    plans = {plan.name: plan for plan in season.plans}
    told = {name: [Path(str(path)).name for path in (p.settings, p.analysis)] for name, p in plans.items()}
    assert told["a_1"] == ["lab.toml", "chair.toml"]
    assert told["b_1"] == ["lab.toml", "analysis.toml"]  # nothing is said of its chair
    assert told["c_1"] == ["c_1.settings.toml", "analysis.toml"]
    lacks = {session.name: [line.partition(":")[0] for line in session.missing] for session in new.sessions}
    assert lacks == {"a_1": [], "b_1": ["seeds"], "c_1": ["seeds", "camera"]}


def test_seeds_where_the_manifest_keeps_them_and_where_it_does_not(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    put(manifest, '[defaults]\nseeds = "seeds/{stem}.toml"\n[[sessions]]\nname = "x"\nvideo = "x.mp4"\n')
    for name in ("a", "b", "c"):
        clips(here / f"{name}.mp4")
    put(tmp_path / "seeds/a.toml", "")
    put(here / "b.seeds.toml", "")
    new, season = added(here, manifest)
    lacks = {session.name: "seeds" in [line.partition(":")[0] for line in session.missing] for session in new.sessions}
    assert lacks == {"a": False, "b": False, "c": True}
    seeds = {plan.name: Path(plan.seeds).relative_to(tmp_path).as_posix() for plan in season.plans if plan.name != "x"}
    assert seeds == {"a": "seeds/a.toml", "b": "videos/b.seeds.toml", "c": "seeds/c.toml"}


def test_logs_that_come_later_are_told_of_and_none_is_two_sessions(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    clips(here / "a.mp4", None)
    clips(here / "b.mp4")
    put(here / "logs/imu7.csv", clock("10:00:00", "10:00:01"))
    put(manifest, '[[sessions]]\nname = "a"\nvideo = "videos/a.mp4"\nsensors = "imu=videos/logs/imu7.csv"\n')
    put(here / "a_wheel.csv")
    new, season = added(here, manifest)
    assert new.notes == ("a: not in its sensors: videos/a_wheel.csv",)
    assert new.sessions[0].notes == ("videos/logs/imu7.csv is another session's already",)
    assert [plan.name for plan in season.plans if plan.sensors] == ["a"]


def test_sensors_that_all_sessions_have_stay_with_what_is_found(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    put(manifest, '[defaults]\nsensors = ["{folder}/{stem}_*.csv", "weather=all.csv"]\n')
    for name in ("all.csv", "videos/a_rim.csv", "videos/b/b_rim.csv", "videos/b/deep/imu.csv"):
        put(tmp_path / name)
    clips(here / "a.mp4")
    clips(here / "b/b.mp4")
    _, season = added(here, manifest)
    told = {plan.name: [sensor.name for sensor in plan.sensors] for plan in season.plans}
    assert told == {"a": ["rim", "weather"], "b_b": ["rim", "imu", "all"]}
    assert manifest.read_text().count("sensors") == 2
    clips(here / "c.mp4")
    put(tmp_path / "videos/c_all.csv")
    put(manifest, manifest.read_text().replace("weather=all.csv", "weather=videos/c_all.csv"))
    new, season = added(here, manifest)
    assert new.sessions[0].notes == ()  # all sessions have that one
    assert season.plans[-1].name == "c"
    assert [Path(sensor.path).name for sensor in season.plans[-1].sensors] == ["c_all.csv"]


def test_videos_that_the_manifest_names_otherwise_are_not_added_again(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    for name in ("a", "b", "c", "d [1]"):
        clips(here / f"{name}.mp4")
    put(tmp_path / "bc.ffconcat", "ffconcat version 1.0\nfile videos/b.mp4\nfile videos/c.mp4\n")
    rows = {"a": f"file://{here}/a.mp4", "bc": "bc.ffconcat", "d": "videos/d [1].mp4"}
    put(manifest, "".join(f'[[sessions]]\nname = "{name}"\nvideo = "{video}"\n' for name, video in rows.items()))
    new, season = added(here, manifest)
    assert new.sessions == ()
    assert season.plans[2].videos == (str(here / "d [1].mp4"),)


def test_chapters_that_are_sessions_of_their_own_are_told_of(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    rows = ""
    for name in ("GH010007", "GH020007"):
        clips(here / f"{name}.MP4")
        rows += f'[[sessions]]\nname = "{name}"\nvideo = "videos/{name}.MP4"\n'
    put(manifest, rows)
    assert added(here, manifest)[0].notes == (
        "GH010007, GH020007: chapters of one recording, but sessions of their own",
    )


# --- what is no session's, and odd names ---


def test_the_tables_of_a_season_are_no_logs(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "a.mp4")
    for name in ("season/sessions.parquet", "season/report.html", "season/quality/session=a/quality.parquet"):
        put(here / name)
    finding = found_in(tmp_path)
    assert finding.sessions[0].sensors == finding.leftovers == ()
    assert finding.notes == ("videos: results of sessions in it are left out: 1",)


def test_a_link_to_a_video_that_is_not_found_by_itself_is_the_video(tmp_path, clips):
    here = tmp_path / "videos"
    clips(here / "blobs/9f3a")
    (here / "a.mp4").symlink_to("blobs/9f3a")
    put(here / "a_wheel.csv")
    (here / "a_latest.csv").symlink_to("a_wheel.csv")
    finding = found_in(tmp_path)
    assert sensors(finding.sessions[0]) == [("wheel", "a_wheel.csv", "by name")]
    assert lines(finding.leftovers) == ("videos/a_latest.csv: is a link to videos/a_wheel.csv",)


def test_umlauts_may_be_written_in_two(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    whole, two = "Müller_1", "Müller_1"
    clips(here / f"{whole}.mp4")
    clips(here / "b.mp4")
    put(here / f"{two}_wheel.csv")
    put(here / f"{two}.seeds.toml", "")
    finding = find_sessions(here, manifest)
    session = next(session for session in finding.sessions if session.seeds)
    assert (session.videos[0].stem, session.seeds.name) == (whole, f"{two}.seeds.toml")
    assert [sensor.path.name for sensor in session.sensors] == [f"{two}_wheel.csv"]
    manifest.write_text(manifest_text(finding, here, manifest), encoding="utf-8")
    plan = next(plan for plan in load_season(manifest).plans if plan.sensors)
    assert Path(plan.seeds).is_file()


def test_braces_in_names_are_no_placeholders(tmp_path, clips):
    here, manifest = tmp_path / "videos", tmp_path / "season.toml"
    clips(here / "{stem}/a.mp4")
    clips(here / "b.mp4")
    for name in ("settings", "seeds", "analysis"):
        put(here / "{stem}" / f"{name}.toml", "")
    manifest.write_text(manifest_text(find_sessions(here, manifest), here, manifest))
    plan = next(plan for plan in load_season(manifest).plans if plan.name != "b")
    folder = here / "{stem}"
    assert [plan.settings, plan.seeds, plan.analysis] == [
        str(folder / f"{name}.toml") for name in ("settings", "seeds", "analysis")
    ]


def test_the_folder_of_pictures_itself_has_its_seeds_beside_it(tmp_path):
    for number in (1, 2):
        (tmp_path / "pics").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"pics/f_{number}.png"), picture(number))
    seeds = put(tmp_path / "pics.seeds.toml", "")
    (session,) = find_sessions(tmp_path / "pics", tmp_path / "season.toml").sessions
    assert session.seeds == seeds


def test_a_folder_that_no_manifest_can_name_is_told(tmp_path, clips):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/x\xff")) / "videos"
    try:
        clips(folder / "a.mp4")
    except OSError:
        pytest.skip("no such names here")
    with pytest.raises(SourceError, match="rename the folder"):
        find_sessions(folder, tmp_path / "season.toml")
