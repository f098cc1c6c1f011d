"""TOML from a file, and what is wrong with it in one line."""

import os
import re
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from spheremcap.errors import SettingsError, short
from spheremcap.io.input_file import settings_bytes

_LARGEST_TOML_BYTES = 16 << 20
_COMMA = re.compile(r"=\s*[-+]?\d+,\d")


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The tables of a TOML file; a byte order mark is passed over. Raises SettingsError."""
    text = toml_text(path)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise SettingsError(f"{path}: not TOML that anybody wrote: its values are nested too deeply") from None
    except ValueError as error:  # tomllib's own, or Python's for a number of thousands of digits
        line = re.search(r"at line (\d+)", str(error))
        wrong = text.splitlines()[int(line[1]) - 1] if line is not None else ""
        hint = "; decimals have a point, as in 0.04" if _COMMA.search(wrong) else ""
        raise SettingsError(f"{path}: not TOML: {short(error)}{hint}") from error


def toml_text(path: str | os.PathLike[str]) -> str:
    """The text of a TOML file without its byte order mark, line ends as they are. Raises SettingsError."""
    path = Path(path)
    data = settings_bytes(path, "a TOML file", _LARGEST_TOML_BYTES)
    utf16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        return data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path}: not TOML: byte {error.start} is not UTF-8 text; save it as UTF-8") from error


def first_problem(error: ValidationError, known_keys: str = "") -> str:
    """One line about the first thing that is wrong: its key, what was expected and what was found; `known_keys` says
    behind an unknown key where the others are listed.
    """
    first = error.errors(include_url=False)[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"unknown key {short(key)}{known_keys}"
    message = " ".join(str(first["msg"]).removeprefix("Value error, ").split())
    return f"{key}: {message} (found {short(first['input'])})" if key else message
