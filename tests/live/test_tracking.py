"""A file paced in real time stands in for a camera; viewers are real, and so is the server."""

import signal
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from viewer import Told, Viewer

from clips import seed, write_clip
from spheremcap.config import CameraSettings, Settings, parse_seed
from spheremcap.core.marker import Seed
from spheremcap.errors import UsageError
from spheremcap.io.contents import contents
from spheremcap.io.layout import layout
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import open as open_recording
from spheremcap.live.server import ViewerServer
from spheremcap.live.tracking import Shown, track_live

PICTURES, STATE = "/camera/image", "/markers/orange/state"
SEED = parse_seed(seed("orange"))
METRES = CameraSettings(width_px=320, height_px=240, fx_px=600.0, fy_px=600.0, cx_px=159.5, cy_px=119.5)


class Watcher(threading.Thread):
    """A viewer that subscribes to whatever comes until the server goes; or never reads again once it has pictures."""

    def __init__(self, address: str, reads: bool = True) -> None:
        super().__init__()
        self.viewer, self.reads, self.told = Viewer(address), reads, []

    def run(self) -> None:
        known = 0
        try:
            while True:
                got = self.viewer.receive(10)
                if isinstance(got, Told):
                    self.told.append(got)
                if len(self.viewer.channels) > known:
                    known = len(self.viewer.channels)
                    self.viewer.subscribe()
                if not self.reads and PICTURES in self.viewer.channels:
                    return
        except Exception:  # the connection ends with the run
            self.viewer.socket.close()


def stored(recording: Path) -> dict[str, dict[int, bytes]]:
    """Of each topic the bytes by log time."""
    found: dict[str, dict[int, bytes]] = {}
    with McapRecords(recording) as records:
        for message in records.messages():
            found.setdefault(message.channel.topic, {})[message.log_time] = message.data
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, clip: Path):
    """A run with a viewer: the report, the recording, what the viewer was told and what it knows of channels."""
    out = tmp_path_factory.mktemp("live") / "live.mcap"
    long = write_clip(out.with_name("long.mp4"), 480)
    with ViewerServer(0) as server:
        watcher = Watcher(server.address)
        watcher.start()
        report = track_live(str(long), out, Settings(), [SEED], server)
    watcher.join(20)
    assert not watcher.is_alive()
    return report, out, watcher


def test_the_recording_has_every_tracked_frame_and_says_what_was_skipped(run):
    report, out, _ = run
    messages = stored(out)
    assert report.frames == len(messages[PICTURES]) == len(messages[STATE])
    with McapRecords(out) as records:
        skipped = 480 - report.frames
        outcome = next(m for m in records.metadata if m.name.startswith("spheremcap/outcome/"))
        assert outcome.metadata["complete"] == "yes"
        assert outcome.metadata["frames"] == str(report.frames)
        if skipped:
            plural = "s" * (skipped != 1)
            assert f"{skipped} picture{plural} skipped" in outcome.metadata["lost"]
            assert any(f"{skipped} picture{plural} skipped" in line for line in report.lost)
            assert any(b"skipped" in data for data in messages["/log"].values())
    track = open_recording(out).tracks["orange"]
    assert track.measured.mean() > 0.5


def test_viewers_get_the_bytes_of_the_recording(run):
    _, out, watcher = run
    messages = stored(out)
    assert {told.topic for told in watcher.told} >= {PICTURES, STATE, "/markers/orange/votes", "/camera/annotations"}
    for told in watcher.told:
        if told.topic != "/log":  # where several may share a time
            assert messages[told.topic][told.log_time] == told.data
    # From when it knew of the channel, each of them.
    seen = [told.log_time for told in watcher.told if told.topic == STATE]
    assert seen == [log_time for log_time in messages[STATE] if log_time >= seen[0]]
    assert len(seen) > len(messages[STATE]) / 2
    for topic, channel in watcher.viewer.channels.items():
        with McapRecords(out) as records:
            mine = next(c for c in records.channels.values() if c.topic == topic)
            assert channel["schemaName"] == records.schemas[mine.schema_id].name


@pytest.mark.parametrize("camera", [CameraSettings(), METRES])
def test_what_it_will_have_is_told_before_the_first_picture_and_is_what_it_then_has(tmp_path, clip, camera):
    """But for the lists that stay empty where there is nothing to say."""
    told = []

    def begins(found):
        assert not tracked
        told.append(found)

    out, tracked = tmp_path / "live.mcap", []
    with ViewerServer(0) as server:
        track_live(
            str(clip), out, Settings(camera=camera), [SEED], server, begins=begins,
            progress=lambda done, skipped: tracked.append(len(told)),
        )  # fmt: skip
    assert set(tracked) == {1}
    (promised,), has = told, contents(out)
    for name in ("name", "picture", "calibration", "markers", "world"):
        assert getattr(promised.cameras[0], name) == getattr(has.cameras[0], name), name
    assert len(promised.cameras[0].xyz_cam_m) == camera.given
    if camera.given:
        assert np.allclose(promised.cameras[0].xyz_cam_m[0], has.cameras[0].xyz_cam_m[0], rtol=0.05, atol=0.01)
    assert promised.topics >= {
        topic for topic in has.topics if topic.startswith(("/markers/orange/v", "/requests", "/log"))
    }
    panels, later = (layout(found)["configById"] for found in (promised, has))
    assert set(panels) >= set(later)


def test_nothing_is_told_of_a_run_that_cannot_begin(tmp_path, clip):
    told = []
    with ViewerServer(0) as server, pytest.raises(UsageError):
        track_live(str(clip), tmp_path / "live.mcap", Settings(), [], server, begins=told.append)
    assert told == list(tmp_path.iterdir()) == []


def test_pictures_are_jpeg_and_at_most_thirty_a_second(run):
    watcher = run[2]
    stamps = [told.log_time for told in watcher.told if told.topic == PICTURES]
    assert len(stamps) > 10
    assert len(stamps) <= 30 * (stamps[-1] - stamps[0]) / 1e9 + 2
    picture = CompressedImage.FromString(next(told.data for told in watcher.told if told.topic == PICTURES))
    assert picture.format == "jpeg"
    assert cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR) is not None


def test_pictures_are_thinned_evenly_and_nothing_else_is():
    class Kept(list):
        __hash__ = object.__hash__

        def register_schema(self, name, encoding, data):
            return {"foxglove.CompressedImage": 1, "x.State": 2}[name]

        def register_channel(self, topic, message_encoding, schema_id, metadata=None):
            return schema_id

        def add_message(self, *message):
            self.append(message)

    recording, viewers = Kept(), Kept()
    both = Shown(recording, viewers)
    for id_, name in ((1, "foxglove.CompressedImage"), (2, "x.State")):
        both.register_channel(name, "protobuf", both.register_schema(name, "protobuf", b""), {})
        for number in range(240):
            stamp_ns = 10**18 + number * 1_000_000_000 // 240
            both.add_message(id_, stamp_ns, b"", stamp_ns, number)
    assert [message[0] for message in recording] == [1] * 240 + [2] * 240
    assert [message[4] for message in viewers if message[0] == 2] == list(range(240))
    sent = [message[4] for message in viewers if message[0] == 1]
    assert 29 <= len(sent) <= 31
    assert set(np.diff(sent)) <= {7, 8, 9}


def test_who_never_reads_does_not_hold_up_the_recording(clip: Path, tmp_path: Path):
    out = tmp_path / "live.mcap"
    with ViewerServer(0) as server:
        asleep = Watcher(server.address, reads=False)
        asleep.start()
        report = track_live(str(clip), out, Settings(), [SEED], server)
    asleep.join(20)
    assert PICTURES in asleep.viewer.channels  # and it has subscribed
    assert report.frames == len(stored(out)[PICTURES])
    asleep.viewer.socket.close()


def test_a_seed_that_never_came_leaves_the_recording(clip: Path, tmp_path: Path):
    out, stopped = tmp_path / "live.mcap", threading.Event()
    late = Seed("blue", 100, SEED.circle)
    with ViewerServer(0) as server:
        report = track_live(
            str(clip), out, Settings(), [SEED, late], server,
            progress=lambda done, skipped: stopped.set(), stop=stopped.is_set,
        )  # fmt: skip
    assert out.exists()
    assert any("seed of blue on frame 100" in line for line in report.lost)


def test_a_second_circle_of_a_marker_is_refused(clip: Path, tmp_path: Path):
    out = tmp_path / "live.mcap"
    again = Seed("orange", 5, SEED.circle)
    with ViewerServer(0) as server, pytest.raises(UsageError, match="does not come again"):
        track_live(str(clip), out, Settings(), [SEED, again], server)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_ends_with_a_whole_recording(tmp_path: Path, number: int):
    long, out = write_clip(tmp_path / "long.mp4", 4800), tmp_path / "live.mcap"
    command = [sys.executable, "-m", "spheremcap", "live", str(long), "-o", str(out), "--port", "0"]
    command += ["--seed", seed("orange")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        with Viewer(address) as viewer:
            while STATE not in viewer.channels:
                viewer.receive(5)
            viewer.subscribe(STATE)
            while not isinstance(viewer.receive(5), Told):
                pass
            process.send_signal(number)
            said, errors = process.communicate(timeout=30)
    assert process.returncode in (0, 3), errors
    assert (process.returncode == 3) == ("skipped" in errors)
    assert "Traceback" not in errors
    assert f"frames -> {out}" in said
    assert not out.with_name("live.mcap.part").exists()
    with McapRecords(out) as records:
        assert not records.damage()
        assert 0 < len(list(records.messages({STATE}))) < 4800


def test_an_output_that_is_there_is_refused_before_anything_is_opened(clip: Path, tmp_path: Path):
    (tmp_path / "live.mcap").write_bytes(b"mine")
    command = [sys.executable, "-m", "spheremcap", "live", str(clip), "-o", str(tmp_path / "live.mcap")]
    done = subprocess.run([*command, "--seed", seed("orange")], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "--overwrite" in done.stderr
