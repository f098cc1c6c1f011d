"""The ray caster, in compiled loops: where a ray meets spheres, capsules, boxes and bands, what light comes from there,
and the exposure of one picture over pixel area and time.

Things are two tables. `knots` (K, N, 7) is where each of N things is at K even instants, K > 1: a sphere's or box's
centre or a capsule's end (3), its other end, the box's half edges or the band's axis (3), and its turn in radians;
between two instants everything moves evenly. `solids` (N, 20) is what does not change, its columns the constants
below.
"""

import math

import numba
import numpy as np

from spheremcap.core.compiled import F4, F8, I8, array, inner, kernel
from spheremcap.synth.daylight.surfaces import chance, pattern_of, ray_of

_LINE, _TABLE, _KNOTS, _LAYER = array(F8, 1), array(F8, 2), array(F8, 3), array(F4, 3)
SPHERE, CAPSULE, BOX, BAND = 0, 1, 2, 3
KIND, RADIUS, PATTERN, SCALE, STRENGTH, GLOSS, EXPONENT = 0, 1, 2, 3, 4, 5, 6
SPIN, ALBEDO, SECOND = 7, 10, 13  # three columns each
HALF_WIDTH, OFFSET = 16, 17  # of a band: metres along its axis
MARKER = 18  # 1 for a marker and what holds it
COLUMNS = 20
_FAR = 1e9
_TILE, _BLOCK = 8, 64  # pixels; what may touch a block is looked for in its tiles
_FIRST = 2  # rays for each pixel whose first meets a thing, or near a marker
_ON_MARKER = 8  # rays for each pixel of a marker, whose print may move and turn while it is exposed
_BESIDE = 0.2  # of the rays at an edge are enough where no marker is near
_TURN_X, _TURN_Y, _TURN_T = 0.8191725133961645, 0.6710436067037893, 0.5497004779019703
# Steps of a sequence that fills the unit cube evenly: powers of 1 / g, g**4 = g + 1 (Roberts 2018).


@inner
def _between(knots, k, f, i, j):
    """Number j of thing i at f between instants k and k + 1."""
    return knots[k, i, j] + f * (knots[k + 1, i, j] - knots[k, i, j])


@inner
def _meets(knots, solids, i, k, f, ox, oy, oz, dx, dy, dz):
    """How far along a unit ray from (ox, oy, oz) it first meets thing i, which it starts outside of; _FAR if never."""
    ax = ox - _between(knots, k, f, i, 0)
    ay = oy - _between(knots, k, f, i, 1)
    az = oz - _between(knots, k, f, i, 2)
    kind, radius = solids[i, KIND], solids[i, RADIUS]
    along = ax * dx + ay * dy + az * dz
    if kind in (SPHERE, BAND):
        px, py, pz = ax - along * dx, ay - along * dy, az - along * dz
        inside = radius * radius - (px * px + py * py + pz * pz)
        if inside <= 0.0:
            return _FAR
        half = math.sqrt(inside)
        if kind == SPHERE:
            return -along - half if -along - half > 1e-7 else _FAR
        ux, uy, uz = _between(knots, k, f, i, 3), _between(knots, k, f, i, 4), _between(knots, k, f, i, 5)
        for side in (-1.0, 1.0):
            t = -along + side * half
            place = (ax + t * dx) * ux + (ay + t * dy) * uy + (az + t * dz) * uz - solids[i, OFFSET]
            if t > 1e-7 and abs(place) < solids[i, HALF_WIDTH]:
                return t
        return _FAR
    bx, by, bz = _between(knots, k, f, i, 3), _between(knots, k, f, i, 4), _between(knots, k, f, i, 5)
    if kind == BOX:
        near, far = -_FAR, _FAR
        for o, d, h in ((ax, dx, bx), (ay, dy, by), (az, dz, bz)):
            d = d if abs(d) > 1e-12 else 1e-12
            near, far = max(near, (-o - math.copysign(h, d)) / d), min(far, (-o + math.copysign(h, d)) / d)
        return near if 1e-7 < near < far else _FAR
    # A capsule: the cylinder first, then the ball at the end beyond which it is met.
    bx, by, bz = bx - ox + ax, by - oy + ay, bz - oz + az
    length2 = bx * bx + by * by + bz * bz
    slope, start = bx * dx + by * dy + bz * dz, bx * ax + by * ay + bz * az
    p = length2 - slope * slope
    q = length2 * along - start * slope
    inside = q * q - p * (length2 * (ax * ax + ay * ay + az * az - radius * radius) - start * start)
    if inside < 0.0:
        return _FAR
    t = (-q - math.sqrt(inside)) / max(p, 1e-15)
    place = start + t * slope
    if 0.0 < place < length2:
        return t if t > 1e-7 else _FAR
    if place >= length2:
        ax, ay, az = ax - bx, ay - by, az - bz
        along = ax * dx + ay * dy + az * dz
    px, py, pz = ax - along * dx, ay - along * dy, az - along * dz
    inside = radius * radius - (px * px + py * py + pz * pz)
    if inside <= 0.0:
        return _FAR
    t = -along - math.sqrt(inside)
    return t if t > 1e-7 else _FAR


@inner
def _nearest(knots, solids, among, count, k, f, ox, oy, oz, dx, dy, dz):
    """(which of the first `count` things of `among` a ray meets first, -1 for none; how far away)."""
    which, distance = -1, _FAR
    for n in range(count):
        t = _meets(knots, solids, among[n], k, f, ox, oy, oz, dx, dy, dz)
        if t < distance:
            which, distance = among[n], t
    return which, distance


@inner
def _across_sun(light, x, y, z):
    """A place seen along the sun's rays: two coordinates across them, and how far towards the sun."""
    return (
        x * light[12] + y * light[13] + z * light[14],
        x * light[15] + y * light[16] + z * light[17],
        x * light[9] + y * light[10] + z * light[11],
    )


@inner
def _shadows(knots, solids, light):
    """All things as seen along the sun's rays, each a segment with a width that holds it during the whole picture (N,
    7): one end across the rays, the way to the other end and the inverse of its square, the square of the width, and
    the end nearest to the sun."""
    out = np.empty((len(solids), 7))
    middle = len(knots) // 2
    for n in range(len(solids)):
        a = knots[middle, n]
        first = 3 if solids[n, KIND] == CAPSULE else 0
        u, v, w = _across_sun(light, a[0], a[1], a[2])
        p, q, r = _across_sun(light, a[first], a[first + 1], a[first + 2])
        wide = solids[n, RADIUS]
        if solids[n, KIND] == BOX:
            wide = math.sqrt(a[3] * a[3] + a[4] * a[4] + a[5] * a[5])
        away = 0.0
        for k in range(len(knots)):
            b = knots[k, n]
            for m in (0, first):
                away = max(away, (b[m] - a[m]) ** 2 + (b[m + 1] - a[m + 1]) ** 2 + (b[m + 2] - a[m + 2]) ** 2)
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = u, v, p - u, q - v
        out[n, 4] = 1.0 / max((p - u) ** 2 + (q - v) ** 2, 1e-12)
        wide += math.sqrt(away) + 1e-6
        out[n, 5], out[n, 6] = wide * wide, max(w, r) + wide
    return out


@inner
def _in_shade(knots, solids, shadows, among, count, own, k, f, x, y, z, light):
    """Whether something other than thing `own` stands between a place and the sun."""
    u, v, w = _across_sun(light, x, y, z)
    for n in range(count):
        i = among[n]
        du, dv = u - shadows[i, 0], v - shadows[i, 1]
        part = min(max((du * shadows[i, 2] + dv * shadows[i, 3]) * shadows[i, 4], 0.0), 1.0)
        du, dv = du - part * shadows[i, 2], dv - part * shadows[i, 3]
        if du * du + dv * dv > shadows[i, 5] or i == own or w > shadows[i, 6]:
            continue
        if _meets(knots, solids, i, k, f, x, y, z, light[9], light[10], light[11]) < _FAR:
            return True
    return False


@inner
def _normal(knots, solids, i, k, f, x, y, z, dx, dy, dz):
    """The outward unit normal of thing i at a place on it, and that place in the frame that moves with the thing."""
    ax, ay, az = _between(knots, k, f, i, 0), _between(knots, k, f, i, 1), _between(knots, k, f, i, 2)
    px, py, pz = x - ax, y - ay, z - az
    kind, radius = solids[i, KIND], solids[i, RADIUS]
    if kind == CAPSULE:
        bx, by, bz = (
            _between(knots, k, f, i, 3) - ax,
            _between(knots, k, f, i, 4) - ay,
            _between(knots, k, f, i, 5) - az,
        )
        length2 = bx * bx + by * by + bz * bz
        part = min(max((px * bx + py * by + pz * bz) / length2, 0.0), 1.0)
        nx, ny, nz = (px - part * bx) / radius, (py - part * by) / radius, (pz - part * bz) / radius
        # Across the axis, as far as can be along a direction that no limb lies in.
        scale = 1.0 / math.sqrt(length2)
        bx, by, bz = bx * scale, by * scale, bz * scale
        ex, ey, ez = 0.9 * bz - 0.3 * by, 0.3 * bx - 0.2 * bz, 0.2 * by - 0.9 * bx
        scale = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez + 1e-12)
        ex, ey, ez = ex * scale, ey * scale, ez * scale
        gx, gy, gz = by * ez - bz * ey, bz * ex - bx * ez, bx * ey - by * ex
        u, v, w = px * ex + py * ey + pz * ez, px * gx + py * gy + pz * gz, px * bx + py * by + pz * bz
        return nx, ny, nz, u, v, w
    if kind == BOX:
        qx, qy, qz = px / knots[k, i, 3], py / knots[k, i, 4], pz / knots[k, i, 5]
        nx, ny, nz = 0.0, 0.0, 0.0
        if abs(qx) >= max(abs(qy), abs(qz)):
            nx = math.copysign(1.0, qx)
        elif abs(qy) >= abs(qz):
            ny = math.copysign(1.0, qy)
        else:
            nz = math.copysign(1.0, qz)
        return nx, ny, nz, px, py, pz
    nx, ny, nz = px / radius, py / radius, pz / radius
    if kind == BAND and nx * dx + ny * dy + nz * dz > 0.0:  # its inner side
        nx, ny, nz = -nx, -ny, -nz
    # The place turned back about the thing's axis (Rodrigues).
    turn = -_between(knots, k, f, i, 6)
    cos, sin = math.cos(turn), math.sin(turn)
    sx, sy, sz = solids[i, SPIN], solids[i, SPIN + 1], solids[i, SPIN + 2]
    dot = (sx * px + sy * py + sz * pz) * (1.0 - cos)
    u = px * cos + (sy * pz - sz * py) * sin + sx * dot
    v = py * cos + (sz * px - sx * pz) * sin + sy * dot
    w = pz * cos + (sx * py - sy * px) * sin + sz * dot
    return nx, ny, nz, u, v, w


@inner
def _ray_light(lens, light, knots, solids, shadows, among, count, shades, shading, every, k, f, px, py, back, colour):
    """The light that comes along one ray into `colour` (3,), linear RGB, and what it is of: 0 for the backdrop, i + 1
    for thing i, doubled, and one more in the shade. `back` (7,) is the backdrop's light of sky and of sun, and how far
    it is.

    Lambert under a hemisphere of sky and bounce and a sun without size; over it a clear coat with Schlick's reflection
    of sky, ground and, at its rim, backdrop, and Blinn's highlight, scaled to reflect the same whatever its width.
    """
    dx, dy, dz = ray_of(lens, px, py)
    which, t = _nearest(knots, solids, among, count, k, f, 0.0, 0.0, lens[4], dx, dy, dz)
    if which < 0:
        t = back[6]
        dark = shading > 0 and _in_shade(
            knots, solids, shadows, shades, shading, -1, k, f, t * dx, t * dy, lens[4] + t * dz, light
        )
        for j in range(3):
            colour[j] = back[j] if dark else back[j] + back[3 + j]
        return 1 if dark else 0
    x, y, z = t * dx, t * dy, lens[4] + t * dz
    nx, ny, nz, u, v, w = _normal(knots, solids, which, k, f, x, y, z, dx, dy, dz)
    factor, mix = pattern_of(
        int(solids[which, PATTERN]), u, v, w, solids[which, RADIUS], solids[which, SCALE], solids[which, STRENGTH]
    )
    factor = max(factor, 0.0)
    facing = nx * light[9] + ny * light[10] + nz * light[11]
    # Beside the terminator a ray to the sun would run along the surface: the place is lifted off it a little.
    dark = (
        facing > 0.0
        and light[6] + light[7] + light[8] > 0.0
        and _in_shade(
            knots, solids, shadows, every, len(every), which, k, f, x + 1e-6 * nx, y + 1e-6 * ny, z + 1e-6 * nz, light
        )
    )
    lit = max(facing, 0.0) if not dark else 0.0
    gloss = solids[which, GLOSS]
    fresnel, shine, rise, through = 0.0, 0.0, 0.0, 0.0
    if gloss > 0.0:
        slant = -(nx * dx + ny * dy + nz * dz)
        graze = 1.0 - min(max(slant, 0.0), 1.0)
        fresnel = gloss * (0.04 + 0.96 * graze * graze * graze * graze * graze)
        rise = min(max(5.0 * (dz + 2.0 * slant * nz) + 0.5, 0.0), 1.0)  # the mirrored ray: 1 sees sky, 0 ground
        # A ray that only grazes goes on almost as it came, to the backdrop behind.
        through = max(1.0 - 2.0 * slant * slant, 0.0) ** 4
        if lit > 0.0:
            hx, hy, hz = light[9] - dx, light[10] - dy, light[11] - dz
            narrow = solids[which, EXPONENT]
            half = (nx * hx + ny * hy + nz * hz) / math.sqrt(hx * hx + hy * hy + hz * hz)
            if half > 0.0 and (1.0 - half) * narrow < 8.0:  # e**-8 and less is nothing
                shine = gloss * 0.04 * (narrow + 8.0) / 8.0 * math.exp(narrow * math.log(half)) * lit
    for j in range(3):
        albedo = solids[which, ALBEDO + j]
        albedo = factor * (albedo + mix * (solids[which, SECOND + j] - albedo))
        sky, bounce, sun = light[j], light[3 + j], light[6 + j]
        soft = 0.5 * (sky * (1.0 + nz) + bounce * (1.0 - nz))
        mirrored = bounce + rise * (sky - bounce)
        mirrored += through * (back[j] + back[3 + j] - mirrored)
        colour[j] = albedo * (soft + sun * lit) * (1.0 - fresnel) + fresnel * mirrored + shine * sun
    return 2 * (which + 1) + (1 if dark else 0)


@inner
def _from_line(ox, oy, oz, dx, dy, dz, ax, ay, az, bx, by, bz):
    """The least distance between a half line and a segment, a little less at worst, and where on the half line."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    wx, wy, wz = ax - ox, ay - oy, az - oz
    uu, wu = ux * ux + uy * uy + uz * uz, wx * ux + wy * uy + wz * uz
    ud, wd = ux * dx + uy * dy + uz * dz, wx * dx + wy * dy + wz * dz
    part = 0.0
    if uu > 1e-12:
        part = min(max((ud * wd - wu) / max(uu - ud * ud, 1e-12), 0.0), 1.0)
    t = max(wd + part * ud, 0.0)
    ex, ey, ez = wx + part * ux - t * dx, wy + part * uy - t * dy, wz + part * uz - t * dz
    return math.sqrt(ex * ex + ey * ey + ez * ez), t


@inner
def _may_touch(knots, solids, hulls, i, ox, oy, oz, dx, dy, dz, wide, opening):
    """Whether thing i may come, during the picture, as near to a half line as `wide` plus `opening` times the distance
    along it: never False when it does."""
    off, t = _from_line(
        ox, oy, oz, dx, dy, dz, hulls[i, 0], hulls[i, 1], hulls[i, 2], hulls[i, 0], hulls[i, 1], hulls[i, 2]
    )
    if off > hulls[i, 3] + wide + opening * (t + hulls[i, 3]):
        return False
    kind, radius = solids[i, KIND], solids[i, RADIUS]
    for k in range(len(knots)):
        a, b = knots[k, i], knots[k, i]
        if kind == CAPSULE:
            off, t = _from_line(ox, oy, oz, dx, dy, dz, a[0], a[1], a[2], b[3], b[4], b[5])
        else:
            off, t = _from_line(ox, oy, oz, dx, dy, dz, a[0], a[1], a[2], a[0], a[1], a[2])
        if kind == BOX:
            radius = math.sqrt(a[3] * a[3] + a[4] * a[4] + a[5] * a[5])
        if off < radius + hulls[i, 4] + wide + opening * (t + radius):
            return True
    return False


@inner
def _sort(of_sun, far, lens, light, knots, solids, hulls, side, above, touch, shade):
    """What may touch, and what may shade the backdrop of, each square of `side` pixels: for both, how many (rows,
    columns) and which (rows, columns, N). Only what `touch` and `shade` have for the squares of `above` pixels is
    looked at, or all where they have one square.
    """
    height, width = far.shape
    rows, columns = (height + side - 1) // side, (width + side - 1) // side
    touching, shading = np.zeros((rows, columns), np.int64), np.zeros((rows, columns), np.int64)
    among = np.empty((rows, columns, len(solids)), np.int64)
    shades = np.empty((rows, columns, len(solids)), np.int64)
    opening = 0.5 * side * math.sqrt(1.0 / lens[0] ** 2 + 1.0 / lens[1] ** 2)
    for i in range(rows):
        for j in range(columns):
            p, q = min(i * side // above, len(touch[0]) - 1), min(j * side // above, touch[0].shape[1] - 1)
            if touch[0][p, q] + shade[0][p, q] == 0:
                continue
            r0, r1, c0, c1 = i * side, min((i + 1) * side, height) - 1, j * side, min((j + 1) * side, width) - 1
            dx, dy, dz = ray_of(lens, 0.5 * (c0 + c1), 0.5 * (r0 + r1))
            for m in range(touch[0][p, q]):
                n = touch[1][p, q, m]
                if _may_touch(knots, solids, hulls, n, 0.0, 0.0, lens[4], dx, dy, dz, 0.0, opening):
                    among[i, j, touching[i, j]] = n
                    touching[i, j] += 1
            if shade[0][p, q] == 0:
                continue
            t = far[(r0 + r1) // 2, (c0 + c1) // 2]
            x, y, z = t * dx, t * dy, lens[4] + t * dz
            reach, sunny = 0.0, 0.0
            for r, c in ((r0, c0), (r0, c1), (r1, c0), (r1, c1)):
                ex, ey, ez = ray_of(lens, c, r)
                s = far[r, c]
                reach = max(reach, math.sqrt((s * ex - x) ** 2 + (s * ey - y) ** 2 + (lens[4] + s * ez - z) ** 2))
                sunny += of_sun[r, c, 1]
            for m in range(shade[0][p, q] if sunny > 0.0 else 0):
                n = shade[1][p, q, m]
                if _may_touch(knots, solids, hulls, n, x, y, z, light[9], light[10], light[11], 1.3 * reach, 0.0):
                    shades[i, j, shading[i, j]] = n
                    shading[i, j] += 1
    return (touching, among), (shading, shades)


@kernel(None, _LAYER, _LAYER, array(F4, 2), _LINE, _LINE, _KNOTS, _TABLE, _TABLE, _LINE, I8, I8, at_import=False)
def expose(of_sky, of_sun, far, lens, light, knots, solids, hulls, when, rays, salt):
    """One picture's light (height, width, 3), linear RGB float32, over pixel area and exposure time.

    `of_sky`, `of_sun`, `far` are the backdrop and `lens`, `light` as `surfaces.backdrop` has them, with two unit
    vectors across the sun's rays at the end of `light` (18,); `hulls` (N, 5) are spheres around all places a thing
    takes (centre, radius) and the most it moves between two knots. `when` (5,) is the first knot's instant, the time
    between knots, the middle of the middle row's exposure, the exposure and the time between rows, in seconds. Where
    a tile may be touched each pixel gets a ray, two if that meets a thing or a marker may touch the tile, eight on a
    marker and at its edge `rays`, at others fewer: where they do not all meet the same thing or a neighbour's meet
    another. Elsewhere the backdrop is copied. `salt` goes into the rays' places.
    """
    height, width, _ = of_sky.shape
    out = of_sky + of_sun
    number = len(solids)
    every = np.arange(number)
    shadows = _shadows(knots, solids, light)
    all_here = np.full((1, 1), number), every.reshape(1, 1, number)
    blocks = _sort(of_sun, far, lens, light, knots, solids, hulls, _BLOCK, _BLOCK, all_here, all_here)
    tiles = _sort(of_sun, far, lens, light, knots, solids, hulls, _TILE, _BLOCK, blocks[0], blocks[1])
    (touching, among), (shading, shades) = tiles
    markers = np.zeros(touching.shape, np.bool_)
    for i in range(len(touching)):
        for j in range(touching.shape[1]):
            for n in range(touching[i, j]):
                markers[i, j] = markers[i, j] or solids[among[i, j, n], MARKER] > 0.5
    seen, cast = np.zeros((height, width), np.int32), np.zeros((height, width), np.int32)
    colour, back, total = np.empty(3), np.empty(7), np.empty(3)
    last = len(knots) - 2
    for second in range(2):
        for r in range(height):
            for c in range(width):
                i, j = r // _TILE, c // _TILE
                if touching[i, j] + shading[i, j] == 0:
                    continue
                if second == 0:
                    first, end = 0, min(_ON_MARKER, rays)
                    total[0], total[1], total[2] = 0.0, 0.0, 0.0
                else:
                    same, marked = seen[r, c] >= 0, False
                    for p in range(max(r - 1, 0), min(r + 2, height)):
                        for q in range(max(c - 1, 0), min(c + 2, width)):
                            of = seen[p, q]
                            same = same and of == seen[r, c]
                            marked = marked or of == -2 or (of > 1 and solids[of // 2 - 1, MARKER] > 0.5)
                    if same or rays < 2:
                        continue
                    first, end = cast[r, c], rays if marked else max(int(_BESIDE * rays), _FIRST)
                    for m in range(3):
                        total[m] = out[r, c, m] * first
                for m in range(3):
                    back[m], back[3 + m] = of_sky[r, c, m], of_sun[r, c, m]
                back[6] = far[r, c]
                u, v, w = chance(r, c, 3 * salt), chance(r, c, 3 * salt + 1), chance(r, c, 3 * salt + 2)
                of, mixed, marked = 0, False, False
                for s in range(first, end):
                    x, y, late = u + s * _TURN_X, v + s * _TURN_Y, w + s * _TURN_T
                    x, y, late = x - math.floor(x) - 0.5, y - math.floor(y) - 0.5, late - math.floor(late) - 0.5
                    at = when[2] + (r - 0.5 * (height - 1)) * when[4] + late * when[3]
                    place = (at - when[0]) / when[1]
                    k = min(max(int(place), 0), last)
                    is_of = _ray_light(
                        lens, light, knots, solids, shadows, among[i, j], touching[i, j], shades[i, j], shading[i, j],
                        every, k, place - k, c + x, r + y, back, colour,
                    )  # fmt: skip
                    mixed = mixed or (s > first and is_of != of)
                    of = is_of
                    marked = marked or (of > 1 and solids[of // 2 - 1, MARKER] > 0.5)
                    total[0] += colour[0]
                    total[1] += colour[1]
                    total[2] += colour[2]
                    enough = _ON_MARKER if marked else _FIRST if of > 1 or markers[i, j] else 1
                    if second == 0 and s + 1 >= enough:
                        end = s + 1
                        break
                cast[r, c] = end
                for m in range(3):
                    out[r, c, m] = np.float32(total[m] / end)
                if second == 0:
                    seen[r, c] = of if not mixed else -2 if marked else -1
    return out


@kernel(numba.types.UniTuple(I8, 2), _LINE, _KNOTS, _TABLE, I8, _LINE, _LINE, I8, I8, I8, at_import=False)
def shown(lens, knots, solids, which, when, box, fine, height, width):
    """(rays that meet thing `which`, those of them that meet nothing before it and lie in the picture) of fine x fine
    rays through `box` (x0, y0, x1, y1) in pixels, each at the middle of its row's exposure; `when` as in `expose`."""
    met, free = 0, 0
    among = np.arange(len(solids))
    last = len(knots) - 2
    for n in range(fine):
        y = box[1] + (n + 0.5) / fine * (box[3] - box[1])
        place = (when[2] + (y - 0.5 * (height - 1)) * when[4] - when[0]) / when[1]
        k = min(max(int(place), 0), last)
        for m in range(fine):
            x = box[0] + (m + 0.5) / fine * (box[2] - box[0])
            dx, dy, dz = ray_of(lens, x, y)
            if _meets(knots, solids, which, k, place - k, 0.0, 0.0, lens[4], dx, dy, dz) == _FAR:
                continue
            met += 1
            if not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5):
                continue
            found, _ = _nearest(knots, solids, among, len(among), k, place - k, 0.0, 0.0, lens[4], dx, dy, dz)
            free += found == which
    return met, free
