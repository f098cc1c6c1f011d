"""What an interrupted run left, or any damaged MCAP, into a whole recording with an index."""

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode

from spheremcap.errors import UsageError
from spheremcap.io.input_file import MCAP_MAGIC as MAGIC
from spheremcap.io.join import McapStream, Merged, merge_streams
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import in_use

_FOOTER = struct.Struct("<BQQQI")


@dataclass(frozen=True)
class Recovered:
    """What was recovered, and `lost`: what could not be, or never was in the file, a line each."""

    merged: Merged
    lost: tuple[str, ...]


def recover(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> Recovered:
    """Copy every message, metadata record and attachment that can be read into a new file, by log time.

    Raises SourceError when there is no MCAP record at all, UsageError when a run is still writing the file, or the
    output exists or is the input, OutputError when it cannot be written.
    """
    path = Path(path)
    if in_use(path):
        raise UsageError(f"{path}: a run is still writing it: wait for it, or end it with Ctrl-C")
    with McapRecords(path) as records:
        merged = merge_streams([McapStream(records)], output, overwrite=overwrite, progress=progress, stop=stop)
        lost = list(merged.lost)
        if any("no footer" in loss.what for loss in records.lost):
            lost.append(f"{path}: the run was cut off: what it had not written yet is lost, up to a second of log time")
        elif records.library.startswith("spheremcap/") and _sealed(path):
            lost.append(f"{path}: the run could not write to its end (was the disk full?): what did not fit is lost")
    return Recovered(merged, tuple(lost))


def _sealed(path: Path) -> bool:
    """Whether the file ends with a footer that knows of no index."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _FOOTER.size - len(MAGIC)))
        tail = file.read(_FOOTER.size)
    if len(tail) < _FOOTER.size:
        return False
    opcode, _, summary_start, _, _ = _FOOTER.unpack(tail)
    return bool(opcode == Opcode.FOOTER and summary_start == 0)
