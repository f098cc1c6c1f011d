"""Follow sessions with OpenCV's legacy trackers by the thesis' protocol, and write OUT/SESSION/TRACKER.csv.

Run by run.sh in an environment with opencv-contrib; of spheremcap it uses the source tree's video reader and
protocol, so every tracker sees the same frames, seeds and re-seeds as the chain. SESSIONS is a rendered
session, a folder of them, or a folder of clips with truth CSVs. Columns are those of `spheremcap export`;
OUT/times.csv has ms per frame.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.frame import Frame
from spheremcap.evaluation.protocol import VOT_SKIP_FRAMES, load_trials, run_reseeded, write_csv

TRACKERS: dict[str, Callable[[], Any]] = {
    "CSRT": cv2.legacy.TrackerCSRT_create,
    "KCF": cv2.legacy.TrackerKCF_create,
    "MedianFlow": cv2.legacy.TrackerMedianFlow_create,
    "Boosting": cv2.legacy.TrackerBoosting_create,
    "MIL": cv2.legacy.TrackerMIL_create,
    "MOSSE": cv2.legacy.TrackerMOSSE_create,
}


class Peer:
    """One of OpenCV's trackers on one marker; its box's inscribed circle is the marker's."""

    def __init__(self, marker: str, make: Callable[[], Any]) -> None:
        self.marker, self._make, self._tracker = marker, make, make()
        self.seconds, self.frames = 0.0, 0

    def seed(self, frame: Frame, circle: Circle) -> MarkerEstimate:
        self._tracker = self._make()
        side = 2 * circle.r_px
        # A box counts from a pixel's corner, a circle from its centre.
        self._tracker.init(
            frame.full, (circle.x_px - circle.r_px + 0.5, circle.y_px - circle.r_px + 0.5, side, side)
        )
        return MarkerEstimate(self.marker, frame.index, frame.stamp_ns, Status.SEEDED, circle=circle)

    def step(self, frame: Frame) -> MarkerEstimate:
        picture = frame.full
        start = time.perf_counter()
        try:
            found, (x, y, width, height) = self._tracker.update(picture)
        except cv2.error:  # some throw where the box leaves the picture
            found = False
        self.seconds, self.frames = self.seconds + time.perf_counter() - start, self.frames + 1
        if not found or min(width, height) <= 0:
            return MarkerEstimate(self.marker, frame.index, frame.stamp_ns, Status.LOST)
        circle = Circle(x + width / 2 - 0.5, y + height / 2 - 0.5, min(width, height) / 2)
        return MarkerEstimate(self.marker, frame.index, frame.stamp_ns, Status.VERIFIED, circle=circle)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sessions", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--trackers", nargs="+", default=list(TRACKERS), choices=list(TRACKERS))
    parser.add_argument("--only", nargs="+", help="names of the sessions to follow")
    parser.add_argument(
        "--vot", action="store_true", help="seed again 5 frames after a failure: OUT/SESSION/TRACKER-vot.csv"
    )
    parser.add_argument("--keep", action="store_true", help="leave out what OUT already has")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    for trial in load_trials(given.sessions):
        if given.only and trial.name not in given.only:
            continue
        for tracker in given.trackers:
            path = given.out / trial.name / f"{tracker}{'-vot' if given.vot else ''}.csv"
            if given.keep and path.exists():
                continue
            peers = {name: Peer(name, TRACKERS[tracker]) for name in trial.markers}
            run = run_reseeded(trial, peers, VOT_SKIP_FRAMES if given.vot else 1)
            write_csv(path, run)
            frames = sum(p.frames for p in peers.values())
            each_ms = 1000 * sum(p.seconds for p in peers.values()) / max(1, frames)
            with (given.out / "times.csv").open("a", encoding="utf-8") as times:
                times.write(f"{trial.name},{tracker},{frames},{each_ms:.3f}\n")
            print(f"{trial.name}: {tracker}, {frames} marker frames, {each_ms:.1f} ms each", flush=True)


if __name__ == "__main__":
    main()
