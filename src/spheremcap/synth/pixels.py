"""Pixels of a picture in compiled loops: the shifted backdrop, balls, cards, sensor noise, H.264's planes."""

import math

import numba
import numpy as np

from spheremcap.core.compiled import F4, F8, I8, array, inner, kernel

_BYTES = array(numba.types.uint8, 2)
_LIGHT = array(F4, 2)
_PART = numba.types.Array(F4, 2, "A", readonly=True)
_OVER = numba.types.Array(F4, 3, "A")


@inner
def _cut_row(top, low, first, a, b, out):
    """Bilinear mix of two rows (interleaved BGR): `a` of the pixel to the right, `b` of the lower row, rounded."""
    p, q = np.float32((1.0 - a) * (1.0 - b)), np.float32(a * (1.0 - b))
    r, s = np.float32((1.0 - a) * b), np.float32(a * b)
    end = first + len(out)
    top, low, after, below = top[first:end], low[first:end], top[first + 3 : end + 3], low[first + 3 : end + 3]
    for k in range(len(out)):
        out[k] = np.uint8(np.rint(p * top[k] + q * after[k] + r * low[k] + s * below[k]))


@kernel(None, _BYTES, F8, F8, F8, F8, I8, I8)
def cut(image, x0_px, y0_px, x1_px, y1_px, width, height):
    """(height, 3 width) uint8: the part of `image` (rows, 3 columns) from (x0, y0) on; where (x1, y1) is another
    place, the mean of both. Places are not negative, and a column and a row more must be there."""
    out = np.empty((height, 3 * width), np.uint8)
    other = np.empty(3 * width, np.uint8)
    j, i, k, n = int(x0_px), int(y0_px), int(x1_px), int(y1_px)
    moved = x0_px != x1_px or y0_px != y1_px
    for r in range(height):
        line = out[r]
        _cut_row(image[i + r], image[i + r + 1], 3 * j, x0_px - j, y0_px - i, line)
        if moved:
            _cut_row(image[n + r], image[n + r + 1], 3 * k, x1_px - k, y1_px - n, other)
            for m in range(len(line)):
                line[m] = np.uint8(np.rint(np.float32(0.5) * (np.float32(line[m]) + np.float32(other[m]))))
    return out


@kernel(None, array(numba.types.uint8, 3))
def mean_of_four(pictures):
    """(rows, columns) uint8: the rounded mean of pictures (4, rows, columns)."""
    _, rows, columns = pictures.shape
    out = np.empty((rows, columns), np.uint8)
    for r in range(rows):
        p, q, s, t, line = pictures[0, r], pictures[1, r], pictures[2, r], pictures[3, r], out[r]
        for k in range(columns):
            total = np.float32(p[k]) + np.float32(q[k]) + np.float32(s[k]) + np.float32(t[k])
            line[k] = np.uint8(np.rint(np.float32(0.25) * total))
    return out


@inner
def _edge_coverage(distance, nx, ny):
    """The part of a pixel's square on the inner side of a straight edge at `distance` (px, positive when the pixel's
    centre is outside) with the unit normal (nx, ny). Exact: the profile across the edge is a trapezoid."""
    ax, ay, u = abs(nx), abs(ny), abs(distance)
    if u <= abs(ax - ay) / 2.0:
        outside = 0.5 - u / max(ax, ay)
    else:
        tail = max((ax + ay) / 2.0 - u, 0.0)
        outside = tail * tail / (2.0 * max(ax * ay, 1e-6))
    return 1.0 - outside if distance < 0.0 else outside


@kernel(None, _PART, _PART, array(F8, 2), F8, array(F8, 1), array(F8, 1), _OVER)
def paint_ball(a, b, track, radius_m, albedo, surface, out):
    """Lay a sphere over `out` (h, w, 4): linear blue, green, red times coverage, and coverage.

    `a`, `b` (h + 2, w + 2) are the pixels' normalised coordinates with a border of one pixel; `track` (h + 2, 3) is
    where the sphere's centre is, in metres, when each row is exposed. `albedo` is linear BGR. `surface` is the unit
    vector to the lamp and the one half-way to the viewer at (0, 0, -1), ambient, gloss, grain, and the grain's turn in
    radians: Lambert, a Blinn-Phong spot (exponent 32) and a mottling. A pixel without a ray is left alone.
    """
    rows, columns = a.shape
    lx, ly, lz, hx, hy, hz = surface[0], surface[1], surface[2], surface[3], surface[4], surface[5]
    ambient, gloss, grain = surface[6], surface[7], surface[8]
    cos, sin = math.cos(surface[9]), math.sin(surface[9])
    past = np.empty((rows, columns))  # from the edge: angle to the centre's ray less the sphere's own, as tangents
    for r in range(rows):
        x, y, z = track[r, 0], track[r, 1], track[r, 2]
        cx, cy = x / z, y / z
        sin2 = radius_m * radius_m / (x * x + y * y + z * z)
        tan = math.sqrt(sin2 / (1.0 - sin2))
        for c in range(columns):
            # By the rays' cross product: no cancellation.
            da, db = a[r, c] - cx, b[r, c] - cy
            roll = da * cy - db * cx
            past[r, c] = math.sqrt(da * da + db * db + roll * roll) / (1.0 + a[r, c] * cx + b[r, c] * cy) - tan
    for r in range(1, rows - 1):
        x, y, z = track[r, 0], track[r, 1], track[r, 2]
        cx, cy = x / z, y / z
        sin2 = radius_m * radius_m / (x * x + y * y + z * z)
        tan = math.sqrt(sin2 / (1.0 - sin2))
        for c in range(1, columns - 1):
            gx, gy = 0.5 * (past[r, c + 1] - past[r, c - 1]), 0.5 * (past[r + 1, c] - past[r - 1, c])
            slope = math.sqrt(gx * gx + gy * gy) + 1e-3 * tan
            # The mean distance over a pixel's square from a curved edge exceeds its centre's by 1 / (24 r).
            distance = past[r, c] / slope + slope / (24.0 * tan)
            coverage = _edge_coverage(distance, gx / slope, gy / slope)
            if not coverage > 0.0:
                continue
            da, db = a[r, c] - cx, b[r, c] - cy
            scale = min((past[r, c] + tan) / tan, 1.0) / max(math.sqrt(da * da + db * db), 1e-9)
            u, v = da * scale, db * scale
            w = math.sqrt(max(1.0 - u * u - v * v, 0.0))
            diffuse = ambient + (1.0 - ambient) * max(u * lx + v * ly - w * lz, 0.0)
            if grain != 0.0:
                p, q = u * cos + w * sin, w * cos - u * sin
                diffuse *= 1.0 + grain * math.sin(9.0 * p + 3.0 * v) * math.sin(8.0 * v - 5.0 * q + 1.0)
            spot = 0.0
            if gloss != 0.0:
                spot = max(u * hx + v * hy - w * hz, 0.0)
                for _ in range(5):
                    spot = spot * spot
            pixel = out[r - 1, c - 1]
            for k in range(3):
                pixel[k] += coverage * (diffuse * albedo[k] + gloss * spot - pixel[k])
            pixel[3] += coverage * (1.0 - pixel[3])
    return None


@inner
def _paint_at(paint, x, y, k):
    """Channel k of an image (n, m, 3) between its pixels, bilinear; beyond the border the border pixel repeats."""
    rows, columns, _ = paint.shape
    x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
    j, i = int(x), int(y)
    n, m = min(j + 1, columns - 1), min(i + 1, rows - 1)
    top = paint[i, j, k] * (1.0 - (x - j)) + paint[i, n, k] * (x - j)
    low = paint[m, j, k] * (1.0 - (x - j)) + paint[m, n, k] * (x - j)
    return top * (1.0 - (y - i)) + low * (y - i)


@kernel(None, I8, I8, array(F8, 2), F8, F8, array(F4, 3), _OVER)
def paint_card(left, top, where, half_width, half_height, paint, out):
    """Lay a rectangle over `out` (h, w, 4), whose first pixel is (left, top): linear BGR times coverage, and coverage.

    `where` (h, 3) is its centre (x, y) in pixels and its angle when each row is exposed; `paint` (n, m, 3) is
    stretched over it.
    """
    rows, columns, _ = out.shape
    for r in range(rows):
        x0, y0 = left - where[r, 0], top + r - where[r, 1]
        cos, sin = math.cos(where[r, 2]), math.sin(where[r, 2])
        for c in range(columns):
            along, across = (x0 + c) * cos + y0 * sin, y0 * cos - (x0 + c) * sin
            # The product of the two strips is exact but at the corners.
            coverage = _edge_coverage(abs(along) - half_width, cos, sin)
            coverage *= _edge_coverage(abs(across) - half_height, sin, cos)
            if coverage <= 0.0:
                continue
            x = (along / (2.0 * half_width) + 0.5) * (paint.shape[1] - 1)
            y = (across / (2.0 * half_height) + 0.5) * (paint.shape[0] - 1)
            pixel = out[r, c]
            for k in range(3):
                pixel[k] += coverage * (_paint_at(paint, x, y, k) - pixel[k])
            pixel[3] += coverage * (1.0 - pixel[3])
    return None


@kernel(None, _LIGHT, _LIGHT, I8, I8, F4, F4, F4, array(numba.types.uint8, 1))
def develop(light, grain, top, left, shot, read, sign, curve):
    """The sensor's answer (rows, 3 columns) uint8 to linear light (rows, 3 columns): photon noise of variance
    shot * light and read noise of variance `read`, both times `grain` from (top, left) on and `sign`, clipped at
    white, then the transfer `curve` over 0..1 in equal steps."""
    rows, columns = light.shape
    out = np.empty((rows, columns), np.uint8)
    codes = np.empty(columns, np.int32)
    white = np.float32(len(curve) - 1)
    dark, strength = np.float32(0.0), sign * white
    for r in range(rows):
        given, rough, line = light[r], grain[top + r], out[r]
        for k in range(columns):
            value = white * given[k] + strength * rough[left + k] * math.sqrt(shot * given[k] + read)
            codes[k] = np.int32(min(max(value, dark), white))
        for k in range(columns):
            line[k] = curve[codes[k]]
    return out


@inner
def _chroma_row(line, m, k, out):
    """One row's Cb or Cr at every column, rounded."""
    blue, green, red, add = m[4 * k], m[4 * k + 1], m[4 * k + 2], m[4 * k + 3]
    for c in range(len(out)):
        out[c] = np.rint(blue * line[3 * c] + green * line[3 * c + 1] + red * line[3 * c + 2] + add)


@kernel(None, _BYTES, array(F4, 1))
def yuv420(picture, matrix):
    """(3/2 height, width) uint8 Y, Cb, Cr planes of a picture (height, 3 width), both even, by `matrix` (3 x 4,
    flat). Chroma belongs to even columns and lies between the rows: weights 1 2 1 across, 1 1 down."""
    height, width = picture.shape[0], picture.shape[1] // 3
    out = np.empty(height * width * 3 // 2, np.uint8)
    one, two = np.empty(width, np.float32), np.empty(width, np.float32)
    for r in range(height):
        line, row = picture[r], out[r * width : (r + 1) * width]
        blue, green, red, add = matrix[0], matrix[1], matrix[2], matrix[3]
        for c in range(width):
            row[c] = np.uint8(np.rint(blue * line[3 * c] + green * line[3 * c + 1] + red * line[3 * c + 2] + add))
    for k in range(1, 3):
        start = height * width + (k - 1) * (height * width // 4)
        for r in range(height // 2):
            _chroma_row(picture[2 * r], matrix, k, one)
            _chroma_row(picture[2 * r + 1], matrix, k, two)
            row = out[start + r * (width // 2) : start + (r + 1) * (width // 2)]
            for c in range(width):
                one[c] += two[c]
            for c in range(width // 2):
                before = one[abs(2 * c - 1)]
                row[c] = np.uint8(np.rint(np.float32(0.125) * (before + 2 * one[2 * c] + one[2 * c + 1])))
    return out.reshape(height * 3 // 2, width)
