"""How surfaces look, in compiled loops: value noise, the patterns of things, the ground and the wall, the backdrop."""

import math

import numpy as np

from spheremcap.core.compiled import F8, I8, array, inner, kernel

_LINE, _TABLE = array(F8, 1), array(F8, 2)
PATTERNS = ("plain", "mottled", "printed", "striped", "skin", "cloth")
GROUNDS = ("asphalt", "planks", "grass", "floor")
WALLS = ("plaster", "planks", "brick", "hedge")


@inner
def chance(i, j, k):
    """A number in 0..1 that belongs to three integers."""
    h = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    h = ((h ^ (h >> 13)) * 1274126177) & 0x7FFFFFFF
    return ((h ^ (h >> 15)) & 0xFFFFFF) * (1.0 / 16777216.0)


@inner
def noise(x, y, z):
    """Value noise in 0..1: random numbers at whole coordinates, smoothly mixed between them."""
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    i, j, k = int(fx), int(fy), int(fz)
    u, v, w = x - fx, y - fy, z - fz
    u, v, w = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v), w * w * (3.0 - 2.0 * w)
    a = chance(i, j, k) * (1.0 - u) + chance(i + 1, j, k) * u
    b = chance(i, j + 1, k) * (1.0 - u) + chance(i + 1, j + 1, k) * u
    c = chance(i, j, k + 1) * (1.0 - u) + chance(i + 1, j, k + 1) * u
    d = chance(i, j + 1, k + 1) * (1.0 - u) + chance(i + 1, j + 1, k + 1) * u
    return (a * (1.0 - v) + b * v) * (1.0 - w) + (c * (1.0 - v) + d * v) * w


@inner
def rough(x, y, z):
    """Two octaves of value noise, about -1..1."""
    return 1.4 * (noise(x, y, z) - 0.5) + 0.7 * (noise(2.1 * x + 7.3, 2.1 * y + 1.9, 2.1 * z + 4.7) - 0.5)


@inner
def _step(x, edge, width):
    """0 below `edge`, 1 above it, with a ramp of `width`."""
    return min(max((x - edge) / width + 0.5, 0.0), 1.0)


@inner
def pattern_of(kind, x, y, z, radius_m, scale, strength):
    """(factor on the albedo, share of the second albedo) at a place (x, y, z) in metres from a thing's own centre, in
    the frame that turns with it. `kind` counts in PATTERNS."""
    if kind == 1:
        return 1.0 + strength * rough(scale * x, scale * y, scale * z), 0.0
    if kind == 2:
        u, v, w = x / radius_m, y / radius_m, z / radius_m
        # A seam like a tennis ball's, and a ring with a bar on the side of +x (and a smaller one opposite).
        seam = 1.0 - _step(abs(w - 0.45 * (u * u - v * v) / max(u * u + v * v, 1e-6)), 0.045, 0.02)
        off = math.sqrt(v * v + w * w)
        logo = _step(off, 0.22, 0.03) * (1.0 - _step(off, 0.40, 0.03)) if u > 0.0 else 1.0 - _step(off, 0.20, 0.03)
        bar = (1.0 - _step(abs(v + 0.3 * w), 0.07, 0.03)) * (1.0 - _step(off, 0.55, 0.03)) if u > 0.0 else 0.0
        return 1.0 + 0.05 * rough(160.0 * x, 160.0 * y, 160.0 * z), strength * max(seam, logo, bar)
    if kind == 3:
        wave = math.sin(scale * math.acos(min(max(z / radius_m, -1.0), 1.0)))
        return 1.0, strength * _step(wave, 0.2, 0.15)
    if kind == 4:
        fine = noise(9.0 * scale * x, 9.0 * scale * y, 9.0 * scale * z) - 0.5
        return 1.0 + strength * (rough(scale * x, scale * y, scale * z) + 0.5 * fine), 0.0
    if kind == 5:
        around = math.atan2(y, x) * radius_m
        weave = math.sin(2.0 * math.pi * scale * around) * math.sin(2.0 * math.pi * scale * z)
        folds = rough(30.0 * x, 30.0 * y, 12.0 * z)
        return 1.0 + strength * (0.3 * weave + 0.8 * folds), 0.0
    return 1.0, 0.0


@inner
def _ground(kind, x, y):
    """The factor on the ground's albedo, and its shift from red to green, at (x, y) in metres."""
    if kind == 0:  # asphalt: stones, patches, a crack
        stones = noise(160.0 * x, 160.0 * y, 0.5)
        crack = 1.0 - _step(abs(y - 3.1 - 0.3 * x - 0.25 * rough(3.0 * x, 0.0, 9.0)), 0.006, 0.006)
        return (0.65 + 0.5 * stones * stones + 0.35 * rough(5.0 * x, 5.0 * y, 2.0)) * (1.0 - 0.7 * crack), 0.0
    if kind == 1:  # planks along y
        board = math.floor(x / 0.14)
        gap = 1.0 - _step(abs(x / 0.14 - board - 0.5), 0.48, 0.02)
        grain = rough(90.0 * x, 4.0 * y, 3.0 * board)
        return (0.75 + 0.45 * chance(int(board), 3, 7) + 0.22 * grain) * (0.15 + 0.85 * gap), 0.0
    if kind == 2:  # grass
        blades = noise(120.0 * x + 3.0 * noise(20.0 * x, 20.0 * y, 1.0), 40.0 * y, 0.0)
        clumps = rough(6.0 * x, 6.0 * y, 1.5)
        return 0.45 + 0.9 * blades * blades + 0.3 * clumps, 0.12 * clumps
    speckle = noise(70.0 * x, 70.0 * y, 0.3)  # a hall's floor with lines
    line = 1.0 - _step(abs(x - 0.62), 0.025, 0.004)
    return 0.95 + 0.08 * speckle + 0.06 * rough(1.5 * x, 1.5 * y, 0.0) + 0.8 * line, 0.0


@inner
def _wall(kind, x, z):
    """The factor on the wall's albedo, and its shift from red to green, at (x, z) in metres."""
    if kind == 0:  # plaster in panels
        joint = 1.0 - _step(abs(x / 1.9 - math.floor(x / 1.9) - 0.5), 0.496, 0.003)
        return (0.96 + 0.05 * rough(40.0 * x, 40.0 * z, 0.0) + 0.05 * rough(1.3 * x, 1.3 * z, 5.0)) * (
            0.7 + 0.3 * joint
        ), 0.0
    if kind == 1:  # boards that lie
        board = math.floor(z / 0.18)
        gap = 1.0 - _step(abs(z / 0.18 - board - 0.5), 0.48, 0.02)
        return (0.75 + 0.45 * chance(int(board), 11, 2) + 0.2 * rough(3.0 * x, 70.0 * z, board)) * (
            0.2 + 0.8 * gap
        ), 0.0
    if kind == 2:  # bricks
        row = math.floor(z / 0.075)
        along = x / 0.24 + 0.5 * (row - 2.0 * math.floor(row / 2.0))
        brick = math.floor(along)
        inside = (1.0 - _step(abs(along - brick - 0.5), 0.475, 0.02)) * (
            1.0 - _step(abs(z / 0.075 - row - 0.5), 0.43, 0.06)
        )
        tone = 0.7 + 0.5 * chance(int(brick), int(row), 5) + 0.25 * rough(60.0 * x, 60.0 * z, 0.0)
        return inside * tone + (1.0 - inside) * 1.25, 0.08 * (1.0 - inside)
    leaves = noise(28.0 * x, 28.0 * z, 0.0) * noise(75.0 * x, 75.0 * z, 2.0)  # a hedge
    return 0.25 + 2.4 * leaves + 0.3 * rough(3.0 * x, 3.0 * z, 0.0), 0.1 * rough(9.0 * x, 9.0 * z, 4.0)


@inner
def ray_of(lens, x_px, y_px):
    """The unit direction on the stage of a pixel's ray. `lens` is fx, fy, cx, cy in pixels, the camera's height in
    metres, and the cosine and sine of how far it looks down."""
    a, b = (x_px - lens[2]) / lens[0], (y_px - lens[3]) / lens[1]
    scale = 1.0 / math.sqrt(a * a + b * b + 1.0)
    return a * scale, (lens[5] - b * lens[6]) * scale, (-lens[6] - b * lens[5]) * scale


@kernel(None, I8, I8, _LINE, _LINE, _LINE, _TABLE, I8, at_import=False)
def backdrop(height, width, lens, light, stage, patches, fine):
    """The empty stage: light of the sky and of the sun, each (height, width, 3) linear RGB float32, and how far it is
    along each pixel's ray in metres (height, width). fine x fine rays a pixel.

    `lens` as `ray_of` has it; `light` (12 or more) is sky, bounce, sun and the unit vector to the sun; `stage` (10,)
    is the ground's kind and albedo, the wall's kind, albedo, distance and height; `patches` (N, 7) is 0 for ground or
    1 for wall, the place on it, radius and albedo.
    """
    of_sky = np.zeros((height, width, 3), np.float32)
    of_sun = np.zeros((height, width, 3), np.float32)
    far = np.zeros((height, width), np.float32)
    colour = np.empty(3)
    share = 1.0 / (fine * fine)
    for r in range(height):
        for c in range(width):
            for s in range(fine * fine):
                px = c - 0.5 + (s % fine + chance(r, c, 2 * s)) / fine
                py = r - 0.5 + (s // fine + chance(r, c, 2 * s + 1)) / fine
                dx, dy, dz = ray_of(lens, px, py)
                down = -lens[4] / dz if dz < -1e-9 else 1e9
                ahead = stage[8] / dy if dy > 1e-9 else 1e9
                on_wall = ahead < down
                distance = min(ahead, down)
                x, y, z = distance * dx, distance * dy, lens[4] + distance * dz
                if on_wall and z > stage[9]:  # the sky, paler towards the horizon, with thin clouds
                    far[r, c] += np.float32(share * 1e4)
                    rise = max(dz, 0.0)
                    cloud = max(rough(2.0 * dx / (rise + 0.15), 2.0 / (rise + 0.15), 0.0), 0.0)
                    for k in range(3):
                        pale = 1.25 * (light[0] + light[1] + light[2]) / 3.0
                        blue = 1.15 * light[k]
                        tone = blue + (pale - blue) * min(1.0, 0.75 * math.exp(-4.0 * rise) + 0.5 * cloud)
                        of_sky[r, c, k] += np.float32(share * tone)
                    continue
                far[r, c] += np.float32(share * distance)
                u, v = (x, z) if on_wall else (x, y)
                first = 4 if on_wall else 0
                factor, shift = _wall(int(stage[4]), u, v) if on_wall else _ground(int(stage[0]), u, v)
                factor = max(factor, 0.02)
                colour[0] = stage[first + 1] * factor * (1.0 - shift)
                colour[1] = stage[first + 2] * factor * (1.0 + shift)
                colour[2] = stage[first + 3] * factor
                for k in range(len(patches)):
                    if (patches[k, 0] > 0.5) == on_wall:
                        off = math.sqrt((u - patches[k, 1]) ** 2 + (v - patches[k, 2]) ** 2)
                        if off < patches[k, 3]:
                            worn = 0.9 + 0.15 * factor / (factor + 0.5)
                            colour[0], colour[1], colour[2] = (
                                patches[k, 4] * worn,
                                patches[k, 5] * worn,
                                patches[k, 6] * worn,
                            )
                # Either plane takes a part of the other's sky near the corner between them.
                corner = 1.0 - 0.35 * math.exp(-(z if on_wall else stage[8] - y) / 0.35)
                nz = 0.0 if on_wall else 1.0
                facing = max(-light[10], 0.0) if on_wall else max(light[11], 0.0)
                # The wall stands between the ground and a sun behind it.
                if not on_wall and light[10] > 1e-6:
                    reach = (stage[8] - y) / light[10] * light[11]
                    if reach < stage[9]:
                        facing = 0.0
                for k in range(3):
                    sky = 0.5 * (light[k] * (1.0 + nz) + light[3 + k] * (1.0 - nz))
                    of_sky[r, c, k] += np.float32(share * colour[k] * sky * corner)
                    of_sun[r, c, k] += np.float32(share * colour[k] * light[6 + k] * facing)
    return of_sky, of_sun, far
