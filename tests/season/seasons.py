"""Small seasons: sessions of two balls over a background, each with whatever is to be wrong with it."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tomli_w

from clips import seed, write_clip
from scenes import CAMERA
from spheremcap.config import parse_seed, seeds_toml
from spheremcap.season.outcome import WORK
from spheremcap.season.worker import PROGRESS

SETTINGS: dict[str, Any] = {
    "camera": {
        "width_px": CAMERA.width_px, "height_px": CAMERA.height_px, "fx_px": CAMERA.fx_px,
        "fy_px": CAMERA.fy_px, "cx_px": CAMERA.cx_px, "cy_px": CAMERA.cy_px,
    },
    "output": {"debug_images": "none"},
}  # fmt: skip


def write_seeds(path: Path, *seeds: str) -> Path:
    path.write_text(seeds_toml([parse_seed(one) for one in seeds or (seed("orange"), seed("blue", 1))]))
    return path


def write_session(folder: Path, count: int = 16, *, seeds: bool = True) -> dict[str, Any]:
    """A video with its settings and seeds beside it; what the manifest says of it."""
    folder.mkdir(parents=True)
    write_clip(folder / "v.mp4", count)
    (folder / "settings.toml").write_text(tomli_w.dumps(SETTINGS))
    if seeds:
        write_seeds(folder / "v.seeds.toml")
    return {"video": f"{folder.name}/v.mp4", "settings": f"{folder.name}/settings.toml"}


def write_manifest(folder: Path, sessions: dict[str, dict[str, Any]], **tables: Any) -> Path:
    path = folder / "season.toml"
    path.write_text(tomli_w.dumps({**tables, "sessions": [{"name": name} | said for name, said in sessions.items()]}))
    return path


def dataset(*arguments: object, **more: Any) -> "subprocess.CompletedProcess[str]":
    """A command as a person gives it."""
    command = [sys.executable, "-m", "spheremcap", "dataset", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, **more)


def in_work(out: Path, name: str, step: str = "tracking", *, wait_s: float = 120) -> int:
    """The process of a session, once it has come to that step."""
    until = time.monotonic() + wait_s
    while time.monotonic() < until:
        try:
            told = json.loads((out / name / WORK / PROGRESS).read_text())
            if told["step"] == step:
                return int(told["pid"])
        except (OSError, ValueError):
            pass
        time.sleep(0.02)
    raise AssertionError(f"{name} did not come to {step}")


def gone(pid: int, *, wait_s: float = 20) -> bool:
    """Whether a process has ended."""
    until = time.monotonic() + wait_s
    while time.monotonic() < until:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        if Path(f"/proc/{pid}/stat").exists() and Path(f"/proc/{pid}/stat").read_text().split()[2] == "Z":
            return True
        time.sleep(0.05)
    return False


def kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)


def files(folder: Path, wanted: Callable[[Path], bool] = lambda path: True) -> dict[str, bytes]:
    """The content of all files below a folder, by their names."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and wanted(path)
    }
