"""The kernelized correlation filter by NumPy's FFT in float64 (eq 2.12-2.17 as corrected in docs/method.md)."""

import numpy as np

from reference.hog import hog


class Kcf:
    """`spheremcap.tracking.kcf.Kcf` for one window: `locate` looks at no ring."""

    def __init__(self, config):
        self.config = config
        self.n = config.grid_cells
        self.size = self.n * config.cell_px
        hann = np.hanning(self.n + 2)[1:-1]
        self.hann = np.outer(hann, hann)
        steps = np.minimum(np.arange(self.n), self.n - np.arange(self.n))
        sigma = config.target_sigma * self.n / (1 + config.padding)
        self.target_f = np.fft.fft2(np.exp(-0.5 * (steps[:, None] ** 2 + steps[None, :] ** 2) / sigma**2))
        self.x = self.alpha_f = None

    def train(self, patch, circle):
        x = self.features(patch, circle)
        alpha_f = self.target_f / (np.fft.fft2(self.kernel(x, x)) + self.config.regularisation)
        rate = self.config.learning_rate if self.x is not None else 1
        self.x = x if rate == 1 else (1 - rate) * self.x + rate * x
        self.alpha_f = alpha_f if rate == 1 else (1 - rate) * self.alpha_f + rate * alpha_f

    def locate(self, patch, circle):
        """Shift (right, down) in picture pixels and the answer there."""
        k_f = np.fft.fft2(self.kernel(self.x, self.features(patch, circle)))
        response = np.fft.ifft2(k_f * self.alpha_f).real
        row, column = np.unravel_index(response.argmax(), response.shape)
        log = np.log(np.maximum(response, 1e-6))
        rows, columns = (
            log[np.arange(row - 1, row + 2) % self.n, column],
            log[row, np.arange(column - 1, column + 2) % self.n],
        )
        cell_px = 2 * (1 + self.config.padding) * circle.r_px / self.n
        right, down = self.signed(column) + vertex(*columns), self.signed(row) + vertex(*rows)
        return right * cell_px, down * cell_px, response[row, column]

    def features(self, patch, circle):
        """(31, n, n): HOG under the cosine window."""
        at, step = patch.local(circle), 2 * (1 + self.config.padding) * circle.r_px / patch.step_px / self.size
        places = (np.arange(self.size) - (self.size - 1) / 2) * step
        columns, rows = (np.round(v + places, 9) for v in (at.x_px, at.y_px))  # a whole pixel is one, rounding or not
        return hog(bilinear(patch.bgr, columns, rows), self.config.cell_px) * self.hann

    def kernel(self, x, z):
        """k^xz (n, n): eq 2.16 or 2.17, per element, clipped at 0."""
        cross = np.fft.ifft2((np.fft.fft2(x).conj() * np.fft.fft2(z)).sum(axis=0)).real
        if self.config.kernel == "linear":
            return cross / x.size
        return np.exp(-np.maximum(0, (x**2).sum() + (z**2).sum() - 2 * cross) / x.size / self.config.sigma**2)

    def signed(self, index):
        return index - self.n if index >= self.n // 2 else index


def vertex(left, mid, right):
    bend = left - 2 * mid + right
    return 0.0 if bend >= 0 else np.clip(0.5 * (left - right) / bend, -0.5, 0.5)


def bilinear(image, columns, rows):
    """(len(rows), len(columns), 3) of an image between its pixels; beyond the border the border pixel repeats."""
    columns, rows = np.clip(columns, 0, image.shape[1] - 1), np.clip(rows, 0, image.shape[0] - 1)
    j, i = columns.astype(int), rows.astype(int)
    k, n = np.minimum(j + 1, image.shape[1] - 1), np.minimum(i + 1, image.shape[0] - 1)
    a, b = (columns - j)[None, :, None], (rows - i)[:, None, None]
    image = image.astype(np.float64)
    top = image[i][:, j] + a * (image[i][:, k] - image[i][:, j])
    low = image[n][:, j] + a * (image[n][:, k] - image[n][:, j])
    return top + b * (low - top)
