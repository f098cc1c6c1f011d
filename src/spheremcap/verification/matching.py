"""Six template matchers from one cross-correlation (thesis eq 3.2-3.7 as corrected in docs/method.md).

OpenCV's TM_ definitions over three channels, for a template that is a disc: a square one has the background in its
corners, and six matchers then outvote a good claim as soon as the marker leaves a bright stripe. Every map follows from
the cross-correlation and the sums of g and g squared under the disc, so each of these is computed once.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.compiled import BGR, BOOL, F4, F8, I8, array, inner, kernel
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig
from spheremcap.core.view import ResponseMap

F32 = npt.NDArray[np.float32]

MATCHERS = ("CCORR", "CCORR_NORMED", "CCOEFF", "CCOEFF_NORMED", "SQDIFF", "SQDIFF_NORMED")
MATCHERS_SAD = (*MATCHERS[:4], "SAD", "SAD_NORMED")
BEST_IS_LOW = (False, False, False, False, True, True)


class MatchingConfig(StageConfig):
    """The six of section 3.1.4; the scale is ours."""

    difference: Literal["SQDIFF", "SAD"] = Field("SQDIFF", description="SAD is eq 3.5 as the thesis' text has it")
    template_r_px: float = Field(12.8, ge=4, le=40, description="radius at which every marker is matched, pixels")
    margin: float = Field(1.0, ge=0.5, le=2, description="radius of the template's disc in marker radii")


@dataclass(frozen=True, slots=True)
class Template:
    """The marker as last verified: pixels (n, n, 3) float32 around the circle, which has `circle.r_px` in the picture
    and `r_px` here. `rows` (n, 2) int64 is the disc: in row i only the columns rows[i, 0] to rows[i, 1] - 1 count."""

    pixels: F32
    rows: npt.NDArray[np.int64]
    r_px: float
    circle: Circle


@dataclass(frozen=True, slots=True)
class Matches:
    """What six matchers found; iterates as six `ResponseMap`, made when asked for.

    `values` (6, k, k) float32 are the maps in the order of `matchers`, `peaks` (6, 2) int64 the column and row of each
    one's best value, `scores` these values, and `circles` the circles found, in image pixels.
    """

    matchers: tuple[str, ...]
    values: F32
    peaks: npt.NDArray[np.int64]
    scores: tuple[float, ...]
    circles: tuple[Circle, ...]

    def __len__(self) -> int:
        return len(self.matchers)

    def overlaps(self, claim: Circle) -> list[float]:
        """Dice overlap of each circle with a claim, in [0, 1] (eq 3.8)."""
        circles = np.array([(c.x_px, c.y_px, c.r_px) for c in self.circles], np.float64)
        return dice_overlaps(circles, claim.x_px, claim.y_px, claim.r_px).tolist()

    def __iter__(self) -> Iterator[ResponseMap]:
        for k, name in enumerate(self.matchers):
            column, row = self.peaks[k].tolist()
            yield ResponseMap(name, self.values[k], BEST_IS_LOW[k], (column, row), self.circles[k])


_PIXELS, _ROWS = array(F4, 3), array(I8, 2)


@inner
def _square(bgr, x0, y0, step, side):
    """(side, side, 3) float32: the patch at (x0 + j step, y0 + i step), bilinear; beyond its border the border pixel
    repeats. A step of 1.5 or more takes the mean of places spread over it."""
    height, width = bgr.shape[:2]
    out = np.empty((side, side, 3), np.float32)
    last_x, last_y = x0 + (side - 1) * step, y0 + (side - 1) * step
    whole = abs(step - 1.0) < 1e-9 and abs(x0 - np.rint(x0)) < 1e-6 and abs(y0 - np.rint(y0)) < 1e-6
    if whole and x0 > -0.5 and y0 > -0.5 and last_x < width - 0.5 and last_y < height - 0.5:
        j0, i0 = int(np.rint(x0)), int(np.rint(y0))
        for i in range(side):
            for j in range(side):
                for c in range(3):
                    out[i, j, c] = bgr[i0 + i, j0 + j, c]
        return out
    sub = max(1, int(np.rint(step)))
    out[:] = 0
    left, right = np.empty(side * sub, np.int64), np.empty(side * sub, np.int64)
    share = np.empty(side * sub, np.float32)
    for j in range(side * sub):
        x = min(max(x0 + ((j + 0.5) / sub - 0.5) * step, 0.0), width - 1.0)
        left[j], right[j], share[j] = int(x), min(int(x) + 1, width - 1), x - int(x)
    part = np.float32(1.0 / (sub * sub))
    for i in range(side * sub):
        y = min(max(y0 + ((i + 0.5) / sub - 0.5) * step, 0.0), height - 1.0)
        top, bottom, low = bgr[int(y)], bgr[min(int(y) + 1, height - 1)], np.float32(y - int(y))
        line = out[i // sub]
        for j in range(side * sub):
            a, b, right_of = left[j], right[j], share[j]
            for c in range(3):
                first = top[a, c] + low * (np.float32(bottom[a, c]) - np.float32(top[a, c]))
                second = top[b, c] + low * (np.float32(bottom[b, c]) - np.float32(top[b, c]))
                line[j // sub, c] += part * (first + right_of * (second - first))
    return out


@kernel(None, array(F8, 2), F8, F8, F8)
def dice_overlaps(circles, x, y, r):
    """`Circle.dice` of each of some circles (N, 3) with one, (N,)."""
    out = np.zeros(len(circles))
    for k in range(len(circles)):
        d, s = math.hypot(circles[k, 0] - x, circles[k, 1] - y), circles[k, 2]
        if d >= r + s:
            continue
        shared = math.pi * min(r, s) ** 2
        if d > abs(r - s):
            alpha = math.acos(max(-1.0, min(1.0, (d * d + r * r - s * s) / (2.0 * d * r))))
            beta = math.acos(max(-1.0, min(1.0, (d * d + s * s - r * r) / (2.0 * d * s))))
            shared = r * r * (alpha - math.sin(2.0 * alpha) / 2.0) + s * s * (beta - math.sin(2.0 * beta) / 2.0)
        out[k] = 2.0 * shared / (math.pi * (r * r + s * s))
    return out


@kernel(None, BGR, F8, F8, F8, F8)
def cut_disc(bgr, x, y, step, radius):
    """The disc of `radius` steps around (x, y), in patch pixels, of a patch (h, w, 3) BGR: pixels (n, n, 3) float32
    with n = 2 radius rounded up to an odd number, and the columns of each row within the disc, (n, 2) int64."""
    side = max(3, int(np.ceil(2 * radius)) | 1)
    middle = (side - 1) // 2
    rows = np.empty((side, 2), np.int64)
    for i in range(side):
        half2 = radius * radius - (i - middle) ** 2
        half = int(np.floor(np.sqrt(half2))) if half2 >= 0 else -1
        rows[i, 0], rows[i, 1] = middle - half, middle + half + 1
    return _square(bgr, x - middle * step, y - middle * step, step, side), rows


@inner
def _dot(f, g):
    total = np.float32(0)
    for q in range(f.size):
        total += f[q] * g[q]
    return total


@inner
def _distance(f, disc, g):
    total = np.float32(0)
    for q in range(f.size):
        total += abs(f[q] - disc[q] * g[q])
    return total


@inner
def _above_rounding(variance, power):
    """0 for the variance of an even colour, which the difference of two sums has only to 7 digits."""
    return variance if variance > np.float32(1e-5) * power else np.float32(0)


@kernel(None, _PIXELS, _ROWS, _PIXELS, BOOL)
def six_maps(pixels, rows, search, absolute):
    """All six response maps, (6, k, k) float32 in the order of MATCHERS (`absolute`: of MATCHERS_SAD), of a template
    (n, n, 3) over a search picture (n + k - 1, n + k - 1, 3), both float32.

    Of template and window only the columns `rows[i, 0]` to `rows[i, 1] - 1` of row i count. Normalised maps are 0
    where the window or the template has no energy (SQDIFF_NORMED: 1), CCOEFF_NORMED where one has an even colour.
    """
    n, m = pixels.shape[0], search.shape[0]
    k = m - n + 1
    # The template as one line, 0 where it does not count, so that a window is one dot product.
    width = 3 * n
    size = n * width
    f, disc = np.zeros(size, np.float32), np.zeros(size, np.float32)
    count, f0, f1, f2 = 0, np.float32(0), np.float32(0), np.float32(0)
    for i in range(n):
        for j in range(rows[i, 0], rows[i, 1]):
            q = i * width + 3 * j
            f[q], f[q + 1], f[q + 2] = pixels[i, j, 0], pixels[i, j, 1], pixels[i, j, 2]
            disc[q], disc[q + 1], disc[q + 2] = 1, 1, 1
            f0, f1, f2, count = f0 + f[q], f1 + f[q + 1], f2 + f[q + 2], count + 1
    part = np.float32(1.0 / max(count, 1))
    f_power = _dot(f, f)
    f_variance = _above_rounding(f_power - part * (f0 * f0 + f1 * f1 + f2 * f2), f_power)
    cross, sad = np.empty((k, k), np.float32), np.zeros((k, k), np.float32)
    lines = search.reshape(m, 3 * m)
    strip = np.empty((m, width), np.float32)  # columns u .. u + n - 1 of the search picture: its windows, row by row
    windows = strip.reshape(m * width)
    for u in range(k):
        for i in range(m):
            for q in range(width):
                strip[i, q] = lines[i, 3 * u + q]
        for v in range(k):
            g = windows[v * width : v * width + size]
            cross[v, u] = _dot(f, g)
            if absolute:
                sad[v, u] = _distance(f, disc, g)
    # Sums of g and g squared under the disc, from running sums along each row; whole vector registers of them.
    span = 4 * ((k + 7) // 8 * 8)
    sums = np.zeros((k, span), np.float32)
    running = np.zeros(4 * (m + 1) + span, np.float32)
    for i in range(m):
        g0, g1, g2, squares = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        for j in range(m):
            blue, green, red = search[i, j, 0], search[i, j, 1], search[i, j, 2]
            g0, g1, g2 = g0 + blue, g1 + green, g2 + red
            squares += blue * blue + green * green + red * red
            q = 4 * (j + 1)
            running[q], running[q + 1], running[q + 2], running[q + 3] = g0, g1, g2, squares
        for v in range(max(0, i - n + 1), min(k, i + 1)):
            first, end = 4 * rows[i - v, 0], 4 * rows[i - v, 1]
            if first < end:
                low, high, out = running[first : first + span], running[end : end + span], sums[v]
                for q in range(span):
                    out[q] += high[q] - low[q]
    maps = np.empty((6, k, k), np.float32)
    tiny, zero, one = np.float32(1e-6), np.float32(0), np.float32(1)
    for v in range(k):
        for u in range(k):
            g0, g1, g2, squares = sums[v, 4 * u], sums[v, 4 * u + 1], sums[v, 4 * u + 2], sums[v, 4 * u + 3]
            both = cross[v, u]
            coefficient = both - part * (g0 * f0 + g1 * f1 + g2 * f2)
            g_variance = _above_rounding(squares - part * (g0 * g0 + g1 * g1 + g2 * g2), squares)
            energy = np.sqrt(max(squares * f_power, tiny))
            maps[0, v, u], maps[1, v, u] = both, both / energy
            maps[2, v, u] = coefficient
            spread = g_variance * f_variance
            maps[3, v, u] = coefficient / np.sqrt(spread) if spread > zero else zero
            if absolute:
                maps[4, v, u] = sad[v, u]
                maps[5, v, u] = sad[v, u] / max(np.sqrt(energy * np.float32(count)), tiny)
            else:
                difference = max(f_power + squares - np.float32(2) * both, zero)
                maps[4, v, u], maps[5, v, u] = difference, min(difference / energy, one)
    return maps


@inner
def _vertex(left, middle, right):
    """Where between -0.5 and 0.5 the parabola through three values at -1, 0, 1 is greatest; 0 if it is nowhere."""
    bend = float(left) - 2.0 * float(middle) + float(right)
    return 0.0 if bend >= 0 else max(-0.5, min(0.5, 0.5 * (float(left) - float(right)) / bend))


@inner
def _best(values, sign):
    """Column and row of the greatest of `sign` times the values (k, k), the first of equal ones, and the offsets of
    the true peak from it."""
    k = values.shape[0]
    row = column = 0
    for v in range(k):
        for u in range(k):
            if sign * values[v, u] > sign * values[row, column]:
                row, column = v, u
    dx = dy = 0.0
    if 0 < row < k - 1:
        dy = _vertex(sign * values[row - 1, column], sign * values[row, column], sign * values[row + 1, column])
    if 0 < column < k - 1:
        dx = _vertex(sign * values[row, column - 1], sign * values[row, column], sign * values[row, column + 1])
    return column, row, dx, dy


@inner
def _less(picture, mean):
    out = np.empty(picture.shape, np.float32)
    for i in range(picture.shape[0]):
        for j in range(picture.shape[1]):
            out[i, j, 0] = picture[i, j, 0] - mean[0]
            out[i, j, 1] = picture[i, j, 1] - mean[1]
            out[i, j, 2] = picture[i, j, 2] - mean[2]
    return out


@kernel(None, BGR, F8, F8, F8, I8, _PIXELS, _ROWS, BOOL)
def search_six(bgr, x, y, step, shifts, pixels, rows, absolute):
    """Search a patch (h, w, 3) BGR around (x, y), up to `shifts` steps of `step` patch pixels each way, for a template.

    Gives the maps (6, k, k) float32 with k = 2 shifts + 1, each one's best column and row (6, 2) int64 and value (6,),
    and the peaks between the pixels, (6, 2) float64 in patch pixels from (x, y).
    """
    side = pixels.shape[0] + 2 * shifts
    middle = (side - 1) // 2
    search = _square(bgr, x - middle * step, y - middle * step, step, side)
    # The thesis takes both pictures to have zero mean (before eq 3.2); without it CCORR finds whatever is brightest.
    blue, green, red = np.float32(0), np.float32(0), np.float32(0)
    for i in range(side):
        for j in range(side):
            blue, green, red = blue + search[i, j, 0], green + search[i, j, 1], red + search[i, j, 2]
    part = np.float32(1.0 / (side * side))
    mean = (part * blue, part * green, part * red)
    maps = six_maps(_less(pixels, mean), rows, _less(search, mean), absolute)
    peaks, scores, offsets = np.empty((6, 2), np.int64), np.empty(6), np.empty((6, 2))
    for n in range(6):
        column, row, dx, dy = _best(maps[n], np.float32(1 if n < 4 else -1))
        peaks[n, 0], peaks[n, 1], scores[n] = column, row, maps[n, row, column]
        offsets[n, 0], offsets[n, 1] = (column + dx - shifts) * step, (row + dy - shifts) * step
    return maps, peaks, scores, offsets


def make_template(patch: Patch, circle: Circle, config: MatchingConfig) -> Template:
    """Cut the marker at `circle` (image pixels) out of the patch, brought to a radius of `template_r_px`."""
    local = patch.local(circle)
    step = local.r_px / config.template_r_px
    pixels, rows = cut_disc(patch.bgr, local.x_px, local.y_px, step, config.margin * config.template_r_px)
    return Template(pixels, rows, config.template_r_px, circle)


def match(template: Template, patch: Patch, around: Circle, reach_px: float, config: MatchingConfig) -> Matches:
    """Search the patch up to `reach_px` around a circle's centre (image pixels) for the template.

    The circles found are in image pixels and have the size the marker had when the template was taken, brought to
    the size expected now (`around.r_px`) so that a fast approach is not taken for disagreement. Time and memory grow
    with the square of `reach_px` over the radius: the caller keeps it to about the radius.
    """
    local = patch.local(around)
    step = local.r_px / template.r_px
    shifts = max(1, round(reach_px * template.r_px / around.r_px))
    absolute = config.difference == "SAD"
    values, peaks, scores, offsets = search_six(
        patch.bgr, local.x_px, local.y_px, step, shifts, template.pixels, template.rows, absolute
    )
    circles = tuple(
        Circle(around.x_px + dx * patch.step_px, around.y_px + dy * patch.step_px, around.r_px)
        for dx, dy in offsets.tolist()
    )
    return Matches(MATCHERS_SAD if absolute else MATCHERS, values, peaks, tuple(scores.tolist()), circles)
