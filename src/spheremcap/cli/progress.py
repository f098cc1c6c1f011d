"""What long verbs share: how they start, a progress bar, and Ctrl-C that lets them finish the file."""

import signal
import sys
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.progress import Progress


def loaded() -> None:
    """To be called once a verb has imported what it works with: OpenCV in one thread, and the last line about
    compiled loops said, if any had to be compiled.
    """
    if "cv2" in sys.modules:
        import cv2

        cv2.setNumThreads(1)  # patches are small: threads only get in each other's way
    if "spheremcap.core.compiled" in sys.modules:
        from spheremcap.core.compiled import notice

        notice.done()


def bar(unit: str = "frames") -> "Progress":
    """A bar on stderr that counts and says how long it will take; silent when that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeRemainingColumn(),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip


class Interrupt:
    """While it is open, the first Ctrl-C is only noted: call it to ask. The second ends the process as usual."""

    def __enter__(self) -> Self:
        self._seen = False
        self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._before)

    def __call__(self) -> bool:
        return self._seen

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._seen:
            raise KeyboardInterrupt
        self._seen = True
