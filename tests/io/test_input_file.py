"""A small file that a person wrote is read whole, or refused in one line."""

from pathlib import Path

import pytest

from spheremcap.errors import SettingsError
from spheremcap.io.input_file import settings_bytes


def test_a_file_of_just_the_largest_size_is_read_and_one_byte_more_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(bytes(2048))
    assert settings_bytes(path, "a TOML file", 2048) == bytes(2048)
    with pytest.raises(SettingsError, match="not a TOML file: larger than 1 kB"):
        settings_bytes(path, "a TOML file", 2047)


def test_a_folder_and_a_missing_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="is a folder, not a TOML file"):
        settings_bytes(tmp_path, "a TOML file", 10)
    with pytest.raises(SettingsError, match="no such file"):
        settings_bytes(tmp_path / "no.toml", "a TOML file", 10)
