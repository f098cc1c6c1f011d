"""A film with all that a person is needed for: a marker that is taken for another, and one that is lost.

The orange wrist goes behind a screen on frame 40. On frame 50 another orange ball comes where the wrist would be by
then, and is taken for it; the wrist itself comes out further down on frame 70. The blue elbow is hidden from frame 90
to 109.
"""

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from scenes import BLUE, ORANGE, Cover, ball_at, picture, truth
from spheremcap import api
from spheremcap.config import MarkerSettings, Settings
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Seed
from spheremcap.io.encode import write_video

COUNT = 130
SETTINGS = Settings(markers=(MarkerSettings(name="wrist"), MarkerSettings(name="elbow")))


def wrist(index: int) -> Circle:
    """Where the orange ball is, hidden or not; after the screen it is another 80 pixels further down."""
    return Circle(60.0 + 0.7 * index, 70.0 + (80 if index >= 70 else 0), 16.0)


def elbow(index: int) -> Circle:
    return Circle(250.0 - 0.3 * index, 170.0, 14.0)


def image(index: int):
    balls, covers = [], []
    if not 40 <= index < 70:
        balls.append(ball_at(*wrist(index), rgb=ORANGE))
    if index >= 50:
        balls.append(ball_at(60.0 + 0.7 * index, 70.0, 16.0, rgb=ORANGE))
    if not 90 <= index < 110:
        balls.append(ball_at(*elbow(index), rgb=BLUE))
    if 40 <= index < 50:
        x, y, r = (round(v) for v in wrist(index))
        covers.append(Cover(x - 2 * r, y - 2 * r, x + 2 * r, y + 2 * r))
    return picture(*balls, covers=covers, noise_seed=index)


def write_film(path: Path, count: int = COUNT) -> Path:
    write_video(path, (image(index) for index in range(count)), Fraction(240), creation_time="2025-06-01T10:00:00Z")
    return path


def seeds() -> list[Seed]:
    """What a person would give on the first frame."""
    return [
        Seed(name, 0, Circle(*(round(v, 2) for v in truth(ball_at(*place(0))))))
        for name, place in (("wrist", wrist), ("elbow", elbow))
    ]


def track_film(film: Path, output: Path) -> Path:
    api.track(film, output, SETTINGS, seeds())
    return output


def write_chair(path: Path) -> tuple[Path, list[tuple[str, tuple[float, float]]]]:
    """A racing chair's wheels as a camera over the front hub sees them, and where to click; one click is wrong."""
    camera = Camera(1280, 720, 900, 900, 639.5, 359.5)
    picture = np.full((1440, 2560, 3), (96, 104, 112), np.uint8)
    cv2.rectangle(picture, (0, 0), (2560, 420), (196, 190, 180), -1)
    clicks: list[tuple[str, tuple[float, float]]] = []

    def seen(side: int, r_m: float, turn: np.ndarray, out_m: float = 0.0) -> np.ndarray:
        """Points of a circle about a hub, in a plane that leans by 12 degrees; x right, y down, z forward."""
        lean = np.radians(12)
        up, forward, off = r_m * np.cos(turn), r_m * np.sin(turn), out_m + 0 * turn
        hub = np.array([0.3 * side, 0.1, 0.85])
        x, y = side * (off * np.cos(lean) - up * np.sin(lean)), -up * np.cos(lean) - off * np.sin(lean)
        return camera.project(hub + np.stack([x, y, -forward], axis=1))

    def line(points: np.ndarray, colour: tuple[int, int, int], width: int, closed: bool = True) -> None:
        fine = np.round((points + 0.5) * 2 * 16).astype(np.int32)
        cv2.polylines(picture, [fine], closed, colour, width, cv2.LINE_AA, shift=4)

    around = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    for side, name in ((1, "left"), (-1, "right")):  # the camera looks back
        line(seen(side, 0.32, around), (32, 32, 34), 26)
        for turn in np.linspace(0, 2 * np.pi, 18, endpoint=False):
            line(np.concatenate([seen(side, r, np.array([turn])) for r in (0.02, 0.31)]), (140, 140, 140), 2, False)
        line(seen(side, 0.185, around, 0.04), (24, 24, 24), 12)
        line(seen(side, 0.185, around, 0.04), (70, 70, 72), 5)
        [hub] = seen(side, 0.0, np.zeros(1))
        cv2.circle(picture, tuple(int(v) for v in np.round(hub * 2)), 16, (60, 60, 64), -1, cv2.LINE_AA)
        clicks.append((f"{name}_axle", tuple(hub)))
        rim = seen(side, 0.185, np.linspace(0.2, 5.9, 9), 0.04)
        rim[3] += (9, 6) if side > 0 else (0, 0)
        clicks += [(f"{name}_rim", tuple(place)) for place in rim]
    small = cv2.resize(cv2.GaussianBlur(picture, (0, 0), 1.2), (1280, 720), interpolation=cv2.INTER_AREA)
    write_video(path, [small] * 24, Fraction(240), creation_time="2025-06-01T10:00:00Z")
    return path, clicks
