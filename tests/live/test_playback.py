"""A real viewer connects to a recording that is played."""

import base64
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from viewer import State, Told, Viewer
from websockets.exceptions import ConnectionClosed

from spheremcap.errors import UsageError
from spheremcap.io.annex_b import is_key_picture
from spheremcap.io.mcap_records import McapRecords
from spheremcap.live.playback import Playback
from spheremcap.live.server import ViewerServer

ENDED, PLAYS, STANDS = 3, 0, 1


@pytest.fixture
def address(recording: Path):
    """Where the recording is played while a test goes on."""
    done = threading.Event()
    with McapRecords(recording) as records, Playback(records, 0) as playback:
        thread = threading.Thread(target=playback.run, args=(done.is_set,))
        thread.start()
        try:
            yield playback.server.address
        finally:
            done.set()
            thread.join(10)
            assert not thread.is_alive()


def stored(recording: Path):
    with McapRecords(recording) as records:
        return list(records.messages())


def told_until(viewer: Viewer, done, timeout_s: float = 20) -> list[Told]:
    """The messages up to what `done` says yes to."""
    told, end = [], time.monotonic() + timeout_s
    while time.monotonic() < end:
        got = viewer.receive(0.2)
        if isinstance(got, Told):
            told.append(got)
        if got is not None and done(got):
            return told
    raise AssertionError(f"nothing like it in {timeout_s} s; states {viewer.states}")


def advertised(viewer: Viewer) -> None:
    while not viewer.channels:
        viewer.receive(1)


def quiet(viewer: Viewer, for_s: float = 0.4) -> list[Told]:
    """The messages until there are none for so long."""
    told, began = [], time.monotonic()
    last = began
    while time.monotonic() - last < for_s:
        assert last - began < 20, "it never ends"
        if isinstance(got := viewer.receive(0.05), Told):
            told.append(got)
            last = time.monotonic()
    return told


def test_every_message_comes_with_its_bytes_and_its_schema(address: str, recording: Path):
    messages = stored(recording)
    with McapRecords(recording) as records, Viewer(address) as viewer:
        advertised(viewer)
        for channel in records.channels.values():
            seen, schema = viewer.channels[channel.topic], records.schemas[channel.schema_id]
            assert (seen["encoding"], seen["schemaName"]) == ("protobuf", schema.name)
            assert base64.b64decode(seen["schema"]) == schema.data
        viewer.ask(play=False)
        viewer.subscribe()
        quiet(viewer)
        began = time.monotonic()
        viewer.ask(play=True, seek_ns=messages[0].log_time)
        told = told_until(viewer, lambda got: isinstance(got, State) and got.status == ENDED)
        took_s = time.monotonic() - began
        told += quiet(viewer)  # the state may overtake the last messages
    every = [Told(m.channel.topic, m.log_time, m.data) for m in messages]
    first_ns = messages[0].log_time  # of which only the last of a topic is shown after the jump
    assert set(told) <= set(every)
    assert {m.topic for m in told} == {m.topic for m in every}
    assert sorted(m for m in told if m.log_time > first_ns) == sorted(m for m in every if m.log_time > first_ns)
    assert took_s > 0.8 * (messages[-1].log_time - messages[0].log_time) / 1e9


def test_nothing_is_offered_but_the_time_bar(address: str, recording: Path):
    with Viewer(address) as viewer:
        advertised(viewer)
        assert sorted(viewer.info["capabilities"]) == ["playbackControl", "time"]
        assert viewer.info["dataStartTime"]["sec"] == stored(recording)[0].log_time // 10**9
        viewer.send(op="fetchAsset", uri="file:///etc/passwd", requestId=1)
        viewer.send(op="getParameters", parameterNames=[], id="1")
        viewer.send(op="advertise", channels=[{"id": 1, "topic": "/x", "encoding": "json", "schemaName": "x"}])
        viewer.subscribe("/log")
        quiet(viewer)
        said = json.dumps([viewer.info, *viewer.texts])
        assert str(recording.parent) not in said
        assert recording.name not in said
        assert not {text["op"] for text in viewer.texts} & {"parameterValues", "advertiseServices"}
        assert "root:" not in said


def test_a_seek_shows_the_video_from_its_key_frame_and_the_last_of_all_else(address: str, recording: Path):
    messages = stored(recording)
    goal = [m for m in messages if m.channel.topic == "/camera/video"][77].log_time
    with Viewer(address) as viewer:
        advertised(viewer)
        viewer.subscribe("/camera/video", "/markers/orange/state")
        viewer.ask(play=False)
        quiet(viewer)
        viewer.ask(play=False, seek_ns=goal, request=b"there")
        told = quiet(viewer)
        assert viewer.states[-1] == State(STANDS, goal, 1.0, True, "there")
        videos = [CompressedVideo.FromString(m.data) for m in told if m.topic == "/camera/video"]
        stamps = [m.log_time for m in told if m.topic == "/camera/video"]
        assert is_key_picture(videos[0].data, videos[0].format)
        assert not any(is_key_picture(video.data, video.format) for video in videos[1:])
        every = [m.log_time for m in messages if m.channel.topic == "/camera/video"]
        assert stamps == every[every.index(stamps[0]) : every.index(goal) + 1]
        assert [m.log_time for m in told if m.topic == "/markers/orange/state"] == [goal]
        assert quiet(viewer) == []  # it stands
        viewer.ask(play=True, speed=0.5)
        began = time.monotonic()
        rest = told_until(viewer, lambda got: isinstance(got, State) and got.status == ENDED)
        took_s = time.monotonic() - began
        rest += quiet(viewer)
    states = [m.log_time for m in rest if m.topic == "/markers/orange/state"]
    assert states == [log_time for log_time in every if log_time > goal]
    assert took_s > 0.8 * 2 * (messages[-1].log_time - goal) / 1e9


def test_who_comes_while_it_stands_sees_where_it_stands(address: str, recording: Path):
    goal = [m for m in stored(recording) if m.channel.topic == "/camera/video"][50].log_time
    with Viewer(address) as viewer:
        advertised(viewer)
        viewer.ask(play=False, seek_ns=goal)
        quiet(viewer)
        viewer.subscribe("/markers/orange/state")
        assert [m.log_time for m in quiet(viewer)] == [goal]


def test_without_a_time_bar_it_plays_again_for_the_next_who_comes(address: str):
    for _ in range(2):
        with Viewer(address) as viewer:
            advertised(viewer)
            viewer.subscribe("/markers/orange/state")
            told = told_until(viewer, lambda got: isinstance(got, State) and got.status == ENDED) + quiet(viewer)
        assert len({m.log_time for m in told}) == 120
        time.sleep(0.3)  # until the server knows that nobody looks


def test_who_never_reads_holds_nobody_up():
    with ViewerServer(0) as server, socket.create_connection(("127.0.0.1", int(server.address.rpartition(":")[2]))):
        channel = server.register_channel("/big", "protobuf", server.register_schema("x.Big", "protobuf", b""))
        with Viewer(server.address) as asleep:
            advertised(asleep)
            asleep.subscribe("/big")
            time.sleep(0.2)
            began = time.monotonic()
            for number in range(3000):
                server.add_message(channel, number, bytes(100_000), number, number)
            took_s = time.monotonic() - began
            # And whoever wakes up sees the newest.
            with contextlib.suppress(ConnectionClosed):
                assert max(m.log_time for m in quiet(asleep)) == 2999
    assert took_s < 10


def test_only_this_machine_is_listened_to(address: str):
    port = int(address.rpartition(":")[2])
    listening = [
        fields[1]
        for table in ("/proc/net/tcp", "/proc/net/tcp6")
        for fields in map(str.split, Path(table).read_text().splitlines()[1:])
        if fields[3] == "0A" and int(fields[1].rpartition(":")[2], 16) == port
    ]
    assert listening == [f"0100007F:{port:04X}"]
    with pytest.raises(OSError, match=r"refused"):
        socket.create_connection(("127.0.0.2", port), timeout=2).close()


def test_a_port_that_is_taken_is_said_in_one_line(address: str, recording: Path):
    port = int(address.rpartition(":")[2])
    with McapRecords(recording) as records, pytest.raises(UsageError, match=rf"port {port}: .*--port"):
        Playback(records, port)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_says_where_and_ends_when_it_is_told_to(recording: Path, number: int):
    command = [sys.executable, "-m", "spheremcap", "view", str(recording), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(3)]
        address = lines[0].strip()
        assert "app.foxglove.dev" in lines[1]
        assert address in lines[2]
        with Viewer(address) as viewer:
            advertised(viewer)
            viewer.subscribe("/markers/orange/state")
            assert told_until(viewer, lambda got: isinstance(got, Told))
            process.send_signal(number)
            assert process.wait(10) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""


def test_without_the_extra_it_says_what_to_install(recording: Path, tmp_path: Path):
    (tmp_path / "foxglove.py").write_text("raise ModuleNotFoundError('not here', name='foxglove')\n")
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path[1:]])}
    command = [sys.executable, "-m", "spheremcap", "view", str(recording)]
    done = subprocess.run(command, capture_output=True, text=True, env=env, check=False)
    assert done.returncode == 2
    assert done.stderr == "spheremcap: view needs more: pip install 'spheremcap[live]' (foxglove is missing)\n"
