"""docs/sensors.md: every maker's header lines are read, and the mapping that is shown does the same."""

import re
from pathlib import Path

import numpy as np
import pytest

from spheremcap.errors import UsageError
from spheremcap.merging.log import SensorLog
from spheremcap.merging.makers import TABLES
from spheremcap.merging.mapping import load_mapping
from spheremcap.merging.sensors import read_sensors

PAGE = (Path(__file__).parents[2] / "docs" / "sensors.md").read_text(encoding="utf-8")
SECTIONS = re.findall(r"^### (.+?)\n(.*?)(?=^### |\Z)", PAGE, re.MULTILINE | re.DOTALL)


def files(section: str, folder: Path) -> tuple[Path, Path]:
    """The section's table and mapping, written down."""
    name, table = re.findall(r"^```csv (\S+)\n(.*?)^```", section, re.MULTILINE | re.DOTALL)[0]
    (mapping,) = re.findall(r"^```toml\n(.*?)^```", section, re.MULTILINE | re.DOTALL)
    (folder / name).write_text(table, encoding="utf-8")
    (folder / "mapping.toml").write_text(mapping, encoding="utf-8")
    return folder / name, folder / "mapping.toml"


def same(a: SensorLog, b: SensorLog) -> bool:
    if (a.kind, a.frame_id, sorted(a.values)) != (b.kind, b.frame_id, sorted(b.values)):
        return False
    steps = np.array_equal(np.diff(a.stamp_ns), np.diff(b.stamp_ns))
    return steps and all(np.allclose(a.values[name], b.values[name]) for name in a.values)


@pytest.mark.parametrize(("title", "section"), SECTIONS, ids=[title for title, _ in SECTIONS])
def test_what_the_page_shows_is_read(title: str, section: str, tmp_path: Path) -> None:
    path, mapping = files(section, tmp_path)
    (by_mapping,) = read_sensors(path, mapping=load_mapping(mapping))
    assert len(by_mapping) == 2
    assert by_mapping.kind in ("imu", "wheel")
    assert (np.diff(by_mapping.stamp_ns) > 0).all()
    if "as it is" in title:
        (as_it_is,) = read_sensors(path, rate_hz=240 if "--rate" in title else None)
        assert same(as_it_is, by_mapping)
    else:
        try:
            kinds = {log.kind for log in read_sensors(path)}
        except UsageError:
            kinds = {"record"}
        assert kinds == {"record"}  # not understood


def test_every_maker_has_its_place_on_the_page() -> None:
    assert len(SECTIONS) >= 9
    for matches, _ in TABLES:
        name = matches.__module__.rpartition(".")[2].split("_")[0]
        assert any(name in title.lower() for title, _ in SECTIONS), name


def test_the_mapping_at_the_head_is_one(tmp_path: Path) -> None:
    (text, *_) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    (tmp_path / "m.toml").write_text(text)
    assert load_mapping(tmp_path / "m.toml").time.unit == "us"
