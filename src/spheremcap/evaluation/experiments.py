"""The experiments by name, and how one or all of them are run into a folder."""

from collections.abc import Callable, Mapping
from pathlib import Path

from spheremcap.errors import UsageError
from spheremcap.evaluation.accuracy import ablation, accuracy, peers
from spheremcap.evaluation.colours import colours
from spheremcap.evaluation.footage import footage
from spheremcap.evaluation.held_out import held_out
from spheremcap.evaluation.hough_tuning import hough
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.lighting import illumination
from spheremcap.evaluation.positions import positions
from spheremcap.evaluation.proposals import proposals
from spheremcap.evaluation.report import write_report
from spheremcap.evaluation.result import Result, load, save
from spheremcap.evaluation.signals import kalman, scale, votes
from spheremcap.evaluation.strokes import strokes
from spheremcap.io.output import make_folder

EXPERIMENTS: Mapping[str, Callable[[Lab], Result]] = {
    "accuracy": accuracy,
    "peers": peers,
    "footage": footage,
    "proposals": proposals,
    "positions": positions,
    "illumination": illumination,
    "hough": hough,
    "scale": scale,
    "colours": colours,
    "kalman": kalman,
    "votes": votes,
    "strokes": strokes,
    "ablation": ablation,
    "held-out": held_out,
}
"""Name to experiment, in the report's order."""


def describe(name: str) -> str:
    """What an experiment shows, from its docstring."""
    return " ".join((EXPERIMENTS[name].__doc__ or "").split())


def run_experiment(name: str, lab: Lab) -> Result:
    """Run one experiment, keep its result in the lab's folder, and return it. Raises UsageError for an
    unknown one.
    """
    if name not in EXPERIMENTS:
        raise UsageError(f"unknown experiment {name!r}; there are: {', '.join(EXPERIMENTS)}, report")
    make_folder(lab.folder)
    result = EXPERIMENTS[name](lab)
    save(result, lab.folder)
    return result


def run_report(lab: Lab, *, again: bool = False) -> Path:
    """Run what the folder has no result of (all when `again`) and write its report.html; returns the path."""
    for name in EXPERIMENTS:
        if name in ("footage", "held-out") and not lab.clips:
            continue
        if again or load(lab.folder, name) is None:
            run_experiment(name, lab)
    return write_report(lab.folder, list(EXPERIMENTS))
