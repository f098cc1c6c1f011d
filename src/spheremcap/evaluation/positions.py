"""15 known positions held still: what each formula from circle to metres makes of the same pictures."""

from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.estimate import Status
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.protocol import run_alone
from spheremcap.evaluation.result import Plot, Result, Table
from spheremcap.positioning.sphere import thesis_position
from spheremcap.synth.scenarios import STATIC_M

FloatArray = npt.NDArray[np.float64]
_STILL_M = 0.004
"""A true position this near to one of the 15 belongs to it (the rest is on the way)."""


def positions(lab: Lab) -> Result:
    """Bias, spread and RMSE of distance and place at 15 static positions, by formula."""
    trial = lab.trial("static")
    run = run_alone(trial)
    found = {e.frame_index: e for e in run.estimates if e.status is Status.VERIFIED}
    settings = trial.settings.chain.position
    first = trial.camera()[0]
    radius_m = trial.specs()[0].radius_m
    groups: dict[int, list[tuple[FloatArray, dict[str, FloatArray]]]] = {}
    for row in trial.truth:
        estimate = found.get(row.frame_index)
        if row.xyz_cam_m is None or estimate is None or estimate.circle is None or estimate.xyz_cam_m is None:
            continue
        away = np.linalg.norm(np.array(STATIC_M) - row.xyz_cam_m, axis=1)
        if away.min() > _STILL_M:
            continue
        circle, constant = estimate.circle, settings.thesis_constant_px
        said = {
            "edge rays": estimate.xyz_cam_m,
            "fx R / r": thesis_position(circle, radius_m, first.fx_px, first),
            "thesis, l_o = radius": thesis_position(circle, radius_m, constant, first),
            "thesis, l_o = diameter": thesis_position(circle, 2 * radius_m, constant, first),
        }
        groups.setdefault(int(away.argmin()), []).append((row.xyz_cam_m, said))
    formulas = ["edge rays", "fx R / r", "thesis, l_o = radius", "thesis, l_o = diameter"]
    cells = [["position (x, y, z) m", "range m", "frames", *(f"{f}: range bias %" for f in formulas)]]
    cells[0] += ["edge rays: sd mm", "edge rays: RMSE mm"]
    everything: dict[str, list[tuple[float, float]]] = {f: [] for f in formulas}  # (range error, 3D error), %
    for index in sorted(groups):
        rows = groups[index]
        truth = np.array([true for true, _ in rows])
        distance = np.linalg.norm(truth, axis=1)
        line = [", ".join(f"{v:+.3f}" for v in truth.mean(axis=0)), f"{distance.mean():.3f}", str(len(rows))]
        for formula in formulas:
            xyz = np.array([said[formula] for _, said in rows])
            ranges = 100 * (np.linalg.norm(xyz, axis=1) - distance) / distance
            off = 100 * np.linalg.norm(xyz - truth, axis=1) / distance
            everything[formula] += list(zip(ranges.tolist(), off.tolist(), strict=True))
            line.append(f"{ranges.mean():+.3f}")
        xyz = np.array([said["edge rays"] for _, said in rows])
        error = np.linalg.norm(xyz, axis=1) - distance
        line += [
            f"{1000 * error.std():.2f}",
            f"{1000 * np.sqrt(((xyz - truth) ** 2).sum(axis=1).mean()):.2f}",
        ]
        cells.append(line)
    overall = [["formula", "range bias %", "range sd %", "range RMSE %", "3D RMSE % of range"]]
    for formula, pairs in everything.items():
        values = np.array(pairs) if pairs else np.full((1, 2), np.nan)
        overall.append(
            [
                formula,
                f"{values[:, 0].mean():+.3f}",
                f"{values[:, 0].std():.3f}",
                f"{np.sqrt((values[:, 0] ** 2).mean()):.3f}",
                f"{np.sqrt((values[:, 1] ** 2).mean()):.3f}",
            ]
        )

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for k, formula in enumerate(formulas[:3]):
            heights = [
                np.mean([_range_error_pct(said[formula], true) for true, said in groups[i]]) for i in sorted(groups)
            ]
            axes.bar(np.arange(len(heights)) + 0.27 * (k - 1), heights, 0.27, label=formula)
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set_xlabel("position")
        axes.set_ylabel("distance, bias %")
        axes.legend()

    return Result(
        "positions",
        "15 static known positions",
        "One camera, the marker held still at 15 places; the same measured circles through each formula. "
        "Ranges are distances from the camera's centre. Edge rays are exact; fx R / r takes the outline "
        "for a circle on the axis; the thesis' formula is that with its constant of 1211.27 px (eq 3.12).",
        "spheremcap experiment positions",
        (Table("By formula, all positions", overall), Table("By position", cells)),
        (Plot("positions", "Bias of the distance at each position", draw),),
    )


def _range_error_pct(xyz: FloatArray, true: FloatArray) -> float:
    distance = float(np.linalg.norm(true))
    return 100 * (float(np.linalg.norm(xyz)) - distance) / distance
