"""docs/analysis.md: every setting is in its table as the classes have it, and every column and field that comes out."""

import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from spheremcap.analysis.cycles import SHOWN
from spheremcap.analysis.settings import JOINTS, SIDES, AnalysisSettings, PointSettings
from spheremcap.core.stage import StageConfig
from spheremcap.core.stroke import Stroke, StrokeEvent
from spheremcap.io import _pb

PAGE = (Path(__file__).parents[2] / "docs" / "analysis.md").read_text(encoding="utf-8")


def rows(kind: type[StageConfig], before: str = "") -> list[str]:
    """The lines of the table of settings."""
    found = []
    for name, field in kind.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, StageConfig):
            found += rows(field.annotation, f"{before}{name}.")
            continue
        shown = "needed" if field.is_required() else "–" if field.default in (None, (), {}) else field.default
        shown = str(shown).lower() if isinstance(shown, bool) else shown
        found.append(f"| `{before}{name}` | {shown} | {field.description} |")
        if name == "points":
            found += rows(PointSettings, f"{before}{name}.")
    return found


def section(title: str) -> str:
    return re.search(rf"^(?:## |\*\*){re.escape(title)}.*?\n(.*?)(?=^## |^\*\*|\Z)", PAGE, re.MULTILINE | re.DOTALL)[1]


def test_every_setting_is_in_the_table_as_the_classes_have_it():
    expected = rows(AnalysisSettings)
    shown = [line for line in section("The settings").splitlines() if line.startswith("| `")]
    assert shown == expected, "\n".join(expected)


def test_the_example_is_taken():
    (text,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    given = AnalysisSettings.model_validate(tomllib.loads(text))
    assert given.markers == {"left_wrist": "green"}
    assert given.chair.camera_xyz_chair_m is not None


@pytest.mark.parametrize(
    ("title", "names"),
    [
        ("StrokeEvent", [field.name for field in fields(StrokeEvent)]),
        ("Stroke**", [field.name for field in fields(Stroke)]),
        ("ArmSample", [f.name for f in _pb.ArmSample.DESCRIPTOR.fields if f.name != "timestamp"]),
        ("TrunkSample", [f.name for f in _pb.TrunkSample.DESCRIPTOR.fields if f.name != "timestamp"]),
        ("mean_cycle.csv", ["side", "quantity", "percent", "mean", "sd", "cycles", *SHOWN]),
    ],
)
def test_every_column_and_field_is_explained(title, names):
    told = re.findall(r"`(\w+)`", section(title))
    assert set(names) <= set(told), set(names) - set(told)


def test_every_name_of_a_marker_is_on_the_page():
    for side in SIDES:
        for joint in JOINTS:
            assert f"`{side}_{joint}`" in PAGE
