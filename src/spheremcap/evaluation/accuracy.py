"""Accuracy and failures, by the thesis' protocol and by VOT's, of the chain, a colour blob and OpenCV's
trackers.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spheremcap.chain import ChainConfig
from spheremcap.core.estimate import Status
from spheremcap.evaluation.blob import BlobTracker
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.metrics import (
    COLUMNS,
    Score,
    failure_frames,
    false_accept_frames,
    missed_frames,
    reacquisitions,
    stretches,
    table_cells,
)
from spheremcap.evaluation.protocol import (
    VOT_BURN_IN_FRAMES,
    VOT_SKIP_FRAMES,
    Film,
    Run,
    Trial,
    chain_methods,
    run_alone,
    run_reseeded,
    score_run,
)
from spheremcap.evaluation.result import Plot, Result, Table
from spheremcap.evaluation.tracks import Scores, read_tracks

PEERS = ("CSRT", "KCF", "MedianFlow", "Boosting", "MIL", "MOSSE")
CHAIN, BLOB = "spheremcap", "HSV blob"
_SHORT = (
    "accuracy_pct", "accuracy_visible_pct", "failures", "centre_median_px", "radius_bias_pct",
    "position_mean_mm", "range_bias_pct", "range_sd_pct", "false_accepts", "missed_pct",
    "reacquire_max_frames", "never_reacquired", "nees_mean",
)  # fmt: skip


def accuracy(lab: Lab) -> Result:
    """The chain alone on every session, all metrics, and the frames on which something went wrong."""
    rows: dict[str, Score] = {}
    statuses = [["", *(f"{s.value} %" for s in Status), "frames"]]
    faults = [["", "failures at", "false accepts at", "missed at", "came back at (+ frames until measured)"]]
    trials = lab.trials() + lab.clip_trials()
    for trial, (scores, counted) in zip(trials, lab.each(_alone, trials), strict=True):
        lab.tell(f"accuracy: {trial.name}")
        for marker, one, compared in _by_marker(trial, scores):
            rows[marker] = one
            said = counted[compared.marker]
            statuses.append([marker, *(f"{100 * said[s] / said.total():.1f}" for s in Status), str(said.total())])
            back = [f"{frame} (+{'never' if wait is None else wait})" for frame, wait in reacquisitions(compared)]
            faults.append(
                [
                    marker,
                    stretches(failure_frames(compared)),
                    stretches(false_accept_frames(compared)),
                    stretches(missed_frames(compared)),
                    ", ".join(back) or "-",
                ]
            )

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, 2, sharey=True)
        names = list(rows)
        places = np.arange(len(names))
        values = [100 - (one.accuracy_pct if one.accuracy_pct is not None else np.nan) for one in rows.values()]
        axes[0].barh(places, values, color="tab:blue")
        axes[0].set_yticks(places, names, fontsize=7)
        axes[0].invert_yaxis()
        axes[0].set_xlabel("100 - accuracy, %")
        axes[1].barh(places, [one.centre_median_px or np.nan for one in rows.values()], color="tab:orange")
        axes[1].set_xlabel("centre error, median, px")
        for ax in axes:
            ax.set_xscale("log")
            ax.grid(axis="x", alpha=0.3)

    return Result(
        "accuracy",
        "The chain alone",
        "Each session once through, seeds as given (a click in whole pixels), no operator, one set of "
        "settings. Errors are of VERIFIED frames against the outline's equal-area circle and the true 3D "
        "centre; 3 is the expected NEES.",
        "spheremcap experiment accuracy",
        (
            Table("All metrics", table_cells(rows, [name for name, _, _ in COLUMNS])),
            Table("Where it went wrong", faults),
            Table("Statuses over all frames, also those without truth", statuses),
        ),
        (Plot("accuracy", "Overlap that is missing, and centre error", draw, (9, 0.9 + 0.24 * len(rows))),),
    )


def _alone(trial: Trial) -> tuple[Scores, dict[str, Counter[Status]]]:
    """The scores of the chain alone on a trial, and how often it said what, by marker."""
    run = run_alone(trial)
    said = {name: Counter(e.status for e in run.estimates if e.marker == name) for name in trial.markers}
    return score_run(trial, run), said


def peers(lab: Lab) -> Result:
    """Chain, colour blob and OpenCV's trackers, seeded again at each failure, on the same frames."""
    trials = lab.trials() + lab.clip_trials()
    folder = lab.folder / "peers"
    scores: dict[str, dict[str, Score]] = {}
    vot: dict[str, dict[str, tuple[float | None, int]]] = {}
    for trial, both in zip(trials, lab.each(partial(_duel, folder=folder), trials), strict=True):
        lab.tell(f"peers: {trial.name}")
        scores[trial.name], vot[trial.name] = both
    methods = list(dict.fromkeys(name for row in scores.values() for name in row))
    duel = [["", *methods, "best peer", "better"]]
    for name, row in scores.items():
        cells = [_pair(row[m].accuracy_visible_pct, row[m].failures) if m in row else "-" for m in methods]
        best = max((m for m in row if m != CHAIN), key=lambda m: _rank(row[m]), default=None)
        duel.append([name, *cells, best or "-", _verdict(row.get(CHAIN), row[best]) if best else "-"])
    vot_cells = [["", *methods]]
    for name, pairs in vot.items():
        vot_cells.append([name, *(_pair(*pairs[m]) if m in pairs else "-" for m in methods)])
    every = {f"{name}: {m}": one for name, row in scores.items() for m, one in row.items()}
    about = (
        "A failure is no overlap with the true circle while at least half of the marker is visible (3 "
        "frames of grace after it comes into view); the method is then seeded again with the true circle, "
        "on the next frame (thesis) or 5 frames later (VOT, which also leaves 10 frames after each seed "
        "out of the accuracy). Cells: mean Dice in % over all visible frames, where a frame without a "
        "circle counts 0, and failures in brackets. A peer's box counts as its inscribed circle; what a "
        "peer reports as found counts as VERIFIED."
    )
    if not folder.exists():
        about += " OpenCV's trackers were not run: benchmarks/peers/run.sh SESSIONS FOLDER/peers."

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, 2)
        places = np.arange(len(methods))
        rows = [[row[m] for row in scores.values() if m in row] for m in methods]
        seen = [[one.accuracy_visible_pct for one in group if one.accuracy_visible_pct is not None] for group in rows]
        axes[0].bar(places, [np.mean(values) if values else np.nan for values in seen])
        axes[0].set_ylabel("mean Dice over visible frames, %")
        axes[1].bar(places, [sum(one.failures for one in group) for group in rows], color="tab:red")
        axes[1].set_ylabel("failures, all sessions")
        for ax in axes:
            ax.set_xticks(places, methods, rotation=45, ha="right")

    return Result(
        "peers",
        "The chain and other trackers on the same frames",
        about,
        "benchmarks/peers/run.sh SESSIONS FOLDER/peers; spheremcap experiment peers",
        (
            Table("Thesis protocol: Dice % (failures)", duel),
            Table("VOT protocol: Dice % (failures)", vot_cells),
            Table("Thesis protocol, more metrics", table_cells(every, _SHORT)),
        ),
        (Plot("peers", "Mean over the sessions, and failures in all", draw),),
    )


def _duel(trial: Trial, folder: Path) -> tuple[dict[str, Score], dict[str, tuple[float | None, int]]]:
    """Every method's score of one trial by the thesis' protocol, and accuracy in % and failures by VOT's."""
    film = Film(trial)
    scores = {method: score_run(trial, run).overall for method, run in _runs(trial, film, folder, 1).items()}
    vot = {}
    for method, run in _runs(trial, film, folder, VOT_SKIP_FRAMES, "-vot").items():
        settled = score_run(trial, run, VOT_BURN_IN_FRAMES).overall.accuracy_visible_pct
        vot[method] = settled, score_run(trial, run).overall.failures
    return scores, vot


def _runs(trial: Trial, film: Film, folder: Path, skip_frames: int, suffix: str = "") -> dict[str, Run]:
    """Every method's run of one trial: chain and blob are run here, the others read from their CSVs."""
    runs = {
        CHAIN: run_reseeded(trial, chain_methods(trial), skip_frames, film),
        BLOB: run_reseeded(trial, {name: BlobTracker(name) for name in trial.markers}, skip_frames, film),
    }
    for peer in PEERS:
        path = folder / trial.name / f"{peer}{suffix}.csv"
        if path.exists():
            runs[peer] = Run(tuple(read_tracks(path)[0]))
    return runs


def _pair(accuracy_pct: float | None, failures: int) -> str:
    return f"{'-' if accuracy_pct is None else format(accuracy_pct, '.2f')} ({failures})"


def _rank(one: Score) -> tuple[float, int]:
    return one.accuracy_visible_pct or 0.0, -one.failures


def _verdict(ours: Score | None, theirs: Score) -> str:
    """Whether the chain beats the best peer in accuracy and failures."""
    if ours is None:
        return "-"
    won = [
        (ours.accuracy_visible_pct or 0) > (theirs.accuracy_visible_pct or 0),
        ours.failures <= theirs.failures,
    ]
    return {(True, True): "yes", (True, False): "accuracy only", (False, True): "failures only"}.get(
        (won[0], won[1]), "no"
    )


def _by_marker(trial: Trial, scores: Scores) -> list[tuple[str, Score, Any]]:
    """(row name, score, comparison) of each marker; the session's name alone when it has one marker."""
    alone = len(scores.markers) == 1
    return [
        (trial.name if alone else f"{trial.name}: {name}", one, compared)
        for (name, one), compared in zip(scores.markers.items(), scores.comparisons, strict=True)
    ]


# --- ablation ---


def variants(base: ChainConfig) -> Mapping[str, ChainConfig]:
    """The chain with each stage taken out in turn."""

    def without(stage: str, **changes: Any) -> ChainConfig:
        return base.model_copy(update={stage: getattr(base, stage).model_copy(update=changes)})

    trusting = {"th1": 0.0, "th2": 0.0, "visible": 0.0, "seed_colour": 0.0, "seed_around": 1.0, "seed_template": 0.0}
    return {
        "whole chain": base,
        'every stage on every frame (when_sure = "run")': base.model_copy(update={"when_sure": "run"}),
        "no KCF": without("kcf", enabled=False),
        "no GeometryScale": without("points", enabled=False),
        "no Hough": without("hough", enabled=False),
        "no ColorSmartBoundary": without("colour", enabled=False),
        "no shading model": without("edge", shading=False),
        "no chroma edges": without("edge", chroma=False),
        "no votes (TH1 = TH2 = 0)": without("jury", th1=0.0, th2=0.0),
        "no verification at all": without("jury", **trusting),
        "no Kalman prediction": without("kalman", enabled=False),
        "no re-acquisition": without("acquire", enabled=False),
        "circle instead of edge rays": without("position", formula="circle"),
        "thesis' formula, radius": without("position", formula="thesis", thesis_size="radius"),
    }


def ablation(lab: Lab) -> Result:
    """What each stage is worth: the chain alone without it, over all sessions."""
    trials = lab.trials()
    rows: dict[str, list[Scores]] = {name: [] for name in _rows(trials[0])}
    for trial, found in zip(trials, lab.each(_ablated, trials), strict=True):
        lab.tell(f"ablation: {trial.name}")
        for name, one in found.items():
            rows[name].append(one)
    heading = "accuracy % | of visible % | failures | false accepts | missed % | centre median px | 3D mm | "
    cells = [["", *(heading + "range bias % | requests").split(" | ")]]
    for name, scores in rows.items():
        overall = [s.overall for s in scores]
        cells.append(
            [
                name,
                _average([o.accuracy_pct for o in overall], ".2f"),
                _average([o.accuracy_visible_pct for o in overall], ".2f"),
                str(sum(o.failures for o in overall)),
                str(sum(o.false_accepts for o in overall)),
                _average([o.missed_pct for o in overall], ".2f"),
                _average([o.centre_median_px for o in overall], ".3f"),
                _average([o.position_mean_mm for o in overall], ".2f"),
                _average([o.range_bias_pct for o in overall], "+.3f"),
                str(sum(_requests(s) for s in scores)),
            ]
        )
    where = [["failures + false accepts", *(trial.name for trial in trials)]]
    for name, scores in rows.items():
        where.append([name, *(f"{s.overall.failures} + {s.overall.false_accepts}" for s in scores)])
    return Result(
        "ablation",
        "What each stage is worth",
        "Each session once through, alone, with one stage taken out. Averages are over sessions, counts are sums.",
        "spheremcap experiment ablation",
        (Table("All sessions", cells), Table("Where: failures + false accepts", where)),
    )


def _rows(trial: Trial) -> dict[str, Trial]:
    """The trial with the settings of each of the ablation's rows."""

    def changed(**settings: Any) -> Trial:
        return replace(trial, settings=trial.settings.model_copy(update=settings))

    def told(**camera: Any) -> Trial:
        return changed(camera=trial.settings.camera.model_copy(update=camera))

    return {
        **{name: changed(chain=config) for name, config in variants(trial.settings.chain).items()},
        "exposure time learnt": told(exposure_s=0.0),
        "readout time learnt": told(readout_s=None),
        "rolling shutter taken for a global one": told(readout_s=0.0),
    }


def _ablated(trial: Trial) -> dict[str, Scores]:
    """The scores of every row on one trial, whose video is decoded once."""
    film = Film(trial)
    return {name: score_run(row, run_alone(row, frames=film)) for name, row in _rows(trial).items()}


def _requests(scores: Scores) -> int:
    """Operator requests of a run, back from their rate."""
    spans = [c.stamp_ns[c.stamp_ns >= 0] for c in scores.comparisons]
    minutes = max((float(s[-1] - s[0]) / 6e10 for s in spans if len(s) > 1), default=0.0)
    return round((scores.overall.requests_per_min or 0.0) * minutes)


def _average(values: Sequence[float | None], form: str) -> str:
    there = [v for v in values if v is not None]
    return format(float(np.mean(there)), form) if there else "-"
