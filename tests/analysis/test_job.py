"""A recording analysed as a whole: what was in it stays, what was found is beside it, what is not there is named."""

import csv
import hashlib
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from simulated import CAMERA, MOUNT, START_NS, simulated, told, truth
from stroke_recording import NAMES, SETTINGS, write_strokes

from spheremcap import api
from spheremcap.analysis.settings import AnalysisSettings
from spheremcap.config import chair_toml
from spheremcap.core.stroke import EventKind
from spheremcap.errors import SourceError, UsageError
from spheremcap.io import _pb
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.strokes import read_strokes
from spheremcap.synth.ride import wheel_points

GIVEN = AnalysisSettings.model_validate(SETTINGS)
WRISTS = ("left_wrist", "right_wrist")


@pytest.fixture(scope="module")
def made():
    return simulated(seconds=3.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("analysis")


@pytest.fixture(scope="module")
def recording(folder, made):
    wheels = {"left_wheel": "angle_rad", "right_wheel": "rate_rad_s"}
    return write_strokes(
        folder / "session.mcap", made, wheels=wheels, gaps={"right_elbow": slice(300, 312)}, requests=3
    )


@pytest.fixture(scope="module")
def report(folder, recording):
    return api.analyse(recording, folder / "analysed.mcap", GIVEN)


def contents(path):
    """(messages by topic in their order, metadata by name, attachments by name) of a recording."""
    with McapRecords(path) as records:
        messages = defaultdict(list)
        for raw in records.messages():
            messages[raw.channel.topic].append((raw.log_time, raw.publish_time, raw.data))
        return (
            dict(messages), {record.name: record.metadata for record in records.metadata},
            {a.name: a.data for a in records.attachments()},
        )  # fmt: skip


def analysed(recording, out, given=GIVEN, **more):
    return api.analyse(recording, out, given, overwrite=True, **more)


def test_every_message_stays_as_it_is_and_channels_are_added(recording, report):
    before, facts, attached = contents(recording)
    after, all_facts, all_attached = contents(report.output)
    for topic, messages in before.items():
        own = after[topic]
        if topic == "/tf":  # where the chair is stands beside where markers are
            assert set(messages) <= set(own)
        else:
            assert own == messages, topic
    added = set(after) - set(before)
    assert added == {"/analysis/chair", "/analysis/trunk"} | {
        f"/analysis/{side}/{kind}" for side in ("left", "right") for kind in ("arm", "events", "strokes")
    }
    assert len(after["/analysis/left/arm"]) == len(before["/markers/left_wrist/state"])
    assert facts.items() <= all_facts.items()
    assert attached.items() <= all_attached.items()
    assert set(all_attached) - set(attached) == {"analysis.toml"}
    (name,) = set(all_facts) - set(facts)
    assert name.startswith("spheremcap/analysis/")
    assert all_facts[name]["input"] == "session.mcap"
    assert all_facts[name]["chair"] == "tape measure, inclinometer, pushes"
    times = [[log_time for log_time, *_ in messages] for messages in after.values()]
    assert all(some == sorted(some) for some in times)


def test_what_is_written_is_what_was_found(made, report):
    found = report.findings
    with McapRecords(report.output) as records:
        events, strokes = read_strokes(records)
        samples = [_pb.ArmSample.FromString(raw.data) for raw in records.messages(["/analysis/left/arm"])]
    assert sorted(e.stamp_ns for e in events) == sorted(e.stamp_ns for h in found.hands.values() for e in h.events)
    own = contents(report.output)[0]
    for side, hand in found.hands.items():
        assert [t for t, *_ in own[f"/analysis/{side}/events"]] == [e.stamp_ns for e in hand.events]
        assert [t for t, *_ in own[f"/analysis/{side}/strokes"]] == [s.stamp_ns for s in hand.strokes]
    assert len(strokes) == sum(len(hand.strokes) for hand in found.hands.values()) >= 10
    wrist = np.array([(s.wrist.x, s.wrist.y, s.wrist.z) for s in samples])
    np.testing.assert_allclose(wrist[20:-20], made.true("left", "wrist")[20:-20], atol=0.012)
    assert samples[100].frame_id == "chair"
    assert samples[100].measured
    assert samples[100].HasField("angle_deg")
    for side, hand in found.hands.items():
        for kind in EventKind:
            assert np.abs(told(made, hand, kind) - truth(made, side, kind)).max() < 0.005
        assert [s.wheel_rad_s for s in hand.strokes if s.push_s] == pytest.approx(
            [20.0] * sum(s.push_s is not None for s in hand.strokes), rel=0.05
        )
    assert report.notes == []
    assert report.lost == []


def test_the_page_and_the_tables_are_beside_it(folder, report):
    assert [path.name for path in report.files] == [
        "analysed.report.html", "analysed.events.csv", "analysed.strokes.csv", "analysed.mean_cycle.csv",
    ]  # fmt: skip
    page, events, strokes, cycle = report.files
    assert page.read_text(encoding="utf-8").startswith("<!")
    rows = list(csv.DictReader(events.open()))
    assert [int(row["stamp_ns"]) for row in rows] == sorted(int(row["stamp_ns"]) for row in rows)
    assert {(row["side"], row["kind"]) for row in rows} == {(s, k.value) for s in ("left", "right") for k in EventKind}
    assert len(list(csv.DictReader(strokes.open()))) == sum(len(h.strokes) for h in report.findings.hands.values())
    bands = {(row["side"], row["quantity"]) for row in csv.DictReader(cycle.open())}
    assert {("left", "elbow_deg"), ("right", "speed_mps"), ("left", "angle_deg")} <= bands
    assert not list(folder.glob("*.part"))


def test_quality_counts_frames_gaps_requests_and_noise(report):
    quality = {q.marker: q for q in report.findings.quality}
    assert set(quality) == set(NAMES)
    assert quality["left_wrist"].measured == 1.0
    assert quality["left_wrist"].requests == 3
    assert quality["right_wrist"].requests == 0
    elbow = quality["right_elbow"]
    assert elbow.measured == pytest.approx(1 - 12 / 720)
    assert elbow.longest_gap_ms == pytest.approx(13 / 0.24, abs=0.1)
    assert all(q.noise == pytest.approx(1.0, rel=0.3) for q in quality.values())
    lengths = {one.segment: one for one in report.findings.lengths}
    assert lengths["left forearm"].median_m == pytest.approx(0.29, abs=0.002)
    assert all(one.constant for segment, one in lengths.items() if "arm" in segment)


def test_the_same_input_gives_the_same_bytes(recording, report, tmp_path):
    again = api.analyse(recording, tmp_path / "analysed.mcap", GIVEN)
    for one, other in zip((report.output, *report.files), (again.output, *again.files), strict=True):
        assert hashlib.sha256(one.read_bytes()).digest() == hashlib.sha256(other.read_bytes()).digest(), one.name


def test_what_cannot_be_analysed_is_refused_in_a_line(made, recording, report, tmp_path):
    with pytest.raises(SourceError, match="was analysed already"):
        analysed(report.output, tmp_path / "a.mcap")
    with pytest.raises(UsageError, match="no marker has a position in metres"):
        analysed(write_strokes(tmp_path / "px.mcap", made, ["left_wrist"], camera=None), tmp_path / "a.mcap")
    with pytest.raises(SourceError, match="has no markers of spheremcap in it; its topics: "):
        analysed(write_strokes(tmp_path / "none.mcap", replace(made, t_s=made.t_s[:0]), []), tmp_path / "a.mcap")
    with pytest.raises(UsageError):
        analysed(recording, recording)
    with pytest.raises(UsageError, match="overwrite"):
        api.analyse(recording, report.output, GIVEN)
    assert not (tmp_path / "a.mcap").exists()


def test_a_table_that_is_there_already_is_not_replaced(recording, tmp_path):
    (tmp_path / "a.events.csv").write_text("mine")
    with pytest.raises(UsageError, match=r"a\.events\.csv"):
        api.analyse(recording, tmp_path / "a.mcap", GIVEN)
    assert not (tmp_path / "a.mcap").exists()
    assert (tmp_path / "a.events.csv").read_text() == "mine"


def test_what_the_focal_length_is_unsure_of_is_no_noise_of_each_frame(made, report, tmp_path):
    """Frames scatter as they do with a camera that is known well; the rest is one error of all."""
    unsure = write_strokes(tmp_path / "r.mcap", made, WRISTS, camera=replace(CAMERA, focal_sd=0.03))
    found = analysed(unsure, tmp_path / "a.mcap").findings
    for side, arm in found.arms.items():
        usual = np.nanmedian(report.findings.arms[side].packed[:, [0, 3, 5]], axis=0)
        np.testing.assert_allclose(np.nanmedian(arm.packed[:, [0, 3, 5]], axis=0), usual, rtol=0.2)


# -- what is missing is named ------------------------------------------------------------------------


def notes_of(made, tmp_path, names=WRISTS, given=GIVEN, **more):
    report = analysed(write_strokes(tmp_path / "r.mcap", made, names, **more), tmp_path / "a.mcap", given)
    return report, "\n".join(report.notes)


def test_one_wrist_only(made, tmp_path):
    report, notes = notes_of(made, tmp_path, ["left_wrist", "left_elbow"])
    assert "no marker is right_wrist: no strokes of that hand" in notes
    assert "(there are: left_wrist, left_elbow)" in notes
    assert list(report.findings.hands) == ["left"]
    assert len(report.findings.hands["left"].events) >= 8


def test_no_wrist_at_all(made, tmp_path):
    report, notes = notes_of(made, tmp_path, ["left_elbow", "left_shoulder"])
    assert "no marker is left_wrist and right_wrist" in notes
    assert (report.findings.arms, report.findings.hands) == ({}, {})


def test_markers_by_other_names_are_taken_as_the_settings_say(made, tmp_path):
    given = AnalysisSettings.model_validate(
        {**SETTINGS, "markers": {"left_wrist": "left_elbow", "right_wrist": "nose"}}
    )
    report, notes = notes_of(made, tmp_path, ["left_wrist", "left_elbow"], given)
    assert "right_wrist is to be 'nose', which is not in the recording" in notes
    assert report.findings.arms["left"].marker == "left_elbow"
    assert "forearm_m" not in report.findings.arms["left"].values  # it is no elbow then
    with pytest.raises(ValueError, match="'green' cannot be left_wrist and left_elbow"):
        AnalysisSettings.model_validate({"markers": {"left_wrist": "green", "left_elbow": "green"}})


def test_no_rim_and_no_tilt(made, tmp_path):
    _, notes = notes_of(made, tmp_path, given=AnalysisSettings())
    assert "no rim: give wheel.rim_radius_m" in notes
    assert "nothing says how the camera is tilted" in notes


def test_a_wheel_that_tells_nothing_or_is_not_there(made, tmp_path):
    given = GIVEN.model_copy(update={"wheel": GIVEN.wheel.model_copy(update={"left": "nowhere"})})
    report, notes = notes_of(made, tmp_path, given=given, wheels={"imu_wheel": "nothing"})
    assert "wheel 'imu_wheel' has neither an angle nor a rate: it is not used" in notes
    assert "the left wheel is to be 'nowhere', of which there are no samples" in notes
    assert {e.evidence for e in report.findings.hands["left"].events[1:-1]} == {"radius and angle"}


def test_one_wheel_without_a_side_is_both_hands_and_two_are_asked_about(made, tmp_path):
    report, notes = notes_of(made, tmp_path, wheels={"hub": "angle_rad"})
    assert notes == ""
    for hand in report.findings.hands.values():
        assert {e.evidence for e in hand.events[1:-1]} == {"radius and slip"}
    report, notes = notes_of(made, tmp_path, wheels={"one": "angle_rad", "two": "angle_rad"})
    assert "which of one, two is the left wheel? Say so: wheel.left" in notes


def test_a_wheel_that_counts_backwards_is_turned_round(made, tmp_path):
    """The made-up sensor counts forward: with reverse = true no hand ever goes with the rim."""
    given = GIVEN.model_copy(update={"wheel": GIVEN.wheel.model_copy(update={"reverse": True})})
    report, notes = notes_of(made, tmp_path, given=given, wheels={"hub": "angle_rad"})
    assert all(hand.events == () for hand in report.findings.hands.values())
    assert "left hand: " in notes


def test_no_calibration(made, tmp_path):
    """Positions there are, but no camera beside them: nothing of the chair."""
    path = write_strokes(tmp_path / "r.mcap", made, WRISTS)
    report = analysed(path, tmp_path / "a.mcap")
    session = replace(report.findings.session, camera=None)
    from spheremcap.analysis.findings import findings_of

    found = findings_of(session, GIVEN)
    assert "no calibration is in the recording: no chair's frame, no strokes" in found.notes
    assert found.chair is None
    assert found.hands == {}
    assert set(found.arms) == {"left", "right"}


def test_what_contradicts_itself_is_said(made, tmp_path):
    wrong = AnalysisSettings.model_validate(
        {**SETTINGS, "chair": {"camera_xyz_chair_m": (1.08, 0.0, 0.9), "camera_down_deg": 15.0}}
    )
    _, notes = notes_of(made, tmp_path, given=wrong)
    assert "the wrists' circles do not agree with what is said of the chair: they are left out" in notes


def test_markers_on_the_chair_that_are_not_there(made, tmp_path):
    given = AnalysisSettings.model_validate(
        {**SETTINGS, "chair": {**SETTINGS["chair"], "points": [{"marker": "bolt", "xyz_chair_m": (0.1, 0, 0)}]}}
    )
    _, notes = notes_of(made, tmp_path, given=given)
    assert "bolt is to be on the chair, but has no position in the recording" in notes


def chair_clicks(made, path, width=1280, height=720):
    from spheremcap.core.chair import ChairClick

    clicks = []
    for side, points in wheel_points(made.motion, MOUNT, CAMERA).items():
        clicks += [ChairClick(f"{side}_rim", 0, float(x), float(y)) for x, y in points.rim_px[::3] if 0 <= y < height]
    path.write_text(chair_toml(clicks, width, height))
    return path


def test_clicks_tell_the_chair_and_those_on_another_picture_are_refused(made, recording, tmp_path):
    chair_clicks(made, tmp_path / "s.chair.toml")
    chair = {"clicks": "s.chair.toml", "camera_down_deg": 15.0}
    given = AnalysisSettings.model_validate({**SETTINGS, "chair": chair})
    report = analysed(recording, tmp_path / "a.mcap", given, folder=tmp_path)
    assert "clicks" in report.findings.chair.told_by
    np.testing.assert_allclose(report.findings.chair.camera_xyz_chair_m, MOUNT.xyz_chair_m, atol=0.02)
    assert "chair.toml" in contents(report.output)[2]
    chair_clicks(made, tmp_path / "s.chair.toml", 1920, 1080)
    with pytest.raises(UsageError, match="clicked on 1920x1080 pictures, the recording's are 1280x720"):
        analysed(recording, tmp_path / "b.mcap", given, folder=tmp_path)


# -- gaps, stops, damage -----------------------------------------------------------------------------


def arm_samples(path, side="left"):
    with McapRecords(path) as records:
        return [
            (raw.log_time, _pb.ArmSample.FromString(raw.data)) for raw in records.messages([f"/analysis/{side}/arm"])
        ]


def test_gaps_are_filled_only_when_asked_and_marked_then(made, tmp_path):
    path = write_strokes(tmp_path / "r.mcap", made, WRISTS, gaps={"left_wrist": slice(300, 305)})
    bare = arm_samples(analysed(path, tmp_path / "a.mcap").output)
    assert len(bare) == 715
    short = arm_samples(analysed(path, tmp_path / "b.mcap", fill_ms=20).output)
    assert len(short) == 715  # the gap is 25 ms long
    filled = arm_samples(analysed(path, tmp_path / "c.mcap", fill_ms=26).output)
    assert len(filled) == 720
    assert [n for n, (_, sample) in enumerate(filled) if not sample.measured] == list(range(300, 305))
    true = made.true("left", "wrist")[300:305]
    own = np.array([(s.wrist.x, s.wrist.y, s.wrist.z) for _, s in filled[300:305]])
    np.testing.assert_allclose(own, true, atol=0.02)
    assert filled[302][1].wrist_sd.x > filled[290][1].wrist_sd.x


def test_a_stop_leaves_a_part_that_can_be_read(recording, tmp_path):
    asked = iter([False, False, True])
    report = analysed(recording, tmp_path / "a.mcap", stop=lambda: next(asked, True))
    assert report.stopped
    assert report.part is not None
    assert report.part.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == [report.part.name]
    messages, *_ = contents(report.part)
    whole = contents(recording)[0]
    assert (
        messages["/markers/left_wrist/state"]
        == whole["/markers/left_wrist/state"][: len(messages["/markers/left_wrist/state"])]
    )
    early = analysed(recording, tmp_path / "b.mcap", stop=lambda: True)
    assert early.stopped
    assert not (tmp_path / "b.mcap").exists()


def test_damage_is_told(recording, tmp_path):
    data = bytearray(recording.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 3000] = bytes(3000)
    (tmp_path / "hurt.mcap").write_bytes(data)
    report = analysed(tmp_path / "hurt.mcap", tmp_path / "a.mcap")
    assert len(report.lost) == 1
    assert report.output.exists()


def test_frames_are_as_long_as_the_stamps_say(report):
    found = report.findings
    assert found.stamp_ns[0] == START_NS
    assert len(found.stamp_ns) == 720
