"""What single stages do over time: GeometryScale, the Kalman filter and smoother, the six votes."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.estimate import MarkerEstimate, SmoothedPose, Status
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.protocol import Film, Trial, chain_methods, run_alone, score_run
from spheremcap.evaluation.result import Plot, Result, Table

FloatArray = npt.NDArray[np.float64]


def scale(lab: Lab) -> Result:
    """With and without GeometryScale where the size changes most (figure 2.5), at the full and at an eighth of the
    frame rate, where a filter on its own knows less.
    """
    whole = lab.trial("scale")
    base = whole.settings.chain.model_copy(update={"when_sure": "run"})  # KCF's proposal on every frame
    without = base.model_copy(update={"points": base.points.model_copy(update={"enabled": False})})
    truth = {row.frame_index: row.circle.r_px for row in whole.truth if row.circle is not None}
    proposed: dict[str, tuple[FloatArray, FloatArray]] = {}
    cells = [["", "radius proposed: sd of error %", "worst %", "measured: accuracy %", "radius bias %", "missed %"]]
    film = Film(whole)
    for name, config, every in (
        ("with GeometryScale", base, 1),
        ("without", without, 1),
        ("with, every 8th frame", base, 8),
        ("without, every 8th frame", without, 8),
    ):
        trial = replace(whole, truth=tuple(row for row in whole.truth if row.frame_index % every == 0))
        run = run_alone(trial, config, (frame for frame in film if frame.index % every == 0))
        radius = {e.frame_index: r for e in run.estimates if (r := _proposed_radius(e)) is not None}
        frames = np.array(sorted(set(radius) & set(truth)))
        values = np.array([radius[f] for f in frames])
        off = 100 * (values / np.array([truth[f] for f in frames]) - 1)
        proposed[name] = frames, values
        one = score_run(trial, run).overall
        cells.append(
            [
                name,
                f"{off.std():.3f}" if len(off) else "-",
                f"{np.abs(off).max():.2f}" if len(off) else "-",
                *("-" if v is None else f"{v:.3f}" for v in (one.accuracy_pct, one.radius_bias_pct, one.missed_pct)),
            ]
        )

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, 2)
        axes[0].plot(list(truth), list(truth.values()), color="black", label="truth")
        for name, (frames, values) in proposed.items():
            axes[0].plot(frames, values, ".", markersize=3, label=name)
            axes[1].plot(frames, [100 * (v / truth[f] - 1) for f, v in zip(frames, values, strict=True)], label=name)
        axes[0].set_ylabel("radius proposed before detection, px")
        axes[1].set_ylabel("its error, %")
        for ax in axes:
            ax.set_xlabel("frame")
            ax.legend(fontsize=8)

    return Result(
        "scale",
        "With and without GeometryScale",
        "From 0.4 m to 2.5 m and back. The radius with which KCF's patch goes into detection (the Kalman filter's, "
        "with GeometryScale weighted with the last verified one times the change of size that the points show), "
        "and what is measured in the end.",
        "spheremcap experiment scale",
        (Table("Radius", cells),),
        (Plot("scale", "The radius that tracking hands to detection (figure 2.5)", draw),),
    )


def _proposed_radius(estimate: MarkerEstimate) -> float | None:
    return next((circle.r_px for name, circle in estimate.proposals if name == "kcf"), None)


def kalman(lab: Lab) -> Result:
    """Measured, filtered and smoothed positions and velocities against the truth (figures 3.8, 3.9)."""
    cells = [["", "frames", "measured mm", "filtered mm", "smoothed mm", "filtered m/s", "smoothed m/s"]]
    shown: dict[str, tuple[FloatArray, FloatArray]] = {}
    trials = lab.trials(("clean", "blur", "racing", "low-light", "static", "vfr"))
    for trial, found in zip(trials, lab.each(_tracks, trials), strict=True):
        lab.tell(f"kalman: {trial.name}")
        for marker, tracks in found.items():
            cells.append([f"{trial.name}: {marker}", str(len(tracks["measured"][0]))])
            for name in ("measured", "filtered", "smoothed"):
                cells[-1].append(f"{1000 * _rms(tracks[name][1]):.3f}" if len(tracks[name][0]) else "-")
            for name in ("filtered", "smoothed"):
                cells[-1].append(f"{_rms(tracks[name][2]):.3f}" if len(tracks[name][0]) else "-")
            shown = shown or {name: (frames, error) for name, (frames, error, _) in tracks.items()}

    def draw(figure: Any) -> None:
        axes = figure.subplots(3, 1, sharex=True)
        for axis, ax in enumerate(axes):
            for name, (frames, error) in shown.items():
                ax.plot(frames, 1000 * error[:, axis], ".-", markersize=2, linewidth=0.7, label=name)
            ax.set_ylabel(f"{'xyz'[axis]} error, mm")
        axes[2].set_xlabel("frame")
        axes[0].legend(fontsize=8, ncols=3)

    return Result(
        "kalman",
        "Kalman filter and smoother, before and after",
        "RMS of the 3D error's length over frames that were measured, and of the velocity's. Filtered is "
        "the state after the frame's own update; smoothed also knows the frames after it.",
        "spheremcap experiment kalman",
        (Table("RMS errors", cells),),
        (Plot("kalman", "Errors of the first session, by axis", draw, (9, 6)),),
    )


Errors = dict[str, tuple[FloatArray, FloatArray, FloatArray]]
"""By kind: frames (N,), position errors (N, 3) in m and velocity errors (N, 3) in m/s (NaN: none measured)."""


def _tracks(trial: Trial) -> dict[str, Errors]:
    """The errors of every marker of a trial."""
    film = Film(trial)
    poses = [pose for result in run_alone(trial, frames=film).results for pose in result.smoothed]
    return {
        name: _errors(trial, film, name, {pose.frame_index: pose for pose in poses if pose.marker == name})
        for name in trial.markers
    }


def _errors(trial: Trial, film: Film, marker: str, smoothed: Mapping[int, SmoothedPose]) -> Errors:
    truth = {row.frame_index: row for row in trial.truth if row.marker == marker}
    chain = chain_methods(trial)[marker]
    seed = next(s for s in trial.seeds if s.marker == marker)
    rows: dict[str, list[tuple[int, FloatArray, FloatArray]]] = {
        "measured": [],
        "filtered": [],
        "smoothed": [],
    }
    nothing = np.full(3, np.nan)
    for frame in film:
        if frame.index < seed.frame_index:
            continue
        if frame.index == seed.frame_index:
            chain.seed(frame, seed.circle)
            continue
        estimate, row = chain.step(frame), truth.get(frame.index)
        moment = getattr(chain, "moment", None)
        if estimate.status is not Status.VERIFIED or row is None or row.xyz_cam_m is None or moment is None:
            continue
        assert estimate.xyz_cam_m is not None
        speed = nothing if row.velocity_cam_mps is None else row.velocity_cam_mps
        rows["measured"].append((frame.index, estimate.xyz_cam_m - row.xyz_cam_m, nothing))
        filtered = moment.xyz_cam_m - row.xyz_cam_m, moment.velocity_cam_mps - speed
        rows["filtered"].append((frame.index, *filtered))
        pose = smoothed.get(frame.index)
        if pose is not None:
            rows["smoothed"].append((frame.index, pose.xyz_cam_m - row.xyz_cam_m, pose.velocity_cam_mps - speed))
    return {
        name: (
            np.array([r[0] for r in found]),
            np.array([r[1] for r in found]).reshape(-1, 3),
            np.array([r[2] for r in found]).reshape(-1, 3),
        )
        for name, found in rows.items()
    }


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.nanmean((errors**2).sum(axis=1))))


def votes(lab: Lab) -> Result:
    """The six votes and their sum over time where the marker is hidden again and again."""
    cells = [["", "visible: median sum", "5 % quantile", "hidden: median sum", "95 % quantile"]]
    plots = []
    trials = lab.trials(("total-occlusion", "partial-occlusion", "similar-colour", "blur"))
    for trial, rows in zip(trials, lab.each(_voted, trials), strict=True):
        lab.tell(f"votes: {trial.name}")
        marker = trial.markers[0]
        visible = {row.frame_index: row.visible for row in trial.truth if row.marker == marker}
        sums = np.array([e.vote_sum if e.vote_sum is not None else np.nan for e in rows])
        seen = np.array([visible.get(e.frame_index, np.nan) for e in rows])
        cells.append([trial.name])
        for chosen, quantiles in ((seen > 0.95, (0.5, 0.05)), (seen < 0.05, (0.5, 0.95))):
            for q in quantiles:
                cells[-1].append(f"{np.nanquantile(sums[chosen], q):.2f}" if chosen.any() else "-")
        limits = trial.settings.chain.jury
        plots.append(_vote_plot(trial.name, rows, visible, (limits.th1, limits.th2)))
    return Result(
        "votes",
        "The votes over time",
        "Each of the six matchers' overlaps with the claim, their sum, and the thresholds TH1 and TH2; "
        "green is how much of the marker is visible, times 6.",
        "spheremcap experiment votes",
        (Table("Sum of the votes by what there is to be seen", cells),),
        tuple(plots),
    )


def _voted(trial: Trial) -> list[MarkerEstimate]:
    """The estimates of a trial's first marker that have votes."""
    return [e for e in run_alone(trial).estimates if e.marker == trial.markers[0] and e.votes]


def _vote_plot(
    name: str, rows: list[MarkerEstimate], visible: dict[int, float], thresholds: tuple[float, float]
) -> Plot:
    def draw(figure: Any) -> None:
        axes = figure.subplots()
        axes.fill_between(list(visible), [6 * v for v in visible.values()], color="tab:green", alpha=0.15)
        frames = np.arange(max(e.frame_index for e in rows) + 1)
        curves = {name: np.full(len(frames), np.nan) for name in [vote.matcher for vote in rows[0].votes] + ["sum"]}
        for e in rows:  # frames that had nothing to vote on stay empty
            for vote in e.votes:
                curves[vote.matcher][e.frame_index] = vote.overlap
            curves["sum"][e.frame_index] = np.nan if e.vote_sum is None else e.vote_sum
        for name, curve in curves.items():
            whole = name == "sum"
            axes.plot(frames, curve, linewidth=1 if whole else 0.6, label=name, color="black" if whole else None)
        for threshold in thresholds:
            axes.axhline(threshold, color="tab:red", linestyle="--", linewidth=0.8)
        axes.set_ylim(0, 6.1)
        axes.set_xlabel("frame")
        axes.legend(fontsize=7, ncols=7, loc="upper center", bbox_to_anchor=(0.5, -0.15))

    return Plot(f"votes-{name}", f"Votes over time: {name}", draw)
