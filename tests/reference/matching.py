"""The six maps by OpenCV and NumPy, and the search picture, which the compiled ones must equal."""

import cv2
import numpy as np


def disc_of(rows):
    """(n, n) float32, 1 in the columns rows[i, 0] to rows[i, 1] - 1 of row i."""
    columns = np.arange(len(rows))
    return ((columns >= rows[:, :1]) & (columns < rows[:, 1:])).astype(np.float32)


def square(bgr, x0, y0, step, side):
    """(side, side, 3) float32: the patch at (x0 + j step, y0 + i step), bilinear, its border repeated."""
    sub = max(1, round(step))
    at = ((np.arange(side * sub) + 0.5) / sub - 0.5) * step
    height, width = bgr.shape[:2]
    x, y = np.clip(x0 + at, 0, width - 1), np.clip(y0 + at, 0, height - 1)
    j, i = x.astype(int), y.astype(int)
    a, b = (x - j)[None, :, None], (y - i)[:, None, None]
    k, n = np.minimum(j + 1, width - 1), np.minimum(i + 1, height - 1)
    source = bgr.astype(np.float64)
    top = source[i][:, j] * (1 - a) + source[i][:, k] * a
    bottom = source[n][:, j] * (1 - a) + source[n][:, k] * a
    fine = top * (1 - b) + bottom * b
    return fine.reshape(side, sub, side, sub, 3).mean(axis=(1, 3)).astype(np.float32)


def six_maps(template, search, difference="SQDIFF", disc=None):
    """All six response maps (rows, columns) of a template (n, n, 3) over a search picture (m, m, 3).

    Of template and window only the pixels count where `disc` (n, n) is 1; all of them for None. Normalised maps are 0
    where the window or the template has no energy (SQDIFF_NORMED: 1), CCOEFF_NORMED where one has an even colour.
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
    g_variance = squares - (sums * sums).sum(axis=2) / pixels
    uneven = (f_variance > 1e-5 * f_power) & (g_variance > 1e-5 * squares)
    spread = np.sqrt(np.where(uneven, g_variance * f_variance, 1))
    coefficient = cross - sums @ (f_sums / np.float32(pixels))
    energy = np.sqrt(np.maximum(squares * f_power, 1e-6))
    sqdiff = np.maximum(f_power + squares - 2 * cross, 0)
    maps = {
        "CCORR": cross,
        "CCORR_NORMED": cross / energy,
        "CCOEFF": coefficient,
        "CCOEFF_NORMED": np.where(uneven, coefficient / spread, 0),
    }
    if difference == "SAD":
        total = sad(template, search, disc)
        return maps | {"SAD": total, "SAD_NORMED": total / np.maximum(np.sqrt(energy * pixels), 1e-6)}
    return maps | {"SQDIFF": sqdiff, "SQDIFF_NORMED": np.minimum(sqdiff / energy, 1)}


def sad(template, search, disc):
    """Eq 3.5 over three channels."""
    windows = np.lib.stride_tricks.sliding_window_view(search, template.shape[:2], axis=(0, 1))
    return (np.abs(windows - np.moveaxis(template, 2, 0)) * disc).sum(axis=(2, 3, 4))


def peak(values):
    """Column and row of the greatest value, and the parabolic offsets of the true peak from it."""
    row, column = np.unravel_index(values.argmax(), values.shape)
    dy = dx = 0.0
    if 0 < row < values.shape[0] - 1:
        dy = vertex(*values[row - 1 : row + 2, column])
    if 0 < column < values.shape[1] - 1:
        dx = vertex(*values[row, column - 1 : column + 2])
    return int(column), int(row), dx, dy


def vertex(left, middle, right):
    """Where the parabola through values at -1, 0, 1 is greatest, at most half a step off; 0 where it has no top."""
    bend = float(left) - 2 * float(middle) + float(right)
    return 0.0 if bend >= 0 else max(-0.5, min(0.5, 0.5 * (float(left) - float(right)) / bend))
