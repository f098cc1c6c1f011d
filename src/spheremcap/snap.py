"""What the chain would make of a person's circle on one frame: shown before anything is tracked."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame, Patch, Window
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.detection.appearance import contrast
from spheremcap.detection.colour import box_mask
from spheremcap.session import check_answers

_AROUND = 3.0  # radii that the mask's window reaches from the circle's centre


@dataclass(frozen=True, slots=True)
class Snap:
    """A person's circle, sharpened by the chain's edge step, and what the chain learns there.

    `circle` is the person's own where no outline agrees with it (`visible` is then 0), else as the edges have it, with
    its standard deviations `circle_sd_px` (x, y, radius). `visible` is the share of the outline that shows an edge.
    `contrast` is how far the colours around differ from the marker's, in the median over a ring about it: CIE 1976
    colour difference in L*a*b* (about 2 is just seen, 100 is black to white); NaN where no such ring is in the picture.
    `against` names what speaks against its being a sphere, as a seed's `reasons` do: "little outline", "no outline".
    `limits` (6,) are the colours learnt: hue's mean and half-width (steps of 2 degrees), least and greatest saturation
    and value (0..255), infinite where there is no limit. `mask` (h, w) uint8 is 255 where the picture has them, on
    `window`. Place and distance (metres, optical frame, with a standard deviation that includes the focal length's) are
    None where the camera is not known.
    """

    circle: Circle
    circle_sd_px: tuple[float, float, float]
    visible: float
    contrast: float
    against: tuple[str, ...]
    limits: npt.NDArray[np.float64]
    window: Window
    mask: npt.NDArray[np.uint8]
    xyz_cam_m: npt.NDArray[np.float64] | None
    distance_m: float | None
    distance_sd_m: float | None


def snapped(
    frame: Frame,
    circle: Circle,
    spec: MarkerSpec,
    camera: Camera,
    chain: ChainConfig,
    *,
    metric: bool = True,
    exposure_s: float = 0.0,
    readout_s: float | None = None,
) -> Snap:
    """The circle as a chain that is seeded with it has it. Raises UsageError for one outside the picture."""
    check_answers([Seed(spec.name, frame.index, circle)], [spec.name], frame.width_px, frame.height_px)
    marker = MarkerChain(spec, camera, chain, exposure_s, metric, readout_s)
    seeded = marker.seed(frame, circle)
    assert seeded.circle is not None
    assert seeded.circle_sd_px is not None
    window = Window.around(seeded.circle, _AROUND * seeded.circle.r_px).clipped(frame.width_px, frame.height_px)
    patch = Patch(frame, window)
    limits = marker.colours(patch, seeded.circle)
    distance_m = distance_sd_m = None
    if seeded.xyz_cam_m is not None and seeded.covariance_m2 is not None:
        distance_m = float(np.linalg.norm(seeded.xyz_cam_m))
        ray = seeded.xyz_cam_m / distance_m
        distance_sd_m = math.sqrt(float(ray @ seeded.covariance_m2 @ ray))
    return Snap(
        seeded.circle,
        seeded.circle_sd_px,
        seeded.visible or 0.0,
        contrast(patch, seeded.circle),
        seeded.reasons,
        limits,
        window,
        box_mask(patch.bgr, limits),
        seeded.xyz_cam_m,
        distance_m,
        distance_sd_m,
    )
