"""spheremcap calibrate as a user meets it."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "analysis"))

from filmed_boards import CHARUCO, film, poses

from spheremcap.io.calibration import read_camera_info

BOARD = "charuco:7x5:30mm:22mm"


def test_a_film_becomes_a_camera_that_track_takes(run, tmp_path):
    path, out = film(tmp_path / "a.mp4", CHARUCO, poses(18)), tmp_path / "camera.yaml"
    outcome = run("calibrate", path, "-o", out, "--board", BOARD)
    assert outcome.code == 0, outcome.err
    for words in ("fx 59", " ± ", "rms 0.", "tilted by", str(out), "camera.png"):
        assert words in outcome.out
    camera = read_camera_info(out)
    assert 0 < camera.focal_sd < 0.01
    assert (camera.width_px, camera.height_px, camera.model) == (640, 360, "plumb_bob")
    again = run("calibrate", path, "-o", out, "--board", BOARD)
    assert (again.code, again.err.count("\n")) == (2, 1)
    assert "--overwrite" in again.err
    few = film(tmp_path / "few.mp4", CHARUCO, poses(4))
    outcome = run("calibrate", few, "-o", tmp_path / "few.yaml", "--board", BOARD)
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (1, "", 1)
    assert "different poses" in outcome.err


def test_a_board_is_printed_and_wrong_use_is_one_line(run, tmp_path):
    out = tmp_path / "board.svg"
    assert run("calibrate", "--print", "--board", BOARD, "-o", out).code == 0
    assert 'width="270mm"' in out.read_text()
    for arguments, words in (
        (("--print", "--board", BOARD, "-o", tmp_path / "board.png"), ".svg"),
        (("--print", "--board", BOARD, "-o", out), "exists"),
        (("--board", BOARD, "-o", tmp_path / "c.yaml"), "name the film"),
        ((out, "-o", tmp_path / "c.yaml"), "--board"),
        ((out, "--board", BOARD), "-o"),
        ((out, "--board", BOARD, "-o", tmp_path / "c.txt"), ".yaml"),
        ((out, "--print", "--board", BOARD, "-o", tmp_path / "b.svg"), "reads nothing"),
    ):
        outcome = run("calibrate", *arguments)
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1), arguments
        assert words in outcome.err
