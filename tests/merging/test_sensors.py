"""Sensor files of every layout as their makers' programs write them, to SI units and typed messages."""

import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from spheremcap.errors import SettingsError, SourceError, SpheremcapError, UsageError
from spheremcap.io import recording
from spheremcap.io.join import merge_streams
from spheremcap.merging.clock import Clock, parse_drift
from spheremcap.merging.log import SensorLog
from spheremcap.merging.makers.gopro import payload_samples
from spheremcap.merging.mapping import TableMapping, load_mapping
from spheremcap.merging.samples import SensorStream
from spheremcap.merging.sensors import read_sensors

G = 9.80665
DEG = np.pi / 180


def text(path: Path, *lines: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def one(path: Path, **options: object) -> SensorLog:
    (log,) = read_sensors(path, **options)  # type: ignore[arg-type]
    return log


def check_imu(log: SensorLog, acceleration: list[float], rate: list[float] | None = None) -> None:
    found = log.vector("linear_acceleration")
    assert found is not None
    assert np.allclose(found[0], acceleration)
    if rate is not None:
        found = log.vector("angular_velocity")
        assert found is not None
        assert np.allclose(found[0], rate)


XIO = (
    "Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),"
    "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)"
)


def test_ngimu_session_folder(tmp_path: Path) -> None:
    for device in ("NGIMU-Blue - 0029D0B4", "NGIMU-Red - 0029B94A"):
        folder = tmp_path / "My Session" / device
        text(
            folder / "sensors.csv",
            f"Time (s),{XIO},Magnetometer X (uT),Magnetometer Y (uT),Magnetometer Z (uT),Barometer (hPa)",
            "0,180,0,-90,1,0,-2,10,20,30,1013",
            "0.002502,180,0,-90,1,0,-2,10,20,30,1013",
        )
        text(folder / "quaternion.csv", "Time (s),W,X,Y,Z", "0,1,0,0,0", "0.02,1,0,0,0")
        text(folder / "temperature.csv", "Time (s),Processor (degC),Gyroscope (degC)", "0,30,31", "1,30,31.5")
        text(folder / "Settings.txt", "[settings]", "rate=400")
    logs = {log.name: log for log in read_sensors(tmp_path / "My Session", name="session")}
    assert set(logs) == {
        f"session_ngimu_{d}{f}" for d in ("blue_0029d0b4", "red_0029b94a") for f in ("", "_quaternion", "_temperature")
    }
    log = logs["session_ngimu_blue_0029d0b4"]
    check_imu(log, [G, 0, -2 * G], [np.pi, 0, -np.pi / 2])
    assert np.allclose(log.values["magnetic_field.y"], 20e-6)
    assert log.stamp_ns.tolist() == [0, 2_502_000]
    assert log.relative
    quaternion = logs["session_ngimu_blue_0029d0b4_quaternion"]
    assert (quaternion.kind, quaternion.values["orientation.w"].tolist()) == ("imu", [1, 1])
    temperature = logs["session_ngimu_blue_0029d0b4_temperature"]
    assert (temperature.kind, sorted(temperature.values)) == ("record", ["gyroscope_c", "processor_c"])


def test_ximu3_folder(tmp_path: Path) -> None:
    folder = tmp_path / "x-IMU3"
    text(folder / "Inertial.csv", f"Timestamp (us),{XIO}", "1700000000000001,0,0,360,0,1,0")
    text(
        folder / "Inertial.csv",
        f"Timestamp (us),{XIO}",
        "1700000000000001,0,0,360,0,1,0",
        "1700000000002501,0,0,0,0,1,0",
    )
    text(folder / "HighGAccelerometer.csv", "Timestamp (us),X (g),Y (g),Z (g)", "1,0,0,100", "2,0,0,101")
    text(folder / "Quaternion.csv", "Timestamp (us),W,X,Y,Z", "1,1,0,0,0", "2,1,0,0,0")
    logs = {log.name: log for log in read_sensors(folder, name="wrist")}
    check_imu(logs["wrist"], [0, G, 0], [0, 0, 2 * np.pi])
    assert logs["wrist"].stamp_ns[0] == 1_700_000_000_000_001_000
    assert not logs["wrist"].relative
    check_imu(logs["wrist_highgaccelerometer"], [0, 0, 100 * G])
    assert logs["wrist_quaternion"].values["orientation.w"].tolist() == [1, 1]


def test_xsens_dot_with_its_preamble_and_a_counter_that_wraps(tmp_path: Path) -> None:
    path = text(
        tmp_path / "dot.csv",
        "sep=,", "DeviceTag:,1", "FirmwareVersion:,3.0.0", "AppVersion:,2023.6.0", "SyncStatus:,Synced",
        "OutputRate:,60Hz", "FilterProfile:,General", "Measurement Mode:,Custom mode 4",
        "StartTime: ,2025-07-11_20:06:00_086 WEST", "© Movella Technologies B. V. 2005-2025", "",
        "PacketCounter,SampleTimeFine,Quat_W,Quat_X,Quat_Y,Quat_Z,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z,Status",
        "1,4294950629,1,0,0,0,1.5,0,9.8,90,0,0,0",
        "2,0,1,0,0,0,1.5,0,9.8,90,0,0,0",
        "3,16667,1,0,0,0,1.5,0,9.8,90,0,0,0",
    )  # fmt: skip
    log = one(path)
    check_imu(log, [1.5, 0, 9.8], [np.pi / 2, 0, 0])
    assert np.diff(log.stamp_ns).tolist() == [16_667_000, 16_667_000]
    assert log.values["orientation.w"].tolist() == [1, 1, 1]
    assert log.notes == (f"{path}: columns that are left out: PacketCounter, Status",)


def test_xsens_dot_without_inertial_data_is_refused(tmp_path: Path) -> None:
    head = "PacketCounter,SampleTimeFine,Euler_X,Euler_Y,Euler_Z,FreeAcc_X,FreeAcc_Y,FreeAcc_Z,Status"
    with pytest.raises(UsageError, match="free acceleration has no gravity"):
        read_sensors(text(tmp_path / "dot.csv", head, "1,10,0,0,0,0,0,0,0", "2,20,0,0,0,0,0,0,0"))


@pytest.mark.parametrize("delimiter", [",", "\t", ";"])
def test_shimmer_consensys(tmp_path: Path, delimiter: str) -> None:
    columns = [
        "Timestamp_Unix_CAL", "Accel_LN_X_CAL", "Accel_LN_Y_CAL", "Accel_LN_Z_CAL", "Accel_WR_X_CAL",
        "Accel_WR_Y_CAL", "Accel_WR_Z_CAL", "Gyro_X_CAL", "Gyro_Y_CAL", "Gyro_Z_CAL", "Mag_X_CAL",
        "Mag_Y_CAL",
        "Mag_Z_CAL", "Battery_CAL",
    ]  # fmt: skip
    units = ["ms", *["m/(s^2)"] * 3, *["m/(s^2)*"] * 3, *["deg/s"] * 3, *["local_flux*"] * 3, "mV"]
    row = ["1595933810034.251", *"111", *"234", "90", "0", "0", *"000", "4100"]
    path = text(
        tmp_path / "s.csv",
        f'"sep={delimiter}"',
        delimiter.join(f"Shimmer_40AC_{c}" for c in columns) + delimiter,
        delimiter.join(units) + delimiter,
        delimiter.join(row) + delimiter,
        delimiter.join(row) + delimiter,
    )
    log = one(path)
    check_imu(log, [2, 3, 4], [np.pi / 2, 0, 0])
    assert log.stamp_ns[0] == 1_595_933_810_034_251_000
    assert "magnetic_field.x" not in log.values
    (note,) = (note for note in log.notes if "left out" in note)
    assert "Shimmer_40AC_Mag_Z_CAL, Shimmer_40AC_Battery_CAL" in note
    assert "Timestamp" not in note
    assert "Gyro" not in note


def test_shimmer_with_dates(tmp_path: Path) -> None:
    path = text(
        tmp_path / "s.csv",
        "sep=\t",
        "S_TimestampSync_FormattedUnix_CAL\tS_Gyro_X_CAL\tS_Gyro_Y_CAL\tS_Gyro_Z_CAL",
        "yyyy/mm/dd hh:mm:ss.000\tdeg/s\tdeg/s\tdeg/s",
        "2020/07/28 10:56:50.034\t180\t0\t0",
        "2020/07/28 10:56:50.044\t180\t0\t0",
    )
    log = one(path)
    assert np.allclose(log.values["angular_velocity.x"], np.pi)
    assert log.stamp_ns[0] == 1_595_933_810_034_000_000


def test_movesense_streams(tmp_path: Path) -> None:
    acc = text(
        tmp_path / "20250601T100000Z_1234_acc_stream.csv",
        "Timestamp,Acc_X, Acc_Y, Acc_Z", "1000,1,2,3", "1009.6,1,2,3",
    )  # fmt: skip
    gyro = text(tmp_path / "x_gyro_stream.csv", "Timestamp,Gyro_X, Gyro_Y, Gyro_Z", "1000,90,0,0", "1010,90,0,0")
    check_imu(one(acc), [1, 2, 3])
    assert one(acc).stamp_ns.tolist() == [1_000_000_000, 1_009_600_000]
    assert np.allclose(one(gyro).values["angular_velocity.x"], np.pi / 2)


@pytest.mark.parametrize(
    "header", ["", "Time,Accel-X (g), Accel-Y (g), Accel-Z (g), Gyro-X (d/s), Gyro-Y (d/s), Gyro-Z (d/s)"]
)
def test_axivity(tmp_path: Path, header: str) -> None:
    rows = ["2014-01-01 00:00:00.000,0,1,0,180,0,0", "2014-01-01 00:00:00.010,0,1,0,180,0,0"]
    log = one(text(tmp_path / "ax6.csv", *([header] if header else []), *rows))
    check_imu(log, [0, G, 0], [np.pi, 0, 0])
    assert log.stamp_ns.tolist() == [1_388_534_400_000_000_000, 1_388_534_400_010_000_000]


def smartwheel_row(k: int, angle: float) -> str:
    row = ["0"] * 25
    row[1], row[3] = str(k), str(angle)
    row[18:24] = ["1", "2", "3", "4", "5", "6"]
    return ",".join(row)


def test_smartwheel_needs_its_rate(tmp_path: Path) -> None:
    path = text(
        tmp_path / "sw.csv",
        *(smartwheel_row(k, 350 + 5 * n if n < 2 else 5) for n, k in enumerate((7, 8, 11))),
    )
    with pytest.raises(UsageError, match="240 and 200 Hz both occur"):
        read_sensors(path)
    log = one(path, rate_hz=240)
    assert log.kind == "wheel"
    assert np.allclose(log.values["angle_rad"], np.array([350, 355, 365]) * DEG)
    assert [log.values[f"force.{a}"][0] for a in "xyz"] == [1, 2, 3]
    assert [log.values[f"moment.{a}"][0] for a in "xyz"] == [4, 5, 6]
    assert log.stamp_ns.tolist() == [0, 4_166_667, 16_666_667]
    assert "2 samples are missing" in log.notes[0]


def test_optipush(tmp_path: Path) -> None:
    rows = ["0.000\t0\t0\t1\t2\t3\t4\t5\t6\t90", "0.005\t0\t0\t1\t2\t3\t4\t5\t6\t91"]
    log = one(text(tmp_path / "trial.data", *[f"% line {k}" for k in range(12)], *rows))
    assert (log.kind, log.frame_id) == ("wheel", "trial_rim")
    assert np.allclose(log.values["angle_rad"], np.array([90, 91]) * DEG)
    assert [log.values[f"moment.{a}"][1] for a in "xyz"] == [4, 5, 6]
    assert log.stamp_ns.tolist() == [0, 5_000_000]


def test_encoder_log(tmp_path: Path) -> None:
    log = one(text(tmp_path / "enc.csv", "time [ms];angle [deg]", "0,5;10,5", "10,5;20,5"))
    assert log.kind == "wheel"
    assert np.allclose(log.values["angle_rad"], np.array([10.5, 20.5]) * DEG)
    assert log.stamp_ns.tolist() == [500_000, 10_500_000]
    counts = text(tmp_path / "counts.csv", "t (s),counts", "0,0", "0.1,1024")
    with pytest.raises(UsageError, match="unit"):
        read_sensors(counts)
    mapping = TableMapping.model_validate(
        {"kind": "wheel", "columns": {"angle": {"columns": ["counts"], "counts_per_turn": 4096}}}
    )
    assert np.allclose(one(counts, mapping=mapping).values["angle_rad"], [0, np.pi / 2])


MAPPING = """
kind = "imu"
frame_id = "left"
delimiter = ";"
skip_lines = 1

[time]
column = "tick"
unit = "us"
start = "2025-06-01T10:00:00.000000001Z"

[columns.linear_acceleration]
columns = ["a1", "a2", 4]
unit = "g"
range = 16
"""


def test_a_mapping_in_toml(tmp_path: Path) -> None:
    path = text(tmp_path / "odd.txt", "logger 7; 3", "tick;a1;a2;a3", "0;1;16;0", "10;1;-15.9;0")
    log = one(path, mapping=load_mapping(text(tmp_path / "map.toml", MAPPING)))
    check_imu(log, [G, 16 * G, 0])
    assert log.saturated is not None
    assert log.saturated.tolist() == [True, False]
    assert log.frame_id == "left"
    assert np.diff(log.stamp_ns).tolist() == [10_000]
    assert log.stamp_ns[0] == 1_748_772_000_000_000_001


@pytest.mark.parametrize(
    ("toml", "message"),
    [("colums = 1", "colums"), ("[time]\nunit = 'week'", "time.unit"), ("kind = ", "not TOML")],
)
def test_mappings_that_are_wrong_are_named(tmp_path: Path, toml: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        load_mapping(text(tmp_path / "map.toml", toml))


def test_any_table_becomes_a_record(tmp_path: Path) -> None:
    log = one(text(tmp_path / "power.csv", "Time (s),Power (W),Note,Heart rate (bpm)", "0,250,a,150", "1,,b,151"))
    assert log.kind == "record"
    assert sorted(log.values) == ["heart_rate_bpm", "power_w"]
    assert np.isnan(log.values["power_w"][1])


@pytest.mark.parametrize("unit", ["ns", "date"])
def test_parquet(tmp_path: Path, unit: str) -> None:
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    ns = [1_700_000_000_123_456_789, 1_700_000_000_123_456_999]
    column = pa.array(ns) if unit == "ns" else pa.array(ns, pa.timestamp("ns"))
    name = "timestamp (ns)" if unit == "ns" else "time"
    table = pa.table({name: column, "acc_x (g)": [1.0, 2.0], "acc_y (g)": [0, 0], "acc_z (g)": [0.5, 0.5]})
    parquet.write_table(table, tmp_path / "imu.parquet")
    log = one(tmp_path / "imu.parquet")
    assert log.stamp_ns.tolist() == ns
    check_imu(log, [G, 0, G / 2])


def test_parquet_without_all_its_times(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    table = pa.table({"time (s)": pa.array([0.5, None, 1.5]), "power (W)": [1.0, 2.0, float("inf")]})
    parquet.write_table(table, tmp_path / "p.parquet")
    log = one(tmp_path / "p.parquet")
    assert log.stamp_ns.tolist() == [500_000_000, 1_500_000_000]
    assert np.isnan(log.values["power_w"]).tolist() == [False, True]
    assert "1 line without a time is left out, the first is line 2" in log.lost[0]


@pytest.mark.parametrize("start", ["1e30", "soon", "0001-01-01"])
def test_a_start_that_is_no_time_is_named(tmp_path: Path, start: str) -> None:
    mapping = TableMapping.model_validate({"time": {"start": start}})
    path = text(tmp_path / "p.csv", "time (s),power (W)", "0,1", "1,2")
    with pytest.raises(UsageError, match="neither a date nor Unix seconds"):
        read_sensors(path, mapping=mapping)


def test_c3d(tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = ("wrist", "El Bow")
    c3d["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    points = np.ones((4, 2, 5))
    points[0, 0] = 1000 * np.arange(5)
    points[:3, 1, 3] = np.nan
    c3d["data"]["points"] = points
    c3d.write(str(tmp_path / "mocap.c3d"))
    log = one(tmp_path / "mocap.c3d")
    assert (log.kind, len(log)) == ("record", 5)
    assert np.allclose(log.values["wrist_x_m"], np.arange(5))
    assert np.isnan(log.values["el_bow_y_m"]).tolist() == [False, False, False, True, False]
    assert np.diff(log.stamp_ns).tolist() == [10_000_000] * 4


def klv(key: str, kind: str, size: int, data: bytes) -> bytes:
    head = key.encode() + struct.pack(">cBH", kind.encode("latin-1"), size, len(data) // size)
    return head + data + b"\0" * (-len(data) % 4)


def test_gopro_payloads() -> None:
    raw = struct.pack(">6h", 418, -836, 0, 418, 0, 0)
    stream = klv("STNM", "c", 1, b"Accelerometer") + klv("SCAL", "s", 2, struct.pack(">h", 418))
    first = klv("STRM", "\0", 1, stream + klv("ACCL", "s", 6, raw))
    turned = klv("STRM", "\0", 1, stream + klv("ORIN", "c", 1, b"YxZ") + klv("GYRO", "s", 6, raw))
    payload = klv("DEVC", "\0", 1, klv("DVNM", "c", 1, b"Camera") + first + turned)
    found = list(payload_samples(payload))
    assert [f[0] for f in found] == ["linear_acceleration", "angular_velocity"]
    assert found[0][1].tolist() == [[-2, 0, 1], [0, 0, 1]]  # stored as z, x, y
    assert found[1][1].tolist() == [[2, 1, 0], [0, 1, 0]]  # y, -x, z
    assert list(payload_samples(payload[:40])) == []


def box(kind: str, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I", len(body) + 8) + kind.encode() + body


def u32(*values: int) -> bytes:
    return struct.pack(f">{len(values)}I", *values)


def gopro_file(payloads: list[bytes], each: int = 1001, scale: int = 1000) -> bytes:
    """An MP4 with nothing but a telemetry track, its payloads `each` / `scale` seconds long."""
    count, total = len(payloads), len(payloads) * each
    matrix = u32(65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)
    ftyp = box("ftyp", b"mp41" + u32(0) + b"mp41")
    tables = box(
        "stbl",
        box("stsd", u32(0, 1), box("gpmd", bytes(6) + b"\0\1" + u32(0))),
        box("stts", u32(0, 1, count, each)),
        box("stsc", u32(0, 1, 1, count, 1)),
        box("stsz", u32(0, 0, count, *map(len, payloads))),
        box("stco", u32(0, 1, len(ftyp) + 8)),
    )
    handler = box("hdlr", u32(0), b"mhlrmeta" + bytes(12) + b"\x0b   GoPro MET\0")
    source = box("dinf", box("dref", u32(0, 1), box("url ", u32(1))))
    media = box("minf", box("gmhd", box("gmin", bytes(16))), source, tables)
    track = box(
        "trak",
        box("tkhd", u32(15, 0, 0, 1, 0, total) + bytes(16) + matrix + u32(0, 0)),
        box("mdia", box("mdhd", u32(0, 0, 0, scale, total) + bytes(4)), handler, media),
    )
    head = box("mvhd", u32(0, 0, 0, scale, total, 65536) + bytes(12) + matrix + bytes(24) + u32(2))
    return ftyp + box("mdat", *payloads) + box("moov", head, track)


def test_gopro_file(tmp_path: Path) -> None:
    scale = klv("SCAL", "s", 2, struct.pack(">h", 100))
    raw = struct.pack(">6h", 981, 0, 0, 981, 0, 0)
    payload = klv("DEVC", "\0", 1, klv("STRM", "\0", 1, scale + klv("ACCL", "s", 6, raw)))
    (tmp_path / "GX01.MP4").write_bytes(gopro_file([payload] * 3))
    log = one(tmp_path / "GX01.MP4", name="camera")
    assert (log.name, log.kind, log.frame_id) == ("camera_acc", "imu", "camera")
    assert log.stamp_ns.tolist() == [500_500_000 * k for k in range(6)]
    assert np.allclose(log.values["linear_acceleration.z"], 9.81)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            ["t (s),acc_x (g),acc_y (g),acc_z (g)", "0,1,2,3", "", "1,1,oops,3"],
            r"bad.csv, line 4, column 3 \(acc_y.*'oops'",
        ),
        (
            ["t (s),acc_x (g),acc_y (g),acc_z (g)", "0,1,2,3", "1,1", "2,1,2,3"],
            r"bad.csv, line 3: 2 columns, not 4",
        ),
        (
            ["t (s),acc_x (g),acc_y (g),acc_z (g)", "0,1,2,3", "x,1,2,3"],
            r"line 3, column 1: 'x' is not a time",
        ),
        (
            ["t (s),acc_x,acc_y,acc_z", "0,1,2,3", "1,1,2,3"],
            r"column 2 \(acc_x\): has no unit; give one of m/s2",
        ),
        (["t (s),acc_x (furlong),acc_y,acc_z", "0,1,2,3", "1,1,2,3"], r"unit 'furlong' is none of"),
        (
            ["t,acc_x (g),acc_y (g),acc_z (g)", "0,1,2,3", "1,1,2,3"],
            r"the time has no unit; give one of ns, us",
        ),
        (["acc_x (g),acc_y (g),acc_z (g)", "1,2,3", "1,2,3"], r"no column is obviously the time"),
        (["just", "words"], "no row of numbers"),
    ],
)
def test_faults_are_located(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(SpheremcapError, match=message):
        read_sensors(text(tmp_path / "bad.csv", *lines))


def test_missing_files_and_empty_folders(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no such file"):
        read_sensors(tmp_path / "absent.csv")
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no sensor file in this folder"):
        read_sensors(tmp_path / "empty")
    (tmp_path / "x.mp4").write_bytes(b"no video")
    with pytest.raises(SourceError):
        read_sensors(tmp_path / "x.mp4")


def test_stamps_that_go_back_are_sorted_and_counted(tmp_path: Path) -> None:
    log = one(text(tmp_path / "a.csv", "t (ms),angle (deg)", "0,1", "20,3", "10,2", "30,4"))
    assert log.stamp_ns.tolist() == [0, 10**7, 2 * 10**7, 3 * 10**7]
    assert np.allclose(log.values["angle_rad"], np.array([1, 2, 3, 4]) * DEG)
    assert "1 stamp goes back; the samples are sorted" in log.notes[0]


def test_clipping_is_found_without_a_range(tmp_path: Path) -> None:
    values = [1, 5, 8, 8, 8, 8, 3, -8, 1]
    lines = [f"{k},{v},0,1" for k, v in enumerate(values)]
    log = one(text(tmp_path / "a.csv", "t (ms),acc_x (g),acc_y (g),acc_z (g)", *lines))
    assert log.saturated is not None
    assert log.saturated.tolist() == [v == 8 for v in values]


def test_merged_sensors_read_back(tmp_path: Path) -> None:
    imu = one(
        text(tmp_path / "imu.csv", f"Time (s),{XIO}", "0,180,0,0,0,0,1", "0.5,180,0,0,,0,1", "1,180,0,0,0,0,1"),
        name="imu_left_wrist",
    )
    wheel = one(text(tmp_path / "sw.csv", *(smartwheel_row(k, k) for k in range(5))), rate_hz=200)
    power = one(text(tmp_path / "power.csv", "Time (s),Power (W)", "0,250", "1,"))
    start = 1_700_000_000_000_000_000
    streams = [
        SensorStream(imu, Clock(start + 12_500_000, parse_drift("-20ppm"))),
        SensorStream(wheel, Clock(start)),
        SensorStream(power, Clock(start)),
    ]
    merged = merge_streams(streams, tmp_path / "out.mcap")
    assert merged.counts == {"/sensors/imu_left_wrist": 3, "/sensors/sw": 5, "/sensors/power": 2}
    back = recording.open(tmp_path / "out.mcap")
    sensor = back.sensors["imu_left_wrist"]
    assert (sensor.stamp_ns - start).tolist() == [12_500_000, 512_490_000, 1_012_480_000]
    assert sensor.own_stamp_ns.tolist() == [0, 500_000_000, 1_000_000_000]
    assert np.allclose(sensor["angular_velocity.x"], np.pi)
    assert np.isnan(sensor["linear_acceleration.z"]).tolist() == [False, True, False]
    assert np.allclose(back.sensors["sw"]["moment_nm.z"], 6)
    reader = make_reader((tmp_path / "out.mcap").open("rb"), decoder_factories=[DecoderFactory()])
    rows = [d for _, _, _, d in reader.iter_decoded_messages(topics=["/sensors/power"])]
    assert [(d.HasField("power_w"), d.power_w) for d in rows] == [(True, 250), (False, 0)]
    names = {m.name: m.metadata for m in reader.iter_metadata()}
    assert (
        next(facts for name, facts in names.items() if name.startswith("spheremcap/clock/imu_left_wrist/"))["drift_ppm"]
        == "-20"
    )


def test_a_mapping_with_a_byte_order_mark_and_one_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_bytes(b"\xef\xbb\xbf" + MAPPING.encode())
    assert load_mapping(path).kind == "imu"
    for data in (b"\xff\xff", b"kind = " + b"[" * 5000):
        path.write_bytes(data)
        with pytest.raises(SettingsError) as caught:
            load_mapping(path)
        assert "\n" not in str(caught.value)
