"""Reading back: whole, unindexed and truncated files; arrays with NaN where there is nothing."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer
from recording_data import CAMERA, MARKERS, PERIOD_NS, START_NS, result, stamp

from spheremcap.core.estimate import Status
from spheremcap.errors import SourceError
from spheremcap.io import _pb, recording
from spheremcap.io.mcap_log import McapLog, RunInfo, schema_id
from spheremcap.io.messages import timestamp
from spheremcap.io.summary import summarise

COUNT = 48
RUN = RunInfo("s.mp4", 1, "cd" * 32, settings_toml="[hough]\ndp = 4\n", seeds_toml="# seeds")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("rec") / "whole.mcap"
    with McapLog(path, camera=CAMERA, markers=MARKERS, run=RUN) as log:
        for index in range(COUNT):
            log.write(result(index), None)
    return path


@pytest.fixture(scope="module")
def unindexed(whole):
    path = whole.with_name("unindexed.mcap")
    with path.open("wb") as file:
        writer = Writer(
            file, chunk_size=20_000, compression=CompressionType.LZ4, index_types=IndexType.NONE,
            repeat_channels=False, repeat_schemas=False, use_statistics=False, use_summary_offsets=False,
        )  # fmt: skip
        writer.start()
        log = McapLog(writer, camera=CAMERA, markers=MARKERS, run=RUN)
        for index in range(COUNT):
            log.write(result(index), None)
        log.close()
        writer.finish()
    return path


@pytest.mark.parametrize("kind", ["whole", "unindexed"])
def test_arrays_are_what_was_written(kind, request):
    session = recording.open(request.getfixturevalue(kind))
    assert session.damage is None
    track = session.tracks["left_wrist"]
    given_ = [result(index) for index in range(COUNT)]
    estimates = [frame.estimates[0] for frame in given_]
    assert track.stamp_ns.tolist() == [stamp(index) for index in range(COUNT)]
    assert track.frame.tolist() == list(range(COUNT))
    assert track.status.tolist() == [e.status.value for e in estimates]
    assert track.reasons.tolist() == [";".join(e.reasons) for e in estimates]
    assert "colour;no outline" in track.reasons
    assert track.measured.tolist() == [e.status.measured for e in estimates]
    for row, e in enumerate(estimates):
        for name in ("xyz_cam_m", "covariance_m2", "velocity_cam_mps"):
            expected = getattr(e, name)
            got = getattr(track, name)[row]
            np.testing.assert_array_equal(got, np.full(got.shape, np.nan) if expected is None else expected)
        for got, circle in ((track.circle_px[row], e.circle), (track.claim_px[row], e.claim)):
            np.testing.assert_array_equal(got, [np.nan] * 3 if circle is None else recording_circle(circle))
        np.testing.assert_array_equal(track.vote_sum[row], np.nan if e.vote_sum is None else e.vote_sum)
    assert np.array_equal(np.isnan(track.smoothed_xyz_cam_m[:, 0]), [e.xyz_cam_m is None for e in estimates])
    assert session.requests == tuple(r for frame in given_ for r in frame.requests)
    assert session.settings == {"hough": {"dp": 4}}
    assert session.seeds_toml == "# seeds"
    assert session.info["input_name"] == "s.mp4"
    assert session.info["complete"] == "yes"
    assert session.camera == dataclasses.replace(CAMERA, source="the recording")


def recording_circle(circle):
    return [circle.x_px, circle.y_px, circle.r_px]


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize("kind", ["whole", "unindexed"])
def test_a_truncated_file_gives_what_can_be_read_and_says_so(kind, share, request, tmp_path):
    source = request.getfixturevalue(kind)
    data = source.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(share * len(data))])
    session = recording.open(cut)
    assert session.damage is not None
    assert "\n" not in session.damage
    assert summarise(cut).damage == session.damage
    if session.tracks:
        kept = session.tracks["left_wrist"]
        assert kept.stamp_ns.tolist() == [stamp(index) for index in range(len(kept))]
    assert session.tracks or kind == "whole"


def test_what_is_no_mcap_is_refused_in_one_line(tmp_path):
    (tmp_path / "no.mcap").write_bytes(b"not at all")
    for path in (tmp_path / "no.mcap", tmp_path / "absent.mcap"):
        with pytest.raises(SourceError, match=path.name):
            recording.open(path)


def test_at_gives_one_row_for_each_stamp_and_nan_where_nothing_is_near(whole):
    track = recording.open(whole).tracks["left_elbow"]
    stamps = [START_NS - 10**9, stamp(3) + 1000, stamp(3) + 2000, stamp(7)]
    there = track.at(stamps)
    assert there.stamp_ns.tolist() == stamps
    assert there.frame.tolist() == [-1, 3, -1, 7]
    assert there.status.tolist() == ["", "VERIFIED", "", "VERIFIED"]
    assert np.isnan(there.xyz_cam_m[[0, 2]]).all()
    np.testing.assert_array_equal(there.covariance_m2[3], track.covariance_m2[7])
    assert track.at([stamp(3) + 1000], tolerance_ns=999).frame.tolist() == [-1]
    assert len(track.at([])) == 0


stamps_ns = st.lists(st.integers(0, 200), max_size=20)


@given(stamps_ns.map(sorted), stamps_ns, st.integers(0, 50))
def test_matching_is_one_to_one_and_within_the_tolerance(samples, stamps, tolerance_ns):
    index = recording.match(np.array(samples, np.int64), np.array(stamps, np.int64), tolerance_ns)
    pairs = [(s, i) for s, i in zip(stamps, index.tolist(), strict=True) if i >= 0]
    assert len({i for _, i in pairs}) == len(pairs)
    for s, i in pairs:
        assert abs(samples[i] - s) <= tolerance_ns
        assert abs(samples[i] - s) == min(abs(x - s) for x in samples)
    for s, i in zip(stamps, index.tolist(), strict=True):
        if i < 0:  # nothing near enough, or the nearest sample went to a stamp that is at least as near
            nearest = min((abs(x - s) for x in samples), default=None)
            taken = {samples[j] for _, j in pairs}
            assert nearest is None or nearest > tolerance_ns or taken & {s - nearest, s + nearest}


def test_sensors_come_back_with_nan_where_nothing_was_set(tmp_path):
    path = tmp_path / "imu.mcap"
    writer = Writer(str(path))
    writer.start()
    topic = "/sensors/imu_left_wrist"
    other = writer.register_channel("/sensors/wheel/circle", "protobuf", schema_id(writer, _pb.Circle))
    writer.add_message(other, 7, _pb.Circle(r_px=3).SerializeToString(), 7)
    channel = writer.register_channel(topic, "protobuf", schema_id(writer, _pb.ImuSample))
    for index in range(5):
        sample = _pb.ImuSample(timestamp=timestamp(index), linear_acceleration={"x": index, "z": 9.81})
        if index == 2:
            sample.temperature_c = 0.0
            sample.saturated = True
        writer.add_message(channel, 100 + index, sample.SerializeToString(), index)
    writer.finish()
    sensors = recording.open(path).sensors
    assert sensors["wheel/circle"]["r_px"].tolist() == [3]
    sensor = sensors["imu_left_wrist"]
    assert sensor.stamp_ns.tolist() == [100, 101, 102, 103, 104]
    assert sensor.own_stamp_ns.tolist() == [0, 1, 2, 3, 4]
    assert sensor["linear_acceleration"].shape == (5, 3)
    assert sensor["linear_acceleration.x"].tolist() == [0, 1, 2, 3, 4]
    assert np.isnan(sensor["angular_velocity"]).all()
    np.testing.assert_array_equal(sensor["temperature_c"], [np.nan, np.nan, 0, np.nan, np.nan])
    assert sensor.at([103, 400], tolerance_ns=0)["saturated"].shape == (2,)
    with pytest.raises(KeyError, match="there are"):
        sensor["no such thing"]


def test_a_summary_counts_statuses_gaps_and_requests(whole):
    summary = summarise(whole)
    wrist, elbow = summary.markers
    assert (wrist.marker, wrist.frames) == ("left_wrist", COUNT)
    assert wrist.frames_by_status == {s.value: COUNT // 6 * (2 if s is Status.VERIFIED else 1) for s in Status}
    assert (wrist.longest_gap_frames, wrist.longest_gap_s) == (3, pytest.approx(4 * PERIOD_NS / 1e9))
    assert len(wrist.requests) == COUNT // 6
    assert (elbow.longest_gap_frames, elbow.longest_gap_s, elbow.requests) == (0, 0.0, ())
    assert {t.topic: t.messages for t in summary.topics}["/markers/left_wrist/state"] == COUNT
    assert (summary.start_ns, summary.end_ns) == (stamp(0), stamp(COUNT - 1))
    assert summary.runs[RUN.id]["input_sha256"] == RUN.input_sha256
    assert summary.attachments == ("settings.toml", "seeds.toml")
    assert summary.library.startswith("spheremcap/")


def test_a_summary_of_anybodys_file(tmp_path):
    path = tmp_path / "x.mcap"
    writer = Writer(str(path))
    writer.start("ros2", "somebody")
    schema = writer.register_schema("a/msg/B", "ros2msg", b"int32 x")
    writer.add_message(writer.register_channel("/b", "cdr", schema), 5, b"1234", 5)
    writer.add_message(writer.register_channel("/json", "json", 0), 9, b"{}", 9)
    writer.finish()
    summary = summarise(path)
    assert [(t.topic, t.schema, t.encoding, t.messages) for t in summary.topics] == [
        ("/b", "a/msg/B", "cdr", 1),
        ("/json", "", "json", 1),
    ]
    assert (summary.start_ns, summary.end_ns, summary.markers) == (5, 9, ())
    session = recording.open(path)
    assert (session.tracks, session.sensors, session.settings, session.info) == ({}, {}, {}, {})
