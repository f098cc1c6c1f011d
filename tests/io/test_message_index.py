"""Any message of a topic by its number."""

from bisect import bisect_left, bisect_right
from pathlib import Path

import pytest

from spheremcap.errors import SourceError
from spheremcap.io.join import OutMessage
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.rewrite import ChunkWriter


def stored(path: Path, chunks: list[list[int]], compression: str = "zstd") -> Path:
    """A recording whose chunks have messages on /a at these times, and as many on /b a moment later."""
    with path.open("wb") as file:
        writer = ChunkWriter(file, {}, {})
        writer.start("", "")
        ids = [writer.register_channel(topic, "", 0) for topic in ("/a", "/b")]
        for number, times in enumerate(chunks):
            told = [(time + k, id_, f"{number} {time}".encode()) for time in times for k, id_ in enumerate(ids)]
            writer.write([OutMessage(time, time, 0, id_, data) for time, id_, data in told], compression)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "chunks",
    [
        [[10, 20], [30, 40], [50]],
        [[10, 30], [20, 40], [35, 50], [60]],  # between each other
        [[40, 50], [10, 20], [60]],  # a later one first
        [[30, 20, 10], [40]],  # out of order inside
        [[10, 20], [20, 20], [20, 30]],
        [[20, 30], [10, 20], [20, 20]],
        [[], [10], []],
    ],
)
def test_messages_by_number_are_those_in_order(tmp_path: Path, chunks: list[list[int]]) -> None:
    path = stored(tmp_path / "a.mcap", chunks)
    for topic in ("/a", "/b"):
        with McapRecords(path) as records:
            expected = list(records.messages({topic}))
            found = records.index_of(topic)
            assert [found.message(number) for number in range(len(found))] == expected
            times = [raw.log_time for raw in expected]
            assert [found.log_time(number) for number in range(len(found))] == times
            for time in range(70):
                assert (found.before(time), found.until(time)) == (bisect_left(times, time), bisect_right(times, time))
            for number in (-1, len(times)):
                with pytest.raises(IndexError):
                    found.message(number)


def test_where_messages_are_is_known_of_a_few_chunks_at_a_time(tmp_path: Path) -> None:
    path = stored(tmp_path / "a.mcap", [[10 * k, 10 * k + 5] for k in range(300)])
    with McapRecords(path) as records:
        found = records.index_of("/a")
        assert found._located.cache_info().currsize == 0  # nothing is looked up before it is asked for
        assert [found.log_time(number) for number in range(600)] == [5 * number for number in range(600)]
        assert found._located.cache_info().currsize <= 8


def test_a_message_that_only_the_index_has_is_said_to_be_damaged(tmp_path: Path) -> None:
    path = stored(tmp_path / "a.mcap", [[10, 20, 30, 40]], "")
    data = bytearray(path.read_bytes())
    at = data.index(b"0 10") - 22  # where the first message's record says its channel
    assert data[at] in (1, 2)
    data[at] = 3 - data[at]
    path.write_bytes(data)
    with McapRecords(path) as records:
        found = records.index_of("/a")
        assert len(found) == 4
        assert [found.message(number).log_time for number in range(3)] == [20, 30, 40]
        for wanted in (found.message, found.log_time):
            with pytest.raises(SourceError, match="more messages than can be read"):
                wanted(3)
        with pytest.raises(IndexError):
            found.message(4)
