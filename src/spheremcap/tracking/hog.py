"""Histograms of oriented gradients with 31 features a cell.

Felzenszwalb, Girshick, McAllester, Ramanan: Object Detection with Discriminatively Trained Part-Based Models,
PAMI 2010, section 6: 18 contrast-sensitive and 9 insensitive orientations and 4 gradient energies.
"""

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

_ORIENTATIONS = 9
_TRUNCATE = 0.2  # section 6.2
_ENERGY_WEIGHT = 0.2357  # 1 / sqrt(18): the paper's weight of the four energy features
FEATURES = 3 * _ORIENTATIONS + 4


@lru_cache(maxsize=8)
def _spread(cells: int, cell_px: int) -> npt.NDArray[np.float32]:
    """(cells, cells * cell_px): how much of each pixel row falls to each cell, linearly interpolated."""
    pixels = (np.arange(cells * cell_px) + 0.5) / cell_px - 0.5
    return np.maximum(0, 1 - np.abs(pixels[None, :] - np.arange(cells)[:, None])).astype(np.float32)


def hog(image: npt.NDArray[np.uint8], cell_px: int) -> npt.NDArray[np.float32]:
    """Features (31, rows, columns) of an image (rows * cell_px, columns * cell_px, 3) BGR or single-channel."""
    rows, columns = image.shape[0] // cell_px, image.shape[1] // cell_px
    channels = np.atleast_3d(image)
    # Central differences; where there are several channels the strongest gradient counts (section 6.1).
    dx_all = cv2.Sobel(channels, cv2.CV_32F, 1, 0, ksize=1)
    dy_all = cv2.Sobel(channels, cv2.CV_32F, 0, 1, ksize=1)
    dx_all, dy_all = np.atleast_3d(dx_all), np.atleast_3d(dy_all)
    power = dx_all * dx_all + dy_all * dy_all
    if channels.shape[2] > 1:
        best = power.argmax(axis=2)[..., None]
        dx = np.take_along_axis(dx_all, best, 2)[..., 0]
        dy = np.take_along_axis(dy_all, best, 2)[..., 0]
        magnitude = np.sqrt(np.take_along_axis(power, best, 2)[..., 0])
    else:
        dx, dy, magnitude = dx_all[..., 0], dy_all[..., 0], np.sqrt(power[..., 0])
    bins = 2 * _ORIENTATIONS
    angle = cv2.phase(dx, dy) * np.float32(bins / (2 * np.pi))
    orientation = (angle + 0.5).astype(np.int64) % bins

    layers = np.zeros((bins, *magnitude.shape), np.float32)
    flat = layers.reshape(bins, -1)
    flat[orientation.ravel(), np.arange(flat.shape[1])] = magnitude.ravel()
    cells = _spread(rows, cell_px) @ layers @ _spread(columns, cell_px).T  # (18, rows, columns)

    unsigned = cells[:_ORIENTATIONS] + cells[_ORIENTATIONS:]
    energy = np.pad(np.einsum("orc,orc->rc", unsigned, unsigned), 1, mode="edge")
    block = energy[:-1, :-1] + energy[1:, :-1] + energy[:-1, 1:] + energy[1:, 1:]
    norm = 1.0 / np.sqrt(block + 1e-4)
    # The four blocks that a cell belongs to (equation 3 of the paper), each truncated on its own.
    out = np.zeros((FEATURES, rows, columns), np.float32)
    for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        n = norm[i : i + rows, j : j + columns]
        signed = np.minimum(cells * n, _TRUNCATE)
        out[:bins] += signed
        out[bins : 3 * _ORIENTATIONS] += np.minimum(unsigned * n, _TRUNCATE)
        out[3 * _ORIENTATIONS + k] = _ENERGY_WEIGHT * signed.sum(axis=0)
    out[: 3 * _ORIENTATIONS] *= 0.5
    return out
