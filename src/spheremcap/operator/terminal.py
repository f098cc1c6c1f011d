"""Asks a person on the terminal: a picture file to look at, and a line to answer with."""

import re
import select
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from datetime import UTC, datetime
from pathlib import Path

from spheremcap.api import Asked
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Answer, Hidden, Keep, Seed
from spheremcap.errors import UsageError, short
from spheremcap.io.output import output_error
from spheremcap.io.overlays import request_picture
from spheremcap.operator.answers import AnswerFile

HELP = "x,y,r (pixels)  |  x,y,r@FRAME  |  see FRAME  |  hidden A-B  |  keep  |  nothing: later"
_NUMBER = r"\s*(\d+(?:\.\d+)?)\s*"
_CIRCLE = re.compile(rf"{_NUMBER},{_NUMBER},{_NUMBER}(?:@\s*(\d{{1,9}})\s*)?", re.ASCII)
_SEE = re.compile(r"see\s+(\d{1,9})", re.ASCII)
_HIDDEN = re.compile(r"hidden\s+(\d{1,9})\s*-\s*(\d{1,9})", re.ASCII)


def now() -> str:
    """The time of an answer, RFC 3339."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def read_line(stopped: Callable[[], bool]) -> str | None:
    """A line from the terminal; None at its end, or when `stopped` says so while nobody types."""
    while not stopped():
        with suppress(OSError, ValueError):  # Windows, or a stdin that is no file: it is waited for
            if not select.select([sys.stdin], [], [], 0.2)[0]:
                continue
        line = sys.stdin.readline()
        return line.strip() if line else None
    return None


class Terminal:
    """An operator who reads and types. Answers are in the seeds file before they are given back.

    Pictures are named after `output`, and go when their request has been answered. `say` takes a line for the person,
    `hear` gives theirs, None when there will be no more; `alone` keeps the terminal free of anything else meanwhile.
    """

    def __init__(
        self,
        answers: AnswerFile,
        output: Path,
        author: str,
        alone: Callable[[], AbstractContextManager[object]],
        hear: Callable[[], str | None],
        say: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True),
        clock: Callable[[], str] = now,
    ) -> None:
        self._answers, self._output, self._author = answers, output, author
        self._alone, self._hear, self._say, self._clock = alone, hear, say, clock
        self._gone = False  # nobody answers any more

    def ask(self, asked: Asked) -> Sequence[Answer]:
        """One answer, or none."""
        if self._gone:
            return []
        request, pictures = asked.request, list[Path]()
        with self._alone():
            self._say(
                f"{request.marker} is lost on frame {request.raised_at_frame_index}, and not verified from frame "
                f"{request.frame_index} on: {request.reason}"
            )
            if asked.last_measured is not None:
                self._show(asked, asked.last_measured.frame_index, "where it was last measured", pictures)
            shown = self._show(asked, request.frame_index, "the first frame without it", pictures)
            self._say(HELP)
            try:
                while (line := self._hear()) is not None:
                    if not line:
                        return []
                    if see := _SEE.fullmatch(line):
                        shown = self._show(asked, int(see[1]), "", pictures) or shown
                        continue
                    try:
                        answer = self._understood(line, asked, shown)
                        asked.check([answer])
                        self._answers.put(answer)
                    except UsageError as error:
                        self._say(f"{error}; {HELP}")
                        continue
                    return [answer]
                self._gone = True
                return []
            finally:
                for path in pictures:
                    path.unlink(missing_ok=True)

    def _understood(self, line: str, asked: Asked, shown: int | None) -> Answer:
        """Raises UsageError for what is no answer."""
        request, signed = asked.request, (self._author, self._clock())
        if line == "keep":
            return Keep(request.marker, request.frame_index, request.raised_at_frame_index, *signed)
        if span := _HIDDEN.fullmatch(line):
            if int(span[2]) < int(span[1]):
                raise UsageError(f"hidden {span[1]}-{span[2]} ends before it begins")
            return Hidden(request.marker, int(span[1]), int(span[2]), *signed)
        circle = _CIRCLE.fullmatch(line)
        if circle is None:
            raise UsageError(f"{short(line)} is no answer")
        frame = int(circle[4]) if circle[4] else shown
        if frame is None:
            raise UsageError("no frame was shown: say which, as in x,y,r@FRAME")
        return Seed(request.marker, frame, Circle(float(circle[1]), float(circle[2]), float(circle[3])), *signed)

    def _show(self, asked: Asked, index: int, what: str, pictures: list[Path]) -> int | None:
        """A picture of a frame as a file, named to the person; the frame's index when there is one."""
        frame = asked.frame_at(index)
        if frame is None:
            self._say(f"there is no frame {index} that can be shown")
            return None
        path = Path(f"{self._output}.{request_name(asked.request.marker)}@{index}.png")
        around = [e for e in (asked.last_measured, asked.estimate) if e is not None and e.circle is not None]
        try:
            path.write_bytes(request_picture(frame.full, [e for e in around if e.frame_index == index] or around[:1]))
        except OSError as error:
            raise output_error(error, path) from error
        pictures.append(path)
        self._say(f"frame {index}{', ' * bool(what)}{what}: {path}")
        return index


def request_name(marker: str) -> str:
    """A marker's name as part of a file's."""
    return marker.replace("/", "_")
