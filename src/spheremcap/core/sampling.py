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
def _places(first, step, count, size):
    """Left neighbour, right neighbour and the right one's share for `count` places along an axis of `size` samples."""
    left, right, share = np.empty(count, np.uint32), np.empty(count, np.uint32), np.empty(count, np.float32)
    for k in range(count):
        place = min(max(first + k * step, 0.0), size - 1.0)
        left[k] = int(place)
        right[k] = min(int(place) + 1, size - 1)
        share[k] = place - int(place)
    return left, right, share


@inner
def _resampled(plane, column, row, across, down, width, height, out):
    """Fill `out` (height, width) float32 from places that start at (column, row), bilinear; where a place stands for
    two and a half samples or more, with the mean of the 2 x 2 or 3 x 3 nearest samples spread over it."""
    rows, columns = plane.shape
    sub = 1 if across < 2.5 else (2 if across < 5.0 else 3)
    if sub == 1:
        j, k, a = _places(column, across, width, columns)
        i, n, b = _places(row, down, height, rows)
        for r in range(height):
            top, bottom, low = plane[i[r]], plane[n[r]], b[r]
            for c in range(width):
                left = top[j[c]] + low * (np.float32(bottom[j[c]]) - np.float32(top[j[c]]))
                right = top[k[c]] + low * (np.float32(bottom[k[c]]) - np.float32(top[k[c]]))
                out[r, c] = left + a[c] * (right - left)
        return
    start = 0.5 / sub - 0.5  # the first of the places within one, and half a sample more to round by
    j, _, _ = _places(column + start * across + 0.5, across / sub, width * sub, columns)
    i, _, _ = _places(row + start * down + 0.5, down / sub, height * sub, rows)
    part = np.float32(1.0 / (sub * sub))
    for r in range(height):
        for c in range(width):
            total = np.uint32(0)
            for m in range(sub):
                line = plane[i[r * sub + m]]
                for n in range(sub):
                    total += line[j[c * sub + n]]
            out[r, c] = part * total


@kernel(None, PLANE, PLANE, PLANE, GRID, F8, F8, F8, I8, I8)
def cut_bgr(y, u, v, grid, x0_px, y0_px, step_px, width, height):
    """(height, width, 3) BGR uint8; its pixel (i, j) is the picture around (x0_px + j step_px, y0_px + i step_px)."""
    luma, cb, cr = (
        np.empty((height, width), np.float32),
        np.empty((height, width), np.float32),
        np.empty((height, width), np.float32),
    )
    sx, sy, ox, oy = grid[0], grid[1], grid[2], grid[3]
    _resampled(y, x0_px, y0_px, step_px, step_px, width, height, luma)
    _resampled(u, (x0_px - ox) / sx, (y0_px - oy) / sy, step_px / sx, step_px / sy, width, height, cb)
    _resampled(v, (x0_px - ox) / sx, (y0_px - oy) / sy, step_px / sx, step_px / sy, width, height, cr)
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
