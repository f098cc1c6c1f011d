"""A process that runs sessions, each in one of its own, forked from it: what they work with is loaded only once.

It is told what to do on stdin, a line of JSON each, and says on stdout how a session's process ended. When stdin ends,
whoever started it is gone: then so is the session in work, which another run makes again.
"""

import contextlib
import fcntl
import json
import os
import resource
import select
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from spheremcap.interrupt import SIGNALS
from spheremcap.season.manifest import Plan
from spheremcap.season.outcome import LOG, WORK

FAILED, STOPPED, BUSY, TOO_LARGE, KEPT = 3, 4, 5, 6, 7
"""Exit codes of a session's process, beside 0 (it has made something) and 1 (a fault): the last line of its log says
why nothing could be written; it was asked to end; another run is at work on the session; it had more memory than it may
have; its result was there already."""
PROGRESS = "progress.json"
_ASKED_EVERY_S = 0.25
_GRACE_S = 30.0
_BUSY_S = 5.0
"""How long the process of a run that was killed may take to end."""


class Ended(NamedTuple):
    """How a session's process ended: its exit code, or minus the signal that ended it; the most memory it had, MB
    (None: nobody knows); `hung`: it had taken longer than it may."""

    code: int
    peak_mb: int | None
    hung: bool = False


# --- of whoever starts it ---


class Worker:
    """The process, from the outside. One session at a time."""

    def __init__(self) -> None:
        # No threads while sessions are forked from here, and the same sums on every machine.
        one_thread = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP")}
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "spheremcap.season.worker"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env=os.environ | one_thread, start_new_session=True,
        )  # fmt: skip

    @property
    def usable(self) -> bool:
        """Whether it runs still."""
        return self._process.poll() is None

    def run(self, plan: Plan, folder: Path, stop: Callable[[], bool]) -> Ended:
        """Run a session and wait for its end, which comes early where `stop` says so or it takes too long."""
        assert self._process.stdout is not None
        since = time.monotonic()
        limit_s = plan.timeout_h * 3600
        self._tell({"run": plan.model_dump(mode="json"), "folder": str(folder)})
        hung, asked_s = False, None
        while True:
            ready, _, _ = select.select([self._process.stdout], [], [], _ASKED_EVERY_S)
            now = time.monotonic()
            if ready:
                line = self._process.stdout.readline()
                if not line:  # it was killed itself
                    code = self._process.wait()
                    return Ended(STOPPED if -code in SIGNALS else code, None, hung)
                told = json.loads(line)
                ended_by_us = asked_s is not None and told["code"] < 0
                return Ended(STOPPED if ended_by_us else told["code"], told["peak_mb"], hung)
            hung = hung or now - since > limit_s
            if asked_s is None and (hung or stop()):
                asked_s = now
                self._tell({"signal": int(signal.SIGTERM)})
            elif asked_s is not None and now - asked_s > _GRACE_S:
                asked_s = now
                self._tell({"signal": int(signal.SIGKILL)})

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _tell(self, what: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # it is gone: which reading its answer shows
            self._process.stdin.write(json.dumps(what).encode() + b"\n")
            self._process.stdin.flush()


class Workers:
    """As many as are needed at once; they stay for the next sessions."""

    def __init__(self) -> None:
        self._idle: list[Worker] = []
        self._taking = threading.Lock()

    @contextmanager
    def one(self) -> Iterator[Worker]:
        """A worker for one session."""
        with self._taking:
            worker = self._idle.pop() if self._idle else None
        worker = worker or Worker()
        whole = False
        try:
            yield worker
            whole = True
        finally:
            if whole and worker.usable:  # else it may be at work still
                with self._taking:
                    self._idle.append(worker)
            else:
                worker.close()

    def close(self) -> None:
        """End all that do nothing."""
        with self._taking:
            while self._idle:
                self._idle.pop().close()


# --- in the process ---


def main() -> None:
    """Run what is asked for on stdin until it ends."""
    for number in SIGNALS:  # who ends all processes of a run at once, as SLURM does, has told the session itself
        signal.signal(number, signal.SIG_IGN)
    answers = os.dup(1)
    os.dup2(2, 1)  # whatever prints does not answer
    lines = _Lines(0)
    # What sessions work with, loaded for all of them.
    import pyarrow.parquet

    from spheremcap.season import session  # noqa: F401

    pyarrow.array([0])  # which loads pandas, where it is installed
    while (told := lines.next()) is not None:
        if "run" not in told:
            continue  # a signal for one that has ended by itself
        ended, alive = os.pipe(), os.pipe()
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        child = os.fork()
        if child == 0:
            for number in SIGNALS:  # until the session looks for them itself
                signal.signal(number, _leave)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
            for unused in (ended[0], alive[1], answers):
                os.close(unused)
            threading.Thread(target=_end_with, args=(alive[0],), daemon=True).start()
            os._exit(_run(Plan.model_validate(told["run"]), Path(told["folder"])))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        os.close(ended[1])
        os.close(alive[0])
        _wait(lines, ended[0], child)
        _, status, usage = os.wait4(child, 0)
        for pipe in (ended[0], alive[1]):
            os.close(pipe)
        answer = {"code": os.waitstatus_to_exitcode(status), "peak_mb": _peak_mb(usage)}
        with contextlib.suppress(BrokenPipeError):  # nobody is there to be told
            os.write(answers, json.dumps(answer).encode() + b"\n")


def _wait(lines: "_Lines", ended: int, child: int) -> None:
    """Wait for the session's end, and hand on signals; with whoever asked for it gone, it is killed."""
    while True:
        if not lines.waiting:
            ready, _, _ = select.select([ended, *([0] if not lines.ended else [])], [], [])
            if ended in ready:
                return
        told = lines.next()
        if told is None:
            os.kill(child, signal.SIGKILL)
        elif "signal" in told:
            os.kill(child, told["signal"])


class _Lines:
    """Lines of JSON from a descriptor that is also waited for."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._read = b""
        self.ended = False

    @property
    def waiting(self) -> bool:
        """Whether one has been read already, which nothing would wait for."""
        return b"\n" in self._read

    def next(self) -> dict[str, Any] | None:
        """The next one; None at the end."""
        while not self.waiting:
            part = os.read(self._descriptor, 1 << 16)
            if not part:
                self.ended = True
                return None
            self._read += part
        line, _, self._read = self._read.partition(b"\n")
        return dict(json.loads(line))


def _leave(number: int, frame: FrameType | None) -> None:
    os._exit(STOPPED)


def _end_with(alive: int) -> None:
    """End when the process that this one was forked from does."""
    os.read(alive, 1)
    os.kill(os.getpid(), signal.SIGKILL)


def _end_above(memory_gb: float) -> None:
    """End when the process has more memory than that. (Its address space, which could be limited instead, is several
    times as large.)"""
    while _peak_mb(resource.getrusage(resource.RUSAGE_SELF)) <= memory_gb * 1024:
        time.sleep(_ASKED_EVERY_S)
    os._exit(TOO_LARGE)


def _peak_mb(usage: resource.struct_rusage) -> int:
    return usage.ru_maxrss // (1024 * 1024 if sys.platform == "darwin" else 1024)


def _run(plan: Plan, folder: Path) -> int:
    """A session, in its own process; its exit code."""
    from spheremcap.errors import SpheremcapError, printable
    from spheremcap.interrupt import Interrupt, Interrupted
    from spheremcap.season.session import run_session

    began, shown_s = time.monotonic(), 0.0

    def progress(step: str, done: int, total: int | None) -> None:
        nonlocal shown_s
        now = time.monotonic()
        if now - shown_s >= 1 or done == 0:
            shown_s = now
            _show(folder, {"pid": os.getpid(), "step": step, "done": done, "total": total})

    def say(line: str) -> None:
        print(f"{time.monotonic() - began:9.3f} s  {printable(line)}", flush=True)

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with alone(folder) as free:
            if not free:
                return BUSY
            before = (folder / LOG).read_bytes() if (folder / LOG).is_file() else b""
            log = os.open(folder / LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o666)
            nothing = os.open(os.devnull, os.O_RDONLY)
            for old, new in ((nothing, 0), (log, 1), (log, 2)):
                os.dup2(old, new)
            if plan.memory_gb is not None:
                threading.Thread(target=_end_above, args=(plan.memory_gb,), daemon=True).start()
            with Interrupt() as interrupted:
                _, made = run_session(plan, folder, progress=progress, say=say, stop=interrupted)
            if not made:  # the log is about how it was
                (folder / LOG).write_bytes(before)
        return 0 if made else KEPT
    except (Interrupted, KeyboardInterrupt):
        print("stopped", flush=True)
        return STOPPED
    except SpheremcapError as error:
        print(printable(str(error)), flush=True)
        return FAILED
    except BaseException:
        traceback.print_exc()
        return 1


@contextmanager
def alone(folder: Path) -> Iterator[bool]:
    """While it is open no other run works in this folder; False where one does, and goes on to."""
    lock = os.open(folder, os.O_RDONLY)
    try:
        until = time.monotonic() + _BUSY_S
        while True:
            free = True
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                free = False
            except OSError:  # a file system without locks
                pass
            if free or time.monotonic() > until:
                break
            time.sleep(_ASKED_EVERY_S)
        yield free
    finally:
        os.close(lock)


def _show(folder: Path, told: dict[str, Any]) -> None:
    """How far the session is, for whoever looks."""
    path = folder / WORK / PROGRESS
    beside = path.with_suffix(".new")
    with contextlib.suppress(OSError):  # nothing hangs on it
        beside.write_text(json.dumps(told))
        beside.replace(path)


if __name__ == "__main__":
    main()
