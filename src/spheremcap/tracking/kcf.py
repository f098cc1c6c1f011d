"""Kernelized correlation filter on HOG features: where the marker's patch has moved to.

Henriques, Caseiro, Martins, Batista: High-Speed Tracking with Kernelized Correlation Filters, PAMI 2015 (thesis
eq 2.12-2.17 as corrected in docs/method.md). The filter lives on a grid of fixed size that is laid over the picture
in units of the marker's radius, so a change of size is a change of the grid's scale.

A spectrum here is (n, 2, n // 2 + 1, LANES): horizontal frequency, real and imaginary part, vertical frequency (the
half that a real signal has), and channel. What has one channel has no last axis and is float64.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator

from spheremcap.core.circle import Circle
from spheremcap.core.compiled import BGR, F4, F8, I8, array, inner, kernel
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig
from spheremcap.tracking.hog import FEATURES, LANES, hog_into

_MOST_RINGS = 2
_WHOLE = 0.004  # patch pixels that a grid may lie beside the patch's own pixels and still take them as they are


class KcfConfig(StageConfig):
    """Defaults are table 2 of Henriques et al. 2015 for HOG unless a line says otherwise."""

    enabled: bool = Field(True, description="false: the Kalman filter alone says where to look (ablation)")
    kernel: Literal["gaussian", "linear"] = Field("gaussian", description="gaussian is KCF, linear is DCF")
    padding: float = Field(1.5, ge=0.5, le=4, description="window side is (1 + padding) marker diameters")
    cell_px: int = Field(4, ge=2, le=8, description="HOG cell, grid pixels")
    grid_cells: int = Field(16, ge=8, le=32, description="grid side in cells, even; ours, the paper uses the picture's")
    sigma: float = Field(0.5, gt=0, description="Gaussian kernel width (eq 2.17)")
    regularisation: float = Field(1e-4, gt=0, description="lambda of eq 2.15")
    target_sigma: float = Field(0.1, gt=0, description="target width over sqrt of the marker's area in cells")
    train_every: int = Field(4, ge=1, description="verified frames to one training; ours, neighbours are alike")
    learning_rate: float = Field(0.02, ge=0, le=1, description="share of the new patch in the model")

    @field_validator("grid_cells")
    @classmethod
    def _is_even(cls, cells: int) -> int:
        if cells % 2:
            raise ValueError(f"grid_cells is {cells}, expected an even number: take {cells - 1} or {cells + 1}")
        return cells


@dataclass(frozen=True, slots=True)
class KcfResponse:
    """Where the filter answers most: the circle moved there, and the answer (1 is the training patch itself)."""

    circle: Circle
    peak: float


class Kcf:
    """One marker's filter. Train it on verified circles only; `locate` never changes it."""

    def __init__(self, config: KcfConfig) -> None:
        self.config = config
        n = config.grid_cells
        self._grid_px = n * config.cell_px
        self._cell_px = config.cell_px
        self._ring_px = int(0.8 * config.padding / (2 * (1 + config.padding)) * self._grid_px)
        self._sigma = config.sigma if config.kernel == "gaussian" else 0.0
        hann = np.hanning(n + 2)[1:-1]
        self._window = np.outer(hann, hann).astype(np.float32)
        angle = 2 * np.pi / n * (np.outer(np.arange(n), np.arange(n)) % n)
        self._waves = np.stack([np.cos(angle), np.sin(angle)])
        sigma = config.target_sigma * n / (1 + config.padding)
        steps = np.minimum(np.arange(n), n - np.arange(n))
        target = np.exp(-0.5 * (steps[:, None] ** 2 + steps[None, :] ** 2) / sigma**2)
        self._target_f = _spectrum_of(target, self._waves)
        half = n // 2 + 1
        self._untrained = np.zeros((n, 2, half, LANES), np.float32), np.zeros((n, 2, half)), 0.0
        self._model: tuple[npt.NDArray[np.float32], npt.NDArray[np.float64], float] | None = None
        """x-hat, alpha-hat and the sum of x^2."""

    @property
    def trained(self) -> bool:
        return self._model is not None

    def half_side_px(self, r_px: float) -> float:
        """Half the side of the window that the filter looks at, in picture pixels, for a marker of this radius."""
        return (1 + self.config.padding) * r_px

    def train(self, patch: Patch, circle: Circle) -> None:
        """Learn the marker at `circle` (image pixels): the first time fully, later by the learning rate."""
        x, y, step = self._grid(patch, circle)
        rate = 1.0 if self._model is None else self.config.learning_rate
        self._model = _train(
            patch.bgr, x, y, step, self._cell_px, self._window, self._waves, *(self._model or self._untrained),
            self._sigma, self._target_f, self.config.regularisation, rate,
        )  # fmt: skip

    def locate(self, patch: Patch, expected: Circle, reach_px: float) -> KcfResponse:
        """The strongest answer around `expected` (image pixels), the radius kept.

        One window sees shifts up to about its padding; for a larger `reach_px` a ring of windows is laid around.
        Raises RuntimeError before the first training.
        """
        if self._model is None:
            raise RuntimeError("the filter has not been trained")
        x, y, step = self._grid(patch, expected)
        px = step * patch.step_px
        rings = min(_MOST_RINGS, max(0, math.ceil(reach_px / (self._ring_px * px)) - 1))
        dx, dy, peak = _locate(
            patch.bgr, x, y, step, self._cell_px, self._window, self._waves, *self._model, self._sigma, rings,
            self._ring_px,
        )  # fmt: skip
        return KcfResponse(expected.shifted(dx * px, dy * px), peak)

    def _grid(self, patch: Patch, circle: Circle) -> tuple[float, float, float]:
        """Where the grid's first pixel lies around a circle, and its step, in patch pixels."""
        local = patch.local(circle)
        step = 2 * self.half_side_px(local.r_px) / self._grid_px
        aside = (self._grid_px - 1) / 2 * step
        return local.x_px - aside, local.y_px - aside, step


@inner
def _cut(bgr, x, y, step, out):
    """Fill the inside of `out` (3, size + 2, size + 2) float32 from places `step` apart that start at patch pixel
    (x, y): as they are where these are the patch's pixels, else bilinear. Beyond the border the border repeats."""
    rows, columns = bgr.shape[0], bgr.shape[1]
    size = out.shape[1] - 2
    if abs(step - 1.0) * size < _WHOLE and abs(x - round(x)) < _WHOLE and abs(y - round(y)) < _WHOLE:
        left, top = round(x), round(y)
        for r in range(size):
            i = min(max(top + r, 0), rows - 1)
            for c in range(size):
                j = min(max(left + c, 0), columns - 1)
                for k in range(3):
                    out[k, r + 1, c + 1] = bgr[i, j, k]
        return
    for r in range(size):
        row = min(max(y + r * step, 0.0), rows - 1.0)
        i = int(row)
        n, b = min(i + 1, rows - 1), np.float32(row - i)
        for c in range(size):
            column = min(max(x + c * step, 0.0), columns - 1.0)
            j = int(column)
            m, a = min(j + 1, columns - 1), np.float32(column - j)
            for k in range(3):
                top = bgr[i, j, k] + a * (np.float32(bgr[i, m, k]) - np.float32(bgr[i, j, k]))
                low = bgr[n, j, k] + a * (np.float32(bgr[n, m, k]) - np.float32(bgr[n, j, k]))
                out[k, r + 1, c + 1] = top + b * (low - top)


@inner
def _features(bgr, x, y, step, cell_px, window):
    """Windowed features (n, n, LANES) float32 of the grid that starts at patch pixel (x, y)."""
    n = window.shape[0]
    planes = np.empty((3, n * cell_px + 2, n * cell_px + 2), np.float32)
    _cut(bgr, x, y, step, planes)
    out = np.empty((n, n, LANES), np.float32)
    hog_into(planes, cell_px, out)
    for i in range(n):
        for j in range(n):
            for b in range(LANES):
                out[i, j, b] *= window[i, j]
    return out


@inner
def _add(total, part, share):
    for k in range(np.uint32(total.size)):
        total[k] += share * part[k]


@inner
def _spectra(features, waves):
    """Spectrum of each channel of (n, n, LANES), by the definition of the transform.

    A term and its mirror image share their cosine and differ in the sign of their sine, so their sum and their
    difference are transformed, half as many.
    """
    n = features.shape[0]
    half, mid = n // 2 + 1, n // 2
    lines = features.reshape(n, n * LANES)
    even, odd = np.empty((half, n * LANES), np.float32), np.empty((half, n * LANES), np.float32)
    _fold(lines, even, odd)
    down = np.zeros((2, half, n * LANES), np.float32)
    for k in range(half):
        for i in range(half):
            _add(down[0, k], even[i], np.float32(waves[0, k, i]))
        for i in range(1, mid):
            _add(down[1, k], odd[i], np.float32(-waves[1, k, i]))

    size = half * LANES
    columns = np.empty((n, 2 * size), np.float32)
    for j in range(n):
        for part in range(2):
            for k in range(half):
                columns[j, part * size + k * LANES : part * size + (k + 1) * LANES] = down[
                    part, k, j * LANES : (j + 1) * LANES
                ]
    even, odd = np.empty((half, 2 * size), np.float32), np.empty((half, 2 * size), np.float32)
    _fold(columns, even, odd)
    out = np.empty((n, 2 * size), np.float32)
    cosine, sine = np.empty(2 * size, np.float32), np.empty(2 * size, np.float32)
    for m in range(half):
        cosine[:], sine[:] = np.float32(0), np.float32(0)
        for j in range(half):
            _add(cosine, even[j], np.float32(waves[0, m, j]))
        for j in range(1, mid):
            _add(sine, odd[j], np.float32(waves[1, m, j]))
        here, mirrored = out[m], out[(n - m) % n]
        for k in range(size):
            here[k], mirrored[k] = cosine[k] + sine[size + k], cosine[k] - sine[size + k]
        for k in range(size):
            here[size + k], mirrored[size + k] = cosine[size + k] - sine[k], cosine[size + k] + sine[k]
    return out.reshape(n, 2, half, LANES)


@inner
def _fold(lines, even, odd):
    """Sums and differences of each line and its mirror image; the first and the middle one have none."""
    n = lines.shape[0]
    for i in range(even.shape[0]):
        a, b = lines[i], lines[(n - i) % n]
        alone = np.float32(0.5) if i == (n - i) % n else np.float32(1)
        for k in range(a.size):
            even[i, k], odd[i, k] = alone * (a[k] + b[k]), a[k] - b[k]


@inner
def _forward(signal, waves):
    """Spectrum (n, 2, n // 2 + 1) of a signal (n, n) with one channel."""
    n = signal.shape[0]
    half = n // 2 + 1
    out = np.empty((n, 2, half))
    real, imaginary = np.empty(n), np.empty(n)
    for k in range(half):
        real[:], imaginary[:] = 0.0, 0.0
        for i in range(n):
            for j in range(n):
                real[j] += waves[0, k, i] * signal[i, j]
                imaginary[j] -= waves[1, k, i] * signal[i, j]
        for m in range(n):
            a, b = 0.0, 0.0
            for j in range(n):
                a += waves[0, m, j] * real[j] + waves[1, m, j] * imaginary[j]
                b += waves[0, m, j] * imaginary[j] - waves[1, m, j] * real[j]
            out[m, 0, k], out[m, 1, k] = a, b
    return out


@inner
def _inverse(spectrum, waves):
    """The signal (n, n) behind a spectrum (n, 2, n // 2 + 1) with one channel."""
    n, half = spectrum.shape[0], spectrum.shape[2]
    out = np.zeros((n, n))
    real, imaginary = np.empty(n), np.empty(n)
    for k in range(half):
        real[:], imaginary[:] = 0.0, 0.0
        for m in range(n):
            a, b = spectrum[m, 0, k], spectrum[m, 1, k]
            for j in range(n):
                real[j] += a * waves[0, m, j] - b * waves[1, m, j]
                imaginary[j] += a * waves[1, m, j] + b * waves[0, m, j]
        twice = (1.0 if k in (0, n // 2) else 2.0) / (n * n)
        for i in range(n):
            c, s = twice * waves[0, k, i], twice * waves[1, k, i]
            for j in range(n):
                out[i, j] += c * real[j] - s * imaginary[j]
    return out


@inner
def _correlation(x_f, x_power, z_f, z_power, sigma, waves):
    """Spectrum of k^xz: eq 2.17 over the number of elements and clipped at 0; eq 2.16 alone where sigma is 0."""
    n, half = x_f.shape[0], x_f.shape[2]
    elements = FEATURES * n * n
    cross_f = np.empty((n, 2, half))
    for m in range(n):
        for k in range(half):
            xr, xi, zr, zi = x_f[m, 0, k], x_f[m, 1, k], z_f[m, 0, k], z_f[m, 1, k]
            real, imaginary = np.float32(0), np.float32(0)
            for b in range(LANES):
                real += xr[b] * zr[b] + xi[b] * zi[b]
                imaginary += xr[b] * zi[b] - xi[b] * zr[b]
            cross_f[m, 0, k], cross_f[m, 1, k] = real / elements, imaginary / elements
    if sigma == 0.0:
        return cross_f
    k_xz = _inverse(cross_f, waves)
    mean = (x_power + z_power) / elements
    for i in range(n):
        for j in range(n):
            k_xz[i, j] = math.exp(-max(0.0, mean - 2.0 * k_xz[i, j]) / (sigma * sigma))
    return _forward(k_xz, waves)


@inner
def _power(values):
    total = np.float32(0)
    for value in values.reshape(values.size):
        total += value * value
    return np.float64(total)


@inner
def _spectral_power(x_f):
    """Sum of squares of the signal behind a spectrum (Parseval)."""
    n, half = x_f.shape[0], x_f.shape[2]
    total = 0.0
    for m in range(n):
        for part in range(2):
            for k in range(half):
                total += (1.0 if k in (0, half - 1) else 2.0) * _power(x_f[m, part, k])
    return total / (n * n)


@inner
def _vertex(left, mid, right):
    """Offset in [-0.5, 0.5] of the vertex of the parabola through the logarithms of three answers, the middle one the
    largest: the target is a Gaussian, whose logarithm is a parabola."""
    left, mid, right = math.log(max(left, 1e-6)), math.log(max(mid, 1e-6)), math.log(max(right, 1e-6))
    bend = left - 2.0 * mid + right
    return 0.0 if bend >= 0.0 else max(-0.5, min(0.5, 0.5 * (left - right) / bend))


@inner
def _peak(response):
    """Where a response (n, n) is largest, as a shift (right, down) in cells between -n/2 and n/2, and its value."""
    n = response.shape[0]
    row, column = 0, 0
    for i in range(n):
        for j in range(n):
            if response[i, j] > response[row, column]:
                row, column = i, j
    here = response[row, column]
    down = _vertex(response[(row - 1) % n, column], here, response[(row + 1) % n, column])
    right = _vertex(response[row, (column - 1) % n], here, response[row, (column + 1) % n])
    return (column + n // 2) % n - n // 2 + right, (row + n // 2) % n - n // 2 + down, here


@inner
def _response(bgr, x, y, step, cell_px, window, waves, model_f, alpha_f, power, sigma):
    """The filter's answer (n, n) at every shift of the grid that starts at patch pixel (x, y), in cells.

    f(z) = F^-1(conj(k^xz-hat) . alpha-hat) when k^xz = F^-1(conj(x-hat) . z-hat) and alpha-hat is real-symmetric;
    with this k a patch that moved by +d peaks at +d.
    """
    z = _features(bgr, x, y, step, cell_px, window)
    k_f = _correlation(model_f, power, _spectra(z, waves), _power(z), sigma, waves)
    n, half = k_f.shape[0], k_f.shape[2]
    for m in range(n):
        for k in range(half):
            a, b, c, d = k_f[m, 0, k], k_f[m, 1, k], alpha_f[m, 0, k], alpha_f[m, 1, k]
            k_f[m, 0, k], k_f[m, 1, k] = a * c - b * d, a * d + b * c
    return _inverse(k_f, waves)


_WAVES, _MODEL, _ALPHA = array(F8, 3), array(F4, 4), array(F8, 3)


@kernel(None, array(F8, 2), _WAVES)
def _spectrum_of(signal, waves):
    return _forward(signal, waves)


@kernel(None, BGR, F8, F8, F8, I8, array(F4, 2), _WAVES, _MODEL, _ALPHA, F8, F8, I8, I8)
def _locate(bgr, x, y, step, cell_px, window, waves, model_f, alpha_f, power, sigma, rings, ring_px):
    """The largest answer of all windows: its shift (right, down) in grid pixels, and its value.

    The grid starts at patch pixel (x, y) and has its pixels `step` apart; `rings` rings of windows lie around it,
    `ring_px` grid pixels from one to the next.
    """
    best = (0.0, 0.0, -np.inf)
    for i in range(-rings, rings + 1):
        for j in range(-rings, rings + 1):
            right, down = j * ring_px, i * ring_px
            response = _response(
                bgr, x + right * step, y + down * step, step, cell_px, window, waves, model_f, alpha_f, power, sigma
            )
            dx, dy, peak = _peak(response)
            if peak > best[2]:
                best = (right + dx * cell_px, down + dy * cell_px, peak)
    return best


@kernel(None, BGR, F8, F8, F8, I8, array(F4, 2), _WAVES, _MODEL, _ALPHA, F8, F8, _ALPHA, F8, F8)
def _train(bgr, x, y, step, cell_px, window, waves, model_f, alpha_f, power, sigma, target_f, ridge, rate):
    """The model (x-hat, alpha-hat, sum of x^2) with a share `rate` of this patch: alpha by eq 2.15, k^xx is even."""
    features = _features(bgr, x, y, step, cell_px, window)
    x_f, own = _spectra(features, waves), _power(features)
    k_f = _correlation(x_f, own, x_f, own, sigma, waves)
    n, half = k_f.shape[0], k_f.shape[2]
    for m in range(n):
        for k in range(half):
            a, b, c, d = target_f[m, 0, k], target_f[m, 1, k], k_f[m, 0, k] + ridge, k_f[m, 1, k]
            square = c * c + d * d
            k_f[m, 0, k] = rate * (a * c + b * d) / square + (1.0 - rate) * alpha_f[m, 0, k]
            k_f[m, 1, k] = rate * (b * c - a * d) / square + (1.0 - rate) * alpha_f[m, 1, k]
    share = np.float32(rate)
    old, new = model_f.reshape(model_f.size), x_f.reshape(x_f.size)
    for k in range(new.size):
        new[k] = share * new[k] + (np.float32(1) - share) * old[k]
    return x_f, k_f, _spectral_power(x_f)
