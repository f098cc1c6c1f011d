"""Camera presets: published numbers for cameras nobody has calibrated, each with its source and its uncertainty."""

from spheremcap.core.camera import Camera

PRESETS: dict[str, Camera] = {
    "gopro-hero4-black-720p240-narrow": Camera(
        1280, 720, 1187.0, 1187.0, 639.5, 359.5, "plumb_bob", (-0.31, 0.17, 0.0, 0.0), 0.03,
        "published HERO4 Black narrow calibration scaled to 1280 px width, distortion of the Silver's; principal point "
        "assumed at the centre; uncalibrated for your camera, distances good to about 3 %",
    ),
    "gopro-hero4-silver-720p-narrow": Camera(
        1280, 720, 1150.0, 1150.0, 639.5, 359.5, "plumb_bob", (-0.31, 0.17, 0.0, 0.0), 0.03,
        "published HERO4 Silver narrow calibration at 1280 px width; principal point assumed at the centre; "
        "uncalibrated for your camera, distances good to about 3 %",
    ),
    "thesis": Camera(
        1280, 720, 2422.54, 2422.54, 639.5, 359.5, "none", (), 0.5,
        "the thesis' f = 34.4 mm and 14.2 um pixels as printed: a 29.6 degree view that a HERO4 does not have; only to "
        "repeat its figures",
    ),
}  # fmt: skip
"""By name. `focal_sd` is the relative standard deviation that goes into every distance's covariance."""


def assumed_camera(width_px: int, height_px: int) -> Camera:
    """A camera for pictures that came with none: 60 degrees across the longer side. For tracking, never for metres."""
    focal = max(width_px, height_px) / 2 / 0.57735
    return Camera(
        width_px, height_px, focal, focal, (width_px - 1) / 2, (height_px - 1) / 2, focal_sd=0.5,
        source="assumed 60 degree view; no camera was given",
    )  # fmt: skip
