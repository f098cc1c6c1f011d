"""Decodes what is looked at, in one thread: the newest look of a viewer wins, then what was asked for beside, and while
nobody asks the pictures around the last look, so that a step finds its picture decoded."""

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from spheremcap.core.frame import Frame
from spheremcap.errors import SpheremcapError
from spheremcap.io.pictures import Pictures

HELD_BYTES = 192 << 20
"""Decoded pictures that the page keeps at hand: 140 of 1280x720."""
_AHEAD, _BEHIND = 60, 30  # pictures that are decoded around the last look

Answer = Future[Frame | None]


@dataclass(frozen=True, slots=True)
class _Look:
    index: int
    exact: bool
    answer: Answer


class Outdated(Exception):
    """A newer look of the same viewer came before this one was had."""


class Desk:
    """Answers looks at pictures by index, each with a Future; a context manager that ends its thread.

    The frame is None where there is no picture; an outdated look ends in `Outdated`.
    """

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self._looks: dict[str, _Look] = {}
        self._beside: deque[_Look] = deque()
        self._asked = threading.Condition()
        self._around: int | None = None
        room = HELD_BYTES // (pictures.width_px * pictures.height_px * 3 // 2)
        self._ahead, self._behind = min(_AHEAD, room // 2), min(_BEHIND, room // 4)
        self._open = True
        self._thread = threading.Thread(target=self._work, name="desk", daemon=True)
        self._thread.start()

    def __enter__(self) -> "Desk":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the thread; looks that wait are outdated."""
        with self._asked:
            self._open = False
            self._asked.notify()
        self._thread.join()
        for look in (*self._looks.values(), *self._beside):
            _outdate(look)

    def look(self, viewer: str, index: int, *, exact: bool) -> Answer:
        """The picture that a viewer wants to see now; not `exact`, the key frame before it will do."""
        with self._asked:
            before = self._looks.pop(viewer, None)
            if before is not None:
                _outdate(before)
            self._looks[viewer] = look = _Look(index, exact, Future())
            self._asked.notify()
        return look.answer

    def beside(self, index: int) -> Answer:
        """A picture that is wanted too, as soon as no look waits."""
        with self._asked:
            self._beside.append(look := _Look(index, True, Future()))
            self._asked.notify()
        return look.answer

    # --- the thread ---

    def _work(self) -> None:
        while self._open:
            with self._asked:
                viewer = next(iter(self._looks), None)
                look = self._looks.get(viewer) if viewer is not None else None
                beside = self._beside[0] if look is None and self._beside else None
                if look is None and beside is None and self._around is None:
                    self._asked.wait()
                    continue
            if look is not None and viewer is not None:
                self._serve(look, partial(self._outdated, viewer, look))
                with self._asked:
                    if self._looks.get(viewer) is look:
                        del self._looks[viewer]
            elif beside is not None:
                self._serve(beside, self._wanted_elsewhere)
                with self._asked:
                    if beside.answer.done():
                        self._beside.remove(beside)
            else:
                self._prepare()

    def _serve(self, look: _Look, stop: Callable[[], bool]) -> None:
        """Answer a look, unless `stop` says so on the way: then it stays as it is."""
        try:
            index = look.index if look.exact else self._pictures.key_at(look.index)
            frame = self._pictures.frame(index, lambda: not self._open or stop())
        except SpheremcapError as error:
            if not stop():
                with suppress(InvalidStateError):
                    look.answer.set_exception(error)
            return
        if frame is None and (not self._open or stop()):
            return
        with suppress(InvalidStateError):  # nobody waits for it any more
            look.answer.set_result(frame)
        self._around = look.index if look.exact else None

    def _outdated(self, viewer: str, look: _Look) -> bool:
        return self._looks.get(viewer) is not look

    def _wanted_elsewhere(self) -> bool:
        return bool(self._looks)

    def _prepare(self) -> None:
        """Decode a picture around the last look that is not yet; when all are, there is nothing to prepare."""
        pictures, at = self._pictures, self._around
        assert at is not None

        def stop() -> bool:
            return not self._open or bool(self._looks or self._beside)

        try:
            first, last = pictures.first_index, pictures.count - 1
            key = pictures.key_at(at)
            behind = range(key - 1, max(first, key - 1 - self._behind) - 1, -1) if at - key < self._behind else range(0)
            for index in (*range(at, min(last, at + self._ahead) + 1), *behind):
                if not pictures.holds(index):
                    pictures.frame(index, stop)
                if stop():
                    return
        except SpheremcapError:
            pass  # whoever looks at it is told
        if self._around == at:
            self._around = None


def _outdate(look: _Look) -> None:
    with suppress(InvalidStateError):
        look.answer.set_exception(Outdated())
