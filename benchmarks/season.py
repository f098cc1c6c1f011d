"""What a season costs besides its sessions: each one's overhead, one worker against two, and a thousand tiny sessions.

usage: python benchmarks/season.py overhead [--sessions 20] [--frames 480]
       python benchmarks/season.py workers [--sessions 8] [--frames 960] [--rounds 2]
       python benchmarks/season.py thousand [--sessions 1000]

`overhead` and `workers` render one session of strokes (six markers, 1280x720, a wheel's log) and run copies of it.
`overhead` is the time of the whole command less what its sessions spent in tracking, merging, analysing and tables, by
their own word, for each session. `workers` runs the same season with one worker and with two, in turns: first with a
processor for each worker, as more machines would do it, then both with all that there are. `thousand` makes that many
sessions of 16 small pictures, runs them once, and then takes time and memory of init, list, a second run, and tables:
commands as a person gives them, each a process of its own with the most memory that it had.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import tomli_w

TESTS = Path(__file__).parents[1] / "tests"
WRITE = """
import pathlib, sys
sys.path[:0] = sys.argv[2:]
import seasons
seasons.write_session(pathlib.Path(sys.argv[1]))
"""
"""In a process of its own, for what this one has in memory counts for those that it starts."""


def command(*arguments: object, codes: tuple[int, ...] = (0,), processors: int | None = None) -> tuple[float, float]:
    """Run `spheremcap ...`, on so many processors where that is said; seconds, and the most memory that it had, MB."""
    since = time.perf_counter()
    pinned = ["taskset", "-c", f"0-{processors - 1}"] if processors is not None else []
    process = subprocess.Popen(
        [*pinned, sys.executable, "-m", "spheremcap", *map(str, arguments)], stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) in codes, arguments
    return time.perf_counter() - since, usage.ru_maxrss / 1024


def copies(folder: Path, sessions: int, frames: int) -> Path:
    """The manifest of so many sessions of the same strokes; each video is a file of its own."""
    command("synth", "strokes", "-o", folder / "strokes", "--frames", frames)
    said = []
    for number in range(sessions):
        video = folder / f"{number:04}.mp4"
        shutil.copyfile(folder / "strokes" / "session.mp4", video)
        said.append({"name": f"s{number:04}", "video": video.name})
    beside = {key: f"strokes/{key}.toml" for key in ("settings", "seeds", "analysis")}
    manifest = folder / "season.toml"
    manifest.write_text(tomli_w.dumps({"defaults": beside | {"sensors": "strokes/wheel.csv"}, "sessions": said}))
    return manifest


def overhead(sessions: int, frames: int) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        manifest = copies(folder, sessions, frames)
        command("dataset", "run", first_of(manifest), "-o", folder / "warm")  # compiles what is not there yet
        took_s, _ = command("dataset", "run", manifest, "-o", folder / "out", "--workers", 1)
        worked_s = sum(
            sum(json.loads(path.read_text())["seconds"].values()) for path in (folder / "out").glob("*/run.json")
        )
        print(f"{sessions} sessions of {frames} frames, one worker: {took_s:.1f} s, of which {worked_s:.1f} s in steps")
        print(f"overhead: {(took_s - worked_s) / sessions:.2f} s a session, its share of the command's start included")


def first_of(manifest: Path) -> Path:
    """Another manifest, of its first session alone."""
    said = tomllib.loads(manifest.read_text())
    one = manifest.with_name("one.toml")
    one.write_text(tomli_w.dumps(said | {"sessions": said["sessions"][:1]}))
    return one


def workers(sessions: int, frames: int, rounds: int) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        manifest = copies(folder, sessions, frames)
        command("dataset", "run", first_of(manifest), "-o", folder / "warm")
        out, run = folder / "out", ("dataset", "run", manifest, "-o", folder / "out", "--workers")
        for pinned in (True, False):
            for _ in range(rounds):
                took = {}
                for number in (1, 2):
                    took[number], _ = command(*run, number, processors=number if pinned else None)
                    shutil.rmtree(out)
                rates = [f"{sessions * frames / took[number]:.0f} frames/s" for number in took]
                print(
                    f"{sessions} sessions of {frames} frames, {'a processor each' if pinned else 'all processors'}: "
                    f"one worker {took[1]:.1f} s ({rates[0]}), two {took[2]:.1f} s ({rates[1]}): "
                    f"{took[1] / took[2]:.2f} times as fast",
                    flush=True,
                )


def thousand(sessions: int) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "videos"
        folder.mkdir()
        subprocess.run([sys.executable, "-c", WRITE, folder / "first", TESTS, TESTS / "season"], check=True)
        (folder / "first" / "settings.toml").rename(folder / "first" / "v.settings.toml")
        for number in range(1, sessions):
            shutil.copytree(folder / "first", folder / f"s{number:04}")
        manifest, out = folder.parent / "season.toml", folder.parent / "out"
        parts = [
            ("init", ("dataset", "init", folder, "-o", manifest)),
            ("first run", ("dataset", "run", manifest, "-o", out, "--workers", 2)),
            ("list", ("dataset", "list", manifest, "-o", out)),
            ("second run", ("dataset", "run", manifest, "-o", out, "--workers", 2)),
            ("tables", ("dataset", "tables", out, "-o", folder.parent / "season")),
        ]
        total_s = 0.0
        for name, arguments in parts:
            took_s, peak_mb = command(*arguments, codes=(0, 3))
            total_s += took_s if name != "first run" else 0
            print(f"{name}: {took_s:.1f} s, {peak_mb:.0f} MB", flush=True)
        print(f"{sessions} sessions: all but the first run {total_s:.1f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("overhead", "workers", "thousand"))
    parser.add_argument("--sessions", type=int)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--rounds", type=int, default=2)
    given = parser.parse_args()
    if given.what == "overhead":
        overhead(given.sessions or 20, given.frames or 480)
    elif given.what == "workers":
        workers(given.sessions or 8, given.frames or 960, given.rounds)
    else:
        thousand(given.sessions or 1000)


if __name__ == "__main__":
    main()
