"""Find the marker with no prior: colour on a reduced picture, blobs in order of how much they look like a disc."""

import math
from dataclasses import dataclass

from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Window
from spheremcap.core.sampling import cut_bgr
from spheremcap.core.stage import StageConfig
from spheremcap.detection.colour import ColourBox, blobs, box_mask

_SHIFTED = 0.2  # radii by which a part's middle has to be off the whole's to be worth a look of its own


class AcquireConfig(StageConfig):
    """Ours. The picture is reduced so far that a marker still spans about `blob_r_px` pixels in radius."""

    enabled: bool = Field(True, description="false: a lost marker waits for a seed (ablation)")
    blob_r_px: float = Field(4.0, ge=1.5, description="radius to which the picture is reduced, pixels")
    most: int = Field(4, ge=1, description="candidates handed on")
    least_fill: float = Field(0.2, gt=0, le=1, description="blob area over its own bounding circle's, at least")
    size_ratio: float = Field(2.0, gt=1, description="radius sought: last known, times or over this")


@dataclass(frozen=True, slots=True)
class Candidate:
    """A blob of the marker's colours: a circle about its middle that holds it, and half its width and height, image
    pixels."""

    circle: Circle
    half_width_px: float
    half_height_px: float

    def wholes(self, r_px: float) -> list[Circle]:
        """Circles of this radius of which the blob may be the part that shows: about its middle, or with its left,
        right, upper or lower side as their own where the other is cut off."""
        circles = [self.circle.resized(r_px)]
        for dx, dy in ((r_px - self.half_width_px, 0.0), (0.0, r_px - self.half_height_px)):
            if dx + dy > _SHIFTED * r_px:
                circles += [Circle(self.circle.x_px + s * dx, self.circle.y_px + s * dy, r_px) for s in (1, -1)]
        return circles


def acquire(
    frame: Frame, box: ColourBox, gain: float, last: Circle, region: Window, config: AcquireConfig
) -> list[Candidate]:
    """Candidates inside `region`, most likely first; `last` is the marker as last verified.

    Only the region is looked at, at a step of up to 8 pixels; empty when it lies outside the picture.
    """
    inside = region.clipped(frame.width_px, frame.height_px)
    if not config.enabled or inside.width == 0 or inside.height == 0:
        return []
    step = max(1, min(8, int(last.r_px / config.blob_r_px)))
    # The middle of the first step x step pixels; the last ones may be cut short.
    x0, y0 = inside.x + (step - 1) / 2, inside.y + (step - 1) / 2
    columns, rows = math.ceil(inside.width / step), math.ceil(inside.height / step)
    mask = box_mask(cut_bgr(*frame.planes, x0, y0, step, columns, rows), box.limits(gain))
    found: list[tuple[float, Candidate]] = []
    for area, x, y, width, height in blobs(mask, True, 3).tolist():
        reach = max(width, height) / 2  # a part-hidden disc keeps its longest extent
        r_px = reach * step
        ratio = r_px / last.r_px
        if not 1 / config.size_ratio / 1.3 < ratio < config.size_ratio * 1.3:
            continue
        fill = area / (math.pi * (reach + 0.25) ** 2)
        if fill < config.least_fill:
            continue
        candidate = Candidate(Circle(x0 + x * step, y0 + y * step, r_px), width * step / 2, height * step / 2)
        found.append((abs(math.log(ratio)) + 2 * max(0.0, 1 - fill), candidate))
    found.sort(key=lambda item: item[0])
    return [candidate for _, candidate in found[: config.most]]
