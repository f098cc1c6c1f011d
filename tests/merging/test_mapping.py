"""The mapping to start from: what the header says is in it, what it does not say is there and empty."""

import tomllib
from pathlib import Path

import pytest

from spheremcap.merging.mapping import TableMapping, UnreadTableError
from spheremcap.merging.sensors import read_sensors


def printed(path: Path, text: str) -> dict[str, object]:
    """The mapping that an error has for a table, which can be loaded as it is."""
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadTableError) as caught:
        read_sensors(path)
    found = tomllib.loads(caught.value.mapping)
    TableMapping.model_validate(found)
    return found


def test_quantities_units_and_kind_are_taken_over(tmp_path: Path) -> None:
    found = printed(
        tmp_path / "imu.csv",
        "t;Acc X (g);Acc Y (g);Acc Z (g);Drehrate X;Drehrate Y;Drehrate Z;qw;qx;qy;qz;Batterie\n"
        "0;0;0;1;1;2;3;1;0;0;0;3,7\n1;0;0;1;1;2;3;1;0;0;0;3,7\n",
    )
    assert found == {
        "kind": "imu",
        "time": {"column": "t", "unit": ""},
        "columns": {
            "linear_acceleration": {"columns": ["Acc X (g)", "Acc Y (g)", "Acc Z (g)"], "unit": "g"},
            "angular_velocity": {"columns": ["Drehrate X", "Drehrate Y", "Drehrate Z"], "unit": ""},
            "orientation": {"columns": ["qw", "qx", "qy", "qz"], "unit": "1"},
        },
    }


def test_columns_without_names_are_numbers_and_the_first_that_rises_is_the_time(tmp_path: Path) -> None:
    found = printed(tmp_path / "bare.csv", "7,0,1.5\n7,10,1.25\n7,20,1.5\n")
    assert found["time"] == {"column": 2, "unit": ""}
    assert found["columns"] == {"column_1": {"columns": [1]}, "column_3": {"columns": [3]}}


def test_names_that_are_there_twice_are_numbers_too(tmp_path: Path) -> None:
    found = printed(tmp_path / "twice.csv", "n,load,load\n5,1,2\n5,1,2\n")
    assert found["time"] == {"rate_hz": 100.0}
    assert found["columns"] == {
        "n": {"columns": ["n"]}, "column_2": {"columns": [2]}, "column_3": {"columns": [3]},
    }  # fmt: skip


def test_dates_need_no_unit(tmp_path: Path) -> None:
    found = printed(tmp_path / "d.csv", "wann;Winkel\n14.07.2025 10:00:00;1,5\n14.07.2025 10:00:01;2\n")
    assert found["time"] == {"column": "wann", "unit": "date"}
    assert found["columns"] == {"angle": {"columns": ["Winkel"], "unit": ""}}
