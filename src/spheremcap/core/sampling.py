"""Pixels of a frame's planes at any place and scale: what every stage looks at is cut here.

`y`, `u`, `v`, `grid` are `Frame.planes`; beyond the border the border pixel repeats.
"""

import math

import numpy as np

from spheremcap.core.compiled import F8, I8, PLANE, array, inner, kernel

GRID = array(F8, 1)


@inner
def level_at(plane, column, row):
    """Value 0..255 of a plane at a place between its samples, bilinear."""
    rows, columns = plane.shape
    column = min(max(column, 0.0), columns - 1.0)
    row = min(max(row, 0.0), rows - 1.0)
    j, i = int(column), int(row)
    a, b = column - j, row - i
    k, n = min(j + 1, columns - 1), min(i + 1, rows - 1)
    top = plane[i, j] * (1.0 - a) + plane[i, k] * a
    bottom = plane[n, j] * (1.0 - a) + plane[n, k] * a
    return top * (1.0 - b) + bottom * b


@inner
def levels_at(plane, column, row, out):
    """`level_at` for many places (N,), into the first N of `out` float32."""
    rows, columns = plane.shape
    for k in range(column.size):
        x, y = min(max(column[k], 0.0), columns - 1.0), min(max(row[k], 0.0), rows - 1.0)
        j, i = np.uint32(x), np.uint32(y)
        a, b = np.float32(x - j), np.float32(y - i)
        h, n = min(j + 1, columns - 1), min(i + 1, rows - 1)
        top_left, top_right = np.float32(plane[i, j]), np.float32(plane[i, h])
        low_left, low_right = np.float32(plane[n, j]), np.float32(plane[n, h])
        top, low = top_left + a * (top_right - top_left), low_left + a * (low_right - low_left)
        out[k] = top + b * (low - top)


@inner
def soft_levels_at(first, second, column, row):
    """Values of two planes at a place between their samples, by a quadratic B-spline: blurred by half a sample, and by
    as much wherever the place lies."""
    rows, columns = first.shape
    j, i = int(math.floor(column + 0.5)), int(math.floor(row + 0.5))
    a, b = column - j, row - i
    wl, wr = 0.5 * (0.5 - a) * (0.5 - a), 0.5 * (0.5 + a) * (0.5 + a)
    wm = 1.0 - wl - wr
    h, k = min(max(j - 1, 0), columns - 1), min(max(j + 1, 0), columns - 1)
    j = min(max(j, 0), columns - 1)
    top, bottom = 0.5 * (0.5 - b) * (0.5 - b), 0.5 * (0.5 + b) * (0.5 + b)
    one, two = 0.0, 0.0
    for n in range(3):
        line = min(max(i + n - 1, 0), rows - 1)
        share = top if n == 0 else (bottom if n == 2 else 1.0 - top - bottom)
        one += share * (wl * first[line, h] + wm * first[line, j] + wr * first[line, k])
        two += share * (wl * second[line, h] + wm * second[line, j] + wr * second[line, k])
    return one, two


@inner
def neighbours(first, step, count, size):
    """Left neighbour, right neighbour and the right one's share for `count` places along an axis of `size` samples."""
    left, right, share = np.empty(count, np.uint32), np.empty(count, np.uint32), np.empty(count, np.float32)
    for k in range(count):
        place = min(max(first + k * step, 0.0), size - 1.0)
        left[k] = int(place)
        right[k] = min(int(place) + 1, size - 1)
        share[k] = place - int(place)
    return left, right, share


@inner
def _levels(plane, left, top, right, bottom):
    """The rows `top` to `bottom` and columns `left` to `right` of a plane, the last ones included, as float32."""
    out = np.empty((bottom - top + 1, right - left + 1), np.float32)
    for i in range(out.shape[0]):
        source, line = plane[top + i, left : right + 1], out[i]
        for j in range(line.size):
            line[j] = source[j]
    return out


@inner
def _bilinear(plane, column, row, across, down, out):
    """Fill `out` (height, width) float32 from places that start at (column, row), `across` and `down` apart."""
    (rows, columns), (height, width) = plane.shape, out.shape
    j, k, a = neighbours(column, across, width, columns)
    i, n, b = neighbours(row, down, height, rows)
    levels = _levels(plane, j[0], i[0], k[-1], n[-1])
    blend = np.empty(levels.shape[1], np.float32)
    for r in range(height):
        above, below, low, line = levels[i[r] - i[0]], levels[n[r] - i[0]], b[r], out[r]
        for q in range(blend.size):
            blend[q] = above[q] + low * (below[q] - above[q])
        for c in range(width):
            left = blend[j[c] - j[0]]
            line[c] = left + a[c] * (blend[k[c] - j[0]] - left)


@inner
def _mean_of_nearest(plane, column, row, across, down, sub, out):
    """As `_bilinear`, but each place is the mean of the sub x sub nearest samples spread over its step."""
    (rows, columns), (height, width) = plane.shape, out.shape
    start = 0.5 / sub - 0.5  # the first of the places within one, and half a sample more to round by
    j, _, _ = neighbours(column + start * across + 0.5, across / sub, width * sub, columns)
    i, _, _ = neighbours(row + start * down + 0.5, down / sub, height * sub, rows)
    total, part = np.empty(j[-1] - j[0] + 1, np.float32), np.float32(1.0 / (sub * sub))
    for r in range(height):
        total[:] = 0
        for p in range(r * sub, r * sub + sub):
            line = plane[i[p], j[0] : j[-1] + 1]
            for q in range(total.size):
                total[q] += line[q]
        line = out[r]
        line[:] = 0
        for n in range(sub):
            for c in range(width):
                line[c] += part * total[j[c * sub + n] - j[0]]


@inner
def _resampled(plane, column, row, across, down, width, height):
    """(height, width) float32 from places that start at (column, row), bilinear; where a place stands for two and a
    half samples or more, the mean of the 2 x 2 or 3 x 3 nearest samples spread over it."""
    out = np.empty((height, width), np.float32)
    if across < 2.5:
        _bilinear(plane, column, row, across, down, out)
    else:
        _mean_of_nearest(plane, column, row, across, down, 2 if across < 5.0 else 3, out)
    return out


@kernel(None, PLANE, PLANE, PLANE, GRID, F8, F8, F8, I8, I8)
def cut_bgr(y, u, v, grid, x0_px, y0_px, step_px, width, height):
    """(height, width, 3) BGR uint8; its pixel (i, j) is the picture around (x0_px + j step_px, y0_px + i step_px).
    Both sizes are at least 1."""
    sx, sy, ox, oy = grid[0], grid[1], grid[2], grid[3]
    column, row, across, down = (x0_px - ox) / sx, (y0_px - oy) / sy, step_px / sx, step_px / sy
    luma = _resampled(y, x0_px, y0_px, step_px, step_px, width, height)
    cb = _resampled(u, column, row, across, down, width, height)
    cr = _resampled(v, column, row, across, down, width, height)
    out = np.empty((height, width, 3), np.uint8)
    m = grid[4:].astype(np.float32)
    for r in range(height):
        for c in range(width):
            for k in range(3):
                value = m[4 * k] * luma[r, c] + m[4 * k + 1] * cb[r, c] + m[4 * k + 2] * cr[r, c] + m[4 * k + 3]
                out[r, c, k] = np.uint8(min(max(value, np.float32(0)), np.float32(255)) + np.float32(0.5))
    return out


@inner
def bgr_at(y, u, v, grid, column, row):
    """Blue, green, red (0..255, not clipped) at a place between pixels."""
    luma = level_at(y, column, row)
    cb = level_at(u, (column - grid[2]) / grid[0], (row - grid[3]) / grid[1])
    cr = level_at(v, (column - grid[2]) / grid[0], (row - grid[3]) / grid[1])
    return (
        grid[4] * luma + grid[5] * cb + grid[6] * cr + grid[7],
        grid[8] * luma + grid[9] * cb + grid[10] * cr + grid[11],
        grid[12] * luma + grid[13] * cb + grid[14] * cr + grid[15],
    )


@inner
def clipped(value):
    """A colour value as 8 bits can hold it, 0..255."""
    return min(max(value, 0.0), 255.0)


@inner
def hsv_of(blue, green, red):
    """Hue 0..180 (2 degrees a step), saturation and value 0..255, as OpenCV's 8-bit HSV but not rounded."""
    high, low = max(blue, green, red), min(blue, green, red)
    span = high - low
    saturation = 255.0 * span / high if high > 0.0 else 0.0
    if span <= 0.0:
        return 0.0, saturation, high
    if high == red:
        hue = 30.0 * (green - blue) / span
    elif high == green:
        hue = 60.0 + 30.0 * (blue - red) / span
    else:
        hue = 120.0 + 30.0 * (red - green) / span
    return hue + 180.0 if hue < 0.0 else hue, saturation, high
