"""How an output file is owned, whatever is in it: OUT.part, which this run alone has locked, becomes OUT when whole.

No output is an input or lies in an input folder; by what the file system says, not by names. `-o` on a symbolic link
writes what it points to. OUT.part is always a new file: what an earlier run left is never written over, the new run
takes OUT.2.part and says so, so that neither the old work is lost nor the new work held up. A second run with the
same output is refused as long as the first holds its lock.
"""

import errno
import os
import re
import stat
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from secrets import token_hex
from typing import IO, BinaryIO, Literal, Protocol, TypeVar

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from spheremcap.core.time import NS_PER_S
from spheremcap.errors import OutputError, SourceError, SpheremcapError, UsageError
from spheremcap.interrupt import Interrupted
from spheremcap.io.chapter_list import chapters_in, is_list

try:
    import fcntl
except ImportError:  # not on Windows: there two runs are not told apart, and still never share a part file
    fcntl = None  # type: ignore[assignment]

VERSION = version("spheremcap")
LIBRARY = f"spheremcap/{VERSION} mcap-python/{version('mcap')}"
CHUNK_BYTES = 1024 * 1024

Compression = Literal["zstd", "lz4", "none"]
COMPRESSION = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


# --- where may be written ---


def checked_output(path: str | os.PathLike[str], inputs: Sequence[Path] = (), *, overwrite: bool = False) -> Path:
    """The file that `path` means, links followed.

    Raises UsageError when it is an input, lies in an input folder, is no regular file, or exists and `overwrite` is
    False; OutputError when there is no such folder.
    """
    path = Path(path)
    try:
        target = Path(os.path.realpath(path))
        found = _stat(path)
        os.stat(target.parent)
    except OSError as error:
        raise output_error(error, path) from error
    if found is not None and stat.S_ISDIR(found.st_mode):
        raise UsageError(f"{path} is a folder: name a file to write")
    if found is not None and not stat.S_ISREG(found.st_mode):
        raise UsageError(f"{path} is a device, pipe or socket: name a file to write")
    refuse_inputs(path, inputs)
    if found is not None and not overwrite:
        raise UsageError(f"{path} exists already: name another file or pass --overwrite")
    return target


def _listed(given: Path) -> list[Path]:
    """The chapters that an input names; one that cannot be read is told when it is opened."""
    try:
        return chapters_in(given) if is_list(given) else []
    except SourceError:
        return []


def refuse_inputs(path: Path, inputs: Sequence[Path]) -> None:
    """Raises UsageError when the file or folder `path` is one of the inputs or lies in one of them."""
    target = Path(os.path.realpath(path))
    places = [there for place in (target, *target.parents) if (there := _stat_or_none(place)) is not None]
    found = _stat_or_none(target)
    for given in [file for one in inputs for file in (one, *_listed(one))]:
        known = _stat_or_none(given)
        if known is None:
            continue
        if found is not None and os.path.samestat(found, known):
            raise UsageError(f"{path} is an input: name another output")
        if not stat.S_ISDIR(known.st_mode):
            continue
        if any(os.path.samestat(place, known) for place in places):
            raise UsageError(f"{path} lies in the input folder {given}: name an output outside of it")
        if found is None:
            continue
        for file in given.rglob("*"):  # a link in there may lead here
            if (inside := _stat_or_none(file)) is not None and os.path.samestat(found, inside):
                raise UsageError(f"{path} is an input, {file}: name another output")


def make_folder(path: Path) -> None:
    """A folder to write into, made when missing, and those above it. Raises OutputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(error, path) from error


def output_error(error: OSError, path: Path) -> OutputError:
    """The one-line error for a file that cannot be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return OutputError(f"{path}: {os.strerror(error.errno)}: free some space and run again")
    if error.errno == errno.ENAMETOOLONG:
        return OutputError(f"{path}: the name is too long, with the .part that it has until it is whole: shorten it")
    if isinstance(error, FileNotFoundError):
        return OutputError(f"{path}: there is no folder {path.parent}: create it first")
    if isinstance(error, NotADirectoryError | FileExistsError):
        return OutputError(f"{path}: there is a file where a folder has to be: name another output")
    if isinstance(error, PermissionError) or error.errno == errno.EROFS:
        return OutputError(f"{path}: cannot be written: {error.strerror}: name a folder that you may write to")
    return OutputError(f"{path}: cannot be written: {error.strerror or error}")


def write_durably(path: Path, text: str) -> None:
    """The text as the whole file, on disk when this returns: written beside it, synced, renamed, the folder synced.

    Raises OutputError; the file is then as it was.
    """
    beside = path.with_name(f".{path.name}.{token_hex(4)}.part")
    try:
        with beside.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            with suppress(OSError):  # a file system that does not sync folders
                os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise output_error(error, path) from error


# --- the part file ---


@dataclass
class Part:
    """A file under its name until it is whole. `path` is where to write; `notes` says what earlier runs left.

    On the way out it becomes `target`, unless something was raised or `complete` was set to False: then it stays under
    `path` when `keep` is set, and is removed otherwise.
    """

    path: Path
    target: Path
    notes: tuple[str, ...]
    complete: bool = True
    keep: bool = False


@contextmanager
def whole_file(path: str | os.PathLike[str], inputs: Sequence[Path] = (), *, overwrite: bool = False) -> Iterator[Part]:
    """For a table, a text, a video: write `part.path`, and the file is there whole on the way out, or not at all.

    Raises what `checked_output` raises; an OSError in between is taken for the output's.
    """
    with _part_file(path, inputs, overwrite) as part:
        try:
            yield part
        except OSError as error:
            raise output_error(error, Path(path)) from error


@contextmanager
def _part_file(path: str | os.PathLike[str], inputs: Sequence[Path], overwrite: bool) -> Iterator[Part]:
    target = checked_output(path, inputs, overwrite=overwrite)
    try:
        left = _left_behind(target)
        lock, place = _claim(target)
    except OSError as error:
        raise output_error(error, Path(path)) from error
    part = Part(place, target, _notes(left, inputs))
    try:
        yield part
    except BaseException:
        part.complete = False
        raise
    else:
        if part.complete:
            part.keep = True
            _publish(part, overwrite)
    finally:
        if not part.keep:
            with suppress(OSError):
                part.path.unlink(missing_ok=True)
        os.close(lock)  # only now: whoever finds the part unlocked takes it for one that was left


def _claim(target: Path) -> tuple[int, Path]:
    """A new part file, seen by nobody before it is locked: its descriptor, which holds the lock, and its name."""
    hidden = target.with_name(f".{token_hex(8)}.part")
    lock = os.open(hidden, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        if fcntl is not None:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX)
        number = 1
        while True:
            place = target.with_name(f"{target.name}.part" if number == 1 else f"{target.name}.{number}.part")
            if os.path.lexists(place):
                _refuse_in_use(place, target)
                number += 1
                continue
            with suppress(FileExistsError):  # else another run was quicker
                _rename_to_new(hidden, place)
                return lock, place
    except BaseException:
        os.close(lock)
        hidden.unlink(missing_ok=True)
        raise


def _left_behind(target: Path) -> list[Path]:
    """The part files of earlier runs that have ended. Raises UsageError when one is being written."""
    named = re.compile(re.escape(target.name) + r"(\.\d+)?\.part")
    parts = sorted(target.with_name(entry.name) for entry in os.scandir(target.parent) if named.fullmatch(entry.name))
    for part in parts:
        _refuse_in_use(part, target)
    return parts


def _refuse_in_use(part: Path, target: Path) -> None:
    if in_use(part):
        raise UsageError(f"{target}: another run is writing it, into {part}: wait for that, or name another output")


def _notes(left: Sequence[Path], inputs: Sequence[Path]) -> tuple[str, ...]:
    notes = []
    known = [found for given in inputs if (found := _stat_or_none(given)) is not None]
    for part in left:
        found = _stat_or_none(part)
        if found is None or not stat.S_ISREG(found.st_mode) or any(os.path.samestat(found, one) for one in known):
            continue
        rescue = f"rescue it with `spheremcap recover {part} -o OTHER.mcap`, or delete it"
        notes.append(f"{part} is what an interrupted run left: " + (rescue if _is_mcap(part) else "delete it"))
    return tuple(notes)


def _publish(part: Part, overwrite: bool) -> None:
    """The part under its final name. Raises OutputError; the part then stays."""
    try:
        if overwrite:
            part.path.replace(part.target)
        else:
            _rename_to_new(part.path, part.target)
    except FileExistsError:
        raise OutputError(f"{part.target} appeared while {part.path} was written: rename one of them") from None
    except OSError as error:
        raise output_error(error, part.target) from error


def _rename_to_new(old: Path, new: Path) -> None:
    """Rename, but never over something else: then FileExistsError is raised."""
    try:
        os.link(old, new)
    except OSError:
        if os.path.lexists(new):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(new)) from None
        os.rename(old, new)  # a file system where a file has one name
    else:
        os.unlink(old)


def in_use(path: Path) -> bool:
    """Whether a run holds the lock of this part file."""
    if fcntl is None:
        return False
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(file)
    return False


def _is_mcap(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
    except OSError:
        return False


def _stat(path: Path) -> os.stat_result | None:
    """What is there, links followed; None when nothing is."""
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None


def _stat_or_none(path: Path) -> os.stat_result | None:
    try:
        return os.stat(path)
    except OSError:
        return None


# --- recordings ---


class SharedWriter(Writer):
    """An mcap Writer for several sources: the same schema, channel or metadata record is stored once.

    It can be handed to McapLog, whose messages then share schemas with those that are copied. A chunk ends, and goes to
    the file, at each half second of log time at the latest, so a process that is killed loses no more than that. Set
    `complete` to False, and the file stays OUT.part, finished and readable.
    """

    def __init__(self, output: IO[bytes], compression: CompressionType = CompressionType.ZSTD) -> None:
        super().__init__(output, CHUNK_BYTES, compression)
        self.complete = True
        self.part: Path | None = None
        self.notes: tuple[str, ...] = ()
        self.topics: dict[int, str] = {}
        self.counts: Counter[str] = Counter()
        self.renamed: dict[str, str] = {}
        self.end_ns: int | None = None
        self._flushed_halves = -1
        self._schema_ids: dict[tuple[str, str, bytes], int] = {}
        self._channel_ids: dict[tuple[str, str, int, frozenset[tuple[str, str]]], int] = {}
        self._metadata: dict[str, list[dict[str, str]]] = {}

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """The id of this schema, stored when it is new."""
        key = (name, encoding, data)
        if key not in self._schema_ids:
            self._schema_ids[key] = super().register_schema(name, encoding, data)
        return self._schema_ids[key]

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] | None = None
    ) -> int:
        """The id of this channel, stored when it is new."""
        key = (topic, message_encoding, schema_id, frozenset((metadata or {}).items()))
        if key not in self._channel_ids:
            new = super().register_channel(topic, message_encoding, schema_id, metadata or {})
            self._channel_ids[key] = new
            self.topics[new] = topic
        return self._channel_ids[key]

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """As in Writer; `counts` goes by topic, `end_ns` is the last message's log time."""
        halves = log_time // (NS_PER_S // 2)
        if halves > self._flushed_halves:
            self.flush()  # type: ignore[no-untyped-call]
            self._flushed_halves = halves
        super().add_message(channel_id, log_time, data, publish_time, sequence)
        self.counts[self.topics[channel_id]] += 1
        self.end_ns = log_time

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Store a record; one that is there already is left out, one whose name is taken gets a number."""
        same_name = self._metadata.setdefault(name, [])
        if data in same_name:
            return
        same_name.append(data)
        if len(same_name) == 1:
            super().add_metadata(name, data)
            return
        number = len(same_name)
        while f"{name}#{number}" in self._metadata:
            number += 1
        self._metadata[f"{name}#{number}"] = [data]
        self.renamed[f"{name}#{number}"] = name
        super().add_metadata(f"{name}#{number}", data)


@contextmanager
def open_output(
    path: str | os.PathLike[str],
    inputs: Sequence[Path] = (),
    *,
    overwrite: bool = False,
    compression: Compression = "zstd",
    profile: str = "",
) -> Iterator[SharedWriter]:
    """A started SharedWriter on OUT.part, finished on every way out, and renamed to OUT when nothing went wrong.

    OUT.part does not stay when it has no message, nor after a UsageError; where it does, an error says so. `profile`
    is MCAP's: "ros2" says that every channel is ROS 2's. Raises what `checked_output` raises, and OutputError when the
    file cannot be written.
    """
    how = COMPRESSION[compression]
    with records_output(path, lambda file: SharedWriter(file, how), inputs, overwrite, profile) as writer:
        yield writer


class RecordWriter(Protocol):
    """What writes the records of an MCAP to a file that somebody else opens and publishes."""

    complete: bool
    part: Path | None
    notes: tuple[str, ...]

    def start(self, profile: str, library: str) -> None: ...

    def finish(self) -> None: ...


Made = TypeVar("Made", bound=RecordWriter)


@contextmanager
def records_output(
    path: str | os.PathLike[str],
    make: Callable[[IO[bytes]], Made],
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    profile: str = "",
) -> Iterator[Made]:
    """`open_output` for a writer of any kind, whose every write is a run of whole records."""
    with _part_file(path, inputs, overwrite) as part:
        file = _RecordFile(part)
        writer = make(file)  # type: ignore[arg-type]
        writer.part, writer.notes = part.path, part.notes
        try:
            writer.start(profile, LIBRARY)
            yield writer
            writer.finish()
            part.complete, part.keep = writer.complete, file.has_messages
        except BaseException as error:
            if not isinstance(error, UsageError):
                part.keep = file.has_messages
                _end(writer, file)
                part.keep = file.has_messages
            if part.keep and isinstance(error, SpheremcapError | Interrupted):
                error.args = (f"{error}; what was written until then is in {part.path}",)
            raise
        finally:
            file.close()


def _end(writer: RecordWriter, file: "_RecordFile") -> None:
    """Make the file readable after something went wrong; without an index when it did not take a write."""
    with suppress(OutputError):
        if file.takes_more and not file.data_ended:
            writer.finish()
    with suppress(OutputError):
        file.seal()


class _RecordFile:
    """The file that mcap's Writer writes to. Every write is a run of whole records, all of it or none of it.

    After one that failed it takes no more: the Writer would write the rest of a chunk, or the chunk once more.
    """

    def __init__(self, part: Part) -> None:
        self._target = part.target
        try:
            self._file: BinaryIO = open(part.path, "wb", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise output_error(error, part.target) from error
        self._last = b""
        self.data_ended = self.has_messages = False
        self.takes_more = True

    def write(self, data: bytes) -> int:
        if not self.takes_more:
            raise OutputError(f"{self._target}: cannot be written any more")
        start = self._file.tell()
        try:
            left = memoryview(data)
            while left:
                left = left[self._file.write(left) :]
        except BaseException as error:
            self.takes_more = False
            self._file.seek(start)
            self._file.truncate()
            if isinstance(error, OSError):
                raise output_error(error, self._target) from error
            raise
        self._last = data[:1] or self._last
        self.has_messages = self.has_messages or self._last == bytes([Opcode.CHUNK])
        self.data_ended = self.data_ended or self._last == bytes([Opcode.DATA_END])
        return len(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        pass

    def seal(self) -> None:
        """Write what is missing at the end of a file whose writer failed: no index, but every reader takes it."""
        if self.data_ended and self._last == MCAP0_MAGIC[:1]:
            return
        tail = RecordBuilder()
        if not self.data_ended:
            DataEnd(0).write(tail)
        if self._last != bytes([Opcode.FOOTER]):
            Footer(0, 0, 0).write(tail)
        self.takes_more = True
        self.write(tail.end() + MCAP0_MAGIC)  # type: ignore[no-untyped-call]

    def close(self) -> None:
        self._file.close()
