"""Kernelized correlation filter on HOG features: where the marker's patch has moved to.

Henriques, Caseiro, Martins, Batista: High-Speed Tracking with Kernelized Correlation Filters, PAMI 2015 (thesis
eq 2.12-2.17 as corrected in docs/method.md). The filter lives on a grid of fixed size that is laid over the picture
in units of the marker's radius, so a change of size is a change of the grid's scale.
"""

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field
from scipy import fft

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig
from spheremcap.tracking.hog import hog

Complex = npt.NDArray[np.complex64]


class KcfConfig(StageConfig):
    """Defaults are table 2 of Henriques et al. 2015 for HOG unless a line says otherwise."""

    enabled: bool = Field(True, description="false: the Kalman filter alone says where to look (ablation)")
    kernel: Literal["gaussian", "linear"] = Field("gaussian", description="gaussian is KCF, linear is DCF")
    padding: float = Field(1.5, ge=0.5, le=4, description="window side is (1 + padding) marker diameters")
    cell_px: int = Field(4, ge=2, le=8, description="HOG cell, grid pixels")
    grid_cells: int = Field(16, ge=8, le=32, description="grid side in cells; ours, the paper uses picture pixels")
    sigma: float = Field(0.5, gt=0, description="Gaussian kernel width (eq 2.17)")
    regularisation: float = Field(1e-4, gt=0, description="lambda of eq 2.15")
    target_sigma: float = Field(0.1, gt=0, description="target width over sqrt of the marker's area in cells")
    train_every: int = Field(4, ge=1, description="verified frames to one training; ours, neighbours are alike")
    learning_rate: float = Field(0.02, ge=0, le=1, description="share of the new patch in the model")


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
        hann = np.hanning(n + 2)[1:-1]
        self._window = (hann[:, None] * hann[None, :]).astype(np.float32)
        marker_cells = n / (1 + config.padding)
        sigma = config.target_sigma * marker_cells
        steps = np.minimum(np.arange(n), n - np.arange(n))
        target = np.exp(-0.5 * (steps[:, None] ** 2 + steps[None, :] ** 2) / sigma**2)
        self._target_f: Complex = fft.rfft2(target.astype(np.float32))
        self._model_f: Complex | None = None  # x-hat, (31, n, n//2+1)
        self._alpha_f: Complex | None = None
        self._model_power = 0.0

    @property
    def trained(self) -> bool:
        return self._alpha_f is not None

    def half_side_px(self, r_px: float) -> float:
        """Half the side of the window that the filter looks at, in picture pixels, for a marker of this radius."""
        return (1 + self.config.padding) * r_px

    def train(self, patch: Patch, circle: Circle) -> None:
        """Learn the marker at `circle` (image pixels): the first time fully, later by the learning rate."""
        x_f, power = self._features(patch, circle)
        alpha_f = self._target_f / (self._kernel(x_f, power, x_f, power) + self.config.regularisation)
        if self._model_f is None or self._alpha_f is None:
            self._model_f, self._alpha_f = x_f, alpha_f
        else:
            rate = np.float32(self.config.learning_rate)
            self._model_f = (1 - rate) * self._model_f + rate * x_f
            self._alpha_f = (1 - rate) * self._alpha_f + rate * alpha_f
        self._model_power = _power(self._model_f, self.config.grid_cells)

    def locate(self, patch: Patch, expected: Circle, reach_px: float) -> KcfResponse:
        """The strongest answer around `expected` (image pixels), the radius kept.

        One window sees shifts up to about its padding; for a larger `reach_px` a ring of windows is laid around.
        Raises RuntimeError before the first training.
        """
        if self._model_f is None or self._alpha_f is None:
            raise RuntimeError("the filter has not been trained")
        step = self.config.padding * expected.r_px * 0.8
        rings = min(2, max(0, math.ceil((reach_px - step) / step)))
        best: KcfResponse | None = None
        for i in range(-rings, rings + 1):
            for j in range(-rings, rings + 1):
                answer = self._answer(patch, expected.shifted(j * step, i * step))
                if best is None or answer.peak > best.peak:
                    best = answer
        assert best is not None
        return best

    def _answer(self, patch: Patch, at: Circle) -> KcfResponse:
        assert self._model_f is not None
        assert self._alpha_f is not None
        n = self.config.grid_cells
        z_f, power = self._features(patch, at)
        kernel_f = self._kernel(self._model_f, self._model_power, z_f, power)
        # f(z) = F^-1(conj(k^xz-hat) . alpha-hat) when k^xz = F^-1(conj(x-hat) . z-hat) and alpha-hat is real-symmetric;
        # with this k a patch that moved by +d peaks at +d.
        response = fft.irfft2(kernel_f * self._alpha_f, s=(n, n))
        row, column = np.unravel_index(int(response.argmax()), response.shape)
        peak = float(response[row, column])
        response = np.log(np.maximum(response, 1e-6))  # the target is a Gaussian: its logarithm is a parabola
        dy = _signed(int(row), n) + _parabola(
            response[(row - 1) % n, column], response[row, column], response[(row + 1) % n, column]
        )
        dx = _signed(int(column), n) + _parabola(
            response[row, (column - 1) % n], response[row, column], response[row, (column + 1) % n]
        )
        px_per_cell = 2 * self.half_side_px(at.r_px) / n
        return KcfResponse(at.shifted(dx * px_per_cell, dy * px_per_cell), peak)

    def _features(self, patch: Patch, circle: Circle) -> tuple[Complex, float]:
        """Spectrum (31, n, n//2+1) of the windowed features around the circle, and their power sum x^2."""
        half, size = self.half_side_px(circle.r_px), self._grid_px
        scale = 2 * half / size
        x0, y0 = circle.x_px - patch.window.x - half, circle.y_px - patch.window.y - half
        # Grid pixel i has its centre at (i + 0.5) * scale from the window's edge.
        sample = np.array([[scale, 0, x0 + scale / 2], [0, scale, y0 + scale / 2]], np.float64)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        grid = cv2.warpAffine(patch.bgr, sample, (size, size), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        features = hog(grid, self.config.cell_px) * self._window  # type: ignore[arg-type]
        return fft.rfft2(features), float(np.vdot(features, features))

    def _kernel(self, x_f: Complex, x_power: float, z_f: Complex, z_power: float) -> Complex:
        """Spectrum of k^xz (eq 2.16 linear, eq 2.17 Gaussian; per element, clipped at 0)."""
        n = self.config.grid_cells
        cross_f = np.einsum("cij,cij->ij", x_f.conj(), z_f)
        elements = x_f.shape[0] * n * n
        if self.config.kernel == "linear":
            return cross_f / elements  # type: ignore[no-any-return]
        cross = fft.irfft2(cross_f, s=(n, n))
        distance = np.maximum(0, x_power + z_power - 2 * cross) / elements
        return fft.rfft2(np.exp(-distance / self.config.sigma**2))  # type: ignore[no-any-return]


def _power(x_f: Complex, n: int) -> float:
    """Sum of squares of the signal behind a half spectrum (Parseval), for even n."""
    weight = np.full(x_f.shape[-1], 2.0)
    weight[0] = weight[-1] = 1.0
    return float((np.abs(x_f) ** 2 * weight).sum() / (n * n))


def _signed(index: int, n: int) -> int:
    return index - n if index >= n // 2 else index


def _parabola(left: float, mid: float, right: float) -> float:
    """Offset in [-0.5, 0.5] of the vertex through three samples around a maximum."""
    bend = left - 2 * mid + right
    return 0.0 if bend >= 0 else float(max(-0.5, min(0.5, 0.5 * (left - right) / bend)))
