"""What the stages saw on one frame of one marker, kept so that a person can see why it was doubted."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrImage, Window


@dataclass(frozen=True, slots=True)
class ResponseMap:
    """One matcher's response over the search patch.

    `values` is (rows, columns) float32 on the matcher's own scale; `best_is_low` for SQDIFF and SAD. `peak` is the
    (column, row) of the best value. `circle` is the vote's circle in image pixels.
    """

    matcher: str
    values: npt.NDArray[np.float32]
    best_is_low: bool
    peak: tuple[int, int]
    circle: Circle


@dataclass(frozen=True, slots=True)
class StageView:
    """Pictures of one marker's stages; all coordinates are image pixels (subtract window.x, window.y for the patch).

    `patch` (h, w, 3) BGR is the searched window; `mask` (h, w) uint8 0 or 255 the colour mask over it, None when the
    colour stage did not run; `hough` the circles Hough proposed, best first; `edges_px` (N, 2) the sub-pixel edge
    points and `edge_weights` (N,) their weights in [0, 1].
    """

    marker: str
    window: Window
    patch: BgrImage
    mask: npt.NDArray[np.uint8] | None
    hough: tuple[Circle, ...]
    edges_px: npt.NDArray[np.float64]
    edge_weights: npt.NDArray[np.float64]
    responses: tuple[ResponseMap, ...]
