"""How fast the tracker is and how much memory it takes, on the machine that this runs on.

python benchmarks/speed.py SESSION [--six SESSION] [--peers PYTHON] [-o docs/performance.md]

SESSION is a rendered session's folder (`spheremcap synth racing -o DIR`), --six one with six markers (`synth
six`). PYTHON is the interpreter that benchmarks/peers/run.sh made: OpenCV's trackers then follow the first
marker of SESSION too, for the ratios. The stages are timed from outside, by wrapping the functions that the
chain calls. Memory is the peak resident size of `spheremcap track` on 1,000 and on 10,000 frames of the same
video repeated.
"""

import argparse
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from spheremcap import appearance, chain, outline
from spheremcap.core.frame import Patch
from spheremcap.detection.colour import ColourBox
from spheremcap.evaluation.metrics import layout
from spheremcap.evaluation.protocol import Trial, load_trial
from spheremcap.io.ahead import ahead
from spheremcap.io.video import VideoSource
from spheremcap.positioning.kalman import Track3D
from spheremcap.session import Session
from spheremcap.tracking.kcf import Kcf

FUNCTIONS = (
    "geometry_scale", "hough_circles", "colour_circle", "find_edges", "fit_sphere", "match", "cast_votes",
    "make_template", "acquire", "circle_of_sphere", "sphere_of_circle", "disc_mask", "disc_pixels",
)  # fmt: skip
WAITING = "waiting for a frame"
METHODS = ((Kcf, "locate"), (Kcf, "train"), (Track3D, "predict"), (Track3D, "update"), (ColourBox, "mask"))


class Stopwatch:
    """Seconds and calls by name; time inside a stage that another stage calls is the inner one's."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        self._inner = [0.0]

    def wrap(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, timed."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                spent = time.perf_counter() - start
                self.seconds[name] += spent - self._inner.pop()
                self.calls[name] += 1
                self._inner[-1] += spent

        return timed

    def each(self, name: str, items: Iterator[Any]) -> Iterator[Any]:
        """The items, the time to get each one counted."""
        following = self.wrap(name, lambda: next(items, None))
        while (item := following()) is not None:
            yield item


@contextmanager
def stages_timed(watch: Stopwatch) -> Iterator[None]:
    """Wraps the stages where the chain calls them, and puts them back."""
    callers = (chain, outline, appearance)
    wrapped: list[tuple[Any, str]] = [(m, name) for m in callers for name in FUNCTIONS if hasattr(m, name)]
    wrapped += [*METHODS, (Patch, "__init__")]
    before = [(owner, name, getattr(owner, name)) for owner, name in wrapped]
    for owner, name, function in before:
        label = "patch to BGR" if owner is Patch else name
        label = f"{owner.__name__}.{name}" if isinstance(owner, type) and owner is not Patch else label
        setattr(owner, name, watch.wrap(label, function))
    try:
        yield
    finally:
        for owner, name, function in before:
            setattr(owner, name, function)


def follow(trial: Trial, watch: Stopwatch, markers: int | None = None) -> tuple[float, int]:
    """(seconds, frames) of decoding and tracking as `spheremcap track` does it, nothing written."""
    camera, metric = trial.camera()
    specs = trial.specs()[:markers]
    names = {spec.name for spec in specs}
    session = Session(
        camera, specs, [s for s in trial.seeds if s.marker in names], trial.settings.chain,
        trial.settings.session, exposure_s=trial.settings.camera.exposure_s, metric=metric,
        readout_s=trial.settings.camera.readout_s,
    )  # fmt: skip
    start, count = time.perf_counter(), 0
    with VideoSource(trial.video, packets=False) as source, closing(ahead(source.frames())) as frames:
        for _ in session.run(watch.each(WAITING, frames)):
            count += 1
    return time.perf_counter() - start, count


def decode(trial: Trial) -> tuple[float, int]:
    """(seconds, frames) of decoding alone."""
    start = time.perf_counter()
    with VideoSource(trial.video, packets=False) as source:
        count = sum(1 for _ in source.frames())
    return time.perf_counter() - start, count


def repeat(video: Path, frames: int, output: Path) -> None:
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


def peak_mb(trial: Trial, frames: int, folder: Path) -> tuple[float, float]:
    """(peak resident MB, seconds) of `spheremcap track` on so many frames, video passed through."""
    video = folder / f"{frames}.mp4"
    repeat(trial.video, frames, video)
    home = trial.video.parent
    code = (
        "import resource, sys, spheremcap.cli as c\n"
        "try: c.main()\n"
        "except SystemExit: pass\n"
        "print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, file=sys.stderr)\n"
    )
    command = [
        sys.executable, "-c", code, "track", str(video), "-o", str(folder / f"{frames}.mcap"),
        "-s", str(home / "settings.toml"), "--seeds", str(home / "seeds.toml"), "--overwrite",
    ]  # fmt: skip
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = re.search(r"^peak ([0-9.]+)", done.stderr, re.MULTILINE)
    if found is None:
        raise SystemExit(f"spheremcap track failed:\n{done.stderr}")
    return float(found[1]), time.perf_counter() - start


def peer_times(python: Path, session: Path, folder: Path) -> dict[str, float]:
    """ms per frame and marker of OpenCV's trackers on the session."""
    script = Path(__file__).parent / "peers" / "track.py"
    subprocess.run([str(python), str(script), str(session), str(folder)], check=True, stdout=subprocess.DEVNULL)
    rows = [line.split(",") for line in (folder / "times.csv").read_text(encoding="utf-8").splitlines()]
    return {tracker: float(each_ms) for _, tracker, _, each_ms in rows}


def machine() -> str:
    """What this runs on, in one line."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists() and (found := re.search(r"model name\s*: (.+)", info.read_text(encoding="utf-8"))):
        cpu = found[1]
    versions = f"Python {platform.python_version()}, OpenCV {cv2.__version__}, PyAV {av.__version__}"
    return f"{cpu}, {os.cpu_count()} logical CPUs, {platform.system()}, {versions}, NumPy {np.__version__}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path)
    parser.add_argument("--six", type=Path)
    parser.add_argument("--peers", type=Path)
    parser.add_argument("--threads", type=int, default=1, help="OpenCV threads (default 1)")
    parser.add_argument("--memory", type=int, nargs="*", default=[1000, 10000], help="frames; none leaves it out")
    parser.add_argument("-o", "--output", type=Path)
    given = parser.parse_args()
    cv2.setNumThreads(given.threads)
    trial = load_trial(given.session)
    parts = ["# Performance", f"Machine: {machine()}; OpenCV threads: {given.threads}."]
    parts.append(f"Command: `python benchmarks/speed.py {' '.join(_told(given))}`.")

    seconds, count = decode(trial)
    rows = [["", "frames/s", "ms a frame", "ms a frame and marker, without waiting for frames"]]
    rows.append(["decoding alone", f"{count / seconds:.0f}", f"{1000 * seconds / count:.2f}", "-"])
    measured: dict[str, float] = {}
    runs: list[tuple[str, Trial, int]] = [("one marker", trial, 1)]
    if given.six:
        six = load_trial(given.six)
        runs.append((f"{len(six.specs())} markers", six, len(six.specs())))
    for name, some, markers in runs:
        watch = Stopwatch()
        seconds, count = follow(some, watch, markers)
        own = 1000 * (seconds - watch.seconds[WAITING]) / count / markers
        measured[name] = own
        rows.append([name, f"{count / seconds:.1f}", f"{1000 * seconds / count:.2f}", f"{own:.2f}"])
    about = "Nothing is written. While one frame is tracked the next few are decoded, as in `spheremcap track`."
    parts += ["## Frames a second", about, layout(rows, markdown=True)]

    watch = Stopwatch()
    with stages_timed(watch):
        seconds, count = follow(trial, watch, 1)
    stages = [["stage", "ms a frame", "calls a frame", "% of all"]]
    for name, spent in sorted(watch.seconds.items(), key=lambda item: -item[1]):
        share = f"{100 * spent / seconds:.1f}"
        stages.append([name, f"{1000 * spent / count:.3f}", f"{watch.calls[name] / count:.2f}", share])
    rest = seconds - sum(watch.seconds.values())
    stages.append(["the rest", f"{1000 * rest / count:.3f}", "-", f"{100 * rest / seconds:.1f}"])
    parts += [
        "## Stages, one marker",
        "Timed from outside, which costs a little; a stage's time is without that of the stages it calls.",
        layout(stages, markdown=True),
    ]
    with tempfile.TemporaryDirectory() as name:
        if given.peers:
            times = peer_times(given.peers, given.session, Path(name))
            ours = measured["one marker"]
            peers = [
                ["tracker", "ms a frame and marker", "times ours"],
                ["spheremcap", f"{ours:.2f}", "1.00"],
            ]
            peers += [[tracker, f"{ms:.2f}", f"{ms / ours:.2f}"] for tracker, ms in times.items()]
            about = "The same session in the same run, without decoding, re-seeded at failures, one thread."
            parts += ["## Other trackers", about, layout(peers, markdown=True)]
        if given.memory:
            memory = [["frames", "peak MB", "s", "frames/s"]]
            for frames in given.memory:
                peak, seconds = peak_mb(trial, frames, Path(name))
                memory.append([f"{frames:,}", f"{peak:.0f}", f"{seconds:.1f}", f"{frames / seconds:.1f}"])
            markers = len(trial.specs())
            about = f"`spheremcap track` from start to finish, {markers} markers, the video passed through."
            parts += ["## Memory", about, layout(memory, markdown=True)]
    text = "\n\n".join(parts) + "\n"
    if given.output:
        given.output.write_text(text, encoding="utf-8")
    print(text)


def _told(given: argparse.Namespace) -> list[str]:
    """The command's own arguments, without where things lie."""
    told = [given.session.name]
    told += ["--six", given.six.name] if given.six else []
    told += ["--peers", "PYTHON"] if given.peers else []
    return told


if __name__ == "__main__":
    main()
