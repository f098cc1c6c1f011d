"""A sphere's outline and its centre: a cone of rays tangent to the sphere (docs/method.md section 4).

Everything is in the camera's optical frame (x right, y down, z forward), metres, radians; picture points in pixels.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.stage import StageConfig

FloatArray = npt.NDArray[np.float64]


class PositionConfig(StageConfig):
    """How a marker's place in metres is found from its outline."""

    formula: Literal["edges", "circle", "thesis"] = Field(
        "edges",
        description="edges: tangent cone through the edge points; circle: Penne et al. 2019 from area and centre; "
        "thesis: eq 3.12 with the constant below",
    )
    thesis_constant_px: float = Field(1211.27, gt=0, description="f / (2 l_p) of eq 3.12, for `thesis`")
    thesis_size: Literal["radius", "diameter"] = Field("diameter", description="what l_o of eq 3.12 is")
    shared_px: float = Field(20.0, ge=0, description="length along the outline over which edge points share an error")
    systematic_px: float = Field(
        0.03,
        ge=0,
        description="error shared by all edge points (shading, codec), added to the covariance; measured",
    )


@dataclass(frozen=True, slots=True)
class SphereFit:
    """A sphere's centre from edge rays: `xyz_cam_m` (3,), `covariance_m2` (3, 3), the rays' final robust weights (N,)
    in [0, 1] and the angles (N,) in radians by which they lie outside the cone."""

    xyz_cam_m: FloatArray
    covariance_m2: FloatArray
    weights: FloatArray
    outside_rad: FloatArray


def outline_rays(xyz_cam_m: FloatArray, radius_m: float, count: int) -> FloatArray:
    """Unit rays (count, 3) tangent to the sphere, evenly spread around its axis. Needs |xyz| > radius."""
    distance = math.sqrt(float(xyz_cam_m @ xyz_cam_m))
    axis = xyz_cam_m / distance
    sin_a = radius_m / distance
    cos_a = math.sqrt(1 - sin_a * sin_a)
    # u lies in the picture's x direction and v in y, so that ray 0 leaves to the right and they run clockwise.
    x, y, z = axis.tolist()
    flat = math.hypot(x, z)
    u = np.array([z / flat, 0.0, -x / flat])
    v = np.array([-x * y / flat, flat, -y * z / flat])  # axis x u
    return cos_a * axis + sin_a * (_around(count) @ np.stack([u, v]))


@lru_cache(maxsize=16)
def _around(count: int) -> FloatArray:
    """Cosine and sine (count, 2) of evenly spaced angles."""
    phi = np.arange(count) * (2 * np.pi / count)
    return np.stack([np.cos(phi), np.sin(phi)], axis=1)


def outline_px(xyz_cam_m: FloatArray, radius_m: float, camera: Camera, count: int = 72) -> FloatArray:
    """The sphere's outline as picture points (count, 2) in pixels, through the lens."""
    return camera.project(outline_rays(xyz_cam_m, radius_m, count))


def polygon_circle(points_px: FloatArray) -> Circle:
    """The circle with the area and the centroid of a closed polygon (N, 2): an outline's equal-area circle."""
    x, y = points_px[:, 0], points_px[:, 1]
    x0, y0 = x.mean(), y.mean()
    x, y = x - x0, y - y0
    xn, yn = np.append(x[1:], x[:1]), np.append(y[1:], y[:1])
    cross = x * yn - xn * y
    area = cross.sum() / 2
    # A regular N-gon inside a circle has (N / 2 pi) sin(2 pi / N) of its area.
    step = 2 * math.pi / len(x)
    share = math.sin(step) / step
    cx, cy = ((x + xn) * cross).sum() / (6 * area), ((y + yn) * cross).sum() / (6 * area)
    return Circle(float(cx + x0), float(cy + y0), math.sqrt(abs(area) / share / math.pi))


def circle_of_sphere(xyz_cam_m: FloatArray, radius_m: float, camera: Camera) -> Circle | None:
    """The equal-area circle of the sphere's image, in pixels; None when the sphere is not wholly before the camera."""
    if xyz_cam_m[2] <= radius_m * 1.01:
        return None
    points = outline_px(xyz_cam_m, radius_m, camera, 24)
    return polygon_circle(points) if np.isfinite(points).all() else None


def sphere_of_circle(circle: Circle, radius_m: float, camera: Camera) -> FloatArray:
    """The sphere's centre (3,) from an outline's area and centre (Penne, Ribbens, Roios, IJCV 2019).

    u^3 + (1 + |c|^2) u^2 - s^2 u - s^2 = 0 with u = b^2, b the semi-minor axis, pi s the area and c the centre of the
    outline in undistorted normalised coordinates; Z = R sqrt(1 + 1/u), (X, Y) = c (Z^2 - R^2) / Z.
    """
    points = circle.r_px * _around(24) + (circle.x_px, circle.y_px)
    flat = polygon_circle(camera.normalise(points))
    c = np.array([flat.x_px, flat.y_px])
    s = flat.r_px**2
    # The one positive root, by Newton's method from above, where the cubic is convex: u = s on the axis.
    k, s2, u = 1.0 + float(c @ c), s * s, max(s, 1e-12)
    for _ in range(50):
        step = (u * u * u + k * u * u - s2 * u - s2) / (3 * u * u + 2 * k * u - s2)
        u -= step
        if abs(step) < 1e-15 * u:
            break
    z = radius_m * math.sqrt(1 + 1 / u)
    xy = c * (z * z - radius_m**2) / z
    return np.array([xy[0], xy[1], z])


def thesis_position(circle: Circle, size_m: float, constant_px: float, camera: Camera) -> FloatArray:
    """Eq 3.12: d = constant * l_o / r is a depth (eq 3.10), on the ray through the circle's centre."""
    x, y = camera.normalise(np.array([[circle.x_px, circle.y_px]]))[0]
    depth_m = constant_px * size_m / circle.r_px
    return np.array([x * depth_m, y * depth_m, depth_m])


def fit_cone(rays: FloatArray, weights: FloatArray, radius_m: float) -> FloatArray:
    """The sphere's centre (3,) by weighted least squares on n . q_i = 1 (docs/method.md 4c); closed form.

    Raises numpy.linalg.LinAlgError when the rays lie in one plane through the camera.
    """
    scaled = rays * weights[:, None]
    n = np.linalg.solve(scaled.T @ rays, scaled.sum(axis=0))
    length = float(np.linalg.norm(n))  # 1 / cos(alpha)
    cos_a = 1 / length
    sin_a = math.sqrt(max(1e-18, 1 - cos_a * cos_a))
    return (n / length) * (radius_m / sin_a)


def fit_sphere(
    rays: FloatArray,
    sd_rad: FloatArray,
    radius_m: float,
    start_m: FloatArray,
    loose: float = 3.0,
    rounds: int = 5,
    imperfection: float = 0.03,
    hold: float | None = None,
    near: bool = False,
    known_m: tuple[float, float] | None = None,
) -> SphereFit | None:
    """The sphere whose tangent cone runs through the edge rays (N, 3), robustly; None when it does not converge.

    Gauss-Newton on the angle between each ray and the cone, in units of the ray's deviation `sd_rad` (N,),
    with Geman-McClure weights whose scale falls from `loose` to 3 standard deviations, so that points on an occluder
    lose their say. A marker that is no perfect sphere, or blur not modelled, leaves residuals beyond the stated
    deviations: these are widened by the median residual, up to `imperfection` of the marker's angular radius. The
    covariance is that of the weighted fit, widened once more when its residuals are larger than stated.

    `hold` keeps the distance near that of `start_m`, with this relative deviation, while the weights settle: the
    straight edge of an occluder then loses its say instead of shrinking the circle. The last rounds are free of it.
    `near` says that the start is close and no other cone needs to be looked for. `known_m` is a distance known from
    elsewhere and its deviation; the covariance stays that of the rays.
    """
    centre = start_m.astype(np.float64) if near else _best_start(rays, sd_rad, radius_m, start_m, hold)
    weights = np.ones(len(rays))
    fall = (3.0 / max(loose, 3.0)) ** (1 / max(1, rounds - 3))
    scales = [*(max(loose, 3.0) * fall**k for k in range(rounds - 2)), 3.0, 3.0]
    information, sd = np.zeros((3, 3)), sd_rad
    held_m = math.sqrt(float(start_m @ start_m)) if known_m is None else known_m[0]
    for number, scale in enumerate(scales):
        residual, jacobian = _cone_residual(rays, centre, radius_m)
        length = math.sqrt(float(centre @ centre))
        usual = float(np.partition(np.abs(residual), len(residual) // 2)[len(residual) // 2])
        sd = np.maximum(sd_rad, min(1.48 * usual, imperfection * radius_m / length))
        residual, jacobian = residual / sd, jacobian / sd[:, None]
        weights = 1.0 / (1.0 + (residual / scale) ** 2) ** 2
        weighted = jacobian * weights[:, None]
        information = weighted.T @ jacobian
        gradient = weighted.T @ residual
        together = information
        deviation_m = None if known_m is None else known_m[1]
        if hold is not None and number < rounds - 2:
            deviation_m = hold * held_m
        if deviation_m is not None:
            axis = centre / length
            together = information + np.outer(axis, axis) / deviation_m**2
            gradient = gradient + axis * ((length - held_m) / deviation_m**2)
        try:
            step = np.linalg.solve(together, gradient)
        except np.linalg.LinAlgError:
            return None
        step *= min(1.0, 0.3 * length / max(1e-12, math.sqrt(float(step @ step))))
        centre = centre - step
        if centre[2] <= radius_m or not np.isfinite(centre).all():
            return None
    outside = _cone_residual(rays, centre, radius_m)[0]
    effective = float(weights.sum())
    if effective < 5:
        return None
    spread = float((weights * (outside / sd) ** 2).sum()) / max(1.0, effective - 3)
    covariance = np.linalg.inv(information) * max(1.0, spread)
    return SphereFit(centre, covariance.astype(np.float64), weights, outside)


_TRIPLES = np.random.default_rng(0).random((48, 3))


def _best_start(
    rays: FloatArray, sd_rad: FloatArray, radius_m: float, start_m: FloatArray, hold: float | None
) -> FloatArray:
    """The cone through three rays that most rays agree with, or the start (3,) when none beats it.

    Random sample consensus (Torr and Zisserman 2000) over 48 fixed triples, a third of the outline apart on average;
    a cone whose distance is far from the start's counts for less when that is to be held.
    """
    count = len(rays)
    first = (_TRIPLES[:, 0] * count).astype(np.intp)
    gaps = 0.2 + 0.25 * _TRIPLES[:, 1:]
    second = (first + (gaps[:, 0] * count).astype(np.intp)) % count
    third = (second + (gaps[:, 1] * count).astype(np.intp)) % count
    corners = rays[np.stack([first, second, third], axis=1)]  # (48, 3, 3)
    if count < 9 or np.abs(np.linalg.det(corners)).min() < 1e-15:
        return start_m.astype(np.float64)
    normals = np.linalg.solve(corners, np.ones((len(corners), 3, 1)))[..., 0]
    own = start_m / math.sqrt(float(start_m @ start_m) - radius_m**2) / math.sqrt(float(start_m @ start_m))
    normals = np.concatenate([(own * math.sqrt(float(start_m @ start_m)))[None], normals])
    lengths = np.sqrt((normals * normals).sum(axis=1))
    valid = lengths > 1 + 1e-9
    # n . q = cos(angle to axis) / cos(alpha): its excess over 1 is the angle times tan(alpha).
    cos_a = 1 / np.maximum(lengths, 1 + 1e-9)
    sin_a = np.sqrt(1 - cos_a * cos_a)
    off = (
        (normals @ rays.T - 1)
        * (cos_a / sin_a)[:, None]
        / (4 * np.maximum(sd_rad, np.partition(sd_rad, count // 2)[count // 2]))
    )
    agreed = (1 / (1 + off * off)).sum(axis=1)
    distance = radius_m / sin_a
    if hold is not None:
        far = np.log(distance / math.sqrt(float(start_m @ start_m))) / (6 * hold)
        agreed = agreed / (1 + far * far)
    best = int(np.where(valid, agreed, 0).argmax())
    if best == 0:
        return start_m.astype(np.float64)
    return normals[best] / lengths[best] * distance[best]


def _cone_residual(rays: FloatArray, centre: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Angle of each ray outside the tangent cone (N,), radians, and its derivative by the centre (N, 3), rad/m."""
    distance = math.sqrt(float(centre @ centre))
    axis = centre / distance
    along = rays @ axis
    aside = rays - along[:, None] * axis
    sin_psi = np.sqrt(np.maximum(1 - along * along, 1e-24))
    ratio = min(radius_m / distance, 0.999999)
    residual = np.arctan2(sin_psi, along) - math.asin(ratio)
    jacobian = -aside / (distance * sin_psi)[:, None] + axis * (ratio / distance / math.sqrt(1 - ratio * ratio))
    return residual, jacobian
