"""A film with all that a person is needed for: a marker that is taken for another, and one that is lost.

The orange wrist goes behind a screen on frame 40. On frame 50 another orange ball comes where the wrist would be by
then, and is taken for it; the wrist itself comes out further down on frame 70. The blue elbow is hidden from frame 90
to 109.
"""

from fractions import Fraction
from pathlib import Path

from scenes import BLUE, ORANGE, Cover, ball_at, picture, truth
from spheremcap import api
from spheremcap.config import MarkerSettings, Settings
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
