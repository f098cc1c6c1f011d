"""What an interrupted run left becomes a whole recording, and what is missing is said."""

import errno

import pytest
from mcap.reader import make_reader
from recording_data import CAMERA, MARKERS, result
from test_output import SECOND, START, Disk, fill, sequences

from spheremcap.errors import OutputError, SourceError, UsageError
from spheremcap.io import output, recording
from spheremcap.io.mcap_log import McapLog, RunInfo
from spheremcap.io.recover import recover


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("recover") / "whole.mcap"
    with McapLog(path, camera=CAMERA, markers=MARKERS, run=RunInfo("a.mp4", settings_toml="[a]\nb = 1\n")) as log:
        for index in range(600):
            log.write(result(index), None)
    return path


def test_a_run_that_was_cut_off_gives_all_half_seconds(tmp_path):
    part, out = tmp_path / "out.mcap.part", tmp_path / "out.mcap"
    stamps = range(START, START + 4 * SECOND, SECOND // 10)
    with output.open_output(tmp_path / "running.mcap") as writer:
        channel = writer.register_channel("/x", "x", 0)
        for k, stamp in enumerate(stamps):
            writer.add_message(channel, stamp, b"1", stamp, k)
            if k == 37:
                part.write_bytes(writer.part.read_bytes())  # what is there when the process is killed now
    done = recover(part, out)
    assert sum(done.merged.counts.values()) == 35
    assert done.merged.end_ns == stamps[34]
    assert sequences(out) == (list(range(35)), True)
    assert "no footer" in done.lost[0]
    assert "the run was cut off" in done.lost[-1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.mcap", "out.mcap.part", "running.mcap"]


def test_every_cut_gives_what_is_before_it_with_an_index(whole, tmp_path):
    size, track = whole.stat().st_size, recording.open(whole).tracks["left_wrist"]
    frames = []
    for share in (0.3, 0.6, 0.9, 1.0):
        cut, out = tmp_path / "cut.mcap", tmp_path / f"{share}.mcap"
        cut.write_bytes(whole.read_bytes()[: int(size * share)])
        done = recover(cut, out)
        assert bool(done.lost) == (share < 1)
        with out.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            assert summary.statistics.message_count == sum(done.merged.counts.values())
            assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 0
            assert "settings.toml" in {attachment.name for attachment in reader.iter_attachments()}
        found = recording.open(out)
        assert found.damage is None
        count = len(found.tracks["left_wrist"])
        assert (found.tracks["left_wrist"].stamp_ns == track.stamp_ns[:count]).all()
        frames.append(count)
    assert frames == sorted(frames)
    assert 100 < frames[0] < frames[-1] == 600


def test_a_part_that_was_ended_in_order_loses_nothing(tmp_path):
    out = tmp_path / "out.mcap"
    with pytest.raises(SourceError, match="cable"):
        fill(out, range(START, START + 3 * SECOND, SECOND // 10), then=cable)
    done = recover(tmp_path / "out.mcap.part", out)
    assert done.lost == ()
    assert sequences(out) == (list(range(30)), True)


def test_a_run_whose_disk_was_full_says_that_something_is_missing(tmp_path, monkeypatch):
    out, full = tmp_path / "out.mcap", OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(output, "open", lambda path, *_, **__: Disk(path, 3000, full), raising=False)
    with pytest.raises(OutputError):
        fill(out, range(START, START + 9 * SECOND, SECOND // 10), compression="none")
    monkeypatch.undo()
    done = recover(tmp_path / "out.mcap.part", out)
    assert len(done.lost) == 1
    assert "could not write to its end" in done.lost[0]
    assert sequences(out) == (list(range(10)), True)


def cable():
    raise SourceError("the cable is out")


def test_what_is_no_recording_or_is_being_written_is_refused(tmp_path):
    table, out = tmp_path / "t.csv.part", tmp_path / "out.mcap"
    table.write_text("marker,frame\n" * 9)
    with pytest.raises(SourceError, match="not an MCAP"):
        recover(table, out)
    with pytest.raises(SourceError, match="no such file"):
        recover(tmp_path / "none.part", out)
    with output.open_output(tmp_path / "r.mcap") as writer, pytest.raises(UsageError, match="still writing"):
        recover(writer.part, out)
    assert not out.exists()


def test_recovering_can_be_stopped(tmp_path):
    given, out = fill(tmp_path / "given.mcap", range(5000)), tmp_path / "out.mcap"
    done = recover(given, out, stop=lambda: True)
    assert (done.merged.stopped, done.merged.part) == (True, None)
    asked = iter([False, True])
    done = recover(given, out, stop=lambda: next(asked))
    assert done.merged.stopped
    assert sequences(done.merged.part) == (list(range(1024)), True)
    assert not out.exists()
