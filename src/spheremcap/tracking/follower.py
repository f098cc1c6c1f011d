"""Where to look and how large: KCF and GeometryScale on the marker's surroundings at its own scale."""

import math

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Patch
from spheremcap.core.look import Expected
from spheremcap.core.sampling import cut_bgr
from spheremcap.tracking.kcf import Kcf, KcfConfig
from spheremcap.tracking.points import PointsConfig, geometry_scale


class Follower:
    """One marker's trackers. `follow` only reads; they learn from verified circles."""

    def __init__(self, kcf: KcfConfig, points: PointsConfig) -> None:
        self._kcf, self._config, self._points = Kcf(kcf), kcf, points
        self._grid_px = kcf.grid_cells * kcf.cell_px
        self._before: tuple[Patch, Circle] | None = None  # the frame before this one, when it was verified
        self._learnt = 0

    def patch(self, frame: Frame, circle: Circle, reach_px: float = 0.0) -> Patch:
        """The surroundings of a circle (image pixels) at the marker's own scale, a pixel of KCF's grid to a pixel, as
        far as KCF and the votes look from `reach_px` away."""
        step_px = 2 * self._kcf.half_side_px(circle.r_px) / self._grid_px
        side = self._grid_px + 2 * math.ceil(max(0.0, reach_px - 0.5 * circle.r_px) / step_px)
        x0_px, y0_px = circle.x_px - (side - 1) / 2 * step_px, circle.y_px - (side - 1) / 2 * step_px
        bgr = cut_bgr(*frame.planes, x0_px, y0_px, step_px, side, side)
        return Patch.scaled(frame, bgr, x0_px, y0_px, step_px)

    def follow(self, patch: Patch, expected: Expected) -> Circle:
        """Where KCF sees the marker (image pixels), as large as the points on it say as far as the filter is less sure
        of the distance."""
        circle = expected.circle
        followed = self._kcf.locate(patch, circle, expected.reach_px).circle if self._config.enabled else circle
        r_px = circle.r_px
        if self._before is not None and self._points.enabled:
            scale = geometry_scale(*self._before, patch, followed, self._points)
            if scale is not None:
                ratio, ratio_sd = scale
                share = expected.range_sd**2 / (expected.range_sd**2 + ratio_sd**2)
                grown = min(max(self._before[1].r_px * ratio, 0.9 * r_px), 1.1 * r_px)
                r_px += share * (grown - r_px)
        return Circle(followed.x_px, followed.y_px, r_px)

    def learn(self, patch: Patch, circle: Circle) -> None:
        """Take a verified circle in (image pixels)."""
        self._before = (patch, circle)
        if self._learnt % self._config.train_every == 0:
            self._kcf.train(patch, circle)
        self._learnt += 1

    def miss(self) -> None:
        """This frame was not verified: the next one's points have nothing to start from."""
        self._before = None
