"""What long verbs share: how they start, a progress bar, and what is said of one that was stopped."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from spheremcap.cli.said import warn
from spheremcap.interrupt import unwind

if TYPE_CHECKING:
    from rich.progress import Progress


def loaded() -> None:
    """To be called once a verb has imported what it works with: OpenCV in one thread, the last line about compiled
    loops said, if any had to be compiled, and Ctrl-C ends what is open from now on.
    """
    unwind()
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


def stopped(after: str, part: Path | None) -> typer.Exit:
    """Say where the work of a run is that was stopped, and give its exit code."""
    kept = f"they are in {part}" if part is not None else "nothing was written"
    warn(f"stopped after {after}; {kept}")
    return typer.Exit(1)
