"""Inputs' coordinate frames under one world, and what a merge says of inputs without a time."""

from dataclasses import replace

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap.reader import make_reader
from recording_data import CAMERA, MARKERS, PERIOD_NS, result

from spheremcap.core.estimate import Status
from spheremcap.errors import UsageError
from spheremcap.io.frames import frames_of
from spheremcap.io.mcap_log import STATIC_PERIOD_NS, McapLog, RunInfo
from spheremcap.io.mcap_records import McapRecords
from spheremcap.merging.dataset import Source, merge
from spheremcap.merging.frames import FramesStream, loose


def recording(path, time_source="", stamps=range(3)):
    with McapLog(path, camera=CAMERA, markers=MARKERS, run=RunInfo(path.name, time_source=time_source)) as log:
        for index in stamps:
            log.write(result(index, [Status.VERIFIED] * 2), None)
    return path


def test_what_hangs_nowhere_is_found():
    parents = {"camera": "world", "optical": "camera", "right/camera": "right/world"}
    assert loose({"optical"}, parents) == []
    assert loose({"optical", "right/camera", "imu"}, parents) == ["imu", "right/world"]
    assert loose({"a"}, {"a": "b", "b": "a"}) == []  # a circle is one


def test_a_prefix_goes_before_frames_too_and_all_are_connected(tmp_path):
    path, out = recording(tmp_path / "a.mcap"), tmp_path / "out.mcap"
    dataset = merge([Source(path), Source(path, "second", prefix="/right")], out)
    assert any("right/world" in note for note in dataset.notes)
    with McapRecords(out) as records:
        used, parents = frames_of(records)
    assert {"camera_optical", "right/camera_optical"} <= used
    assert parents["right/world"] == "world"
    assert loose(used, parents) == []
    # A merge of that adds to it what is new, on a topic of its own.
    again = tmp_path / "again.mcap"
    merge([Source(out), Source(path, "third", prefix="left")], again)
    with McapRecords(again) as records:
        used, parents = frames_of(records)
        assert {c.topic for c in records.channels.values()} >= {"/merged/tf", "/merged2/tf"}
    assert loose(used, parents) == []


def test_one_recording_gets_no_further_frames(tmp_path):
    path, out = recording(tmp_path / "a.mcap"), tmp_path / "out.mcap"
    merge([Source(path)], out)
    with McapRecords(out) as records:
        assert not any("/merged" in c.topic for c in records.channels.values())


def test_frames_are_repeated_every_few_seconds_where_there_is_something():
    spans = [(0, 3 * STATIC_PERIOD_NS), (STATIC_PERIOD_NS, 2 * STATIC_PERIOD_NS), (10**18, 10**18)]
    stream = FramesStream(["imu"], "/merged/tf", spans)
    stamps = [message.log_time for message in stream.messages()]
    assert stamps == [0, STATIC_PERIOD_NS, 2 * STATIC_PERIOD_NS, 3 * STATIC_PERIOD_NS, 10**18]
    assert stream.count == len(stamps)
    (edge,) = FrameTransforms.FromString(next(stream.messages()).data).transforms
    assert (edge.parent_frame_id, edge.child_frame_id, edge.rotation.w) == ("world", "imu", 1)
    assert FramesStream(["imu"], "/merged/tf", [(0, 1 << 62)]).count == 10_000


def test_a_recording_without_a_time_is_named_with_what_to_do(tmp_path):
    timeless, other = tmp_path / "timeless.mcap", recording(tmp_path / "other.mcap")
    with McapLog(timeless, camera=None, markers=MARKERS, run=RunInfo("x", time_source="zero")) as log:
        for index in range(3):
            log.write(replace(result(index), stamp_ns=index * PERIOD_NS), None)
    said = []
    with pytest.raises(UsageError, match="does not overlap"):
        merge([Source(other), Source(timeless)], tmp_path / "out.mcap", say=said.append)
    (line,) = [line for line in said if "timeless.mcap" in line and "--start-time" in line]
    assert "--offset timeless=" in line
    fine = merge([Source(other)], tmp_path / "fine.mcap")
    assert not any("--start-time" in note for note in fine.notes)


def test_records_of_clocks_are_of_one_input_alone(tmp_path):
    path, names = recording(tmp_path / "a.mcap"), []
    for number in range(2):
        out = tmp_path / f"out{number}.mcap"
        merge([Source(path, offset_ns=number)], out)
        with out.open("rb") as file:
            names.append({m.name for m in make_reader(file).iter_metadata() if "/clock/" in m.name})
    assert names[0]
    assert names[0].isdisjoint(names[1])
