"""Shaded spheres on a textured background with exactly known truth, for the tests of the chain.

Light is mixed in linear intensities with the exact outline of a sphere under a pinhole (no distortion),
blurred like a lens, coded by the sRGB curve, and given noise. Truth comes from the closed form of a sphere's
image, not from the package: centre (X, Y) Z / (Z^2 - R^2), semi-axes R / sqrt(Z^2 - R^2) and
R sqrt(|S|^2 - R^2) / (Z^2 - R^2).
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, YuvFrame, yuv_to_bgr_matrix
from spheremcap.core.status import PolicyConfig

CAMERA = Camera(320, 240, 600.0, 600.0, 159.5, 119.5)
RADIUS_M = 0.02
PERIOD_NS = 4_170_837  # 1001/240000 s
ORANGE, GREEN, BLUE = (235, 120, 25), (40, 190, 70), (30, 80, 220)
LENS_SIGMA_PX = 0.55
_SUB = 3  # samples a pixel and axis on the outline


@dataclass(frozen=True)
class Ball:
    """A sphere in the optical frame, metres, with its sRGB colour (red, green, blue)."""

    xyz: tuple[float, float, float]
    rgb: tuple[int, int, int] = ORANGE
    radius_m: float = RADIUS_M


@dataclass(frozen=True)
class Cover:
    """A plain rectangle in front of everything: its edges in pixels (half open) and its sRGB colour."""

    left: int
    top: int
    right: int
    bottom: int
    rgb: tuple[int, int, int] = (150, 130, 120)


def ball_at(x_px, y_px, r_px, camera=CAMERA, rgb=ORANGE, radius_m=RADIUS_M) -> Ball:
    """A ball whose image is near this circle; `truth` says exactly where it is."""
    z = camera.fx_px * radius_m / r_px
    return Ball(
        (
            (x_px - camera.cx_px) / camera.fx_px * z,
            (y_px - camera.cy_px) / camera.fy_px * z,
            z,
        ),
        rgb,
        radius_m,
    )


def truth(ball: Ball, camera=CAMERA) -> Circle:
    """The equal-area circle of the ball's image, in pixels (square pixels, no distortion)."""
    x, y, z = ball.xyz
    depth = z * z - ball.radius_m**2
    minor = ball.radius_m / np.sqrt(depth)
    major = ball.radius_m * np.sqrt(x * x + y * y + depth) / depth
    f = camera.fx_px
    return Circle(camera.cx_px + f * x * z / depth, camera.cy_px + f * y * z / depth, f * float(np.sqrt(minor * major)))


def to_linear(code):
    code = np.asarray(code, np.float64) / 255
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def to_code(linear):
    linear = np.clip(linear, 0, 1)
    return 255 * np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


@lru_cache(maxsize=16)
def background(width, height, seed=0):
    """A textured grey-brown picture (height, width, 3) BGR, linear light."""
    rng = np.random.default_rng(seed)
    texture = np.zeros((height, width, 3))
    for cell, weight in ((4, 12), (16, 18), (64, 22)):
        grid = rng.standard_normal((height // cell + 2, width // cell + 2, 3)) * (
            1,
            1,
            1,
        ) + rng.standard_normal((height // cell + 2, width // cell + 2, 1))
        texture += weight * cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC) / 1.4
    return to_linear(np.clip(texture + np.array([105, 115, 120]), 5, 250))


def picture(
    *balls: Ball,
    camera=CAMERA,
    covers=(),
    noise=2.0,
    noise_seed=0,
    backdrop=0,
    gain=1.0,
    shading=0.4,
    shift=(0, 0),
):
    """The scene as (height, width, 3) uint8 BGR; later balls and covers hide earlier ones.

    `shift` moves the whole scene right and down by whole pixels (the camera's picture is a window on it).
    """
    height, width = camera.height_px, camera.width_px
    coded = _coded_background(width, height, backdrop, gain).copy()
    boxes = [_box(ball, camera) for ball in balls]
    boxes += [(c.left, c.top, c.right, c.bottom) for c in covers]
    if boxes:
        # Only what is covered is drawn anew, with a margin for the lens.
        low = np.min(boxes, axis=0)[:2] - 8
        high = np.max(boxes, axis=0)[2:] + 8
        (x0, y0), (x1, y1) = np.clip(low, 0, (width, height)), np.clip(high, 0, (width, height))
        part = np.s_[y0:y1, x0:x1]
        scene = background(width, height, backdrop).copy()
        for ball in balls:
            _draw(scene, ball, camera, shading)
        for c in covers:
            scene[max(0, c.top) : max(0, c.bottom), max(0, c.left) : max(0, c.right)] = to_linear(np.array(c.rgb[::-1]))
        if x1 > x0 and y1 > y0:
            inner = np.s_[max(0, y0 - 4) : y1 + 4, max(0, x0 - 4) : x1 + 4]
            light = cv2.GaussianBlur(scene[inner], (0, 0), LENS_SIGMA_PX)
            top, left = y0 - max(0, y0 - 4), x0 - max(0, x0 - 4)
            coded[part] = to_code(light[top : top + y1 - y0, left : left + x1 - x0] * gain)
    coded = np.roll(coded, (shift[1], shift[0]), axis=(0, 1))
    if noise:
        field = np.empty(coded.shape, np.float32)
        cv2.setRNGSeed(noise_seed + 1)
        cv2.randn(field, 0, noise)
        coded += field
    return np.clip(np.rint(coded), 0, 255).astype(np.uint8)


@lru_cache(maxsize=16)
def _coded_background(width, height, seed, gain):
    light = cv2.GaussianBlur(background(width, height, seed), (0, 0), LENS_SIGMA_PX)
    return to_code(light * gain).astype(np.float32)


def _box(ball, camera):
    circle = truth(ball, camera)
    half = circle.r_px * 1.15 + 3
    x, y = (np.clip(v, -1e4, 1e4) for v in (circle.x_px, circle.y_px))
    return int(x - half), int(y - half), int(x + half) + 2, int(y + half) + 2


def _draw(scene, ball, camera, shading):
    x0, y0, x1, y1 = _box(ball, camera)
    x0, x1, y0, y1 = max(0, x0), min(camera.width_px, x1), max(0, y0), min(camera.height_px, y1)
    if x0 >= x1 or y0 >= y1:
        return
    fine = (np.arange((x1 - x0) * _SUB) + 0.5) / _SUB - 0.5 + x0
    rows = (np.arange((y1 - y0) * _SUB) + 0.5) / _SUB - 0.5 + y0
    a = ((fine - camera.cx_px) / camera.fx_px)[None, :]
    b = ((rows - camera.cy_px) / camera.fy_px)[:, None]
    xyz = np.array(ball.xyz)
    distance = np.linalg.norm(xyz)
    axis = xyz / distance
    length = np.sqrt(a * a + b * b + 1)
    along = (a * axis[0] + b * axis[1] + axis[2]) / length
    angle = np.arctan2(np.sqrt(np.maximum(1 - along * along, 0)), along)
    limb = np.arcsin(ball.radius_m / distance)
    past = angle - limb
    gy, gx = np.gradient(past)
    cover = np.clip(0.5 - past / np.maximum(np.hypot(gx, gy), 1e-12), 0, 1)
    # Lambert with ambient light, the lamp up and to the left behind the camera.
    rho = np.minimum(angle / limb, 1)
    aside = np.maximum(np.hypot(a - axis[0] / axis[2], b - axis[1] / axis[2]), 1e-12)
    nx, ny = rho * (a - axis[0] / axis[2]) / aside, rho * (b - axis[1] / axis[2]) / aside
    nz = np.sqrt(np.maximum(1 - nx * nx - ny * ny, 0))
    light = 1 - shading + shading * np.maximum(0, -0.35 * nx - 0.5 * ny + 0.79 * nz)
    body = (cover * light).reshape(y1 - y0, _SUB, x1 - x0, _SUB).mean(axis=(1, 3))
    cover = cover.reshape(y1 - y0, _SUB, x1 - x0, _SUB).mean(axis=(1, 3))
    colour = to_linear(np.array(ball.rgb[::-1]))
    part = scene[y0:y1, x0:x1]
    part[:] = part * (1 - cover[..., None]) + body[..., None] * colour


def bgr_frame(image, index=0, period_ns=PERIOD_NS) -> BgrFrame:
    return BgrFrame(index, index * period_ns, image)


_BT709 = yuv_to_bgr_matrix("bt709", False)


def yuv_frame(image, index=0, period_ns=PERIOD_NS) -> YuvFrame:
    """The picture as 4:2:0 video has it: BT.709, limited range, chroma sited on the left (origin 0, 0.5)."""
    forward = np.linalg.inv(_BT709[:, :3])
    yuv = (image.astype(np.float64) - _BT709[:, 3]) @ forward.T
    # Left-sited: a (1, 2, 1)/4 filter across columns, the mean of two rows.
    chroma = cv2.sepFilter2D(yuv[..., 1:], -1, np.array([0.25, 0.5, 0.25]), np.ones(1))
    chroma = (chroma[0::2, 0::2] + chroma[1::2, 0::2]) / 2
    planes = [np.clip(np.rint(p), 0, 255).astype(np.uint8) for p in (yuv[..., 0], chroma[..., 0], chroma[..., 1])]
    return YuvFrame(index, index * period_ns, planes[0], (planes[1], planes[2]), (2, 2), (0.0, 0.5), _BT709)


COUNTED = PolicyConfig(lost_radii=0)
"""A marker is LOST after five frames, however sure the filter is of it."""
