"""spheremcap analyse and calibrate without a board, as a user meets them."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "analysis"))

import tomli_w
from simulated import CAMERA, simulated
from stroke_recording import SETTINGS, write_strokes

from spheremcap.io.calibration import read_camera_info


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("analyse")


@pytest.fixture(scope="module")
def recording(folder):
    return write_strokes(folder / "session.mcap", simulated(seconds=2.5), wheels={"hub": "angle_rad"})


@pytest.fixture(scope="module")
def settings(folder):
    path = folder / "analysis.toml"
    path.write_text(tomli_w.dumps(SETTINGS))
    return path


def test_a_recording_becomes_strokes_tables_and_a_page(run, recording, settings, tmp_path):
    out = tmp_path / "analysed.mcap"
    outcome = run("analyse", recording, "-o", out, "--settings", settings)
    assert outcome.code == 0, outcome.err
    for words in (
        "left hand: ",
        " strokes, 1.",
        "right hand: ",
        "left forearm: 29",
        "varies by",
        "600 frames analysed",
    ):
        assert words in outcome.out, outcome.out
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "analysed.mcap", "analysed.report.html", "analysed.events.csv", "analysed.strokes.csv",
        "analysed.mean_cycle.csv", "analysed.layout.json",
    }  # fmt: skip
    again = run("analyse", recording, "-o", out, "--settings", settings)
    assert (again.code, again.out, again.err.count("\n")) == (2, "", 1)
    assert "--overwrite" in again.err
    assert run("analyse", recording, "-o", out, "--settings", settings, "--overwrite", "--no-layout").code == 0
    shown = run("info", out)
    assert shown.code == 0
    analysed = run("analyse", out, "-o", tmp_path / "b.mcap")
    assert (analysed.code, analysed.out, analysed.err.count("\n")) == (1, "", 1)
    assert "was analysed already" in analysed.err


def test_notes_are_said_and_are_no_failure(run, recording, tmp_path):
    outcome = run("analyse", recording, "-o", tmp_path / "a.mcap", "--fill", 30)
    assert outcome.code == 0
    assert "no rim: give wheel.rim_radius_m" in outcome.err


def test_what_was_lost_is_said_and_is_exit_3(run, recording, settings, tmp_path):
    data = bytearray(recording.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 3000] = bytes(3000)
    (tmp_path / "hurt.mcap").write_bytes(data)
    outcome = run("analyse", tmp_path / "hurt.mcap", "-o", tmp_path / "a.mcap", "--settings", settings)
    assert outcome.code == 3
    assert (tmp_path / "a.mcap").exists()


def test_wrong_use_is_one_line(run, recording, folder, tmp_path):
    wrong = tmp_path / "wrong.toml"
    for text, words in (
        ("[wheel]\nrim_radius_m = 0", "rim_radius_m"),
        ("[markers]\nnose = 'green'", "is no joint"),
        ("[markers]\nleft_wrist = 'a'\nleft_elbow = 'a'", "cannot be left_wrist and left_elbow"),
        ("[chair]\nlooks = 'up'", "looks"),
        ("[tyre]\n", "tyre"),
        ("[chair]\nclicks = 'none.chair.toml'\n", "none.chair.toml"),
    ):
        wrong.write_text(text)
        outcome = run("analyse", recording, "-o", tmp_path / "a.mcap", "--settings", wrong)
        assert (outcome.code in (1, 2), outcome.out, outcome.err.count("\n")) == (True, "", 1), text
        assert words in outcome.err
    for arguments, code in (
        ((recording, "-o", tmp_path / "a.mcap", "--fill", 2000), 2),
        ((recording, "-o", tmp_path / "a.mcap", "--fill", -1), 2),
        ((tmp_path / "none.mcap", "-o", tmp_path / "a.mcap"), 1),
        ((recording, "-o", recording), 2),
    ):
        outcome = run("analyse", *arguments)
        assert (outcome.code, outcome.out) == (code, "")
    assert not (tmp_path / "a.mcap").exists()


def test_calibrate_finds_the_focal_length_in_a_recordings_arms(run, tmp_path):
    path = write_strokes(tmp_path / "s.mcap", simulated(seconds=5.0, rate_hz=120.0))
    out = tmp_path / "camera.yaml"
    outcome = run("calibrate", path, "-o", out)
    assert outcome.code == 0, outcome.err
    for words in (
        "fx 11",
        "times what the recording was tracked with",
        "left_wrist to left_elbow: 29",
        "degrees in depth",
    ):
        assert words in outcome.out, outcome.out
    camera = read_camera_info(out)
    assert camera.fx_px == pytest.approx(CAMERA.fx_px, rel=0.01)
    assert 0 < camera.focal_sd < 0.02
    assert (camera.distortion, camera.width_px) == (CAMERA.distortion, CAMERA.width_px)
    alone = write_strokes(tmp_path / "one.mcap", simulated(seconds=2.0, rate_hz=120.0), ["left_wrist"])
    for source, target, code, words in (
        (alone, "b.yaml", 1, "no two markers of one arm are measured together on 200 frames"),
        (path, "camera.yaml", 2, "--overwrite"),
        (path, "camera.txt", 2, ".yaml"),
    ):
        outcome = run("calibrate", source, "-o", tmp_path / target)
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (code, "", 1)
        assert words in outcome.err
