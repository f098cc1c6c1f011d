"""Tables: the promised columns first, every digit, empty where there is no value, no half-written file."""

import csv
import sys

import pyarrow.parquet
import pytest
from mcap.writer import Writer
from recording_data import CAMERA, MARKERS, result, stamp

from spheremcap.errors import SourceError, UsageError
from spheremcap.io import recording
from spheremcap.io.export import export_tracks
from spheremcap.io.mcap_log import McapLog

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
    assert export_tracks(recorded, out).rows == 2 * COUNT
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
    export_tracks(recorded, tmp_path / "t.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    assert ",".join(table.column_names).startswith(FIRST)
    row = table.filter(pyarrow.compute.field("frame") == 4).to_pylist()[0]
    assert (row["status"], row["stamp_ns"], row["x_px"], row["verdict"]) == ("LOST", stamp(4), None, None)


def test_columns_are_those_of_a_track(recorded, tmp_path):
    export_tracks(recorded, tmp_path / "t.parquet")
    columns = recording.open(recorded).tracks["left_wrist"].columns()
    table = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    assert table.column_names == list(columns)


def test_no_pyarrow_is_told_with_what_to_install(recorded, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match="pip install"):
        export_tracks(recorded, tmp_path / "t.parquet")
    assert list(tmp_path.iterdir()) == []


def test_no_pandas_is_told_with_what_to_install(recorded, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match="pip install pandas"):
        recording.open(recorded).tracks["left_wrist"].to_pandas()


def test_bad_requests_leave_nothing_behind(recorded, tmp_path):
    with pytest.raises(UsageError, match=r"\.csv or \.parquet"):
        export_tracks(recorded, tmp_path / "t.xlsx")
    other = tmp_path / "other.mcap"
    writer = Writer(str(other))
    writer.start()
    writer.add_message(writer.register_channel("/json", "json", 0), 9, b"{}", 9)
    writer.finish()
    with pytest.raises(SourceError, match="/json"):
        export_tracks(other, tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("precious")
    with pytest.raises(UsageError, match="exists"):
        export_tracks(recorded, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other.mcap", "t.csv"]


def test_a_cut_recording_exports_what_there_is_and_says_so(recorded, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.read_bytes()[:-100])
    done = export_tracks(cut, tmp_path / "t.csv")
    assert done.rows == 2 * COUNT
    assert done.damage is not None
