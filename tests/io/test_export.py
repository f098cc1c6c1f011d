"""Tables: the promised columns first, every digit, empty where there is no value, no half-written file."""

import csv
import sys

import pyarrow.parquet
import pytest
from mcap.writer import Writer
from recording_data import CAMERA, MARKERS, result, stamp
from session_data import event, write_session
from session_data import stamp as at_frame

from spheremcap.core.stroke import EventKind, Stroke
from spheremcap.errors import SourceError, UsageError
from spheremcap.io import recording
from spheremcap.io.export import export_recording
from spheremcap.io.mcap_log import McapLog
from spheremcap.io.selection import Selection
from spheremcap.io.topics import Topics

COUNT = 30
FIRST = "marker,frame,stamp_ns,status,x_px,y_px,r_px,x_cam_m,y_cam_m,z_cam_m,vote_sum"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "r.mcap"
    with McapLog(path, camera=CAMERA, markers=MARKERS) as log:
        for index in range(COUNT):
            log.write(result(index), None)
    return path


def test_csv_has_the_columns_every_digit_and_gaps(recorded, tmp_path):
    out = tmp_path / "t.csv"
    assert export_recording(recorded, out).rows == 2 * COUNT
    assert out.read_text().startswith(FIRST + ",")
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    estimates = [e for index in range(COUNT) for e in result(index).estimates]
    for row, e in zip(rows, estimates, strict=True):
        assert (row["marker"], row["status"], int(row["stamp_ns"])) == (e.marker, e.status.value, e.stamp_ns)
        assert row["x_px"] == ("" if e.circle is None else repr(e.circle.x_px))
        assert row["z_cam_m"] == ("" if e.xyz_cam_m is None else repr(float(e.xyz_cam_m[2])))
        assert row["vote_sum"] == ("" if e.vote_sum is None else repr(e.vote_sum))
        assert row["verdict"] == (e.verdict.value if e.verdict else "")
        assert row["reasons"] == ";".join(e.reasons)


def test_parquet_says_the_same_with_nulls(recorded, tmp_path):
    export_recording(recorded, tmp_path / "t.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    assert ",".join(table.column_names).startswith(FIRST)
    row = table.filter(pyarrow.compute.field("frame") == 4).to_pylist()[0]
    assert (row["status"], row["stamp_ns"], row["x_px"], row["verdict"]) == ("LOST", stamp(4), None, None)


def test_columns_are_those_of_a_track(recorded, tmp_path):
    export_recording(recorded, tmp_path / "t.parquet")
    columns = recording.open(recorded).tracks["left_wrist"].columns()
    table = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    assert table.column_names == list(columns)


def test_no_pyarrow_is_told_with_what_to_install(recorded, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match="pip install"):
        export_recording(recorded, tmp_path / "t.parquet")
    assert list(tmp_path.iterdir()) == []


def test_no_pandas_is_told_with_what_to_install(recorded, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match="pip install pandas"):
        recording.open(recorded).tracks["left_wrist"].to_pandas()


def test_bad_requests_leave_nothing_behind(recorded, tmp_path):
    with pytest.raises(UsageError, match=r"\.csv, \.parquet, \.c3d, \.trc"):
        export_recording(recorded, tmp_path / "t.xlsx")
    other = tmp_path / "other.mcap"
    writer = Writer(str(other))
    writer.start()
    writer.add_message(writer.register_channel("/json", "json", 0), 9, b"{}", 9)
    writer.finish()
    with pytest.raises(SourceError, match="/json"):
        export_recording(other, tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("precious")
    with pytest.raises(UsageError, match="exists"):
        export_recording(recorded, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other.mcap", "t.csv"]


def test_a_cut_recording_exports_what_there_is_and_says_so(recorded, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.read_bytes()[:-100])
    done = export_recording(cut, tmp_path / "t.csv")
    assert done.rows == 2 * COUNT
    assert done.damage is not None


STROKE = Stroke(
    at_frame(5), "left", "left_wrist", 2, push_s=0.21, push_sd_s=0.002, frequency_hz=1.75, push_deg=181.5,
    wheel_rad_s=-12.5, pattern="arc", measured=0.875, missing="recovery: left_wrist is lost from frame 90",
)  # fmt: skip


@pytest.fixture
def analysed(tmp_path):
    strokes = [STROKE, event(EventKind.CONTACT, at_frame(5)), event(EventKind.RELEASE, at_frame(7.25), "right")]
    return write_session(tmp_path / "analysed.mcap", range(20), strokes=strokes)


def test_cycles_and_events_are_tables_too_with_nothing_where_there_is_no_value(analysed, tmp_path):
    assert export_recording(analysed, tmp_path / "c.csv", table="cycles").rows == 1
    with (tmp_path / "c.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (int(row["stamp_ns"]), row["stroke"], row["push_s"], row["cycle_s"]) == (at_frame(5), "2", "0.21", "")
    assert (row["pattern"], row["missing"]) == (STROKE.pattern, STROKE.missing)
    assert export_recording(analysed, tmp_path / "e.parquet", table="events").rows == 2
    rows = pyarrow.parquet.read_table(tmp_path / "e.parquet").to_pylist()
    assert [(r["side"], r["kind"], r["stamp_ns"]) for r in rows] == [
        ("left", "CONTACT", at_frame(5)), ("right", "RELEASE", at_frame(7.25)),
    ]  # fmt: skip
    assert (rows[0]["angle_deg"], rows[0]["angle_sd_deg"]) == (30, None)
    chosen = Selection(("left_wrist",), 0, 10**9)
    assert export_recording(analysed, tmp_path / "left.csv", table="events", wanted=chosen).rows == 1
    with pytest.raises(UsageError, match="there are: left_wrist, right_wrist"):
        export_recording(analysed, tmp_path / "n.csv", table="events", wanted=Selection(("nose",)))


def test_their_columns_have_units_too(analysed, tmp_path):
    export_recording(analysed, tmp_path / "c.parquet", table="cycles")
    schema = pyarrow.parquet.read_schema(tmp_path / "c.parquet")
    units = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in schema}
    named = ("push_s", "frequency_sd_hz", "push_deg", "contact_mps", "wheel_rad_s", "measured", "stroke", "pattern")
    assert [units[name] for name in named] == ["s", "Hz", "deg", "m/s", "rad/s", "of 1", "", ""]
    export_recording(analysed, tmp_path / "e.csv", table="events", excel=True)
    assert "sd_ms [ms];angle_deg [deg]" in (tmp_path / "e.csv").read_text("utf-8-sig")


def test_a_recording_without_strokes_says_what_to_run_first(recorded, tmp_path):
    for table in ("cycles", "events"):
        with pytest.raises(SourceError, match="run `spheremcap analyse`"):
            export_recording(recorded, tmp_path / "t.csv", table=table)
    with pytest.raises(UsageError, match="there are poses, cycles, events"):
        export_recording(recorded, tmp_path / "t.csv", table="strokes")
    assert list(tmp_path.iterdir()) == []


def test_two_cameras_positions_do_not_go_into_one_file_of_points(recorded, tmp_path):
    both = tmp_path / "both.mcap"
    with both.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for side in ("/left", "/right"):
            log = McapLog(writer, camera=CAMERA, markers=MARKERS, topics=Topics(side, side))
            with log:
                for index in range(COUNT):
                    log.write(result(index), None)
        writer.finish()
    for name in ("p.c3d", "p.trc"):
        with pytest.raises(UsageError, match=r"2 cameras.*left/left_elbow"):
            export_recording(both, tmp_path / name)
        one = Selection(("left/left_elbow",))
        assert export_recording(both, tmp_path / name, wanted=one).rows == COUNT
    assert "\tleft_elbow\t" in (tmp_path / "p.trc").read_text()
