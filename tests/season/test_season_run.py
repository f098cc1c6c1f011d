"""A season's run: each session by itself, only what is new or has changed, and every failure with its reason."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from seasons import dataset, files, gone, in_work, write_manifest, write_seeds, write_session

from clips import seed, write_recording
from spheremcap.errors import UsageError
from spheremcap.io.mcap_records import McapRecords
from spheremcap.season.manifest import load_season
from spheremcap.season.outcome import Outcome, read_outcome, write_season
from spheremcap.season.run import SeasonRun, here, run_season, shard
from spheremcap.season.worker import STOPPED, Worker, alone

LONG = 1200  # frames of a session that a test has time to interfere with


@pytest.fixture(scope="module")
def run() -> Iterator[Callable[[Path, Path], SeasonRun]]:
    """Runs a manifest's sessions into a folder; workers stay for the next test."""
    with here(2) as submit:

        def run_it(manifest: Path, out: Path) -> SeasonRun:
            season = load_season(manifest)
            return run_season(season, season.plans, out, submit)

        yield run_it


@pytest.fixture
def manifest(tmp_path: Path) -> Path:
    wheel = "time_s,angle_rad\n" + "".join(f"{k / 200},{k / 50}\n" for k in range(20))
    said = write_session(tmp_path / "a")
    (tmp_path / "a" / "wheel.csv").write_text(wheel)
    return write_manifest(
        tmp_path, {"a": said | {"sensors": "a/wheel.csv", "subject": "anna"}, "b": write_session(tmp_path / "b")}
    )


def outcome_of(out: Path, name: str) -> Outcome:
    found = read_outcome(out / name)
    assert found is not None
    return found


def test_a_session_has_its_recording_tables_log_and_what_decided_it(run, manifest, tmp_path):
    out = tmp_path / "out"
    done = run(manifest, out)
    assert done.complete
    assert done.made == ("a", "b")
    assert {path.name for path in (out / "a").iterdir()} == {
        "session.mcap", "session.layout.json", "session.report.html", "tables", "run.json", "log.txt"
    }  # fmt: skip
    told = outcome_of(out, "a")
    assert (told.status, told.subject, told.frames) == ("done", "anna", 16)
    assert {m.marker: m.measured for m in told.markers} == {"orange": 16, "blue": 16}
    assert [(c.sensor, c.samples) for c in told.clocks] == [("wheel", 20)]
    assert {Path(f.path).name for f in told.inputs} == {"v.mp4", "wheel.csv"}
    with McapRecords(out / "a" / "session.mcap") as records:
        topics = {channel.topic for channel in records.channels.values()}
        assert {"/sensors/wheel", "/markers/orange/pose", "/camera/video"} <= topics
        assert not records.lost
    poses = pq.read_table(out / "a" / "tables" / "poses.parquet")
    assert len(poses) == 32
    assert "tracking ..." in (out / "a" / "log.txt").read_text()


def test_a_second_run_does_only_what_is_new_or_changed(run, manifest, tmp_path):
    out = tmp_path / "out"
    run(manifest, out)
    before = files(out)
    again = run(manifest, out)
    assert again.made == ()
    assert again.complete
    assert files(out) == before
    (tmp_path / "b" / "settings.toml").write_text(
        "# a comment changes nothing\n" + (tmp_path / "b" / "settings.toml").read_text()
    )
    assert run(manifest, out).made == ()
    (tmp_path / "b" / "settings.toml").write_text(
        (tmp_path / "b" / "settings.toml").read_text().replace('"none"', '"crops"')
    )
    assert run(manifest, out).made == ("b",)
    assert "tracking ..." in (out / "b" / "log.txt").read_text()
    log, told = (out / "a" / "log.txt").read_bytes(), outcome_of(out, "a")
    os.utime(tmp_path / "a" / "v.mp4", (1, 1))  # looks new, and is not
    made = run(manifest, out)
    assert made.made == ("a",)
    assert (out / "a" / "log.txt").read_bytes() == log
    assert outcome_of(out, "a").model_copy(update={"inputs": told.inputs}) == told
    assert run(manifest, out).made == ()


def test_an_answer_tracks_its_stretch_again_and_nothing_else(run, manifest, tmp_path):
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    run(manifest, out)
    write_seeds(tmp_path / "a" / "v.seeds.toml", seed("orange"), seed("blue", 1), seed("orange", 0, 9))
    assert run(manifest, out).made == ("a",)
    log = (out / "a" / "log.txt").read_text()
    assert "tracking again ..." in log
    assert "tracking ..." not in log
    run(manifest, fresh)  # with the answer from the start
    tables = [files(folder / "a" / "tables") for folder in (out, fresh)]
    assert tables[0] == tables[1]
    write_seeds(tmp_path / "a" / "v.seeds.toml", seed("orange"), seed("blue", 1, 1))  # another beginning
    run(manifest, out)
    assert "tracking ..." in (out / "a" / "log.txt").read_text()


def test_another_sensor_or_analysis_tracks_nothing_again(run, manifest, tmp_path):
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    run(manifest, out)
    (tmp_path / "a" / "wheel.csv").write_text("time_s,angle_rad\n" + "".join(f"{k / 200},{k}\n" for k in range(15)))
    assert run(manifest, out).made == ("a",)
    log = (out / "a" / "log.txt").read_text()
    assert "tracked already" in log
    assert "tracking" not in log
    assert [c.samples for c in outcome_of(out, "a").clocks] == [15]
    run(manifest, fresh)
    tables = [files(folder / "a" / "tables") for folder in (out, fresh)]
    assert tables[0] == tables[1]
    with McapRecords(out / "a" / "session.mcap") as records:
        clocks = [record.name for record in records.metadata if record.name.startswith("spheremcap/clock/wheel")]
        assert len(clocks) == 1  # that of the first run is gone
        assert sum(1 for _ in records.messages({"/sensors/wheel"})) == 15


def test_a_sensor_that_cannot_be_merged_is_left_out_and_named(run, manifest, tmp_path):
    (tmp_path / "a" / "strange.csv").write_text("foo,bar\n1,2\n3,4\n")
    manifest.write_text(manifest.read_text().replace('"a/wheel.csv"', '["a/wheel.csv", "a/strange.csv", "a/no.csv"]'))
    out = tmp_path / "out"
    done = run(manifest, out)
    assert not done.complete
    told = outcome_of(out, "a")
    assert told.status == "lost"
    assert len(told.lost) == 2
    assert any("sensor strange is left out" in line for line in told.lost)
    assert any("no.csv" in line for line in told.lost)
    assert [c.sensor for c in told.clocks] == ["wheel"]
    assert outcome_of(out, "b").status == "done"


def test_every_way_to_fail_has_its_reason_and_costs_one_session(run, tmp_path):
    whole = write_session(tmp_path / "whole")
    cut = write_session(tmp_path / "cut")
    video = tmp_path / "cut" / "v.mp4"
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 3])
    wrong = write_session(tmp_path / "wrong")
    (tmp_path / "wrong" / "settings.toml").write_text("[camera]\nprest = 'x'\n")
    out = tmp_path / "out"
    manifest = write_manifest(
        tmp_path,
        {
            "whole": whole,
            "cut": cut,
            "wrong": wrong,
            "none": write_session(tmp_path / "none", seeds=False),
            "gone": {"video": "gone.mp4"},
            "small": write_session(tmp_path / "small") | {"memory_gb": 0.1},
            "slow": write_session(tmp_path / "slow", LONG) | {"timeout_h": 1 / 3600},
        },
    )
    done = run(manifest, out)
    assert not done.complete
    assert not done.stopped
    reasons = {name: outcome.reason for name, outcome in done.outcomes.items() if outcome.status == "failed"}
    assert set(reasons) == {"cut", "wrong", "none", "gone", "small", "slow"}
    for name, said in {
        "cut": "v.mp4", "wrong": "prest", "none": "no seeds", "gone": "gone.mp4", "small": "out of memory",
        "slow": "hours",
    }.items():  # fmt: skip
        assert said in reasons[name]
    assert outcome_of(out, "whole").status == "done"
    assert run(manifest, out).made == tuple(sorted(reasons))  # what failed is tried again


def start(manifest: Path, out: Path, *more: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "spheremcap", "dataset", "run", str(manifest), "-o", str(out), *more]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ctrl_c(process: subprocess.Popen[str], session: int) -> None:
    process.send_signal(signal.SIGINT)


def all_at_once(process: subprocess.Popen[str], session: int) -> None:
    """As SLURM's scancel does it."""
    worker = int(Path(f"/proc/{session}/stat").read_text().rpartition(")")[2].split()[1])
    assert worker != process.pid
    for pid in (worker, session, process.pid):
        os.kill(pid, signal.SIGTERM)


@pytest.mark.parametrize(
    "end", [ctrl_c, pytest.param(all_at_once, marks=pytest.mark.skipif(not Path("/proc").is_dir(), reason="no /proc"))]
)
def test_what_is_in_work_is_ended_and_the_same_command_goes_on(tmp_path, end):
    out = tmp_path / "out"
    said = {name: write_session(tmp_path / name, LONG) for name in ("one", "two")}
    manifest = write_manifest(tmp_path, said | {"short": write_session(tmp_path / "short")})
    process = start(manifest, out, "--workers", "1")
    pid = in_work(out, "one")
    end(process, pid)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "the same command goes on" in stderr
    assert "Traceback" not in stderr
    assert "3 not run" in stdout
    assert gone(pid)
    assert [path.name for path in out.iterdir() if path.name.startswith(".stop")] == []
    assert {path.name for path in (out / "one").iterdir()} == {"log.txt"}
    assert dataset("run", manifest, "-o", out).returncode == 0


def test_a_session_that_another_run_is_at_work_on_is_left_to_it(run, manifest, tmp_path):
    out = tmp_path / "out"
    (out / "a").mkdir(parents=True)
    write_season(out, load_season(manifest))
    with alone(out / "a"):
        done = run(manifest, out)
    assert (done.left, done.made) == (("a",), ("b",))
    assert not done.complete
    assert list((out / "a").iterdir()) == []
    assert run(manifest, out).complete


def test_results_are_never_put_into_a_folder_of_something_else(run, manifest, tmp_path):
    with pytest.raises(UsageError, match="no season was run into it"):
        run(manifest, tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="is a file"):
        run(manifest, tmp_path / "file")


def test_shards_have_every_session_once_whether_they_count_from_0_or_1(manifest):
    plans = load_season(manifest).plans * 5
    for numbers in (range(3), range(1, 4)):
        shares = [shard(plans, f"{i}/3") for i in numbers]
        assert sorted(plan.name for share in shares for plan in share) == sorted(plan.name for plan in plans)
        assert max(map(len, shares)) - min(map(len, shares)) <= 1
    for wrong in ("3", "4/3", "1/0", "-1/3", "a/b", "1/3/5"):
        with pytest.raises(UsageError, match="--shard"):
            shard(plans, wrong)


def test_chapters_are_one_session(run, tmp_path):
    said = write_session(tmp_path / "a")
    (tmp_path / "a" / "v.mp4").rename(tmp_path / "a" / "GOPR0001.MP4")
    (tmp_path / "a" / "GP010001.MP4").write_bytes((tmp_path / "a" / "GOPR0001.MP4").read_bytes())
    (tmp_path / "a" / "v.seeds.toml").rename(tmp_path / "a" / "GOPR0001.seeds.toml")
    manifest = write_manifest(tmp_path, {"a": said | {"video": ["a/GOPR0001.MP4", "a/GP010001.MP4"]}})
    out = tmp_path / "out"
    done = run(manifest, out)
    assert done.outcomes["a"].frames == 32, done.outcomes["a"]


def test_inputs_may_lie_behind_addresses(run, manifest, tmp_path):
    pytest.importorskip("fsspec")
    text = manifest.read_text()
    for name in ("a/v.mp4", "a/wheel.csv"):
        text = text.replace(f'"{name}"', f'"file://{tmp_path}/{name}"')
    manifest.write_text(text.replace('subject = "anna"', 'subject = "anna"\nseeds = "a/v.seeds.toml"'))
    out, plain = tmp_path / "out", tmp_path / "plain"
    done = run(manifest, out)
    assert done.complete, done
    assert run(manifest, out).made == ()
    (tmp_path / "a" / "wheel.csv").write_text("time_s,angle_rad\n0,0\n0.01,1\n0.02,2\n")
    assert run(manifest, out).made == ("a",)
    assert "tracking" not in (out / "a" / "log.txt").read_text()
    assert not (out / "a" / ".work").exists()
    manifest.write_text(
        text.replace("file://", "").replace('subject = "anna"', 'subject = "anna"\nseeds = "a/v.seeds.toml"')
    )
    run(manifest, plain)
    assert files(out / "a" / "tables") == files(plain / "a" / "tables")
    (tmp_path / "a" / "v.mp4").unlink()
    manifest.write_text(text.replace('"b/v.mp4"', f'"nonsense://{tmp_path}/b/v.mp4"'))
    failed = run(manifest, tmp_path / "other").outcomes
    assert "nothing is there" in failed["a"].reason
    assert "nonsense" in failed["b"].reason


def test_a_sensor_whose_clock_cannot_be_found_is_left_out_and_named(run, manifest, tmp_path):
    manifest.write_text(manifest.read_text() + '\n[defaults]\nmerge.wheel.sync = "orange"\n')
    done = run(manifest, tmp_path / "out")
    told = done.outcomes["a"]
    assert told.status == "lost"
    assert told.clocks == ()
    assert told.lost[0].startswith("sensor wheel is left out: wheel: ")
    manifest.write_text(manifest.read_text().replace('sync = "orange"', 'sync = ""'))
    assert run(manifest, tmp_path / "unsaid").complete
    with McapRecords(tmp_path / "out" / "a" / "session.mcap") as records:
        assert "/sensors/wheel" not in {channel.topic for channel in records.channels.values()}


def test_a_sensor_that_comes_or_goes_is_another_result(run, manifest, tmp_path):
    out, text = tmp_path / "out", manifest.read_text()
    assert run(manifest, out).complete
    manifest.write_text(text.replace('"a/wheel.csv"', '["a/wheel.csv", "a/no.csv"]'))
    told = run(manifest, out).outcomes["a"]
    assert told.status == "lost"
    assert "no.csv" in told.lost[0]
    manifest.write_text(text)
    assert run(manifest, out).complete
    season = load_season(manifest)
    (tmp_path / "a" / "wheel.csv").unlink()  # after the manifest was read
    with here(1) as submit:
        gone = run_season(season, season.plans, out, submit).outcomes["a"]
    assert gone.lost == (f"sensor wheel is left out: {tmp_path / 'a' / 'wheel.csv'} is not there",)


def test_a_session_called_as_its_recording_takes_an_answer(run, tmp_path):
    write_recording(tmp_path / "log.mcap", ["/front/image"])
    write_seeds(tmp_path / "log.seeds.toml")
    manifest, out = write_manifest(tmp_path, {"log": {"video": "log.mcap", "analyse": False}}), tmp_path / "out"
    assert run(manifest, out).complete
    write_seeds(tmp_path / "log.seeds.toml", seed("orange"), seed("blue", 1), seed("orange", 0, 8))
    assert run(manifest, out).complete
    assert "tracking again ..." in (out / "log" / "log.txt").read_text()


def test_what_somebody_deleted_is_made_again(run, manifest, tmp_path):
    out = tmp_path / "out"
    run(manifest, out)
    (out / "a" / "session.mcap").unlink()
    assert run(manifest, out).made == ("a",)
    assert (out / "a" / "session.mcap").is_file()


def test_jobs_that_begin_at_the_same_time_do_not_refuse_each_other(run, manifest, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / ".season.json.0123.part").write_text("{")  # what another is just writing
    assert run(manifest, out).complete


def test_a_session_is_stopped_as_soon_as_it_was_asked_for(tmp_path):
    said = write_session(tmp_path / "a", LONG)
    (plan,) = load_season(write_manifest(tmp_path, {"a": said})).plans
    worker = Worker()
    try:
        since = time.monotonic()
        ended = worker.run(plan, tmp_path / "out" / "a", lambda: True)  # while it is loading still
        assert ended.code == STOPPED
        assert time.monotonic() - since < 25
    finally:
        worker.close()
