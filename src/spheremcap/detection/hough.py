"""Gradient circle Hough in the tracked patch (thesis section 2.4.1, eq 2.20).

Every edge pixel votes for the centres that lie along its gradient within the radii sought; the radius of a centre is
the distance at which most edge pixels face it.
"""

import numpy as np
from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.compiled import BGR, F8, I8, inner, kernel
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig

REFERENCE_R_PX = 20.0
"""The radius of the thesis' markers, for which its parameters were found."""
_HAIR = 1e-9  # pixels: what lies on a border counts as beyond it, however the sums that led there were rounded


class HoughConfig(StageConfig):
    """(dp, minDist, param1, param2) = (4, 1, 77, 1) is the thesis' optimum on 240 frames (eq 2.20).

    All four are those of a marker of 20 px radius in the picture's own pixels. dp, minDist and param2 scale with the
    marker's radius in the patch, whatever the patch's scale, so a marker is found alike far and near. param1 is a
    gradient per pixel of the picture: in a patch that is finer than the picture it scales with the patch's step; in
    one that is coarser it stays, since an edge is no wider than a pixel there.
    """

    enabled: bool = Field(True, description="false leaves detection to colour, KCF and the prediction")
    dp: float = Field(4.0, ge=1, description="accumulator cell, pixels at a radius of 20 px")
    min_dist_px: float = Field(1.0, gt=0, description="least distance between centres, pixels at a radius of 20 px")
    param1: float = Field(77.0, gt=0, description="upper Canny threshold (|Gx| + |Gy|, 3 x 3 Sobel), grey levels")
    param2: float = Field(1.0, gt=0, description="accumulator threshold, votes at a radius of 20 px")
    radius_window: float = Field(0.25, gt=0, lt=1, description="radius searched: expected +- this share; ours")
    keep: int = Field(3, ge=1, description="circles handed on, most votes first; ours")


@inner
def _gradients(bgr, x0, y0, width, height):
    """3 x 3 Sobel gradients (height, width) int16 of a part's luma, 0 on its border, along x and y."""
    gray = np.empty((height, width), np.int16)
    for i in range(height):
        for j in range(width):
            pixel = bgr[y0 + i, x0 + j]  # BT.601, as OpenCV rounds it
            gray[i, j] = (3735 * pixel[0] + 19235 * pixel[1] + 9798 * pixel[2] + 16384) >> 15
    gx, gy = np.zeros((height, width), np.int16), np.zeros((height, width), np.int16)
    for i in range(1, height - 1):
        above, here, below = gray[i - 1], gray[i], gray[i + 1]
        for j in range(1, width - 1):
            right = above[j + 1] + 2 * here[j + 1] + below[j + 1]
            gx[i, j] = right - (above[j - 1] + 2 * here[j - 1] + below[j - 1])
            gy[i, j] = below[j - 1] + 2 * below[j] + below[j + 1] - (above[j - 1] + 2 * above[j] + above[j + 1])
    return gx, gy


@inner
def _edges(gx, gy, low, high):
    """Canny's edges: (N, 4) float64 column, row and unit gradient of the pixels that are greatest along their gradient
    and above `high`, or above `low` and connected with one that is."""
    height, width = gx.shape
    size = np.empty((height, width), np.int32)
    for i in range(height):
        for j in range(width):
            size[i, j] = abs(np.int32(gx[i, j])) + abs(np.int32(gy[i, j]))
    state = np.zeros((height, width), np.uint8)  # 1: may be an edge, 2: is one
    rows, columns = np.empty(height * width, np.int32), np.empty(height * width, np.int32)
    count = 0
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            m = size[i, j]
            if m <= low:
                continue
            ax, ay = abs(gx[i, j]), abs(gy[i, j])
            if ay <= 0.41421356 * ax:  # within 22.5 degrees of the row
                edge = m > size[i, j - 1] and m >= size[i, j + 1]
            elif ax <= 0.41421356 * ay:
                edge = m > size[i - 1, j] and m >= size[i + 1, j]
            else:
                side = -1 if (gx[i, j] < 0) != (gy[i, j] < 0) else 1
                edge = m > size[i - 1, j - side] and m > size[i + 1, j + side]
            if edge:
                state[i, j] = 1
                if m > high:
                    state[i, j] = 2
                    rows[count], columns[count], count = i, j, count + 1
    k = 0
    while k < count:
        for i in range(rows[k] - 1, rows[k] + 2):
            for j in range(columns[k] - 1, columns[k] + 2):
                if state[i, j] == 1:
                    state[i, j] = 2
                    rows[count], columns[count], count = i, j, count + 1
        k += 1
    out = np.empty((count, 4))
    for k in range(count):
        x, y = float(gx[rows[k], columns[k]]), float(gy[rows[k], columns[k]])
        norm = np.sqrt(x * x + y * y)
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = columns[k], rows[k], x / norm, y / norm
    return out


@inner
def _radius(edges, x, y, low, high):
    """The radius within low..high at which most edge pixels, for its length, face (x, y), and how many do: those in
    three bins of a pixel each, and their mean."""
    bins = int(high - low + _HAIR) + 1
    counts, sums = np.zeros(bins + 2), np.zeros(bins + 2)
    for k in range(edges.shape[0]):
        dx, dy = edges[k, 0] - x, edges[k, 1] - y
        d = np.sqrt(dx * dx + dy * dy)
        if low - _HAIR <= d <= high + _HAIR and abs(dx * edges[k, 2] + dy * edges[k, 3]) > 0.9 * d:
            n = 1 + min(int(d - low + _HAIR), bins - 1)
            counts[n] += 1
            sums[n] += d
    best, best_share, radius = 0.0, 0.0, 0.0
    for n in range(1, bins + 1):
        count = counts[n - 1] + counts[n] + counts[n + 1]
        if count == 0:
            continue
        mean = (sums[n - 1] + sums[n] + sums[n + 1]) / count
        if count / mean > best_share:
            best, best_share, radius = count, count / mean, mean
    return radius, best


@kernel(None, BGR, I8, I8, I8, I8, F8, F8, F8, F8, F8, F8, I8)
def vote_circles(bgr, x0, y0, x1, y1, low, high, dp, least_distance, threshold, least_votes, keep):
    """(N, 3) float64 centre and radius of circles, most votes first and at most `keep`, with radii low..high in the
    columns x0..x1-1 and rows y0..y1-1 of a patch (h, w, 3) BGR; all in patch pixels.

    `dp` is the accumulator's cell, `threshold` Canny's upper one in grey levels (the lower is half of it). A centre is
    the mean place of the votes in and around a cell that has more than `least_votes` and more than its neighbours.
    """
    width, height = x1 - x0, y1 - y0
    gx, gy = _gradients(bgr, x0, y0, width, height)
    edges = _edges(gx, gy, 0.5 * threshold, threshold)
    columns, rows = int(width / dp) + 3, int(height / dp) + 3  # with an empty border
    votes, sum_x, sum_y = np.zeros((rows, columns)), np.zeros((rows, columns)), np.zeros((rows, columns))
    for k in range(edges.shape[0]):
        for sign in (-1.0, 1.0):
            r = low
            while r <= high + _HAIR:
                x, y = edges[k, 0] + sign * r * edges[k, 2], edges[k, 1] + sign * r * edges[k, 3]
                r += 1.0
                across, down = x + 0.5 + _HAIR, y + 0.5 + _HAIR
                if across < 0.0 or down < 0.0 or across >= width or down >= height:
                    break
                i, j = 1 + int(down / dp), 1 + int(across / dp)
                votes[i, j] += 1
                sum_x[i, j] += x
                sum_y[i, j] += y
    tops, count = np.empty((rows * columns, 3)), 0  # votes and mean place of each peak
    for i in range(1, rows - 1):
        for j in range(1, columns - 1):
            peak = votes[i, j]
            if peak <= least_votes or peak < votes[i + 1, j] or peak < votes[i, j + 1]:
                continue
            if peak <= votes[i - 1, j] or peak <= votes[i, j - 1]:
                continue
            total, x, y = 0.0, 0.0, 0.0
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    total, x, y = total + votes[a, b], x + sum_x[a, b], y + sum_y[a, b]
            tops[count, 0], tops[count, 1], tops[count, 2], count = peak, x / total, y / total, count + 1
    out, n = np.empty((keep, 3)), 0
    for _ in range(count):
        top = 0
        for k in range(count):
            if tops[k, 0] > tops[top, 0]:
                top = k
        x, y = tops[top, 1], tops[top, 2]
        tops[top, 0] = -1.0  # seen
        apart = True
        for k in range(n):
            apart = apart and (x - out[k, 0]) ** 2 + (y - out[k, 1]) ** 2 >= least_distance * least_distance
        if not apart:
            continue
        radius, support = _radius(edges, x, y, low, high)
        if support > least_votes:
            out[n, 0], out[n, 1], out[n, 2], n = x, y, radius, n + 1
            if n == keep:
                break
    for k in range(n):
        out[k, 0] += x0
        out[k, 1] += y0
    return out[:n]


def hough_circles(patch: Patch, expected: Circle, config: HoughConfig) -> tuple[Circle, ...]:
    """Circles in image pixels near `expected` in place and size, most votes first; empty when there is none.

    Only the part of the patch that such circles can touch is searched.
    """
    local = patch.local(expected)
    height, width = patch.bgr.shape[:2]
    half, r = 1.6 * local.r_px + 2, local.r_px
    x0, y0 = max(0, int(local.x_px - half)), max(0, int(local.y_px - half))
    x1, y1 = min(width, int(local.x_px + half) + 2), min(height, int(local.y_px + half) + 2)
    if x1 - x0 < 3 or y1 - y0 < 3:
        return ()
    scale = r / REFERENCE_R_PX
    found = vote_circles(
        patch.bgr, x0, y0, x1, y1, r * (1 - config.radius_window), r * (1 + config.radius_window),
        max(1.0, config.dp * scale), config.min_dist_px * scale, config.param1 * min(1.0, patch.step_px),
        config.param2 * scale, config.keep,
    )  # fmt: skip
    return tuple(patch.in_picture(Circle(*circle)) for circle in found.tolist())
