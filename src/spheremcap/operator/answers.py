"""What a person has answered, in a seeds file: each change is on disk, whole, before it is said to be saved."""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from spheremcap.config import load_seeds, seeds_toml
from spheremcap.core.marker import Answer, Hidden, Keep, Seed
from spheremcap.errors import UsageError
from spheremcap.io.output import output_error, write_durably

try:
    import fcntl
except ImportError:  # not on Windows: there two programs must not write one seeds file
    fcntl = None  # type: ignore[assignment]

_KINDS = {Seed: "circle", Hidden: "hidden", Keep: "keep"}


def kind_of(answer: Answer) -> str:
    """circle, hidden or keep, as the seeds file has it."""
    return _KINDS[type(answer)]


class AnswerFile:
    """The answers in a seeds file. Several pages, threads and programs may change it: nothing of theirs is lost.

    `given` are the answers that stand as long as there is no such file. An answer is known by its kind, marker and
    first frame: a later one of the same takes its place. `check` is asked of all of them before any is written. The
    file is written beside itself, synced and renamed, so that it is whole whenever the machine goes down. Where the
    file has the answers of several cameras, `place` is what the names of this one's markers begin with in there: only
    they are seen and changed here, by their names without it.

    Raises SettingsError for a file that is damaged, OutputError for one that cannot be written.
    """

    def __init__(
        self,
        path: Path,
        given: Sequence[Answer] = (),
        check: Callable[[Sequence[Answer]], None] = lambda answers: None,
        place: str = "",
    ) -> None:
        self.path = path
        self.revision = 0
        """Grows with every change that is seen."""
        self._given, self._check, self._place = tuple(given), check, place
        self._changing = threading.Lock()
        self._seen: tuple[int, int, int] | None = None
        self._answers: tuple[Answer, ...] = self._given
        with self._changing:
            self._read()

    def answers(self) -> tuple[Answer, ...]:
        """All of them, in the order in which they were given; read anew where another program has changed the file."""
        with self._changing:
            self._read()
            return tuple(self._own())

    def everything(self) -> tuple[Answer, ...]:
        """Those of all cameras, by the names that they have in the file."""
        with self._changing:
            self._read()
            return self._answers

    def _own(self) -> list[Answer]:
        """Those of this camera."""
        own = (answer for answer in self._answers if answer.marker.startswith(self._place))
        return [replace(answer, marker=answer.marker.removeprefix(self._place)) for answer in own]

    def put(self, answer: Answer) -> None:
        """Save an answer, in the place of the one before of the same kind, marker and first frame. Raises UsageError
        for one that cannot be, and then nothing has changed."""

        def with_it(there: Sequence[Answer]) -> list[Answer]:
            new = [answer if _known_by(a) == _known_by(answer) else a for a in there]
            return new if answer in new else [*new, answer]

        self._change(with_it)

    def take_back(self, kind: str, marker: str, frame_index: int) -> Answer:
        """Take an answer out again. Raises UsageError when there is none."""
        taken: list[Answer] = []

        def without(there: Sequence[Answer]) -> list[Answer]:
            taken.extend(a for a in there if _known_by(a) == (kind, marker, frame_index))
            if not taken:
                raise UsageError(f"there is no answer ({kind}) of {marker} on frame {frame_index} any more")
            return [a for a in there if a not in taken]

        self._change(without)
        return taken[0]

    def rename(self, marker: str, name: str) -> None:
        """Give a marker's answers another name."""
        self._change(lambda there: [replace(a, marker=name) if a.marker == marker else a for a in there])

    def _change(self, change: Callable[[Sequence[Answer]], Sequence[Answer]]) -> None:
        with self._changing, alone(self.path.parent):
            self._read()
            new = change(self._own())
            self._check(new)
            others = [answer for answer in self._answers if not answer.marker.startswith(self._place)]
            named = [replace(answer, marker=self._place + answer.marker) for answer in new]
            write_durably(self.path, seeds_toml([*others, *named]))
            self._read()

    def _read(self) -> None:
        state = state_of(self.path)
        if state is None:
            answers = self._given
        elif state == self._seen:
            return
        else:
            # Of a file that was emptied on purpose no answer is left.
            answers = tuple(load_seeds(self.path)) if state[2] else ()
        if state != self._seen or answers != self._answers:
            self._seen, self._answers = state, answers
            self.revision += 1


def _known_by(answer: Answer) -> tuple[str, str, int]:
    return kind_of(answer), answer.marker, answer.frame_index


def state_of(path: Path) -> tuple[int, int, int] | None:
    """By what a file is known to have changed: which it is, when it was written, its bytes. None: there is none."""
    try:
        found = os.stat(path)
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """While it is open, no other spheremcap changes a file of this folder."""
    try:
        lock = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise output_error(error, folder) from error
    try:
        if fcntl is not None:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)
