"""GeometryScale: the marker's change of size from Lucas-Kanade points on it (thesis section 2.3.3, eq 2.18).

Pyramidal Lucas-Kanade after Bouguet 2001 (OpenCV's), checked forward and backward (Kalal et al. 2010).
"""

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig


class PointsConfig(StageConfig):
    """Limits keep a product of ratios from drifting; the chain re-anchors the radius on every accepted detection."""

    enabled: bool = Field(True, description="false leaves the size to the Kalman filter (figure 2.5a)")
    max_step: float = Field(0.1, gt=0, lt=1, description="largest relative change of radius a frame; ours")
    max_round_trip_px: float = Field(
        0.7, gt=0, description="forward-backward distance that keeps a point, 64-px square; ours"
    )
    min_points: int = Field(6, ge=3, description="fewer surviving points give no scale; ours")


_ANGLES = np.arange(24) * (2 * np.pi / 24)
_SPOKES = 0.97 * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
"""Points just inside the outline, in radii: a smooth ball has no features further in, where flow is drawn along."""
_SIDE, _REACH = 64, 1.7  # the square both pictures are brought to: pixels, and half its side in marker radii


def geometry_scale(
    before: Patch, circle_before: Circle, now: Patch, circle_now: Circle, config: PointsConfig
) -> float | None:
    """The ratio r_now / r_before of eq 2.18, clamped to 1 +- max_step; None when too few points survive.

    `circle_now` is only where to start looking (KCF's answer). Circles are in image pixels.
    """
    half = _REACH * circle_before.r_px
    scale = _SIDE / (2 * half)
    first, second = (_square(p, c, scale) for p, c in ((before, circle_before), (now, circle_now)))
    start = (_SPOKES * circle_before.r_px * scale + (_SIDE - 1) / 2).astype(np.float32)
    options = {"winSize": (13, 13), "maxLevel": 1}
    forward, ok, _ = cv2.calcOpticalFlowPyrLK(first, second, start, None, **options)  # type: ignore[call-overload]
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(second, first, forward, None, **options)  # type: ignore[call-overload]
    round_trip = np.linalg.norm(back - start, axis=1)
    keep = (ok.ravel() == 1) & (ok_back.ravel() == 1) & (round_trip < config.max_round_trip_px)
    if keep.sum() < config.min_points:
        return None
    ratio = _spread(forward[keep]) / _spread(start[keep])
    return float(np.clip(ratio, 1 - config.max_step, 1 + config.max_step))


def _square(patch: Patch, circle: Circle, scale: float) -> npt.NDArray[np.uint8]:
    """The luma around a circle's centre as a (_SIDE, _SIDE) square, `scale` of its pixels to a picture pixel."""
    local, step, middle = patch.local(circle), 1 / scale, (_SIDE - 1) / 2
    sample = np.array([[step, 0, local.x_px - middle * step], [0, step, local.y_px - middle * step]], np.float64)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(patch.gray, sample, (_SIDE, _SIDE), flags=flags, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[return-value]


def _spread(points: npt.NDArray[np.float32]) -> float:
    """Sum of distances to the mean point (numerator and denominator of eq 2.18)."""
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).sum())
