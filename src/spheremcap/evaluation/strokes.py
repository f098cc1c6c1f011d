"""Contacts, releases, angles and lengths of rendered strokes against their truth, by the whole run a user makes."""

import csv
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap import api
from spheremcap.analysis.findings import Findings
from spheremcap.analysis.focal_job import calibrate_recording
from spheremcap.analysis.settings import load_analysis_settings
from spheremcap.core.stroke import StrokeEvent
from spheremcap.errors import SourceError
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.protocol import Trial, load_trial
from spheremcap.evaluation.result import Plot, Result, Table
from spheremcap.synth import stroke_names

FloatArray = npt.NDArray[np.float64]
_SAME_MS = 60.0
"""A found event this near to a true one of its kind and hand is of it; each true one has one at most."""
_KINDS = ("CONTACT", "RELEASE")
_ANGLES = ("elbow_deg", "forearm_elevation_deg", "upper_arm_elevation_deg")
_WAYS = ("wheel and mount told", "mount told", "wheel told, mount by pushes and tilt")
"""What the analysis is told: a wheel's log and where the camera is, one of them, and the other."""


@dataclass(frozen=True)
class _Scored:
    """A session's errors: events in ms and degrees with their standard deviations (E, 4) by kind, how many are missed
    and invented, angles' errors in degrees by name, lengths' in %, and the focal length's in % with its own deviation.
    """

    name: str
    events: dict[str, FloatArray]
    missed: int
    invented: int
    angles: dict[str, FloatArray]
    lengths_pct: tuple[float, ...]
    focal_pct: tuple[float, float] | None


def strokes(lab: Lab) -> Result:
    """Contact and release of rendered strokes in ms, angles in degrees, lengths and focal length in %, by scenario."""
    base = [name for name in stroke_names() if "@" not in name]
    names = [name for name in base if not lab.only or name in lab.only]
    slower = [] if lab.quick else [f"{name}@{rate}" for rate in (120, 60) for name in names]
    for name in (*names, *slower):
        lab.trial(name)  # rendered one after the other: each takes all cores
    score = partial(_scored, sessions=lab.sessions or lab.folder / "sessions", folder=lab.folder / "strokes")
    done = zip((*names, *slower), lab.each(score, (*names, *slower)), strict=True)
    by_work = {(name, way): one for name, ways in done for way, one in ways.items()}
    events = [_heading()]
    for way in _WAYS:
        of_way = [by_work[name, way] for name in names]
        for one in [*of_way, *([_all(of_way)] if len(of_way) > 1 else [])]:
            events += _event_rows(one, way)
    rates = [_heading()]
    for rate in (240, 120, 60):
        some = [
            by_work[name, _WAYS[0]]
            for name in (names if rate == 240 else [n for n in slower if n.endswith(f"@{rate}")])
        ]
        if some:
            rates += _event_rows(_all(some), f"{rate} frames/s")
    arms = [
        [
            "",
            *(f"{name.removesuffix('_deg').replace('_', ' ')} RMSE deg" for name in _ANGLES),
            "lengths %",
            "fx %",
            "± %",
        ]
    ]
    for name in names:
        one = by_work[name, _WAYS[0]]
        fx = ("refused", "") if one.focal_pct is None else (f"{one.focal_pct[0]:+.2f}", f"{one.focal_pct[1]:.2f}")
        arms.append(
            [
                name, *(f"{_rms(one.angles[angle]):.2f}" for angle in _ANGLES),
                " ".join(f"{value:+.2f}" for value in one.lengths_pct), *fx,
            ]
        )  # fmt: skip

    def draw(figure: Any) -> None:
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, kind in ((left, _KINDS[0]), (right, _KINDS[1])):
            for way in _WAYS:
                errors = np.sort(np.abs(_all([by_work[name, way] for name in names]).events[kind][:, 0]))
                axes.plot(errors, 100 * np.arange(1, len(errors) + 1) / max(1, len(errors)), label=way)
            for limit in (1000 / 240, 2000 / 240):
                axes.axvline(limit, color="0.7", linewidth=0.8)
            axes.set_xlim(0, 20)
            axes.set_title(kind.lower())
            axes.set_xlabel("error, ms (lines: one and two frames)")
        left.set_ylabel("share of events, %")
        left.legend(fontsize=7)

    return Result(
        "strokes",
        "Strokes of a racer: contact, release, angles, lengths, focal length",
        "Each session is rendered, tracked, merged with its wheel's log and analysed as a user does it; the truth is "
        "that of the rendered motion. z is the errors' root mean square over the standard deviations that were given. "
        "Four sessions are on rollers (strokes, -start, -missed, -low), the others on the road, where the camera "
        "shakes by 0.45 mrad at 17 to 59 Hz; in -low another marker hides a part of the wrist's at each event.",
        "spheremcap experiment strokes",
        (
            Table("Contact and release at 240 frames/s, by scenario and by what is told", events),
            Table("All scenarios by frame rate, wheel and mount told", rates),
            Table(
                "Arms, wheel and mount told; the focal length is that of a recording tracked with the true one", arms
            ),
        ),
        (Plot("strokes", "How many events are found to how many milliseconds", draw, (9.0, 3.6)),),
    )  # fmt: skip


def _heading() -> list[str]:
    return ["", "told", "event", "n", "missed", "invented", "bias ms", "median ms", "95 % ms", "z", "angle median deg",
            "angle RMSE deg", "angle z"]  # fmt: skip


def _event_rows(one: _Scored, way: str) -> list[list[str]]:
    rows = []
    for kind in _KINDS:
        found = one.events[kind]
        row = [one.name, way, kind.lower(), str(len(found))]
        row += [str(one.missed), str(one.invented)] if kind == _KINDS[0] else ["", ""]
        if len(found):
            ms, sd, deg, deg_sd = found.T
            told = np.isfinite(deg)
            row += [f"{ms.mean():+.2f}", f"{np.median(np.abs(ms)):.2f}", f"{np.percentile(np.abs(ms), 95):.2f}",
                    f"{_rms(ms / sd):.2f}"]  # fmt: skip
            row += (
                [
                    f"{np.median(np.abs(deg[told])):.2f}",
                    f"{_rms(deg[told]):.2f}",
                    f"{_rms(deg[told] / deg_sd[told]):.2f}",
                ]
                if told.any()
                else ["", "", ""]
            )
        rows.append(row + [""] * (13 - len(row)))
    return rows


def _rms(values: FloatArray) -> float:
    seen = values[np.isfinite(values)]
    return float(np.sqrt((seen**2).mean())) if len(seen) else float("nan")


def _all(some: list[_Scored]) -> _Scored:
    return _Scored(
        "all", {kind: np.concatenate([one.events[kind] for one in some]) for kind in _KINDS},
        sum(one.missed for one in some), sum(one.invented for one in some), {}, (), None,
    )  # fmt: skip


def _scored(name: str, *, sessions: Path, folder: Path) -> dict[str, _Scored]:
    """A session tracked, merged, analysed in each way and held against its truth; those at a slower rate in the first
    way only. A tracked session that is there already is not tracked again."""
    session, into = sessions / name, folder / name
    into.mkdir(parents=True, exist_ok=True)
    trial = load_trial(session)
    tracked, merged = into / "session.mcap", into / "dataset.mcap"
    if not merged.exists() or merged.stat().st_mtime < (session / "seeds.toml").stat().st_mtime:
        api.track(trial.video, tracked, trial.settings, trial.seeds, folder=session, overwrite=True)
        given = [api.Source(tracked, "session"), api.Source(session / "wheel.csv", "wheel")]
        api.merge(given, merged, overwrite=True)
    told = load_analysis_settings(session / "analysis.toml")
    pushes = told.model_copy(update={"chair": told.chair.model_copy(update={"camera_xyz_chair_m": None})})
    ways = {_WAYS[0]: (merged, told), _WAYS[1]: (tracked, told), _WAYS[2]: (merged, pushes)}
    truth = _truth(session / "events.csv")
    scored = {}
    for way, (recording, settings) in ways.items():
        if "@" in name and way != _WAYS[0]:
            continue
        found = api.analyse(recording, into / "analysed.mcap", settings, overwrite=True).findings
        events, missed, invented = _matched(found, truth)
        focal = _focal(merged, into) if way == _WAYS[0] and "@" not in name else None
        scored[way] = _Scored(name, events, missed, invented, *_arms(found, trial), focal)
    return scored


def _focal(recording: Path, into: Path) -> tuple[float, float] | None:
    """The error of the focal length and its standard deviation, %; None where it was refused."""
    try:
        focal = calibrate_recording(recording, into / "camera.yaml", overwrite=True).focal
    except SourceError:
        return None
    return 100 * (focal.factor - 1), 100 * focal.sd


def _truth(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def _matched(found: Findings, truth: list[dict[str, str]]) -> tuple[dict[str, FloatArray], int, int]:
    """Errors of time (ms) and angle (degrees) with their standard deviations, of events by kind; missed and invented
    ones, but for those within a tenth of a second of an end, where half of a path is not there."""
    ends = int(found.stamp_ns[0]) + 10**8, int(found.stamp_ns[-1]) - 10**8
    rows: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in _KINDS}
    missed, invented = 0, 0
    for side, hand in found.hands.items():
        for kind in _KINDS:
            free: list[StrokeEvent] = [event for event in hand.events if event.kind.value == kind]
            for true in (row for row in truth if row["side"] == side and row["kind"] == kind):
                at = int(true["stamp_ns"]) + int(found.stamp_ns[0])
                best = min(free, key=lambda event, at=at: abs(event.stamp_ns - at), default=None)  # type: ignore[misc]
                if best is None or abs(best.stamp_ns - at) > _SAME_MS * 1e6:
                    missed += ends[0] <= at <= ends[1]
                    continue
                free.remove(best)
                off = np.nan
                if best.angle_deg is not None:
                    off = (best.angle_deg - float(true["angle_deg"]) + 180) % 360 - 180
                rows[kind].append(((best.stamp_ns - at) / 1e6, best.sd_ms, off, best.angle_sd_deg or np.nan))
            invented += sum(ends[0] <= event.stamp_ns <= ends[1] for event in free)
    return {kind: np.array(some).reshape(-1, 4) for kind, some in rows.items()}, missed, invented


def _arms(found: Findings, trial: Trial) -> tuple[dict[str, FloatArray], tuple[float, ...]]:
    """Errors of angles in degrees by name, of both arms, and of the median lengths in %."""
    places = {(row.marker, row.frame_index): row.xyz_cam_m for row in trial.truth}
    frames = range(len(found.stamp_ns))
    errors: dict[str, list[FloatArray]] = {name: [] for name in _ANGLES}
    lengths = []
    for side, arm in found.arms.items():
        w, e, s = (
            np.array([places.get((f"{side}_{joint}", k), np.full(3, np.nan)) for k in frames], np.float64)
            for joint in ("wrist", "elbow", "shoulder")
        )
        if found.chair is not None:
            w, e, s = (found.chair.place(xyz) for xyz in (w, e, s))
        true = {"elbow_deg": _between(w - e, s - e), "forearm_elevation_deg": _above(e - w),
                "upper_arm_elevation_deg": _above(s - e)}  # fmt: skip
        for name in _ANGLES:
            if name in arm.values:
                errors[name].append(arm.values[name] - true[name])
        for name, ends in (("forearm_m", (w, e)), ("upper_arm_m", (e, s))):
            if name in arm.values:
                own = float(np.nanmedian(np.linalg.norm(ends[0] - ends[1], axis=1)))
                lengths.append(100 * (float(np.nanmedian(arm.values[name])) / own - 1))
    return {name: np.concatenate(some) if some else np.zeros(0) for name, some in errors.items()}, tuple(lengths)


def _between(a: FloatArray, b: FloatArray) -> FloatArray:
    cos = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    out: FloatArray = np.degrees(np.arccos(np.clip(cos, -1, 1)))
    return out


def _above(d: FloatArray) -> FloatArray:
    out: FloatArray = np.degrees(np.arctan2(d[:, 2], np.hypot(d[:, 0], d[:, 1])))
    return out
