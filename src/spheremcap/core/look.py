"""What one marker's step read on one frame, before anything is decided."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.core.optics import Motion
from spheremcap.core.view import ResponseMap
from spheremcap.core.vote import Verdict, Vote

FloatArray = npt.NDArray[np.float64]
AGREES = 0.3
"""Least weight of an edge point that counts as the outline's."""


@dataclass(frozen=True, slots=True)
class EdgePoints:
    """Edge points in image pixels (N, 2), the standard deviation of each along its normal (N,) in pixels, and the ray
    each came from (N,). Rays without an edge, or out of the picture, have none. `rays` is how many rays lay inside
    the picture; `offset_px` (N,) how far outside the expected outline each point is; `explained` the share in [0, 1]
    of the profiles' variance that the blurred step explains, a measure of how well the blur is known."""

    points_px: FloatArray
    sd_px: FloatArray
    ray: npt.NDArray[np.intp]
    offset_px: FloatArray
    rays: int
    explained: float


@dataclass(frozen=True, slots=True)
class Measured:
    """A circle (pixels, as seen), its place in space (optical frame) and what speaks for it.

    `visible` is the share of the outline that shows an edge, `edge_weights` (N,) and `edges_outside_px` (N,) what the
    fit made of the edge points: weight in [0, 1], and how far outside the fitted outline. `motion` is the blur and lean
    with which the edges were found. `proposer` names the stage whose circle it was. `in_picture` is the share of the
    outline that lies inside the picture at all. Of a marker that is followed, the place is the likeliest given outline
    and expected distance, which matters where little of the outline is seen; `alone` is then what the outline says by
    itself.
    """

    circle: Circle
    circle_sd_px: tuple[float, float, float]
    xyz_cam_m: FloatArray
    covariance_m2: FloatArray
    visible: float
    proposer: str
    edges: EdgePoints
    edge_weights: FloatArray
    edges_outside_px: FloatArray
    motion: Motion
    in_picture: float = 1.0
    alone: tuple[FloatArray, FloatArray] | None = None

    @property
    def agreeing(self) -> npt.NDArray[np.bool_]:
        """Which of the edge points (N,) count as the outline's."""
        return self.edge_weights > AGREES

    @property
    def outline_alone(self) -> tuple[FloatArray, FloatArray]:
        """Place (3,) and covariance (3, 3) that the outline has by itself: what the Kalman filter, who made the
        expectation, may take in."""
        return self.alone or (self.xyz_cam_m, self.covariance_m2)


@dataclass(frozen=True, slots=True)
class Expected:
    """What the Kalman filter expects of a frame: the `circle` in the picture, as seen; its standard deviation in
    pixels, the larger of x and y; the distance in metres and its standard deviation, relative; its velocity (2,) in
    px/s; the time since the frame before; what lens and shutter make of it; and how far from the circle the marker is
    looked for."""

    circle: Circle
    spread_px: float
    range_m: float
    range_sd: float
    rate_px: FloatArray
    interval_s: float
    motion: Motion
    reach_px: float


@dataclass(frozen=True, slots=True)
class Look:
    """All that was read of one marker at one place of one frame; nothing is decided yet.

    `around` is where it was looked for, on `patch`, at the marker's own scale. `proposals` are the stages' circles by
    name, `hough` all of Hough's, `claim` the one with an outline, measured, or None. `votes` are the six matchers'
    (of `maps`), `vote_sum` their sum in [0, 6], and `doubts` the names of the checks that the claim fails so far.
    `limits` are the marker's colours on this patch; None where colour is not asked. `elsewhere` says that it is not
    where a marker that is followed was expected, but where one that was missed or lost may have gone.
    """

    around: Circle
    patch: Patch
    proposals: tuple[tuple[str, Circle], ...]
    hough: tuple[Circle, ...]
    limits: FloatArray | None
    claim: Measured | None
    maps: Iterable[ResponseMap]
    votes: tuple[Vote, ...]
    vote_sum: float
    verdict: Verdict
    doubts: tuple[str, ...]
    elsewhere: bool = False


def foremost(looks: Iterable[Look]) -> Look | None:
    """The look by which a frame without a verified circle is told: the one where the marker was expected, else the one
    with the most votes."""
    return min(looks, key=lambda look: (look.elsewhere, -look.vote_sum), default=None)
