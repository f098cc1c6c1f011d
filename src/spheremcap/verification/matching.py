"""Six template matchers from one cross-correlation (thesis eq 3.2-3.7 as corrected in docs/method.md).

OpenCV's TM_ definitions over three channels, for a template that is a disc: a square one has the background in its
corners, and six matchers then outvote a good claim as soon as the marker leaves a bright stripe. Every map follows from
the cross-correlation and the sums of g and g squared under the disc, so each of these is computed once.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig
from spheremcap.core.view import ResponseMap

F32 = npt.NDArray[np.float32]

MATCHERS = ("CCORR", "CCORR_NORMED", "CCOEFF", "CCOEFF_NORMED", "SQDIFF", "SQDIFF_NORMED")


class MatchingConfig(StageConfig):
    """The six of section 3.1.4; the scale is ours."""

    difference: Literal["SQDIFF", "SAD"] = Field("SQDIFF", description="SAD is eq 3.5 as the thesis' text has it")
    template_r_px: float = Field(10.0, ge=4, le=40, description="radius at which a larger marker is matched, pixels")
    margin: float = Field(1.0, ge=0.5, le=2, description="radius of the template's disc in marker radii")


@dataclass(frozen=True, slots=True)
class Template:
    """The marker as last verified: pixels (n, n, 3) float32 around the circle, which has `circle.r_px` in the picture
    and `r_px` here, and the disc (n, n), 0 or 1, that counts of them."""

    pixels: F32
    disc: F32
    r_px: float
    circle: Circle


def _resampled(patch: Patch, x_px: float, y_px: float, half_px: float, scale: float) -> F32:
    """The square of half side `half_px` around an image point, `scale` template pixels to a picture pixel."""
    side = max(3, int(np.ceil(2 * half_px * scale)) | 1)
    step = 1 / scale
    middle = (side - 1) / 2
    x0, y0 = x_px - patch.window.x - middle * step, y_px - patch.window.y - middle * step
    sample = np.array([[step, 0, x0], [0, step, y0]], np.float64)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    source = patch.bgr if step < 1.5 else cv2.blur(patch.bgr, (int(step) | 1, int(step) | 1))
    out = cv2.warpAffine(source, sample, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return out.astype(np.float32)


def make_template(patch: Patch, circle: Circle, config: MatchingConfig) -> Template:
    """Cut the marker at `circle` (image pixels) out of the patch, reduced when it is larger than `template_r_px`."""
    scale = min(1.0, config.template_r_px / circle.r_px)
    pixels = _resampled(patch, circle.x_px, circle.y_px, config.margin * circle.r_px, scale)
    off = np.arange(len(pixels), dtype=np.float32) - (len(pixels) - 1) / 2
    disc = (off * off + (off * off)[:, None] <= (config.margin * circle.r_px * scale) ** 2).astype(np.float32)
    return Template(pixels, disc, circle.r_px * scale, circle)


def match(
    template: Template, patch: Patch, around: Circle, reach_px: float, config: MatchingConfig
) -> tuple[ResponseMap, ...]:
    """Search the patch up to `reach_px` around a circle's centre for the template; six maps, each with its circle.

    The maps' circles are in image pixels and have the size the marker had when the template was taken, brought to
    the size expected now (`around.r_px`) so that a fast approach is not taken for disagreement.
    """
    scale = template.r_px / around.r_px
    half = config.margin * template.r_px / scale + reach_px
    search = _resampled(patch, around.x_px, around.y_px, half, scale)
    n = template.pixels.shape[0]
    if search.shape[0] < n + 2:
        search = _resampled(patch, around.x_px, around.y_px, (n / 2 + 2) / scale, scale)
    # The thesis takes both pictures to have zero mean (before eq 3.2); without it CCORR finds whatever is brightest.
    mean = search.mean(axis=(0, 1))
    maps = six_maps(template.pixels - mean, search - mean, config.difference, template.disc)
    out = []
    for name, values in maps.items():
        low = name.startswith(("SQDIFF", "SAD"))
        row, column, dy, dx = _peak(-values if low else values)
        middle = (values.shape[0] - 1) / 2
        circle = Circle(
            around.x_px + (column + dx - middle) / scale,
            around.y_px + (row + dy - middle) / scale,
            around.r_px,
        )
        out.append(ResponseMap(name, values, low, (column, row), circle))
    return tuple(out)


def six_maps(template: F32, search: F32, difference: str = "SQDIFF", disc: F32 | None = None) -> dict[str, F32]:
    """All six response maps (rows, columns) of a template (n, n, 3) over a search picture (m, m, 3).

    Of template and window only the pixels count where `disc` (n, n) is 1; all of them for None. Normalised maps are 0
    where the window or the template has no energy (SQDIFF_NORMED: 1).
    """
    if disc is None:
        disc = np.ones(template.shape[:2], np.float32)
    template = template * disc[:, :, None]
    pixels = float(disc.sum())
    cross = cv2.matchTemplate(search, template, cv2.TM_CCORR)
    sums = np.stack([cv2.matchTemplate(channel, disc, cv2.TM_CCORR) for channel in cv2.split(search)], axis=2)
    squares = cv2.matchTemplate((search * search).sum(axis=2), disc, cv2.TM_CCORR)
    f_sums = template.sum(axis=(0, 1))
    f_power = float((template * template).sum())
    f_variance = f_power - float((f_sums * f_sums).sum()) / pixels
    g_variance = np.maximum(squares - (sums * sums).sum(axis=2) / pixels, 0)
    coefficient = cross - sums @ (f_sums / np.float32(pixels))
    energy = np.sqrt(np.maximum(squares * f_power, 1e-6))
    sqdiff = np.maximum(f_power + squares - 2 * cross, 0)
    maps = {
        "CCORR": cross,
        "CCORR_NORMED": cross / energy,
        "CCOEFF": coefficient,
        "CCOEFF_NORMED": coefficient / np.sqrt(np.maximum(g_variance * f_variance, 1e-6)),
    }
    if difference == "SAD":
        sad = _sad(template, search, disc)
        maps |= {"SAD": sad, "SAD_NORMED": sad / np.maximum(np.sqrt(energy * pixels), 1e-6)}
    else:
        maps |= {"SQDIFF": sqdiff, "SQDIFF_NORMED": np.minimum(sqdiff / energy, 1)}
    return {name: np.ascontiguousarray(values, np.float32) for name, values in maps.items()}


def _sad(template: F32, search: F32, disc: F32) -> F32:
    """Eq 3.5 over three channels; direct, so about n^2 times the work of one correlation shift."""
    windows = np.lib.stride_tricks.sliding_window_view(search, template.shape[:2], axis=(0, 1))
    out = np.zeros((search.shape[0] - template.shape[0] + 1, search.shape[1] - template.shape[1] + 1), np.float32)
    goal: F32 = np.ascontiguousarray(np.moveaxis(template, 2, 0))
    for row in range(len(out)):
        out[row] = (np.abs(windows[row] - goal) * disc).reshape(len(out[row]), -1).sum(axis=1)
    return out


def _peak(values: F32) -> tuple[int, int, float, float]:
    """Row and column of the greatest value, and the parabolic offsets of the true peak from it."""
    _, _, _, (column, row) = cv2.minMaxLoc(values)
    dy = dx = 0.0
    if 0 < row < values.shape[0] - 1:
        dy = _vertex(*values[row - 1 : row + 2, column])
    if 0 < column < values.shape[1] - 1:
        dx = _vertex(*values[row, column - 1 : column + 2])
    return int(row), int(column), dy, dx


def _vertex(left: float, mid: float, right: float) -> float:
    bend = float(left) - 2 * float(mid) + float(right)
    return 0.0 if bend >= 0 else max(-0.5, min(0.5, 0.5 * (float(left) - float(right)) / bend))
