"""A season's tables: what the recordings have, hive partitions that others read, whole or as before, the same bytes."""

import json
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pyarrow.dataset
import pyarrow.parquet
import pytest
from made_up import START_NS, asked, clock, many, marker, outcome, season, write_season_of, write_session

sys.path.insert(0, str(Path(__file__).parents[1] / "io"))

from recording_data import CAMERA, MARKERS, result
from session_data import event, stamp
from session_data import write_session as write_recording

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.stroke import EventKind, Stroke
from spheremcap.errors import OutputError, SourceError, UsageError
from spheremcap.io import _pb
from spheremcap.io.export import export_recording
from spheremcap.io.mcap_log import McapLog
from spheremcap.season import tables
from spheremcap.season.outcome import RECORDING, RUN, TABLES, read_outcome, write_outcome, write_season
from spheremcap.season.tables import season_tables, write_session_tables

COUNT = 20
KINDS = ("poses", "strokes", "events", "quality", "clocks")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="module")
def analysed(folder):
    """Two markers on 20 frames, a stroke and two events."""
    strokes = [
        Stroke(stamp(5), "left", "left_wrist", 0, push_s=0.2, pattern="arc", measured=0.9, missing="cycle: none"),
        event(EventKind.CONTACT, stamp(5)), event(EventKind.RELEASE, stamp(9.25)),
    ]  # fmt: skip
    return write_recording(folder / "analysed.mcap", range(COUNT), strokes=strokes)


@pytest.fixture(scope="module")
def tracked(folder):
    """What was tracked only: all statuses, votes, nobody has looked for strokes."""
    path = folder / "tracked.mcap"
    with McapLog(path, camera=CAMERA, markers=MARKERS) as log:
        for index in range(COUNT):
            got = result(index)
            log.write(replace(got, estimates=tuple(map(_told_apart, got.estimates))), None)
    return path


def _told_apart(estimate):
    """What is not measured has another radius and other votes."""
    if estimate.status is not Status.ESTIMATED:
        return estimate
    return replace(estimate, circle=Circle(60, 50, 30), vote_sum=1.0)


def made(out, output, **more):
    given = {"overwrite": False, "progress": lambda done, total: None, "stop": lambda: False}
    return season_tables(out, output, **(given | more))


def read(path):
    return pyarrow.parquet.read_table(path).to_pylist()


def files(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def names(folder):
    return sorted(path.name for path in folder.iterdir())


# --- one session ---


def test_poses_are_those_that_export_writes(tracked, tmp_path):
    assert write_session_tables(tracked, tmp_path, outcome("a")) is None
    export_recording(tracked, tmp_path / "t.parquet")
    got, exported = (pyarrow.parquet.read_table(tmp_path / f"{name}.parquet") for name in ("poses", "t"))
    assert got.equals(exported)
    assert got.schema.equals(exported.schema, check_metadata=True)
    assert len(got) == 2 * COUNT
    assert names(tmp_path) == ["clocks.parquet", "poses.parquet", "quality.parquet", "t.parquet"]


def test_strokes_and_events_are_there_where_somebody_looked(analysed, tmp_path):
    write_session_tables(analysed, tmp_path, outcome("a"))
    (stroke,) = read(tmp_path / "strokes.parquet")
    assert (stroke["stamp_ns"], stroke["side"], stroke["push_s"], stroke["cycle_s"]) == (stamp(5), "left", 0.2, None)
    assert [row["kind"] for row in read(tmp_path / "events.parquet")] == ["CONTACT", "RELEASE"]


def test_where_nothing_was_found_there_are_no_rows_and_all_columns(analysed, tmp_path):
    nothing = [("/analysis/left/events", stamp(3), _pb.ArmSample())]  # a topic of the analysis that has no stroke
    bare = write_recording(tmp_path / "bare.mcap", range(3), analysed=nothing)
    none = write_recording(tmp_path / "none.mcap", ())
    looked = tmp_path / "looked.mcap"
    with_topic = [event(EventKind.CONTACT, stamp(1))]
    write_recording(looked, range(3), strokes=with_topic)
    for name, path in {"bare": bare, "none": none, "looked": looked, "full": analysed}.items():
        (tmp_path / name).mkdir()
        write_session_tables(path, tmp_path / name, outcome("a", clocks=(), markers=()))
    full = {path.stem: pyarrow.parquet.read_schema(path) for path in (tmp_path / "full").iterdir()}
    assert sorted(full) == sorted(KINDS)
    assert names(tmp_path / "bare") == ["clocks.parquet", "poses.parquet", "quality.parquet"]
    for path in [*(tmp_path / "none").iterdir(), *(tmp_path / "looked").iterdir()]:
        assert pyarrow.parquet.read_schema(path).equals(full[path.stem], check_metadata=True), path
    assert read(tmp_path / "none" / "poses.parquet") == []
    assert read(tmp_path / "looked" / "strokes.parquet") == []
    assert len(read(tmp_path / "looked" / "events.parquet")) == 1


def test_quality_is_a_row_a_marker(tracked, tmp_path):
    markers = (marker("left_wrist", 750, gap_s=0.5), marker("left_elbow", 0, 0), marker("nobody", 1, 4))
    requests = (asked("left_wrist", 3), asked("left_wrist", 9), asked("left_wrist", 20, "circle at 20"))
    write_session_tables(tracked, tmp_path, outcome("a", markers=markers, requests=requests))
    wrist, elbow, nobody = read(tmp_path / "quality.parquet")
    assert (wrist["marker"], wrist["frames"], wrist["measured"]) == ("left_wrist", 1000, 0.75)
    assert (wrist["verified_frames"], wrist["lost_frames"], wrist["out_of_view_frames"]) == (750, 250, 0)
    assert (wrist["longest_gap_frames"], wrist["longest_gap_s"]) == (120, 0.5)
    assert (wrist["open_requests"], wrist["answered_requests"]) == (2, 1)
    rows = [r for r in read(tmp_path / "poses.parquet") if r["marker"] == "left_wrist"]
    seen = [r for r in rows if r["status"] in ("SEEDED", "VERIFIED")]
    assert len(seen) < len([r for r in rows if r["r_px"] is not None])  # an estimate's radius is not measured
    assert wrist["mean_r_px"] == pytest.approx(sum(r["r_px"] for r in seen) / len(seen))
    assert wrist["mean_vote_sum"] == pytest.approx(sum(r["vote_sum"] for r in seen) / len(seen))
    assert (elbow["measured"], nobody["mean_r_px"], nobody["mean_vote_sum"]) == (None, None, None)


def test_clocks_are_a_row_a_sensor(tracked, tmp_path):
    write_session_tables(tracked, tmp_path, outcome("a", clocks=(clock("wheel", 0.4), clock("imu"))))
    wheel, imu = read(tmp_path / "clocks.parquet")
    assert wheel == {
        "sensor": "wheel", "samples": 900, "first_ns": START_NS, "last_ns": START_NS + 10**9, "added": "+5 ms",
        "residual_ms": 0.4, "error_ms": 0.08, "windows": "11 of 12", "drift_ppm": 12.5,
    }  # fmt: skip
    assert (imu["sensor"], imu["residual_ms"], imu["error_ms"], imu["windows"]) == ("imu", None, None, None)


def test_columns_have_units(analysed, tmp_path):
    write_session_tables(analysed, tmp_path, outcome("a"))
    units = {}
    for path in tmp_path.iterdir():
        units |= {
            f.name: (f.metadata or {}).get(b"unit", b"").decode() for f in pyarrow.parquet.read_schema(path)
        }  # fmt: skip
    for name, unit in {
        "x_px": "px", "z_cam_m": "m", "stamp_ns": "ns", "push_s": "s", "sd_ms": "ms", "longest_gap_s": "s",
        "mean_r_px": "px", "mean_vote_sum": "of 6", "measured": "of 1", "residual_ms": "ms", "drift_ppm": "ppm",
        "frames": "", "added": "",
    }.items():  # fmt: skip
        assert units[name] == unit, name


def test_rows_are_packed_together_and_are_the_same_however_many(tracked, tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "iter_columns", lambda records: _in_parts(records, 7))
    for rows in (10, 65_536):
        monkeypatch.setattr(tables, "_ROWS", rows)
        (tmp_path / str(rows)).mkdir()
        write_session_tables(tracked, tmp_path / str(rows), outcome("a"))
    few, all_ = (pyarrow.parquet.ParquetFile(tmp_path / rows / "poses.parquet") for rows in ("10", "65536"))
    assert [few.metadata.row_group(k).num_rows for k in range(few.num_row_groups)] == [14, 14, 12]
    assert all_.num_row_groups == 1
    assert few.read().equals(all_.read())
    assert all_.metadata.row_group(0).column(4).compression == "ZSTD"


def _in_parts(records, rows):
    from spheremcap.io.recording import iter_columns

    return iter_columns(records, rows)


def test_what_of_a_recording_could_not_be_read_is_said(tracked, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(tracked.read_bytes()[:-100])
    assert "cut.mcap is damaged" in write_session_tables(cut, tmp_path, outcome("a"))
    assert len(read(tmp_path / "poses.parquet")) == 2 * COUNT


# --- all sessions ---


@pytest.fixture
def out(analysed, tracked, tmp_path):
    """A season in which everything can be."""
    outcomes = {
        "b_run": outcome("b_run", requests=(asked("left_wrist", 3), asked("left_wrist", 9, "keep"))),
        "a_run": outcome("a_run", "lost", lost=("left_wrist was lost", "12 frames"), strokes={}, clocks=()),
        "failed": outcome("failed", "failed", reason="/data/x.mp4: not a video"),
        "waiting": None,
        "007": outcome("007", markers=(), start_ns=None, clocks=(clock("imu"), clock("hub", 0.2), clock("rim", 0.9))),
    }
    return write_season_of(tmp_path / "out", outcomes, analysed, {"a_run": tracked})


def hive(output, table):
    part = pyarrow.dataset.partitioning(pyarrow.schema([("session", pyarrow.string())]), flavor="hive")
    return pyarrow.dataset.dataset(output / table, partitioning=part)


def test_all_sessions_are_one_data_set(out, tmp_path):
    report = made(out, tmp_path / "season")
    assert names(tmp_path / "season") == [
        "clocks", "events", "poses", "quality", "report.html", "sessions.parquet", "strokes",
    ]  # fmt: skip
    assert (report.sessions, report.notes, report.lost, report.stopped) == (5, [], [], False)
    assert dict(report.ended) == {"done": 2, "lost": 1, "failed": 1, "not run": 1}
    counts = {}
    for table in KINDS:
        column = hive(tmp_path / "season", table).to_table(columns=["session"])["session"].to_pylist()
        counts[table] = {name: column.count(name) for name in set(column)}
    assert counts["poses"] == {"b_run": 40, "a_run": 40, "007": 40}
    assert counts["strokes"] == {"b_run": 1, "007": 1}
    assert counts["events"] == {"b_run": 2, "007": 2}
    assert counts["quality"] == {"b_run": 2, "a_run": 2}
    assert counts["clocks"] == {"b_run": 1, "007": 3}
    assert names(tmp_path) == ["out", "season"]


def test_sessions_has_a_row_for_each_run_or_not(out, tmp_path):
    made(out, tmp_path / "season")
    table = pyarrow.parquet.read_table(tmp_path / "season" / "sessions.parquet")
    rows = {row["session"]: row for row in table.to_pylist()}
    assert table["session"].to_pylist() == ["007", "a_run", "b_run", "failed", "waiting"]
    assert [rows[n]["status"] for n in rows] == ["done", "lost", "done", "failed", "not run"]
    b = rows["b_run"]
    assert (b["subject"], b["frames"], b["start_ns"], b["duration_s"]) == ("S1", 1000, START_NS, 4.2)
    assert (b["measured"], b["markers"], b["lowest_marker"], b["lowest_measured"]) == (0.99, 2, "left_wrist", 0.99)
    assert (b["open_requests"], b["answered_requests"], b["longest_gap_s"]) == (1, 1, 0.1)
    assert (b["strokes_left"], b["strokes_right"], b["videos"], b["key"]) == (8, 7, "run.mp4", "key of b_run")
    assert (rows["a_run"]["lost"], rows["a_run"]["strokes_left"]) == ("left_wrist was lost; 12 frames", None)
    assert (rows["007"]["measured"], rows["007"]["start_ns"], rows["007"]["lowest_marker"]) == (None, None, None)
    assert (rows["007"]["sync_residual_ms"], rows["007"]["sync_error_ms"]) == (0.9, 0.18)
    assert rows["failed"]["reason"] == "/data/x.mp4: not a video"
    for name in ("failed", "waiting"):
        known = {"session", "status", "videos"} | (
            {"subject", "reason", "version", "key"} if name == "failed" else set()
        )
        assert {column for column, value in rows[name].items() if value is not None} == known
    units = {f.name: (f.metadata or {}).get(b"unit", b"").decode() for f in table.schema}
    assert [units[n] for n in ("duration_s", "measured", "lowest_measured", "start_ns")] == ["s", "of 1", "of 1", "ns"]


def test_why_a_session_cannot_be_run_is_said(analysed, tmp_path):
    out = write_season_of(tmp_path / "out", {}, analysed)
    said = season("a", "b")
    plan = said.plans[0].model_copy(update={"missing": ("no video: nothing matches a*.mp4",), "videos": ()})
    write_season(out, said.model_copy(update={"plans": (plan, said.plans[1])}))
    made(out, tmp_path / "season")
    a, b = read(tmp_path / "season" / "sessions.parquet")
    assert (a["status"], a["reason"], a["videos"]) == ("not run", "no video: nothing matches a*.mp4", None)
    assert (b["status"], b["reason"]) == ("not run", None)


def test_pandas_reads_it(out, tmp_path):
    pandas = pytest.importorskip("pandas")
    made(out, tmp_path / "season")
    poses = pandas.read_parquet(tmp_path / "season" / "poses")
    assert poses.groupby("session", observed=True).size().to_dict() == {"b_run": 40, "a_run": 40, "007": 40}


def test_duckdb_reads_it(out, tmp_path):
    duckdb = pytest.importorskip("duckdb")
    made(out, tmp_path / "season")
    counted = duckdb.sql(f"SELECT session, count(*) FROM '{tmp_path}/season/poses/*/*.parquet' GROUP BY 1").fetchall()
    assert dict(counted) == {"b_run": 40, "a_run": 40, "007": 40}


def test_polars_reads_it(out, tmp_path):
    polars = pytest.importorskip("polars")
    made(out, tmp_path / "season")
    counted = polars.scan_parquet(tmp_path / "season" / "poses").group_by("session").len().collect()
    assert dict(counted.iter_rows()) == {"b_run": 40, "a_run": 40, "007": 40}


def test_the_same_sessions_give_the_same_bytes_whenever_and_wherever(out, tmp_path):
    made(out, tmp_path / "season")
    first = files(tmp_path / "season")
    made(out, tmp_path / "again")
    assert files(tmp_path / "again") == first
    moved = tmp_path / "elsewhere" / "moved"
    shutil.copytree(out, moved)
    for path in moved.rglob("*"):
        os.utime(path, (1, 1))
    for name in ("a_run", "b_run"):
        told = json.loads((moved / name / RUN).read_text())
        (moved / name / RUN).write_text(json.dumps(told | {"seconds": {"tracking": 9.5}, "peak_mb": 77}))
    shutil.rmtree(moved / "a_run" / TABLES)
    shutil.rmtree(moved / "007" / TABLES)
    report = made(moved, tmp_path / "elsewhere" / "season")
    assert files(tmp_path / "elsewhere" / "season") == first  # also those that were made again
    assert report.notes == ["tables that were not there, or damaged, are made again: 007, a_run"]
    for content in first.values():
        assert str(tmp_path).encode() not in content


def test_a_sessions_files_are_not_copied_where_that_can_be(out, tmp_path, monkeypatch):
    made(out, tmp_path / "season")
    own, linked = out / "b_run" / TABLES / "poses.parquet", "poses/session=b_run/poses.parquet"
    assert own.samefile(tmp_path / "season" / linked)

    def refuse(*paths):
        raise PermissionError("no second names here")

    monkeypatch.setattr(tables.os, "link", refuse)
    made(out, tmp_path / "copied")
    assert not own.samefile(tmp_path / "copied" / linked)
    assert files(tmp_path / "copied") == files(tmp_path / "season")


@pytest.mark.parametrize("damage", ["folder", "file", "cut", "foreign", "columns", "strokes"])
def test_tables_that_are_not_there_or_damaged_are_made_again(out, tmp_path, damage):
    made(out, tmp_path / "whole")
    folder = out / "b_run" / TABLES
    poses = folder / "poses.parquet"
    if damage == "folder":
        shutil.rmtree(folder)
    elif damage == "file":
        (folder / "quality.parquet").unlink()
    elif damage == "strokes":
        (folder / "strokes.parquet").unlink()
    else:
        table, content = pyarrow.parquet.read_table(poses), poses.read_bytes()
        poses.unlink()  # and so the data set's stays
        if damage == "columns":  # as another version wrote them
            pyarrow.parquet.write_table(table.drop_columns(["visible"]), poses)
        else:
            poses.write_bytes(content[:-50] if damage == "cut" else b"no table at all")
    before = files(out)
    report = made(out, tmp_path / "season")
    assert report.notes == ["tables that were not there, or damaged, are made again: b_run"]
    assert report.lost == []
    assert files(tmp_path / "season") == files(tmp_path / "whole")
    assert files(out) == before


@pytest.mark.parametrize("what", [RECORDING, f"{TABLES}/poses.parquet"])
def test_a_file_of_another_size_than_was_made_is_noticed(out, tmp_path, what):
    folder = out / "b_run"
    told = read_outcome(folder)
    sizes = {name: (folder / name).stat().st_size for name in (RECORDING, f"{TABLES}/poses.parquet")}
    write_outcome(folder, told.model_copy(update={"files": sizes}))
    assert made(out, tmp_path / "before").notes == []
    write_outcome(folder, told.model_copy(update={"files": sizes | {what: 5}}))
    report = made(out, tmp_path / "season")
    if what == RECORDING:
        assert report.lost == ["b_run: its recording is not what it was: run it again"]
    else:
        assert report.made_again == ["b_run"]
    (folder / RECORDING).unlink()
    assert any("b_run" in line for line in made(out, tmp_path / "gone").lost)


def test_a_session_whose_tables_cannot_be_had_is_named(out, tmp_path):
    shutil.rmtree(out / "b_run" / TABLES)
    (out / "b_run" / RECORDING).write_bytes(b"no recording")
    report = made(out, tmp_path / "season")
    (line,) = report.lost
    assert line.startswith(f"b_run: {tables.NO_TABLES}: ")
    assert dict(report.ended) == {"done": 1, "lost": 2, "failed": 1, "not run": 1}
    row = read(tmp_path / "season" / "sessions.parquet")[2]
    assert (row["session"], row["status"], row["lost"]) == ("b_run", "lost", tables.NO_TABLES)
    assert tables.NO_TABLES in (tmp_path / "season" / "report.html").read_text()
    assert not list((tmp_path / "season").glob("*/session=b_run"))
    assert hive(tmp_path / "season", "poses").count_rows() == 80


def test_a_folder_that_is_there_is_not_replaced_unasked(out, tmp_path):
    output = tmp_path / "season"
    made(out, output)
    with pytest.raises(UsageError, match="exists already: name another folder or pass --overwrite"):
        made(out, output)
    write_session(out / "waiting", outcome("waiting", "failed", reason="no light"), Path())
    made(out, output, overwrite=True)
    assert [row["status"] for row in read(output / "sessions.parquet")].count("failed") == 2
    assert names(tmp_path) == ["out", "season"]


def test_a_folder_of_somebody_elses_is_never_replaced(out, tmp_path):
    theirs = tmp_path / "photos"
    theirs.mkdir()
    (theirs / "a.jpg").write_text("precious")
    with pytest.raises(UsageError, match="no folder of a season's tables"):
        made(out, theirs, overwrite=True)
    made(out, tmp_path / "season")
    (tmp_path / "season" / "thesis.docx").write_text("precious")
    with pytest.raises(UsageError, match=r"not replaced, for it has what is not of here: thesis\.docx"):
        made(out, tmp_path / "season", overwrite=True)
    (tmp_path / "note.txt").write_text("precious")
    with pytest.raises(UsageError, match="is a file"):
        made(out, tmp_path / "note.txt", overwrite=True)
    for inside in (out, out / "b_run", out / "b_run" / TABLES, out / "waiting", out / "waiting" / "x"):
        with pytest.raises(UsageError, match="the season was run into it"):
            made(out, inside, overwrite=True)
    assert (theirs / "a.jpg").read_text() == (tmp_path / "season" / "thesis.docx").read_text() == "precious"
    assert names(tmp_path) == ["note.txt", "out", "photos", "season"]


def test_it_may_lie_beside_the_sessions_and_behind_a_link(out, tmp_path):
    made(out, out / "all")
    (tmp_path / "link").symlink_to(out / "all")
    report = made(out, tmp_path / "link", overwrite=True)
    assert (tmp_path / "link").is_symlink()
    assert report.notes == []
    assert (out / "all" / "report.html").is_file()
    with pytest.raises(OutputError, match="there is no folder"):
        made(out, tmp_path / "nowhere" / "season")


def test_stopped_half_way_it_is_as_before(out, tmp_path):
    output = tmp_path / "season"
    made(out, output)
    before = files(output)
    write_session(out / "waiting", outcome("waiting", "failed", reason="no light"), Path())
    asked_for = []

    def progress(done, total):
        asked_for.append((done, total))

    report = made(out, output, overwrite=True, progress=progress, stop=lambda: len(asked_for) > 3)
    assert report.stopped
    assert asked_for == [(0, 5), (1, 5), (2, 5), (3, 5)]
    assert files(output) == before
    assert made(out, tmp_path / "new", stop=lambda: True).stopped
    assert names(tmp_path) == ["out", "season"]


@pytest.mark.parametrize("step", ["page", "rename"])
def test_when_it_cannot_be_written_it_is_as_before(out, tmp_path, monkeypatch, step):
    output = tmp_path / "season"
    made(out, output)
    before = files(output)

    def full(*given):
        raise OSError(28, "No space left on device")

    if step == "page":
        monkeypatch.setattr(tables, "page", full)
    else:
        rename, last = Path.rename, [full]  # the first that comes to its place does not
        monkeypatch.setattr(
            Path, "rename", lambda old, new: last.pop()() if new == output and last else rename(old, new)
        )
    with pytest.raises(OutputError, match="free some space"):
        made(out, output, overwrite=True)
    monkeypatch.undo()
    assert files(output) == before
    assert names(tmp_path) == ["out", "season"]


def test_what_there_is_besides_is_named(out, analysed, tmp_path):
    write_session(out / "old_run", outcome("old_run"), analysed)
    (out / "b_run" / RUN).write_text("{")
    (tmp_path / ".season.0123.part").mkdir()
    report = made(out, tmp_path / "season")
    assert report.notes == [
        "left out, for the season has them no more: old_run",
        f"{tmp_path}/.season.0123.part is what an interrupted run left: delete it",
        f"b_run: its {RUN} is damaged, or of another version: run it again",
    ]
    assert [row["status"] for row in read(tmp_path / "season" / "sessions.parquet")][2] == "not run"


def test_a_session_that_is_run_again_meanwhile_is_not_mixed(out, tmp_path):
    link = os.link

    def link_and_run(old, new):
        link(old, new)
        if "b_run" in str(new):
            write_outcome(out / "b_run", outcome("b_run", key="another"))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables.os, "link", link_and_run)
        with pytest.raises(SourceError, match="b_run: is being run again just now"):
            made(out, tmp_path / "season")
    assert names(tmp_path) == ["out"]


def test_a_folder_without_a_season_is_refused(tmp_path):
    with pytest.raises(SourceError, match="no season was run into it"):
        made(tmp_path, tmp_path / "season")


def test_without_pyarrow_it_is_one_line(out, tracked, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match=r"pip install 'spheremcap\[parquet\]'"):
        made(out, tmp_path / "season")
    with pytest.raises(UsageError, match=r"pip install 'spheremcap\[parquet\]'"):
        write_session_tables(tracked, tmp_path, outcome("a"))
    assert names(tmp_path) == ["out"]


def test_a_recording_without_the_strokes_that_were_told_is_named(out, tracked, tmp_path):
    shutil.rmtree(out / "b_run" / TABLES)
    shutil.copyfile(tracked, out / "b_run" / RECORDING)
    (line,) = made(out, tmp_path / "season").lost
    assert "has no strokes, and run.json says that it has" in line


def test_a_season_of_many_is_one_too(analysed, tmp_path):
    outcomes = many(60)
    assert made(write_season_of(tmp_path / "out", outcomes, analysed), tmp_path / "season").lost == []
    rows = read(tmp_path / "season" / "sessions.parquet")
    assert [row["session"] for row in rows] == sorted(outcomes)
    ended = [name for name, one in outcomes.items() if one is not None and one.status != "failed"]
    assert hive(tmp_path / "season", "poses").count_rows() == 2 * COUNT * len(ended)
