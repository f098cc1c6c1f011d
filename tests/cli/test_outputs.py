"""No verb writes over what it reads, over what somebody else is writing, or over what an interrupted run left."""

import fcntl
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import spheremcap
from clips import COUNT, decoded, rows, seed, write_clip, write_truth
from spheremcap.cli.progress import loaded

ONE = ("--seed", seed("orange"))
CAMERA_INFO = (
    "image_width: 320\nimage_height: 240\ndistortion_model: plumb_bob\n"
    "camera_matrix: {rows: 3, cols: 3, data: [600, 0, 159.5, 0, 600, 119.5, 0, 0, 1]}\n"
    "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
)


@pytest.fixture(scope="module")
def tracked(clip, tmp_path_factory):
    out = tmp_path_factory.mktemp("tracked") / "out.mcap"
    spheremcap.track(clip, out, spheremcap.Settings(), [spheremcap.Seed("orange", 0, spheremcap.Circle(100, 90, 18))])
    return out


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """So that no run has more to say than what it is asked."""
    import spheremcap.api
    import spheremcap.evaluation.hough_tuning  # noqa: F401

    loaded()


@pytest.fixture
def given(clip, log, tracked, tmp_path):
    """Every kind of input, in a folder of its own."""
    folder = tmp_path / "given"
    (folder / "imu").mkdir(parents=True)
    (folder / "imu" / "a.csv").write_text("time (s),angle (deg)\n0,1\n0.1,2\n0.2,3\n")
    (folder / "clips").mkdir()
    for name, source in (("clip.mp4", clip), ("log.mcap", log), ("tracked.csv", tracked)):  # an MCAP, whatever its name
        shutil.copy(source, folder / name)
    (folder / "wheel.csv").write_text("time (s),angle (deg)\n0,1\n0.1,2\n0.2,3\n")
    (folder / "mapping.toml").write_text('[time]\ncolumn = "time (s)"\nunit = "s"\n')
    write_truth(folder / "truth.csv")
    (folder / "camera.yaml").write_text(CAMERA_INFO)
    (folder / "lens.yaml").write_text(CAMERA_INFO)
    (folder / "settings.toml").write_text('[camera]\nfile = "lens.yaml"\n')
    (folder / "seeds.toml").write_text('[[seeds]]\nmarker = "orange"\nframe = 0\nx_px = 100\ny_px = 90\nr_px = 18\n')
    return folder


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


TRACK = ("track", "clip.mp4", "--seeds", "seeds.toml", "-s", "settings.toml")
MERGE = ("merge", "log.mcap", "wheel.csv", "imu", "--mapping", "imu=mapping.toml")
TUNE = ("tune", "hough", "clip.mp4", "--truth", "truth.csv", "-s", "settings.toml", "--no-grid", "--draws", "1")


@pytest.mark.parametrize(
    ("verb", "inputs"),
    [
        (TRACK, ["clip.mp4", "seeds.toml", "settings.toml", "lens.yaml"]),
        ((*TRACK, "--camera", "camera.yaml"), ["camera.yaml"]),
        (("track", "log.mcap", *ONE), ["log.mcap"]),
        (
            ("retrack", "tracked.csv", "--seeds", "seeds.toml", "--source", "clip.mp4"),
            ["tracked.csv", "seeds.toml", "clip.mp4"],
        ),
        (MERGE, ["log.mcap", "wheel.csv", "mapping.toml", "imu/a.csv", "imu/new.csv"]),
        (("export", "tracked.csv"), ["tracked.csv"]),
        (TUNE, ["clip.mp4", "truth.csv", "settings.toml"]),
        (("recover", "log.mcap"), ["log.mcap"]),
        (("experiment", "accuracy", "--quick", "--clips", "clips"), ["clips", "clips/new"]),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_no_verb_writes_over_its_inputs(run, given, verb, inputs, monkeypatch):
    monkeypatch.chdir(given)
    before = contents(given)
    for name in inputs:
        link, hard = given / "link.csv", given / "hard.csv"
        link.symlink_to(given / name)
        outputs = [given / name, link]
        if (given / name).is_file():
            os.link(given / name, hard)
            outputs.append(hard)
        for output in outputs:
            flags = () if verb[0] == "experiment" else ("--overwrite",)
            outcome = run(*verb, "-o", output, *flags)
            assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1), (output, outcome)
            assert "is an input" in outcome.err or "lies in the input folder" in outcome.err
            assert str(output) in outcome.err
        link.unlink()
        hard.unlink(missing_ok=True)
        assert contents(given) == before


def test_a_part_is_rescued_under_its_own_name(run, tracked, tmp_path):
    """`merge x.mcap.part -o x.mcap` was how an interrupted run was rescued, and emptied it."""
    part, out = tmp_path / "x.mcap.part", tmp_path / "x.mcap"
    part.write_bytes(tracked.read_bytes()[:-2000])
    before = part.read_bytes()
    for verb in ("merge", "recover"):
        outcome = run(verb, part, "-o", out, *(["--no-layout"] if verb == "merge" else []))
        assert outcome.code == 3, outcome
        assert part.read_bytes() == before
        assert rows(out) == rows(tracked)
        assert sorted(tmp_path.iterdir()) == [out, part]
        out.unlink()


def test_a_video_with_the_name_of_the_part_stays(run, clip, tmp_path):
    part, out = tmp_path / "y.mcap.part", tmp_path / "y.mcap"
    shutil.copy(clip, part)
    outcome = run("track", part, "-o", out, *ONE)
    assert outcome.code == 0, outcome
    assert part.read_bytes() == clip.read_bytes()
    assert len(decoded(out)["/markers/orange/state"]) == COUNT


@pytest.mark.parametrize("verb", ["track", "retrack", "merge", "export", "recover", "tune", "synth"])
def test_what_an_interrupted_run_left_stays_and_is_named(run, verb, clip, log, tracked, tmp_path):
    truth = write_truth(tmp_path / "truth.csv")
    out = tmp_path / ("out.csv" if verb == "export" else "out.mcap")
    words = {
        "track": ("track", clip, *ONE), "merge": ("merge", log), "export": ("export", tracked),
        "retrack": ("retrack", tracked, "--seed", seed("orange", index=9)),
        "recover": ("recover", log), "tune": ("tune", "hough", clip, "--truth", truth, "--no-grid", "--draws", 1),
        "synth": ("synth", "racing", "--frames", 2),
    }[verb]  # fmt: skip
    if verb == "synth":
        out = tmp_path / "folder"
        out.mkdir()
        left = out / "session.mp4.part"
    else:
        left = Path(f"{out}.part")
    left.write_bytes(b"\x89MCAP0\r\nprecious")
    outcome = run(*words, "-o", out)
    assert outcome.code == 0, outcome
    assert left.read_bytes() == b"\x89MCAP0\r\nprecious"
    if verb != "tune":
        assert f"spheremcap recover {left} -o OTHER.mcap" in outcome.err
    assert not list(tmp_path.rglob("*2.part"))


@pytest.mark.parametrize("verb", ["track", "retrack", "merge", "export", "recover"])
def test_an_output_that_another_run_is_writing_is_refused(run, verb, clip, log, tracked, tmp_path):
    out = tmp_path / ("out.csv" if verb == "export" else "out.mcap")
    words = {
        "track": ("track", clip, *ONE), "merge": ("merge", log), "export": ("export", tracked),
        "retrack": ("retrack", tracked, "--seed", seed("orange", index=9)),
        "recover": ("recover", log),
    }[verb]  # fmt: skip
    part = Path(f"{out}.part")
    with part.open("wb") as other:
        other.write(b"half")
        other.flush()
        fcntl.flock(other, fcntl.LOCK_EX)
        outcome = run(*words, "-o", out, "--overwrite")
        placed = verb == "merge"  # it says first where it puts its input
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1 + placed), outcome
        assert f"another run is writing it, into {part}" in outcome.err
        outcome = run("recover", part, "-o", tmp_path / "new.mcap")
        assert (outcome.code, outcome.err.count("\n")) == (2, 1)
        assert "still writing" in outcome.err
    assert part.read_bytes() == b"half"
    assert list(tmp_path.iterdir()) == [part]


def test_an_error_of_usage_leaves_no_part(run, clip, log, tmp_path):
    out = tmp_path / "out.mcap"
    matroska = write_clip(tmp_path / "clip.mkv")  # does not say how many frames it has
    for words in (
        ("track", clip, "--seed", "orange@0=900,90,18"),
        ("track", matroska, *ONE, "--seed", "orange@999=100,90,18"),
        ("track", log, *ONE, "--start", 0.02),
        ("merge", log, "--offset", f"{log.stem}=-100000d"),
        ("merge", log, "--offset", f"{log.stem}=-2000000000s"),
        ("recover", log, "-o", tmp_path),
    ):
        outcome = run(*words, *(() if "-o" in words else ("-o", out)))
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1), outcome
        assert list(tmp_path.iterdir()) == [matroska]


def test_synth_replaces_none_of_its_files_unasked(run, tmp_path):
    for name in ("session.mp4", "truth.csv", "settings.toml", "seeds.toml"):
        path = tmp_path / name
        path.write_text("mine")
        outcome = run("synth", "racing", "-o", tmp_path, "--frames", 2)
        assert (outcome.code, outcome.err.count("\n")) == (2, 1), outcome
        assert f"{path} exists already" in outcome.err
        assert path.read_text() == "mine"
        assert list(tmp_path.iterdir()) == [path]
        path.unlink()
    file = tmp_path / "file"
    file.write_text("mine")
    for place in (file, file / "folder"):
        outcome = run("synth", "racing", "-o", place, "--frames", 2)
        assert (outcome.code, outcome.err.count("\n")) == (1, 1), outcome
        assert "a file where a folder has to be" in outcome.err


def test_experiments_that_cannot_be_written_are_one_line(run, tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    for name in ("accuracy", "report"):
        outcome = run("experiment", name, "-o", file / "results", "--quick")
        assert (outcome.code, outcome.err.count("\n")) == (1, 1), outcome


# --- signals ---

SLOW = """
import time
print('importing', flush=True)
try:
    time.sleep(60)
except BaseException:
    print("swallowed")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_starting_is_one_line(tmp_path, number):
    """Whatever is being imported, and whatever that makes of exceptions."""
    (tmp_path / "typer.py").write_text(SLOW)
    env = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    for command in (["-m", "spheremcap"], ["-c", "from spheremcap.__main__ import main; main()"]):
        with subprocess.Popen(
            [sys.executable, *command, "info", "x.mcap"], env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, preexec_fn=default_signals,
        ) as process:  # fmt: skip
            assert process.stdout.readline() == "importing\n"
            process.send_signal(number)
            out, err = process.communicate(timeout=30)
        assert (process.returncode, out, err) == (1, "", "spheremcap: interrupted\n")


def default_signals() -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def test_the_installed_command_begins_where_signals_are_taken_care_of():
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert 'spheremcap = "spheremcap.__main__:main"' in text
