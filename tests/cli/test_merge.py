"""spheremcap merge and sync as a user runs them."""

import signal

import numpy as np
import pytest
from test_dataset import errors_ms, write_imu, write_recording
from test_join import rows as many
from test_join import write
from test_sync import session

import spheremcap
from clips import START_NS, decoded, rows
from spheremcap.io.output import SharedWriter
from spheremcap.synth.stroke_scenarios import ride


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """A track and an accelerometer beside it, whose clock is 5.4 s off."""
    folder = tmp_path_factory.mktemp("moved")
    made = session(20, seed=3, fps=120, offset_s=5.4)
    return made, write_recording(folder / "out.mcap", made), write_imu(folder / "imu_left_wrist.csv", made)


def wheel_csv(path, count=50):
    lines = ["time (s),angle (deg)"] + [f"{k / 100},{k * 3.6}" for k in range(count)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_recordings_and_sensors_become_one(run, log, tmp_path):
    wheel = wheel_csv(tmp_path / "wheel.csv")
    folder = tmp_path / "imu"
    folder.mkdir()
    (folder / "sensors.csv").write_text(
        "Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n0.0,0,0,1\n0.01,0,0,1\n0.02,0,1,0\n"
    )
    out = tmp_path / "dataset.mcap"
    flags = ("--offset", "wheel=+12.5ms", "--drift", "imu=-20ppm", "--prefix", "second=right")
    outcome = run("merge", log, wheel, f"{folder}/", f"second={log}", "-o", out, *flags)
    assert outcome.code == 0, outcome.err
    given, found = rows(log), rows(out)
    assert [row for row in found if row[0] in {r[0] for r in given}] == given
    assert sum(row[0] == "/right/front/image" for row in found) == sum(r[0] == "/front/image" for r in given)
    assert f"{len(found)} messages on" in outcome.out
    back = spheremcap.open(out)
    start = min(row[1] for row in given)
    assert back.sensors["wheel"].stamp_ns[0] == start + 12_500_000
    assert back.sensors["wheel"]["angle_rad"][-1] == pytest.approx(np.deg2rad(49 * 3.6))
    assert len(back.sensors["imu"]) == 3
    assert decoded(out)["/sensors/imu"][0].linear_acceleration.z == pytest.approx(9.80665)


def test_the_wheel_of_rendered_strokes_is_read_as_it_is(run, log, tmp_path):
    made, wheel, out = ride("strokes"), tmp_path / "wheel.csv", tmp_path / "dataset.mcap"
    wheel.write_text(made.files()["wheel.csv"])
    outcome = run("merge", log, wheel, "-o", out)
    assert outcome.code == 0, outcome.err
    back = spheremcap.open(out).sensors["wheel"]
    since_s = (back.stamp_ns - min(row[1] for row in rows(log))) / 1e9
    assert back["angle_rad"] == pytest.approx(made.motion.turned_rad(since_s), abs=1e-6)
    assert 19 < np.median(np.diff(back["angle_rad"]) / np.diff(since_s)) < 21  # forward is more


def test_what_is_wrong_is_one_line(run, log, tmp_path):
    wheel, out = wheel_csv(tmp_path / "wheel.csv"), tmp_path / "dataset.mcap"
    broken = tmp_path / "broken.csv"
    broken.write_text("time (s),angle (deg)\n0,1\n1,2\n2,x\n3,4\n")
    no_unit = tmp_path / "no_unit.csv"
    no_unit.write_text("time (s),angle\n0,1\n1,2\n")
    for arguments, code, words in (
        ((log, tmp_path / "none.csv"), 2, ["none.csv", "no such file"]),
        ((log, wheel, "--offset", "imu=+1ms"), 2, ["--offset imu=+1ms", "log, wheel"]),
        ((log, wheel, "--offset", "wheel=1"), 2, ["'1'", "+12.5ms"]),
        ((log, wheel, "--drift", "wheel=fast"), 2, ["'fast'", "-20ppm"]),
        ((log, wheel, "--rate", "many"), 2, ["--rate many", "wheel=240"]),
        ((log, wheel, "--mapping", tmp_path / "none.toml"), 2, ["none.toml", "no such file"]),
        ((log, wheel, f"wheel={log}", "--offset", "wheel=1ms"), 2, ["two inputs are called 'wheel'"]),
        ((log, wheel, "--sync", "wheel=nose"), 2, ["no recording has a marker 'nose'"]),
        ((log, broken), 1, ["broken.csv", "line 4", "angle"]),
        ((log, no_unit), 2, ["no_unit.csv", "unit"]),
    ):
        outcome = run("merge", *arguments, "-o", out)
        assert (outcome.code, outcome.out == "") == (code, no_unit not in arguments), outcome
        assert outcome.err.count("\n") == 1, outcome.err
        for word in words:
            assert word in outcome.err
        assert not out.exists()
    before = log.read_bytes()
    assert run("merge", log, "-o", log, "--overwrite").code == 2
    assert log.read_bytes() == before


def test_a_damaged_input_is_merged_as_far_as_it_goes(run, log, tmp_path):
    cut, out = tmp_path / "cut.mcap", tmp_path / "dataset.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    outcome = run("merge", cut, "-o", out)
    assert outcome.code == 3
    assert f"{cut}: byte" in outcome.err
    assert len(decoded(out)["/front/image"]) > 0
    assert min(row[1] for row in rows(out)) > START_NS


def test_ctrl_c_leaves_a_readable_part(run, log, tmp_path, monkeypatch):
    long, out = write(tmp_path / "long.mcap", many("/x", range(START_NS, START_NS + 5000))), tmp_path / "dataset.mcap"
    add, before = SharedWriter.add_message, signal.getsignal(signal.SIGINT)  # ignored in a job of the background

    def pressed(writer, *message):
        if writer.counts["/x"] == 1500:
            signal.raise_signal(signal.SIGINT)
        add(writer, *message)

    monkeypatch.setattr(SharedWriter, "add_message", pressed)
    outcome = run("merge", log, long, "-o", out, "--force")
    part = tmp_path / "dataset.mcap.part"
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.splitlines()[-1] == f"spheremcap: stopped after 2048 messages; they are in {part}"
    assert not out.exists()
    assert len(rows(part)) == 2048
    assert signal.getsignal(signal.SIGINT) is before


def test_sync_finds_the_clock_and_merge_applies_it(run, moved, tmp_path):
    made, video, imu = moved
    rough, fine = tmp_path / "rough.mcap", tmp_path / "fine.mcap"
    assert run("merge", video, imu, "-o", rough).code == 0
    outcome = run("sync", rough, "--marker", "left_wrist", "--sensor", "imu_left_wrist")
    assert outcome.code == 0, outcome.err
    assert "windows agree" in outcome.out
    found = outcome.out.split("--offset NAME=")[1].split()
    again = (
        "--offset",
        f"imu_left_wrist={found[0]}",
        "--drift",
        f"imu_left_wrist={found[2].removeprefix('NAME=')}",
    )
    assert run("merge", video, imu, "-o", fine, *again).code == 0
    assert errors_ms(spheremcap.open(fine).sensors["imu_left_wrist"].stamp_ns, made).max() < 2.0
    outcome = run("merge", video, imu, "-o", fine, "--overwrite", "--sync", "imu_left_wrist=left_wrist")
    assert outcome.code == 0, outcome.err
    assert "windows agree" in outcome.err
    assert "/sync/imu_left_wrist/residual" in decoded(fine)


def test_sync_lists_what_there_is_and_refuses_to_guess(run, moved, tmp_path):
    _, video, _imu = moved
    outcome = run("sync", video, "--marker", "nose", "--sensor", "imu")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "there are: left_wrist" in outcome.err
    flat = tmp_path / "flat.csv"
    flat.write_text("Time (s),Acc X (g),Acc Y (g),Acc Z (g)\n" + "".join(f"{k / 100},0,0,1\n" for k in range(1500)))
    merged = tmp_path / "merged.mcap"
    assert run("merge", video, flat, "-o", merged).code == 0
    outcome = run("sync", merged, "--marker", "left_wrist", "--sensor", "flat")
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (1, "", 1)


def test_each_placement_is_one_line_and_what_is_lost_is_exit_3(run, log, tmp_path):
    imu = tmp_path / "imu.csv"
    imu.write_text("Zeit [s];a x [g];a y [g];a z [g]\n" + "".join(f"{k / 100};0;0;1\n" for k in range(30)) + "0,3;0;0")
    out = tmp_path / "out.mcap"
    outcome = run("merge", log, imu, "-o", out)
    assert outcome.code == 3
    first, second, frames, lost = outcome.err.splitlines()
    assert "nothing says where" in frames
    assert "imu" in frames
    assert first.startswith("spheremcap: log: ")
    assert first.endswith("times: log times; added: nothing")
    assert "imu: 30 samples at 100 Hz, " in second
    assert "times: column 1 (Zeit [s]) in s; added: " in second
    assert lost == f"spheremcap: {imu}: the last line, 32, is cut off: the 30 before it are kept"
    assert len(spheremcap.open(out).sensors["imu"]) == 30


def test_what_does_not_overlap_is_asked_about(run, log, tmp_path):
    wheel, out = wheel_csv(tmp_path / "wheel.csv"), tmp_path / "out.mcap"
    outcome = run("merge", log, wheel, "-o", out, "--offset", "wheel=1h")
    assert (outcome.code, outcome.out) == (2, "")
    assert "does not overlap log" in outcome.err.splitlines()[-1]
    assert not list(tmp_path.glob("out*"))
    outcome = run("merge", log, wheel, "-o", out, "--offset", "wheel=1h", "--force")
    assert outcome.code == 0, outcome.err
    assert "does not overlap log" in outcome.err


def test_a_table_that_is_not_understood_prints_a_mapping_that_reads_it(run, log, tmp_path):
    odd, mapping, out = tmp_path / "odd.csv", tmp_path / "odd.toml", tmp_path / "out.mcap"
    odd.write_text("tick;links [N];Kurbelwinkel;note\n0;1,5;90;a\n10;2,5;180;b\n")
    outcome = run("merge", log, odd, "-o", out)
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert "no column is obviously the time (tick, links [N], Kurbelwinkel, note)" in outcome.err
    assert 'column = "tick"' in outcome.out
    assert "# column 2: 'links [N]', first value '1,5'" in outcome.out
    mapping.write_text(outcome.out)
    outcome = run("merge", log, odd, "-o", out, "--mapping", f"odd={mapping}")
    assert (outcome.code, outcome.out) == (2, "")
    assert "column 1 (tick): the time has no unit" in outcome.err
    text = mapping.read_text()
    assert text.count('unit = ""') == 2
    mapping.write_text(text.replace('unit = ""', 'unit = "ms"', 1).replace('unit = ""', 'unit = "deg"'))
    outcome = run("merge", log, odd, "-o", out, "--mapping", f"odd={mapping}")
    assert outcome.code == 0, outcome.err
    sensor = spheremcap.open(out).sensors["odd"]
    assert sensor["angle_rad"] == pytest.approx([np.pi / 2, np.pi])
    assert np.diff(sensor.stamp_ns).tolist() == [10_000_000]


def without(out, topic, index):
    """An uncompressed recording, one message of which no reader knows as such any more; nothing else says so:
    there are no checksums, and the statistics are those of the whole.
    """
    from mcap.writer import CompressionType, Writer

    with out.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False, enable_data_crcs=False)
        writer.start()
        channel = writer.register_channel(topic, "json", 0)
        for k in range(10):
            writer.add_message(channel, START_NS + k, f"message {k:02}".encode(), START_NS + k)
        writer.finish()
    data = bytearray(out.read_bytes())
    data[data.index(f"message {index:02}".encode()) - 31] = 0x80  # a private record: readers pass over it
    out.write_bytes(data)
    return out


def test_fewer_messages_than_the_files_own_statistics_say_is_a_loss(run, log, tmp_path):
    cut, out = without(tmp_path / "cut.mcap", "/x", 4), tmp_path / "out.mcap"
    outcome = run("merge", cut, "-o", out)
    assert outcome.code == 3
    assert f"{cut}: " in outcome.err
    assert "the file's own statistics" in outcome.err
    assert len(rows(out)) == 9


def test_sync_says_damage_and_exits_3(run, moved, tmp_path):
    _, video, imu = moved
    rough, cut = tmp_path / "rough.mcap", tmp_path / "cut.mcap"
    assert run("merge", video, imu, "-o", rough).code == 0
    cut.write_bytes(rough.read_bytes()[:-200])
    outcome = run("sync", cut, "--marker", "left_wrist", "--sensor", "imu_left_wrist")
    assert outcome.code == 3
    assert "windows agree" in outcome.out
    assert "cut.mcap is damaged: " in outcome.err
