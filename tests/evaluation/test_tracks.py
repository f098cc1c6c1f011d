"""Scoring files: a recording, its export, and truth made by hand or rendered."""

from pathlib import Path

import numpy as np
import pytest

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, OperatorRequest, Status
from spheremcap.core.marker import MarkerSpec
from spheremcap.errors import SourceError, UsageError
from spheremcap.evaluation import evaluate, read_truth, scores_table
from spheremcap.io.export import export_recording
from spheremcap.io.mcap_log import McapLog, RunInfo
from spheremcap.synth import TRUTH_COLUMNS

FRAMES = 6
NAMES = ("left", "right")


def true_circle(marker: str, frame: int) -> Circle:
    return Circle(50.0 + 3 * frame + 100 * NAMES.index(marker), 40.0, 10.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two markers, each off by (0.3, 0.4) px; the right one is lost on the last frame."""
    path = tmp_path_factory.mktemp("tracks") / "run.mcap"
    run = RunInfo("session.mp4", 1, "0" * 64, "zero", "no video", "", "", {})
    with McapLog(path, camera=None, markers=[MarkerSpec(n) for n in NAMES], run=run) as log:
        for k in range(FRAMES):
            lost = k == FRAMES - 1
            found = [
                MarkerEstimate(
                    name, k, k * 4_000_000,
                    Status.LOST if lost and name == "right" else Status.VERIFIED if k else Status.SEEDED,
                    circle=None if lost and name == "right" else true_circle(name, k).shifted(0.3, 0.4),
                    xyz_cam_m=None if lost and name == "right" else np.array([0.0, 0.0, 1.0 + 0.001]),
                    covariance_m2=None if lost and name == "right" else np.eye(3) * 1e-6,
                )
                for name in NAMES
            ]  # fmt: skip
            asked = (OperatorRequest("right", k, k * 4_000_000, k, k * 4_000_000, "lost"),) if lost else ()
            log.write(FrameResult(k, k * 4_000_000, tuple(found), (), asked), None, None, 1)
        log.close({"frames": str(FRAMES)}, complete=True)
    return path


@pytest.fixture(scope="module")
def truth(recording: Path) -> Path:
    path = recording.with_name("truth.csv")
    lines = [",".join(TRUTH_COLUMNS)]
    for k in range(FRAMES):
        for name in NAMES:
            c = true_circle(name, k)
            values = {
                "frame": k, "marker": name, "x_px": c.x_px, "y_px": c.y_px, "r_px": c.r_px,
                "x_cam_m": 0, "y_cam_m": 0, "z_cam_m": 1, "visible": 1,
            }  # fmt: skip
            lines.append(",".join(str(values.get(column, "")) for column in TRUTH_COLUMNS))
    path.write_text("\n".join(lines))
    return path


def test_a_recording_is_scored_against_rendered_truth(recording: Path, truth: Path) -> None:
    scores = evaluate(recording, truth)
    assert set(scores.markers) == set(NAMES)
    assert scores.overall.centre_median_px == pytest.approx(0.5)
    assert scores.overall.position_mean_mm == pytest.approx(1.0)
    assert scores.overall.nees_mean == pytest.approx(1.0)
    assert (scores.markers["left"].failures, scores.markers["right"].failures) == (0, 1)
    assert scores.markers["right"].requests_per_min == pytest.approx(60 / 0.02)
    text = scores_table(scores)
    assert "left: 5 frames" in text
    assert "all markers: 10 frames" in text


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_an_export_scores_like_its_recording(recording: Path, truth: Path, tmp_path: Path, ending: str) -> None:
    if ending == ".parquet":
        pytest.importorskip("pyarrow")
    out = tmp_path / f"tracks{ending}"
    export_recording(recording, out)
    whole, table = evaluate(recording, truth).overall, evaluate(out, truth).overall
    assert table.accuracy_pct == pytest.approx(whole.accuracy_pct)
    assert table.position_mean_mm == pytest.approx(whole.position_mean_mm)
    assert table.nees_mean is None  # a table has no full covariance
    assert table.requests_per_min is None


def test_truth_made_by_hand_needs_no_marker_names(recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "hand.csv"
    c = true_circle("left", 2)
    path.write_text(f"frame,x,y,r,err_px,note\n2,{c.x_px},{c.y_px},{c.r_px},1.5,by eye\n3,,,,,hidden\n")
    rows = read_truth(path)
    assert (rows[0].circle, rows[0].err_px, rows[0].visible) == (c, 1.5, 1.0)
    assert (rows[1].circle, rows[1].visible) == (None, 0.0)
    scores = evaluate(recording, path, "left")
    assert scores.overall.frames == 2
    assert scores.overall.false_accepts == 1  # VERIFIED on the frame where it is hidden
    with pytest.raises(UsageError, match="--marker"):
        evaluate(recording, path)


def test_what_cannot_be_scored_is_said(recording: Path, truth: Path, tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no such file"):
        evaluate(recording, tmp_path / "none.csv")
    with pytest.raises(UsageError, match="no marker 'elbow'"):
        evaluate(recording, truth, "elbow")
    with pytest.raises(UsageError, match=r"not '\.txt'"):
        evaluate(tmp_path / "a.txt", truth)
    bad = tmp_path / "bad.csv"
    bad.write_text("time,x\n1,2\n")
    with pytest.raises(SourceError, match="line 2"):
        evaluate(recording, bad)
    other = tmp_path / "other.csv"
    other.write_text("frame,x,y,r,marker\n1,2,3,4,elbow\n")
    with pytest.raises(UsageError, match="elbow"):
        evaluate(recording, other)
