"""Light as sRGB and as linear light."""

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]


def to_linear(srgb: npt.NDArray[np.floating] | npt.NDArray[np.uint8]) -> FloatArray:
    """Linear light in 0..1 of sRGB values in 0..255."""
    s = np.asarray(srgb, np.float64) / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: npt.NDArray[np.floating]) -> FloatArray:
    """sRGB values in 0..255 of linear light in 0..1."""
    x = np.asarray(linear, np.float64)
    return 255 * np.where(x <= 0.0031308, x * 12.92, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def linear_bgr(rgb: tuple[int, int, int]) -> Image:
    """An sRGB (red, green, blue) colour in 0..255 as linear BGR (3,)."""
    return to_linear(np.array(rgb[::-1], np.float64)).astype(np.float32)
