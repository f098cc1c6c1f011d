"""What comes first where two stamps are the same, and what becomes of a stamp that says nothing."""

from fractions import Fraction
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader
from mcap.writer import Writer

from spheremcap.io.join import Join, McapStream
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import open_output
from spheremcap.io.video import _Clock


def recording(path: Path, times: list[int]) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="another tool")
        channel = writer.register_channel("/in", "json", writer.register_schema("thing", "jsonschema", b"{}"))
        for time in times:
            writer.add_message(channel, time, b"{}", time)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_a_copys_messages_at_a_frames_time_come_before_the_frames_own(tmp_path: Path) -> None:
    """The picture that a frame was decoded from lies before what was found in it."""
    source = recording(tmp_path / "in.mcap", [10, 20, 20, 30])
    with McapRecords(source) as records, open_output(tmp_path / "out.mcap", [source]) as writer:
        join = Join(writer, [McapStream(records)])
        ours = writer.register_channel("/ours", "json", 0, {})
        for time in (10, 20, 25, 30):
            join.until(time)
            writer.add_message(ours, time, b"{}", time)
        join.rest()
    with (tmp_path / "out.mcap").open("rb") as file:
        order = [(m.log_time, c.topic) for _, c, m in NonSeekingReader(file).iter_messages(log_time_order=False)]
    assert order == [
        (10, "/in"), (10, "/ours"), (20, "/in"), (20, "/in"), (20, "/ours"), (25, "/ours"), (30, "/in"), (30, "/ours"),
    ]  # fmt: skip


class Picture:
    def __init__(self, pts: int | None, duration: int = 40, dts: int | None = None) -> None:
        self.pts, self.duration, self.dts = pts, duration, dts


class Stream:
    time_base = Fraction(1, 1000)
    average_rate = Fraction(25)


def stamps(*pictures: Picture) -> list[tuple[int, bool]]:
    clock = _Clock(Stream(), 0, 2**63)  # type: ignore[arg-type]
    return [clock.stamp(picture) for picture in pictures]  # type: ignore[arg-type]


@pytest.mark.parametrize("again", [40, 39, 0])
def test_a_stamp_that_does_not_come_after_the_last_is_put_half_a_picture_later(again: int) -> None:
    ms = 10**6
    assert stamps(Picture(0), Picture(40), Picture(again), Picture(80)) == [
        (0, True), (40 * ms, True), (60 * ms, False), (80 * ms, True),
    ]  # fmt: skip


def test_half_of_nothing_is_a_nanosecond() -> None:
    class Instant(Stream):
        average_rate = Fraction(10**9)

    clock = _Clock(Instant(), 0, 2**63)  # type: ignore[arg-type]
    assert [clock.stamp(Picture(0, 0))[0] for _ in range(3)] == [0, 1, 2]  # type: ignore[arg-type]


def test_a_clock_that_starts_again_goes_on_a_picture_later() -> None:
    s = 10**9
    assert stamps(Picture(0), Picture(5000), Picture(0), Picture(40)) == [
        (0, True), (5 * s, True), (5 * s + s // 25, False), (5 * s + 2 * s // 25, True),
    ]  # fmt: skip


def test_a_stamp_beyond_what_int64_can_hold_is_none() -> None:
    clock = _Clock(Stream(), 0, 10**18)  # type: ignore[arg-type]
    found = [clock.stamp(picture) for picture in (Picture(0), Picture(10**18), Picture(80))]  # type: ignore[arg-type]
    assert found == [(0, True), (40 * 10**6, False), (80 * 10**6, True)]
