"""Where experiments find their sessions and keep what they found."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from spheremcap.errors import UsageError
from spheremcap.evaluation.protocol import Trial, load_trial, load_trials
from spheremcap.synth import known, names, render, stroke_names

Item = TypeVar("Item")
Answer = TypeVar("Answer")
_MOST_WORKERS = 8
"""Each may keep a whole video in memory (`protocol.Film`), so there is one a core and never more than these."""


@dataclass(frozen=True)
class Lab:
    """The setting of every experiment.

    `folder` keeps all that they write: sessions/NAME (rendered when missing), peers/ (written by
    benchmarks/peers/run.sh) and a folder for each result. `sessions` may lie elsewhere. `clips` are
    folders of clips made elsewhere (`protocol.load_trials`). `quick` makes every experiment small, for a first look and
    for tests. `only` names the scenarios where not all are wanted.
    """

    folder: Path
    sessions: Path | None = None
    clips: tuple[Path, ...] = ()
    quick: bool = False
    only: tuple[str, ...] = ()
    tell: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True)

    def trial(self, scenario: str) -> Trial:
        """A rendered session, made when it is not there yet. Raises UsageError for an unknown scenario."""
        folder = (self.sessions or self.folder / "sessions") / scenario
        if not (folder / "seeds.toml").exists():
            if not known(scenario):
                raise UsageError(_unknown(scenario))
            self.tell(f"rendering {scenario}")
            render(scenario, folder, frames=60 if self.quick else None, overwrite=True)
        return load_trial(folder)

    def trials(self, among: Iterable[str] | None = None) -> list[Trial]:
        """The sessions of all scenarios but strokes, or of `among`; only those of `only` where that is given."""
        wanted = list(names() if among is None else among)
        if self.only:
            unknown = [name for name in self.only if not known(name)]
            if unknown:
                raise UsageError(_unknown(unknown[0]))
            wanted = [name for name in wanted if name in self.only] or list(self.only)
        return [self.trial(name) for name in wanted]

    @staticmethod
    def each(function: Callable[[Item], Answer], items: Sequence[Item]) -> Iterator[Answer]:
        """What `function` makes of each item, in the items' order, in processes side by side; both must pickle."""
        workers = min(os.cpu_count() or 1, len(items), _MOST_WORKERS)
        if workers < 2:
            yield from map(function, items)
            return
        # Ctrl-C is for all processes of a terminal: the workers end by it without a word.
        quiet = (signal.SIGINT, signal.SIG_DFL)
        with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), signal.signal, quiet) as pool:
            yield from pool.map(function, items)

    def clip_trials(self) -> list[Trial]:
        """The clips made elsewhere; none when no folder was given."""
        return [trial for folder in self.clips for trial in load_trials(folder)]


def _unknown(scenario: str) -> str:
    return f"unknown scenario {scenario!r}; there are: {', '.join((*names(), *stroke_names()))}"
