"""An output is a file of its own: never an input, never another run's, there whole or not at all."""

import errno
import fcntl
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from spheremcap.errors import OutputError, SourceError, UsageError
from spheremcap.interrupt import Interrupted
from spheremcap.io import output
from spheremcap.io.output import checked_output, open_output, refuse_inputs, whole_file

SECOND = 10**9
START = 1_700_000_000 * SECOND


def fill(path: Path, stamps: Iterator[int] | range, *, then: Callable[[], None] = lambda: None, **options) -> Path:
    with open_output(path, **options) as writer:
        channel = writer.register_channel("/x", "x", writer.register_schema("s", "x", b"x"))
        for k, stamp in enumerate(stamps):
            writer.add_message(channel, stamp, noise(k), stamp, k)
        then()
    return path


def noise(k: int) -> bytes:
    return bytes((k * 7 + j * j * 3) % 251 for j in range(200))


def sequences(path: Path) -> tuple[list[int], bool]:
    """The messages that the mcap package's stream reader gives, by sequence, and whether it came to the end."""
    found: list[int] = []
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records:
                inside = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
                found += [one.sequence for one in inside if isinstance(one, Message)]
        except Exception:
            return found, False
    return found, True


def text(path: Path, content: str = "new", *, then: Callable[[], None] = lambda: None, **options) -> output.Part:
    with whole_file(path, **options) as part:
        part.path.write_text(content)
        then()
    return part


def raiser(error: BaseException) -> Callable[[], None]:
    def fail() -> None:
        raise error

    return fail


# --- never an input ---


def test_an_output_is_told_from_inputs_by_what_they_are_not_by_names(tmp_path, monkeypatch):
    given, link, hard = (tmp_path / name for name in ("in.csv", "link.csv", "hard.csv"))
    given.write_text("precious")
    link.symlink_to(given)
    hard.hardlink_to(given)
    monkeypatch.chdir(tmp_path)
    for named in (given, link, hard, Path("in.csv"), tmp_path / "x" / ".." / "in.csv"):
        if ".." in named.parts:
            (tmp_path / "x").mkdir()
        for known in (given, link, hard):
            with pytest.raises(UsageError, match="is an input"):
                text(named, inputs=[known], overwrite=True)
    assert given.read_text() == hard.read_text() == "precious"
    assert link.is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hard.csv", "in.csv", "link.csv", "x"]


def test_nothing_is_written_into_an_input_folder(tmp_path):
    folder, other = tmp_path / "imu", tmp_path / "other"
    (folder / "deep").mkdir(parents=True)
    other.symlink_to(folder)
    for place in (folder / "new.mcap", folder / "deep" / "new.mcap", other / "new.mcap"):
        with pytest.raises(UsageError, match="lies in the input folder"):
            checked_output(place, [folder])
    with pytest.raises(UsageError, match="lies in the input folder"):
        checked_output(folder / "new.mcap", [other])
    kept = tmp_path / "kept.csv"
    kept.write_text("precious")
    (folder / "deep" / "linked.csv").symlink_to(kept)
    with pytest.raises(UsageError, match=r"is an input, .*linked\.csv"):
        text(kept, inputs=[folder], overwrite=True)
    (folder / "deep" / "linked.csv").unlink()
    into = tmp_path / "into.mcap"
    into.symlink_to(folder / "new.mcap")
    with pytest.raises(UsageError, match="lies in the input folder"):
        checked_output(into, [folder])
    assert checked_output(tmp_path / "imu.mcap", [folder]) == tmp_path / "imu.mcap"
    refuse_inputs(tmp_path, [folder])
    for place in (folder, folder / "new", folder / "new" / "newer"):
        with pytest.raises(UsageError, match="input"):
            refuse_inputs(place, [folder])
    assert not list((folder / "deep").iterdir())


# --- what the name stands for ---


def test_a_link_stays_and_what_it_points_to_is_written(tmp_path):
    real, link = tmp_path / "store" / "real.csv", tmp_path / "link.csv"
    real.parent.mkdir()
    link.symlink_to(Path("store") / "real.csv")
    part = text(link, "first")  # the file it points to is not there yet
    assert part.path.parent == real.parent
    with pytest.raises(UsageError, match="exists"):
        text(link)
    text(link, "second", overwrite=True)
    assert link.is_symlink()
    assert real.read_text() == "second"
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    with pytest.raises(OutputError, match="loop"):
        text(loop)


def test_devices_pipes_sockets_and_folders_are_refused(tmp_path):
    pipe, place = tmp_path / "pipe", tmp_path / "socket"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(place))
        linked = tmp_path / "null.mcap"
        linked.symlink_to("/dev/null")
        for path in (pipe, place, Path("/dev/null"), linked):
            with pytest.raises(UsageError, match="is a device, pipe or socket"):
                fill(path, range(1), overwrite=True)
        with pytest.raises(UsageError, match="is a folder"):
            fill(tmp_path, range(1), overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["null.mcap", "pipe", "socket"]


@contextmanager
def nobody() -> Iterator[None]:
    """As a user who may not do everything."""
    if os.geteuid():
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_places_that_cannot_be_written_are_one_line(tmp_path):
    file, closed = tmp_path / "file", tmp_path / "closed"
    file.write_text("x")
    closed.mkdir(mode=0o555)
    for path, word in (
        (tmp_path / ("n" * 300 + ".mcap"), "too long"),
        (tmp_path / ("n" * 246 + ".mcap"), "too long"),  # with .part it is
        (tmp_path / "none" / "out.mcap", "no folder"),
        (file / "out.mcap", "a file where a folder has to be"),
        (Path("/sys/out.mcap"), "may write to"),
    ):
        for attempt in (lambda: fill(path, range(1)), lambda: text(path)):  # noqa: B023
            with pytest.raises(OutputError, match=word) as raised:
                attempt()
            assert "\n" not in str(raised.value)
    for above in closed.parents:
        if above.stat().st_uid == os.geteuid() and str(above).startswith("/tmp/"):
            above.chmod(0o755)
    with nobody(), pytest.raises(OutputError, match="Permission denied: name a folder"):
        text(closed / "out.csv")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["closed", "file"]


# --- the part file ---


def test_a_part_that_was_left_is_named_and_never_touched(tmp_path):
    out = tmp_path / "out.mcap"
    left = Path(f"{out}.part")
    left.write_bytes(b"\x89MCAP0\r\nprecious")
    (tmp_path / "out.mcap.2.part").write_bytes(b"a table")
    (tmp_path / "out.mcap.old.part").write_bytes(b"somebody else's")
    with open_output(out) as writer:
        assert writer.part == tmp_path / "out.mcap.3.part"
        assert "out.mcap.2.part is what an interrupted run left: delete it" in writer.notes[0]
        assert f"`spheremcap recover {left} -o OTHER.mcap`" in writer.notes[1]
        assert len(writer.notes) == 2
    assert left.read_bytes() == b"\x89MCAP0\r\nprecious"
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "out.mcap", "out.mcap.2.part", "out.mcap.old.part", "out.mcap.part",
    ]  # fmt: skip


def test_a_part_can_be_the_input_of_the_run_that_has_its_name(tmp_path):
    out = tmp_path / "out.mcap"
    left = Path(f"{out}.part")
    left.write_bytes(b"\x89MCAP0\r\nprecious")
    part = text(out, "new", inputs=[left])
    assert (out.read_text(), left.read_bytes(), part.notes) == ("new", b"\x89MCAP0\r\nprecious", ())


def test_a_second_run_is_refused_and_the_first_is_not_disturbed(tmp_path):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"old")
    Path(f"{out}.part").write_bytes(b"left")  # so that the running one is not the first name that is looked at
    with open_output(out, overwrite=True) as writer:
        channel = writer.register_channel("/x", "x", 0)
        writer.add_message(channel, 1, b"1", 1, 7)
        for attempt in (lambda: fill(out, range(1), overwrite=True), lambda: text(out, overwrite=True)):
            with pytest.raises(UsageError, match=r"another run is writing it, into .*out\.mcap\.2\.part"):
                attempt()
        code = f"from spheremcap.io.output import *\nwith open_output({str(out)!r}, overwrite=True): pass"
        other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert "another run is writing it" in other.stderr
        assert out.read_bytes() == b"old"
        Path(f"{out}.part").unlink()  # a gap among the names hides nothing
        with pytest.raises(UsageError, match="another run is writing it"):
            text(out, overwrite=True)
    assert sequences(out) == ([7], True)
    assert list(tmp_path.iterdir()) == [out]


RACE = """
import sys
from spheremcap.errors import UsageError
from spheremcap.io.output import whole_file
print("ready", flush=True)
sys.stdin.readline()
try:
    with whole_file(sys.argv[1], overwrite=True) as part:
        part.path.write_text(sys.argv[2])
        print("writing", flush=True)
        sys.stdin.readline()
except UsageError:
    sys.exit(2)
"""


@pytest.mark.parametrize("left", [False, True])
def test_of_runs_that_start_together_one_writes(tmp_path, left):
    out = tmp_path / "out.csv"
    if left:
        Path(f"{out}.part").write_text("left")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    runs = [subprocess.Popen([sys.executable, "-c", RACE, str(out), str(k)], **pipes) for k in range(6)]
    for run in runs:
        assert run.stdout.readline() == "ready\n"
    for run in runs:
        run.stdin.write("go\n")
        run.stdin.flush()
    said = [run.stdout.readline() for run in runs]  # nothing: it has ended
    assert sorted(said) == ["", "", "", "", "", "writing\n"]
    for run in runs:
        run.communicate("end\n", timeout=60)
    codes = [run.returncode for run in runs]
    assert sorted(codes) == [0, 2, 2, 2, 2, 2]
    assert out.read_text() == str(codes.index(0))
    assert len(list(tmp_path.iterdir())) == 1 + left


def test_a_run_that_was_quicker_keeps_its_name(tmp_path, monkeypatch):
    """Between the look whether a name is free and taking it."""
    out, theirs, rename, others = tmp_path / "out.csv", tmp_path / "out.csv.part", output._rename_to_new, []

    def late(old, new):
        others.append(theirs.open("wb", buffering=0))
        fcntl.flock(others[0], fcntl.LOCK_EX | fcntl.LOCK_NB)
        others[0].write(b"theirs")
        rename(old, new)

    monkeypatch.setattr(output, "_rename_to_new", late)
    with pytest.raises(UsageError, match="another run is writing it"):
        text(out)
    others[0].close()
    assert theirs.read_bytes() == b"theirs"
    assert list(tmp_path.iterdir()) == [theirs]


def test_the_lock_holds_until_the_file_has_its_name(tmp_path, monkeypatch):
    """Or a run that starts in between would take the part for one that was left."""
    out, seen = tmp_path / "out.csv", []
    publish = output._publish

    def watched(part, overwrite):
        seen.append(output.in_use(part.path))
        publish(part, overwrite)
        seen.append(output.in_use(out))

    monkeypatch.setattr(output, "_publish", watched)
    text(out)
    assert seen == [True, True]
    assert not output.in_use(out)


@pytest.mark.parametrize("second_names", [True, False])
def test_what_appears_meanwhile_is_not_replaced(tmp_path, monkeypatch, second_names):
    out = tmp_path / "out.mcap"

    def refused(*_):
        raise OSError(errno.EPERM, "no hard links here")

    if not second_names:
        monkeypatch.setattr(os, "link", refused)
        fill(tmp_path / "other.mcap", range(START, START + 3))
        assert sequences(tmp_path / "other.mcap") == ([0, 1, 2], True)
    with pytest.raises(OutputError, match="appeared while"):
        fill(out, range(2), then=lambda: out.write_bytes(b"precious"))
    assert out.read_bytes() == b"precious"
    assert sequences(Path(f"{out}.part")) == ([0, 1], True)


def test_a_file_is_there_whole_or_not_at_all(tmp_path):
    out = tmp_path / "out.csv"
    out.write_text("old")
    full = OSError(errno.ENOSPC, "full")
    for error, raised in ((ValueError(), ValueError), (full, OutputError), (Interrupted(), Interrupted)):
        with pytest.raises(raised):
            text(out, "half", then=raiser(error), overwrite=True)
        assert list(tmp_path.iterdir()) == [out]
        assert out.read_text() == "old"


# --- recordings ---


def test_a_recording_is_on_disk_by_half_seconds(tmp_path):
    out, done = tmp_path / "out.mcap", []
    with open_output(out) as writer:
        channel = writer.register_channel("/x", "x", 0)
        for k, stamp in enumerate(range(START, START + 5 * SECOND, SECOND // 8)):
            writer.add_message(channel, stamp, b"small", stamp, k)
            done.append(k)
            on_disk, _ = sequences(writer.part)
            assert on_disk == done[: k // 4 * 4]
    assert sequences(out) == (done, True)
    with out.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert [index.message_start_time for index in summary.chunk_indexes] == [
            START + k * SECOND // 2 for k in range(10)
        ]


def test_a_gap_or_a_step_back_in_the_log_times_costs_no_chunk_a_message(tmp_path):
    fill(tmp_path / "out.mcap", iter([9 * SECOND, SECOND, 9 * SECOND + 1, 2 * SECOND, 10**18, 5, 10**18 + 1]))
    with (tmp_path / "out.mcap").open("rb") as file:
        assert make_reader(file).get_summary().statistics.chunk_count == 2
    assert sequences(tmp_path / "out.mcap") == (list(range(7)), True)


@pytest.mark.parametrize(
    ("error", "count", "stays"),
    [
        (SourceError("the cable is out"), 3, True),
        (Interrupted("interrupted"), 3, True),
        (KeyboardInterrupt(), 3, True),
        (SourceError("the cable is out"), 0, False),
        (Interrupted("interrupted"), 0, False),
        (UsageError("a seed of nobody"), 3, False),
    ],
)
def test_what_an_error_leaves(tmp_path, error, count, stays):
    out = tmp_path / "out.mcap"
    with pytest.raises(type(error)) as raised:
        fill(out, range(count), then=raiser(error))
    part = Path(f"{out}.part")
    assert list(tmp_path.iterdir()) == ([part] if stays else [])
    if stays:
        assert sequences(part) == ([0, 1, 2], True)
        with part.open("rb") as file:
            assert make_reader(file).get_summary().statistics.message_count == 3
    assert str(part) in str(raised.value) or not stays or isinstance(error, KeyboardInterrupt)


class Disk:
    """A file on a disk with so much room: it takes what fits of a write, then nothing."""

    def __init__(self, path: Path, room: int, error: BaseException) -> None:
        self._file = open(path, "wb", buffering=0)  # noqa: SIM115
        self._room, self._error = room, error

    def write(self, data: memoryview) -> int:
        fits = self._room - self._file.tell()
        if fits <= 0 and len(data):
            raise self._error
        return self._file.write(data[:fits])

    def __getattr__(self, name: str):
        return getattr(self._file, name)


@pytest.mark.parametrize("compression", ["zstd", "none"])
@pytest.mark.parametrize("error", [partial(OSError, errno.ENOSPC, "full"), partial(Interrupted, "interrupted")])
def test_a_disk_that_is_full_at_any_place_keeps_what_it_has_once_and_the_old_file(
    tmp_path, monkeypatch, compression, error
):
    stamps = range(START, START + 4 * SECOND, SECOND // 10)
    whole = fill(tmp_path / "whole.mcap", stamps, compression=compression)
    size, out = whole.stat().st_size, tmp_path / "out.mcap"
    out.write_bytes(b"old")
    part = Path(f"{out}.part")
    kept = []
    for room in (*range(0, size, size // 60), *range(size - 40, size)):
        monkeypatch.setattr(output, "open", lambda path, *_, **__: Disk(path, room, error()), raising=False)  # noqa: B023
        with pytest.raises((OutputError, Interrupted)):
            fill(out, stamps, overwrite=True, compression=compression)
        monkeypatch.undo()
        assert out.read_bytes() == b"old"
        if not part.exists():
            kept.append(0)
            continue
        found, ended = sequences(part)
        assert found == list(range(len(found)))
        assert not ended or part.read_bytes().endswith(b"\x89MCAP0\r\n")  # and nothing of what did not fit
        assert len(found) % 5 == 0
        kept.append(len(found))
        part.unlink()
    assert kept == sorted(kept)
    assert set(kept) == set(range(0, 41, 5))


def test_an_error_that_passes_does_not_write_a_chunk_twice(tmp_path, monkeypatch):
    """When the index of a chunk does not fit and then there is room again, for somebody tidied up."""

    class FailsOnce(Disk):
        def write(self, data: memoryview) -> int:
            if self._room and data[:1] == bytes([Opcode.MESSAGE_INDEX]):
                self._room = 0
                raise self._error
            return self._file.write(data)

    out, full = tmp_path / "out.mcap", OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(output, "open", lambda path, *_, **__: FailsOnce(path, 1, full), raising=False)
    refused = 0
    with pytest.raises(OutputError, match="free some space"), open_output(out) as writer:  # noqa: PT012
        first = None
        channel = writer.register_channel("/x", "x", 0)
        for k in range(40):  # as a thread that writes goes on until it is told
            try:
                writer.add_message(channel, START + k * SECOND // 10, noise(k), 0, k)
            except OutputError as error:
                first = first or error
                refused += 1
        raise first
    assert sequences(Path(f"{out}.part")) == (list(range(5)), True)
    assert refused == 35


@pytest.mark.parametrize("at", range(4))
def test_a_signal_while_the_file_is_finished_leaves_it_readable(tmp_path, monkeypatch, at):
    """After each of the writes that end it: data end, summary, footer, magic."""
    out, after = tmp_path / "out.mcap", []
    write = output._RecordFile.write

    def interrupted(self, data):
        count = write(self, data)
        if after or data[:1] == bytes([Opcode.DATA_END]):
            after.append(True)
            if len(after) == at + 1:
                raise Interrupted("interrupted")
        return count

    monkeypatch.setattr(output._RecordFile, "write", interrupted)
    with pytest.raises(Interrupted):
        fill(out, range(5))
    part = Path(f"{out}.part")
    assert sequences(part) == (list(range(5)), True)
    with part.open("rb") as file:
        assert [c.topic for _, c, _ in make_reader(file).iter_messages()] == ["/x"] * 5


def test_the_same_messages_give_the_same_bytes(tmp_path):
    stamps = range(START, START + 3 * SECOND, SECOND // 7)
    one, two = (fill(tmp_path / name, stamps).read_bytes() for name in ("one.mcap", "two.mcap"))
    assert one == two
