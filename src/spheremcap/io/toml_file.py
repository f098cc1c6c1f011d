"""TOML from a file, and what is wrong with it in one line."""

import os
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from spheremcap.errors import SettingsError


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """A file's table; a byte order mark before it does not matter. Raises SettingsError."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise SettingsError(f"{path}: no such file") from None
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path}: not TOML: byte {error.start} is not UTF-8 text; save it as UTF-8") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsError(f"{path}: not TOML: {error}") from error


def first_problem(error: ValidationError) -> str:
    """The first key that is wrong, and why."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"unknown key {key!r}"
    return f"{key}: {first['msg']} (found {first['input']!r})" if key else str(first["msg"])
