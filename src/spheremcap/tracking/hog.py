"""Histograms of oriented gradients with 31 features a cell.

Felzenszwalb, Girshick, McAllester, Ramanan: Object Detection with Discriminatively Trained Part-Based Models,
PAMI 2010, section 6: 18 contrast-sensitive and 9 insensitive orientations and 4 gradient energies.
"""

import math

import numpy as np
import numpy.typing as npt

from spheremcap.core.compiled import F4, I8, inner, kernel

_ORIENTATIONS = 9
_BINS = 2 * _ORIENTATIONS
_TRUNCATE = np.float32(0.2)  # section 6.2
_ENERGY_WEIGHT = np.float32(0.2357)  # 1 / sqrt(18): the paper's weight of the four energy features
FEATURES = 3 * _ORIENTATIONS + 4
LANES = 32
"""A cell's features in memory: the 31 and a 0, so that a loop over them fills vector registers."""
_TAN_10, _TAN_30, _TAN_50, _TAN_70 = (np.float32(math.tan(math.radians(edge))) for edge in (10, 30, 50, 70))
_NONE, _ONE, _NINE = np.float32(0), np.float32(1), np.float32(9)


@inner
def hog_into(planes, cell_px, out):
    """Fill `out` (rows, columns, LANES) float32 with the features of a picture.

    `planes` (3, rows * cell_px + 2, columns * cell_px + 2) float32 is its blue, green and red with room for a border,
    which is written here.
    """
    rows, columns = out.shape[0], out.shape[1]
    _mirror(planes)
    out[:] = _NONE
    _histograms(planes, cell_px, out)
    norms = _norms(out)
    for i in range(rows):
        for j in range(columns):
            _normalise(out[i, j], norms[i, j], norms[i, j + 1], norms[i + 1, j], norms[i + 1, j + 1])


@inner
def _mirror(planes):
    """The picture beyond its border is its mirror image about the border pixels, which have no gradient across."""
    for plane in planes:
        plane[0, :], plane[-1, :] = plane[2, :], plane[-3, :]
        plane[:, 0], plane[:, -1] = plane[:, 2], plane[:, -3]


@inner
def _histograms(planes, cell_px, out):
    """Add each pixel's gradient to its bin in the four cells around it, linearly interpolated (section 6.1), and the
    sum of opposite bins behind the 18."""
    rows, columns = out.shape[0], out.shape[1]
    width = columns * cell_px
    cells, shares = np.empty(width, np.uint32), np.empty(width, np.float32)
    for c in range(width):
        place = (c + 0.5) / cell_px + 0.5
        cells[c], shares[c] = int(place), place - int(place)
    length, bins = np.empty(width, np.float32), np.empty(width, np.uint32)
    band = np.empty((columns + 2, LANES), np.float32)  # one pixel row's; its first and last cells are outside
    inside = band[1:-1].reshape(columns * LANES)
    flat = out.reshape(rows, columns * LANES)
    for r in range(rows * cell_px):
        _gradients(planes, r, length, bins)
        band[:] = _NONE
        for c in range(np.uint32(width)):
            j, k = cells[c], bins[c]
            right = shares[c] * length[c]
            band[j, k] += length[c] - right
            band[j + np.uint32(1), k] += right
        place = (r + 0.5) / cell_px - 0.5
        i = math.floor(place)
        if i >= 0:
            _add(flat[i], inside, np.float32(1 - (place - i)))
        if i + 1 < rows:
            _add(flat[i + 1], inside, np.float32(place - i))
    for i in range(rows):
        for j in range(columns):
            cell = out[i, j]
            for b in range(_ORIENTATIONS):
                cell[_BINS + b] = cell[b] + cell[_ORIENTATIONS + b]


@inner
def _add(total, part, share):
    for k in range(np.uint32(total.size)):
        total[k] += share * part[k]


@inner
def _gradients(planes, r, length, bins):
    """Length and bin 0..17 of the strongest channel's central difference, for the pixels of row `r`.

    Bin k holds the directions within 10 degrees of 20 k; straight down is on an edge and counts to 5, up to 14.
    """
    width = length.size
    left0, right0, up0, down0 = _around(planes[0], r, width)
    left1, right1, up1, down1 = _around(planes[1], r, width)
    left2, right2, up2, down2 = _around(planes[2], r, width)
    for c in range(np.uint32(width)):
        dx, dy = right0[c] - left0[c], down0[c] - up0[c]
        x, y = right1[c] - left1[c], down1[c] - up1[c]
        stronger = x * x + y * y > dx * dx + dy * dy
        dx, dy = x if stronger else dx, y if stronger else dy
        x, y = right2[c] - left2[c], down2[c] - up2[c]
        stronger = x * x + y * y > dx * dx + dy * dy
        dx, dy = x if stronger else dx, y if stronger else dy
        length[c] = math.sqrt(dx * dx + dy * dy)
        turn = _NINE if dy < _NONE else _NONE
        dx = -dx if dy < _NONE else dx
        along, across = abs(dx), abs(dy)
        k = _ONE if across > _TAN_10 * along else _NONE
        k += _ONE if across > _TAN_30 * along else _NONE
        k += _ONE if across > _TAN_50 * along else _NONE
        k += _ONE if across > _TAN_70 * along else _NONE
        k = turn + (k if dx > _NONE else _NINE - k)
        bins[c] = np.uint32(np.int32(k if k < _BINS else _NONE))


@inner
def _around(plane, r, width):
    """The neighbours of a row's pixels: left, right, up, down (width,)."""
    return plane[r + 1, :width], plane[r + 1, 2 : width + 2], plane[r, 1 : width + 1], plane[r + 2, 1 : width + 1]


@inner
def _norms(cells):
    """(rows + 1, columns + 1): one over the gradient energy of each block of 2 x 2 cells; border cells repeat."""
    rows, columns = cells.shape[0], cells.shape[1]
    energy = np.empty((rows + 2, columns + 2), np.float32)
    for i in range(rows):
        for j in range(columns):
            cell, total = cells[i, j], _NONE
            for b in range(_BINS, 3 * _ORIENTATIONS):
                total += cell[b] * cell[b]
            energy[i + 1, j + 1] = total
    energy[0, :], energy[-1, :] = energy[1, :], energy[-2, :]
    energy[:, 0], energy[:, -1] = energy[:, 1], energy[:, -2]
    out = np.empty((rows + 1, columns + 1), np.float32)
    for i in range(rows + 1):
        for j in range(columns + 1):
            block = energy[i, j] + energy[i + 1, j] + energy[i, j + 1] + energy[i + 1, j + 1]
            out[i, j] = _ONE / math.sqrt(block + np.float32(1e-4))
    return out


@inner
def _normalise(cell, n0, n1, n2, n3):
    """Bins become features: by each of the cell's four blocks (equation 3 of the paper), truncated on their own."""
    e0, e1, e2, e3 = _NONE, _NONE, _NONE, _NONE
    for b in range(_BINS):
        e0 += min(cell[b] * n0, _TRUNCATE)
        e1 += min(cell[b] * n1, _TRUNCATE)
        e2 += min(cell[b] * n2, _TRUNCATE)
        e3 += min(cell[b] * n3, _TRUNCATE)
    for b in range(LANES):
        a = min(cell[b] * n0, _TRUNCATE) + min(cell[b] * n1, _TRUNCATE)
        a += min(cell[b] * n2, _TRUNCATE) + min(cell[b] * n3, _TRUNCATE)
        cell[b] = np.float32(0.5) * a
    cell[3 * _ORIENTATIONS] = _ENERGY_WEIGHT * e0
    cell[3 * _ORIENTATIONS + 1] = _ENERGY_WEIGHT * e1
    cell[3 * _ORIENTATIONS + 2] = _ENERGY_WEIGHT * e2
    cell[3 * _ORIENTATIONS + 3] = _ENERGY_WEIGHT * e3


@kernel(None, F4[:, :, ::1], I8, F4[:, :, ::1], at_import=False)
def _hog(planes, cell_px, out):
    hog_into(planes, cell_px, out)


def hog(image: npt.NDArray[np.uint8], cell_px: int) -> npt.NDArray[np.float32]:
    """Features (31, rows, columns) of an image (rows * cell_px, columns * cell_px, 3) BGR or single-channel."""
    height, width = image.shape[:2]
    planes = np.empty((3, height + 2, width + 2), np.float32)
    planes[:, 1:-1, 1:-1] = np.moveaxis(np.atleast_3d(image), 2, 0)
    features = np.empty((height // cell_px, width // cell_px, LANES), np.float32)
    _hog(planes, cell_px, features)
    return np.moveaxis(features[..., :FEATURES], 2, 0)
