"""Running methods over a session: who is seeded when, and what counts."""

import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from spheremcap.config import MarkerSettings, Settings
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.frame import BgrFrame, Frame
from spheremcap.core.marker import Seed
from spheremcap.errors import SourceError
from spheremcap.evaluation.blob import BlobTracker
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.metrics import TruthRow, compare
from spheremcap.evaluation.protocol import (
    Film,
    Run,
    Trial,
    load_clip,
    run_reseeded,
    score_run,
    without_burn_in,
    write_csv,
)
from spheremcap.evaluation.tracks import read_tracks

CIRCLE = Circle(60.0, 50.0, 12.0)


def frames(count: int, picture: np.ndarray | None = None) -> list[BgrFrame]:
    image = np.zeros((100, 140, 3), np.uint8) if picture is None else picture
    return [BgrFrame(k, k * 4_000_000, image) for k in range(count)]


def trial(visible: list[float], seed_frame: int = 0) -> Trial:
    rows = tuple(TruthRow("m", k, CIRCLE if v else None, None, v) for k, v in enumerate(visible))
    settings = Settings(markers=(MarkerSettings.model_validate({"name": "m"}),))
    return Trial("made", Path("none.mp4"), settings, (Seed("m", seed_frame, CIRCLE),), rows)


class Scripted:
    """Says what it is told to: V right, W wrong, L lost, by frame; counts its seeds."""

    def __init__(self, script: str) -> None:
        self.script, self.seeds = script, []

    def seed(self, frame: Frame, circle: Circle) -> MarkerEstimate:
        self.seeds.append(frame.index)
        return MarkerEstimate("m", frame.index, frame.stamp_ns, Status.SEEDED, circle=circle)

    def step(self, frame: Frame) -> MarkerEstimate:
        letter = self.script[frame.index]
        status = Status.LOST if letter == "L" else Status.VERIFIED
        circle = {"V": CIRCLE, "W": CIRCLE.shifted(60, 0)}.get(letter)
        return MarkerEstimate("m", frame.index, frame.stamp_ns, status, circle=circle)


def test_a_method_is_seeded_again_on_the_frame_after_each_failure() -> None:
    made, method = trial([1.0] * 8), Scripted("-VWVVLVV")
    run = run_reseeded(made, {"m": method}, frames=frames(8))
    assert method.seeds == [0, 3, 6]
    assert score_run(made, run).overall.failures == 2
    assert [e.frame_index for e in run.estimates] == list(range(8))


def test_vot_waits_five_frames_and_leaves_out_the_settling() -> None:
    made, method = trial([1.0] * 30), Scripted("-VW" + "V" * 27)
    run = run_reseeded(made, {"m": method}, 5, frames(30))
    assert method.seeds == [0, 7]
    scores = score_run(made, run)
    assert scores.overall.failures == 1
    settled = without_burn_in(scores.comparisons[0], 10)
    assert settled.frame.tolist() == list(range(18, 30))


def test_nobody_seeds_a_marker_that_is_not_to_be_seen() -> None:
    made, method = trial([1.0, 1.0, 1.0, 0.0, 0.0, 0.3, 0.8, 1.0]), Scripted("-VLLLLLV")
    run_reseeded(made, {"m": method}, frames=frames(8))
    assert method.seeds == [0, 6]


def test_a_marker_is_not_followed_before_its_first_seed() -> None:
    run = run_reseeded(trial([1.0] * 5, seed_frame=2), {"m": Scripted("--VVV")}, frames=frames(5))
    assert [e.frame_index for e in run.estimates] == [2, 3, 4]


def test_a_runs_csv_reads_back(tmp_path: Path) -> None:
    run = run_reseeded(trial([1.0] * 4), {"m": Scripted("-VLV")}, frames=frames(4))
    write_csv(tmp_path / "deep" / "tracker.csv", run)
    again, requests = read_tracks(tmp_path / "deep" / "tracker.csv")
    assert requests is None
    assert [(e.frame_index, e.status, e.circle) for e in again] == [
        (e.frame_index, e.status, e.circle) for e in run.estimates
    ]


def test_the_blob_tracker_finds_a_red_disc_whose_hue_wraps() -> None:
    rng = np.random.default_rng(0)
    picture = rng.integers(60, 120, (100, 140, 3), dtype=np.uint8)
    rows, columns = np.indices((100, 140))
    disc = np.hypot(columns - 60, rows - 50) <= 12
    picture[disc] = (20, 25, 200)
    picture[disc & (columns < 60)] = (35, 20, 200)  # the other side of hue 0
    made = trial([1.0] * 3)
    run = run_reseeded(made, {"m": BlobTracker("m")}, frames=frames(3, picture))
    compared = compare(made.truth, run.estimates, "m")
    assert compared.dice[1:].min() > 0.9


def test_a_blob_that_is_gone_is_lost() -> None:
    tracker = BlobTracker("m")
    first, empty = np.zeros((100, 140, 3), np.uint8), np.zeros((100, 140, 3), np.uint8)
    first[38:63, 48:73] = (20, 200, 20)
    tracker.seed(BgrFrame(0, 0, first), CIRCLE)
    assert tracker.step(BgrFrame(1, 1, empty)).status is Status.LOST


def test_a_clip_is_seeded_on_its_first_row_with_a_circle(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("frame,x,y,r\n9,,,\n12,3,4,5\n10,1,2,3\n")
    made = load_clip(tmp_path / "a.mp4", tmp_path / "a.csv")
    assert made.seeds == (Seed("ball", 10, Circle(1.0, 2.0, 3.0)),)
    (tmp_path / "b.csv").write_text("frame,x,y,r\n9,,,\n")
    with pytest.raises(SourceError, match="no row with a circle"):
        load_clip(tmp_path / "b.mp4", tmp_path / "b.csv")


def test_a_run_scores_requests_by_marker() -> None:
    made = trial([1.0] * 3)
    run = run_reseeded(made, {"m": Scripted("-VV")}, frames=frames(3))
    assert score_run(made, Run(run.estimates, {"m": 2})).overall.requests_per_min == pytest.approx(15000)


class Reel(Trial):
    """A trial that counts how often it is decoded."""

    passes: ClassVar[int] = 0

    def frames(self) -> Iterator[Frame]:
        Reel.passes += 1
        yield from frames(6)


def test_a_film_is_decoded_once_and_every_pass_has_its_own_frames() -> None:
    made = trial([1.0] * 6)
    reel = Reel(made.name, made.video, made.settings, made.seeds, made.truth)
    film = Film(reel)
    assert [frame.index for frame in film] == list(range(6))
    first, second = list(film), list(film)
    assert [frame.index for frame in first] == [frame.index for frame in second] == list(range(6))
    assert Reel.passes == 1
    assert "planes" not in vars(second[0])
    _ = first[0].planes
    assert "planes" not in vars(next(iter(film)))
    long = Film(reel, most=5)
    assert [len(list(long)), len(list(long))] == [6, 6]
    assert Reel.passes == 3
    left_early = Film(reel)
    assert [frame.index for frame in islice(left_early, 2)] == [0, 1]
    assert len(list(left_early)) == 6


def test_processes_answer_in_the_order_of_the_items() -> None:
    assert list(Lab.each(math.sqrt, [16.0, 9.0, 4.0])) == [4.0, 3.0, 2.0]
    assert list(Lab.each(math.sqrt, [16.0])) == [4.0]
    assert list(Lab.each(math.sqrt, [])) == []
    with pytest.raises(ValueError, match="domain"):
        list(Lab.each(math.sqrt, [1.0, -1.0]))
