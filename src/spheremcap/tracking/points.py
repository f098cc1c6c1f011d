"""GeometryScale: the marker's change of size from Lucas-Kanade points on it (thesis section 2.3.3, eq 2.18).

Pyramidal Lucas-Kanade after Bouguet, "Pyramidal Implementation of the Affine Lucas Kanade Feature Tracker", Intel
2001, checked forward and backward (Kalal et al. 2010).
"""

import math

import numpy as np
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.compiled import BGR, F8, array, inner, kernel
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig


class PointsConfig(StageConfig):
    """Limits keep a product of ratios from drifting; the chain re-anchors the radius on every accepted detection."""

    enabled: bool = Field(True, description="false leaves the size to the Kalman filter (figure 2.5a)")
    max_step: float = Field(0.1, gt=0, lt=1, description="largest relative change of radius a frame; ours")
    max_round_trip_px: float = Field(
        0.5, gt=0, description="forward-backward distance that keeps a point, patch pixels; ours"
    )
    min_points: int = Field(6, ge=3, description="fewer surviving points give no scale; ours")


_ANGLES = np.arange(16) * (2 * np.pi / 16)
_SPOKES = np.concatenate([share * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1) for share in (0.8, 0.97)])
"""Points inside the outline, in radii: a smooth ball has few features further in, where flow is drawn along."""
_SHARED, _LEAST_SD = 3.0, 0.002  # points that share an error, and what the ratio is never surer of
_MARGIN_PX = 12  # of the picture around the marker: room for the coarser level's window and for the way there
_HALF = 2  # the window reaches so many pixels to each side, at both levels
_WIDTH = 2 * _HALF + 1
_NEXT = np.uint32(1)
_STEPS, _STILL_PX = 10, 0.02  # most refinements a level, and one so small that it is the last
_LEAST_SLOPE = 0.1  # (grey levels a pixel)^2 in the direction that changes least, mean over the window


def geometry_scale(
    before: Patch, circle_before: Circle, now: Patch, circle_now: Circle, config: PointsConfig
) -> tuple[float, float] | None:
    """The ratio r_now / r_before of eq 2.18, clamped to 1 +- max_step, and its standard deviation by how much the
    points disagree; None when too few points survive.

    `circle_now` is only where to start looking (KCF's answer). Circles are in image pixels. The points are followed
    from pixel to pixel of the two patches as these are, so their steps should be alike to some 10 %.
    """
    was, start = before.local(circle_before), now.local(circle_now)
    zoom = now.step_px / before.step_px
    kept, ratio, scatter = _scale(
        before.bgr, was.x_px, was.y_px, was.r_px, now.bgr, start.x_px, start.y_px, was.r_px / zoom, _SPOKES,
        config.max_round_trip_px,
    )  # fmt: skip
    if kept < config.min_points:
        return None
    sd = max(_LEAST_SD, zoom * scatter * math.sqrt(_SHARED / kept))
    return min(max(zoom * ratio, 1 - config.max_step), 1 + config.max_step), sd


@inner
def _luma(bgr, left, top, side):
    """The luma (side, side) float32 of the patch from this pixel on; beyond the border the border pixel repeats."""
    rows, columns = bgr.shape[0], bgr.shape[1]
    out = np.empty((side, side), np.float32)
    for r in range(side):
        i = min(max(top + r, 0), rows - 1)
        for c in range(side):
            j = min(max(left + c, 0), columns - 1)
            out[r, c] = (
                np.float32(0.114) * bgr[i, j, 0] + np.float32(0.587) * bgr[i, j, 1] + np.float32(0.299) * bgr[i, j, 2]
            )
    return out


@inner
def _halved(fine):
    """The next level of the pyramid: its pixel (i, j) is that around (2i, 2j), smoothed by (1, 2, 1) / 4 both ways."""
    side = fine.shape[0]
    out = np.empty((side // 2, side // 2), np.float32)
    line = np.empty(side, np.float32)
    for i in range(side // 2):
        above, here, below = fine[max(2 * i - 1, 0)], fine[2 * i], fine[2 * i + 1]
        for c in range(side):
            line[c] = np.float32(0.25) * (above[c] + below[c]) + np.float32(0.5) * here[c]
        for j in range(side // 2):
            out[i, j] = np.float32(0.25) * (line[max(2 * j - 1, 0)] + line[2 * j + 1]) + np.float32(0.5) * line[2 * j]
    return out


@inner
def _place(image, x, y, reach):
    """Whole pixel and remainder (column, row, right share, lower share) of a place; column -1 if there are no `reach`
    pixels of the image around it to interpolate in."""
    side = image.shape[0]
    if not (reach <= x < side - 1 - reach and reach <= y < side - 1 - reach):
        return -1, -1, np.float32(0), np.float32(0)
    j, i = int(x), int(y)
    return j, i, np.float32(x - j), np.float32(y - i)


@inner
def _refined(first, second, x, y, to_x, to_y, room):
    """Where the window around (x, y) of the first image lies in the second one, from a guess; NaN where it is lost.

    Newton-Raphson on the sum of squared differences; slopes are the first image's (Bouguet, section 2.3).
    """
    wide, level, dx, dy = room
    j, i, a, b = _place(first, x, y, _HALF + 1)
    if j < 0:
        return np.nan, np.nan
    for r in range(_WIDTH + 2):
        upper, lower = first[i - _HALF - 1 + r], first[i - _HALF + r]
        for c in range(_WIDTH + 2):
            k = np.uint32(j - _HALF - 1 + c)
            top = upper[k] + a * (upper[k + _NEXT] - upper[k])
            low = lower[k] + a * (lower[k + _NEXT] - lower[k])
            wide[r, c] = top + b * (low - top)
    xx, xy, yy = np.float32(0), np.float32(0), np.float32(0)
    for r in range(_WIDTH):
        for c in range(_WIDTH):
            level[r, c] = wide[r + 1, c + 1]
            dx[r, c] = np.float32(0.5) * (wide[r + 1, c + 2] - wide[r + 1, c])
            dy[r, c] = np.float32(0.5) * (wide[r + 2, c + 1] - wide[r, c + 1])
            xx += dx[r, c] * dx[r, c]
            xy += dx[r, c] * dy[r, c]
            yy += dy[r, c] * dy[r, c]
    least = 0.5 * (xx + yy - math.sqrt((xx - yy) * (xx - yy) + 4 * xy * xy))
    if least < _LEAST_SLOPE * _WIDTH * _WIDTH:
        return np.nan, np.nan
    det = xx * yy - xy * xy
    for _ in range(_STEPS):
        j, i, a, b = _place(second, to_x, to_y, _HALF)
        if j < 0:
            return np.nan, np.nan
        ex, ey = np.float32(0), np.float32(0)
        for r in range(_WIDTH):
            upper, lower = second[i - _HALF + r], second[i - _HALF + r + 1]
            for c in range(_WIDTH):
                k = np.uint32(j - _HALF + c)
                top = upper[k] + a * (upper[k + _NEXT] - upper[k])
                low = lower[k] + a * (lower[k + _NEXT] - lower[k])
                off = level[r, c] - (top + b * (low - top))
                ex += off * dx[r, c]
                ey += off * dy[r, c]
        step_x, step_y = (yy * ex - xy * ey) / det, (xx * ey - xy * ex) / det
        to_x += step_x
        to_y += step_y
        if step_x * step_x + step_y * step_y < _STILL_PX * _STILL_PX:
            break
    return to_x, to_y


@inner
def _followed(first, first_half, second, second_half, x, y, to_x, to_y, room):
    """`_refined` on the halved images, where it is not lost there, then on the full ones."""
    coarse_x, coarse_y = _refined(first_half, second_half, x / 2, y / 2, to_x / 2, to_y / 2, room)
    if not math.isnan(coarse_x):
        to_x, to_y = 2 * coarse_x, 2 * coarse_y
    return _refined(first, second, x, y, to_x, to_y, room)


@kernel(None, BGR, F8, F8, F8, BGR, F8, F8, F8, array(F8, 2), F8)
def _scale(before, x, y, r, now, start_x, start_y, start_r, spokes, max_round_trip):
    """How many points came back, the ratio of their spreads about their means (eq 2.18), and the standard deviation of
    one point's ratio; in pixels of the two patches. `spokes` (N, 2) are the points, in radii."""
    side = 2 * (int(r) + _MARGIN_PX)
    left, top = int(x) - side // 2, int(y) - side // 2
    now_left, now_top = int(start_x) - side // 2, int(start_y) - side // 2
    first, second = _luma(before, left, top, side), _luma(now, now_left, now_top, side)
    first_half, second_half = _halved(first), _halved(second)
    room = (
        np.empty((_WIDTH + 2, _WIDTH + 2), np.float32),
        np.empty((_WIDTH, _WIDTH), np.float32),
        np.empty((_WIDTH, _WIDTH), np.float32),
        np.empty((_WIDTH, _WIDTH), np.float32),
    )
    points, kept = np.empty((spokes.shape[0], 4)), 0
    for k in range(spokes.shape[0]):
        from_x, from_y = x - left + r * spokes[k, 0], y - top + r * spokes[k, 1]
        to_x, to_y = start_x - now_left + start_r * spokes[k, 0], start_y - now_top + start_r * spokes[k, 1]
        to_x, to_y = _followed(first, first_half, second, second_half, from_x, from_y, to_x, to_y, room)
        back_x = x - left + (to_x - start_x + now_left) * r / start_r
        back_y = y - top + (to_y - start_y + now_top) * r / start_r
        back_x, back_y = _followed(second, second_half, first, first_half, to_x, to_y, back_x, back_y, room)
        if math.hypot(back_x - from_x, back_y - from_y) < max_round_trip:
            points[kept, 0], points[kept, 1], points[kept, 2], points[kept, 3] = from_x, from_y, to_x, to_y
            kept += 1
    if kept < 2:
        return kept, np.nan, np.nan
    was, has = np.empty(kept), np.empty(kept)
    mean = np.zeros(4)
    for k in range(kept):
        mean += points[k] / kept
    for k in range(kept):
        was[k] = math.hypot(points[k, 0] - mean[0], points[k, 1] - mean[1])
        has[k] = math.hypot(points[k, 2] - mean[2], points[k, 3] - mean[3])
    ratio = has.sum() / was.sum()
    return kept, ratio, (has - ratio * was).std() / was.mean()
