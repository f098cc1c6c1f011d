"""The example for Kinetics Toolkit, where that is installed, and the toolkit's own reading of our C3D."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from session_data import event, stamp, write_session, xyz_m

from spheremcap.core.estimate import Status
from spheremcap.core.stroke import EventKind
from spheremcap.io.export import export_recording

ktk = pytest.importorskip("kineticstoolkit", reason="pip install kineticstoolkit to run its example")

EXAMPLE = Path(__file__).parents[2] / "examples" / "kinetics_toolkit.py"
RATE_HZ = 240_000 / 1001


@pytest.fixture
def session(tmp_path):
    gaps = {"left_wrist": {10: Status.ESTIMATED, 20: Status.LOST}}
    strokes = [event(EventKind.CONTACT, stamp(5.5)), event(EventKind.RELEASE, stamp(30.25), "right")]
    return write_session(tmp_path / "r.mcap", range(40), gaps, strokes=strokes)


def test_the_example_has_measured_points_events_and_units(session, tmp_path, capsys):
    tracks, events = tmp_path / "t.parquet", tmp_path / "e.parquet"
    export_recording(session, tracks)
    export_recording(session, events, table="events")
    example = runpy.run_path(str(EXAMPLE))
    series = example["time_series"](str(tracks), str(events))
    np.testing.assert_allclose(series.time, np.arange(40) / RATE_HZ, atol=1e-8)
    assert np.flatnonzero(series.isnan("left_wrist")).tolist() == [10, 20]
    np.testing.assert_allclose(series.data["right_wrist"][3], [*xyz_m("right_wrist", 3), 1])
    assert [(e.name, round(e.time * RATE_HZ, 3)) for e in series.events] == [
        ("left CONTACT", 5.5), ("right RELEASE", 30.25),
    ]  # fmt: skip
    example["main"](str(tracks), str(events))
    assert "left_wrist: 38 measured, in m" in capsys.readouterr().out


def test_it_reads_the_c3d_with_gaps_and_events(session, tmp_path):
    export_recording(session, tmp_path / "out.c3d")
    read = ktk.read_c3d(str(tmp_path / "out.c3d"), convert_point_unit=True, include_event_context=True)
    points = read["Points"]
    assert np.flatnonzero(points.isnan("left_wrist")).tolist() == [10, 20]
    np.testing.assert_allclose(points.data["right_wrist"][3, :3], xyz_m("right_wrist", 3), rtol=1e-6)
    assert [(e.name, round(e.time * RATE_HZ, 2)) for e in points.events] == [
        ("Left:CONTACT", 5.5), ("Right:RELEASE", 30.25),
    ]  # fmt: skip
