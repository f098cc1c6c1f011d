"""The Hough optimisation of the thesis' section 2.4.1: the best (dp, minDist, param1, param2) by eq 2.19."""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from spheremcap.chain import ChainConfig
from spheremcap.config import Settings, load_settings
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Patch, Window
from spheremcap.detection.hough import HoughConfig, hough_circles
from spheremcap.errors import UsageError
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.metrics import TruthRow
from spheremcap.evaluation.protocol import Trial
from spheremcap.evaluation.result import Plot, Result, Table
from spheremcap.evaluation.tracks import read_truth
from spheremcap.io.output import checked_output, whole_file
from spheremcap.io.video import VideoSource

THESIS = {"dp": 4.0, "min_dist_px": 1.0, "param1": 77.0, "param2": 1.0}
"""Eq 2.20, with a mean error of 0.10648 on the thesis' 240 images."""
GRID = {
    "dp": (1.0, 1.5, 2.0, 3.0, 4.0, 5.0),
    "min_dist_px": (1.0, 8.0),
    "param1": (20.0, 45.0, 77.0, 120.0, 200.0),
    "param2": (1.0, 4.0, 10.0),
}
RANGES = {"dp": (1.0, 6.0), "min_dist_px": (1.0, 20.0), "param1": (10.0, 250.0), "param2": (1.0, 20.0)}
"""What Monte Carlo draws from: dp and minDist evenly, param1 and param2 evenly in their logarithm."""


@dataclass(frozen=True)
class Sample:
    """A patch with a marker in it, the true circle and the one tracking would expect (image pixels)."""

    patch: Patch
    circle: Circle
    expected: Circle


@dataclass(frozen=True)
class Tuned:
    """The outcome: `tried` holds every (parameters, mean error of eq 2.19), in the order in which they were
    tried.
    """

    best: HoughConfig
    error: float
    thesis_error: float
    tried: tuple[tuple[dict[str, float], float], ...]
    samples: int
    grid_size: int


def hough_samples(frames: Iterable[Frame], truth: Sequence[TruthRow], most: int = 240, seed: int = 0) -> list[Sample]:
    """Patches around true circles of visible markers, at most `most`, evenly over the frames.

    The marker lies up to half a radius off the patch's centre and the expected radius is up to 5 % off, as
    after tracking, so that neither gives the answer away.
    """
    rng = np.random.default_rng(seed)
    wanted = [row for row in truth if row.circle is not None and row.visible > 0.99]
    wanted = wanted[:: max(1, -(-len(wanted) // most))]
    by_frame: dict[int, list[TruthRow]] = {}
    for row in wanted:
        by_frame.setdefault(row.frame_index, []).append(row)
    samples = []
    for frame in frames:
        for row in by_frame.get(frame.index, ()):
            circle = row.circle
            assert circle is not None
            dx, dy = rng.uniform(-0.25, 0.25, 2) * circle.r_px
            size = circle.r_px * float(rng.uniform(0.95, 1.05))
            expected = Circle(circle.x_px + float(dx), circle.y_px + float(dy), size)
            samples.append(Sample(Patch(frame, Window.around(expected, 2.2 * circle.r_px)), circle, expected))
    return samples


def hough_error(samples: Sequence[Sample], config: HoughConfig) -> float:
    """Mean of eq 2.19, 1 - Dice, of the circle with most votes; 1 where none is found."""
    return sum(_errors(samples, config)) / len(samples)


def _errors(samples: Sequence[Sample], config: HoughConfig) -> list[float]:
    errors = []
    for sample in samples:
        found = hough_circles(sample.patch, sample.expected, config)
        errors.append(1 - (found[0].dice(sample.circle) if found else 0.0))
    return errors


def tune(
    samples: Sequence[Sample],
    draws: int = 200,
    grid: bool = True,
    seed: int = 0,
    base: HoughConfig | None = None,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> Tuned:
    """Try a grid and then `draws` random points: half anywhere, half around the best so far.

    Raises UsageError when there are no samples.
    """
    if not samples:
        raise UsageError("there is no frame with a visible marker and a true circle to tune on")
    rng = np.random.default_rng(seed)
    base = base or ChainConfig().hough
    points = [THESIS]
    if grid:
        meshes = np.meshgrid(*GRID.values(), indexing="ij")
        points += [
            dict(zip(GRID, map(float, point), strict=True)) for point in zip(*map(np.ravel, meshes), strict=True)
        ]
    tried: list[tuple[dict[str, float], float]] = []
    total = len(points) + draws
    cores = os.cpu_count() or 1
    size = -(-len(samples) // cores)
    parts = [samples[k : k + size] for k in range(0, len(samples), size)]
    with ThreadPoolExecutor(cores) as threads:  # the transform lets them run side by side

        def attempt(point: dict[str, float]) -> None:
            found = threads.map(_errors, parts, repeat(base.model_copy(update=point)))
            tried.append((point, sum(error for part in found for error in part) / len(samples)))
            tell(len(tried), total)

        for point in points:
            attempt(point)
        for k in range(draws):
            attempt(_draw(rng) if k < draws // 2 else _near(min(tried, key=lambda t: t[1])[0], rng))
    point, error = min(tried, key=lambda t: t[1])
    return Tuned(base.model_copy(update=point), error, tried[0][1], tuple(tried), len(samples), len(points))


def _draw(rng: np.random.Generator) -> dict[str, float]:
    low_high = {name: (np.log(a), np.log(b)) if name.startswith("param") else (a, b) for name, (a, b) in RANGES.items()}
    drawn = {name: float(rng.uniform(a, b)) for name, (a, b) in low_high.items()}
    return {name: round(float(np.exp(v)) if name.startswith("param") else v, 3) for name, v in drawn.items()}


def _near(best: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    moved = {name: value * float(np.exp(rng.normal(0, 0.25))) for name, value in best.items()}
    return {name: round(min(max(moved[name], low), high), 3) for name, (low, high) in RANGES.items()}


def tune_hough(
    video: Path,
    truth: Path,
    output: Path,
    settings: Path | None = None,
    *,
    draws: int = 200,
    grid: bool = True,
    overwrite: bool = False,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> Tuned:
    """Tune on a video and its truth CSV, and write settings that can be used: those of `settings`, else an
    empty file's, with the best [chain.hough]. Raises SpheremcapError.
    """
    inputs = [path for path in (video, truth, settings) if path is not None]
    checked_output(output, inputs, overwrite=overwrite)
    given = load_settings(settings) if settings is not None else None
    rows = read_truth(truth)
    with VideoSource(video, packets=False) as source:
        samples = hough_samples(source.frames(), rows)
    tuned = tune(samples, draws, grid, base=(given or Settings()).chain.hough, tell=tell)
    values = tuned.best.model_dump()
    if given is not None:
        chain = given.chain.model_copy(update={"hough": tuned.best})
        text = given.model_copy(update={"chain": chain}).to_toml()
    else:
        text = "[chain.hough]\n" + "".join(f"{name} = {values[name]!r}\n" for name in THESIS)
    note = (
        f"# Hough parameters tuned on {tuned.samples} patches of {video.name}: mean error\n"
        f"# {tuned.error:.5f} (eq 2.19), {tuned.thesis_error:.5f} with the thesis' (4, 1, 77, 1).\n"
    )
    with whole_file(output, inputs, overwrite=overwrite) as part:
        part.path.write_text(note + text, encoding="utf-8")
    return tuned


def _samples(trial: Trial, most: int) -> list[Sample]:
    return hough_samples(trial.frames(), trial.truth, most)


def hough(lab: Lab) -> Result:
    """Grid and Monte Carlo over the four parameters, on rendered frames of every scenario."""
    samples: list[Sample] = []
    tests: list[Sample] = []
    trials = lab.trials()
    most = 10 if lab.quick else max(4, 480 // len(trials))
    for found in lab.each(partial(_samples, most=most), trials):
        samples, tests = samples + found[::2], tests + found[1::2]
    lab.tell(f"hough: {len(samples)} samples")
    tuned = tune(samples, 10 if lab.quick else 300, grid=not lab.quick)
    thesis = tuned.best.model_copy(update=THESIS)
    cells = [["", "dp", "minDist", "param1", "param2", "error, tuned on", "error, other frames"]]
    best_of_grid = min(tuned.tried[: tuned.grid_size], key=lambda t: t[1])
    for name, point in (
        ("thesis (eq 2.20)", THESIS),
        ("best of the grid", best_of_grid[0]),
        ("best of all", {key: getattr(tuned.best, key) for key in THESIS}),
    ):
        config = thesis.model_copy(update=point)
        errors = [f"{hough_error(some, config):.5f}" if some else "-" for some in (samples, tests)]
        cells.append([name, *(f"{point[key]:g}" for key in THESIS), *errors])

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, 4, sharey=True)
        for ax, key in zip(axes, THESIS, strict=True):
            ax.plot([point[key] for point, _ in tuned.tried], [e for _, e in tuned.tried], ".", markersize=3)
            ax.axhline(tuned.thesis_error, color="tab:red", linewidth=0.8)
            ax.set_xlabel(key)
        axes[0].set_ylabel("mean error (eq 2.19)")

    return Result(
        "hough",
        "Optimising the circle Hough transform",
        f"Mean of 1 - Dice (eq 2.19) of the circle with most votes on {tuned.samples} rendered patches, "
        "and on as many others that took no part. The thesis reports 0.10648 for its own on its 240 images. "
        "The red line is the thesis' parameters here.",
        "spheremcap experiment hough",
        (Table("Parameters", cells),),
        (Plot("hough", f"All {len(tuned.tried)} points tried", draw),),
    )
