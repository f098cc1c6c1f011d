"""A rendered film with two total occlusions, an exit and a wrong click, and what a person answers to it."""

from fractions import Fraction
from functools import cache

import numpy as np

from scenes import BLUE, CAMERA, GREEN, ORANGE, Cover, ball_at, picture, truth
from spheremcap.config import CameraSettings, MarkerSettings, Settings
from spheremcap.core.marker import Hidden, Keep, Seed
from spheremcap.io.encode import write_video

COUNT, RATE_HZ = 180, 120
BEHIND = Cover(120, 20, 190, 130)
PASSING = Cover(25, 180, 95, 230)
"""Before the rival for a few frames."""


def wrist(i):
    """Goes behind a board and comes out on its other side, twice."""
    return ball_at(155 + 75 * float(np.cos(i / 24)), 80 + 8 * float(np.sin(i / 9)), 13, rgb=ORANGE)


def elbow(i):
    """Leaves the picture on the right and comes back."""
    return ball_at(230 + 120 * float(np.sin(i / 40)), 175, 15, rgb=GREEN)


def knee(i):
    return ball_at(60 + 20 * float(np.sin(i / 12)), 150, 12, rgb=BLUE)


def decoy(i):
    return ball_at(60, 30 + 8 * float(np.cos(i / 15)), 12, rgb=BLUE)


def rival(i):
    """What is taken for the wrist while that is hidden: it looks the same, and is the only one that does. It is hidden
    a little later itself, so that the wrist is lost once more, and asked for."""
    return ball_at(60 + 20 * float(np.sin(i / 12)), 205, 12, rgb=ORANGE)


BALLS = {"wrist": wrist, "elbow": elbow, "knee": knee, "decoy": decoy}
SETTINGS = Settings(
    camera=CameraSettings(
        width_px=CAMERA.width_px, height_px=CAMERA.height_px, fx_px=CAMERA.fx_px, fy_px=CAMERA.fy_px,
        cx_px=CAMERA.cx_px, cy_px=CAMERA.cy_px,
    ),
    markers=tuple(MarkerSettings(name=name) for name in ("wrist", "elbow", "knee")),
)  # fmt: skip


@cache
def image(i):
    covers = [BEHIND, PASSING] if 37 <= i < 43 else [BEHIND]
    return picture(wrist(i), elbow(i), knee(i), decoy(i), rival(i), covers=covers, noise_seed=i)


def covered(i):
    """Whether nothing of the wrist is to be seen."""
    c = truth(wrist(i))
    return BEHIND.left <= c.x_px - c.r_px and c.x_px + c.r_px <= BEHIND.right


def outside(i):
    c = truth(elbow(i))
    return c.x_px - c.r_px > CAMERA.width_px


def write_film(path, count=COUNT, **how):
    write_video(path, map(image, range(count)), Fraction(RATE_HZ), creation_time="2025-06-01T10:00:00Z", **how)
    return path


def seed(name, index, of=None, **who):
    return Seed(name, index, truth(BALLS[of or name](index)), **who)


ANNA = {"author": "anna", "time": "2026-11-30T03:31:00Z"}
FIRST = [seed("wrist", 0), seed("elbow", 0), seed("knee", 0, of="decoy")]


def spans(true):
    """The first and last frame of each run of frames of which this is so."""
    frames = [i for i in range(COUNT) if true(i)]
    starts = [i for i in frames if i - 1 not in frames]
    ends = [i for i in frames if i + 1 not in frames]
    return list(zip(starts, ends, strict=True))


def answers():
    """What a person says to it: where the wrist comes out again each time, that it is hidden behind the board, that the
    elbow's estimates when it left may stay, and which of the balls the knee is."""
    (first, out), (second, again) = spans(covered)[:2]
    (gone, _), *_ = spans(outside)
    return [
        *FIRST,
        seed("wrist", again + 12, **ANNA),
        seed("wrist", out + 10, **ANNA),
        Hidden("wrist", first, out, **ANNA),
        Hidden("wrist", second, again, **ANNA),
        Keep("elbow", gone - 3, gone + 3, **ANNA),
        seed("knee", 90, **ANNA),
    ]
