"""Cameras: pixel <-> ray, with plumb-bob or fisheye distortion. Optical frame: x right, y down, z forward."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
DistortionModel = Literal["none", "plumb_bob", "fisheye"]
_COEFFICIENTS = {"none": (0,), "plumb_bob": (4, 5, 8), "fisheye": (4,)}


@dataclass(frozen=True)
class Camera:
    """A calibrated camera for pictures of one size, in pixels of that picture (integer = pixel centre).

    `distortion` is (k1, k2, p1, p2[, k3[, k4, k5, k6]]) for plumb_bob (Brown-Conrady, as ROS and OpenCV have it),
    (k1, k2, k3, k4) for fisheye (Kannala-Brandt), empty for none. `focal_sd` is the relative standard deviation of
    the focal length (0.03 for "about 3 %"; 0 when the calibration's own error is below the measurement's).
    `source` says where the numbers come from.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    model: DistortionModel = "none"
    distortion: tuple[float, ...] = ()
    focal_sd: float = 0.0
    source: str = "given"

    def __post_init__(self) -> None:
        if len(self.distortion) not in _COEFFICIENTS[self.model]:
            wanted = " or ".join(map(str, _COEFFICIENTS[self.model]))
            raise ValueError(f"{self.model} distortion takes {wanted} coefficients, not {len(self.distortion)}")
        for size in (self.width_px, self.height_px):
            if not 1 <= size <= 65_535:
                raise ValueError(f"a picture is 1 to 65535 pixels wide and high, not {self.width_px}x{self.height_px}")
        if not all(0 < focal <= 1e6 for focal in (self.fx_px, self.fy_px)):
            raise ValueError(f"focal lengths must be positive, up to a million pixels, not {self.fx_px}, {self.fy_px}")
        if not (abs(self.cx_px) <= 10 * self.width_px and abs(self.cy_px) <= 10 * self.height_px):
            raise ValueError(
                f"the principal point {self.cx_px}, {self.cy_px} is nowhere near a picture of "
                f"{self.width_px}x{self.height_px}"
            )
        if not all(abs(k) <= 1e6 for k in self.distortion):
            raise ValueError(f"distortion coefficients {self.distortion} are no numbers that a lens can have")
        if not 0 <= self.focal_sd <= 1:
            raise ValueError(f"the focal length's relative uncertainty is 0 to 1, not {self.focal_sd}")

    @cached_property
    def matrix(self) -> FloatArray:
        """K, (3, 3), pixels."""
        return np.array([[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1]], np.float64)

    @cached_property
    def _coefficients(self) -> FloatArray:
        return np.array(self.distortion, np.float64)

    @cached_property
    def holds_to(self) -> float:
        """The distance from the axis, x/z and y/z, up to which the distortion model holds: beyond, there is no pixel.

        That is where it would fold back, and never more than twice as far out as the picture's farthest corner: a
        polynomial fitted inside the picture says nothing of what lies far outside. Infinite without distortion.
        """
        if self.model == "none":
            return np.inf
        x = max(self.cx_px, self.width_px - 1 - self.cx_px) / self.fx_px
        y = max(self.cy_px, self.height_px - 1 - self.cy_px) / self.fy_px
        corner = float(np.hypot(x, y))  # as bent, and so within the model's own reach
        r = np.linspace(0, min(8 * corner, 50.0), 4001)
        bent = self._bent(r)
        rising = np.diff(bent) > 0
        fold = r[-1] if rising.all() else float(r[int(rising.argmin())])
        seen = r[bent >= corner]
        return min(fold, 2 * float(seen[0]) if len(seen) else fold)

    def _bent(self, r: FloatArray) -> FloatArray:
        """Distance from the axis in the picture of points `r` from it, both as x/z; radial terms only."""
        if self.model == "fisheye":
            k1, k2, k3, k4 = self.distortion
            theta = np.arctan(r)
            t2 = theta * theta
            return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        k = self._padded
        r2 = r * r
        with np.errstate(divide="ignore", invalid="ignore"):
            return r * (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))

    @cached_property
    def _padded(self) -> FloatArray:
        k = np.zeros(8)
        k[: len(self.distortion)] = self.distortion
        return k

    @cached_property
    def params(self) -> FloatArray:
        """All that the compiled loops (`core.lens`) need, (14,): fx, fy, cx, cy, the model (0 none, 1 plumb_bob, 2
        fisheye), eight distortion coefficients, `holds_to`."""
        model = list(_COEFFICIENTS).index(self.model)
        own = [self.fx_px, self.fy_px, self.cx_px, self.cy_px, model, *self._padded, self.holds_to]
        return np.array(own, np.float64)

    def scaled(self, width_px: int, height_px: int) -> "Camera":
        """The same camera for pictures resized to another size: edges scale, so pixel centres shift."""
        sx, sy = width_px / self.width_px, height_px / self.height_px
        return Camera(
            width_px, height_px, self.fx_px * sx, self.fy_px * sy,
            (self.cx_px + 0.5) * sx - 0.5, (self.cy_px + 0.5) * sy - 0.5,
            self.model, self.distortion, self.focal_sd, self.source,
        )  # fmt: skip

    def normalise(self, points_px: FloatArray) -> FloatArray:
        """Undistorted normalised coordinates (N, 2), x/z and y/z, of pixels (N, 2). NaN where the model has no ray."""
        points = np.asarray(points_px, np.float64).reshape(-1, 2)
        if self.model == "none":
            return (points - (self.cx_px, self.cy_px)) / (self.fx_px, self.fy_px)
        if self.model == "fisheye":
            out = cv2.fisheye.undistortPoints(points[:, None], self.matrix, self._coefficients)
            out = np.where(np.abs(out) > 1e5, np.nan, out)
        else:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
            out = cv2.undistortPoints(points[:, None], self.matrix, self._coefficients, criteria=criteria)
        normal = np.asarray(out, np.float64)[:, 0]
        # What the search for it ended at is the pixel's ray only if it is seen there.
        back = self.project(np.concatenate([normal, np.ones((len(normal), 1))], axis=1))
        return np.where(np.abs(back - points).max(axis=1, keepdims=True) < 1e-3, normal, np.nan)

    def rays(self, points_px: FloatArray) -> FloatArray:
        """Unit rays (N, 3) in the optical frame through pixels (N, 2)."""
        normal = self.normalise(points_px)
        rays = np.concatenate([normal, np.ones((len(normal), 1))], axis=1)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def project(self, xyz_cam_m: FloatArray) -> FloatArray:
        """Pixels (N, 2) of points (N, 3) in the optical frame; NaN for points at or behind the camera's plane, and for
        those farther out than the lens model holds."""
        xyz = np.asarray(xyz_cam_m, np.float64).reshape(-1, 3)
        z = np.where(xyz[:, 2] > 1e-9, xyz[:, 2], np.nan)
        a, b = xyz[:, 0] / z, xyz[:, 1] / z
        a = np.where(np.hypot(a, b) <= self.holds_to, a, np.nan)
        if self.model == "plumb_bob":
            k = self._padded
            r2 = a * a + b * b
            radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
            a, b = (
                a * radial + 2 * k[2] * a * b + k[3] * (r2 + 2 * a * a),
                b * radial + k[2] * (r2 + 2 * b * b) + 2 * k[3] * a * b,
            )
        elif self.model == "fisheye":
            r = np.hypot(a, b)
            theta = np.arctan(r)
            t2 = theta * theta
            k1, k2, k3, k4 = self.distortion
            bent = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            scale = np.where(r > 1e-12, bent / np.maximum(r, 1e-12), 1.0)
            a, b = a * scale, b * scale
        b = np.where(np.isnan(a), np.nan, b)
        return np.stack([a * self.fx_px + self.cx_px, b * self.fy_px + self.cy_px], axis=1)
