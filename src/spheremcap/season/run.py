"""All sessions of a season that have no result yet: a few at once here, or as many as a cluster takes.

A session is run by `run_one`, wherever its executor calls it, in a process of its own (`worker`). Whatever happens to
that costs this session alone. Who stops the run leaves a file that every worker looks for, so that it works the same
way on other machines.
"""

import json
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from secrets import token_hex

from spheremcap.errors import OutputError, UsageError
from spheremcap.io.output import make_folder
from spheremcap.season.key import is_done, size_of
from spheremcap.season.manifest import Plan, Season
from spheremcap.season.outcome import (
    LOG,
    OUT_OF_MEMORY,
    SEASON,
    WORK,
    Outcome,
    failed,
    read_outcome,
    write_outcome,
    write_season,
)
from spheremcap.season.worker import BUSY, FAILED, KEPT, PROGRESS, STOPPED, TOO_LARGE, Ended, Workers, alone

_LOOKED_EVERY_S = 0.5
_STOP = ".stop-"
_STOP_STAYS_S = 3600.0
"""No run takes so long to stop."""
_WEIGHTS = {"tracking": (0.02, 0.85), "merging": (0.85, 0.92), "analysing": (0.92, 0.98), "tables": (0.98, 1.0)}
"""Where in a session each step begins and ends, as shares of its time."""

_NO_MEMORY = (
    "MemoryError", "bad_alloc", "memory allocation of", "Memory allocation still failed", "out of memory",
    "Cannot allocate memory", "can't start new thread",
)  # fmt: skip
"""What libraries say that want more memory than there is."""

Submit = Callable[[Plan, Path, Path], "Future[Outcome | None]"]
"""Has `run_one` called somewhere."""
_workers = Workers()


class BusyError(Exception):
    """Another run is at work on the session."""


def run_one(plan: Plan, folder: Path, stop_file: Path) -> Outcome | None:
    """Run a session in a process of its own, and say how it ended; None where it was stopped. Raises BusyError."""
    if stop_file.exists():
        return None
    with _workers.one() as worker:
        ended = worker.run(plan, folder, stop_file.exists)
    if ended.hung and ended.code not in (0, KEPT):
        reason = f"not done after {plan.timeout_h:g} hours (timeout_h), and ended"
    elif ended.code == TOO_LARGE:
        reason = f"out of memory: it needed more than memory_gb = {plan.memory_gb:g}: give it more"
    elif ended.code == STOPPED:
        return None
    elif ended.code == BUSY:
        raise BusyError
    elif ended.code in (0, KEPT):
        outcome = read_outcome(folder)
        if outcome is not None and ended.code == 0:
            outcome = outcome.model_copy(update={"peak_mb": ended.peak_mb})
            with suppress(OutputError):  # nothing hangs on it
                write_outcome(folder, outcome)
        if outcome is not None:
            return outcome
        reason = "its run.json cannot be read: is the disk full?"
    else:
        reason = _why(folder, ended)
    return _failed(plan, folder, reason)


def _failed(plan: Plan, folder: Path, reason: str) -> Outcome:
    """A session whose process or worker cannot say any more how it ended. Raises BusyError."""
    outcome = failed(plan, reason, read_outcome(folder))
    try:
        make_folder(folder)
        with alone(folder) as free:
            if not free:
                raise BusyError
            shutil.rmtree(folder / WORK, ignore_errors=True)  # what it was at
            write_outcome(folder, outcome)
    except OutputError as error:
        return outcome.model_copy(update={"reason": f"{reason}; {error}"})
    return outcome


def _why(folder: Path, ended: Ended) -> str:
    """Why a session's process ended that did not say so itself."""
    lines = _last_lines(folder / LOG)
    if any(word in line for line in lines for word in _NO_MEMORY):
        return OUT_OF_MEMORY
    said = lines[-1] if lines else ""
    if ended.code == FAILED:
        return said
    behind = f": {said}" if said else ""
    if ended.code >= 0:
        return f"a fault of spheremcap's own ended it{behind} ({LOG} has the trace that belongs in a report)"
    name = signal.Signals(-ended.code).name
    if -ended.code == signal.SIGKILL:
        return f"it was killed ({name}): by somebody, or by the system because memory ran out"
    return f"it crashed ({name}){behind}"


def _last_lines(log: Path) -> list[str]:
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    return [line.strip()[:300] for line in lines[-200:] if line.strip()]


# --- where sessions are run ---


@contextmanager
def here(workers: int) -> Iterator[Submit]:
    """So many at once on this machine."""
    pool = ThreadPoolExecutor(workers)
    try:
        yield lambda plan, folder, stop_file: pool.submit(run_one, plan, folder, stop_file)
    finally:
        pool.shutdown(cancel_futures=True)
        _workers.close()


@contextmanager
def on_dask(address: str) -> Iterator[Submit]:
    """On the workers of a Dask cluster, which see the same files under the same paths. Raises UsageError."""
    from distributed import Client

    try:
        client = Client(address, timeout="20s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise UsageError(f"--dask {address}: no scheduler answers there: {error}") from error
    run = token_hex(4)
    with client, client.get_executor(pure=False) as executor:
        # The scheduler's own page calls a task by its key.
        yield lambda plan, folder, stop_file: executor.submit(
            run_one, plan, folder, stop_file, key=f"{plan.name}-{run}"
        )


def shard(plans: Sequence[Plan], text: str) -> list[Plan]:
    """The share `i/n` of the sessions: every n-th by name. i counts from 0 or from 1, as array jobs do."""
    number, slash, of = text.partition("/")
    if not (slash and number.isdecimal() and of.isdecimal() and int(of) > 0 and int(number) <= int(of)):
        raise UsageError(f"--shard {text}: expected I/N, as in --shard $SLURM_ARRAY_TASK_ID/10")
    return [plan for k, plan in enumerate(plans) if k % int(of) == int(number) % int(of)]


# --- the run ---


@dataclass
class Doing:
    """How far a run is. Sizes are bytes of video, by which it is told how long the rest takes."""

    sizes: Mapping[str, int]
    ended: dict[str, Outcome] = field(default_factory=dict)
    """By session, those that this run has ended."""
    working: dict[str, tuple[str, float]] = field(default_factory=dict)
    """By session, the step that it is at, and the share of the session that is done."""

    @property
    def done_bytes(self) -> float:
        """Of what this run has to do."""
        part = sum(self.sizes[name] * share for name, (_, share) in self.working.items())
        return part + sum(self.sizes[name] for name in self.ended)


@dataclass(frozen=True)
class SeasonRun:
    """What a run did: how the sessions that it was about ended, by name (of those before, too); which of them this run
    has made; which it left to another run that is at work on them; and whether it was stopped before all were made."""

    outcomes: Mapping[str, Outcome]
    made: tuple[str, ...]
    left: tuple[str, ...]
    stopped: bool

    @property
    def complete(self) -> bool:
        """Every session has its whole result."""
        return (
            not self.stopped and not self.left and all(outcome.status == "done" for outcome in self.outcomes.values())
        )


def run_season(
    season: Season,
    plans: Sequence[Plan],
    out: Path,
    submit: Submit,
    *,
    show: Callable[[Doing], None] = lambda doing: None,
    ended: Callable[[Outcome], None] = lambda outcome: None,
    stop: Callable[[], bool] = lambda: False,
) -> SeasonRun:
    """Run those of `plans` that have no result in `out`, the longest first. `show` is called twice a second, `ended`
    with each session's end, `stop` asked as often: when it says so, what is in work is ended and nothing else begun.

    Raises UsageError where `out` is a folder of something else, OutputError where it cannot be written.
    """
    checked_season_folder(out)
    make_folder(out)
    out = out.resolve()  # the same for workers that stand elsewhere
    write_season(out, season)
    known = {plan.name: read_outcome(out / plan.name) for plan in plans}
    todo = [plan for plan in plans if not is_done(plan, known[plan.name], out / plan.name)]
    sizes = {plan.name: size_of(plan) for plan in todo}
    doing = Doing(sizes)
    others: list[str] = []
    for stale in out.glob(f"{_STOP}*"):  # of a run that was killed while it stopped
        with suppress(OSError):
            if time.time() - stale.stat().st_mtime > _STOP_STAYS_S:
                stale.unlink()
    stop_file = out / f"{_STOP}{token_hex(4)}"
    stopped = asked = False
    futures: dict[Future[Outcome | None], Plan] = {}
    try:
        for plan in sorted(todo, key=lambda plan: -sizes[plan.name]):
            futures[submit(plan, out / plan.name, stop_file)] = plan
        left = set(futures)
        while left:
            finished, left = wait(left, _LOOKED_EVERY_S, FIRST_COMPLETED)
            for future in finished:
                plan = futures[future]
                try:
                    outcome = _result(future, plan, out / plan.name)
                except BusyError:
                    others.append(plan.name)
                    continue
                if outcome is None:  # perhaps somebody ended this one alone
                    stopped = True
                else:
                    doing.ended[plan.name] = outcome
                    doing.working.pop(plan.name, None)
                    ended(outcome)
            if not asked and stop():
                stopped = asked = True
                stop_file.touch()
            doing.working = _working(out, [futures[future] for future in left])
            show(doing)
    finally:
        if any(not future.done() for future in futures):  # somebody will not wait
            stop_file.touch()
            wait(futures, 60)
        stop_file.unlink(missing_ok=True)
    made = tuple(sorted(doing.ended))
    outcomes = {name: outcome for name, outcome in known.items() if outcome is not None and name not in sizes}
    return SeasonRun(dict(sorted((outcomes | doing.ended).items())), made, tuple(sorted(others)), stopped)


def checked_season_folder(out: Path) -> None:
    """Raises UsageError for a folder that has something else in it: results replace what has their names."""
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is a file: name a folder for the season's results")
    if out.is_dir() and not (out / SEASON).exists() and any(path.name[0] != "." for path in out.iterdir()):
        raise UsageError(f"{out} is not empty, and no season was run into it: name a new folder")


def _result(future: "Future[Outcome | None]", plan: Plan, folder: Path) -> Outcome | None:
    """How a session ended. Where its worker was lost with it, that is how. Raises BusyError."""
    try:
        return future.result()
    except CancelledError:
        return None
    except BusyError:
        raise
    except Exception as error:
        return _failed(plan, folder, f"the worker that ran it was lost: {error}")


def _working(out: Path, plans: Sequence[Plan]) -> dict[str, tuple[str, float]]:
    """The sessions that are in work, by what they say themselves."""
    working = {}
    for plan in plans:
        try:
            told = json.loads((out / plan.name / WORK / PROGRESS).read_text())
        except (OSError, ValueError):
            continue
        begin, end = _WEIGHTS.get(told["step"], (0.0, 0.02))
        share = told["done"] / told["total"] if told["total"] else 0.0
        working[plan.name] = told["step"], begin + (end - begin) * min(share, 1.0)
    return working


def default_workers() -> int:
    """How many sessions at once: one for each two processors, for pictures are decoded beside the tracking."""
    return max(1, (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1) // 2)
