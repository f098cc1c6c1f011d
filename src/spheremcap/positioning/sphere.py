"""A sphere's outline and its centre: a cone of rays tangent to the sphere (docs/method.md section 4).

Everything is in the camera's optical frame (x right, y down, z forward), metres, radians; picture points in pixels.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.compiled import BOOL, F8, I8, array, finite, inner, kernel
from spheremcap.core.lens import normal_of, pixel_of
from spheremcap.core.linear import inverse3, middle
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


_F1, _F2 = array(F8, 1), array(F8, 2)
_CIRCLE_POINTS = 24  # of an outline, for the circle that has its area


# -- the outline of a sphere ----------------------------------------------------------------------------------


@inner
def set_rays(x, y, z, radius_m, out):
    """Fill `out` (count, 3) with unit rays tangent to the sphere at (x, y, z), evenly spread around its axis."""
    count = len(out)
    distance = math.sqrt(x * x + y * y + z * z)
    sin_a = radius_m / distance
    cos_a = math.sqrt(1.0 - sin_a * sin_a)
    x, y, z = x / distance, y / distance, z / distance
    # u lies in the picture's x direction and v in y, so that ray 0 leaves to the right and they run clockwise.
    flat = math.sqrt(x * x + z * z)
    ux, uz = z / flat, -x / flat
    vx, vy, vz = -x * y / flat, flat, -y * z / flat  # axis x u
    step = 2.0 * math.pi / count
    for k in range(count):
        c, s = sin_a * math.cos(k * step), sin_a * math.sin(k * step)
        out[k, 0] = cos_a * x + c * ux + s * vx
        out[k, 1] = cos_a * y + s * vy
        out[k, 2] = cos_a * z + c * uz + s * vz


@inner
def set_outline(x, y, z, radius_m, camera, out):
    """Fill `out` (count, 2) with the outline's picture points, pixels; False when a part of it has no pixel."""
    rays = np.empty((len(out), 3))
    set_rays(x, y, z, radius_m, rays)
    for k in range(len(out)):
        out[k, 0], out[k, 1] = pixel_of(camera, rays[k, 0], rays[k, 1], rays[k, 2])
        if not finite(out[k, 0]):
            return False
    return True


@inner
def circle_of_polygon(points):
    """Centre and radius of the circle with a closed polygon's area and centroid; its corners (N, 2)."""
    count = len(points)
    x0, y0 = 0.0, 0.0
    for k in range(count):
        x0 += points[k, 0] / count
        y0 += points[k, 1] / count
    double_area, cx, cy = 0.0, 0.0, 0.0
    for k in range(count):
        n = k + 1 if k + 1 < count else 0
        x, y, xn, yn = points[k, 0] - x0, points[k, 1] - y0, points[n, 0] - x0, points[n, 1] - y0
        cross = x * yn - xn * y
        double_area += cross
        cx += (x + xn) * cross
        cy += (y + yn) * cross
    # A regular N-gon inside a circle has (N / 2 pi) sin(2 pi / N) of its area.
    step = 2.0 * math.pi / count
    r = math.sqrt(abs(double_area) / 2.0 / (math.sin(step) / step) / math.pi)
    return x0 + cx / (3.0 * double_area), y0 + cy / (3.0 * double_area), r


@inner
def circle_at(x, y, z, radius_m, camera):
    """The equal-area circle of a sphere's image, pixels; NaN when there is none."""
    if not z > radius_m * 1.01:
        return np.nan, np.nan, np.nan
    points = np.empty((_CIRCLE_POINTS, 2))
    if not set_outline(x, y, z, radius_m, camera, points):
        return np.nan, np.nan, np.nan
    return circle_of_polygon(points)


@inner
def sphere_at(x_px, y_px, r_px, radius_m, camera):
    """The sphere's centre from an outline's area and centre (Penne, Ribbens, Roios, IJCV 2019); NaN where the lens
    model has no rays."""
    points = np.empty((_CIRCLE_POINTS, 2))
    for k in range(_CIRCLE_POINTS):
        phi = k * (2.0 * math.pi / _CIRCLE_POINTS)
        points[k, 0], points[k, 1] = normal_of(camera, x_px + r_px * math.cos(phi), y_px + r_px * math.sin(phi))
    cx, cy, flat_r = circle_of_polygon(points)
    s = flat_r * flat_r
    # The one positive root, by Newton's method from above, where the cubic is convex: u = s on the axis.
    k, s2, u = 1.0 + cx * cx + cy * cy, s * s, max(s, 1e-12)
    for _ in range(50):
        step = (u * u * u + k * u * u - s2 * u - s2) / (3.0 * u * u + 2.0 * k * u - s2)
        u -= step
        if not abs(step) >= 1e-15 * u:
            break
    z = radius_m * math.sqrt(1.0 + 1.0 / u)
    share = (z * z - radius_m * radius_m) / z
    return cx * share, cy * share, z


@kernel(None, F8, F8, F8, F8, I8)
def _rays(x, y, z, radius_m, count):
    out = np.empty((count, 3))
    set_rays(x, y, z, radius_m, out)
    return out


@kernel(None, F8, F8, F8, F8, _F1)
def _circle_at(x, y, z, radius_m, camera):
    return circle_at(x, y, z, radius_m, camera)


@kernel(None, _F1, F8, _F1)
def _moving_circle(state, radius_m, camera):
    x, y, r = circle_at(state[0], state[1], state[2], radius_m, camera)
    half_s = 0.5e-4
    ax, ay = pixel_of(camera, state[0] - half_s * state[3], state[1] - half_s * state[4], state[2] - half_s * state[5])
    bx, by = pixel_of(camera, state[0] + half_s * state[3], state[1] + half_s * state[4], state[2] + half_s * state[5])
    return x, y, r, (bx - ax) / (2.0 * half_s), (by - ay) / (2.0 * half_s)


@kernel(None, F8, F8, F8, F8, _F1)
def _sphere_at(x_px, y_px, r_px, radius_m, camera):
    return sphere_at(x_px, y_px, r_px, radius_m, camera)


@kernel(None, _F2)
def _circle_of_polygon(points):
    return circle_of_polygon(points)


def outline_rays(xyz_cam_m: FloatArray, radius_m: float, count: int) -> FloatArray:
    """Unit rays (count, 3) tangent to the sphere, evenly spread around its axis. Needs |xyz| > radius."""
    return _rays(*xyz_cam_m.tolist(), radius_m, count)


def outline_px(xyz_cam_m: FloatArray, radius_m: float, camera: Camera, count: int = 72) -> FloatArray:
    """The sphere's outline as picture points (count, 2) in pixels, through the lens; NaN where it has no pixel."""
    return camera.project(outline_rays(xyz_cam_m, radius_m, count))


def polygon_circle(points_px: FloatArray) -> Circle:
    """The circle with the area and the centroid of a closed polygon (N, 2): an outline's equal-area circle."""
    return Circle(*_circle_of_polygon(np.ascontiguousarray(points_px, np.float64)))


def circle_of_sphere(xyz_cam_m: FloatArray, radius_m: float, camera: Camera) -> Circle | None:
    """The equal-area circle of the sphere's image, in pixels; None when the sphere is not wholly before the camera or
    reaches out of what the lens model holds for."""
    x, y, r = _circle_at(*xyz_cam_m.tolist(), radius_m, camera.params)
    return None if math.isnan(r) else Circle(x, y, r)


def image_of_moving(state: FloatArray, radius_m: float, camera: Camera) -> tuple[Circle, FloatArray] | None:
    """The equal-area circle of a sphere's image and its velocity (2,) in px/s; `state` (6,) is place and velocity in
    the optical frame. None when there is no such circle."""
    x, y, r, rate_x, rate_y = _moving_circle(state, radius_m, camera.params)
    return None if math.isnan(r + rate_x) else (Circle(x, y, r), np.array([rate_x, rate_y]))


def sphere_of_circle(circle: Circle, radius_m: float, camera: Camera) -> FloatArray:
    """The sphere's centre (3,) from an outline's area and centre (Penne, Ribbens, Roios, IJCV 2019).

    u^3 + (1 + |c|^2) u^2 - s^2 u - s^2 = 0 with u = b^2, b the semi-minor axis, pi s the area and c the centre of the
    outline in undistorted normalised coordinates; Z = R sqrt(1 + 1/u), (X, Y) = c (Z^2 - R^2) / Z. NaN where the lens
    model has no rays.
    """
    return np.array(_sphere_at(circle.x_px, circle.y_px, circle.r_px, radius_m, camera.params))


def thesis_position(circle: Circle, size_m: float, constant_px: float, camera: Camera) -> FloatArray:
    """Eq 3.12: d = constant * l_o / r is a depth (eq 3.10), on the ray through the circle's centre."""
    x, y = camera.normalise(np.array([[circle.x_px, circle.y_px]]))[0]
    depth_m = constant_px * size_m / circle.r_px
    return np.array([x * depth_m, y * depth_m, depth_m])


# -- the sphere of an outline ---------------------------------------------------------------------------------

_TRIPLES = np.random.default_rng(0).random((48, 3))


@inner
def _set_residuals(rays, centre, radius_m, residual, jacobian):
    """Angle of each ray outside the tangent cone (N,), radians, and its derivative by the centre (N, 3), rad/m."""
    distance = math.sqrt(centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2])
    ax, ay, az = centre[0] / distance, centre[1] / distance, centre[2] / distance
    ratio = min(radius_m / distance, 0.999999)
    cos_a = math.sqrt(1.0 - ratio * ratio)
    deeper = ratio / distance / cos_a
    for k in range(len(rays)):
        x, y, z = rays[k, 0], rays[k, 1], rays[k, 2]
        along = x * ax + y * ay + z * az
        sin_psi = math.sqrt(max(1.0 - along * along, 1e-24))
        off = sin_psi * cos_a - along * ratio  # the sine of the angle outside
        if abs(off) < 0.03:  # its series, to 1e-12
            square = off * off
            residual[k] = off * (1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0 + square * (5.0 / 112.0))))
        else:
            residual[k] = math.atan2(sin_psi, along) - math.asin(ratio)
        share = 1.0 / (distance * sin_psi)
        jacobian[k, 0] = ax * deeper - (x - along * ax) * share
        jacobian[k, 1] = ay * deeper - (y - along * ay) * share
        jacobian[k, 2] = az * deeper - (z - along * az) * share


@inner
def _best_start(rays, sd_rad, radius_m, start, hold, out):
    """The centre of the cone through three rays that most rays agree with, or the start when none beats it.

    Random sample consensus (Torr and Zisserman 2000) over 48 fixed triples, a third of the outline apart on average;
    a cone whose distance is far from the start's counts for less when that is to be held (`hold`, NaN for not).
    """
    count = len(rays)
    out[0], out[1], out[2] = start[0], start[1], start[2]
    if count < 9:
        return
    held = math.sqrt(start[0] * start[0] + start[1] * start[1] + start[2] * start[2])
    usual = middle(sd_rad.copy(), count)
    softer = np.empty(count)
    for k in range(count):
        softer[k] = 1.0 / (4.0 * max(sd_rad[k], usual))
    # n . q = cos(angle to axis) / cos(alpha): its excess over 1 is the angle times tan(alpha). The start goes first.
    root = math.sqrt(held * held - radius_m * radius_m)
    most, best_n = -1.0, np.empty(3)
    n = start / root
    for number in range(len(_TRIPLES) + 1):
        if number > 0:
            a = int(_TRIPLES[number - 1, 0] * count)
            b = (a + int((0.2 + 0.25 * _TRIPLES[number - 1, 1]) * count)) % count
            c = (b + int((0.2 + 0.25 * _TRIPLES[number - 1, 2]) * count)) % count
            ax, ay, az = rays[a, 0], rays[a, 1], rays[a, 2]
            bx, by, bz = rays[b, 0], rays[b, 1], rays[b, 2]
            cx, cy, cz = rays[c, 0], rays[c, 1], rays[c, 2]
            ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
            vx, vy, vz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
            wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            det = ax * ux + ay * uy + az * uz
            if abs(det) < 1e-15:
                return
            n[0], n[1], n[2] = (ux + vx + wx) / det, (uy + vy + wy) / det, (uz + vz + wz) / det
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if not length > 1.0 + 1e-9:
            continue
        cos_a = 1.0 / length
        sin_a = math.sqrt(1.0 - cos_a * cos_a)
        gain = cos_a / sin_a
        agreed = 0.0
        for k in range(count):
            off = (n[0] * rays[k, 0] + n[1] * rays[k, 1] + n[2] * rays[k, 2] - 1.0) * gain * softer[k]
            agreed += 1.0 / (1.0 + off * off)
        if not math.isnan(hold):
            far = math.log(radius_m / sin_a / held) / (6.0 * hold)
            agreed /= 1.0 + far * far
        if agreed > most:
            most = agreed
            scale = radius_m / sin_a / length
            best_n[0], best_n[1], best_n[2] = n[0] * scale, n[1] * scale, n[2] * scale
            if number > 0:
                out[0], out[1], out[2] = best_n[0], best_n[1], best_n[2]


@inner
def fit_rays(
    rays, sd_rad, radius_m, start, loose, rounds, imperfection, hold, known_m, known_sd_m, near,
    centre, covariance, alone, weights, outside,
):  # fmt: skip
    """`fit_sphere` into the arrays `centre` (3,), `covariance` (3, 3), `weights` and `outside` (N,); False for None.
    `hold` is NaN when nothing is held, `known_sd_m` infinite when the distance is not known; `alone` (3,) is the centre
    that the rays have without it."""
    count = len(rays)
    if near:
        centre[0], centre[1], centre[2] = start[0], start[1], start[2]
    else:
        _best_start(rays, sd_rad, radius_m, start, hold, centre)
    held = math.sqrt(start[0] * start[0] + start[1] * start[1] + start[2] * start[2])
    if finite(known_sd_m):
        held = known_m
    loose = max(loose, 3.0)
    fall = (3.0 / loose) ** (1.0 / max(1, rounds - 3))
    jacobian, sizes, sd = np.empty((count, 3)), np.empty(count), np.empty(count)
    information, gradient, step, steps = np.empty((3, 3)), np.empty(3), np.empty(3), np.zeros((3, 3))
    scale = loose
    for number in range(rounds):
        if number >= rounds - 2:
            scale = 3.0
        _set_residuals(rays, centre, radius_m, outside, jacobian)
        length = math.sqrt(centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2])
        for k in range(count):
            sizes[k] = abs(outside[k])
        wider = min(1.48 * middle(sizes, count), imperfection * radius_m / length)
        gx, gy, gz, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            sd[k] = max(sd_rad[k], wider)
            sharp = 1.0 / sd[k]
            off = outside[k] * sharp
            softened = 1.0 / (1.0 + (off / scale) * (off / scale))
            weights[k] = softened * softened
            jx, jy, jz = jacobian[k, 0] * sharp, jacobian[k, 1] * sharp, jacobian[k, 2] * sharp
            wx, wy, wz = weights[k] * jx, weights[k] * jy, weights[k] * jz
            gx, gy, gz = gx + wx * off, gy + wy * off, gz + wz * off
            xx, xy, xz = xx + wx * jx, xy + wx * jy, xz + wx * jz
            yy, yz, zz = yy + wy * jy, yz + wy * jz, zz + wz * jz
        information[0, 0], information[0, 1], information[0, 2] = xx, xy, xz
        information[1, 0], information[1, 1], information[1, 2] = xy, yy, yz
        information[2, 0], information[2, 1], information[2, 2] = xz, yz, zz
        gradient[0], gradient[1], gradient[2] = gx, gy, gz
        if inverse3(information, covariance) == 0.0:
            return False
        deviation = known_sd_m
        if not math.isnan(hold) and number < rounds - 2:
            deviation = hold * held
        if finite(deviation):
            for i in range(3):
                gradient[i] += centre[i] / length * (length - held) / (deviation * deviation)
                for j in range(3):
                    information[i, j] += centre[i] * centre[j] / (length * length) / (deviation * deviation)
        if inverse3(information, steps) == 0.0:
            return False
        for i in range(3):
            step[i] = steps[i, 0] * gradient[0] + steps[i, 1] * gradient[1] + steps[i, 2] * gradient[2]
            alone[i] = centre[i] - covariance[i, 0] * gx - covariance[i, 1] * gy - covariance[i, 2] * gz
        size = math.sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
        part = min(1.0, 0.3 * length / max(1e-12, size))
        for i in range(3):
            centre[i] -= part * step[i]
        if not (centre[2] > radius_m and finite(centre[0]) and finite(centre[1])):
            return False
        scale *= fall
    if not alone[2] > radius_m:
        alone[:] = centre
    _set_residuals(rays, centre, radius_m, outside, jacobian)
    effective, spread = 0.0, 0.0
    for k in range(count):
        effective += weights[k]
        spread += weights[k] * (outside[k] / sd[k]) ** 2
    if not effective >= 5.0:
        return False
    wider = max(1.0, spread / max(1.0, effective - 3.0))
    for i in range(3):
        for j in range(3):
            covariance[i, j] *= wider
    return True


@kernel(None, _F2, _F1, F8, _F1, F8, I8, F8, F8, F8, F8, BOOL, at_import=False)
def _fit_sphere(rays, sd_rad, radius_m, start, loose, rounds, imperfection, hold, known_m, known_sd_m, near):
    centre, covariance = np.empty(3), np.empty((3, 3))
    weights, outside = np.empty(len(rays)), np.empty(len(rays))
    found = fit_rays(
        rays, sd_rad, radius_m, start, loose, rounds, imperfection, hold, known_m, known_sd_m, near,
        centre, covariance, np.empty(3), weights, outside,
    )  # fmt: skip
    return found, centre, covariance, weights, outside


FIT_ROUNDS, IMPERFECTION = 5, 0.03


def fit_sphere(
    rays: FloatArray,
    sd_rad: FloatArray,
    radius_m: float,
    start_m: FloatArray,
    loose: float = 3.0,
    rounds: int = FIT_ROUNDS,
    imperfection: float = IMPERFECTION,
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
    `near` says that the start is close and no other cone needs to be looked for.

    `known_m` is a distance known from elsewhere and its deviation: the centre is then the likeliest given both, which
    on a short arc hardly leaves that distance. The covariance stays that of the rays alone.
    """
    found, centre, covariance, weights, outside = _fit_sphere(
        np.ascontiguousarray(rays, np.float64), np.ascontiguousarray(sd_rad, np.float64), radius_m,
        np.ascontiguousarray(start_m, np.float64), loose, rounds, imperfection,
        math.nan if hold is None else hold, *(known_m or (0.0, math.inf)), near,
    )  # fmt: skip
    return SphereFit(centre, covariance, weights, outside) if found else None
