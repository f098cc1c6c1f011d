"""The clicks on the chair's wheels: the file that keeps them, and the ellipse that a rim's points lie on."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremcap.core.camera import Camera
from spheremcap.core.chair import RIM_POINTS, ChairClick, check_clicks
from spheremcap.errors import SettingsError, UsageError
from spheremcap.io.chair_file import chair_toml, load_chair
from spheremcap.io.output import write_durably
from spheremcap.operator.answers import alone, state_of

_OUTLINE_POINTS = 720  # of a rim 800 pixels across, no point of the outline is 0.01 px off the ellipse
_DOUBTED_FROM_PX = 1.0
_Points = NDArray[np.float64]


class ChairFile:
    """The clicks in a file, on pictures of one size. Several pages, threads and programs may change it; each change is
    on disk, whole, when `change` returns.

    Raises SettingsError for a file that is damaged or of pictures of another size, OutputError for one that cannot be
    written.
    """

    def __init__(self, path: Path, width_px: int, height_px: int) -> None:
        self.path = path
        self.revision = 0
        """Grows with every change that is seen."""
        self._size = width_px, height_px
        self._changing = threading.Lock()
        self._seen: tuple[int, int, int] | None = None
        self._clicks: tuple[ChairClick, ...] = ()
        with self._changing:
            self._read()

    def clicks(self) -> tuple[ChairClick, ...]:
        """All of them, in the order in which they were given; read anew where another program has changed the file."""
        with self._changing:
            self._read()
            return self._clicks

    def change(self, was: ChairClick | None, now: ChairClick | None) -> None:
        """Put one click in the place of another: None is none, so that one is added or taken out. Raises UsageError
        for what cannot be, and then nothing has changed."""
        with self._changing, alone(self.path.parent):
            self._read()
            if was is not None and was not in self._clicks:
                raise UsageError(f"the click on {was.on} at {was.x_px:g}, {was.y_px:g} is not there any more")
            changed = [now if click == was else click for click in self._clicks]
            new = [click for click in changed if click is not None]
            if now is not None and now not in new:
                new.append(now)
            check_clicks(new, *self._size)
            write_durably(self.path, chair_toml(new, *self._size))
            self._read()

    def _read(self) -> None:
        state = state_of(self.path)
        if state == self._seen:
            return
        clicks, size = ((), self._size) if state is None else load_chair(self.path)
        if size != self._size:
            raise SettingsError(
                f"{self.path}: its clicks are on pictures of {size[0]}x{size[1]}, these are of "
                f"{self._size[0]}x{self._size[1]}: move it away, and click on these"
            )
        self._seen, self._clicks = state, clicks
        self.revision += 1


@dataclass(frozen=True)
class RimFit:
    """The ellipse through the points of a rim, as the lens shows it.

    `outline` (N, 2) is the ellipse in the picture; `off_px` is how far each point is off it, `rms_px` their root mean
    square: both 0 for five points, through which an ellipse always goes. Where leaving out one point more than halves
    an rms of above a pixel, `doubted` is its number from 0, and `rms_without_px` is the rms of the others' own ellipse.
    """

    outline: _Points
    off_px: tuple[float, ...]
    rms_px: float
    doubted: int | None = None
    rms_without_px: float | None = None


def fit_rim(clicks: Sequence[ChairClick], camera: Camera) -> RimFit | None:
    """The fit of one rim's clicks through the camera's lens. None for fewer than five, and where they give no ellipse.

    A circle is an ellipse in the picture only where the lens does not bend: the points are fitted as a camera without
    distortion would show them. The least squares spread one wrong point over all of them, so that the worst is often
    another: a wrong one is found by leaving out each in turn, which needs seven.
    """
    points = np.array([(click.x_px, click.y_px) for click in clicks], np.float64).reshape(-1, 2)
    whole = _fitted(points, camera)
    if whole is None or len(points) < RIM_POINTS + 2 or whole.rms_px <= _DOUBTED_FROM_PX:
        return whole
    without = [_fitted(np.delete(points, k, axis=0), camera) for k in range(len(points))]
    rms_px = [np.inf if fit is None else fit.rms_px for fit in without]
    best = int(np.argmin(rms_px))
    if rms_px[best] > whole.rms_px / 2:
        return whole
    return RimFit(whole.outline, whole.off_px, whole.rms_px, best, float(rms_px[best]))


def _fitted(points_px: _Points, camera: Camera) -> RimFit | None:
    if len(points_px) < RIM_POINTS:
        return None
    focal, centre = (camera.fx_px, camera.fy_px), (camera.cx_px, camera.cy_px)
    straight = camera.normalise(points_px) * focal + centre
    if not np.isfinite(straight).all():
        return None
    (x, y), (width, height), angle_deg = cv2.fitEllipse(straight.astype(np.float32))
    if not (np.isfinite([x, y, angle_deg]).all() and 1 <= width <= 1e5 and 1 <= height <= 1e5):
        return None
    turn, angle = np.linspace(0, 2 * np.pi, _OUTLINE_POINTS, endpoint=False), np.radians(angle_deg)
    along, across = width / 2 * np.cos(turn), height / 2 * np.sin(turn)
    ellipse = np.stack(
        [x + along * np.cos(angle) - across * np.sin(angle), y + along * np.sin(angle) + across * np.cos(angle)], axis=1
    )
    seen = camera.project(np.column_stack([(ellipse - centre) / focal, np.ones(_OUTLINE_POINTS)]))
    outline = seen[np.isfinite(seen).all(axis=1)]
    if len(outline) < _OUTLINE_POINTS / 2:
        return None
    polygon = outline.astype(np.float32)
    off = [abs(cv2.pointPolygonTest(polygon, (float(u), float(v)), True)) for u, v in points_px]
    return RimFit(outline, tuple(off), float(np.sqrt(np.mean(np.square(off)))))
