"""How fast the tracker is and how much memory it takes, on the machine that this runs on.

python benchmarks/speed.py ONE SIX [--against WORKTREE] [--peers PYTHON] [--memory FRAMES ...] [-o docs/performance.md]

ONE and SIX are rendered sessions' folders (`spheremcap synth clean -o DIR`, `synth six`). Exposure and readout are not
given to the tracker, as users run it. WORKTREE is a checkout of an older commit (`git worktree add DIR COMMIT`): each
figure of the chain is then taken in turn from both, in this one run. PYTHON is the interpreter that
benchmarks/peers/run.sh made: OpenCV's trackers follow the first marker of ONE too. Every figure is the least of its
repeats: the machine's other work only ever adds.
"""

import argparse
import json
import os
import platform
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import av
import cv2
import numba
import numpy as np

from spheremcap.evaluation.metrics import layout

ROOT = Path(__file__).resolve().parents[1]

CHAIN = """
import dataclasses, inspect, itertools, json, sys, time
from pathlib import Path
import cv2
cv2.setNumThreads(1)
from spheremcap.evaluation.protocol import load_trial
from spheremcap.io.video import VideoSource
from spheremcap.session import Session
trial, count, repeats = load_trial(Path(sys.argv[1])), int(sys.argv[2]), int(sys.argv[3])
camera, metric = trial.camera()
with VideoSource(trial.video, packets=False) as source:
    frames = list(itertools.islice(source.frames(), count))
more = {"threads": 1} if "threads" in inspect.signature(Session.__init__).parameters else {}
best = 1e9
for _ in range(repeats):
    settings = trial.settings
    session = Session(camera, trial.specs(), trial.seeds, settings.chain, settings.session, metric=metric, **more)
    start = time.process_time()
    estimates = sum(len(result.estimates) for result in session.run(iter(frames)))
    best = min(best, 1000 * (time.process_time() - start) / estimates)
print(json.dumps(best))
"""
"""CPU ms of the chain, a marker and frame: decoded frames, one thread, nothing written."""

SIZE = """
import json, sys, time
import cv2, numpy as np
cv2.setNumThreads(1)
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame
from spheremcap.core.marker import MarkerSpec
camera = Camera(1280, 720, 1200, 1200, 639.5, 359.5)
noise = np.random.default_rng(0).integers(60, 100, (720, 1280, 3), np.uint8)
def drawn(k, r):
    centre = (round((560 + k) * 16), 360 * 16)
    image = cv2.circle(noise.copy(), centre, round(r * 16), (60, 190, 70), -1, cv2.LINE_AA, 4)
    return BgrFrame(k, k * 1_000_000_000 // 240, cv2.GaussianBlur(image, (0, 0), 0.6))
out = {}
for r in (24, 240):
    frames = [drawn(k, r) for k in range(40)]
    best = 1e9
    for _ in range(3):
        chain = MarkerChain(MarkerSpec("ball", 0.04), camera, ChainConfig())
        chain.seed(frames[0], Circle(560, 360, r))
        for frame in frames[1:10]:
            chain.step(frame)
        start = time.process_time()
        for frame in frames[10:]:
            chain.step(frame)
        best = min(best, 1000 * (time.process_time() - start) / 30)
    out[r] = best
print(json.dumps(out))
"""
"""CPU ms of a step at two radii."""

TRACK = """
import json, os, re, resource, sys, time
from pathlib import Path
start = time.process_time()
import cv2
cv2.setNumThreads(1)
import spheremcap.session
from spheremcap.api import track
from spheremcap.config import load_seeds, load_settings
from spheremcap.io.video import VideoSource
begun = time.process_time() - start
video, folder, out = Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3])
settings = load_settings(folder / "settings.toml")
blank = settings.camera.model_copy(update={"exposure_s": 0.0, "readout_s": None})
settings = settings.model_copy(update={"camera": blank})
def decoded():
    start = time.perf_counter()
    with VideoSource(video, packets=False) as source:
        count = sum(1 for _ in source.frames())
    return count / (time.perf_counter() - start)
def tracked():
    start = time.perf_counter()
    report = track(video, out, settings, load_seeds(folder / "seeds.toml"), overwrite=True)
    return report.frames / (time.perf_counter() - start)
rates = [(decoded(), tracked()) for _ in range(int(sys.argv[4]))]
decode, track = map(max, zip(*rates))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"begun": begun, "decode": decode, "track": track, "peak": peak}))
"""
"""Frames a second of decoding alone and of decode to finished MCAP, debug pictures on; start-up CPU s; peak MB."""


def probe(code: str, *words: object, tree: Path = ROOT) -> object:
    """What a piece of code prints as JSON when it runs on a checkout."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)], env={**os.environ, "PYTHONPATH": str(tree / "src")},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{tree}: {done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def repeated(video: Path, frames: int, output: Path) -> Path:
    """The video's packets over and over, as they are, until there are `frames`."""
    with av.open(str(output), "w") as out:
        stream = None
        written, shift = 0, 0
        while written < frames:
            with av.open(str(video)) as source:
                own = source.streams.video[0]
                stream = stream or out.add_stream_from_template(own)
                end = 0
                for packet in source.demux(own):
                    if packet.pts is None or packet.dts is None or written == frames:
                        continue
                    end = max(end, packet.pts + (packet.duration or 0))
                    packet.pts, packet.dts, packet.stream = packet.pts + shift, packet.dts + shift, stream
                    out.mux(packet)
                    written += 1
                shift += end
    return output


def peer_times(python: Path, session: Path, folder: Path) -> dict[str, float]:
    """CPU ms a frame and marker of OpenCV's trackers on the session."""
    script = Path(__file__).parent / "peers" / "track.py"
    subprocess.run([str(python), str(script), str(session), str(folder)], check=True, stdout=subprocess.DEVNULL)
    rows = [line.split(",") for line in (folder / "times.csv").read_text(encoding="utf-8").splitlines()]
    return {tracker: float(each_ms) for _, tracker, _, each_ms in rows}


def help_seconds(tree: Path) -> float:
    """CPU seconds of `spheremcap --help`, the least of five."""
    spent = []
    for _ in range(5):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
        subprocess.run([sys.executable, "-m", "spheremcap", "--help"], env=environment, capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(spent)


def machine() -> str:
    """What this runs on, in one line."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists() and (found := re.search(r"model name\s*: (.+)", info.read_text(encoding="utf-8"))):
        cpu = found[1]
    versions = f"Python {platform.python_version()}, OpenCV {cv2.__version__}, PyAV {av.__version__}"
    return (
        f"{cpu}, {os.cpu_count()} logical CPUs, {platform.system()}, {versions}, NumPy {np.__version__}, "
        f"numba {numba.__version__}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("one", type=Path)
    parser.add_argument("six", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--peers", type=Path)
    parser.add_argument("--memory", type=int, nargs="*", default=[1000, 10000], help="frames; none leaves it out")
    parser.add_argument("-o", "--output", type=Path)
    given = parser.parse_args()
    trees = {"this commit": ROOT} | ({f"{given.against.name}": given.against} if given.against else {})
    old = given.against.name if given.against else ""

    rows = [["", *trees, "ratio"]]

    def compared(name: str, values: dict[str, float], digits: int = 2) -> None:
        ratio = f"{values[old] / values['this commit']:.1f}" if old else "-"
        rows.append([name, *(f"{value:.{digits}f}" for value in values.values()), ratio])

    chain: dict[str, dict[str, float]] = {"one": {}, "six": {}}
    for name, tree in trees.items():
        short = name == old
        chain["one"][name] = float(probe(CHAIN, given.one, 60 if short else 360, 2 if short else 5, tree=tree))  # type: ignore[arg-type]
        chain["six"][name] = float(probe(CHAIN, given.six, 30 if short else 240, 1 if short else 3, tree=tree))  # type: ignore[arg-type]
    compared("chain, one marker: CPU ms a marker and frame", chain["one"])
    compared("chain, six markers: the same", chain["six"])
    sizes = {name: probe(SIZE, tree=tree) for name, tree in trees.items()}
    for r in ("24", "240"):
        compared(f"a step at r = {r} px: CPU ms", {name: one[r] for name, one in sizes.items()})  # type: ignore[index]
    grown = {name: one["240"] / one["24"] for name, one in sizes.items()}  # type: ignore[index]
    rows.append(["r = 240 against r = 24", *(f"{value:.1f} x" for value in grown.values()), "-"])
    compared("`spheremcap --help`: CPU s", {name: help_seconds(tree) for name, tree in trees.items()})
    parts = ["# Performance", f"Machine: {machine()}."]
    parts.append(f"Command: `python benchmarks/speed.py {' '.join(_told(given))}`.")
    parts += ["## The chain", "One thread, frames decoded before, nothing written.", layout(rows, markdown=True)]

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = [["", "frames/s", "of decoding alone", "decoding alone, frames/s"]]
        for label, home in (("one marker", given.one), ("six markers", given.six)):
            video = repeated(home / "session.mp4", 1800, folder / f"{label}.mp4")
            one = probe(TRACK, video, home, folder / "out.mcap", 2)
            rate, alone = one["track"], one["decode"]  # type: ignore[index]
            whole.append([label, f"{rate:.0f}", f"{rate / alone:.2f}", f"{alone:.0f}"])
        parts += [
            "## From video to finished MCAP",
            "1,800 frames, video passed through, debug pictures on, after start-up (imports, compiled code from the "
            f"cache): {one['begun']:.1f} s of CPU.",  # type: ignore[index]
            layout(whole, markdown=True),
        ]
        if given.peers:
            ours = chain["one"]["this commit"]
            peers = [["tracker", "ms a frame and marker", "times ours"], ["spheremcap", f"{ours:.2f}", "1.00"]]
            times = peer_times(given.peers, given.one, folder)
            peers += [[tracker, f"{ms:.2f}", f"{ms / ours:.2f}"] for tracker, ms in times.items()]
            about = "The same session in the same run, without decoding, re-seeded at failures, one thread."
            parts += ["## Other trackers", about, layout(peers, markdown=True)]
        if given.memory:
            memory = [["frames", "peak MB", "frames/s"]]
            for frames in given.memory:
                video = repeated(given.six / "session.mp4", frames, folder / f"{frames}.mp4")
                one = probe(TRACK, video, given.six, folder / "out.mcap", 1)
                memory.append([f"{frames:,}", f"{one['peak']:.0f}", f"{one['track']:.0f}"])  # type: ignore[index]
            parts += ["## Memory", "Six markers, as above, once.", layout(memory, markdown=True)]
    text = "\n\n".join(parts) + "\n"
    if given.output:
        given.output.write_text(text, encoding="utf-8")
    print(text)


def _told(given: argparse.Namespace) -> list[str]:
    """The command's own arguments, without where things lie."""
    told = [given.one.name, given.six.name]
    told += ["--against", given.against.name] if given.against else []
    told += ["--peers", "PYTHON"] if given.peers else []
    return told


if __name__ == "__main__":
    main()
