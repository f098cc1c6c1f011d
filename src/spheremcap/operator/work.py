"""One long job at a time, in a thread of its own, with its progress and a way to stop it."""

import ctypes
import gc
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

from spheremcap.errors import SpheremcapError, UsageError


@dataclass(frozen=True, slots=True)
class Job:
    """What is being done, or was done last; `number` counts the jobs from 1.

    `total` is None where nobody knows; `ended` says how: done, stopped, failed, or "" while it runs; `said` is a line
    for the person."""

    number: int = 0
    name: str = ""
    done: int = 0
    total: int | None = None
    ended: str = "done"
    said: str = ""


class Work:
    """Runs a job in a thread; `changed` is called when there is something new to show."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self.job = Job()
        self._changed = changed
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._starting = threading.Lock()

    def start(self, name: str, run: Callable[["Work"], str]) -> None:
        """Begin a job; what it returns is said at its end. Raises UsageError while another one runs."""
        with self._starting:
            if self.job.ended == "":
                raise UsageError(f"wait until this has ended, or stop it: {self.job.name}")
            self._stopping.clear()
            self._set(Job(self.job.number + 1, name, ended=""))
            self._thread = threading.Thread(target=self._run, args=(run,), name="work", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Ask the job to end."""
        self._stopping.set()

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for the job's end."""
        if self._thread is not None:
            self._thread.join(timeout_s)

    def stopping(self) -> bool:
        """For the job: whether it is asked to end."""
        return self._stopping.is_set()

    def progress(self, done: int, total: int | None) -> None:
        """For the job: how far it is."""
        self._set(replace(self.job, done=done, total=total))

    def _run(self, run: Callable[["Work"], str]) -> None:
        try:
            said, ended = run(self), "stopped" if self.stopping() else "done"
        except SpheremcapError as error:
            said, ended = str(error), "failed"
        except Exception as error:
            said, ended = f"a fault of spheremcap's own, please report it: {type(error).__name__}: {error}", "failed"
        give_back()
        self._set(replace(self.job, said=said, ended=ended))

    def _set(self, job: Job) -> None:
        self.job = job
        self._changed()


def give_back() -> None:
    """Give the memory that is free back to the system: glibc keeps what pictures took, and a page is open for hours.
    Elsewhere nothing happens."""
    gc.collect()
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
