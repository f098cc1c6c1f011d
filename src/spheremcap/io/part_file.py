"""OUT.part, the file that becomes OUT when it is whole; and what is said when it cannot be written."""

import errno
import os
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer
from mcap.writer import MCAP0_MAGIC

from spheremcap.errors import OutputError, UsageError


class PartFile:
    """The file under OUT.part. Every write is a run of whole MCAP records, all of it or none of it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO = open(path, "wb", buffering=0)  # noqa: SIM115
        self._ended = False

    def write(self, data: bytes) -> int:
        start = self._file.tell()
        try:
            left = memoryview(data)
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            self._file.seek(start)
            self._file.truncate()
            raise
        self._ended = data[:1] == b"\x0f"
        return len(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        pass

    def seal(self) -> None:
        """End a file whose writer failed: no index, but every reader takes it."""
        tail = RecordBuilder()
        if not self._ended:
            DataEnd(0).write(tail)
        Footer(0, 0, 0).write(tail)
        self.write(tail.end() + MCAP0_MAGIC)  # type: ignore[no-untyped-call]

    def close(self) -> None:
        self._file.close()


def part_of(path: Path, overwrite: bool) -> Path:
    """OUT.part for OUT. Raises UsageError when OUT is a folder, or exists and `overwrite` is False."""
    if path.is_dir():
        raise UsageError(f"{path} is a folder: name a file to write")
    if path.exists() and not overwrite:
        raise UsageError(f"{path} exists already: name another file or pass --overwrite")
    return path.with_name(path.name + ".part")


def output_error(error: OSError, path: Path) -> OutputError:
    """The one-line error for a file that cannot be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return OutputError(f"{path}: {os.strerror(error.errno)}: free some space and run again")
    if isinstance(error, FileNotFoundError):
        return OutputError(f"{path}: there is no folder {path.parent}: create it first")
    return OutputError(f"{path}: cannot be written: {error.strerror or error}")
