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
_SPOKES = np.concatenate([share * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1) for share in (0.8, 0.97)])
"""Points inside the outline, in radii: a smooth ball has few features further in, where flow is drawn along."""
_SHARED, _LEAST_SD = 4.0, 0.002  # points that share an error, and what the ratio is never surer of
_SIDE, _REACH = 64, 1.7  # the square both pictures are brought to: pixels, and half its side in marker radii


def geometry_scale(
    before: Patch, circle_before: Circle, now: Patch, circle_now: Circle, config: PointsConfig
) -> tuple[float, float] | None:
    """The ratio r_now / r_before of eq 2.18, clamped to 1 +- max_step, and its standard deviation by how much the
    points disagree; None when too few points survive.

    `circle_now` is only where to start looking (KCF's answer). Circles are in image pixels.
    """
    half = _REACH * circle_before.r_px
    scale = _SIDE / (2 * half)
    first, second = (_square(p, c, scale) for p, c in ((before, circle_before), (now, circle_now)))
    start = (_SPOKES * circle_before.r_px * scale + (_SIDE - 1) / 2).astype(np.float32)
    options = {"winSize": (7, 7), "maxLevel": 2}
    forward, ok, _ = cv2.calcOpticalFlowPyrLK(first, second, start, None, **options)  # type: ignore[call-overload]
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(second, first, forward, None, **options)  # type: ignore[call-overload]
    round_trip = np.linalg.norm(back - start, axis=1)
    keep = (ok.ravel() == 1) & (ok_back.ravel() == 1) & (round_trip < config.max_round_trip_px)
    if keep.sum() < config.min_points:
        return None
    was, is_now = _spread(start[keep]), _spread(forward[keep])
    ratio = float(is_now.sum() / was.sum())
    scatter = float((is_now - ratio * was).std() / was.mean())
    sd = max(_LEAST_SD, scatter * float(np.sqrt(_SHARED / keep.sum())))
    return float(np.clip(ratio, 1 - config.max_step, 1 + config.max_step)), sd


def _square(patch: Patch, circle: Circle, scale: float) -> npt.NDArray[np.uint8]:
    """The luma around a circle's centre as a (_SIDE, _SIDE) square, `scale` of its pixels to a picture pixel."""
    local, step, middle = patch.local(circle), 1 / scale, (_SIDE - 1) / 2
    sample = np.array([[step, 0, local.x_px - middle * step], [0, step, local.y_px - middle * step]], np.float64)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(patch.gray, sample, (_SIDE, _SIDE), flags=flags, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[return-value]


def _spread(points: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Distances (N,) to the mean point; eq 2.18 has their sums."""
    return np.linalg.norm(points - points.mean(axis=0), axis=1)
