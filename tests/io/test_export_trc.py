"""TRC, read as strictly as OpenSim reads it, and by pandas: header, times, cells in mm and blank ones."""

import numpy as np
import pandas
import pytest
from session_data import NAMES, START_NS, stamp, write_session, xyz_m

from spheremcap.core.estimate import Status
from spheremcap.errors import UsageError
from spheremcap.io.export import export_recording
from spheremcap.io.selection import Selection

COUNT = 48
RATE_HZ = 240_000 / 1001
KEYS = [
    "DataRate",
    "CameraRate",
    "NumFrames",
    "NumMarkers",
    "Units",
    "OrigDataRate",
    "OrigDataStartFrame",
    "OrigNumFrames",
]


def tokens(line):
    """As OpenSim splits a line: at each tab, and what follows the last one counts only where there is something."""
    cells = line.split("\t")
    return cells if cells[-1] else cells[:-1]


def strictly(path):
    """(header values, marker names, times (N,), xyz in mm (N, M, 3)) by the rules of OpenSim's reader for TRC."""
    lines = path.read_text(encoding="utf-8").split("\n")
    assert lines[0].split()[0] == "PathFileType"
    keys, values = (list(filter(None, tokens(line))) for line in lines[1:3])
    assert keys == KEYS
    assert len(values) == len(keys)
    header = dict(zip(keys, values, strict=True))
    frame, time, *names = filter(None, tokens(lines[3]))
    assert (frame, time, len(names)) == ("Frame#", "Time", int(header["NumMarkers"]))
    assert list(filter(None, tokens(lines[4]))) == [f"{a}{k + 1}" for k in range(len(names)) for a in "XYZ"]
    rows = iter(lines[5:])
    while not (row := tokens(next(rows))) or not row[0]:
        pass
    times, cells = [], []
    while row:  # an empty line ends the data
        assert len(row) == 3 * len(names) + 2
        times.append(float(row[1]))
        cells.append([float(cell) if cell else np.nan for cell in row[2:]])
        assert row[0] == str(len(times))
        row = tokens(next(rows))
    assert len(times) == int(header["NumFrames"]) == int(header["OrigNumFrames"])
    assert (np.diff(times) > 0).all()
    return header, names, np.array(times), np.array(cells).reshape(len(times), -1, 3)


def test_the_header_is_opensims_and_cells_are_blank_where_nothing_was_measured(tmp_path):
    gaps = {
        "left_wrist": {10: Status.ESTIMATED, 11: Status.LOST, 30: Status.ESTIMATED},
        "right_wrist": {5: Status.ESTIMATED, 30: Status.OUT_OF_VIEW},  # 30: a whole row is blank
    }
    recording = write_session(tmp_path / "r.mcap", range(COUNT), gaps)
    done = export_recording(recording, tmp_path / "out.trc")
    assert done.rows == COUNT
    assert done.notes == (
        "left_wrist: 3 of 48 frames are blank, the longest gap has 2 frames (8.3 ms)",
        "right_wrist: 2 of 48 frames are blank, the longest gap has 1 frames (4.2 ms)",
    )
    header, names, times, xyz_mm = strictly(tmp_path / "out.trc")
    assert (names, header["Units"], float(header["DataRate"])) == (list(NAMES), "mm", pytest.approx(RATE_HZ, abs=1e-6))
    np.testing.assert_allclose(times, np.arange(COUNT) / RATE_HZ, atol=5.1e-7)
    for k, name in enumerate(NAMES):
        for index in range(COUNT):
            if index in gaps[name]:
                assert np.isnan(xyz_mm[index, k]).all()
            else:
                np.testing.assert_allclose(xyz_mm[index, k], 1000 * xyz_m(name, index), atol=6e-5)
    table = pandas.read_csv(tmp_path / "out.trc", sep="\t", skiprows=5, header=None, skip_blank_lines=True)
    np.testing.assert_array_equal(table.iloc[:, 2:8].to_numpy(float), xyz_mm.reshape(COUNT, -1))
    assert (tmp_path / "out.trc").read_text().startswith("PathFileType\t4\t(X/Y/Z)\tout.trc\n")


def test_times_are_the_stamps_own_and_missing_frames_have_blank_rows(tmp_path):
    there = [k for k in range(COUNT) if k not in (20, 21)]
    recording = write_session(tmp_path / "r.mcap", there, stamps={7: stamp(7) + 1_500_000})
    done = export_recording(recording, tmp_path / "out.trc")
    _, _, times, xyz_mm = strictly(tmp_path / "out.trc")
    assert times[7] == pytest.approx((stamp(7) + 1_500_000 - START_NS) / 1e9, abs=5.1e-7)
    np.testing.assert_allclose(times[[20, 21]], np.array([20, 21]) / RATE_HZ, atol=1e-4)
    assert np.isnan(xyz_mm[[20, 21]]).all()
    assert np.isfinite(xyz_mm[there]).all()
    assert any("2 frames are missing" in note for note in done.notes)


def test_what_is_filled_could_not_be_marked_so_nothing_is(tmp_path):
    recording = write_session(tmp_path / "r.mcap", range(COUNT))
    with pytest.raises(UsageError, match="cannot mark"):
        export_recording(recording, tmp_path / "out.trc", fill_ms=20)
    for ending in ("csv", "parquet"):
        with pytest.raises(UsageError, match="smoothed positions in columns"):
            export_recording(recording, tmp_path / f"out.{ending}", fill_ms=20)
    assert not list(tmp_path.glob("out*"))


def test_markers_and_times_are_chosen_as_for_tables(tmp_path):
    recording = write_session(tmp_path / "r.mcap", range(COUNT))
    chosen = Selection(("right_wrist",), round(10.5 * 1e9 / RATE_HZ), round(20.5 * 1e9 / RATE_HZ))
    assert export_recording(recording, tmp_path / "out.trc", wanted=chosen).notes == ()
    _, names, times, xyz_mm = strictly(tmp_path / "out.trc")
    assert (names, times[0], xyz_mm.shape) == (["right_wrist"], 0, (10, 1, 3))
    np.testing.assert_allclose(xyz_mm[0, 0], 1000 * xyz_m("right_wrist", 11), atol=6e-5)
