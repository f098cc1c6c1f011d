"""Gradient circle Hough in the tracked patch (thesis section 2.4.1, eq 2.20)."""

import cv2
import numpy as np
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch, Window
from spheremcap.core.stage import StageConfig


class HoughConfig(StageConfig):
    """(dp, minDist, param1, param2) = (4, 1, 77, 1) is the thesis' optimum on 240 frames (eq 2.20)."""

    enabled: bool = Field(True, description="false leaves detection to colour, KCF and the prediction")
    dp: float = Field(4.0, ge=1, description="accumulator cell, pixels")
    min_dist_px: float = Field(1.0, gt=0, description="least distance between centres")
    param1: float = Field(77.0, gt=0, description="upper Canny threshold, grey levels")
    param2: float = Field(1.0, gt=0, description="accumulator threshold, votes")
    radius_window: float = Field(0.25, gt=0, lt=1, description="radius searched: expected +- this share; ours")
    keep: int = Field(3, ge=1, description="circles handed on, most votes first; ours")


def hough_circles(patch: Patch, expected: Circle, config: HoughConfig) -> tuple[Circle, ...]:
    """Circles in image pixels near `expected` in place and size, most votes first; empty when there is none.

    Only the part of the patch that such circles can touch is searched.
    """
    r_px = expected.r_px
    low, high = r_px * (1 - config.radius_window), r_px * (1 + config.radius_window)
    local, height, width = patch.local(expected), *patch.gray.shape
    part = Window.around(local, 1.6 * r_px + 2).clipped(width, height)
    if part.width < 3 or part.height < 3:
        return ()
    found = cv2.HoughCircles(
        patch.gray[part.y : part.y + part.height, part.x : part.x + part.width],
        cv2.HOUGH_GRADIENT,
        dp=config.dp,
        minDist=config.min_dist_px,
        param1=config.param1,
        param2=config.param2,
        minRadius=max(1, int(low)),
        maxRadius=int(np.ceil(high)) + 1,
    )
    if found is None:
        return ()
    rows = found.reshape(-1, found.shape[-1])[: config.keep]
    dx, dy = patch.window.x + part.x, patch.window.y + part.y
    return tuple(Circle(float(x) + dx, float(y) + dy, float(r)) for x, y, r, *_ in rows)
