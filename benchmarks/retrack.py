"""What one answer in half an hour of 240 pictures a second costs: `spheremcap retrack` beside copying the file.

usage: python benchmarks/retrack.py [--frames 432000] [--lost 500] [--width 640]

A short clip, which ends as it begins, is tracked once; the recording is made of that by repetition, with its passed
through pictures. In the middle the marker is lost for so many frames. The answer is a circle in the middle of those.
Each command is a process of its own, and the file is in the page cache, for both.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from scenes import ORANGE, ball_at, picture, truth
from spheremcap import api
from spheremcap.config import CameraSettings, MarkerSettings, Settings, load_settings, seeds_toml
from spheremcap.core.camera import Camera
from spheremcap.core.estimate import FrameResult, MarkerEstimate, Status
from spheremcap.core.marker import Seed
from spheremcap.io.encode import write_video
from spheremcap.io.mcap_log import McapLog, RunInfo
from spheremcap.io.video import VideoSource
from spheremcap.session import Session

RATE_HZ = 240
CYCLE = 120  # frames after which the ball is where it was


def ball(k: int, camera: Camera):  # type: ignore[no-untyped-def]
    turn = 2 * np.pi * k / CYCLE
    x, y = camera.cx_px + 0.3 * camera.width_px * np.cos(turn), camera.cy_px + 0.25 * camera.height_px * np.sin(turn)
    return ball_at(x, y, 15, camera=camera, rgb=ORANGE)


def make(folder: Path, frames: int, lost: range, width_px: int) -> tuple[Path, Seed]:
    """The recording and the answer to it."""
    camera = Camera(width_px, width_px * 9 // 16, 1000.0, 1000.0, (width_px - 1) / 2, (width_px * 9 // 16 - 1) / 2)
    settings = Settings(
        camera=CameraSettings(
            width_px=camera.width_px, height_px=camera.height_px, fx_px=camera.fx_px, fy_px=camera.fy_px,
            cx_px=camera.cx_px, cy_px=camera.cy_px,
        ),
        markers=(MarkerSettings(name="wrist"),),
    )  # fmt: skip
    clip, once, out = folder / "clip.mp4", folder / "once.mcap", folder / "long.mcap"
    shown = [picture(ball(k, camera), camera=camera, noise_seed=k) for k in range(CYCLE)]
    write_video(clip, shown * 3, Fraction(RATE_HZ), creation_time="2025-06-01T10:00:00Z")
    c = truth(ball(0, camera), camera)
    seed = Seed("wrist", 0, c)
    api.track(clip, once, settings, [seed])
    recording = api.open(once)
    (folder / "settings.toml").write_text(recording.settings_toml)
    settings = load_settings(folder / "settings.toml")
    with VideoSource(clip) as source:
        pictures = list(source.frames())
    chain = Session(camera, [settings.markers[0].spec()], [seed], settings.chain, settings.session)
    cycle = list(chain.run(pictures))[CYCLE : 2 * CYCLE]
    encoded = [frame.encoded for frame in pictures[CYCLE : 2 * CYCLE]]
    known = {
        "version",
        "input_name",
        "input_size",
        "input_sha256",
        "time_source",
        "video",
        "frames",
        "lost",
        "complete",
    }
    more = {
        k: v
        for k, v in recording.info.items()
        if k not in known and not k.startswith(("camera_s", "camera_f", "marker."))
    }
    run = RunInfo(
        "long.mp4", 1, recording.info["input_sha256"], recording.info["time_source"], recording.info["video"],
        recording.settings_toml, seeds_toml([seed]), more,
    )  # fmt: skip
    start_ns = pictures[0].stamp_ns
    with McapLog(out, camera=camera, markers=[settings.markers[0].spec()], run=run) as log:
        for k in range(frames):
            result, stamp_ns = cycle[k % CYCLE], start_ns + k * 1_000_000_000 // RATE_HZ
            log.write(_moved(result, k, stamp_ns, k in lost), encoded[k % CYCLE])
    middle = (lost.start + lost.stop) // 2
    return out, Seed("wrist", middle, truth(ball(middle, camera), camera), "anna", "2026-11-30T03:31:00Z")


def _moved(result: FrameResult, index: int, stamp_ns: int, lost: bool) -> FrameResult:
    (estimate,) = result.estimates
    estimate = replace(estimate, frame_index=index, stamp_ns=stamp_ns)
    if lost:
        estimate = MarkerEstimate("wrist", index, stamp_ns, Status.LOST, reasons=("not found",))
    smoothed = tuple(replace(pose, frame_index=index, stamp_ns=stamp_ns) for pose in result.smoothed)
    return FrameResult(index, stamp_ns, (estimate,), () if lost else smoothed)


_APART = """
import os, resource, subprocess, sys, time
started = time.monotonic()
code = subprocess.run(sys.argv[1:]).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(time.monotonic() - started, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, file=sys.stderr)
sys.exit(code)
"""


def measured(words: list[str]) -> tuple[float, float, float]:
    """Seconds on the clock, seconds of processors, and megabytes at most, of a command. A small process starts it: one
    begins with the memory of what it was forked from, and this one is large."""
    done = subprocess.run([sys.executable, "-c", _APART, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    print(done.stdout, end="")
    seconds, busy, megabytes = map(float, done.stderr.splitlines()[-1].split())
    return seconds, busy, megabytes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=432_000)
    parser.add_argument("--lost", type=int, default=500)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--keep", type=Path, help="a folder to make the recording in, and to find it in again")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = given.keep or Path(name)
        middle = given.frames // 2
        lost = range(middle - given.lost // 2, middle + given.lost // 2)
        folder.mkdir(exist_ok=True)
        if not (folder / "answers.toml").exists():
            recording, answer = make(folder, given.frames, lost, given.width)
            (folder / "answers.toml").write_text(seeds_toml([answer]))
        recording = folder / "long.mcap"
        size_mb = recording.stat().st_size / 1e6
        print(f"{given.frames} frames, {size_mb:.0f} MB, lost for {given.lost}")
        empty = measured([sys.executable, "-c", "import spheremcap.api"])
        copied, copying, _ = measured(["cp", str(recording), str(folder / "copy.mcap")])
        (folder / "copy.mcap").unlink()
        command = [sys.executable, "-m", "spheremcap", "retrack", str(recording), "--overwrite"]
        seconds, busy, megabytes = measured(
            [*command, "--seeds", str(folder / "answers.toml"), "-o", str(folder / "out.mcap")]
        )
        print(f"cp: {copied:.1f} s, {copying:.1f} s of processors")
        print(f"retrack: {seconds:.1f} s, {busy:.1f} s of processors, {megabytes:.0f} MB at most")
        print(f"of that Python and the libraries alone: {empty[0]:.1f} s, {empty[1]:.1f} s, {empty[2]:.0f} MB")
        started = time.monotonic()
        stretch = api.stretch_of(recording, _answer(folder))
        print(f"stretch_of: {time.monotonic() - started:.1f} s, frames {stretch.frames[0]} to {stretch.frames[-1]}")


def _answer(folder: Path) -> Seed:
    from spheremcap.config import load_seeds

    (answer,) = load_seeds(folder / "answers.toml")
    assert isinstance(answer, Seed)
    return answer


if __name__ == "__main__":
    main()
