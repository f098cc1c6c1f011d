"""Where chroma lies across its two columns of pixels, by what a picture shows.

Streams hardly ever say it. H.264 and its kin mean the left column; whoever makes 4:2:0 from RGB (FFmpeg's scaler,
OpenCV's writer) puts it midway, half a pixel to the right, and says nothing. In small windows chroma follows brightness
along a straight line, as predictors of chroma from luma in video coding have it (CCLM: Zhang et al., IEEE Transactions
on Image Processing 27(8), 2018), and best where brightness is read at chroma's own place.
"""

import cv2
import numpy as np
import numpy.typing as npt

Plane = npt.NDArray[np.uint8]

_PLACES = np.arange(-1.0, 2.01, 0.5)  # columns of brightness from chroma's left one
_SIGMA = 1.0  # columns: the same blur wherever brightness is read, so that no place is favoured
_WINDOW = 7  # chroma samples a side
_VARIES = 12.0  # least variance of chroma in a window that counts, code values squared
_FOLLOWS = 0.85  # least share of it that brightness explains
_NOISE = 1.0  # variance, code values squared
_LEAST_WINDOWS = 60
_PARTS = 16  # of the windows, for the estimate's own standard deviation
_MIDWAY = 0.5
_SURE = 3.0  # standard deviations


def lies_midway(y: Plane, u: Plane, v: Plane) -> bool:
    """Whether chroma (half as many columns as y, as many rows or half) lies midway between its columns, and not on the
    left one; False where the picture does not tell."""
    place, sd = chroma_place(y, u, v)
    return bool(place - _SURE * sd > 0.6 * _MIDWAY)


def chroma_place(y: Plane, u: Plane, v: Plane) -> tuple[float, float]:
    """Columns by which chroma lies right of the left one of its two, and the standard deviation of that; NaN where the
    picture has too few windows that tell."""
    rows, columns = u.shape
    light = y.astype(np.float32)
    if len(y) > rows:  # 4:2:0
        pairs = light[: 2 * (len(y) // 2)].reshape(-1, 2, y.shape[1])
        light = pairs.mean(axis=1)
    rows, columns = min(rows, len(light)), min(columns, light.shape[1] // 2)
    if min(rows, columns) < _WINDOW:
        return np.nan, np.nan
    light = light[:rows, : 2 * columns]
    planes = [plane[:rows, :columns].astype(np.float32) for plane in (u, v)]
    spread = [_mean(plane * plane) - _mean(plane) ** 2 for plane in planes]
    left_over = np.empty((2, len(_PLACES), *spread[0].shape), np.float32)
    columns_around = np.arange(-4, 5)
    for k, place in enumerate(_PLACES):
        taps = np.exp(-0.5 * ((columns_around - place) / _SIGMA) ** 2)
        read = np.asarray(cv2.filter2D(light, -1, (taps / taps.sum())[None])[:, ::2], np.float32)
        mean, square = _mean(read), _mean(read * read)
        for which, plane in enumerate(planes):
            both = _mean(read * plane) - mean * _mean(plane)
            left_over[which, k] = spread[which] - both**2 / (square - mean**2 + _NOISE)
    misfit = []
    for which, variance in enumerate(spread):
        rest = np.maximum(left_over[which], 0.0)
        tells = (variance > _VARIES) & (rest.min(axis=0) < (1 - _FOLLOWS) * variance)
        misfit.append(np.log(rest[:, tells] + 0.02 * variance[tells] + _NOISE))
    windows = np.concatenate(misfit, axis=1)
    count = windows.shape[1]
    if count < _LEAST_WINDOWS:
        return np.nan, np.nan
    total = windows.sum(axis=1)
    without = np.array([_lowest(total - windows[:, part::_PARTS].sum(axis=1)) for part in range(_PARTS)])  # jackknife
    return _lowest(total), float(np.sqrt((_PARTS - 1) * np.var(without)))


def _mean(plane: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Means over windows side by side."""
    half = _WINDOW // 2
    return np.asarray(cv2.blur(plane, (_WINDOW, _WINDOW))[half::_WINDOW, half::_WINDOW], np.float32)


def _lowest(misfit: npt.NDArray[np.float32]) -> float:
    """The place of the least misfit, by a parabola through it and its neighbours."""
    k = int(np.clip(np.argmin(misfit), 1, len(_PLACES) - 2))
    before, least, after = (float(value) for value in misfit[k - 1 : k + 2])
    bend = before - 2 * least + after
    return float(_PLACES[k] + (0.25 * (before - after) / bend if bend > 0 else 0.0))
