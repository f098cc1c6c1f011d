"""Follow sessions with OpenCV's legacy trackers by the thesis' protocol, and write OUT/SESSION/TRACKER.csv.

Run by run.sh in an environment with opencv-contrib; of spheremcap it uses the source tree's video reader and
protocol, so every tracker sees the same frames, seeds and re-seeds as the chain. SESSIONS is a rendered
session, a folder of them, or a folder of clips with truth CSVs. Columns are those of `spheremcap export`;
OUT/times.csv has ms per frame.
"""

import argparse
import multiprocessing
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.frame import Frame
from spheremcap.evaluation.protocol import VOT_SKIP_FRAMES, Trial, load_trials, run_reseeded, write_csv

TRACKERS: dict[str, Callable[[], Any]] = {
    "CSRT": cv2.legacy.TrackerCSRT_create,
    "KCF": cv2.legacy.TrackerKCF_create,
    "MedianFlow": cv2.legacy.TrackerMedianFlow_create,
    "Boosting": cv2.legacy.TrackerBoosting_create,
    "MIL": cv2.legacy.TrackerMIL_create,
    "MOSSE": cv2.legacy.TrackerMOSSE_create,
}


BOX = {"CSRT": 1.5}
"""Sides of the box in diameters of the marker, where a tracker does better with some of its surroundings; else 1."""
BORDER_PX = 128
"""Pictures get this much of their border pixels around them, so that no tracker's box leaves the picture."""
WHOLE_PIXELS = ("Boosting",)
"""Trackers that read beyond their arrays, and crash, when seeded with a box that is not of whole pixels."""


class Peer:
    """One of OpenCV's trackers on one marker; its box's inscribed circle, over `BOX`, is the marker's.

    A box whose centre has left the picture is lost for good, until the next seed.
    """

    def __init__(self, marker: str, tracker: str) -> None:
        self.marker, self._make, self._whole = marker, TRACKERS[tracker], tracker in WHOLE_PIXELS
        self._box = BOX.get(tracker, 1.0)
        self._tracker, self._inside = self._make(), True
        self.seconds, self.frames = 0.0, 0

    def seed(self, frame: Frame, circle: Circle) -> MarkerEstimate:
        """Start again: the box is the circle's square."""
        self._tracker, self._inside = self._make(), True
        half = self._box * circle.r_px
        side = 2 * half
        # A box counts from a pixel's corner, a circle from its centre.
        x, y = circle.x_px - half + 0.5 + BORDER_PX, circle.y_px - half + 0.5 + BORDER_PX
        box = tuple(round(v) for v in (x, y, side, side)) if self._whole else (x, y, side, side)
        self._tracker.init(_bordered(frame), box)
        return MarkerEstimate(self.marker, frame.index, frame.stamp_ns, Status.SEEDED, circle=circle)

    def step(self, frame: Frame) -> MarkerEstimate:
        """Where the tracker says the marker is; LOST where it says that it does not know."""
        lost = MarkerEstimate(self.marker, frame.index, frame.stamp_ns, Status.LOST)
        if not self._inside:
            return lost
        picture = _bordered(frame)
        start = time.perf_counter()
        found, (x, y, width, height) = self._tracker.update(picture)
        self.seconds, self.frames = self.seconds + time.perf_counter() - start, self.frames + 1
        if not found or min(width, height) <= 0:
            return lost
        r_px = min(width, height) / 2 / self._box
        circle = Circle(x + width / 2 - 0.5 - BORDER_PX, y + height / 2 - 0.5 - BORDER_PX, r_px)
        self._inside = 0 <= circle.x_px < frame.width_px and 0 <= circle.y_px < frame.height_px
        return replace(lost, status=Status.VERIFIED, circle=circle)


def _bordered(frame: Frame) -> npt.NDArray[np.uint8]:
    b = BORDER_PX
    return cv2.copyMakeBorder(frame.full, b, b, b, b, cv2.BORDER_REPLICATE)


def follow(trial: Trial, tracker: str, path: Path, skip_frames: int, times: Path) -> None:
    """One tracker over one session, into its CSV and a line of times.csv."""
    cv2.setNumThreads(1)
    peers = {name: Peer(name, tracker) for name in trial.markers}
    write_csv(path, run_reseeded(trial, peers, skip_frames))
    frames = sum(p.frames for p in peers.values())
    each_ms = 1000 * sum(p.seconds for p in peers.values()) / max(1, frames)
    with times.open("a", encoding="utf-8") as file:
        file.write(f"{trial.name},{tracker},{frames},{each_ms:.3f}\n")
    print(f"{trial.name}: {tracker}, {frames} marker frames, {each_ms:.1f} ms each", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--trackers", nargs="+", default=list(TRACKERS), choices=list(TRACKERS))
    parser.add_argument("--only", nargs="+", help="names of the sessions to follow")
    parser.add_argument("--vot", action="store_true", help="seed 5 frames after a failure: TRACKER-vot.csv")
    parser.add_argument("--alone", action="store_true", help="never seed again: TRACKER-alone.csv")
    parser.add_argument("--keep", action="store_true", help="leave out what OUT already has")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for trial in load_trials(given.sessions):
        if given.only and trial.name not in given.only:
            continue
        for tracker in given.trackers:
            ending = "-vot" if given.vot else "-alone" if given.alone else ""
            path = given.out / trial.name / f"{tracker}{ending}.csv"
            if given.keep and path.exists():
                continue
            # In a process of its own: some of these trackers crash.
            skip_frames = VOT_SKIP_FRAMES if given.vot else 10**9 if given.alone else 1
            job = (trial, tracker, path, skip_frames, given.out / "times.csv")
            process = multiprocessing.get_context("fork").Process(target=follow, args=job)
            process.start()
            process.join()
            if process.exitcode and process.exitcode > 0:
                raise SystemExit(process.exitcode)
            if process.exitcode:
                print(f"{trial.name}: {tracker} crashed ({process.exitcode})", flush=True)


if __name__ == "__main__":
    main()
