"""Real footage with hand-made truth, where there is any: `<clip>.mp4|avi` beside `<clip>.csv` (frame,x,y,r).

In the folder that SPHEREMCAP_CLIPS names, or in shared/real beside the checkout.
"""

import csv
import os
from itertools import pairwise
from pathlib import Path

import pytest

from spheremcap import api
from spheremcap.config import OutputSettings, Settings
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Hidden, Seed
from spheremcap.evaluation.tracks import evaluate
from spheremcap.io import recording
from spheremcap.session import HIDDEN

CLIPS = Path(os.environ.get("SPHEREMCAP_CLIPS", Path(__file__).parents[2] / "shared" / "real"))
NAMES = sorted(path.stem for path in CLIPS.glob("*.csv"))


@pytest.mark.skipif(not NAMES, reason=f"no clips in {CLIPS}")
@pytest.mark.parametrize("name", NAMES)
def test_a_real_clip_runs_through_and_reads_back(name, tmp_path):
    video = next(path for path in CLIPS.glob(f"{name}.*") if path.suffix in (".mp4", ".avi"))
    truth = CLIPS / f"{name}.csv"
    with truth.open(encoding="utf-8") as file:
        first = next(row for row in csv.DictReader(file) if row["x"])
    seed = Seed("ball", int(first["frame"]), Circle(float(first["x"]), float(first["y"]), float(first["r"])))
    settings = Settings(output=OutputSettings(debug_images="none"))
    report = api.track(video, tmp_path / "out.mcap", settings, [seed])
    track = recording.open(tmp_path / "out.mcap").tracks["ball"]
    assert len(track.stamp_ns) == report.frames - seed.frame_index
    assert (track.stamp_ns[1:] > track.stamp_ns[:-1]).all()
    scores = evaluate(tmp_path / "out.mcap", truth)
    # A hand-made circle is good to 1.5 to 3 px; what is measured must not be somewhere else.
    error = scores.overall.centre_median_px
    assert error is None or error < 8


@pytest.mark.skipif(not NAMES, reason=f"no clips in {CLIPS}")
@pytest.mark.parametrize("name", NAMES)
def test_answers_to_a_real_clip_are_the_same_at_once_and_afterwards(name, tmp_path):
    """A person gives a circle on a measured frame behind the longest gap and says that it is hidden before."""
    video = next(path for path in CLIPS.glob(f"{name}.*") if path.suffix in (".mp4", ".avi"))
    with (CLIPS / f"{name}.csv").open(encoding="utf-8") as file:
        first = next(row for row in csv.DictReader(file) if row["x"])
    seed = Seed("ball", int(first["frame"]), Circle(float(first["x"]), float(first["y"]), float(first["r"])))
    settings = Settings(output=OutputSettings(debug_images="none"))
    base, corrected, at_once = (tmp_path / f"{part}.mcap" for part in ("base", "corrected", "at_once"))
    api.track(video, base, settings, [seed])
    track = recording.open(base).tracks["ball"]
    measured = [int(frame) for frame, is_it in zip(track.frame, track.measured, strict=True) if is_it]
    gap, start = max((b - a, a) for a, b in pairwise([*measured, measured[-1] + 1]))
    k = next(i for i, frame in enumerate(track.frame) if frame == (start + gap if gap > 1 else measured[-1]))
    answer = Seed("ball", int(track.frame[k]), Circle(*track.circle_px[k].tolist()), "anna")
    hidden = [Hidden("ball", start + 1, start + gap - 1, "anna")] if gap > 2 else []
    report = api.retrack(base, corrected, [seed, answer, *hidden], source=video)
    api.track(video, at_once, settings, [seed, answer, *hidden])
    assert corrected.read_bytes() == at_once.read_bytes()
    after = recording.open(corrected).tracks["ball"]
    assert list(after.frame) == list(track.frame)
    assert after.status[k] == "SEEDED"
    assert report.frames < len(track)
    for i in range(len(track)):
        said = start < track.frame[i] < start + gap
        assert (after.reasons[i] == HIDDEN) == (said and bool(hidden))
