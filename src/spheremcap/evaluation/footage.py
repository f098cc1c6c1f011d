"""The chain on footage made elsewhere: clips and sessions of a folder that nobody here has rendered or filmed."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spheremcap.core.estimate import Status
from spheremcap.errors import UsageError
from spheremcap.evaluation.accuracy import BLOB, CHAIN, PEERS
from spheremcap.evaluation.blob import BlobTracker
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.metrics import FALSE_DICE, HIDDEN, Comparison, Score
from spheremcap.evaluation.protocol import Film, Run, Trial, run_alone, run_reseeded, score_run
from spheremcap.evaluation.result import Plot, Result, Table
from spheremcap.evaluation.tracks import Scores, read_tracks

_NEVER = 10**9  # frames after a failure until a method is seeded again
_A_QUARTER = 0.25  # visible


def footage(lab: Lab) -> Result:
    """The chain and other trackers on the clips of --clips: once through from the first circle, never seeded again."""
    trials = lab.clip_trials()
    if not trials:
        raise UsageError("footage: give folders with clips, --clips FOLDER, as often as needed")
    own = [["", "Dice % of visible", "failures", "VERIFIED below 0.5", "VERIFIED hidden", "lost at a quarter or more",
            "centre median px", "radius bias %", "range bias %", "range sd %", "NEES (3)"]]  # fmt: skip
    scores: dict[str, dict[str, Score]] = {}
    for trial, found in zip(trials, lab.each(partial(_all, folder=lab.folder / "peers"), trials), strict=True):
        lab.tell(f"footage: {trial.name}")
        overall, compared = found[CHAIN].overall, found[CHAIN].comparisons
        scores[trial.name] = {method: one.overall for method, one in found.items()}
        own.append(
            [
                trial.name,
                _cell(overall.accuracy_visible_pct, ".2f"), str(overall.failures),
                *(str(n) for n in _counts(compared)),
                _cell(overall.centre_median_px, ".3f"), _cell(overall.radius_bias_pct, "+.2f"),
                _cell(overall.range_bias_pct, "+.2f"), _cell(overall.range_sd_pct, ".2f"),
                _cell(overall.nees_mean, ".2f"),
            ]
        )  # fmt: skip
    methods = list(dict.fromkeys(method for row in scores.values() for method in row))
    duel = [["", *methods, "ahead of all"]]
    for name, row in scores.items():
        duel.append([name, *(_pair(row.get(method)) for method in methods), _ahead(row)])

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        places, width = np.arange(len(scores)), 0.8 / max(1, len(methods))
        for k, method in enumerate(methods):
            values = [row[method].accuracy_visible_pct if method in row else None for row in scores.values()]
            heights = [np.nan if value is None else value for value in values]
            axes.bar(places + k * width, heights, width, label=method, color="tab:blue" if k == 0 else None)
        axes.set_xticks(places + 0.4, list(scores), rotation=40, ha="right", fontsize=7)
        axes.set_ylabel("mean Dice over visible frames, %")
        axes.legend(fontsize=7, ncols=4)

    about = (
        "One set of settings for all; of the camera no more is given than the clip's own settings say, neither "
        "exposure nor readout time. Each method is seeded once, with the first circle of the truth or the clip's own "
        "seeds, and never again. Cells of the second table: mean Dice in % over all visible frames, where a frame "
        "without a circle counts 0, and failures in brackets (no overlap while visible). Lost are frames that are LOST "
        "or OUT_OF_VIEW while a quarter of the marker or more is visible."
    )
    if not any(peer in row for row in scores.values() for peer in PEERS):
        about += " OpenCV's trackers were not run: benchmarks/peers/run.sh CLIPS FOLDER/peers --alone."
    return Result(
        "footage",
        "Footage made elsewhere",
        about,
        "benchmarks/peers/run.sh CLIPS FOLDER/peers --alone; spheremcap experiment footage --clips CLIPS",
        (Table("The chain", own), Table("And other trackers: Dice % (failures)", duel)),
        (Plot("footage", "Overlap with the truth, by clip", draw, (1.5 + 0.9 * len(scores), 4.5)),),
    )


def _all(trial: Trial, folder: Path) -> dict[str, Scores]:
    """Every method's scores of one trial; OpenCV's trackers from their CSVs."""
    film = Film(trial)
    runs = {CHAIN: run_alone(trial, frames=film)}
    runs[BLOB] = run_reseeded(trial, {name: BlobTracker(name) for name in trial.markers}, _NEVER, film)
    for peer in PEERS:
        path = folder / trial.name / f"{peer}-alone.csv"
        if path.exists():
            runs[peer] = Run(tuple(read_tracks(path)[0]))
    return {method: score_run(trial, run) for method, run in runs.items()}


def _counts(compared: tuple[Comparison, ...]) -> tuple[int, int, int]:
    """Frames VERIFIED with hardly any overlap, VERIFIED while hidden, and lost while a quarter is seen."""
    wrong = hidden = lost = 0
    for one in compared:
        verified = one.status == Status.VERIFIED.value
        away = np.isin(one.status, [Status.LOST.value, Status.OUT_OF_VIEW.value])
        unseen = one.visible < HIDDEN
        wrong += int((verified & ~unseen & (one.dice < FALSE_DICE)).sum())
        hidden += int((verified & unseen).sum())
        lost += int((away & (one.visible >= _A_QUARTER)).sum())
    return wrong, hidden, lost


def _ahead(row: dict[str, Score]) -> str:
    """Whether the chain is ahead of every other method in overlap and not behind in failures."""
    ours = row[CHAIN]
    mine = ours.accuracy_visible_pct
    if mine is None:
        return "-"
    behind = [
        method
        for method, other in row.items()
        if method != CHAIN and ((other.accuracy_visible_pct or 0.0) >= mine or other.failures < ours.failures)
    ]
    return "yes" if not behind else "not of " + ", ".join(behind)


def _pair(score: Score | None) -> str:
    return "-" if score is None else f"{_cell(score.accuracy_visible_pct, '.2f')} ({score.failures})"


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
