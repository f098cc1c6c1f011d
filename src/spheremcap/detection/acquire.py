"""Find the marker with no prior: colour on a reduced picture, blobs in order of how much they look like a disc."""

import cv2
import numpy as np
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Window
from spheremcap.core.stage import StageConfig
from spheremcap.detection.colour import ColourBox


class AcquireConfig(StageConfig):
    """Ours. The picture is reduced so far that a marker still spans about `blob_r_px` pixels in radius."""

    enabled: bool = Field(True, description="false: a lost marker waits for a seed (ablation)")
    blob_r_px: float = Field(3.0, ge=1.5, description="radius to which the picture is reduced, pixels")
    most: int = Field(4, ge=1, description="candidates handed on")
    least_fill: float = Field(0.35, gt=0, le=1, description="blob area over its own bounding circle's, at least")
    size_ratio: float = Field(2.0, gt=1, description="radius sought: last known, times or over this")


def acquire(
    frame: Frame, box: ColourBox, gain: float, last: Circle, region: Window, config: AcquireConfig
) -> list[Circle]:
    """Candidate circles in image pixels inside `region`, most likely first; `last` is the marker as last verified."""
    if not config.enabled:
        return []
    step = max(1, min(8, int(last.r_px / config.blob_r_px)))
    small = frame.reduced(step)
    inside = region.clipped(frame.width_px, frame.height_px)
    x0, y0 = inside.x // step, inside.y // step
    cut = small[y0 : (inside.y + inside.height) // step + 1, x0 : (inside.x + inside.width) // step + 1]
    if cut.size == 0:
        return []
    mask = box.mask(cv2.cvtColor(np.ascontiguousarray(cut), cv2.COLOR_BGR2HSV), gain)  # type: ignore[arg-type]
    count, _, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
    found: list[tuple[float, Circle]] = []
    for k in range(1, count):
        area, width, height = (int(stats[k, c]) for c in (cv2.CC_STAT_AREA, cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT))
        reach = max(width, height) / 2  # a part-hidden disc keeps its longest extent
        r_px = reach * step
        ratio = r_px / last.r_px
        if area < 3 or not 1 / config.size_ratio / 1.3 < ratio < config.size_ratio * 1.3:
            continue
        fill = area / (np.pi * (reach + 0.25) ** 2)
        if fill < config.least_fill:
            continue
        x, y = centres[k]
        circle = Circle((x + x0) * step + step // 2, (y + y0) * step + step // 2, float(r_px))
        found.append((abs(float(np.log(ratio))) + 2 * max(0.0, 1 - fill), circle))
    found.sort(key=lambda item: item[0])
    return [circle for _, circle in found[: config.most]]
