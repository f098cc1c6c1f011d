"""From light on the sensor to what the encoder gets: noise, tone curve, noise reduction, sharpening, 4:2:0."""

import math

import cv2
import numba
import numpy as np
import numpy.typing as npt

from spheremcap.core.compiled import F4, array, kernel
from spheremcap.core.frame import BgrImage
from spheremcap.synth.daylight.world import Electronics

Image = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]
_LAYER = array(F4, 3)
_STEPS = 8192  # of the tone curve's table over light 0..2
_BRIGHTEST = 2.0
_MIXED = np.array([0.25, 1.0, 0.25]) / np.sqrt(1.125)  # demosaicing shares noise between neighbours


def tone(light: FloatArray, shoulder: float) -> FloatArray:
    """Code values 0..255 of linear light: sRGB's curve (IEC 61966-2-1) over a shoulder that bends what is above
    `shoulder` towards white without clipping it at once (1: none)."""
    x = np.maximum(light, 0.0)
    if shoulder < 1.0:
        room = 1.0 - shoulder
        x = np.where(x > shoulder, shoulder + room * (1 - np.exp(-(x - shoulder) / room)), x)
    x = np.minimum(x, 1.0)
    return 255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def curve(electronics: Electronics) -> npt.NDArray[np.uint8]:
    """The tone curve as a table over light 0..2 in even steps."""
    return np.rint(tone(np.linspace(0, _BRIGHTEST, _STEPS + 1), electronics.shoulder)).astype(np.uint8)


@kernel(None, _LAYER, _LAYER, F4, F4, F4, array(numba.types.uint8, 1), at_import=False)
def _codes(light, dots, gain, shot, read, table):
    """The picture (height, width, 3) uint8 BGR of light (height, width, 3) RGB, multiplied by `gain`, with noise
    `dots` of unit variance, or none of them (0, width, 3), scaled to the variance shot * light + read."""
    height, width, _ = light.shape
    out = np.empty((height, width, 3), np.uint8)
    scale, last, noisy = np.float32((len(table) - 1) / _BRIGHTEST), np.float32(len(table) - 1), len(dots) > 0
    for r in range(height):
        for c in range(width):
            for k in range(3):
                x = gain * light[r, c, k]
                if noisy:
                    x += dots[r, c, k] * math.sqrt(shot * x + read)
                place = min(max(scale * x + np.float32(0.5), np.float32(0.0)), last)
                out[r, c, 2 - k] = table[np.int32(place)]
    return out


def develop(light: Image, electronics: Electronics, table: npt.NDArray[np.uint8], rng: np.random.Generator) -> BgrImage:
    """The picture (height, width, 3) BGR of light (height, width, 3) linear RGB before the gain.

    Shot noise has the variance of the electrons, read noise its own; both are multiplied by the gain, so that they are
    the stronger the less light there was.
    """
    dots, white_e = light[:0], electronics.full_well_e / electronics.gain
    if electronics.noise:
        dots = rng.standard_normal(light.shape, np.float32)
        dots = cv2.sepFilter2D(dots, -1, _MIXED, _MIXED)  # type: ignore[assignment]
    picture: BgrImage = _codes(light, dots, electronics.gain, 1 / white_e, (electronics.read_e / white_e) ** 2, table)
    if electronics.smooth:
        picture = cv2.bilateralFilter(picture, 5, electronics.smooth, 1.4)  # type: ignore[assignment]
    if electronics.sharpen:
        soft = cv2.GaussianBlur(picture, (0, 0), electronics.sharpen_px)
        picture = cv2.addWeighted(picture, 1 + electronics.sharpen, soft, -electronics.sharpen, 0)  # type: ignore[assignment]
    return np.ascontiguousarray(picture)


_KR, _KB = 0.2126, 0.0722
_FROM_BGR = np.array(
    [
        [219 / 255 * _KB, 219 / 255 * (1 - _KR - _KB), 219 / 255 * _KR, 16],
        [112 / 255, -112 / 255 * (1 - _KR - _KB) / (1 - _KB), -112 / 255 * _KR / (1 - _KB), 128],
        [-112 / 255 * _KB / (1 - _KR), -112 / 255 * (1 - _KR - _KB) / (1 - _KR), 112 / 255, 128],
    ]
)
"""BT.709, limited range, of BGR code values (ITU-R BT.709-6, 3.2 and 3.5)."""


def planes420(picture: BgrImage, siting: str) -> npt.NDArray[np.uint8]:
    """The (height * 3 / 2, width) planes of a BGR picture with even sides. Chroma lies midway between two rows; with
    the "left" siting on the even columns (weights 1 2 1 across), with "centre" midway between two (weights 1 1)."""
    height, width = picture.shape[:2]
    yuv: Image = cv2.transform(picture.astype(np.float32), _FROM_BGR)  # type: ignore[assignment]
    out = np.empty((height * 3 // 2, width), np.uint8)
    out[:height] = np.rint(yuv[..., 0])
    chroma = 0.5 * (yuv[0::2, :, 1:] + yuv[1::2, :, 1:])
    even, odd = chroma[:, 0::2], chroma[:, 1::2]
    if siting == "centre":
        chroma = 0.5 * (even + odd)
    else:
        before = np.concatenate([odd[:, :1], odd[:, :-1]], axis=1)
        chroma = 0.5 * even + 0.25 * (before + odd)
    quarter = height // 2 * (width // 2)
    flat = out[height:].reshape(-1)
    flat[:quarter] = np.rint(chroma[..., 0]).ravel()
    flat[quarter:] = np.rint(chroma[..., 1]).ravel()
    return out
