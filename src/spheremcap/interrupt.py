"""How a command ends before its time: Ctrl-C, SIGTERM and SIGHUP, all in the same way and without a traceback.

While a command is starting there is nothing to finish, so it leaves at once. Once it works, what it has open is ended:
by an exception, or, where a verb asks an `Interrupt` between two steps, in good order.
"""

import os
import signal
from types import FrameType, TracebackType
from typing import Any, Self

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Interrupted(BaseException):
    """A signal ended the command; like KeyboardInterrupt nothing but the outermost place catches it."""


def leave_at_once() -> None:
    """From now on a signal ends the process where it stands, whatever it is importing or compiling."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _leave)


def unwind() -> None:
    """From now on a signal that would end the process at once raises Interrupted, so that open files are ended."""
    for number in SIGNALS:
        if signal.getsignal(number) is _leave:
            signal.signal(number, _raise)


class Interrupt:
    """While it is open, the first signal is only noted: call it to ask. The second raises Interrupted.

    A SIGTERM or SIGHUP that the process was started to ignore (nohup) stays ignored.
    """

    def __enter__(self) -> Self:
        self._seen = False
        self._before: dict[int, Any] = {}
        for number in SIGNALS:
            if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def __call__(self) -> bool:
        return self._seen

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._seen:
            _raise(number, frame)
        self._seen = True


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, b"spheremcap: interrupted\n")
    os._exit(1)


def _raise(number: int, frame: FrameType | None) -> None:
    raise Interrupted("interrupted")
