"""The loops of `spheremcap.synth.pixels` as NumPy and OpenCV say them: what the compiled ones must equal."""

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]


def cut(image, x, y, width, height):
    """The part (height, width, 3) of a picture from (x, y) on, between pixels bilinear."""
    j, i = int(x), int(y)
    region = image[i : i + height + 1, j : j + width + 1].astype(np.float64)
    fx, fy = x - j, y - i
    across = region[:, :-1] * (1 - fx) + region[:, 1:] * fx
    return np.rint(across[:-1] * (1 - fy) + across[1:] * fy).astype(np.uint8)


def mean(pictures):
    """The rounded mean of pictures (N, ...)."""
    return np.rint(np.mean(pictures, axis=0)).astype(np.uint8)


def half_plane_coverage(distance_px: Image, nx: Image, ny: Image) -> Image:
    """The part of each pixel's square on the inner side of a straight edge.

    `distance_px` is the pixel centre's signed distance from the edge, positive outside; (nx, ny) the edge's
    unit normal. Exact: the square's profile across the edge is a trapezoid.
    """
    ax, ay = np.abs(nx), np.abs(ny)
    large = np.maximum(ax, ay)
    u = np.abs(distance_px)
    tail = np.maximum((ax + ay) / 2 - u, 0)
    tail = tail * tail / (2 * np.maximum(ax * ay, 1e-6))
    outside = np.where(u <= np.abs(ax - ay) / 2, 0.5 - u / large, tail)
    return np.where(distance_px < 0, 1 - outside, outside).astype(np.float32, copy=False)


def ball_coverage(a: Image, b: Image, centre_cam_m: FloatArray, radius_m: float) -> tuple[Image, Image, Image]:
    """Coverage (h, w) by a sphere, and the x and y of the surface normal there in units of 1.

    `a`, `b` (h + 2, w + 2) are the pixels' normalised coordinates with a border of one pixel; `centre_cam_m`
    (h + 2, 3) is where the sphere is when each row is exposed.
    """
    c = (centre_cam_m[:, :2] / centre_cam_m[:, 2:]).astype(np.float32)
    cx, cy = c[:, :1], c[:, 1:]
    sin2 = radius_m**2 / np.sum(centre_cam_m**2, axis=1, keepdims=True)
    tan = np.sqrt(sin2 / (1 - sin2)).astype(np.float32)
    # Tangent of the angle between the pixel's ray and the centre's, by their cross product: no cancellation.
    da, db = a - cx, b - cy
    roll = da * cy - db * cx
    angle = np.sqrt(da * da + db * db + roll * roll) / (1 + a * cx + b * cy)
    past = angle - tan
    gx = (past[1:-1, 2:] - past[1:-1, :-2]) * np.float32(0.5)
    gy = (past[2:, 1:-1] - past[:-2, 1:-1]) * np.float32(0.5)
    inner, tan = past[1:-1, 1:-1], tan[1:-1]
    slope = np.sqrt(gx * gx + gy * gy) + tan * np.float32(1e-3)
    # The mean distance over a pixel's square from a curved edge exceeds its centre's by 1 / (24 r).
    distance = inner / slope + slope / (24 * tan)
    coverage = half_plane_coverage(distance, gx / slope, gy / slope)
    rho = np.minimum(angle[1:-1, 1:-1] / tan, 1)
    da, db = da[1:-1, 1:-1], db[1:-1, 1:-1]
    scale = rho / np.maximum(np.sqrt(da * da + db * db), np.float32(1e-9))
    return np.nan_to_num(coverage), da * scale, db * scale


def ball_colour(
    u: Image,
    v: Image,
    albedo: Image,
    lamp: FloatArray,
    ambient: float,
    gloss: float,
    grain: float,
    turn_rad: float,
) -> Image:
    """Linear light (h, w, 3) off a sphere whose normal is (u, v, -sqrt(1 - u² - v²)), under a distant lamp
    (3,).

    Lambert and a Blinn-Phong spot (exponent 32) with the viewer at (0, 0, -1); `grain` mottles the surface
    with a pattern that turns with it by `turn_rad`.
    """
    w = np.sqrt(np.maximum(1 - u * u - v * v, 0))
    lamp = lamp / np.linalg.norm(lamp)
    half = lamp + np.array([0.0, 0.0, -1.0])
    half = half / np.linalg.norm(half)
    lx, ly, lz = (np.float32(x) for x in lamp)
    hx, hy, hz = (np.float32(x) for x in half)
    diffuse = np.float32(ambient) + np.float32(1 - ambient) * np.maximum(u * lx + v * ly - w * lz, 0)
    if grain:
        c, s = np.float32(np.cos(turn_rad)), np.float32(np.sin(turn_rad))
        p, q = u * c + w * s, w * c - u * s
        diffuse = diffuse * (1 + np.float32(grain) * np.sin(9 * p + 3 * v) * np.sin(8 * v - 5 * q + 1))
    out = diffuse[..., None] * albedo
    if gloss:
        spot = np.maximum(u * hx + v * hy - w * hz, 0)
        for _ in range(5):
            spot = spot * spot
        out += (np.float32(gloss) * spot)[..., None]
    return out


def paint_ball(a, b, track, radius_m, albedo, lamp, ambient, gloss, grain, turn_rad, out):
    """Lay a sphere over `out` (h, w, 4)."""
    coverage, u, v = ball_coverage(a, b, track, radius_m)
    colour = ball_colour(u, v, albedo.astype(np.float32), lamp, ambient, gloss, grain, turn_rad)
    colour = np.concatenate([colour, np.ones_like(coverage)[..., None]], axis=2)
    return out + coverage[..., None] * (colour - out)


def card_layer(window, where, half_px, paint):
    """Coverage (h, w) and linear colour (h, w, 3) of a rectangle in `window`.

    `where` (h, 3) is its centre (x, y) in pixels and its angle when each row is exposed; `paint` (n, m, 3) is
    stretched over it.
    """
    x = (np.arange(window.x, window.x + window.width)[None, :] - where[:, :1]).astype(np.float32)
    y = (np.arange(window.y, window.y + window.height)[:, None] - where[:, 1:2]).astype(np.float32)
    angle = where[:, 2:].astype(np.float32)
    cos, sin = np.cos(angle), np.sin(angle)
    along, across = x * cos + y * sin, y * cos - x * sin
    ones = np.ones_like(along)
    # The product of the two strips is exact but at the corners.
    long = half_plane_coverage(np.abs(along) - np.float32(half_px[0]), ones * cos, ones * sin)
    wide = half_plane_coverage(np.abs(across) - np.float32(half_px[1]), ones * sin, ones * cos)
    coverage: Image = long * wide
    if paint.size == 3:
        return coverage, np.broadcast_to(paint.reshape(1, 1, 3), (*coverage.shape, 3))
    rows, columns = paint.shape[:2]
    map_x = (along / np.float32(2 * half_px[0]) + np.float32(0.5)) * (columns - 1)
    map_y = (across / np.float32(2 * half_px[1]) + np.float32(0.5)) * (rows - 1)
    return coverage, cv2.remap(paint, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def paint_card(window, where, half_px, paint, out):
    """Lay a rectangle over `out` (h, w, 4)."""
    coverage, colour = card_layer(window, where, half_px, paint)
    colour = np.concatenate([colour, np.ones_like(coverage)[..., None]], axis=2)
    return out + coverage[..., None] * (colour - out)


def develop(light, grain, shot, read, sign, curve):
    """The sensor's answer (rows, columns) to linear light, with the part of the noise that belongs to it."""
    white = len(curve) - 1
    noisy = light * white + sign * white * grain * np.sqrt(light * np.float32(shot) + np.float32(read))
    return curve[np.clip(noisy, 0, white).astype(np.uint16)]


def yuv420(picture, matrix):
    """(height, width, 3) BGR -> (height * 3 / 2, width) planes, by a matrix (3, 4), chroma sited left."""
    height, width = picture.shape[:2]
    # Not cv2.transform, whose fixed point is a level off in one value of thirty.
    yuv = np.rint(picture @ matrix[:, :3].T + matrix[:, 3]).astype(np.uint8)
    # Chroma belongs to even columns and lies between the rows: weights 1 2 1 across, 1 1 down.
    soft = cv2.sepFilter2D(yuv[..., 1:], -1, np.array([0.25, 0.5, 0.25]), np.array([0.5, 0.5]), anchor=(1, 0))
    chroma = soft[::2, ::2]
    planes = [yuv[..., 0].ravel(), chroma[..., 0].ravel(), chroma[..., 1].ravel()]
    return np.concatenate(planes).reshape(height * 3 // 2, width)
