"""A file that is read: what it has to be before anything opens it."""

import os
from pathlib import Path

from spheremcap.errors import SettingsError, SourceError

MCAP_MAGIC = b"\x89MCAP0\r\n"


def checked_input(path: Path, what: str) -> int:
    """The size in bytes of a file that can be opened; `what` it should be, as in "a video". Raises SourceError.

    A pipe is refused, since it can be read once only and waits for whoever writes.
    """
    try:
        if path.is_dir():
            raise SourceError(f"{path}: is a folder, not {what}; name one file in it")
        if not path.exists():
            raise SourceError(f"{path}: no such file; check the name")
        if not path.is_file():
            raise SourceError(f"{path}: is a pipe or device, not {what}; save what comes from it as a file first")
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
    except OSError as error:
        raise SourceError(f"{path}: cannot be opened: {error.strerror}") from error
    if size == 0:
        raise SourceError(f"{path}: is empty (0 bytes); copy it again")
    return size


def settings_bytes(path: Path, what: str, most_bytes: int) -> bytes:
    """All of a small file that a person wrote; `what` it should be, as in "a YAML". Raises SettingsError."""
    try:
        if not path.exists():
            raise SettingsError(f"{path}: no such file")
        if not path.is_file():
            raise SettingsError(f"{path}: is {'a folder' if path.is_dir() else 'no regular file'}, not {what}")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > most_bytes:
        raise SettingsError(f"{path}: not {what}: larger than {most_bytes >> 10} kB")
    return data


def is_recording(path: Path) -> bool:
    """Whether an input is taken as MCAP: by its name or its first bytes."""
    if path.suffix.lower() == ".mcap":
        return True
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(5) == MCAP_MAGIC[:5]
    except OSError as error:
        raise SourceError(f"{path}: cannot be opened: {error.strerror}") from error
