"""HOG with 31 features a cell (Felzenszwalb et al. 2010, section 6) by whole arrays."""

import numpy as np


def hog(image, cell_px):
    """Features (31, rows, columns) float64 of an image (rows * cell_px, columns * cell_px, 3)."""
    rows, columns = image.shape[0] // cell_px, image.shape[1] // cell_px
    wide = np.pad(image.astype(np.float64), ((1, 1), (1, 1), (0, 0)), mode="reflect")
    dx_all, dy_all = wide[1:-1, 2:] - wide[1:-1, :-2], wide[2:, 1:-1] - wide[:-2, 1:-1]
    strongest = (dx_all**2 + dy_all**2).argmax(axis=2)[..., None]
    dx, dy = (np.take_along_axis(d, strongest, 2)[..., 0] for d in (dx_all, dy_all))
    turns = np.arctan2(dy, dx) / (2 * np.pi) % 1
    orientation = np.floor(turns * 18 + 0.5 + 1e-9).astype(int) % 18  # 1e-9: what lies on an edge counts to the next
    layers = (orientation == np.arange(18)[:, None, None]) * np.hypot(dx, dy)
    cells = _shares(rows, cell_px) @ layers @ _shares(columns, cell_px).T

    unsigned = cells[:9] + cells[9:]
    energy = np.pad((unsigned**2).sum(axis=0), 1, mode="edge")
    block = energy[:-1, :-1] + energy[1:, :-1] + energy[:-1, 1:] + energy[1:, 1:]
    norm = 1 / np.sqrt(block + 1e-4)
    out = np.zeros((31, rows, columns))
    for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        n = norm[i : i + rows, j : j + columns]
        signed = np.minimum(cells * n, 0.2)
        out[:18] += 0.5 * signed
        out[18:27] += 0.5 * np.minimum(unsigned * n, 0.2)
        out[27 + k] = 0.2357 * signed.sum(axis=0)
    return out


def _shares(cells, cell_px):
    """(cells, cells * cell_px): how much of each pixel row falls to each cell, linearly interpolated."""
    pixels = (np.arange(cells * cell_px) + 0.5) / cell_px - 0.5
    return np.maximum(0, 1 - np.abs(pixels[None, :] - np.arange(cells)[:, None]))
