"""What a file says of itself by its name, its head or its own words, without reading all of it where that will do."""

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av

from spheremcap.errors import SpheremcapError
from spheremcap.io.video import open_video, start_of
from spheremcap.merging.sensors import TABLE_ENDINGS, read_sensors
from spheremcap.merging.tables import open_table
from spheremcap.season.outcome import RECORDING, REPORT, RUN, SESSIONS, read_outcome

_TEXTS = (".csv", ".tsv", ".txt", ".data")
_OURS = (".events.csv", ".strokes.csv", ".mean_cycle.csv")
_HEAD_BYTES = 64 << 10


@dataclass(frozen=True)
class Facts:
    """What a video says of itself, as in Found; `camera`: it has its calibration with it."""

    start_ns: int | None = None
    duration_s: float | None = None
    size: tuple[int, int] | None = None
    rate: Fraction | None = None
    camera: bool = False


def video_facts(path: Path) -> Facts:
    """What a container's head says. Raises SourceError."""
    container, stream = open_video(path)
    with container:
        start_ns, source = start_of(container, stream, None)
        length_s: Fraction | None = None
        if stream.duration and stream.time_base:
            length_s = stream.duration * stream.time_base
        elif container.duration:
            length_s = Fraction(container.duration, av.time_base)
        size = (stream.codec_context.width, stream.codec_context.height)
        return Facts(
            None if source == "zero" else start_ns, None if length_s is None else float(length_s), size,
            stream.average_rate or None,
        )  # fmt: skip


def is_output(folder: Path) -> bool:
    """Whether a folder is a session's result, or has the tables of a season."""
    if all(os.path.isfile(folder / name) for name in (SESSIONS, REPORT)):
        return True
    there = os.path.isfile(folder / RUN)
    return there and (os.path.isfile(folder / RECORDING) or read_outcome(folder) is not None)


def is_ours(path: Path) -> bool:
    """Whether a table was written by us (truth, events, exports), or is no file that could be read as one."""
    try:
        if (path.exists() and not path.is_file()) or path.name.lower().endswith(_OURS):
            return True
        if path.suffix.lower() == ".parquet":
            names = set(open_table(path).names)
        else:
            with path.open("rb") as file:
                head = file.read(_HEAD_BYTES)
            if path.suffix.lower() == ".c3d":
                return b"SPHEREMCAP" in head
            names = set(re.split("[,;]", head.decode("utf-8-sig", "replace").partition("\n")[0].strip()))
    except (OSError, SpheremcapError):  # which will be said
        return False
    return "marker" in names and not names.isdisjoint({"stamp_ns", "UTC"})


@contextmanager
def head_of(path: Path) -> Iterator[tuple[Path, str]]:
    """A log, or a device's folder, of which only the beginning is there, where that is text: where, and what stands
    before the file's own path there."""
    there = path.rglob("*") if os.path.isdir(path) else [path]
    texts = [text for text in there if text == path or (text.suffix.lower() in TABLE_ENDINGS and os.path.isfile(text))]
    if not all(text.suffix.lower() in _TEXTS for text in texts):
        yield path, ""
        return
    with tempfile.TemporaryDirectory() as folder:
        for text in texts:
            copy = Path(f"{folder}{text}")  # makers are told by the names of files and folders
            copy.parent.mkdir(parents=True, exist_ok=True)
            try:
                with text.open("rb") as file:
                    head = file.read(_HEAD_BYTES)
            except OSError:  # reading it says why
                yield path, ""
                return
            cut = head.rfind(b"\n") + 1 if len(head) == _HEAD_BYTES else 0
            copy.write_bytes(head[: cut or len(head)])
        yield Path(f"{folder}{path}"), folder


def span_of(path: Path) -> tuple[int, int] | None:
    """First and last stamp (Unix time, ns) of a log; None where its times count from something else."""
    logs = [log for log in read_sensors(path) if log.timing.zero == "1970" and len(log)]
    return (min(int(log.stamp_ns[0]) for log in logs), max(int(log.stamp_ns[-1]) for log in logs)) if logs else None
