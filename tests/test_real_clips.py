"""Real footage with hand-made truth, where there is any: `<clip>.mp4|avi` beside `<clip>.csv` (frame,x,y,r).

In the folder that SPHEREMCAP_CLIPS names, or in shared/real beside the checkout.
"""

import csv
import os
from pathlib import Path

import pytest

from spheremcap import api
from spheremcap.config import OutputSettings, Settings
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Seed
from spheremcap.evaluation.tracks import evaluate
from spheremcap.io import recording

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
