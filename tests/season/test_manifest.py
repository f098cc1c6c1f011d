"""A season's manifest: what it says of each session, and what is wrong with it in one line."""

from pathlib import Path

import pytest

from spheremcap.errors import SettingsError
from spheremcap.season.manifest import load_season, sensor_name, session_name


def write(folder: Path, text: str, *files: str) -> Path:
    """A manifest, and empty files beside it."""
    for name in files:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    path = folder / "season.toml"
    path.write_text(text)
    return path


def plans(path: Path):
    return {plan.name: plan for plan in load_season(path).plans}


def test_what_a_session_says_counts_more_than_overrides_and_those_more_than_defaults(tmp_path):
    path = write(
        tmp_path,
        """
        [defaults]
        fill_ms = 5
        analysis = "a.toml"
        auto = true
        merge.wheel.sync = "left_wrist"
        merge.wheel.rate_hz = 240
        [[overrides]]
        sessions = "anna_*"
        fill_ms = 10
        auto = false
        merge.wheel.rate_hz = 200
        [[overrides]]
        sessions = ["*_2"]
        fill_ms = 20
        [[sessions]]
        name = "anna_1"
        video = "1.mp4"
        sensors = "wheel.csv"
        fill_ms = 30
        [[sessions]]
        name = "anna_2"
        video = "2.mp4"
        [[sessions]]
        name = "bo_1"
        video = "3.mp4"
        """,
        "1.mp4", "2.mp4", "3.mp4", "wheel.csv", "a.toml",
    )  # fmt: skip
    found = plans(path)
    assert [found[name].fill_ms for name in ("anna_1", "anna_2", "bo_1")] == [30, 20, 5]
    assert [found[name].auto for name in ("anna_1", "anna_2", "bo_1")] == [False, False, True]
    (wheel,) = found["anna_1"].sensors
    assert (wheel.how.sync, wheel.how.rate_hz) == ("left_wrist", 200)
    assert found["bo_1"].analysis == str(tmp_path / "a.toml")


def test_a_row_without_a_name_is_a_session_for_each_video_that_no_other_row_has(tmp_path):
    path = write(
        tmp_path,
        """
        [[sessions]]
        video = "*/*.mp4"
        sensors = "{folder}/{stem}_*.csv"
        seeds = "answers/{name}.toml"
        [[sessions]]
        name = "special"
        video = "anna/run 2.mp4"
        """,
        "anna/run 1.mp4", "anna/run 2.mp4", "bo/x.mp4", "anna/run 1_wheel.csv", "bo/x_imu.csv", "bo/y_imu.csv",
    )  # fmt: skip
    found = plans(path)
    assert list(found) == ["anna_run_1", "bo_x", "special"]
    assert [(s.name, s.path) for s in found["anna_run_1"].sensors] == [
        ("wheel", str(tmp_path / "anna/run 1_wheel.csv"))
    ]
    assert [s.name for s in found["bo_x"].sensors] == ["imu"]
    assert found["anna_run_1"].seeds == str(tmp_path / "answers/anna_run_1.toml")
    assert found["special"].seeds == str(tmp_path / "anna/run 2.seeds.toml")


def test_seeds_and_settings_are_those_beside_the_first_video_unless_said(tmp_path):
    path = write(
        tmp_path,
        '[[sessions]]\nname = "one"\nvideo = ["v/GOPR1.MP4", "v/GP01.MP4"]\n',
        "v/GOPR1.MP4", "v/GP01.MP4", "v/GOPR1.settings.toml",
    )  # fmt: skip
    plan = plans(path)["one"]
    assert plan.videos == (str(tmp_path / "v/GOPR1.MP4"), str(tmp_path / "v/GP01.MP4"))
    assert plan.settings == str(tmp_path / "v/GOPR1.settings.toml")
    assert plan.seeds == str(tmp_path / "v/GOPR1.seeds.toml")
    assert plan.missing == ()


def test_settings_beside_the_video_count_more_than_those_for_all_and_less_than_what_is_said(tmp_path):
    path = write(
        tmp_path,
        """
        [defaults]
        settings = "all.toml"
        [[sessions]]
        video = "*.mp4"
        [[overrides]]
        sessions = "c"
        settings = "all.toml"
        """,
        "all.toml", "a.mp4", "b.mp4", "b.settings.toml", "c.mp4", "c.settings.toml",
    )  # fmt: skip
    found = {name: Path(str(plan.settings)).name for name, plan in plans(path).items()}
    assert found == {"a": "all.toml", "b": "b.settings.toml", "c": "all.toml"}
    assert f"--settings {tmp_path / 'all.toml'}" in plans(path)["a"].seedless
    assert "--settings" not in plans(path)["b"].seedless


def test_a_row_without_a_name_calls_sessions_from_where_its_pattern_begins(tmp_path):
    path = write(
        tmp_path, '[[sessions]]\nvideo = "videos/**/*.mp4"\n', "videos/anna_1.mp4", "videos/bo/session.mp4",
    )  # fmt: skip
    assert list(plans(path)) == ["anna_1", "bo"]


def test_what_is_named_and_not_there_is_said_of_its_session_only(tmp_path):
    path = write(
        tmp_path,
        """
        [[sessions]]
        name = "gone"
        video = "gone.mp4"
        settings = "no.toml"
        sensors = ["no.csv", "maybe*.csv"]
        [[sessions]]
        name = "there"
        video = "1.mp4"
        """,
        "1.mp4",
    )
    found = plans(path)
    assert found["gone"].videos == ()
    assert [line.partition(":")[0] for line in found["gone"].missing] == ["no video", "no settings", "no sensor"]
    assert found["there"].missing == ()


def test_chapters_of_a_pattern_are_in_the_order_of_their_names(tmp_path):
    path = write(tmp_path, '[[sessions]]\nname = "one"\nvideo = "GX0?1.MP4"\n', "GX031.MP4", "GX011.MP4", "GX021.MP4")
    assert [Path(video).name for video in plans(path)["one"].videos] == ["GX011.MP4", "GX021.MP4", "GX031.MP4"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no session"),
        ('[[sessions]]\nname = "a"\n', "video"),
        ('[[sessions]]\nname = "a/b"\nvideo = "1.mp4"\n', "name"),
        ('[[sessions]]\nname = "..a"\nvideo = "1.mp4"\n', "name"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nsede = "x"\n', "sessions 1.sede"),
        ('[[sessions]]\nvideo = "*.avi"\n', "no video matches *.avi"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\n[[sessions]]\nname = "a"\nvideo = "1.mp4"\n', "are called a"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nrate = "1/0"\n', "pictures a second"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nstart_time = "noon"\n', "start_time"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nmerge.imu.offset = "12"\n', "offset"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\ntimeout_h = 0\n', "timeout_h"),
        ('[[overrides]]\nsessions = "b*"\n[[sessions]]\nname = "a"\nvideo = "1.mp4"\n', "no session is called b*"),
        (
            '[[sessions]]\nname = "a"\nvideo = "1.mp4"\nsensors = "imu=*.csv"\n',
            "sensor 'imu=*.csv': 2 files",
        ),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nsensors = ["m=x.csv", "m=y.csv"]\n', "called m already"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nsensors = ""\n', "write sensors = []"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nsensors = "wheel="\n', "write sensors = []"),
        ('[[sessions]]\nname = "a"\nvideo = ""\n', "no video is named"),
        ('[[sessions]]\nname = "a"\nvideo = []\n', "no video is named"),
        ('[[sessions]]\nname = "a"\nvideo = 1\n', "sessions 1.video: "),
        ('[[sessions]]\nname = "season.json"\nvideo = "1.mp4"\n', "not season.json"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nrate = "1e999999999"\n', "pictures a second"),
        ('[[sessions]]\nname = "a"\nvideo = "1.mp4"\nseeds = "s3://lab/x"\n', "session a: seeds s3://lab/x"),
        ('[sessions]\nname = "a"\nvideo = "1.mp4"\n', "begin each with [[sessions]], in two brackets"),
        (
            '[[sessions]]\nvideo = ["x.csv", "sub/../x.csv", "?.csv"]\n[[sessions]]\nname = "x"\nvideo = "y.csv"\n',
            "two sessions are called x: ",
        ),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, text, said):
    path = write(tmp_path, text, "1.mp4", "x.csv", "y.csv")
    with pytest.raises(SettingsError) as caught:
        load_season(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_addresses_stay_as_they_are(tmp_path):
    path = write(
        tmp_path,
        '[[sessions]]\nname = "a"\nvideo = "s3://lab/run1.mp4"\nsensors = "{folder}/run1_wheel.csv"\n',
    )
    plan = plans(path)["a"]
    assert plan.videos == ("s3://lab/run1.mp4",)
    assert [(s.name, s.path) for s in plan.sensors] == [("wheel", "s3://lab/run1_wheel.csv")]


def test_names_with_glob_characters_and_names_that_go_on_are_what_they_are(tmp_path):
    folder = tmp_path / "study [2025]"
    folder.mkdir()
    path = write(
        folder,
        """
        [[sessions]]
        video = "*.mp4"
        sensors = "{stem}*.csv"
        """,
        "run[1].mp4", "run[1]_wheel.csv", "run1_imu.csv",
    )  # fmt: skip
    (plan,) = load_season(path).plans
    assert plan.videos == (str(folder / "run[1].mp4"),)
    assert [(s.name, Path(s.path).name) for s in plan.sensors] == [("wheel", "run[1]_wheel.csv")]
    assert sensor_name("wheel.csv", "w") == "wheel"
    assert sensor_name("run10.csv", "run1") == "run10"
    assert sensor_name("run1.csv", "run1") == "run1"
    assert session_name(tmp_path / "видео.mp4", tmp_path) == "session"


def test_times_and_numbers_need_no_quotes(tmp_path):
    path = write(
        tmp_path, '[[sessions]]\nname = "a"\nvideo = "1.mp4"\nrate = 240\nstart_time = 2025-06-01T10:00:00Z\n', "1.mp4"
    )
    plan = plans(path)["a"]
    assert (plan.rate, plan.start_time_ns) == ("240", 1_748_772_000 * 10**9)


def test_a_name_too_long_for_any_file_is_one_that_is_not_there(tmp_path):
    long = "x" * 300
    path = write(
        tmp_path, f'[[sessions]]\nname = "a"\nvideo = "1.mp4"\nsettings = "{long}"\nseeds = "{long}"\n', "1.mp4"
    )
    assert plans(path)["a"].missing == (f"no settings: there is no {tmp_path / long}",)


def test_a_sensor_that_is_gone_is_told_whatever_its_name_has(tmp_path):
    text = '[[sessions]]\nname = "a"\nvideo = "1.mp4"\nsensors = ["a [[]1]_wheel.csv", "b[{]c}.csv", "maybe*.csv"]\n'
    missing = plans(write(tmp_path, text, "1.mp4"))["a"].missing
    assert [line.partition(":")[0] for line in missing] == ["no sensor", "no sensor"]


def test_sensors_that_would_be_called_alike_are_numbered(tmp_path):
    text = '[[sessions]]\nname = "a"\nvideo = "a.mp4"\nsensors = "{stem}*wheel.csv"\n'
    plan = plans(write(tmp_path, text, "a.mp4", "a-wheel.csv", "a_wheel.csv"))["a"]
    assert [(s.name, Path(s.path).name) for s in plan.sensors] == [("wheel", "a-wheel.csv"), ("wheel_2", "a_wheel.csv")]


def test_merging_told_of_a_sensor_that_the_session_does_not_have_is_noticed(tmp_path):
    text = (
        '[defaults]\nmerge.imu.sync = "w"\n'
        '[[sessions]]\nname = "a"\nvideo = "1.mp4"\nsensors = "wheel.csv"\nmerge.whel.offset = "+2h"\n'
    )
    plan = plans(write(tmp_path, text, "1.mp4", "wheel.csv"))["a"]
    assert plan.missing == ("no sensor is called whel, of which merge.whel speaks",)


def test_a_row_without_a_name_has_chapters_together_and_no_video_twice(tmp_path):
    text = (
        '[[sessions]]\nvideo = "v/*.MP4"\n[[sessions]]\nvideo = "**/*.MP4"\n'
        '[[sessions]]\nname = "x"\nvideo = "link/x.MP4"\n'
    )
    path = write(tmp_path, text, "v/GOPR0001.MP4", "v/GP010001.MP4", "v/GX020002.MP4", "v/x.MP4")
    (tmp_path / "link").symlink_to("v")
    found = plans(path)
    assert {name: [Path(video).name for video in plan.videos] for name, plan in found.items()} == {
        "GOPR0001": ["GOPR0001.MP4", "GP010001.MP4"], "GX020002": ["GX020002.MP4"], "x": ["x.MP4"],
    }  # fmt: skip
    assert found["GX020002"].missing == ("no video: nothing matches GX010002.MP4",)
    assert found["GOPR0001"].missing == ()


def test_a_manifest_that_grows_need_not_have_what_its_overrides_are_for(tmp_path):
    path = write(tmp_path, '[defaults]\nauto = true\n[[overrides]]\nsessions = "GOPR*"\nsubject = "anna"\n')
    assert load_season(path, growing=True).plans == ()
    with pytest.raises(SettingsError, match="no session in it"):
        load_season(path)
