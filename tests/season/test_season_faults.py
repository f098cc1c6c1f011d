"""What decides a result and what becomes of it, each promise by itself: keys, what is taken up, how runs end."""

import fcntl
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow.parquet as pq
import pytest
from made_up import asked, outcome, plan
from seasons import gone, in_work, kill, write_manifest, write_seeds, write_session
from test_season_reach import damaged

from clips import seed
from spheremcap import api
from spheremcap.corrections.told import HOW_TO_ANSWER
from spheremcap.errors import OutputError, SourceError, UsageError
from spheremcap.interrupt import Interrupted
from spheremcap.io.mcap_records import McapRecords
from spheremcap.season import key, requests, run, session, worker
from spheremcap.season.manifest import HowMerged, Plan, Season, Sensor, load_season
from spheremcap.season.outcome import RECORDING, RUN, TABLES, WORK, Outcome, read_outcome, write_outcome, write_season
from spheremcap.season.run import BusyError, Doing, SeasonRun, run_one, run_season
from spheremcap.season.session import run_session
from spheremcap.season.worker import BUSY, FAILED, KEPT, PROGRESS, STOPPED, TOO_LARGE, Ended, Worker, Workers, alone

LONG = 600  # frames of a session that a test has time to interfere with
LARGE_BYTES = 1 << 36  # of a file that is read for as long as nobody ends that; nothing is in it
WHEEL = "time_s,angle_rad\n" + "".join(f"{k / 200},{k / 50}\n" for k in range(20))


# --- the key ---


@pytest.fixture
def everything(tmp_path: Path) -> Plan:
    """A session that has every kind of file, all but the settings only to be looked at."""
    (tmp_path / "settings.toml").write_text('[camera]\nfile = "camera.yaml"\n')
    (tmp_path / "analysis.toml").write_text('[chair]\nclicks = "clicks.toml"\n')
    for name in ("1.mp4", "2.mp4", "camera.yaml", "clicks.toml", "wheel.csv", "imu.csv", "map.toml"):
        (tmp_path / name).write_text(f"the content of {name}")
    write_seeds(tmp_path / "seeds.toml")
    sensors = (
        Sensor(name="wheel", path=str(tmp_path / "wheel.csv"), how=HowMerged(mapping=str(tmp_path / "map.toml"))),
        Sensor(name="imu", path=str(tmp_path / "imu.csv")),
    )
    return Plan(
        name="a", videos=(str(tmp_path / "1.mp4"), str(tmp_path / "2.mp4")), settings=str(tmp_path / "settings.toml"),
        seeds=str(tmp_path / "seeds.toml"), analysis=str(tmp_path / "analysis.toml"), sensors=sensors,
    )  # fmt: skip


def given(of: Plan, known: Outcome | None = None) -> key.Given:
    found = key.given(of, known, Path)
    assert found is not None
    return found


def how(of: Plan, **said: Any) -> dict[str, Any]:
    """The plan's sensors, the second of them merged in another way."""
    first, second = of.sensors
    return {"sensors": (first, second.model_copy(update={"how": HowMerged(**said)}))}


def test_settings_of_a_session_are_in_the_key_and_those_of_the_tracking_in_its_own(everything: Plan) -> None:
    before = given(everything)
    seen = {before.key}
    for changed, tracked in (
        ({"auto": True}, True), ({"start_time": "2025-01-01T00:00:00Z"}, True), ({"rate": "100"}, True),
        ({"topic": "/image"}, True), ({"name": "b"}, True), ({"videos": everything.videos[::-1]}, True),
        ({"videos": everything.videos[:1]}, True), ({"subject": "anna"}, False), ({"force": True}, False),
        ({"analyse": False}, False), ({"fill_ms": 5.0}, False), ({"analysis": None}, False),
        (how(everything, offset="+5ms"), False), (how(everything, sync="left_wrist"), False),
        ({"sensors": (everything.sensors[0], everything.sensors[1].model_copy(update={"name": "other"}))}, False),
        ({"sensors": everything.sensors[:1]}, False),
    ):  # fmt: skip
        now = given(everything.model_copy(update=changed))
        assert now.key not in seen, changed
        assert (now.tracked != before.tracked) == tracked, changed
        seen.add(now.key)


@pytest.mark.parametrize(
    ("file", "tracked"),
    [("2.mp4", True), ("camera.yaml", True), ("clicks.toml", False), ("map.toml", False), ("imu.csv", False)],
)
def test_what_is_in_a_file_is_in_the_key(everything: Plan, tmp_path: Path, file: str, tracked: bool) -> None:
    before = given(everything)
    (tmp_path / file).write_text("something else")
    now = given(everything)
    assert now.key != before.key
    assert (now.tracked != before.tracked) == tracked


def test_answers_analysis_and_version_are_in_the_key(everything: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = [given(everything)]
    write_seeds(Path(everything.seeds), seed("orange"))
    keys.append(given(everything))
    assert everything.analysis is not None
    Path(everything.analysis).write_text('[chair]\nclicks = "clicks.toml"\n[wheel]\nrim_radius_m = 0.3\n')
    keys.append(given(everything))
    monkeypatch.setattr(key, "VERSION", "another")
    keys.append(given(everything))
    assert len({one.key for one in keys}) == 4
    assert [one.tracked == keys[0].tracked for one in keys] == [True, True, True, False]


def test_how_a_thing_is_written_and_where_it_lies_is_not_in_the_key(everything: Plan, tmp_path: Path) -> None:
    before = given(everything)
    Path(everything.settings or "").write_text('# a remark\n[camera]\n\nfile="camera.yaml"\n')
    assert given(everything).key == before.key
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "1.mp4").rename(tmp_path / "elsewhere" / "1.mp4")
    moved = (str(tmp_path / "elsewhere" / "1.mp4"), everything.videos[1])
    assert given(everything.model_copy(update={"videos": moved})).key == before.key


def is_done(of: Plan, before: key.Given, folder: Path) -> bool:
    """By what is known of its files, with its result there."""
    (folder / "of").mkdir(exist_ok=True)
    (folder / "of" / RECORDING).write_bytes(b"123")
    told = outcome("a", key=before.key, inputs=tuple(before.files.values()), files={RECORDING: 3})
    return key.is_done(of, told, folder / "of")


@pytest.mark.parametrize("same", ["size", "time", "size and time"])
def test_a_file_is_read_again_when_it_may_be_another_one(everything: Plan, tmp_path: Path, same: str) -> None:
    before = given(everything)
    known = outcome("a", key=before.key, inputs=tuple(before.files.values()))
    assert is_done(everything, before, tmp_path)
    video, text = tmp_path / "1.mp4", "the content of 1.mp4"
    then = video.stat()
    time.sleep(0.02)  # a file system's clock has ticks
    video.write_text(text * 2 if same == "time" else text.upper())
    if "time" in same:
        os.utime(video, ns=(then.st_atime_ns, then.st_mtime_ns))
    assert not is_done(everything, before, tmp_path)
    assert given(everything, known).key != before.key
    with pytest.raises(SourceError, match="was changed while"):
        key.check_unchanged(before.files)
    video.write_text(text)  # written again, and the same
    assert given(everything, known).key == before.key
    key.check_unchanged(before.files)


def test_a_folder_of_pictures_counts_by_names_and_contents(everything: Plan, tmp_path: Path) -> None:
    folder = tmp_path / "shown"
    folder.mkdir()
    for name in ("1.png", "2.png", "3.png"):
        (folder / name).write_text(name)
        os.utime(folder / name, (1000, 1000))
    shown = everything.model_copy(update={"videos": (str(folder),)})
    before = given(shown)
    known = outcome("a", key=before.key, inputs=tuple(before.files.values()))
    (folder / "2.png").write_text("3.png")  # just as large
    assert not is_done(shown, before, tmp_path)
    (folder / "2.png").write_text("2.png")
    assert given(shown, known).key == before.key
    for old, new in (("2.png", "x"), ("3.png", "2.png"), ("x", "3.png")):  # in another order
        (folder / old).rename(folder / new)
    assert not is_done(shown, before, tmp_path)
    assert given(shown, known).key != before.key
    assert key.key_of("12", "3") != key.key_of("1", "23")


def test_of_a_list_of_chapters_what_it_lists_counts(everything: Plan, tmp_path: Path) -> None:
    (tmp_path / "both.ffconcat").write_text("ffconcat version 1.0\nfile '1.mp4'\nfile '2.mp4'\n")
    both = everything.model_copy(update={"videos": (str(tmp_path / "both.ffconcat"),)})
    before = given(both)
    assert is_done(both, before, tmp_path)
    (tmp_path / "2.mp4").write_text("another one")
    assert not is_done(both, before, tmp_path)
    assert given(both).key != before.key


@pytest.mark.parametrize("of", [RECORDING, f"{TABLES}/poses.parquet"])
@pytest.mark.parametrize("how", ["gone", "cut"])
def test_a_result_that_is_not_what_it_was_is_made_again(made, tmp_path, of, how):
    before, lines = made(), list[str]()
    folder = tmp_path / "out" / "a"
    assert set(before.files) == {RECORDING, *(f"{TABLES}/{name}.parquet" for name in ("poses", "quality", "clocks"))}
    if how == "gone":
        (folder / of).unlink()
    else:
        os.truncate(folder / of, 100)
    kept = pq.read_table(folder / TABLES / "quality.parquet")
    told = made(lines.append)
    assert any("tables" in line for line in lines)
    assert told.key == before.key
    assert pq.read_table(folder / TABLES / "quality.parquet") == kept
    assert len(pq.read_table(folder / TABLES / "poses.parquet")) == 32
    assert {name: (folder / name).stat().st_size for name in told.files} == told.files


# --- what becomes of a session ---


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., Outcome]:
    """Runs session a here, in this process, with what the manifest is to say of it beside its video."""
    write_session(tmp_path / "a")
    (tmp_path / "a" / "wheel.csv").write_text(WHEEL)

    def make(
        say: Callable[[str], None] = lambda line: None, stop: Callable[[], bool] = lambda: False, **said: Any
    ) -> Outcome:
        own = {"video": "a/v.mp4", "settings": "a/settings.toml"} | said
        (of,) = load_season(write_manifest(tmp_path, {"a": own})).plans
        told, _ = run_session(of, tmp_path / "out" / "a", progress=lambda *told: None, say=say, stop=stop)
        return told

    return make


def facts(recording: Path) -> tuple[set[str], list[str], list[str]]:
    """Topics, metadata and attachments of a recording."""
    with McapRecords(recording) as records:
        topics = {channel.topic for channel in records.channels.values()}
        return topics, sorted(r.name for r in records.metadata), sorted(f.name for f in records.attachments())


def test_what_was_merged_and_analysed_leaves_nothing_when_it_is_not_wanted_any_more(made, tmp_path):
    made()
    plain = facts(tmp_path / "out" / "a" / "session.mcap")
    made(analyse=False)
    bare = facts(tmp_path / "out" / "a" / "session.mcap")
    assert not (tmp_path / "out" / "a" / "session.report.html").exists()
    lines: list[str] = []
    made(lines.append, sensors="a/wheel.csv")
    assert facts(tmp_path / "out" / "a" / "session.mcap")[0] == plain[0] | {"/sensors/wheel", "/merged/tf"}
    assert "tracked already" in lines
    made()
    assert facts(tmp_path / "out" / "a" / "session.mcap") == plain
    made(analyse=False)
    assert facts(tmp_path / "out" / "a" / "session.mcap") == bare


def test_what_the_tracking_lost_stays_lost_when_it_is_taken_up(made, tmp_path):
    write_session(tmp_path / "b", 60)
    damaged(tmp_path / "b" / "v.mp4")
    lines: list[str] = []
    first = made(video="b/v.mp4")
    again = made(lines.append, video="b/v.mp4", sensors="a/wheel.csv")
    assert "tracked already" in lines
    assert (first.status, again.status) == ("lost", "lost")
    assert any("could not be decoded" in line for line in first.lost)
    assert again.lost == first.lost
    assert "camera from the settings" in first.notes
    assert "camera from the settings" in again.notes


def test_a_recording_that_is_damaged_is_tracked_anew(made, tmp_path):
    made()
    recording = tmp_path / "out" / "a" / "session.mcap"
    recording.write_bytes(recording.read_bytes()[:-2000])
    lines: list[str] = []
    assert made(lines.append, sensors="a/wheel.csv").status == "done"
    assert "tracking ..." in lines


def test_a_session_that_failed_is_gone_on_with_from_what_was_recorded(made, tmp_path):
    made()
    settings = tmp_path / "a" / "settings.toml"
    was = settings.read_text()
    settings.write_text("[camera]\nprest = 'x'\n")
    assert made().status == "failed"
    settings.write_text(was)
    lines: list[str] = []
    assert made(lines.append).status == "done"
    assert "tracked already" in lines


def test_what_a_run_that_was_killed_left_is_in_nobodys_way(made, tmp_path):
    left = tmp_path / "out" / "a" / WORK / "tracked"
    left.mkdir(parents=True)
    (left / "a.mcap").write_text("half of it")
    assert made().status == "done"
    assert not left.parent.exists()


def test_without_all_files_in_place_there_is_no_result(made, tmp_path, monkeypatch):
    made()

    def killed(self: Path, target: Path) -> None:
        if Path(target).name == TABLES:
            raise RuntimeError("killed")
        os.rename(self, target)

    monkeypatch.setattr(Path, "rename", killed)
    with pytest.raises(RuntimeError, match="killed"):
        made(sensors="a/wheel.csv")
    assert not (tmp_path / "out" / "a" / RUN).exists()
    monkeypatch.undo()
    assert made(sensors="a/wheel.csv").status == "done"


def test_it_stops_while_a_large_input_is_read(made, tmp_path):
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(1 << 28)
    lines: list[str] = []
    with pytest.raises(Interrupted):
        made(lines.append, lambda: bool(lines), sensors="large.csv")
    assert lines == ["reading ..."]
    assert list((tmp_path / "out" / "a").iterdir()) == []


def test_stopped_between_two_steps_nothing_has_changed(made, tmp_path):
    lines: list[str] = []
    with pytest.raises(Interrupted):
        made(lines.append, lambda: any("tracking" in line for line in lines))
    assert list((tmp_path / "out" / "a").iterdir()) == []


def test_sensors_that_cannot_be_merged_together_are_named(made, tmp_path):
    (tmp_path / "b").mkdir()
    for name in ("rim", "hub"):
        (tmp_path / "b" / f"{name}.csv").write_text(WHEEL)
    told = made(sensors=["m=b", "m_rim=a/wheel.csv"])  # of the folder one is m_rim, too
    assert told.status == "lost"
    assert "sensors m, m_rim are left out" in told.lost[0]
    assert "left out" in told.lost[0]


def test_a_sensor_that_goes_away_before_its_session_is_run_does_not_end_it(made, tmp_path, monkeypatch):
    (of,) = load_season(write_manifest(tmp_path, {"a": {"video": "a/v.mp4", "sensors": "a/wheel.csv"}})).plans
    (tmp_path / "a" / "wheel.csv").unlink()
    assert "wheel.csv" not in {Path(path).name for path in given(of).files}


@pytest.mark.parametrize("wanted", [True, False])
def test_what_could_not_be_analysed_is_a_loss_where_somebody_gave_settings(made, tmp_path, monkeypatch, wanted):
    def refused(*told: Any, **more: Any) -> None:
        raise UsageError("no axle")

    monkeypatch.setattr(api, "analyse", refused)
    (tmp_path / "analysis.toml").write_text("")
    told = made(**({"analysis": "analysis.toml"} if wanted else {}))
    assert told.status == ("lost" if wanted else "done")
    assert "not analysed: no axle" in (told.lost if wanted else told.notes)


def test_tables_of_the_analysis_are_among_the_tables_and_strokes_by_side(made, tmp_path, monkeypatch):
    analyse = api.analyse

    def pushed(merged: Path, out: Path, *told: Any, **more: Any) -> Any:
        assert more["fill_ms"] == 7
        report = analyse(merged, out, *told, **more)
        out.with_name("a.events.csv").write_text("events")
        return report

    monkeypatch.setattr(api, "analyse", pushed)
    monkeypatch.setattr(session, "has_strokes", lambda records: True)
    monkeypatch.setattr(session, "read_strokes", lambda records: ((), [SimpleNamespace(side="left")] * 2))
    told = made(fill_ms=7)
    assert (tmp_path / "out" / "a" / TABLES / "events.csv").read_text() == "events"
    assert told.strokes == {"left": 2, "right": 0}


def test_how_a_sensor_is_merged_and_when_the_video_began_are_handed_on(made, monkeypatch):
    seen: list[Any] = []
    merge = api.merge

    def watched(sources: Any, out: Path, **more: Any) -> Any:
        seen[:] = [sources[1], more["force"]]
        return merge(sources, out, **more)

    monkeypatch.setattr(api, "merge", watched)
    wheel = {"offset": "+5ms", "drift": "+20ppm", "rate_hz": 200.0}
    told = made(sensors="a/wheel.csv", merge={"wheel": wheel}, force=True, start_time="2024-05-01T10:00:00Z")
    source, force = seen
    assert (source.offset_ns, float(source.drift), source.rate_hz, source.sync_marker) == (
        5_000_000,
        20e-6,
        200.0,
        None,
    )
    assert force
    assert told.start_ns == 1_714_557_600 * 10**9
    made(sensors="a/wheel.csv", merge={"wheel": {"sync": "orange"}})
    assert seen[0].sync_marker == "orange"
    assert not seen[1]


def test_nobody_looks_for_markers_that_are_seeded(made, monkeypatch):
    monkeypatch.setattr(api, "find", lambda *told, **more: pytest.fail("looked for markers"))
    assert made(auto=True).status == "done"


def test_a_chapter_that_is_gone_is_no_result(made, tmp_path):
    told = made(video=["a/v.mp4", "a/w.mp4"])
    assert (told.status, told.reason) == ("failed", "no video: nothing matches a/w.mp4")


@pytest.mark.parametrize("error", [OutputError("out/a: cannot be written: full"), OSError(28, "full")])
def test_what_cannot_be_written_is_not_the_sessions_fault(made, monkeypatch, error):
    monkeypatch.setattr(session._Making, "_publish", raising(error))
    with pytest.raises(OutputError, match=r"cannot be written: full|No space left on device: free some space"):
        made()


def test_an_answer_leaves_what_the_first_tracking_said(made, tmp_path):
    (tmp_path / "a" / "settings.toml").write_text('[output]\ndebug_images = "none"\n')
    first = made()
    assert any("no camera" in note for note in first.notes)
    seeds = tmp_path / "a" / "v.seeds.toml"
    before = seeds.read_text()
    for frames in ("10", "12"):
        seeds.write_text(f'{before}\n[[seeds]]\nmarker = "orange"\nframe = 8\nto_frame = {frames}\nkind = "hidden"\n')
        told = made()
        assert told.recorded.notes == first.recorded.notes
        assert set(told.notes) >= set(first.notes)
        assert set(told.notes) - set(first.notes) == set(told.recorded.stretches)
        assert f"orange: hidden on frames 8 to {frames}" in told.recorded.stretches[0]
    again = made(subject="anna")
    assert again.notes == told.notes


def test_a_result_whose_videos_have_moved_says_where_they_are(made, tmp_path):
    made()
    (tmp_path / "a").rename(tmp_path / "b")
    lines: list[str] = []
    told = made(lines.append, video="b/v.mp4", settings="b/settings.toml")
    assert not any("tracking" in line for line in lines)
    assert told.videos == (str(tmp_path / "b" / "v.mp4"),)
    assert told.seeds == str(tmp_path / "b" / "v.seeds.toml")


def test_where_to_answer_is_told_as_of_a_season(made, monkeypatch):
    def lost(*told: Any, **more: Any) -> Any:
        report = track(*told, **more)
        report.lost.append(f"orange is LOST: {HOW_TO_ANSWER}")
        return report

    track = api.track
    monkeypatch.setattr(api, "track", lost)
    assert made().lost == ("orange is LOST: spheremcap annotate OUT, and run the season again",)


def test_markers_are_looked_for_where_nobody_has_said_where_they_begin(made, tmp_path, monkeypatch):
    asked: list[int] = []

    def find(*told: Any, **more: Any) -> Any:
        asked.append(1)
        raise SourceError("looked for")

    monkeypatch.setattr(api, "find", find)
    (tmp_path / "a" / "v.seeds.toml").write_text(
        '[[seeds]]\nmarker = "orange"\nframe = 8\nto_frame = 9\nkind = "hidden"\n'
    )
    assert made(auto=True).reason == "looked for"
    assert "no seeds" in made().reason
    assert asked == [1]


def test_no_memory_is_a_reason_to_fail(made, tmp_path, monkeypatch):
    def much(*told: Any, **more: Any) -> None:
        raise MemoryError

    monkeypatch.setattr(api, "track", much)
    told = made()
    assert (told.status, "out of memory" in told.reason) == ("failed", True)
    assert not (tmp_path / "out" / "a" / WORK).exists()


# --- how a session's process ends ---


@contextmanager
def ending(monkeypatch: pytest.MonkeyPatch, ended: Ended, do: Callable[[], None] = lambda: None) -> Iterator[None]:
    """A worker whose session ends so, without any process."""

    def told(*asked: object) -> Ended:
        do()
        return ended

    @contextmanager
    def one() -> Iterator[Any]:
        yield SimpleNamespace(run=told)

    monkeypatch.setattr(run, "_workers", SimpleNamespace(one=one))
    yield


def raising(error: Exception) -> Callable[..., None]:
    def fail(*told: Any, **more: Any) -> None:
        raise error

    return fail


def crashed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ended: Ended, log: str = "", **said: Any) -> Outcome:
    """What is said of a session that had a result before and ends so now."""
    folder = tmp_path / "a"
    (folder / WORK).mkdir(parents=True, exist_ok=True)
    (folder / "log.txt").write_text(log)
    recorded = {"tracked": "t", "answers": "a", "topics": (), "metadata": (), "attachments": 0}
    write_outcome(folder, Outcome.model_validate(outcome("a").model_dump() | {"recorded": recorded}))
    with ending(monkeypatch, ended):
        told = run_one(plan("a", **said), folder, tmp_path / "stop")
    assert told is not None
    assert read_outcome(folder) == told
    assert not (folder / WORK).exists()
    assert told.recorded is not None  # to be gone on with
    return told


def test_every_end_of_a_process_has_its_reason(tmp_path, monkeypatch):
    for ended, log, said in (
        (Ended(-9, 10), "", "it was killed (SIGKILL)"),
        (Ended(-11, 10), "Fatal: bus\n", "it crashed (SIGSEGV): Fatal: bus"),
        (Ended(-6, 10), "terminate: std::bad_alloc\nAborted\n", "out of memory"),
        (Ended(1, 10), "Traceback\nMemoryError\n", "out of memory"),
        (Ended(1, 10), "RuntimeError: can't start new thread\n", "out of memory"),
        (Ended(TOO_LARGE, 10), "", "out of memory: it needed more than memory_gb = 2"),
        (Ended(FAILED, 10), "tracking ...\na/b: cannot be written: it is full\n", "a/b: cannot be written: it is full"),
        (Ended(1, 10), "Traceback\nKeyError: 'x'\n", "a fault of spheremcap's own ended it: KeyError: 'x'"),
        (Ended(STOPPED, 10, hung=True), "", "not done after 3 hours"),
        (Ended(-9, 10, hung=True), "", "not done after 3 hours"),
    ):
        told = crashed(tmp_path, monkeypatch, ended, log, timeout_h=3, memory_gb=2)
        assert told.status == "failed"
        assert said in told.reason


def test_a_session_that_has_ended_has_its_memory_noted_and_one_without_a_result_failed(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    with ending(monkeypatch, Ended(0, 1234), lambda: write_outcome(tmp_path / "a", outcome("a"))):
        run_one(plan("a"), tmp_path / "a", tmp_path / "stop")
    told = read_outcome(tmp_path / "a")
    assert told is not None
    assert told.peak_mb == 1234
    for late in (Ended(KEPT, 99), Ended(0, 1234, hung=True)):  # what is there counts, however late
        with ending(monkeypatch, late):
            assert run_one(plan("a"), tmp_path / "a", tmp_path / "stop") == told
    with ending(monkeypatch, Ended(0, 99)), monkeypatch.context() as full:
        full.setattr(run, "write_outcome", raising(OutputError("the disk is full")))
        assert run_one(plan("a"), tmp_path / "a", tmp_path / "stop") is not None
    with ending(monkeypatch, Ended(0, 1234), (tmp_path / "a" / RUN).unlink):
        said = run_one(plan("a"), tmp_path / "a", tmp_path / "stop")
    assert said is not None
    assert "run.json cannot be read" in said.reason


def test_who_finds_another_run_at_work_leaves_it_alone(tmp_path, monkeypatch):
    folder = tmp_path / "a"
    (folder / WORK).mkdir(parents=True)
    with ending(monkeypatch, Ended(BUSY, 10)), pytest.raises(BusyError):
        run_one(plan("a"), folder, tmp_path / "stop")
    assert [path.name for path in folder.iterdir()] == [WORK]


def test_what_is_stopped_is_not_begun_and_has_no_outcome(tmp_path, monkeypatch):
    with ending(monkeypatch, Ended(STOPPED, 10)):
        assert run_one(plan("a"), tmp_path / "a", tmp_path / "stop") is None
    (tmp_path / "stop").touch()
    with ending(monkeypatch, Ended(0, 10), lambda: pytest.fail("begun")):
        assert run_one(plan("a"), tmp_path / "a", tmp_path / "stop") is None
    assert not (tmp_path / "a").exists()


def test_one_run_at_a_time_works_in_a_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(worker, "_BUSY_S", 0.0)
    with alone(tmp_path) as first, alone(tmp_path) as second:
        assert (first, second) == (True, False)
    with alone(tmp_path) as free:
        assert free
    (tmp_path / "a").mkdir()
    with alone(tmp_path / "a"):
        assert worker._run(plan("a"), tmp_path / "a") == BUSY
    lock = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # nobody has it any more
    os.close(lock)


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    found = Workers()
    yield found
    found.close()


@pytest.fixture
def long(tmp_path: Path) -> Plan:
    (of,) = load_season(write_manifest(tmp_path, {"long": write_session(tmp_path / "long", LONG)})).plans
    return of


def test_a_session_is_stopped_killed_and_outlived(workers, long, tmp_path, monkeypatch):
    """As one test, for a worker takes its time to start."""
    monkeypatch.setattr(worker, "_GRACE_S", 0.3)
    ends: list[Ended] = []
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(LARGE_BYTES)
    endless = long.model_copy(update={"sensors": (Sensor(name="large", path=str(tmp_path / "large.csv")),)})

    @contextmanager
    def large(own: Worker, out: Path) -> Iterator[int]:
        """The process of a session that does not come to its end."""
        thread = threading.Thread(target=lambda: ends.append(own.run(endless, out / "long", lambda: False)))
        thread.start()
        pid = in_work(out, "long", "reading")
        try:
            yield pid
        finally:
            with suppress(ProcessLookupError):
                kill(pid)
            thread.join()

    def run_nothing(own: Worker) -> None:
        assert own.run(plan("nothing", videos=()), tmp_path / "nothing", lambda: False).code == 0

    with workers.one() as own:
        process = own._process
        own._tell({"signal": int(signal.SIGTERM)})  # to one that has ended by itself
        run_nothing(own)
        working = tmp_path / "1" / "long" / WORK / PROGRESS
        ended = own.run(long, tmp_path / "1" / "long", working.exists)
        assert ended.code == STOPPED
        assert ended.peak_mb is not None
        assert 20 < ended.peak_mb < 10_000
    with workers.one() as own:
        assert own._process is process  # it stays
        stop = threading.Event()
        thread = threading.Thread(target=lambda: ends.append(own.run(long, tmp_path / "2" / "long", stop.is_set)))
        thread.start()
        pid = in_work(tmp_path / "2", "long")
        os.kill(pid, signal.SIGSTOP)  # it hears nothing
        stop.set()
        thread.join(5)
        killed = not thread.is_alive()
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
        thread.join()
        assert killed
        assert ends[0].code == STOPPED  # nobody else killed it

        with large(own, tmp_path / "3") as pid:
            process.kill()
            assert gone(pid, wait_s=5)  # its session goes with it
        assert ends[1].code == -signal.SIGKILL
    with workers.one() as own:
        assert own._process is not process
        run_nothing(own)
        with large(own, tmp_path / "4") as pid:
            assert own._process.stdin is not None
            own._process.stdin.close()  # as when whoever started it was killed
            assert gone(pid, wait_s=5)


# --- a run ---


def season_run(out: Path, plans: list[Plan], ends: Callable[[Plan], Outcome | None], **more: Any) -> SeasonRun:
    """A run whose sessions end so, without any process."""

    def submit(of: Plan, folder: Path, stop_file: Path) -> "Future[Outcome | None]":
        future: Future[Outcome | None] = Future()
        try:
            future.set_result(ends(of))
        except Exception as error:
            future.set_exception(error)
        return future

    return run_season(Season(name="s", plans=tuple(plans)), plans, out, submit, **more)


def test_the_longest_session_is_begun_first(tmp_path):
    plans = []
    for name, size in (("a", 10), ("b", 30), ("c", 20)):
        (tmp_path / name).write_bytes(bytes(size))
        plans.append(plan(name, videos=(str(tmp_path / name),)))
    begun: list[str] = []

    def ends(of: Plan) -> Outcome:
        begun.append(of.name)
        return outcome(of.name)

    done = season_run(tmp_path / "out", plans, ends)
    assert begun == ["b", "c", "a"]
    assert done.made == ("a", "b", "c")
    assert done.complete
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["season.json"]


def test_a_worker_that_is_lost_costs_its_session_and_losses_are_not_complete(tmp_path):
    def ends(of: Plan) -> Outcome:
        if of.name == "b":
            raise OSError("no route to host")
        return outcome(of.name)

    done = season_run(tmp_path / "out", [plan("a"), plan("b")], ends)
    assert [told.status for told in done.outcomes.values()] == ["done", "failed"]
    assert "lost: no route to host" in done.outcomes["b"].reason
    assert read_outcome(tmp_path / "out" / "b") == done.outcomes["b"]
    assert not SeasonRun({"a": outcome("a", "lost")}, ("a",), (), False).complete
    assert not SeasonRun({"a": outcome("a")}, ("a",), (), True).complete


def test_a_run_tells_of_those_before_and_not_of_what_has_changed_since(tmp_path):
    (tmp_path / "v").write_text("")
    plans = [plan(name, videos=(str(tmp_path / "v"),)) for name in "ab"]
    for of, key_ in zip(plans, (given(plans[0]).key, "of something else"), strict=True):
        (tmp_path / "out" / of.name).mkdir(parents=True)
        inputs = tuple(given(of).files.values())
        told = outcome(of.name, key=key_, inputs=inputs, files={RECORDING: 0})
        write_outcome(tmp_path / "out" / of.name, told)
        (tmp_path / "out" / of.name / RECORDING).write_text("")
    write_season(tmp_path / "out", Season(name="s", plans=tuple(plans)))
    stopped = season_run(tmp_path / "out", plans, lambda of: None)
    assert stopped.stopped
    assert list(stopped.outcomes) == ["a"]
    done = season_run(tmp_path / "out", plans, lambda of: outcome(of.name))
    assert done.made == ("b",)
    assert list(done.outcomes) == ["a", "b"]


def test_what_a_killed_run_left_to_stop_others_is_taken_away(tmp_path):
    (tmp_path / "out").mkdir()
    old, new = tmp_path / "out" / ".stop-1", tmp_path / "out" / ".stop-2"
    old.touch()
    new.touch()
    os.utime(old, (1, 1))
    season_run(tmp_path / "out", [plan("a")], lambda of: outcome(of.name))
    assert (old.exists(), new.exists()) == (False, True)


@pytest.mark.parametrize("before", [False, True])
def test_who_stops_a_run_leaves_a_file_for_those_at_work_and_takes_it_away(tmp_path, before):
    """Also where a session was ended by somebody before."""

    def submit(of: Plan, folder: Path, stop_file: Path) -> "Future[Outcome | None]":
        future: Future[Outcome | None] = Future()
        if of.name == "ended":
            future.set_result(None)
            return future

        def work() -> None:
            until = time.monotonic() + 20
            while not stop_file.exists() and time.monotonic() < until:
                time.sleep(0.01)
            future.set_result(None if stop_file.exists() else outcome(of.name))

        threading.Thread(target=work).start()
        return future

    plans = [plan("a"), *([plan("ended")] if before else [])]
    asked = iter([False])
    done = run_season(
        Season(name="s", plans=tuple(plans)), plans, tmp_path / "out", submit, stop=lambda: next(asked, True)
    )
    assert done.stopped
    assert done.outcomes == {}
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["season.json"]


def test_progress_is_never_more_than_all_of_it(tmp_path):
    work = tmp_path / "a" / WORK
    work.mkdir(parents=True)
    for told, share in (
        ('{"step": "tracking", "done": 50, "total": 100}', 0.435),
        ('{"step": "tracking", "done": 300, "total": 100}', 0.85),
        ('{"step": "tracking", "done": 3, "total": null}', 0.02),
        ('{"step": "reading", "done": 0, "total": null}', 0.0),
    ):
        (work / PROGRESS).write_text(told)
        ((_, found),) = run._working(tmp_path, [plan("a")]).values()
        assert found == pytest.approx(share)
    assert Doing({"a": 10, "b": 20}, {"a": outcome("a")}, {"b": ("tracking", 0.5)}).done_bytes == 20


# --- questions ---


def test_questions_are_by_frame_and_those_of_seeds_that_cannot_be_read_stay_open(tmp_path):
    seeds = tmp_path / "seeds.toml"
    recorded = {"tracked": "t", "answers": "a", "topics": (), "metadata": (), "attachments": 0}
    told = outcome("a", requests=(asked("a", 30), asked("b", 10), asked("c", 20, "an answer")), recorded=recorded)
    write_season(tmp_path, Season(name="s", plans=(plan("a", seeds=str(seeds)),)))
    (tmp_path / "a").mkdir()
    write_outcome(tmp_path / "a", Outcome.model_validate(told.model_dump()))
    for text in (None, "nonsense"):
        if text is not None:
            seeds.write_text(text)
        assert [(q.asked.marker, q.asked.frame, q.answered) for q in requests.questions(tmp_path)] == [
            ("b", 10, False), ("a", 30, False)
        ]  # fmt: skip


def test_a_question_about_one_of_several_cameras_is_answered_by_its_own_seeds(tmp_path, monkeypatch):
    recorded = {"tracked": "t", "answers": "a", "topics": (), "metadata": (), "attachments": 0}
    told = outcome("a", requests=(asked("left/blue", 10), asked("right/blue", 10)), recorded=recorded)
    write_season(tmp_path, Season(name="s", plans=(plan("a", seeds=str(write_seeds(tmp_path / "seeds.toml"))),)))
    (tmp_path / "a").mkdir()
    write_outcome(tmp_path / "a", Outcome.model_validate(told.model_dump()))

    @contextmanager
    def opened(recording: Path, seeds: Path, camera: str | None = None) -> Iterator[Any]:
        asks = SimpleNamespace(asked=asked("blue", 10), answered=lambda answers, last: camera == "left")
        asks.asked = SimpleNamespace(marker="blue", frame_index=10, answered="")
        yield SimpleNamespace(
            cameras=("left", "right"), answers=SimpleNamespace(answers=tuple), last=20, asked=lambda: [asks]
        )

    monkeypatch.setattr(requests, "Opened", opened)
    assert [(q.asked.marker, q.answered) for q in requests.questions(tmp_path)] == [
        ("left/blue", True), ("right/blue", False)
    ]  # fmt: skip


# --- the manifest ---


def read(folder: Path, text: str) -> Plan:
    (folder / "season.toml").write_text(f'[[sessions]]\nname = "a"\nvideo = "v.mp4"\n{text}')
    (found,) = load_season(folder / "season.toml").plans
    return found


def test_a_sensor_is_found_once_by_name_and_merged_by_a_mapping_that_lies_with_the_manifest(tmp_path, monkeypatch):
    for name in ("v.mp4", "1.csv", "2.csv", "v.settings.toml", "own.toml"):
        (tmp_path / name).write_text("")
    found = read(tmp_path, 'sensors = ["wheel=2.csv", "*.csv"]\nmerge.wheel.mapping = "no.toml"\nsettings = "own.toml"')
    assert [(s.name, Path(s.path).name) for s in found.sensors] == [("wheel", "2.csv"), ("1", "1.csv")]
    assert found.sensors[0].how.mapping == str(tmp_path / "no.toml")
    assert found.missing == (f"no mapping: there is no {tmp_path / 'no.toml'}",)
    assert found.settings == str(tmp_path / "own.toml")
    glob = __import__("glob").glob
    monkeypatch.setattr("spheremcap.season.manifest.glob.glob", lambda *p, **m: sorted(glob(*p, **m), reverse=True))
    assert [s.name for s in read(tmp_path, 'sensors = "*.csv"').sensors] == ["1", "2"]


def test_names_are_told_apart_by_their_case_and_no_video_is_from_before_1970(tmp_path):
    (tmp_path / "v.mp4").write_text("")
    with pytest.raises(UsageError, match="no session is called A"):
        read(tmp_path, '[[overrides]]\nsessions = "A*"\nsubject = "anna"')
    with pytest.raises(UsageError, match="1970"):
        read(tmp_path, 'start_time = "1969-12-31T23:59:59Z"')
