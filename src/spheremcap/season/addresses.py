"""Inputs that lie behind an address instead of a path, as fsspec understands it: s3://, gs://, sftp://, file:// and so
on. They are copied to where a session is made, and read there like any other.
"""

import hashlib
import importlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

from spheremcap.errors import SourceError, UsageError, short

_COPIED_BYTES = 8 << 20
_MARKS = (
    "ETag", "etag", "Content-MD5", "Digest", "md5Hash", "crc32c", "generation", "VersionId", "Last-Modified",
    "LastModified", "last_modified", "modified", "updated", "mtime",
)  # fmt: skip
"""What keepers say of a file that is another one when its content is; others count when it was read."""


def is_address(path: str) -> bool:
    """Whether it is no path."""
    return "://" in path


def looked_at(address: str) -> tuple[int, str]:
    """Bytes of what is there, and a text that is another one when it has changed, by what its keeper says of it (size,
    date, version, checksum). Raises SourceError, UsageError."""
    filesystem, place = _there(address)
    try:
        filesystem.invalidate_cache()
        told = filesystem.info(place)
        said = [f"{key}: {told[key]}" for key in _MARKS if told.get(key) is not None] or filesystem.ukey(place)
        size = int(told.get("size") or 0)
        return size, hashlib.sha256(f"{size} {said}".encode()).hexdigest()
    except Exception as error:
        raise _gone(address, error) from error


def fetched(address: str, folder: Path, going_on: Callable[[], None] = lambda: None) -> Path:
    """A copy of what is there, in `folder`, by its own name. `going_on` is called meanwhile, and may raise. Raises
    SourceError, UsageError."""
    filesystem, place = _there(address)
    folder.mkdir(parents=True)
    path = folder / PurePosixPath(place).name
    whole = {"block_size": 0} if address.startswith(("http://", "https://")) else {}  # not every server gives parts
    try:
        with filesystem.open(place, "rb", **whole) as there, path.open("wb") as here:
            while part := there.read(_COPIED_BYTES):
                here.write(part)
                going_on()
    except Exception as error:
        raise _gone(address, error) from error
    return path


def _there(address: str) -> tuple[Any, str]:
    try:
        core = importlib.import_module("fsspec.core")
    except ImportError:
        raise UsageError(f"{address}: addresses need fsspec: pip install 'spheremcap[cluster]'") from None
    try:
        filesystem, place = core.url_to_fs(address)
    except ImportError as error:  # a protocol whose own package is not there
        raise UsageError(f"{address}: cannot be read as it is: {short(error)}") from error
    except Exception as error:
        raise _gone(address, error) from error
    return filesystem, str(place)


def _gone(address: str, error: Exception) -> SourceError:
    """Every keeper has errors of its own."""
    if isinstance(error, FileNotFoundError):
        cause = "" if error.__cause__ is None else f" ({short(error.__cause__)})"  # a server that does not answer, too
        return SourceError(f"{address}: nothing is there{cause}; check the address")
    return SourceError(f"{address}: cannot be read: {type(error).__name__}: {short(error)}")
