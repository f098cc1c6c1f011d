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
from spheremcap.core.sampling import neighbours
from spheremcap.core.stage import StageConfig
from spheremcap.core.view import ResponseMap

F32 = npt.NDArray[np.float32]

_QUARTER = math.pi / 4  # half of the widest stretch without an edge that a whole marker may have

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
    one's best value, `scores` these values, `circles` the circles found, in image pixels, and `overlaps` their Dice
    overlaps with the claim, in [0, 1] (eq 3.8); 0 when nothing was claimed.
    """

    matchers: tuple[str, ...]
    values: F32
    peaks: npt.NDArray[np.int64]
    scores: tuple[float, ...]
    circles: tuple[Circle, ...]
    overlaps: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.matchers)

    def __iter__(self) -> Iterator[ResponseMap]:
        for k, name in enumerate(self.matchers):
            column, row = self.peaks[k].tolist()
            yield ResponseMap(name, self.values[k], BEST_IS_LOW[k], (column, row), self.circles[k])


_NOTHING = Circle(0.0, 0.0, 0.0)

_PIXELS, _ROWS = array(F4, 3), array(I8, 2)


@inner
def _square(bgr, x0, y0, step, side):
    """(side, 3 side) float32, a pixel's three channels side by side: the patch at (x0 + j step, y0 + i step), bilinear;
    beyond its border the border pixel repeats. A step of 1.5 or more takes the mean of places spread over it."""
    height, width = bgr.shape[:2]
    sub = max(1, int(np.rint(step)))
    start, part = (0.5 / sub - 0.5) * step, np.float32(1.0 / sub)
    left, right, a = neighbours(x0 + start, step / sub, side * sub, width)
    upper, lower, b = neighbours(y0 + start, step / sub, side * sub, height)
    # First along the rows, each of the patch's once, then whole rows with one another.
    first = upper[0]
    along = np.zeros((lower[-1] - first + 1, 3 * side), np.float32)
    for i in range(along.shape[0]):
        source, line = bgr[first + i], along[i]
        for p in range(side * sub):
            q, j, k, share = 3 * (p // sub), left[p], right[p], a[p]
            for c in range(3):
                value = np.float32(source[j, c])
                line[q + c] += part * (value + share * (np.float32(source[k, c]) - value))
    out = np.zeros((side, 3 * side), np.float32)
    for p in range(side * sub):
        line, above, below, low = out[p // sub], along[upper[p] - first], along[lower[p] - first], b[p]
        for q in range(3 * side):
            line[q] += part * (above[q] + low * (below[q] - above[q]))
    return out


@inner
def _dice(x, y, r, other_x, other_y, other_r):
    """`Circle.dice` of two circles; 0 where one has no size."""
    d = math.hypot(x - other_x, y - other_y)
    if d >= r + other_r:
        return 0.0
    shared = math.pi * min(r, other_r) ** 2
    if d > abs(r - other_r):
        alpha = math.acos(max(-1.0, min(1.0, (d * d + r * r - other_r * other_r) / (2.0 * d * r))))
        beta = math.acos(max(-1.0, min(1.0, (d * d + other_r * other_r - r * r) / (2.0 * d * other_r))))
        shared = r * r * (alpha - math.sin(2.0 * alpha) / 2.0) + other_r * other_r * (beta - math.sin(2.0 * beta) / 2.0)
    return 2.0 * shared / (math.pi * (r * r + other_r * other_r))


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
    pixels = _square(bgr, x - middle * step, y - middle * step, step, side)
    return pixels.reshape(side, side, 3), rows


@inner
def _dot(f, g):
    total = np.float32(0)
    for q in range(f.size):
        total += f[q] * g[q]
    return total


@inner
def _four_dots(f, windows, pitch):
    """The products of one template with four windows, each `pitch` values further on, so that it is read only once."""
    a, b, c, d = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    gb, gc, gd = windows[pitch:], windows[2 * pitch :], windows[3 * pitch :]
    for q in range(f.size):
        a += f[q] * windows[q]
        b += f[q] * gb[q]
        c += f[q] * gc[q]
        d += f[q] * gd[q]
    return a, b, c, d


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


@inner
def _products(f, disc, lines, width, absolute):
    """The products (k, k) of a template with the windows of a search picture (m, 3 m), and (`absolute`, else 0) the
    sums of their absolute differences. `f` and `disc` (1 where it counts) are the template as one line, its n rows of
    3 n values filled up with 0 to `width`, whole registers."""
    m, size = lines.shape[0], f.size
    n = size // width
    k = m - n + 1
    cross, sad = np.empty((k, k), np.float32), np.zeros((k, k), np.float32)
    strip = np.zeros((m, width), np.float32)  # columns u .. u + n - 1 of the search picture: its windows, row by row
    windows = strip.reshape(m * width)
    for u in range(k):
        for i in range(m):
            for q in range(3 * n):
                strip[i, q] = lines[i, 3 * u + q]
        for v in range(0, k - 3, 4):
            four = _four_dots(f, windows[v * width :], width)
            cross[v, u], cross[v + 1, u], cross[v + 2, u], cross[v + 3, u] = four
        for v in range(k - k % 4, k):
            cross[v, u] = _dot(f, windows[v * width : v * width + size])
        if absolute:
            for v in range(k):
                sad[v, u] = _distance(f, disc, windows[v * width : v * width + size])
    return cross, sad


@inner
def _running_sums(search, spare):
    """Sums of blue, green, red and of their squares over the pixels left of each one of a picture (m, m, 3), the four
    side by side: (m, 4 (m + 1) + spare) float32."""
    m = search.shape[0]
    out, power = np.zeros((m, 4 * (m + 1) + spare), np.float32), np.empty(m, np.float32)
    for i in range(m):
        pixels, line = search[i], out[i]
        for j in range(m):
            blue, green, red = pixels[j, 0], pixels[j, 1], pixels[j, 2]
            power[j] = blue * blue + green * green + red * red
        g0, g1, g2, squares = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        for j in range(m):
            g0, g1, g2, squares = g0 + pixels[j, 0], g1 + pixels[j, 1], g2 + pixels[j, 2], squares + power[j]
            q = 4 * (j + 1)
            line[q], line[q + 1], line[q + 2], line[q + 3] = g0, g1, g2, squares
    return out


@inner
def _sums(rows, search):
    """Sums of blue, green, red and of their squares under the disc (n rows) in every window of a search picture
    (m, m, 3), the four side by side: (k, 4 k) float32 or wider, whole registers of them."""
    n = rows.shape[0]
    k = search.shape[0] - n + 1
    span = 4 * ((k + 7) // 8 * 8)
    sums, running = np.zeros((k, span), np.float32), _running_sums(search, span)
    for v in range(k):
        out = sums[v]
        for i in range(n):
            first, end = 4 * rows[i, 0], 4 * rows[i, 1]
            if first < end:
                low, high = running[v + i, first : first + span], running[v + i, end : end + span]
                for q in range(span):
                    out[q] += high[q] - low[q]
    return sums


@inner
def six_maps(pixels, rows, search, absolute):
    """All six response maps, (6, k, k) float32 in the order of MATCHERS (`absolute`: of MATCHERS_SAD), of a template
    (n, n, 3) over a search picture (n + k - 1, n + k - 1, 3), both float32.

    Of template and window only the columns `rows[i, 0]` to `rows[i, 1] - 1` of row i count. Normalised maps are 0
    where the window or the template has no energy (SQDIFF_NORMED: 1), CCOEFF_NORMED where one has an even colour.
    """
    n, m = pixels.shape[0], search.shape[0]
    k = m - n + 1
    width = (3 * n + 7) // 8 * 8
    f, disc = np.zeros(n * width, np.float32), np.zeros(n * width, np.float32)
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
    cross, sad = _products(f, disc, search.reshape(m, 3 * m), width, absolute)
    sums = _sums(rows, search)
    maps = np.empty((6, k, k), np.float32)
    tiny, zero, one = np.float32(1e-6), np.float32(0), np.float32(1)
    for v in range(k):
        for u in range(k):
            g0, g1, g2, squares = sums[v, 4 * u], sums[v, 4 * u + 1], sums[v, 4 * u + 2], sums[v, 4 * u + 3]
            both = cross[v, u]
            coefficient = both - part * (g0 * f0 + g1 * f1 + g2 * f2)
            g_variance = _above_rounding(squares - part * (g0 * g0 + g1 * g1 + g2 * g2), squares)
            energy = np.sqrt(max(squares * f_power, tiny))
            maps[0, v, u], maps[1, v, u], maps[2, v, u] = both, both / energy, coefficient
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
    best = sign * values[0, 0]
    for v in range(k):
        for u in range(k):
            value = sign * values[v, u]
            if value > best:
                best, row, column = value, v, u
    dx = dy = 0.0
    if 0 < row < k - 1:
        dy = _vertex(sign * values[row - 1, column], sign * values[row, column], sign * values[row + 1, column])
    if 0 < column < k - 1:
        dx = _vertex(sign * values[row, column - 1], sign * values[row, column], sign * values[row, column + 1])
    return column, row, dx, dy


@inner
def _mean_colour(lines):
    """The mean of each channel of a picture (h, 3 w), as a line (3 w,)."""
    height, width = lines.shape
    total, colour = np.zeros(width, np.float32), np.zeros(3, np.float32)
    for i in range(height):
        line = lines[i]
        for q in range(width):
            total[q] += line[q]
    for q in range(width):
        colour[q % 3] += total[q]
    for q in range(width):
        total[q] = colour[q % 3] * np.float32(3.0 / (height * width))
    return total


@inner
def _less(lines, colour):
    """A picture (h, 3 w) less a colour given as a line, as a picture (h, w, 3)."""
    height, width = lines.shape
    out = np.empty((height, width), np.float32)
    for i in range(height):
        line, to = lines[i], out[i]
        for q in range(width):
            to[q] = line[q] - colour[q]
    return out.reshape(height, width // 3, 3)


@kernel(None, BGR, F8, F8, F8, F8, F8, F8, F8, F8, F8, F8, I8, _PIXELS, _ROWS, BOOL)
def search_six(
    bgr, x0_px, y0_px, step_px, x_px, y_px, r_px, claim_x_px, claim_y_px, claim_r_px, template_r_px,
    shifts, pixels, rows, absolute,
):  # fmt: skip
    """Search a patch (h, w, 3) BGR, whose pixel (i, j) is the picture at (x0_px + j step_px, y0_px + i step_px), around
    a circle, up to `shifts` pixels of a template each way, whose circle has `template_r_px` of them.

    Gives the maps (6, k, k) float32 with k = 2 shifts + 1, each one's best column and row (6, 2) int64, and (5, 6)
    float64: x, y and r of the circles found, in image pixels, their scores, and their Dice overlaps with the claim,
    which are 0 when that has no radius.
    """
    n, step = pixels.shape[0], r_px / step_px / template_r_px
    side = n + 2 * shifts
    middle = (side - 1) // 2
    corner_x, corner_y = (x_px - x0_px) / step_px - middle * step, (y_px - y0_px) / step_px - middle * step
    search = _square(bgr, corner_x, corner_y, step, side)
    # The thesis takes both pictures to have zero mean (before eq 3.2); without it CCORR finds whatever is brightest.
    colour = _mean_colour(search)
    maps = six_maps(_less(pixels.reshape(n, 3 * n), colour), rows, _less(search, colour), absolute)
    peaks, found = np.empty((6, 2), np.int64), np.empty((5, 6))
    for k in range(6):
        column, row, dx, dy = _best(maps[k], np.float32(1 if k < 4 else -1))
        x = x_px + (column + dx - shifts) * step * step_px
        y = y_px + (row + dy - shifts) * step * step_px
        peaks[k, 0], peaks[k, 1] = column, row
        found[0, k], found[1, k], found[2, k], found[3, k] = x, y, r_px, maps[k, row, column]
        found[4, k] = _dice(x, y, r_px, claim_x_px, claim_y_px, claim_r_px)
    return maps, peaks, found


def make_template(patch: Patch, circle: Circle, config: MatchingConfig) -> Template:
    """Cut the marker at `circle` (image pixels) out of the patch, brought to a radius of `template_r_px`."""
    local = patch.local(circle)
    step = local.r_px / config.template_r_px
    pixels, rows = cut_disc(patch.bgr, local.x_px, local.y_px, step, config.margin * config.template_r_px)
    return Template(pixels, rows, config.template_r_px, circle)


@dataclass(frozen=True, slots=True)
class Gap:
    """The widest stretch of an outline that shows no edge: its middle and half of it, angles from the circle's centre
    (x to y), radians. What lies beyond its chord counts as hidden, unless the stretch is a quarter or less."""

    towards: float = 0.0
    half: float = 0.0

    @property
    def shown(self) -> float:
        """The share of the disc that is not hidden."""
        return 1.0 if self.half <= _QUARTER else 1 - (2 * self.half - math.sin(2 * self.half)) / (2 * math.pi)


def widest_gap(circle: Circle, edges_px: npt.NDArray[np.float64]) -> Gap:
    """The widest gap between the edge points (N, 2) of a circle's outline, both in image pixels; none where there are
    no points to tell."""
    if len(edges_px) == 0:
        return Gap()
    angles = np.sort(np.arctan2(edges_px[:, 1] - circle.y_px, edges_px[:, 0] - circle.x_px))
    gaps = np.diff(np.append(angles, angles[0] + 2 * math.pi))
    widest = int(gaps.argmax())
    half = float(gaps[widest]) / 2
    return Gap(float(angles[widest]) + half, half)


def less_hidden(template: Template, gap: Gap) -> Template:
    """The template without what lies beyond the chord of a gap in the outline; ours: six matchers that compare with
    what hides a half of the marker outvote the half that shows."""
    if gap.half <= _QUARTER:
        return template
    across, down = math.cos(gap.towards), math.sin(gap.towards)
    rows, middle = template.rows.copy(), (len(template.rows) - 1) // 2
    for i in range(len(rows)):
        # Kept are the columns with across * x + down * y up to the chord's distance from the centre.
        left = template.r_px * math.cos(gap.half) - down * (i - middle)
        if abs(across) < 1e-9:
            first, end = (rows[i, 0], rows[i, 1]) if left >= 0 else (middle, middle)
        elif across > 0:
            first, end = rows[i, 0], min(rows[i, 1], middle + math.floor(left / across) + 1)
        else:
            first, end = max(rows[i, 0], middle + math.ceil(left / across)), rows[i, 1]
        rows[i] = first, max(first, end)
    return Template(template.pixels, rows, template.r_px, template.circle)


def match(
    template: Template,
    patch: Patch,
    around: Circle,
    reach_px: float,
    config: MatchingConfig,
    claim: Circle | None = None,
) -> Matches:
    """Search the patch up to `reach_px` around a circle's centre (image pixels) for the template, and compare what is
    found with a claim.

    The circles found are in image pixels and have the size the marker had when the template was taken, brought to
    the size expected now (`around.r_px`) so that a fast approach is not taken for disagreement. Time and memory grow
    with the square of `reach_px` over the radius: the caller keeps it to about the radius.
    """
    absolute = config.difference == "SAD"
    claimed = _NOTHING if claim is None else claim
    values, peaks, found = search_six(
        patch.bgr, patch.x0_px, patch.y0_px, patch.step_px,
        around.x_px, around.y_px, around.r_px, claimed.x_px, claimed.y_px, claimed.r_px,
        template.r_px, max(1, round(reach_px * template.r_px / around.r_px)), template.pixels, template.rows, absolute,
    )  # fmt: skip
    x, y, r, scores, overlaps = found.tolist()
    circles = tuple(map(Circle, x, y, r))
    return Matches(MATCHERS_SAD if absolute else MATCHERS, values, peaks, tuple(scores), circles, tuple(overlaps))
