"""Coordinate frames in messages of any schema: found, renamed, and the rest of a message as it was."""

from recording_data import CAMERA, MARKERS, result

from spheremcap.core.estimate import Status
from spheremcap.io.frames import FrameNames, frames_of
from spheremcap.io.mcap_log import McapLog
from spheremcap.io.mcap_records import McapRecords


def recording(path):
    with McapLog(path, camera=CAMERA, markers=MARKERS) as log:
        for index in range(3):
            log.write(result(index, [Status.VERIFIED] * 2, view=index == 0), None)
    return path


def test_the_frames_of_a_recording_are_found_with_their_places(tmp_path):
    with McapRecords(recording(tmp_path / "a.mcap")) as records:
        used, parents = frames_of(records)
    assert used == {"camera_optical", "camera_optical_debug"}
    assert parents == {
        "camera": "world", "camera_optical": "camera", "camera_optical_debug": "camera_optical"
    }  # fmt: skip


def test_every_frame_of_every_message_is_renamed_and_nothing_else(tmp_path):
    renamed = 0
    with McapRecords(recording(tmp_path / "a.mcap")) as records:
        for raw in records.messages():
            names = FrameNames(raw.channel, records.schemas[raw.channel.schema_id])
            other = names.prefixed(raw.data, "right/")
            used, parents = names.of(raw.data)
            now_used, now_parents = names.of(other)
            assert now_used == {f"right/{frame}" for frame in used}
            assert now_parents == {f"right/{child}": f"right/{parent}" for child, parent in parents.items()}
            assert (other == raw.data) == (not used and not parents)
            renamed += other != raw.data
    assert renamed


def test_a_message_that_cannot_be_read_goes_as_it_is(tmp_path):
    with McapRecords(recording(tmp_path / "a.mcap")) as records:
        channel = next(c for c in records.channels.values() if c.topic == "/scene")
        names = FrameNames(channel, records.schemas[channel.schema_id])
    assert names.prefixed(b"\xff\xff", "right/") == b"\xff\xff"
    assert names.of(b"\xff\xff") == (set(), {})
