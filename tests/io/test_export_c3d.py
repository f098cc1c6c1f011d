"""C3D, read by ezc3d and by the package c3d: positions, residuals, rate, events, and sensors only where they fit."""

import sys
import warnings

import c3d as other_c3d
import ezc3d
import numpy as np
import pytest
from session_data import NAMES, START_NS, event, stamp, write_session, xyz_m

from spheremcap.core.estimate import Status
from spheremcap.core.stroke import EventKind
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.export import c3d, export_recording
from spheremcap.io.selection import Selection

COUNT = 48
RATE_HZ = 240_000 / 1001
BRIDGED = {
    "left_wrist": {10: Status.ESTIMATED, 11: Status.ESTIMATED, 20: Status.LOST}
    | dict.fromkeys(range(30, 36), Status.ESTIMATED)
}


def both(path, rel=1e-6):
    """Points (3, M, N) and residuals (M, N) as two readers have them, and all that ezc3d read; NaN where invalid."""
    file = ezc3d.c3d(str(path))
    points, residuals = file["data"]["points"][:3], file["data"]["meta_points"]["residuals"][0]
    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reader = other_c3d.Reader(stream)
        frames = np.array([data for _, data, _ in reader.read_frames()], np.float64)
        assert reader.point_rate == pytest.approx(RATE_HZ, rel=rel)
        assert [label.strip() for label in reader.point_labels] == list(file["parameters"]["POINT"]["LABELS"]["value"])
    theirs = frames[:, :, 3].T
    theirs_xyz = np.where(theirs < 0, np.nan, frames[:, :, :3].transpose(2, 1, 0))
    np.testing.assert_array_equal(theirs_xyz.astype(np.float32), points.astype(np.float32))
    np.testing.assert_allclose(theirs, residuals, rtol=1e-5)
    return points, residuals, file


def exported(tmp_path, *frames, rel=1e-6, **how):
    recording = write_session(
        tmp_path / "r.mcap", *frames, **{k: how.pop(k) for k in ("strokes", "imus", "stamps") if k in how}
    )
    done = export_recording(recording, tmp_path / "out.c3d", overwrite=True, **how)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.c3d", "r.mcap"]
    return done, *both(tmp_path / "out.c3d", rel)


def test_measured_points_are_there_in_mm_and_all_others_are_invalid(tmp_path):
    done, points, residuals, file = exported(tmp_path, range(COUNT), BRIDGED)
    assert (done.rows, done.notes, points.shape) == (COUNT, (), (3, 2, COUNT))
    for k, name in enumerate(NAMES):
        for index in range(COUNT):
            if index in BRIDGED.get(name, {}):
                assert residuals[k, index] == -1
                assert np.isnan(points[:, k, index]).all()
            else:
                np.testing.assert_allclose(points[:, k, index], 1000 * xyz_m(name, index), rtol=1e-6)
                assert residuals[k, index] == pytest.approx(8.485, abs=0.06)
    parameters = file["parameters"]
    assert parameters["POINT"]["RATE"]["value"][0] == pytest.approx(RATE_HZ, rel=1e-6)
    assert parameters["POINT"]["UNITS"]["value"] == ["mm"]
    assert (parameters["POINT"]["X_SCREEN"]["value"], parameters["POINT"]["Y_SCREEN"]["value"]) == (["+X"], ["-Y"])
    assert "optical frame" in parameters["POINT"]["__METADATA__"]["DESCRIPTION"]
    assert parameters["SPHEREMCAP"]["START"]["value"] == ["2023-11-14T22:13:20.123456789Z"]
    assert parameters["MANUFACTURER"]["SOFTWARE"]["value"] == ["spheremcap"]
    raw = (tmp_path / "out.c3d").read_bytes()
    block = int.from_bytes(raw[16:18], "little")
    words = np.frombuffer(raw, "<f4", 2 * 4 * COUNT, 512 * (block - 1)).reshape(COUNT, 2, 4)
    np.testing.assert_array_equal(words[10, 0], [0, 0, 0, -1])  # the convention for what is invalid


def test_gaps_are_filled_only_as_far_as_said_and_marked_as_no_measurement(tmp_path):
    _, points, residuals, file = exported(tmp_path, range(COUNT), BRIDGED, fill_ms=9)  # two frames are 8.3 ms
    left = residuals[0]
    assert np.flatnonzero(left == 0).tolist() == [10, 11]
    assert np.flatnonzero(left < 0).tolist() == [20, *range(30, 36)]  # a lost one has nothing to fill it with
    np.testing.assert_allclose(points[:, 0, 10], 1000 * xyz_m("left_wrist", 10) + 1, rtol=1e-6)  # the smoothed one
    np.testing.assert_allclose(points[:, 0, 9], 1000 * xyz_m("left_wrist", 9), rtol=1e-6)
    assert (residuals[1] > 0).all()
    assert file["parameters"]["SPHEREMCAP"]["FILL_MS"]["value"] == [9]


def test_what_lies_before_the_first_and_after_the_last_measurement_is_no_gap(tmp_path):
    ends = {"left_wrist": {0: Status.ESTIMATED, COUNT - 1: Status.ESTIMATED}}
    _, _, residuals, _ = exported(tmp_path, range(COUNT), ends, fill_ms=1000)
    assert (residuals[0, [0, -1]] == -1).all()


def test_frames_that_are_missing_keep_their_places_and_rounded_stamps_give_the_true_rate(tmp_path):
    there = [k for k in range(400) if not 100 <= k < 140 and k % 7]
    stamps = {k: START_NS + (stamp(k) - START_NS + 500_000) // 1_000_000 * 1_000_000 for k in there}  # whole ms
    done, points, residuals, _ = exported(tmp_path, there, stamps=stamps, rel=5e-6)
    assert points.shape == (3, 2, 398)  # from frame 1 to 398
    assert np.flatnonzero(residuals[0] >= 0).tolist() == [k - 1 for k in there]
    np.testing.assert_allclose(points[0, 0, 397], 1000 * xyz_m("left_wrist", 398)[0], rtol=1e-6)
    assert any("0.5" in note and "off a rate of 239.7" in note for note in done.notes)
    assert any(f"{398 - len(there)} frames are missing" in note for note in done.notes)


def test_of_two_frames_in_one_place_the_nearer_stays_and_that_is_said(tmp_path):
    done, points, _, _ = exported(tmp_path, range(COUNT), stamps={20: stamp(19.1)}, rel=1e-4)
    assert points.shape[2] == COUNT
    np.testing.assert_allclose(points[0, 0, 19], 1000 * xyz_m("left_wrist", 19)[0], rtol=1e-6)
    assert np.isnan(points[0, 0, 20])
    assert any("1 frames are left out" in note for note in done.notes)


def test_of_two_frames_at_one_time_the_first_stays_and_that_is_said(tmp_path):
    done, points, _, _ = exported(tmp_path, range(COUNT), stamps={20: stamp(19)})
    np.testing.assert_allclose(points[0, 0, 19], 1000 * xyz_m("left_wrist", 19)[0], rtol=1e-6)
    assert np.isnan(points[0, 0, 20])
    assert any("2 positions are left out" in note for note in done.notes)


def test_events_have_their_side_and_their_time_from_the_first_frame(tmp_path):
    slow = range(0, 20_000, 200)  # 83 s: minutes are told apart from seconds
    strokes = [
        event(EventKind.RELEASE, stamp(17_000.5), "right"), event(EventKind.CONTACT, stamp(300.25)),
        event(EventKind.CONTACT, START_NS - 1), event(EventKind.RELEASE, stamp(20_500)),
    ]  # fmt: skip
    recording = write_session(tmp_path / "r.mcap", slow, strokes=strokes)
    export_recording(recording, tmp_path / "out.c3d")
    found = ezc3d.c3d(str(tmp_path / "out.c3d"))["parameters"]["EVENT"]
    assert (found["USED"]["value"], found["LABELS"]["value"]) == ([2], ["CONTACT", "RELEASE"])
    assert found["CONTEXTS"]["value"] == ["Left", "Right"]
    times = found["TIMES"]["value"]
    assert times.shape == (2, 2)
    assert times[0].tolist() == [0, 1]
    np.testing.assert_allclose(60 * times[0] + times[1], np.array([300.25, 17_000.5]) / RATE_HZ, atol=1e-5)
    with (tmp_path / "out.c3d").open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = other_c3d.Reader(stream).get("EVENT:TIMES").float_array
    np.testing.assert_array_equal(theirs, times.T)


def test_more_events_than_one_parameter_holds_go_on_in_the_next(tmp_path):
    strokes = [event(EventKind.CONTACT, stamp(k / 10)) for k in range(300)]
    done, *_, file = exported(tmp_path, range(COUNT), strokes=strokes)
    found = file["parameters"]["EVENT"]
    assert found["USED"]["value"] == [300]
    assert (len(found["LABELS"]["value"]), len(found["LABELS2"]["value"])) == (255, 45)
    np.testing.assert_allclose(found["TIMES2"]["value"][1], np.arange(255, 300) / 10 / RATE_HZ, atol=1e-6)
    assert any("300 events" in note for note in done.notes)


@pytest.mark.parametrize("each", [1, 3, 4])
def test_a_sensor_whose_samples_keep_the_frames_time_is_analog(tmp_path, each):
    times = [stamp((k + 0.3) / each) for k in range(-5, COUNT * each + 5)]
    done, *_, file = exported(tmp_path, range(COUNT), imus={"imu": times})
    analog = file["parameters"]["ANALOG"]
    assert analog["LABELS"]["value"] == [f"imu.linear_acceleration.{axis}" for axis in "xyz"]
    assert analog["UNITS"]["value"] == ["m/s^2"] * 3
    assert analog["RATE"]["value"][0] == pytest.approx(each * RATE_HZ, rel=1e-6)
    values = file["data"]["analogs"][0]
    np.testing.assert_array_equal(values[0], np.arange(5, 5 + COUNT * each))
    np.testing.assert_array_equal(values[2], 9.8125)
    late_ms = f"{0.3 / each / RATE_HZ * 1000:.2f}"
    assert [note for note in done.notes if f"at most {late_ms} ms off" in note] == list(done.notes)
    with (tmp_path / "out.c3d").open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = np.concatenate([a for _, _, a in other_c3d.Reader(stream).read_frames()], axis=1)
    np.testing.assert_array_equal(theirs, values)


@pytest.mark.parametrize(
    ("times", "why"),
    [
        ([START_NS + k * 10_000_000 for k in range(-2, 25)], "100.00 Hz"),
        ([stamp(k) for k in range(5, COUNT + 5)], "5 would have no sample"),
        ([stamp(k) for k in range(-5, COUNT + 5) if k != 9], "1 would have no sample"),
        (sorted([*(stamp(k) for k in range(-5, COUNT + 5)), stamp(9.2)]), "1 samples no place"),
        ([stamp(1)], "one sample"),
    ],
)
def test_a_sensor_that_does_not_fit_is_left_out_and_named(tmp_path, times, why):
    done, *_, file = exported(tmp_path, range(COUNT), imus={"imu": times})
    assert file["data"]["analogs"].size == 0
    (note,) = done.notes
    assert note.startswith("imu is left out of the C3D: it has ")
    assert why in note


def test_of_two_rates_that_fit_one_is_taken_and_the_other_named(tmp_path):
    imus = {name: [stamp(k / m) for k in range(-5, COUNT * m + 5)] for name, m in (("a", 1), ("b", 4), ("c", 4))}
    done, *_, file = exported(tmp_path, range(COUNT), imus=imus)
    assert {label[0] for label in file["parameters"]["ANALOG"]["LABELS"]["value"]} == {"b", "c"}
    assert any(note.startswith("a is left out") for note in done.notes)


def test_markers_and_times_are_chosen_as_for_tables(tmp_path):
    chosen = Selection(("right_wrist",), round(10.5 * 1e9 / RATE_HZ), round(20.5 * 1e9 / RATE_HZ))
    strokes = [event(EventKind.CONTACT, stamp(k)) for k in (5, 15.5, 25)]
    _, points, _, file = exported(tmp_path, range(COUNT), wanted=chosen, strokes=strokes)
    assert (points.shape, file["parameters"]["POINT"]["LABELS"]["value"]) == ((3, 1, 10), ["right_wrist"])
    np.testing.assert_allclose(points[:, 0, 0], 1000 * xyz_m("right_wrist", 11), rtol=1e-6)
    np.testing.assert_allclose(file["parameters"]["EVENT"]["TIMES"]["value"][1], 4.5 / RATE_HZ, atol=1e-6)


def test_what_a_c3d_cannot_hold_is_refused_in_one_line(tmp_path, monkeypatch):
    long = write_session(tmp_path / "long.mcap", range(COUNT))
    with monkeypatch.context() as patch:
        patch.setattr(c3d, "MOST_FRAMES", COUNT - 1)
        with pytest.raises(UsageError, match=r"holds 47 frames, 0 s at 239\.760 Hz.*--from and --to"):
            export_recording(long, tmp_path / "out.c3d")
        gap = write_session(tmp_path / "gap.mcap", [*range(COUNT - 10), COUNT])
        with pytest.raises(UsageError, match="--from and --to"):  # few frames, but far apart
            export_recording(gap, tmp_path / "out.c3d")
        patch.setattr(c3d, "MOST_FRAMES", COUNT)
        assert export_recording(long, tmp_path / "out.c3d").rows == COUNT
    for how, word in (
        ({"fill_ms": -1.0}, "above 0"), ({"table": "events"}, "--table"), ({"excel": True}, "--excel"),
        ({"wanted": Selection(("nose",))}, "there are: left_wrist, right_wrist"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=word):
            export_recording(long, tmp_path / "new.c3d", **how)
    with pytest.raises(SourceError, match="0 frames"):
        export_recording(long, tmp_path / "new.c3d", wanted=Selection(start_ns=10**9))
    blind = write_session(tmp_path / "blind.mcap", range(COUNT), camera=False)
    with pytest.raises(SourceError, match="--camera"):
        export_recording(blind, tmp_path / "new.c3d")
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(UsageError, match=r"pip install 'spheremcap\[c3d\]'"):
        export_recording(long, tmp_path / "new.c3d")
    assert not list(tmp_path.glob("new*"))


def test_as_many_frames_as_a_c3d_holds_are_read_back_by_both(tmp_path):
    recording = write_session(tmp_path / "r.mcap", [*range(100), c3d.MOST_FRAMES - 1])
    assert export_recording(recording, tmp_path / "out.c3d").rows == c3d.MOST_FRAMES
    points, residuals, _ = both(tmp_path / "out.c3d")
    assert points.shape == (3, 2, c3d.MOST_FRAMES)
    assert np.flatnonzero(residuals[0] > 0).tolist() == [*range(100), c3d.MOST_FRAMES - 1]


def test_a_disk_that_ezc3d_does_not_notice_is_full_is_noticed(tmp_path, monkeypatch):
    recording = write_session(tmp_path / "r.mcap", range(COUNT))
    whole = c3d._laid_out
    monkeypatch.setattr(c3d, "_laid_out", lambda file: whole(file)[:-1000])
    with pytest.raises(Exception, match="free some space"):
        export_recording(recording, tmp_path / "out.c3d")
    assert not list(tmp_path.glob("out*"))
