"""Pictures as time goes on: the newest is taken, what is passed over counted, and a password stays inside."""

import io
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from spheremcap.core.frame import BgrFrame, Frame
from spheremcap.errors import SourceError, UsageError
from spheremcap.live.sources import DeviceSource, PacedVideo, newest, open_live


def never() -> bool:
    return False


def still(index: int) -> Frame:
    return BgrFrame(index, index * 10**7, np.zeros((4, 4, 3), np.uint8))


def test_a_slow_taker_gets_the_newest_and_the_seeded():
    skipped: list[None] = []
    gone_on = threading.Event()

    def frames() -> Iterator[Frame]:
        yield still(0)
        gone_on.wait(5)
        for index in range(1, 10):
            yield still(index)

    def skip() -> None:
        skipped.append(None)

    taken = newest(frames(), never, {3}, skip)
    assert next(taken).index == 0
    gone_on.set()
    time.sleep(0.3)  # all have come while nobody took one
    assert [frame.index for frame in taken] == [3, 9]
    assert len(skipped) == 7


def test_what_goes_wrong_while_it_is_read_comes_out():
    def frames() -> Iterator[Frame]:
        yield still(0)
        raise SourceError("the cable is out")

    with pytest.raises(SourceError, match="cable"):
        list(newest(frames(), never, (), lambda: None))


def test_closing_waits_for_the_thread():
    source = newest((still(index) for index in range(10**9)), never, (), lambda: None)
    next(source)
    source.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "camera"]


def test_a_file_takes_as_long_as_it_lasts(clip: Path):
    source = PacedVideo(clip, never, ())
    began = time.monotonic()
    frames = [frame.index for frame in source.frames()]
    took_s = time.monotonic() - began
    source.close()
    assert took_s >= 119 / 240
    assert len(frames) + source.lost.skipped == 120
    assert frames == sorted(set(frames))


def test_it_ends_when_it_is_told_to(clip: Path):
    stopped = threading.Event()
    source = PacedVideo(clip, stopped.is_set, ())
    frames = source.frames()
    next(frames)
    stopped.set()
    assert list(frames) == []
    source.close()


@pytest.mark.parametrize("untimed", [0, 1])
def test_a_stream_has_this_clocks_time_and_its_own_steps(clip: Path, untimed: int):
    """Over TCP: what FFmpeg opens by an address goes the same way, whatever its protocol. The first picture of an RTSP
    stream has no time of its own, as FFmpeg has it."""
    import av

    held = io.BytesIO()
    with av.open(str(clip)) as read, av.open(held, "w", format="mpegts") as written:
        stream = written.add_stream_from_template(read.streams.video[0])
        for packet in read.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                written.mux(packet)
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = server.accept()
        with connection:
            connection.sendall(held.getvalue())

    thread = threading.Thread(target=serve)
    thread.start()
    before_ns = time.time_ns()
    source = DeviceSource("stream", f"tcp://127.0.0.1:{server.getsockname()[1]}", None, never, range(200))
    if untimed:
        source._first.pts = None
    frames = list(source.frames())
    source.close()
    thread.join()
    server.close()
    assert [frame.index for frame in frames] == list(range(120))
    assert before_ns <= frames[0].stamp_ns <= time.time_ns()
    steps = np.diff([frame.stamp_ns for frame in frames])
    assert abs(steps[untimed:] - 1e9 / 240).max() < 12_000  # ticks of 90 kHz
    assert (frames[0].width_px, frames[0].height_px) == (source.width_px, source.height_px)
    assert source.lost.skipped == 0


def test_a_password_is_not_said():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(SourceError, match=r"^rtsp 127\.0\.0\.1: cannot be opened: ") as refused:
        open_live(f"rtsp://me:secret@127.0.0.1:{port}/here", never, ())
    assert "secret" not in str(refused.value)


def test_a_camera_that_is_not_there_is_one_line():
    with pytest.raises(SourceError, match=r"^camera 97: cannot be opened: No such file"):
        open_live("camera:97", never, ())


@pytest.mark.parametrize("name", ["camera:", "camera:front", "camera:-1"])
def test_a_camera_has_a_number(name: str):
    with pytest.raises(UsageError, match="camera:0"):
        open_live(name, never, ())
