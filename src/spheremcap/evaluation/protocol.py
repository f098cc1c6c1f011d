"""How a method is run over a session: alone as in `spheremcap track`, or re-seeded at each failure as in the
thesis.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from spheremcap.api import aspect_of, resolve_camera
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.config import MarkerSettings, Settings, load_seeds, load_settings
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate
from spheremcap.core.frame import Frame
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.errors import SourceError
from spheremcap.evaluation.metrics import VISIBLE, Comparison, FailureWatch, TruthRow, compare, score
from spheremcap.evaluation.tracks import Scores, read_truth
from spheremcap.io.video import VideoSource
from spheremcap.session import Session

VOT_SKIP_FRAMES = 5
"""The VOT challenges seed again this many frames after a failure (Kristan et al. 2016)."""
VOT_BURN_IN_FRAMES = 10
"""And leave this many frames after each seed out of the accuracy."""
_CLIP_MARKER = "ball"
_VIDEOS = (".mp4", ".avi", ".mov", ".mkv")


class Method(Protocol):
    """Anything that follows one marker: seeded with a circle, then asked for every later frame in order."""

    def seed(self, frame: Frame, circle: Circle) -> MarkerEstimate: ...

    def step(self, frame: Frame) -> MarkerEstimate: ...


@dataclass(frozen=True)
class Trial:
    """A session to be followed: its video, what a person gave, and the truth."""

    name: str
    video: Path
    settings: Settings
    seeds: tuple[Seed, ...]
    truth: tuple[TruthRow, ...]

    @property
    def markers(self) -> list[str]:
        """The markers with a seed, in the settings' order."""
        seeded = {seed.marker for seed in self.seeds}
        return [m.name for m in self.settings.markers if m.name in seeded]

    def specs(self) -> list[MarkerSpec]:
        return [m.spec() for m in self.settings.markers if m.name in self.markers]

    def camera(self) -> tuple[Camera, bool]:
        """The camera for the video's pictures, and whether its metres count."""
        with VideoSource(self.video, packets=False) as source:
            aspect = aspect_of(source, [] if self.settings.camera.given else self.seeds)
            size_px = source.width_px, source.height_px
        camera, metric, _ = resolve_camera(self.settings.camera, *size_px, self.video.parent, None, *aspect)
        return camera, metric

    def frames(self) -> Iterator[Frame]:
        """The video's frames in order."""
        with VideoSource(self.video, packets=False) as source:
            yield from source.frames()


class Film:
    """A trial's frames, decoded once and then kept, to be gone through again and again.

    Every pass gets frames of its own, so what a method makes and keeps on one (a BGR picture) goes with it. Of a
    video with more than `most` frames (1.4 MB each at 1280x720) none are kept: it is decoded again for every pass.
    """

    def __init__(self, trial: Trial, most: int = 720) -> None:
        self._trial, self._most = trial, most
        self._kept: list[Frame] | None = None

    def __iter__(self) -> Iterator[Frame]:
        if self._kept is not None:
            yield from map(copy, self._kept)
            return
        kept: list[Frame] = []
        count = 0
        for count, frame in enumerate(self._trial.frames(), 1):
            if count <= self._most:
                kept.append(copy(frame))
            else:
                kept.clear()
            yield frame
        if count <= self._most:
            self._kept = kept


def load_trial(folder: Path) -> Trial:
    """A rendered session's folder: one video, settings.toml, seeds.toml and truth.csv. Raises SourceError."""
    videos = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in _VIDEOS]
    if len(videos) != 1:
        raise SourceError(f"{folder}: has {len(videos)} videos; expected one, settings.toml, seeds.toml and truth.csv")
    return Trial(
        folder.name,
        videos[0],
        load_settings(folder / "settings.toml"),
        tuple(seed for seed in load_seeds(folder / "seeds.toml") if isinstance(seed, Seed)),
        tuple(read_truth(folder / "truth.csv")),
    )


def load_clip(video: Path, truth: Path) -> Trial:
    """A real clip and its hand-made truth `frame,x,y,r[,err_px]`: one marker, seeded on its first row.

    No camera is given, so there are no metres.
    """
    rows = read_truth(truth, _CLIP_MARKER)
    given = sorted((r for r in rows if r.circle is not None), key=lambda r: r.frame_index)
    if not given or given[0].circle is None:
        raise SourceError(f"{truth}: has no row with a circle to start from")
    seed = Seed(_CLIP_MARKER, given[0].frame_index, given[0].circle)
    settings = Settings(markers=(MarkerSettings(name=_CLIP_MARKER, diameter_m=0.04),))
    return Trial(video.stem, video, settings, (seed,), tuple(rows))


def load_trials(folder: Path) -> list[Trial]:
    """The trials in a folder, by name: rendered sessions (folders with seeds.toml and truth.csv) and clips with
    a CSV beside.
    """
    if (folder / "seeds.toml").exists():
        return [load_trial(folder)]
    trials = [load_trial(path.parent) for path in folder.glob("*/seeds.toml") if (path.parent / "truth.csv").exists()]
    for truth in folder.glob("*.csv"):
        videos = [v for v in folder.glob(f"{truth.stem}.*") if v.suffix.lower() in _VIDEOS]
        trials += [load_clip(video, truth) for video in videos[:1]]
    return sorted(trials, key=lambda trial: trial.name)


def write_csv(path: Path, run: "Run") -> None:
    """The estimates of a run with the first columns of `spheremcap export`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("marker,frame,stamp_ns,status,x_px,y_px,r_px\n")
        for e in run.estimates:
            c = e.circle
            cells = ",,," if c is None else f",{c.x_px!r},{c.y_px!r},{c.r_px!r}"
            file.write(f"{e.marker},{e.frame_index},{e.stamp_ns},{e.status.value}{cells}\n")


@dataclass(frozen=True)
class Run:
    """What a method said of a session. `requests` counts them by marker, None where nobody did; `results` are
    the session's own where it was the chain, alone."""

    estimates: tuple[MarkerEstimate, ...]
    requests: Mapping[str, int] | None = None
    results: tuple[FrameResult, ...] = ()


def run_alone(trial: Trial, chain: ChainConfig | None = None, frames: Iterable[Frame] | None = None) -> Run:
    """The chain as `spheremcap track` runs it: seeds once, no operator. `frames` stand in for the video's."""
    camera, metric = trial.camera()
    session = Session(
        camera, trial.specs(), trial.seeds, chain or trial.settings.chain, trial.settings.session,
        exposure_s=trial.settings.camera.exposure_s, metric=metric, readout_s=trial.settings.camera.readout_s,
    )  # fmt: skip
    results = tuple(session.run(trial.frames() if frames is None else frames))
    requests = Counter(request.marker for result in results for request in result.requests)
    return Run(tuple(e for result in results for e in result.estimates), requests, results)


def run_reseeded(
    trial: Trial, methods: Mapping[str, Method], skip_frames: int = 1, frames: Iterable[Frame] | None = None
) -> Run:
    """Each method, by marker, seeded again with the true circle `skip_frames` after each failure.

    A failure is no overlap while visible (`FailureWatch`); the new seed waits until the marker is visible
    with its centre in the picture. In between there is no estimate. `skip_frames` 1 is the thesis' way, 5
    that of VOT.
    """
    truth = {(row.marker, row.frame_index): row for row in trial.truth}
    first = {seed.marker: seed for seed in reversed(trial.seeds)}
    watches = {name: FailureWatch() for name in methods}
    due = {name: first[name].frame_index for name in methods}
    running: set[str] = set()
    estimates: list[MarkerEstimate] = []
    for frame in trial.frames() if frames is None else frames:
        for name, method in methods.items():
            row = truth.get((name, frame.index))
            if name not in running:
                seed = first[name].circle if frame.index == first[name].frame_index else _circle(row, frame)
                if frame.index >= due[name] and seed is not None:
                    estimates.append(method.seed(frame, seed))
                    running.add(name)
                    watches[name] = FailureWatch()
                continue
            estimate = method.step(frame)
            estimates.append(estimate)
            if row is None:
                continue
            overlap = 0.0
            if row.circle is not None and estimate.circle is not None:
                overlap = estimate.circle.dice(row.circle)
            if watches[name].fails(frame.index, row.visible, overlap):
                running.remove(name)
                due[name] = frame.index + skip_frames
    return Run(tuple(estimates))


def _circle(row: TruthRow | None, frame: Frame) -> Circle | None:
    """The circle a person could give on this frame; None when the marker is not to be seen."""
    if row is None or row.circle is None or row.visible < VISIBLE:
        return None
    inside = 0 <= row.circle.x_px <= frame.width_px - 1 and 0 <= row.circle.y_px <= frame.height_px - 1
    return row.circle if inside else None


def chain_methods(trial: Trial, chain: ChainConfig | None = None) -> dict[str, Method]:
    """The chain of each marker of a trial, for `run_reseeded`."""
    camera, metric = trial.camera()
    config, known = chain or trial.settings.chain, trial.settings.camera
    return {
        spec.name: MarkerChain(spec, camera, config, known.exposure_s, metric, known.readout_s)
        for spec in trial.specs()
    }


def score_run(trial: Trial, run: Run, burn_in_frames: int = 0) -> Scores:
    """Scores of a run; `burn_in_frames` after each seed are left out."""
    comparisons = [compare(trial.truth, run.estimates, name) for name in trial.markers]
    if burn_in_frames:
        comparisons = [without_burn_in(c, burn_in_frames) for c in comparisons]

    asked = run.requests
    each = {c.marker: score([c], None if asked is None else asked.get(c.marker, 0)) for c in comparisons}
    overall = score(comparisons, None if asked is None else sum(asked.get(name, 0) for name in trial.markers))
    return Scores(each, overall, tuple(comparisons))


def without_burn_in(comparison: Comparison, frames: int) -> Comparison:
    """Only the rows that are more than `frames` after the last seed."""
    seeds = comparison.frame[comparison.seeded]
    since = np.searchsorted(seeds, comparison.frame, side="right") - 1
    last = np.where(since >= 0, seeds[since.clip(0)] if len(seeds) else 0, -(10**9))
    return comparison.take(comparison.frame - last > frames)
