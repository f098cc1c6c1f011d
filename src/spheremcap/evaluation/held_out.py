"""Whether the settings are the footage's that they were judged by: chosen again without one kind, scored on that."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from spheremcap.chain import ChainConfig
from spheremcap.errors import UsageError
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.metrics import Score
from spheremcap.evaluation.protocol import Film, Trial, load_trials, run_alone, score_run
from spheremcap.evaluation.result import Plot, Result, Table

Values = Mapping[str, tuple[float, ...]]
SETTINGS: Values = {
    "edge.chroma_sigma_px": (0.85, 1.5),
    "edge.noise": (0.004, 0.009),
    "edge.balance": (0.013, 0.03),
    "edge.least_contrast": (2.7, 6.0),
    "colour.least_hue": (4.0, 9.0),
    "colour.coverage": (0.88, 0.97),
    "matching.template_r_px": (9.0, 18.0),
    "kalman.acceleration_mps2": (40.0, 90.0),
    "jury.visible": (0.2, 0.45),
    "jury.near_visible": (0.13, 0.3),
    "jury.lost_visible": (0.27, 0.6),
    "jury.lost_likeness": (0.5, 0.85),
}
"""Settings that footage decided, and what else each could have been."""
DEFAULT = "default"
_A_FAULT = 5.0  # % of Dice that a failure or a false accept weighs in a choice, a % of the frames


def held_out(lab: Lab, settings: Values = SETTINGS) -> Result:
    """Settings chosen again on all kinds of footage but one and scored on that one: own renderings, those of the
    daylight renderer, and each folder of --clips."""
    kinds: dict[str, list[Trial]] = {}
    for trial in lab.trials():
        kinds.setdefault("day" if trial.name.startswith("day-") else "racing", []).append(trial)
    for folder in lab.clips:
        kinds.setdefault(folder.resolve().name, []).extend(load_trials(folder))
    if len(kinds) < 2:
        raise UsageError("held-out: there is one kind of footage: give another, --clips FOLDER, as often as needed")
    every = [trial for trials in kinds.values() for trial in trials]
    loss: dict[str, list[dict[str, float]]] = {kind: [] for kind in kinds}
    whose = {id(trial): kind for kind, trials in kinds.items() for trial in trials}
    for trial, one in zip(every, lab.each(partial(_losses, settings=settings), every), strict=True):
        lab.tell(f"held-out: {trial.name}")
        if one:
            loss[whose[id(trial)]].append(one)
    loss = {kind: ones for kind, ones in loss.items() if ones}
    best = {k: chosen({other: ones for other, ones in loss.items() if other != k}, settings) for k in loss}
    cells = [["without", "chosen instead of the default", "Dice %, default", "Dice %, chosen without it",
              "failures", "chosen without it"]]  # fmt: skip
    drawn: dict[str, tuple[float, float]] = {}
    for kind, values in best.items():
        scored = [
            pair
            for pair in lab.each(partial(_both, values=values), kinds[kind])
            if pair[0].accuracy_visible_pct is not None
        ]
        dice = [float(np.mean([pair[k].accuracy_visible_pct for pair in scored])) for k in (0, 1)]
        failures = [sum(pair[k].failures for pair in scored) for k in (0, 1)]
        drawn[kind] = dice[0], dice[1]
        said = ", ".join(f"{name} = {value:g}" for name, value in values.items()) or "nothing"
        cells.append([kind, said, *(f"{value:.2f}" for value in dice), *map(str, failures)])

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        places = np.arange(len(drawn))
        axes.bar(places, [pair[0] for pair in drawn.values()], 0.4, label="default")
        axes.bar(places + 0.4, [pair[1] for pair in drawn.values()], 0.4, label="chosen without this kind")
        axes.set_xticks(places + 0.2, list(drawn))
        axes.set_ylim(min(min(pair) for pair in drawn.values()) - 1, 100)
        axes.set_ylabel("mean Dice over visible frames, %")
        axes.legend()

    tried = "; ".join(f"{name} {', '.join(f'{v:g}' for v in values)}" for name, values in settings.items())
    return Result(
        "held-out",
        "Settings chosen without a kind of footage, scored on it",
        f"Each of the settings that footage decided is tried at other values, alone ({tried}). For each kind the "
        "values are taken that the other kinds like best, all counting alike: the least of what is missing from Dice "
        f"over all visible frames, in %, and {_A_FAULT:g} for each failure or false accept, in % of the frames. "
        "Then all of them together are scored on the kind that was left out.",
        "spheremcap experiment held-out --clips FOLDER",
        (Table("One kind left out", cells),),
        (Plot("held-out", "What is lost on footage that no setting has seen", draw, (6, 4)),),
    )


def _losses(trial: Trial, settings: Values) -> dict[str, float]:
    """What each value costs on a trial, by "setting = value"; {} where nothing of it can be scored."""
    film = Film(trial)
    losses: dict[str, float] = {}
    for key, changes in {DEFAULT: {}, **{f"{n} = {v:g}": {n: v} for n, vs in settings.items() for v in vs}}.items():
        score = _score(trial, film, changes)
        if score.accuracy_visible_pct is None:
            return {}
        wrong = 100 * (score.failures + score.false_accepts) / max(1, score.frames)
        losses[key] = 100 - score.accuracy_visible_pct + _A_FAULT * wrong
    return losses


def _both(trial: Trial, values: Mapping[str, float]) -> tuple[Score, Score]:
    film = Film(trial)
    return _score(trial, film, {}), _score(trial, film, values)


def _score(trial: Trial, film: Film, changes: Mapping[str, float]) -> Score:
    changed = replace(trial, settings=trial.settings.model_copy(update={"chain": _with(trial.settings.chain, changes)}))
    return score_run(changed, run_alone(changed, frames=film)).overall


def _with(config: ChainConfig, changes: Mapping[str, float]) -> ChainConfig:
    for name, value in changes.items():
        stage, field = name.split(".")
        config = config.model_copy(update={stage: getattr(config, stage).model_copy(update={field: value})})
    return config


def chosen(loss: Mapping[str, list[dict[str, float]]], settings: Values = SETTINGS) -> dict[str, float]:
    """The settings, other than the defaults, that these kinds like best."""
    mean = {
        key: float(np.mean([np.mean([one[key] for one in ones]) for ones in loss.values()]))
        for key in next(iter(loss.values()))[0]
    }
    best = {}
    for name, values in settings.items():
        least, liked = min((mean[f"{name} = {value:g}"], value) for value in values)
        if least < mean[DEFAULT]:
            best[name] = liked
    return best
