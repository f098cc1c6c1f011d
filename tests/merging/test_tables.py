"""Tables as researchers have them: encodings, decimal commas, gaps in the cells, cut ends, and any bytes."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spheremcap.errors import SourceError, SpheremcapError, UsageError
from spheremcap.merging.header import field_name, meaning
from spheremcap.merging.log import SensorLog
from spheremcap.merging.mapping import TableMapping, UnreadTableError
from spheremcap.merging.sensors import read_sensors
from spheremcap.merging.tables import open_table, split_unit

G = 9.80665
GERMAN = "Zeit [s];Beschleunigung X [m/s²];Beschleunigung Y [m/s²];Beschleunigung Z [m/s²]\r\n"
ROWS = "0,00;1,5;-2;9,81\r\n0,01;1,25;#N/A;9,81\r\n0,02;1;2;\r\n"


def one(path: Path, **options: object) -> SensorLog:
    (log,) = read_sensors(path, **options)  # type: ignore[arg-type]
    return log


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "cp1252", "utf-16", "utf-16-le", "utf-16-be"])
def test_a_german_table_in_every_encoding(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "imu.csv"
    path.write_bytes((GERMAN + ROWS).encode(encoding))
    log = one(path)
    assert log.kind == "imu"
    assert log.stamp_ns.tolist() == [0, 10_000_000, 20_000_000]
    assert log.values["linear_acceleration.x"].tolist() == [1.5, 1.25, 1.0]
    assert np.isnan(log.values["linear_acceleration.y"]).tolist() == [False, True, False]
    assert np.isnan(log.values["linear_acceleration.z"]).tolist() == [False, False, True]
    assert log.timing.how == "column 1 (Zeit [s]) in s"
    assert log.lost == ()


def test_letters_of_both_kinds_in_one_file(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes("Zeit (s),Temperatur (°C),".encode("latin-1") + "Größe (%)\n0,1,2\n1,2,3\n".encode())
    assert sorted(one(path).values) == ["groesse", "temperatur_c"]


@pytest.mark.parametrize(
    ("name", "unit", "quantity"),
    [
        ("Zeit [s]", "", ("time", "", "s")),
        ("Zeit in ms", "", ("time", "", "ms")),
        ("t/s", "", ("time", "", "s")),
        ("Zeitstempel (µs)", "", ("time", "", "µs")),
        ("Relative Time (Sekunden)", "", ("time", "", "Sekunden")),
        ("Uhrzeit", "", ("time", "", "")),
        ("Horodatage", "", ("time", "", "")),
        ("Время [s]", "", ("time", "", "s")),
        ("时间 (s)", "", ("time", "", "s")),
        ("time_ms", "", ("time", "", "ms")),
        ("Accélération X (m/s2)", "", ("linear_acceleration", "x", "m/s2")),
        ("X-Achse Beschleunigung", "g", ("linear_acceleration", "x", "g")),
        ("Drehrate Z [°/s]", "", ("angular_velocity", "z", "°/s")),
        ("Gyro.Y", "deg/s", ("angular_velocity", "y", "deg/s")),
        ("acc_x", "", ("linear_acceleration", "x", "")),
        ("Radwinkel [°]", "", ("angle", "", "°")),
        ("Drehmoment z in Nm", "", ("moment", "z", "Nm")),
        ("v/(km/h)", "", ("speed", "", "km/h")),
        ("Geschwindigkeit", "km/h", ("speed", "", "km/h")),
        ("Speed (rpm)", "", ("rate", "", "rpm")),
        ("FreeAcc_X", "", None),
        ("Note", "", None),
    ],
)
def test_what_headers_mean(name: str, unit: str, quantity: tuple[str, str, str] | None) -> None:
    assert meaning(name, unit) == quantity


def test_units_behind_names() -> None:
    assert split_unit("v/(km/h)") == ("v", "km/h")
    assert split_unit("Acc X g") == ("Acc X", "g")
    assert split_unit("Gyroscope X (deg/s)") == ("Gyroscope X", "deg/s")
    assert split_unit("Pump A") == ("Pump A", "")
    assert split_unit("km/h") == ("km/h", "")
    assert field_name("Größe (%)") == "groesse"
    assert field_name("时间") == ""


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("Speed (km/h)", 1 / 3.6),
        ("Geschwindigkeit [km/h]", 1 / 3.6),
        ("speed_kmh", 1 / 3.6),
        ("velocity (mph)", 0.44704),
        ("v in m/s", 1.0),
        ("GPS speed (knots)", 1852 / 3600),
        ("speed (cm/s)", 0.01),
    ],
)
def test_speeds_come_in_metres_a_second(tmp_path: Path, header: str, factor: float) -> None:
    (tmp_path / "v.csv").write_text(f"time (s),{header}\n0,36\n1,72\n", encoding="utf-8")
    log = one(tmp_path / "v.csv")
    (name,) = log.values
    assert name.endswith("_mps")
    assert np.allclose(log.values[name], np.array([36, 72]) * factor)


def test_names_that_fold_to_one_are_kept_apart_and_counted(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("time_s,timestamp,Pump A,pump_a,PumpA\n0,7,1,2,3\n1,8,4,5,6\n")
    log = one(tmp_path / "p.csv")
    assert {name: column.tolist() for name, column in log.values.items()} == {
        "timestamp_2": [7, 8], "pump_a": [1, 4], "pump_a_2": [2, 5], "pumpa_3": [3, 6],
    }  # fmt: skip
    (note,) = log.notes
    for word in ("'timestamp' as timestamp_2", "'pump_a' as pump_a_2", "'PumpA' as pumpa_3"):
        assert word in note


def test_what_is_left_out_of_a_typed_sample_is_said(tmp_path: Path) -> None:
    (tmp_path / "i.csv").write_text(
        "t (s),ax (g),ay (g),az (g),Barometer (hPa),acc x (g)\n0,0,0,1,1013,5\n1,0,0,1,1013,5\n"
    )
    log = one(tmp_path / "i.csv")
    assert log.notes == (f"{tmp_path / 'i.csv'}: columns that are left out: Barometer (hPa), acc x (g)",)


def test_dates_with_commas_among_decimal_commas(tmp_path: Path) -> None:
    (tmp_path / "d.csv").write_text(
        "14.07.2025;10:00:00\nZeit;Leistung\n14.07.2025, 10:00:00,5;1,5\n14.07.2025, 10:00:01;2\n"
    )
    log = one(tmp_path / "d.csv")
    assert log.stamp_ns.tolist() == [1_752_487_200_500_000_000, 1_752_487_201_000_000_000]
    assert log.values["leistung"].tolist() == [1.5, 2]


@pytest.mark.parametrize("day_first", [True, False])
def test_a_date_and_its_time_in_two_columns(tmp_path: Path, day_first: bool) -> None:
    rows = [("Datum", "Uhrzeit"), ("14.07.2025", "10:00:00"), ("14.07.2025", "10:00:01")]
    values = ("Leistung", "200,5", "201")
    lines = [";".join([*(row if day_first else row[::-1]), v]) for row, v in zip(rows, values, strict=True)]
    (tmp_path / "d.csv").write_text("\n".join(lines) + "\n")
    log = one(tmp_path / "d.csv")
    assert log.stamp_ns.tolist() == [1_752_487_200_000_000_000, 1_752_487_201_000_000_000]
    assert list(log.values) == ["leistung"]


@pytest.mark.parametrize("end", ["0.03,1", "0.03,1,2", "0.03,1,2,3", "0.03", "0.03,1,2,3,", "0.0"])
def test_a_last_line_that_is_cut_off_is_left_out_and_said(tmp_path: Path, end: str) -> None:
    path = tmp_path / "cut.csv"
    path.write_text("t (s),ax (g),ay (g),az (g),note\n0.01,0,0,1,a\n0.02,0,0,1,b\n" + end)
    log = one(path)
    assert len(log) == 2 + (end == "0.03,1,2,3,")
    assert log.lost == (() if len(log) == 3 else (f"{path}: the last line, 4, is cut off: the 2 before it are kept",))


def test_a_fault_in_the_middle_or_in_a_whole_last_line_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    for text, words in (
        ("t (s),angle (deg)\n0,1\n1\n2,3\n", "line 3: 1 columns, not 2"),
        ("t (s),angle (deg)\n0,1\n1,x\n", "line 3, column 2 .*'x' is not a number"),
        ("t (s),angle (deg)\n0,1\nx,2\n2,3\n", "line 3, column 1: 'x' is not a time"),
    ):
        path.write_text(text)
        with pytest.raises(SourceError, match=words):
            read_sensors(path)


def test_lines_without_a_time_are_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "n.csv"
    path.write_text("t (s),angle (deg)\n0,1\n,2\nNaN,3\n3,4\n")
    log = one(path)
    assert log.stamp_ns.tolist() == [0, 3 * 10**9]
    assert log.lost == (f"{path}: 2 lines without a time are left out, the first is line 3",)


def test_the_first_rows_may_have_gaps(tmp_path: Path) -> None:
    (tmp_path / "g.csv").write_text("Time (s),Power (W)\n0,\n1,NA\n2,250\n")
    log = one(tmp_path / "g.csv")
    assert log.stamp_ns.tolist() == [0, 10**9, 2 * 10**9]
    assert np.isnan(log.values["power_w"]).tolist() == [True, True, False]


def test_infinity_is_no_value(tmp_path: Path) -> None:
    (tmp_path / "i.csv").write_text("Time (s),Power (W)\n0,1\n1,inf\n2,-1e999\n")
    assert np.isnan(one(tmp_path / "i.csv").values["power_w"]).tolist() == [False, True, True]


def test_quotes_hold_delimiters_and_an_open_one_swallows_nothing(tmp_path: Path) -> None:
    (tmp_path / "q.csv").write_text(
        '"Time (s)","Power (W)",Note\n"0,5","1,5","a, b"\n"1,0","2,5","27" screen"\n"2","3",\n'
    )
    log = one(tmp_path / "q.csv")
    assert log.stamp_ns.tolist() == [500_000_000, 10**9, 2 * 10**9]
    assert log.values["power_w"].tolist() == [1.5, 2.5, 3.0]


def workbook(path: Path) -> Path:
    from datetime import datetime, timedelta

    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "empty"
    sheet = book.create_sheet("data")
    sheet.append(["Session 7"])
    sheet.append(["Zeit", "Kraft X [N]", "Kraft Y [N]", "Kraft Z [N]", "Note"])
    for k in range(3):
        at = datetime(2025, 7, 14, 10) + timedelta(milliseconds=250 * k)
        sheet.append([at, 1.5 * k, None if k == 1 else 2, "#N/A" if k == 2 else 3, "x"])
    book.save(path)
    return path


def test_excel(tmp_path: Path) -> None:
    log = one(workbook(tmp_path / "wheel.xlsx"))
    assert log.kind == "wheel"
    assert (log.stamp_ns - log.stamp_ns[0]).tolist() == [0, 250_000_000, 500_000_000]
    assert log.stamp_ns[0] == 1_752_487_200_000_000_000
    assert log.values["force.x"].tolist() == [0, 1.5, 3]
    assert np.isnan(log.values["force.y"]).tolist() == [False, True, False]
    assert np.isnan(log.values["force.z"]).tolist() == [False, False, True]


def test_excel_without_its_package_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = workbook(tmp_path / "wheel.xlsx")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(UsageError, match=r"pip install 'spheremcap\[xlsx\]'"):
        read_sensors(path)


def test_what_only_looks_like_a_sheet_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    for name, words in (("a.xlsx", "not a readable .xlsx"), ("a.xls", "save it as .xlsx"), ("a.parquet", "Parquet")):
        (tmp_path / name).write_bytes(b"PK\x03\x04 no sheet")
        with pytest.raises(SpheremcapError, match=words) as caught:
            read_sensors(tmp_path / name)
        assert "\n" not in str(caught.value)


CELLS = st.sampled_from(
    ["0", "1.5", "-2", "1e9", "1e300", "nan", "", "#N/A", "x", '"', '"a', "1,5", "Time (s)", "acc_x (g)", "t", "s", "g",
     "14.07.2025 10:00:00", "10:00:01", "2025-07-14", "angle (deg)", "time_ms", "timestamp", "µ", "\x00", "sep=;", "W"]
)  # fmt: skip
NUMBERS = st.sampled_from(["0", "1.5", "2", "-3", "", "#N/A", "1e300", "10:00:02", "1,5"])
TABLES = st.builds(
    lambda time, names, rows: [[time, *names], *rows],
    st.sampled_from(["Time (s)", "t", "time_ms", "Zeit [s]", "timestamp", "x"]),
    st.lists(CELLS, min_size=2, max_size=5),
    st.lists(st.lists(NUMBERS, min_size=2, max_size=5), min_size=1, max_size=6),
)
LINES = st.lists(st.lists(CELLS, max_size=5), max_size=8)


@settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.one_of(
        st.binary(max_size=300),
        st.builds(
            lambda lines, delimiter, end, encoding: end.join(delimiter.join(line) for line in lines).encode(encoding),
            st.one_of(LINES, TABLES),
            st.sampled_from([",", ";", "\t", " "]),
            st.sampled_from(["\n", "\r\n", "\r"]),
            st.sampled_from(["utf-8", "utf-16", "latin-1", "utf-8-sig"]),
        ),
    ),
    suffix=st.sampled_from([".csv", ".txt", ".data", "_acc_stream.csv"]),
    rate_hz=st.sampled_from([None, 240.0]),
)
def test_any_bytes_are_rows_or_one_line(tmp_path: Path, data: bytes, suffix: str, rate_hz: float | None) -> None:
    path = tmp_path / f"any{suffix}"
    path.write_bytes(data)
    try:
        logs = read_sensors(path, rate_hz=rate_hz)
    except SpheremcapError as error:
        if "\n" in str(error):
            raise
        if isinstance(error, UnreadTableError):
            TableMapping.model_validate(tomllib.loads(error.mapping))
        return
    for log in logs:
        assert len(log) > 0
        assert (np.diff(log.stamp_ns) >= 0).all()
        assert all(len(column) == len(log) for column in log.values.values())
        assert not any(np.isinf(column).any() for column in log.values.values())


def test_the_head_says_where_the_data_begins(tmp_path: Path) -> None:
    path = tmp_path / "h.csv"
    path.write_text("\n".join([*(f"line {k}" for k in range(150)), "t;a", "s;g", "1;2", "2;3"]))
    table = open_table(path)
    assert (table.first_line, table.names, table.units) == (153, ("t", "a"), ("s", "g"))
