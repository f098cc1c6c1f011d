"""Twenty sessions of mixed kinds, five of them with something wrong, here and on a cluster, killed and gone on with:
the five are named, all else is the same to the last byte."""

import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import pytest
from seasons import dataset, files, gone, kill, write_manifest, write_seeds, write_session

from clips import pictures, seed, write_recording
from spheremcap.season.outcome import WORK, read_outcome
from spheremcap.season.worker import PROGRESS

LONG = 1500  # frames of a session that something happens to while it is in work
WRONG = {
    "cut": ("failed", "v.mp4"),
    "damaged": ("lost", "could not be decoded"),
    "killed": ("failed", "killed (SIGKILL)"),
    "large": ("failed", "out of memory"),
    "seedless": ("failed", "no seeds"),
}
"""How those end that something is wrong with, and what is said of it."""


def damaged(video: Path) -> None:
    """The middle of its pictures overwritten."""
    data = bytearray(video.read_bytes())
    at = len(data) // 2
    data[at : at + 3000] = bytes(3000)
    video.write_bytes(data)


def table(path: Path, count: int = 40) -> Path:
    path.write_text("time_s,angle_rad\n" + "".join(f"{k / 400},{k / 90}\n" for k in range(count)))
    return path


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("videos")
    said: dict[str, dict[str, Any]] = {}
    for number in range(7):  # plain ones of other lengths
        said[f"plain{number}"] = write_session(folder / f"plain{number}", 12 + 4 * number)
    for number in range(2):
        said[f"wheel{number}"] = write_session(folder / f"wheel{number}") | {"sensors": f"wheel{number}/*.csv"}
        table(folder / f"wheel{number}" / "wheel.csv")
    said["two_logs"] = write_session(folder / "two_logs") | {"sensors": ["a=two_logs/1.csv", "b=two_logs/2.csv"]}
    table(folder / "two_logs" / "1.csv"), table(folder / "two_logs" / "2.csv", 30)
    said["chapters"] = write_session(folder / "chapters")
    (folder / "chapters" / "w.mp4").write_bytes((folder / "chapters" / "v.mp4").read_bytes())
    said["chapters"]["video"] = ["chapters/v.mp4", "chapters/w.mp4"]
    said["answered"] = write_session(folder / "answered")
    write_seeds(folder / "answered" / "v.seeds.toml", seed("orange"), seed("blue", 1), seed("orange", 0, 8))
    said["auto"] = write_session(folder / "auto", 24, seeds=False) | {"auto": True, "analyse": False}
    shown = folder / "folder" / "shown"
    shown.mkdir(parents=True)
    for index, image in enumerate(pictures()):
        cv2.imwrite(str(shown / f"{index:04}.png"), image)
    write_seeds(folder / "folder" / "seeds.toml")
    said["folder"] = {"video": "folder/shown", "rate": "240", "seeds": "folder/seeds.toml"}
    (folder / "mcap").mkdir()
    write_recording(folder / "mcap" / "log.mcap", ["/front/image"])
    write_seeds(folder / "mcap" / "log.seeds.toml")
    said["mcap"] = {"video": "mcap/log.mcap"}
    for name in ("cut", "damaged", "seedless", "large"):
        said[name] = write_session(folder / name, 60, seeds=name != "seedless")
    said["killed"] = write_session(folder / "killed", LONG)
    said["large"]["memory_gb"] = 0.1
    video = folder / "cut" / "v.mp4"
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 3])
    damaged(folder / "damaged" / "v.mp4")
    assert len(said) == 20
    return write_manifest(folder, said, overrides=[{"sessions": "plain*", "subject": "anna"}])


@contextmanager
def killing(out: Path) -> Iterator[None]:
    """While it is open, somebody kills the process of `killed` whenever it is at work."""
    over = threading.Event()

    def watch() -> None:
        done: set[int] = set()
        while not over.wait(0.01):
            with suppress(OSError, ValueError, ProcessLookupError):
                told = json.loads((out / "killed" / WORK / PROGRESS).read_text())
                if told["step"] == "tracking" and told["pid"] not in done:
                    kill(told["pid"])
                    done.add(told["pid"])

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()


def tables(out: Path) -> dict[str, bytes]:
    folder = out.with_name(f"{out.name}-tables")
    done = dataset("tables", out, "-o", folder)
    assert done.returncode == 0, done.stderr
    return files(folder)


def check(out: Path, returncode: int, said: str) -> None:
    assert returncode == 3, said
    assert "15 done, 1 with losses, 4 failed, 0 not run" in said
    for name, (status, reason) in WRONG.items():
        outcome = read_outcome(out / name)
        assert outcome is not None
        assert outcome.status == status, outcome.line()
        assert reason in outcome.line()
        assert f"{name}: {'failed: ' if status == 'failed' else 'done'}" in said


@pytest.fixture(scope="module")
def here(manifest: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The tables of a run on this machine."""
    out = tmp_path_factory.mktemp("here") / "out"
    with killing(out):
        done = dataset("run", manifest, "-o", out, "--workers", 2)
    check(out, done.returncode, done.stdout)
    return tables(out)


def test_on_two_workers_here_all_but_the_five_are_whole(here: dict[str, bytes]) -> None:
    assert {name for name in here if "/" not in name} == {"sessions.parquet", "report.html"}
    made = {name.split("/")[1].removeprefix("session=") for name in here if name.startswith("poses/")}
    assert len(made) == 16
    assert made & set(WRONG) == {"damaged"}
    page = here["report.html"].decode()
    for name, (_, reason) in WRONG.items():
        assert name in page
        assert reason in page


def test_a_cluster_makes_the_same_and_a_worker_that_dies_costs_nothing_else(
    here: dict[str, bytes], manifest: Path, tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed")
    out = tmp_path / "out"
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster.scheduler_address, set_as_default=False) as client,
        killing(out),
    ):
        run = ["run", str(manifest), "-o", str(out), "--dask", cluster.scheduler_address]
        with subprocess.Popen(
            [sys.executable, "-m", "spheremcap", "dataset", *run], stdout=subprocess.PIPE, text=True
        ) as process:
            victim = next(iter(client.run(_pid).values()))
            until = time.monotonic() + 120
            while not any((out / name / "run.json").exists() for name in ("plain6", "folder", "damaged")):
                assert time.monotonic() < until
                time.sleep(0.05)
            names = {key for keys in client.processing().values() for key in keys}
            assert all(str(name).rpartition("-")[0] for name in names)  # a session's own name, on the scheduler's page
            kill(victim)
            said, _ = process.communicate(timeout=300)
        check(out, process.returncode, said)
        assert tables(out) == here


def _pid() -> int:
    import os

    return os.getpid()


def test_a_run_that_is_killed_is_gone_on_with_and_makes_the_same(
    here: dict[str, bytes], manifest: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = [sys.executable, "-m", "spheremcap", "dataset", "run", str(manifest), "-o", str(out), "--workers", "2"]
    with killing(out):
        with subprocess.Popen(run, stdout=subprocess.PIPE) as process:
            until = time.monotonic() + 120
            while len(list(out.glob("*/run.json"))) < 5:
                assert time.monotonic() < until
                time.sleep(0.01)
            process.kill()
        at_work = [json.loads(path.read_text())["pid"] for path in out.glob(f"*/{WORK}/{PROGRESS}")]
        assert all(gone(pid) for pid in at_work)
        before = {path.parent.name: path.read_bytes() for path in out.glob("*/run.json")}
        assert 5 <= len(before) < 20
        done = dataset("run", manifest, "-o", out)
    check(out, done.returncode, done.stdout)
    for name, told in before.items():
        if name not in WRONG:
            assert (out / name / "run.json").read_bytes() == told
    assert tables(out) == here
    assert list(itertools.chain(out.glob("*/.work"), out.glob(".stop*"))) == []
