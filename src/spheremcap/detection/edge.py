"""Sub-pixel edge points on a marker's outline, each with its own uncertainty.

Along rays across the expected outline the pixel values are mixtures of marker and background. Mixing is a sum in
linear light only, so the sRGB curve is undone first. Chroma is projected on the difference that tells marker from
background there whatever the light does, the marker's limb darkening is allowed for, and the edge is where the step
that the lens and the known motion make (a Gaussian, swept along the blur) explains the profile best by least squares.
Brightness and chroma are weighed by their own evidence, ray by ray: chroma is blurred by its half resolution, and
brightness varies with the light.
"""

import math

import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.compiled import BOOL, F4, F8, PLANE, array, inner, kernel
from spheremcap.core.frame import Frame
from spheremcap.core.linear import inverse3, middle
from spheremcap.core.look import EdgePoints
from spheremcap.core.sampling import GRID, bgr_at, clipped, hsv_of, levels_at, soft_levels_at
from spheremcap.core.stage import StageConfig
from spheremcap.detection.colour import in_box
from spheremcap.detection.shading import Rings

FloatArray = npt.NDArray[np.float64]


class EdgeConfig(StageConfig):
    """Ours throughout; the defaults were judged on seven rendered scenarios at once, never on one."""

    rays: int = Field(48, ge=16, le=360, description="rays around the outline")
    blur_sigma_px: float = Field(0.5, gt=0, description="Gaussian blur of lens, sensor and codec")
    learn_blur: bool = Field(True, description="look at the seed for a softer lens than `blur_sigma_px`")
    chroma_sigma_px: float = Field(
        1.15, gt=0, description="further blur of chroma at half resolution: a box of 2 px, and the spline it is read by"
    )
    noise: float = Field(0.006, gt=0, description="least pixel noise, code values with full scale 1")
    balance: float = Field(
        0.02, gt=0, description="colour differences below this do not steer the projection, code values"
    )
    least_contrast: float = Field(4.0, gt=0, description="step over its own standard deviation that makes an edge")
    shading: bool = Field(True, description="carry the marker's shading on to the limb")
    chroma: bool = Field(True, description="false: edges in brightness alone (ablation)")


_STEP = 0.7  # px between samples on a ray near the edge
_DEEP = 16  # samples between the edge and the deepest place, at most
_SHARED = 2.5  # neighbouring samples of chroma at half resolution that share an error
_STEP_SD = 0.3  # standard deviation of the step that is seen, over the step between the levels on either side
_TEXTURE = 0.0125  # share of the background's variance along the outline that is expected across it
_CARRIED = 0.2  # share of the shading's variance that is, where shading has to be carried on by half the radius
_READ_PLAINLY = 0.87  # of chroma's blur is left where every pixel has its own and no spline is needed
_NO_LIMITS = np.empty(0)
_NO_SHADING = np.empty((0, 0), np.float32)


def edge_params(config: EdgeConfig) -> FloatArray:
    """The config as the compiled loops take it, (6,): chroma blur, noise, balance, least contrast, shading, chroma."""
    return np.array(
        [
            config.chroma_sigma_px, config.noise, config.balance, config.least_contrast, config.shading, config.chroma,
        ],
        np.float64,
    )  # fmt: skip


def find_edges(
    frame: Frame,
    outline_px: FloatArray,
    r_px: float,
    reach_px: float,
    blur_px: FloatArray,
    limits: FloatArray | None,
    config: EdgeConfig,
    coarse: bool = False,
    sigma_px: float | None = None,
    shading: Rings = _NO_SHADING,
) -> EdgePoints | None:
    """Edge points near an expected outline (image pixels, (N, 2), clockwise on screen); None when there is no contrast.

    `reach_px` is how far from the outline an edge may be; `blur_px` (2,) the motion during the exposure;
    `limits` the colours of the marker (`ColourBox.limits`; edges whose inner side has others are left out), or None;
    `sigma_px` the blur of lens and codec where it is not the config's.
    `coarse` samples at half the density and leaves the shading out: a quarter of the work, for a first look. `shading`
    is what is known of it from earlier frames (`Shading.profile`, with N rays).
    """
    outline = np.ascontiguousarray(outline_px, np.float64)
    count = len(outline)
    points, sd, ray, offset = np.empty((count, 2)), np.empty(count), np.empty(count), np.empty(count)
    found, rays, explained = _find_edges(
        *frame.planes, outline, r_px, reach_px, blur_px[0], blur_px[1], _NO_LIMITS if limits is None else limits,
        config.blur_sigma_px if sigma_px is None else sigma_px, edge_params(config), coarse, shading,
        points, sd, ray, offset,
    )  # fmt: skip
    if found == 0:
        return None
    whole = ray[:found].astype(np.intp)
    return EdgePoints(points[:found], sd[:found], whole, offset[:found], rays, explained)


@inner
def edges_into(
    y, u, v, grid, outline, r_px, reach_px, blur_x, blur_y, limits, sigma, params, coarse, shading,
    points, sd, ray, offset,
):  # fmt: skip
    """`find_edges` into the first places of `points` (N, 2), `sd`, `ray` and `offset` (N,): how many there are (0 for
    none), how many rays lay inside the picture, and the share of the profiles that the step explains.

    Arrays over places and rays have the rays innermost, so that each loop over rays runs in vector registers.
    """
    count = len(outline)
    normal, inside = np.empty((count, 2)), np.empty(count, np.float32)
    across, along = np.empty(count, np.float32), np.empty(count, np.float32)
    soft = sigma + 0.5 * params[0]
    margin = soft + 0.2
    widest, in_picture = _set_rays(y, outline, blur_x, blur_y, margin, normal, inside, across, along)
    if in_picture < 8:
        return 0, in_picture, 0.0
    window, colours, direction, varies, limb, v_first, fine, half, depth = _profiles(
        y, u, v, grid, outline, normal, inside, across, along, 1.0, r_px, reach_px, margin, widest, params, coarse,
        shading,
    )  # fmt: skip
    shifts, chroma_sigma = 2 * half + 1, _chroma_sigma(grid, params)
    light, cover = np.empty((len(limb), count), np.float32), np.empty((len(limb), 1), np.float32)
    _through_lens(v_first, fine, limb, r_px, sigma, light, cover)
    shapes = np.empty((2, len(limb), count), np.float32)
    _set_shapes(light, cover, depth, v_first, fine, *colours, direction, across, along, r_px, chroma_sigma, shapes)

    cost, power = np.zeros((shifts, count), np.float32), np.zeros((shifts, count), np.float32)
    seen, left_over = np.zeros(count, np.float32), np.zeros(count, np.float32)
    shared = _SHARED if grid[0] > 1.0 else 1.0
    _match(window[:1], direction[:1], shapes[0], varies[0], params[1], 1.0, cost, power, seen, left_over)
    _match(window[1:], direction[1:], shapes[1], varies[1], params[1], shared, cost, power, seen, left_over)

    found, seen_power, left_power = 0, 0.0, 0.0
    for n in range(count):
        best = 0
        for k in range(1, shifts):
            if cost[k, n] < cost[best, n]:
                best = k
        if inside[n] == 0.0 or best == 0 or best == shifts - 1:
            continue
        left, mid, right = float(cost[best - 1, n]), float(cost[best, n]), float(cost[best + 1, n])
        bend = left - 2.0 * mid + right
        if not bend > 0.0:
            continue
        moved = (best - half) * fine + 0.5 * (left - right) / bend * fine
        deviation = fine * math.sqrt(2.0 / bend)  # half the second derivative is the Fisher information
        if not (math.sqrt(power[best, n]) > params[3] and deviation < 2.0):
            continue
        if len(limits) > 0:
            back = max(moved - 1.5 - abs(across[n]) / 2.0 - soft, -0.7 * r_px)
            if not _own_colour(
                y, u, v, grid, outline[n, 0] + back * normal[n, 0], outline[n, 1] + back * normal[n, 1], limits
            ):
                continue
        points[found, 0] = outline[n, 0] + moved * normal[n, 0]
        points[found, 1] = outline[n, 1] + moved * normal[n, 1]
        sd[found], ray[found], offset[found] = max(deviation, 0.02), n, moved
        seen_power += seen[n]
        left_power += left_over[n]
        found += 1
    if found < 6:
        return 0, in_picture, 0.0
    return found, in_picture, 1.0 - left_power / max(seen_power, 1e-12)


@inner
def misfits_into(
    y, u, v, grid, outline, r_px, reach_px, way_x, way_y, believed, softnesses, exposures, sigma, params, shading,
    shown, out,
):  # fmt: skip
    """How badly each softness of the lens and exposure time explain the profiles across an outline (N, 2), into `out`
    (softnesses, exposures): the mean logarithm of the squares that are left, over the rays (N,) that `shown` an edge.
    False where there are too few.

    It falls by as much as the likelihood rises, were all candidates to explain the same samples: these reach as far as
    the longest exposure needs. A lens blurs all rays alike, motion those across it: so each is told from the other.
    `way_x`, `way_y` is the motion in a frame interval, of which the exposures are shares, `believed` the share by which
    the light's fall towards the limb is told from its blur; the rest as in `find_edges`.
    """
    count = len(outline)
    normal, inside = np.empty((count, 2)), np.empty(count, np.float32)
    across, along = np.empty(count, np.float32), np.empty(count, np.float32)
    margin = sigma + 0.5 * params[0] + 0.2
    widest, _ = _set_rays(y, outline, way_x, way_y, margin, normal, inside, across, along)
    used = 0
    for n in range(count):
        used += shown[n] and inside[n] > 0.0
    if used < 8:
        return False
    window, colours, direction, _, limb, v_first, fine, half, depth = _profiles(
        y, u, v, grid, outline, normal, inside, across, along, believed, r_px, reach_px, margin, widest, params, False,
        shading,
    )  # fmt: skip
    shifts, chroma_sigma = 2 * half + 1, _chroma_sigma(grid, params)
    shapes = np.empty((2, len(limb), count), np.float32)
    sse, rise = np.empty((shifts, count), np.float32), np.empty((shifts, count), np.float32)
    expected = np.empty((shifts, count), np.float32)
    whole, other = np.empty(count, np.float32), np.empty(count, np.float32)
    luma, chroma = np.empty(count, np.float32), np.empty(count, np.float32)
    of_luma, of_chroma = _along(window[:1], direction[:1], whole), _along(window[1:], direction[1:], other)
    light, cover = np.empty((len(limb), count), np.float32), np.empty((len(limb), 1), np.float32)
    for i in range(len(softnesses)):
        _through_lens(v_first, fine, limb, r_px, sigma * softnesses[i], light, cover)
        for j in range(len(exposures)):
            share = np.float32(exposures[j])
            _set_shapes(
                light, cover, depth, v_first, fine, *colours, direction, share * across, share * along, r_px,
                chroma_sigma, shapes,
            )  # fmt: skip
            _set_squares(of_luma, whole, shapes[0], sse, rise, expected, luma)
            _set_squares(of_chroma, other, shapes[1], sse, rise, expected, chroma)
            total = 0.0
            for n in range(count):
                if shown[n] and inside[n] > 0.0:
                    total += math.log(luma[n] + chroma[n] + 1e-7)
            out[i, j] = total / used
    return True


@inner
def _profiles(
    y, u, v, grid, outline, normal, inside, across, along, believed, r_px, reach_px, margin, widest, params, coarse,
    shading,
):  # fmt: skip
    """What the rays show, and what tells marker from background on them: samples (3, M, N) where the edge may be, the
    colours (3, N) inside and outside, what `_directions` says, and the limb (V, N) against the distance from the edge,
    as a share `believed` of the blur (`across`, `along`) shows it; the first such distance, the step to the next, and
    how many steps the edge may be off, either way; how deep the colour inside was taken (N,)."""
    count = len(outline)
    place, step, deepest, deep_steps, near = _places(r_px, reach_px + margin + widest, widest, coarse)
    samples = np.empty((3, len(place), count), np.float32)
    _sample(y, u, v, grid, outline, normal, place, deep_steps, samples)
    depth, beyond = np.empty(count, np.float32), np.empty(count, np.float32)
    for n in range(count):
        clear = margin + abs(across[n]) / 2.0
        aside = r_px - math.sqrt(max(r_px * r_px - 0.25 * along[n] * along[n], 0.0))
        depth[n] = min(max(clear, margin + aside) + 0.5 * reach_px, 0.6 * deepest)
        beyond[n] = clear + 0.5 * reach_px - 0.5
    colour_in, colour_out = np.zeros((3, count), np.float32), np.zeros((3, count), np.float32)
    _levels(samples, place, depth, beyond, r_px, colour_in, colour_out)
    direction, varies = np.empty((3, count), np.float32), np.empty((2, count), np.float32)
    _directions(
        samples, place, depth, r_px, inside, colour_in, colour_out, params[2], params[5] > 0.0, direction, varies
    )
    fine = step / 2.0
    half = int(math.ceil(reach_px / fine))
    v_first = place[deep_steps] - half * fine
    limb = np.ones((2 * (near - 1) + 2 * half + 1, count), np.float32)
    if params[4] > 0.0 and not coarse:
        share = np.float32(believed)
        _set_limb(
            samples[0], colour_out[0], place, r_px, depth, inside, share * across, share * along, v_first, fine, limb
        )
        if len(shading) > 0:
            _take_in(shading, place, r_px, depth, v_first, fine, limb)
    window = samples[:, deep_steps : deep_steps + near]
    return window, (colour_in, colour_out), direction, varies, limb, v_first, fine, half, depth


@inner
def _chroma_sigma(grid, params):
    """The blur of chroma, px: less where every pixel has its own."""
    return params[0] if grid[0] > 1.0 else _READ_PLAINLY * params[0]


@inner
def _set_rays(y, outline, blur_x, blur_y, margin, normal, inside, across, along):
    """The rays' outward normals (N, 2), whether they lie inside the picture (N,), and the blur across and along the
    outline (N,); half of the widest, and how many rays lie inside."""
    count = len(outline)
    widest, in_picture = 0.0, 0
    for n in range(count):
        before, after = outline[n - 1 if n > 0 else count - 1], outline[n + 1 if n + 1 < count else 0]
        tx, ty = after[0] - before[0], after[1] - before[1]
        length = math.sqrt(tx * tx + ty * ty)
        tx, ty = tx / length, ty / length
        normal[n, 0], normal[n, 1] = ty, -tx
        across[n], along[n] = ty * blur_x - tx * blur_y, tx * blur_x + ty * blur_y
        widest = max(widest, abs(across[n]) / 2.0)
        whole = True
        for side in (-margin, margin):
            x, row = outline[n, 0] + side * ty, outline[n, 1] - side * tx
            whole = whole and 0.0 <= x <= y.shape[1] - 1 and 0.0 <= row <= y.shape[0] - 1
        inside[n] = 1.0 if whole else 0.0
        in_picture += whole
    return widest, in_picture


@inner
def _places(r_px, outer, widest, coarse):
    """Places along a ray, as far out as `outer`: even steps as far as the edge can be, wider ones further in where they
    would be many. The places, the step, how deep they reach, how many there are further in, and of the even ones, how
    many from there on are where the edge may be."""
    deepest = min(max(outer, 0.6 * r_px), 0.95 * r_px)
    step = _STEP * (1.0 if r_px < 40.0 else 2.0) * (2.0 if coarse else 1.0) * (1.0 if widest < 2.0 else 1.4)
    far_steps, near_steps = int(math.ceil(outer / step)), int(math.floor(outer / step))
    close_in = min(near_steps, int(math.ceil(deepest / step)))
    stride = max(1, int(math.ceil((deepest / step - close_in) / _DEEP)))
    deep_steps = max(0, int(math.ceil((deepest / step - close_in) / stride)))
    place = np.empty(deep_steps + close_in + 1 + far_steps, np.float32)
    for k in range(deep_steps):
        place[k] = -(close_in + (deep_steps - k) * stride) * step
    for k in range(close_in + 1 + far_steps):
        place[deep_steps + k] = (k - close_in) * step
    return place, step, deepest, deep_steps, close_in + 1 + near_steps


_BGR_TO_YCC = np.array(
    [
        [0.114, 0.587, 0.299],
        [-0.114 * 0.713, -0.587 * 0.713, 0.701 * 0.713],
        [0.886 * 0.564, -0.587 * 0.564, -0.299 * 0.564],
    ]
)
_YCC_TO_BGR = np.linalg.inv(_BGR_TO_YCC)


@inner
def _match(window, direction, shape, varies, noise, shared, cost, power, seen, left_over):
    """Adds, for each ray, what a part of the colour says of where the edge is: brightness (1, M, N) or chroma (2, M, N)
    along a direction (1 or 2, N), against the step `shape` (V, N).

    `cost` (K, N) grows by the squares that are left at each shift, over their variance; the level is free, the step is
    about as large as expected. `power` grows by the square of the step over the same, `seen` and `left_over` (N,) by
    the squares before and after.
    """
    shifts, count = cost.shape
    places = window.shape[1]
    whole, least = np.empty(count, np.float32), np.empty(count, np.float32)
    sse, rise = np.empty((shifts, count), np.float32), np.empty((shifts, count), np.float32)
    expected = np.empty((shifts, count), np.float32)
    _set_squares(_along(window, direction, whole), whole, shape, sse, rise, expected, least)
    free = np.float32(max(1, places - 3))
    usual = middle(least.copy(), count) / free
    for n in range(count):
        variance = max(np.float32(0.5) * (least[n] / free + usual), np.float32(noise * noise))
        variance += varies[n]
        seen[n] += whole[n] / variance
        left_over[n] += least[n] / variance
        held = variance / np.float32(_STEP_SD * _STEP_SD)
        for k in range(shifts):
            both = expected[k, n] + held
            off = rise[k, n] - np.float32(1.0)
            step = max((rise[k, n] * expected[k, n] + held) / both, np.float32(0.0))
            cost[k, n] += (sse[k, n] + expected[k, n] * held / both * off * off) / (variance * np.float32(shared))
            power[k, n] += step * step * expected[k, n] / (variance * np.float32(shared))


@inner
def _along(window, direction, whole):
    """Profiles (M, N) along a direction, each less its mean; the sums of their squares go into `whole` (N,). `window`
    and `direction` as in `_match`."""
    parts, places, count = window.shape
    data, mean = np.zeros((places, count), np.float32), np.zeros(count, np.float32)
    whole[:] = 0.0
    for m in range(places):
        for c in range(parts):
            for n in range(count):
                data[m, n] += window[c, m, n] * direction[c, n]
        for n in range(count):
            mean[n] += data[m, n]
    for m in range(places):
        for n in range(count):
            data[m, n] -= mean[n] / np.float32(places)
            whole[n] += data[m, n] * data[m, n]
    return data


@inner
def _set_squares(data, whole, shape, sse, rise, expected, least):
    """The squares of profiles (M, N) that are left when the step `shape` (V, N) is taken out of their `whole` (N,) at
    each shift (`sse`, (K, N), and the `least` of it); the step that is seen over the one expected (`rise`), and the
    latter's square (`expected`)."""
    shifts, count = sse.shape
    places = len(data)
    least[:] = np.float32(np.inf)
    like, squares, plain = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    for k in range(shifts):
        like[:] = 0.0
        squares[:] = 0.0
        plain[:] = 0.0
        for m in range(places):
            template, profile = shape[shifts - 1 - k + 2 * m], data[m]
            for n in range(count):
                like[n] += template[n] * profile[n]
                squares[n] += template[n] * template[n]
                plain[n] += template[n]
        for n in range(count):
            expected[k, n] = max(squares[n] - plain[n] * plain[n] / np.float32(places), np.float32(1e-9))
            rise[k, n] = like[n] / expected[k, n]
            sse[k, n] = max(whole[n] - like[n] * rise[k, n], np.float32(0.0))
            least[n] = min(least[n], sse[k, n])


@inner
def _sample(y, u, v, grid, outline, normal, place, deep_steps, out):
    """Luma and chroma (3, M, N), code values 0..1, at outline + place * normal, straight from the planes; the first
    `deep_steps` places only tell what colour the marker has."""
    to_ycc = np.zeros((3, 4))
    for c in range(3):
        for k in range(3):
            for m in range(4):
                to_ycc[c, m] += _BGR_TO_YCC[c, k] * grid[4 + 4 * k + m] / 255.0
    count, halved = len(outline), grid[0] > 1.0
    column, row = np.empty(len(place) * count), np.empty(len(place) * count)
    for k in range(len(place)):
        for n in range(count):
            column[k * count + n] = outline[n, 0] + place[k] * normal[n, 0]
            row[k * count + n] = outline[n, 1] + place[k] * normal[n, 1]
    flat = out.reshape(3, len(place) * count)
    levels_at(y, column, row, flat[0])
    sx, sy, ox, oy = 1.0 / grid[0], 1.0 / grid[1], grid[2], grid[3]
    for k in range(column.size):
        column[k], row[k] = (column[k] - ox) * sx, (row[k] - oy) * sy
    plain = deep_steps * count if halved else column.size
    levels_at(u, column[:plain], row[:plain], flat[1])
    levels_at(v, column[:plain], row[:plain], flat[2])
    for k in range(plain, column.size):
        flat[1, k], flat[2, k] = soft_levels_at(u, v, column[k], row[k])
    m = to_ycc.astype(np.float32)
    for k in range(column.size):
        luma, cb, cr = flat[0, k], flat[1, k], flat[2, k]
        for c in range(3):
            flat[c, k] = m[c, 0] * luma + m[c, 1] * cb + m[c, 2] * cr + m[c, 3]


@inner
def _levels(samples, place, depth, beyond, r_px, colour_in, colour_out):
    """Mean colours (3, N) inside, just deeper than `depth`, and outside, beyond `beyond` and at the last two places."""
    places, count = samples.shape[1:]
    inner_count, outer_count = np.zeros(count, np.float32), np.zeros(count, np.float32)
    band = np.float32(0.15 * r_px + 0.5)
    for k in range(places):
        last = k >= places - 2
        for n in range(count):
            own = np.float32(_deep(place[k], depth[n], r_px) and place[k] > -depth[n] - band)
            other = np.float32(last or place[k] > beyond[n])
            inner_count[n] += own
            outer_count[n] += other
            for c in range(3):
                colour_in[c, n] += own * samples[c, k, n]
                colour_out[c, n] += other * samples[c, k, n]
    for c in range(3):
        for n in range(count):
            colour_in[c, n] /= max(inner_count[n], np.float32(1.0))
            colour_out[c, n] /= max(outer_count[n], np.float32(1.0))


@inner
def _deep(place, depth, r_px):
    """Whether a place on a ray lies on the marker, clear of the edge and of the other side."""
    return -0.9 * r_px < place < -depth


@inner
def _directions(samples, place, depth, r_px, inside, colour_in, colour_out, balance, chroma, direction, varies):
    """For each ray brightness as it is, and the chroma direction that tells marker from background (3, N); and the
    variances (2, N) that brightness and chroma have along them beside the edge.

    What may vary without being an edge is the background's texture and the marker's own shading. A direction that is
    blind to both (Fisher's discriminant) sees a coloured marker's edge whatever the light does to it.
    """
    places, count = samples.shape[1:]
    within, inverse, reference = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    textured, shaded = np.empty((3, 3)), np.empty((3, 3))
    weight, column = np.empty((places, count), np.float32), np.empty(count, np.float32)
    rays, on_marker = 0.0, 0.0
    for n in range(count):
        rays += inside[n]
        for k in range(places):
            weight[k, n] = inside[n] * np.float32(_deep(place[k], depth[n], r_px))
            on_marker += weight[k, n]
    mean_out, mean_in = np.zeros(3), np.zeros(3)
    for a in range(3):
        for n in range(count):
            mean_out[a] += inside[n] * colour_out[a, n] / rays
        for k in range(places):
            part = np.float32(0.0)
            for n in range(count):
                part += weight[k, n] * samples[a, k, n]
            mean_in[a] += part / max(on_marker, 1.0)
    for a in range(3):
        for b in range(a, 3):
            texture, shading = 0.0, 0.0
            for n in range(count):
                texture += inside[n] * (colour_out[a, n] - mean_out[a]) * (colour_out[b, n] - mean_out[b])
            mean_a, mean_b = np.float32(mean_in[a]), np.float32(mean_in[b])
            for k in range(places):
                part = np.float32(0.0)
                for n in range(count):
                    part += weight[k, n] * (samples[a, k, n] - mean_a) * (samples[b, k, n] - mean_b)
                shading += part
            texture, shading = texture / rays, shading / max(on_marker, 1.0)
            within[a, b] = within[b, a] = 0.25 * texture + 0.2 * shading
            textured[a, b] = textured[b, a] = texture
            shaded[a, b] = shaded[b, a] = shading
        within[a, a] += balance * balance
        some = 0
        for n in range(count):
            if inside[n] > 0.0:
                column[some] = colour_in[a, n]
                some += 1
        reference[a] = middle(column, some)
    inverse3(within, inverse)
    for n in range(count):
        off0, off1, off2 = (
            reference[0] - colour_out[0, n],
            reference[1] - colour_out[1, n],
            reference[2] - colour_out[2, n],
        )
        d1 = inverse[1, 0] * off0 + inverse[1, 1] * off1 + inverse[1, 2] * off2 if chroma else 0.0
        d2 = inverse[2, 0] * off0 + inverse[2, 1] * off1 + inverse[2, 2] * off2 if chroma else 0.0
        length = math.sqrt(max(d1 * d1 + d2 * d2, 1e-24))
        d1, d2 = d1 / length, d2 / length
        direction[0, n], direction[1, n], direction[2, n] = 1.0, d1, d2
        # Shading is carried on from `depth` to the limb; it was seen to vary over about half the radius.
        carried = _CARRIED * (2.0 * depth[n] / r_px) ** 2
        varies[0, n] = _TEXTURE * textured[0, 0] + carried * shaded[0, 0]
        varies[1, n] = _TEXTURE * (
            textured[1, 1] * d1 * d1 + 2.0 * textured[1, 2] * d1 * d2 + textured[2, 2] * d2 * d2
        ) + carried * (shaded[1, 1] * d1 * d1 + 2.0 * shaded[1, 2] * d1 * d2 + shaded[2, 2] * d2 * d2)


@inner
def _set_limb(luma, outside, place, r_px, depth, inside, across, along, v_first, fine, limb):
    """How the marker darkens (or brightens) towards its limb: `limb` (V, N) against the distance from the edge,
    relative to each ray's mean over the places just deeper than `depth`.

    A matt ball lit from all around the camera follows A + C nz, nz the normal's share towards the camera; of one that
    moves, what it covers for a part of the time is rid of the background's light (`outside`, (N,)). One C for
    all rays, each with its own brightness, is fitted by ridge to all places on the marker, twice, highlights left out
    the second time. What differs from ray to ray is left to the free level of each: carrying it on to the limb was
    tried with spherical harmonics and moved the centre by 0.1 px.
    """
    count = luma.shape[1]
    places = 0  # those on the marker come first
    while places < len(place) and place[places] < 0.0:
        places += 1
    nz, cover = np.empty((places, count), np.float32), np.empty((places, count), np.float32)
    _set_towards(place, r_px, across, along, nz, cover)
    keep, light = np.empty((places, count), np.float32), np.empty((places, count), np.float32)
    for k in range(places):
        for n in range(count):
            keep[k, n] = inside[n] * np.float32(_deep(place[k], depth[n], r_px) and cover[k, n] > 0.5)
            light[k, n] = to_linear(luma[k, n])
            if cover[k, n] < 1.0:
                behind = (np.float32(1.0) - cover[k, n]) * to_linear(outside[n])
                light[k, n] = (light[k, n] - behind) / max(cover[k, n], np.float32(0.5))
    own, level, mean_nz = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    rest = np.empty(places * count, np.float32)
    slope = np.float32(0.0)
    most_ridge = np.float32(max(1.0, (_FEW_PX / r_px) ** 2))
    for turn in range(2):
        own[:] = 0.0
        level[:] = 0.0
        mean_nz[:] = 0.0
        for k in range(places):
            for n in range(count):
                own[n] += keep[k, n]
                level[n] += keep[k, n] * light[k, n]
                mean_nz[n] += keep[k, n] * nz[k, n]
        both, squares, total = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for n in range(count):
            of_ray = max(own[n], np.float32(1.0))
            level[n], mean_nz[n] = max(level[n] / of_ray, np.float32(1e-6)), mean_nz[n] / of_ray
            total += own[n]
        for k in range(places):
            for n in range(count):
                off_nz = keep[k, n] * (nz[k, n] - mean_nz[n])
                both += off_nz * (light[k, n] / level[n] - np.float32(1.0))
                squares += off_nz * off_nz
        slope = both / (squares + min(np.float32(0.02) * total, most_ridge * squares) + np.float32(1e-9))
        if turn == 1 or total < 24.0:
            break
        some = 0
        for k in range(places):
            for n in range(count):
                if keep[k, n] > 0.0:
                    off = light[k, n] / level[n] - np.float32(1.0) - slope * (nz[k, n] - mean_nz[n])
                    rest[some] = abs(off)
                    some += 1
        most = np.float32(2.5 * max(1.48 * middle(rest, some), 0.02))
        for k in range(places):
            for n in range(count):
                off = light[k, n] / level[n] - np.float32(1.0) - slope * (nz[k, n] - mean_nz[n])
                keep[k, n] *= np.float32(abs(off) < most)
    here, own_close = np.zeros(count, np.float32), np.zeros(count, np.float32)
    band = np.float32(0.15 * r_px + 0.5)
    for k in range(places):
        for n in range(count):
            close = np.float32(_deep(place[k], depth[n], r_px) and place[k] > -depth[n] - band)
            own_close[n] += close
            here[n] += close * nz[k, n]
    for n in range(count):
        here[n] = here[n] / max(own_close[n], np.float32(1.0)) - mean_nz[n]
        here[n] = max(np.float32(1.0) + slope * here[n], np.float32(0.1))
    for k in range(len(limb)):
        limb_nz = np.float32(_towards(v_first + k * fine, r_px))
        for n in range(count):
            value = (np.float32(1.0) + slope * (limb_nz - mean_nz[n])) / here[n]
            limb[k, n] = min(max(value, np.float32(0.1)), np.float32(4.0))


@inner
def _take_in(shading, place, r_px, depth, v_first, fine, limb):
    """The geometric mean of the limb (V, N) that this frame shows and the one that earlier frames showed on each ray.

    One curve for all rays cannot know which side lies in shade; what was learnt feeds on the circle it was learnt with.
    Their errors have opposite signs.
    """
    count = limb.shape[1]
    here, own = np.zeros(count, np.float32), np.zeros(count, np.float32)
    band = np.float32(0.15 * r_px + 0.5)
    for k in range(len(place)):
        for n in range(count):
            if _deep(place[k], depth[n], r_px) and place[k] > -depth[n] - band:
                here[n] += _shade(shading, place[k], r_px, n)
                own[n] += np.float32(1.0)
    for n in range(count):
        here[n] = max(here[n] / max(own[n], np.float32(1.0)), np.float32(1e-6))
    for k in range(len(limb)):
        for n in range(count):
            if own[n] > 0.0:
                value = _shade(shading, v_first + k * fine, r_px, n) / here[n]
                limb[k, n] = math.sqrt(limb[k, n] * min(max(value, np.float32(0.1)), np.float32(4.0)))


@inner
def _shade(shading, place, r_px, n):
    """The light of a ray at a place on it, from rings that reach from its middle to the edge."""
    at = min(max(1.0 + place / r_px, 0.0), 1.0) * (len(shading) - 1)
    k = min(int(at), len(shading) - 2)
    return shading[k, n] + np.float32(at - k) * (shading[k + 1, n] - shading[k, n])


@inner
def _towards(place, r_px):
    """The share of a sphere's normal towards the camera at a place on a ray across its outline; 0 outside."""
    depth = min(max(1.0 + place / r_px, 0.0), 1.0)
    return math.sqrt(1.0 - depth * depth)


@inner
def _set_towards(place, r_px, across, along, nz, cover):
    """The mean of `_towards`, over the share of the exposure for which the marker covers them, at places on each ray:
    `nz` (M, N), and that share, `cover` (M, N)."""
    longest = _longest(across, along)
    times = 1 if longest < _STILL else min(max(int(longest / _STILL), 4), _MOST_TIMES)
    for k in range(len(nz)):
        from_centre = max(r_px + place[k], 0.0)
        for n in range(len(across)):
            total = 0.0
            for i in range(times):
                t = (i + 0.5) / times - 0.5
                way2 = t * t * (across[n] * across[n] + along[n] * along[n])
                away2 = from_centre * (from_centre - 2.0 * t * across[n]) + way2
                total += math.sqrt(max(1.0 - away2 / (r_px * r_px), 0.0))
            cover[k, n] = 1.0 if times == 1 else _covers(from_centre, across[n], along[n], r_px)
            nz[k, n] = total / times / max(cover[k, n], np.float32(0.5))


@inner
def _through_lens(v_first, fine, limb, r_px, sigma, light, cover):
    """The marker's light (V, N), and how much of the background it covers (V, 1), along rays across an edge at 0,
    marker on the negative side, blurred by the lens."""
    length, count = limb.shape
    # Blur moves a curved edge inwards by sigma^2 / 2r: by the lens here, by the chroma in `_set_shapes`.
    inwards = sigma * sigma / (2.0 * r_px)
    row, step = np.empty((length, count), np.float32), np.empty((length, 1), np.float32)
    for k in range(length):
        step[k, 0] = min(max(0.5 - (v_first + k * fine + inwards) / fine, 0.0), 1.0)
        for n in range(count):
            row[k, n] = step[k, 0] * limb[k, n]
    lens = _taps(sigma / fine)
    _blur(step, lens, cover)
    _blur(row, lens, light)


@inner
def _set_shapes(
    light, cover, depth, v_first, fine, colour_in, colour_out, direction, across, along, r_px, chroma_sigma, shapes
):
    """What video shows along each ray of what went `_through_lens`, in brightness and in chroma along `direction`:
    (2, V, N), 0 on the far side.

    Light mixes linearly under the lens blur and the motion, then the camera's curve is applied, then chroma is blurred
    once more by its half resolution. Mixing coded values instead would shift the edge towards the darker side.
    """
    length, count = light.shape
    row, dark = np.empty((length, count), np.float32), np.empty((length, count), np.float32)
    for k in range(length):
        for n in range(count):
            dark[k, n] = cover[k, 0]
    longest = _longest(across, along)
    if longest >= fine:
        swept = np.empty((length, count), np.float32)
        if longest * longest > _BENT * r_px * fine:
            _streak(dark, light, across, along, depth, v_first, fine, r_px, row, swept)
        else:
            _sweep(dark, across, along, fine, r_px, row)
            _sweep(light, across, along, fine, r_px, swept)
        dark, row = row, dark
        light = swept
    linear_in, linear_out = np.empty((3, count), np.float32), np.empty((3, count), np.float32)
    of_luma, of_chroma = np.empty((3, count), np.float32), np.empty((3, count), np.float32)
    for n in range(count):
        for c in range(3):
            inner_code, outer_code = 0.0, 0.0
            for k in range(3):
                inner_code += _YCC_TO_BGR[c, k] * colour_in[k, n]
                outer_code += _YCC_TO_BGR[c, k] * colour_out[k, n]
            linear_in[c, n], linear_out[c, n] = to_linear(inner_code), to_linear(outer_code)
            # How much of each code value goes into what is seen along the direction, by luma and by chroma.
            of_luma[c, n] = direction[0, n] * _BGR_TO_YCC[0, c]
            of_chroma[c, n] = direction[1, n] * _BGR_TO_YCC[1, c] + direction[2, n] * _BGR_TO_YCC[2, c]
    chroma = np.empty((length, count), np.float32)
    level = np.empty(count, np.uint32)
    for k in range(length):
        for n in range(count):
            shapes[0, k, n] = chroma[k, n] = 0.0
        for c in range(3):
            for n in range(count):
                mixed = light[k, n] * linear_in[c, n] + (np.float32(1.0) - dark[k, n]) * linear_out[c, n]
                level[n] = np.uint32(math.sqrt(min(max(mixed, np.float32(0.0)), np.float32(1.0))) * _SCALE + _HALF)
            for n in range(count):
                code = _TO_CODE[level[n]]
                shapes[0, k, n] += of_luma[c, n] * code
                chroma[k, n] += of_chroma[c, n] * code
    _blur(chroma, _taps(chroma_sigma / fine), row)
    # 1.5: on small discs chroma comes further in than a Gaussian alone would bring it (its samples are means of boxes).
    part = np.float32(min(1.0, 1.5 * chroma_sigma * chroma_sigma / (2.0 * r_px) / fine))
    for k in range(length):
        following = min(k + 1, length - 1)
        for n in range(count):
            shapes[1, k, n] = row[k, n] + part * (row[following, n] - row[k, n])
    for c in range(2):
        for k in range(length):
            for n in range(count):
                shapes[c, k, n] -= shapes[c, length - 1, n]


@inner
def _longest(across, along):
    longest2 = np.float32(0.0)
    for n in range(len(across)):
        longest2 = max(longest2, across[n] * across[n] + along[n] * along[n])
    return math.sqrt(longest2)


@inner
def _taps(sigma):
    """A Gaussian of `sigma` samples, out to three of them."""
    half = int(math.ceil(3.0 * sigma))
    taps = np.empty(2 * half + 1, np.float32)
    total = 0.0
    for k in range(2 * half + 1):
        taps[k] = math.exp(-0.5 * ((k - half) / sigma) ** 2)
        total += taps[k]
    return taps / np.float32(total)


@inner
def _blur(rows, taps, out):
    """Each column of (V, N) under the taps; its ends repeat."""
    length, count = rows.shape
    half = len(taps) // 2
    for k in range(length):
        for n in range(count):
            out[k, n] = 0.0
        for t in range(len(taps)):
            tap, source = taps[t], rows[min(max(k + t - half, 0), length - 1)]
            for n in range(count):
                out[k, n] += tap * source[n]


@inner
def _sweep(rows, across, along, fine, r_px, out):
    """Each column of (V, N) averaged over the exposure; `across` and `along` (N,) are the blur in pixels.

    At time t in [-1/2, 1/2] of the exposure the outline lies t * across - (t * along)^2 / 2r further out: a mean over
    `across`, from a running sum, about a place that lies along^2 / 24r further in.
    """
    length, count = rows.shape
    running = np.zeros((length + 1, count), np.float32)  # up to a sample's right side
    half, inwards = np.empty(count, np.float32), np.empty(count, np.float32)
    for n in range(count):
        blurred = across[n] * across[n] + along[n] * along[n] >= fine * fine
        half[n] = max(abs(across[n]) / fine, 1.0) / 2.0
        inwards[n] = along[n] * along[n] / (24.0 * r_px * fine) if blurred else 0.0
    for k in range(length):
        for n in range(count):
            running[k + 1, n] = running[k, n] + rows[k, n]
    most = np.float32(length - 1e-3)
    for k in range(length):
        for n in range(count):
            centre = np.float32(k + 0.5) + inwards[n]
            low = min(max(centre - half[n], np.float32(0.0)), most - np.float32(1.0))
            high = min(max(centre + half[n], np.float32(1.0)), most)
            i, j = np.uint32(low), np.uint32(high)
            above = running[j, n] + (high - np.float32(j)) * rows[j, n]
            below = running[i, n] + (low - np.float32(i)) * rows[i, n]
            out[k, n] = (above - below) / (high - low)


@inner
def _streak(dark, light, across, along, depth, v_first, fine, r_px, swept_dark, swept_light):
    """As `_sweep` for both, of a streak so long that the outline's bend counts: at time t a place on a ray, s outside
    the outline, is sqrt((r + s)^2 - 2 (r + s) t across + t^2 (across^2 + along^2)) - r from it.

    Not every place is covered all the time: as long as one at `depth`, where the marker's colour was taken, is 1.
    """
    length, count = dark.shape
    longest = _longest(across, along)
    times = min(max(int(math.ceil(longest)), 8), _MOST_TIMES)
    for k in range(length):
        for n in range(count):
            swept_dark[k, n] = swept_light[k, n] = 0.0
    last, part = np.float32(length - 1.001), np.float32(1.0 / times)
    radius, start, per_step = np.float32(r_px), np.float32(v_first), np.float32(1.0 / fine)
    for i in range(times):
        t = np.float32((i + 0.5) / times - 0.5)
        for k in range(length):
            from_centre = radius + start + np.float32(k * fine)
            for n in range(count):
                way2 = t * t * (across[n] * across[n] + along[n] * along[n])
                away2 = from_centre * (from_centre - np.float32(2.0) * t * across[n]) + way2
                away = math.sqrt(max(away2, np.float32(0.0))) - radius
                at = min(max((away - start) * per_step, np.float32(0.0)), last)
                j = np.uint32(at)
                rest = at - np.float32(j)
                swept_dark[k, n] += part * (dark[j, n] + rest * (dark[j + 1, n] - dark[j, n]))
                swept_light[k, n] += part * (light[j, n] + rest * (light[j + 1, n] - light[j, n]))
    for n in range(count):
        there = max(_covers(r_px - depth[n] - 0.07 * r_px, across[n], along[n], r_px), np.float32(0.25))
        for k in range(length):
            swept_dark[k, n] /= there
            swept_light[k, n] /= there


@inner
def _covers(from_centre, across, along, r_px):
    """The share of the exposure for which a marker covers a place on a ray, so far from its centre."""
    way = math.sqrt(across * across + along * along)
    on_way = from_centre * across / way
    chord = math.sqrt(max(r_px * r_px - from_centre * from_centre + on_way * on_way, 0.0))
    return max(min(0.5 * way, on_way + chord) - max(-0.5 * way, on_way - chord), 0.0) / way


@inner
def _own_colour(y, u, v, grid, x, row, limits):
    """Whether a third of the nine pixels around a place have the marker's colours."""
    own = 0
    for i in range(-1, 2):
        for j in range(-1, 2):
            blue, green, red = bgr_at(y, u, v, grid, x + j, row + i)
            hue, saturation, value = hsv_of(clipped(blue), clipped(green), clipped(red))
            own += in_box(limits, hue, saturation, value)
    return own >= 3


_FEW_PX = 9.0  # a marker's radius below which too few pixels tell how its light falls off to carry half of it on
_STILL = 1.5  # pixels of motion that leave the light as it is
_BENT = 8.0  # radii times steps of a profile: from the square of such a way on the outline's bend counts
_MOST_TIMES = 32
_LEVELS = np.linspace(0, 1, 2049)
_TO_LINEAR = np.where(_LEVELS <= 0.04045, _LEVELS / 12.92, ((_LEVELS + 0.055) / 1.055) ** 2.4).astype(np.float32)
_TO_CODE = np.where(_LEVELS**2 <= 0.0031308, _LEVELS**2 * 12.92, 1.055 * _LEVELS ** (2 / 2.4) - 0.055).astype(
    np.float32
)
"""Code values 0..1 of linear light 0..1; the table runs over the square root, which is nearly even in code."""
_SCALE, _HALF = np.float32(2048.0), np.float32(0.5)


@inner
def to_linear(code):
    """Linear light 0..1 of a code value 0..1, by the sRGB curve (IEC 61966-2-1), from a table."""
    return _TO_LINEAR[int(min(max(code, 0.0), 1.0) * 2048.0 + 0.5)]


@kernel(
    None, PLANE, PLANE, PLANE, GRID, array(F8, 2), F8, F8, F8, F8, array(F8, 1), F8, array(F8, 1), BOOL, array(F4, 2),
    F8[:, ::1], F8[::1], F8[::1], F8[::1], at_import=False,
)  # fmt: skip
def _find_edges(
    y, u, v, grid, outline, r_px, reach_px, blur_x, blur_y, limits, sigma, params, coarse, shading,
    points, sd, ray, offset,
):  # fmt: skip
    return edges_into(
        y, u, v, grid, outline, r_px, reach_px, blur_x, blur_y, limits, sigma, params, coarse, shading,
        points, sd, ray, offset,
    )  # fmt: skip
