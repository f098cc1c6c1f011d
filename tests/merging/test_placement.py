"""Where inputs come to lie: each sample where it belongs to a microsecond, or a refusal that names the input."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from test_dataset import errors_ms, write_imu, write_recording
from test_starts import log_times, table
from test_starts import recording as short_recording
from test_sync import session

from spheremcap.errors import SpheremcapError, UsageError
from spheremcap.io import recording
from spheremcap.merging.clock import Clock, format_offset, parse_drift, parse_offset
from spheremcap.merging.dataset import Source, merge
from spheremcap.merging.placement import Placement, apart, base_ns
from spheremcap.merging.sensors import read_sensors
from spheremcap.merging.times import Timing

S = 10**9
START_NS = 1_752_480_000 * S  # 2025-07-14 08:00:00 UTC


def rows(path: Path, header: str, times: list[str]) -> Path:
    path.write_text("\n".join([header, *(f"{t};{k}" for k, t in enumerate(times))]) + "\n", encoding="utf-8")
    return path


def clock_text(ns: int, pattern: str) -> str:
    """A stamp as a date or time of day of UTC, with microseconds."""
    seconds, nanos = divmod(ns, S)
    day, second = divmod(seconds, 86_400)
    date = np.datetime64(day, "D").astype(object)
    of_day = f"{second // 3600:02}:{second // 60 % 60:02}:{second % 60:02}.{nanos // 1000:06}"
    return pattern.format(d=date.day, m=date.month, y=date.year, t=of_day)


def written(path: Path, topic: str) -> list[tuple[int, int]]:
    """(log time, row number) of a table's samples, in the file's order."""
    back = recording.open(path).sensors[topic]
    (column,) = back.values.values()
    return list(zip(back.stamp_ns.tolist(), column.astype(int).tolist(), strict=True))


def test_ten_inputs_come_to_lie_where_they_belong_to_a_microsecond(tmp_path: Path) -> None:
    """Truth is kept here, and each file is written as its device would have seen it: own = what the device says."""
    second = [START_NS + k * S for k in range(60)]
    even = [START_NS + k * S // 10 for k in range(600)]
    truth: dict[str, list[int]] = {}
    sources = []

    # Two recordings: one true, one whose clock is 3 s behind and 20 ppm too slow.
    sources.append(Source(short_recording(tmp_path / "true.mcap", START_NS, 61)))
    own = [START_NS - 3 * S + k * S for k in range(61)]
    sources.append(
        Source(short_recording(tmp_path / "late.mcap", own[0], 61), offset_ns=3 * S, drift=Fraction(20, 10**6),
               prefix="/late")
    )  # fmt: skip
    truth["late"] = [START_NS + k * S + k * 20_000 for k in range(61)]

    def add(name: str, header: str, times: list[str], true_ns: list[int], **clock: object) -> None:
        sources.append(Source(rows(tmp_path / f"{name}.csv", header, times), **clock))  # type: ignore[arg-type]
        truth[name] = true_ns

    add("unix", "t (s);load", [f"{ns // S}.{ns % S:09}" for ns in even], even)
    # 2.5 s ahead, in milliseconds; late packets out of order.
    shuffled = [*even[:300], even[302], even[300], even[301], *even[303:]]
    add("ms", "time_ms;load", [f"{(ns + 5 * S // 2) / 1_000_000:.6f}" for ns in shuffled], shuffled,
        offset_ns=-5 * S // 2)  # fmt: skip
    add("local", "Datum;load", [clock_text(ns + 7200 * S, "{d:02}.{m:02}.{y} {t}") for ns in even], even,
        offset_ns=parse_offset("-2h"))  # fmt: skip
    gap = even[:100] + even[300:]
    add("gap", "Zeit;load", [clock_text(ns, "{y}-{m:02}-{d:02}T{t}Z") for ns in gap], gap)
    add("zero", "Zeit [s];load", [f"{(ns - START_NS) / S:.1f}" for ns in even], even)
    # Its first sample 12.0 s after its own zero, which is the recording's start plus the offset; 150 ppm too fast.
    fast = [START_NS + 12 * S + S // 4 + k * S // 10 - k * 15_000 for k in range(400)]
    add("twelve", "Zeit [s];load", [f"{12 + k / 10:.1f}" for k in range(400)], fast,
        offset_ns=S // 4, drift=parse_drift("-150ppm"))  # fmt: skip
    add("clock", "Uhrzeit;load", [clock_text(ns, "{t}") for ns in even], even)
    add("twice", "timestamp (us);load", [str(ns // 1000) for ns in [*second, *second[-2:]]], [*second, *second[-2:]])
    assert len(sources) == 10

    dataset = merge(sources, tmp_path / "out.mcap")
    assert log_times(tmp_path / "out.mcap", "/late") == pytest.approx(truth.pop("late"), abs=1000)
    for name, expected in truth.items():
        found = written(tmp_path / "out.mcap", name)
        assert len(found) == len(expected), name
        assert max(abs(ns - expected[row]) for ns, row in found) <= 1000, name
    lines = {p.name: p.line() for p in dataset.placements}
    assert list(lines) == ["true", "late", *truth]
    assert set(lines.values()) <= set(dataset.notes)
    assert "3s (offset)" in lines["late"]
    assert "20 ppm (drift)" in lines["late"]
    assert "600 samples at 10 Hz, 2025-07-14T08:00:00.000000000Z to" in lines["unix"]
    assert "as times of day, no zone, taken for UTC; added: 2025-07-14T00:00:00.000000000Z, the midn" in lines["clock"]
    assert "day first, no zone, taken for UTC; added: -2h (offset)" in lines["local"]
    assert "as its zero is taken for the start of true, +250ms (offset), -150 ppm (drift)" in lines["twelve"]
    notes = "\n".join(dataset.notes)
    assert "ms.csv: 1 stamp goes back; the samples are sorted by stamp" in notes
    assert "gap.csv: a gap in its times of 20.100 s after 2025-07-14T08:00:09.900000000Z" in notes
    assert (
        "twice.csv: 2 samples have the time of the one before (kept as they are), first at 2025-07-14T08:00:5" in notes
    )


def test_every_placement_is_in_the_recording_too(tmp_path: Path) -> None:
    sources = [Source(short_recording(tmp_path / "rec.mcap", START_NS)), Source(table(tmp_path / "crank.csv", 1.0))]
    merge(sources, tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as file:
        facts = {m.name.rpartition("/")[0]: m.metadata for m in make_reader(file).iter_metadata()}
    assert facts["spheremcap/clock/rec"] == {
        "input": "rec.mcap", "samples": "3", "first_ns": str(START_NS), "last_ns": str(START_NS + 2 * S),
        "times": "log times", "added": "nothing", **Clock(0, Fraction(0), START_NS).lines(),
    }  # fmt: skip
    crank = facts["spheremcap/clock/crank"]
    assert (crank["input"], crank["samples"], crank["rate_hz"]) == ("crank.csv", "4", "2")
    assert crank["first_ns"] == str(START_NS + S)
    assert crank["times"] == "column 1 (time_s) in s"
    assert "start of rec" in crank["added"]
    assert crank["offset_ns"] == str(START_NS)


def test_a_recordings_own_clock_carries_what_is_placed_by_it(tmp_path: Path) -> None:
    """Sensors that count from zero and a sensor synchronised with a marker both follow the recording's offset."""
    made = session(40, seed=3, fps=120, offset_s=5.4)
    video = write_recording(tmp_path / "out.mcap", made)
    imu = write_imu(tmp_path / "imu.csv", made)
    start = int(made.stamp_ns[0])
    sources = [
        Source(video, offset_ns=2 * S, drift=Fraction(100, 10**6)),
        Source(imu, sync_marker="left_wrist"),
        Source(table(tmp_path / "crank.csv", 0.0)),
    ]
    dataset = merge(sources, tmp_path / "both.mcap")
    assert log_times(tmp_path / "both.mcap", "crank")[0] == start + 2 * S
    back = recording.open(tmp_path / "both.mcap")
    stamp_ns = back.sensors["imu"].stamp_ns
    on_the_videos_clock = start + (stamp_ns - start - 2 * S) / (1 + 100e-6)
    assert errors_ms(on_the_videos_clock, made).max() < 1.0
    assert back.tracks["left_wrist"].stamp_ns[0] == start + 2 * S
    line = next(p.line() for p in dataset.placements if p.name == "imu")
    assert "(sync with left_wrist)" in line
    with open(tmp_path / "both.mcap", "rb") as file:
        facts = {m.name.rpartition("/")[0]: m.metadata for m in make_reader(file).iter_metadata()}
    sync = dataset.syncs["imu"]
    assert facts["spheremcap/clock/imu"]["sync_residual_ms"] == f"{sync.residual_s * 1e3:.3f}"
    assert facts["spheremcap/clock/imu"]["sync_error_ms"] == f"{sync.error_s * 1e3:.3f}"
    assert "sync_residual_ms" not in facts["spheremcap/clock/crank"]


def test_a_sensor_that_has_run_for_long_is_synchronised_from_the_recordings_start(tmp_path: Path) -> None:
    made = session(40, seed=3, fps=120, offset_s=5.4)
    video = write_recording(tmp_path / "out.mcap", made)
    made.imu_stamp_ns = made.imu_stamp_ns + 10**9  # write_imu counts from its first sample
    imu = write_imu(tmp_path / "imu.csv", made)
    first, *others = imu.read_text().splitlines()
    later = [f"{int(line.partition(',')[0]) + 4_294_000_000},{line.partition(',')[2]}" for line in others]
    imu.write_text("\n".join([first, *later]) + "\n")
    dataset = merge([Source(video), Source(imu, sync_marker="left_wrist")], tmp_path / "both.mcap")
    assert errors_ms(recording.open(tmp_path / "both.mcap").sensors["imu"].stamp_ns, made).max() < 1.0
    line = next(p.line() for p in dataset.placements if p.name == "imu")
    assert "its first sample at the start of out as a guess" in line


def test_all_files_of_one_device_have_one_clock(tmp_path: Path) -> None:
    """With the drift counted from the device's own start, not from each file's first line."""
    folder = tmp_path / "device"
    folder.mkdir()
    (folder / "sensors.csv").write_text("Time (s),Power (W)\n" + "".join(f"{k},1\n" for k in range(11)))
    (folder / "temperature.csv").write_text("Time (s),Heat (W)\n10,1\n11,2\n")
    sources = [
        Source(short_recording(tmp_path / "rec.mcap", START_NS, 20)),
        Source(folder, drift=parse_drift("1000ppm")),
    ]
    merge(sources, tmp_path / "out.mcap")
    assert log_times(tmp_path / "out.mcap", "device_temperature")[0] == START_NS + 10 * S + 10 * S // 1000
    assert log_times(tmp_path / "out.mcap", "device")[10] == START_NS + 10 * S + 10 * S // 1000


def test_a_clock_that_began_anew_is_refused_by_name(tmp_path: Path) -> None:
    times = [f"{k / 10:.1f}" for k in [*range(50), *range(30)]]
    imu = rows(tmp_path / "imu.csv", "Zeit [s];load", times)
    sources = [Source(short_recording(tmp_path / "rec.mcap", START_NS, 20)), Source(imu)]
    told: list[str] = []
    with pytest.raises(UsageError, match=r"imu\.csv: its clock starts again after sample 50 \(4\.900 s, then 0\.000 s"):
        merge(sources, tmp_path / "out.mcap", say=told.append)
    assert list(tmp_path.glob("out*")) == []
    assert any(line.startswith("imu: 80 samples") for line in told)
    merge(sources, tmp_path / "out.mcap", force=True, say=told.append)
    assert len(log_times(tmp_path / "out.mcap", "imu")) == 80
    assert any("starts again" in line for line in told)


@pytest.mark.parametrize(
    ("times", "restarts"),
    [
        ([*range(100), *range(40, 100)], True),  # back into the middle
        ([*range(100), *range(-5, 3)], True),  # back beyond the start
        ([0, 1, 2, 0, 1, 2], True),
        ([0, 2, 1, 3], False),
        ([*range(50), 53, 50, 51, 52, *range(54, 90)], False),  # one packet early
        ([*range(40), *range(60, 100), *range(40, 60), *range(100, 120)], False),  # a block that was kept back
        ([k + (2 if k % 10 == 3 else 0) for k in range(100)], False),  # jitter all along
    ],
)
def test_a_restart_is_told_from_late_samples(times: list[int], restarts: bool, tmp_path: Path) -> None:
    base = 1_752_480_000
    path = rows(tmp_path / "a.csv", "t (s);load", [f"{base + t}" for t in times])
    (log,) = read_sensors(path)
    assert bool(log.doubts) == restarts
    assert any("back" in note for note in log.notes) != restarts
    assert log.stamp_ns.tolist() == sorted((base + t) * S for t in times)


def test_what_overlaps_nothing_is_asked_about(tmp_path: Path) -> None:
    rec = short_recording(tmp_path / "rec.mcap", START_NS, 60)
    local = rows(tmp_path / "imu.csv", "Datum;load", [f"14.07.2025 10:00:{k:02}" for k in range(50)])
    up = rows(tmp_path / "up.csv", "time_s;load", [f"{4294 + k}" for k in range(50)])
    old = rows(tmp_path / "old.csv", "time_s;load", [f"{1_700_000_000 + k}" for k in range(50)])
    for path, remedy in (
        (local, "its zone is not known: if its clock is local time, --offset imu=-2h"),
        (up, "to let both start together, --offset up=-4294s"),
        (old, "to let both start together, --offset old=+52480000s"),
    ):
        with pytest.raises(UsageError, match="does not overlap rec") as caught:
            merge([Source(rec), Source(path)], tmp_path / "out.mcap")
        assert remedy in str(caught.value)
        assert "--force" in str(caught.value)
        assert not list(tmp_path.glob("out*"))
        offset = str(caught.value).partition(f"--offset {path.stem}=")[2].partition(";")[0]
        merge([Source(rec), Source(path, offset_ns=parse_offset(offset))], tmp_path / "out.mcap")
        assert log_times(tmp_path / "out.mcap", path.stem)[0] == START_NS
        (tmp_path / "out.mcap").unlink()
    merge([Source(rec), Source(old)], tmp_path / "out.mcap", force=True)
    assert log_times(tmp_path / "out.mcap", "old")[0] == 1_700_000_000 * S


def test_the_remedy_counts_what_was_given_already(tmp_path: Path) -> None:
    rec = short_recording(tmp_path / "rec.mcap", START_NS, 60)
    up = rows(tmp_path / "up.csv", "time_s;load", [f"{k}" for k in range(50)])
    with pytest.raises(UsageError, match=r"--offset up=\+0ns"):
        merge([Source(rec), Source(up, offset_ns=-1000 * S)], tmp_path / "out.mcap")


def test_inputs_hang_together_through_others() -> None:
    def place(name: str, first: int, last: int) -> Placement:
        return Placement(name, name, name, "samples", 2, first, last, 1.0, Timing("", "1970"), Clock(), ())

    chain = [place("a", 0, 10), place("b", 10, 20), place("c", 15, 30)]
    assert apart(chain) == []
    assert apart([place("long", 0, 100), place("short", 10, 20), place("late", 50, 60)]) == []
    (line,) = apart([*chain, place("d", 31, 40)])
    assert line.startswith("d (")
    assert [line.split(" ")[0] for line in apart([place("x", 0, 1), place("y", 2, 3), place("z", 2, 9)])] == ["y", "z"]
    assert apart([]) == []


def test_two_sensors_of_one_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    sources = [Source(table(tmp_path / "crank.csv", 0.0)), Source(table(tmp_path / "a" / "crank.csv", 0.0))]
    with pytest.raises(UsageError, match="2 sensors would be /sensors/crank"):
        merge(sources, tmp_path / "out.mcap")


def test_a_sensor_that_a_recording_has_already_is_refused(tmp_path: Path) -> None:
    rec, crank = short_recording(tmp_path / "rec.mcap", START_NS), table(tmp_path / "crank.csv", 0.0)
    merge([Source(rec), Source(crank)], tmp_path / "one.mcap")
    with pytest.raises(UsageError, match=r"one\.mcap has /sensors/crank already: give the file another name"):
        merge([Source(tmp_path / "one.mcap"), Source(crank)], tmp_path / "two.mcap")
    merge([Source(tmp_path / "one.mcap", prefix="/old"), Source(crank)], tmp_path / "two.mcap")
    assert set(recording.open(tmp_path / "two.mcap").sensors) == {"crank"}


def test_a_devices_folder_is_synchronised_by_what_moved(tmp_path: Path) -> None:
    made = session(40, seed=3, fps=120, offset_s=5.4)
    video, folder = write_recording(tmp_path / "out.mcap", made), tmp_path / "device"
    folder.mkdir()
    write_imu(folder / "Inertial.csv", made)
    still = "".join(f"{k * 100_000},0,0,1\n" for k in range(400))
    (folder / "HighG.csv").write_text("Timestamp (us),X (g),Y (g),Z (g)\n" + still)
    (folder / "Temperature.csv").write_text("Timestamp (us),Heat (W)\n0,20\n1000000,21\n")
    source = Source(folder, sync_marker="left_wrist", drift=parse_drift("100ppm"))
    dataset = merge([Source(video), source], tmp_path / "both.mcap")
    assert list(dataset.syncs) == ["device"]
    back = recording.open(tmp_path / "both.mcap").sensors
    assert errors_ms(back["device"].stamp_ns, made).max() < 1.0
    for name in ("device_temperature", "device_highg"):
        assert back[name].stamp_ns[0] == back["device"].stamp_ns[0]
    assert all("(drift)" not in p.line() for p in dataset.placements)


NUMBERS = st.sampled_from(["0", "1", "2.5", "-3", "", "#N/A", "1e300", "1e18", "1752480000", "10:00:02", "x"])
HEADS = st.sampled_from(
    ["Time (s)", "t", "Zeit [s]", "timestamp", "acc_x (g)", "acc_y (g)", "acc_z (g)", "angle (deg)", "Pump A", "pump_a",
     "pump_a1", "pump_a_1", "pumpA1", "1", "_", "größe", "时间", "json", "class", "timestamp_2", "v (km/h)", ""]
)  # fmt: skip


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    names=st.lists(HEADS, min_size=1, max_size=6),
    lines=st.lists(st.lists(NUMBERS, min_size=2, max_size=7), min_size=1, max_size=6),
    offset_ns=st.sampled_from([0, 1, -START_NS, 10**18, -(10**18)]),
    force=st.booleans(),
)
def test_any_table_is_merged_or_one_line(
    tmp_path: Path, names: list[str], lines: list[list[str]], offset_ns: int, force: bool
) -> None:
    rec = tmp_path / "rec.mcap"
    if not rec.exists():
        short_recording(rec, START_NS)
    path, out = tmp_path / "any.csv", tmp_path / "out.mcap"
    path.write_text("\n".join(";".join(row) for row in [["Time (s)", *names], *lines]) + "\n", encoding="utf-8")
    try:
        dataset = merge([Source(rec), Source(path, offset_ns=offset_ns)], out, force=force, overwrite=True)
    except SpheremcapError as error:
        if "\n" in str(error) or list(tmp_path.glob("*.part")):
            raise
        return
    (place,) = (p for p in dataset.placements if p.name == "any")
    back = recording.open(out).sensors["any"]
    assert len(back) == place.count
    assert (int(back.stamp_ns[0]), int(back.stamp_ns[-1])) == place.span_ns


def test_what_an_offset_moves_out_of_all_time_is_found_before_anything_is_written(tmp_path: Path) -> None:
    rec, crank = short_recording(tmp_path / "rec.mcap", START_NS), table(tmp_path / "crank.csv", 0.0)
    for sources in ([Source(rec), Source(crank, offset_ns=-START_NS - S)], [Source(rec, offset_ns=-START_NS - S)]):
        with pytest.raises(UsageError, match="before 1970"):
            merge(sources, tmp_path / "out.mcap", force=True)
        assert not list(tmp_path.glob("out*"))


def test_sensors_alone_go_by_the_one_with_a_true_clock(tmp_path: Path) -> None:
    sources = [Source(table(tmp_path / "zero.csv", 0.0)), Source(table(tmp_path / "true.csv", START_NS / S))]
    merge(sources, tmp_path / "out.mcap")
    assert log_times(tmp_path / "out.mcap", "zero") == log_times(tmp_path / "out.mcap", "true")
    merge(sources[:1], tmp_path / "alone.mcap")
    assert log_times(tmp_path / "alone.mcap", "zero")[0] == 0


@pytest.mark.parametrize(
    ("start", "first", "midnight"),
    [
        (START_NS, 8 * 3600 * S, START_NS - 8 * 3600 * S),
        (START_NS - 8 * 3600 * S + S, 86_399 * S, START_NS - 32 * 3600 * S),  # began before midnight
        (START_NS - 8 * 3600 * S - S, 0, START_NS - 8 * 3600 * S),
    ],
)
def test_a_time_of_day_is_put_on_the_nearest_day(start: int, first: int, midnight: int) -> None:
    assert base_ns("midnight", first, start, "rec")[0] == midnight


@pytest.mark.parametrize("ns", [0, 1, -1, 12_500_000, -7_200 * S, 4_294_967_295_123_456, -999, 90 * S, 3_600 * S + 1])
def test_offsets_are_written_so_that_they_are_read_back(ns: int) -> None:
    assert parse_offset(format_offset(ns)) == ns
