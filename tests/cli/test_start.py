"""How a verb starts: what only prints imports nothing that tracks, and OpenCV gets one thread."""

import os
import subprocess
import sys

import cv2
import pytest
from recording_data import CAMERA, MARKERS, result

from spheremcap.cli.progress import loaded
from spheremcap.io.mcap_log import McapLog

METHOD = {"numba", "scipy", "av", "spheremcap.chain", "spheremcap.session", "spheremcap.core.compiled"}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("start") / "r.mcap"
    with McapLog(path, camera=CAMERA, markers=MARKERS) as log:
        for index in range(6):
            log.write(result(index), None)
    return path


def imported(*arguments: object) -> set[str]:
    """The modules that a command line imports, by Python's own account."""
    command = [sys.executable, "-X", "importtime", "-m", "spheremcap", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "COLUMNS": "100"}, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    return {line.rpartition("|")[2].strip() for line in lines}


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--version"],
        ["track", "--help"],
        ["tune", "hough", "--help"],
        ["analyse", "--help"],
        ["calibrate", "--help"],
        ["dataset", "run", "--help"],
    ],
)
def test_help_imports_no_numbers(arguments):
    found = imported(*arguments)
    assert "typer" in found
    assert not found & (METHOD | {"cv2", "numpy", "mcap", "google.protobuf"})


def test_verbs_that_only_print_do_not_import_the_method(recorded, tmp_path):
    for arguments in (
        ("info", recorded),
        ("export", recorded, "-o", tmp_path / "tracks.csv"),
        ("recover", recorded, "-o", tmp_path / "whole.mcap"),
        ("config", "presets"),
    ):
        assert not imported(*arguments) & METHOD, arguments


def test_an_unknown_choice_is_told_with_those_there_are(run, tmp_path):
    outcome = run("track", tmp_path / "a.mp4", "-o", tmp_path / "o.mcap", "--video", "mpeg1")
    assert outcome.code == 2
    for word in ("mpeg1", "auto", "passthrough", "h264", "jpeg", "none"):
        assert word in outcome.err


def test_opencv_gets_one_thread():
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(2)
        loaded()
        assert cv2.getNumThreads() == 1
    finally:
        cv2.setNumThreads(before)
