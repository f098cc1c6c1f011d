"""Sub-pixel edge points on a marker's outline, each with its own uncertainty.

Along rays across the expected outline the pixel values are mixtures of marker and background. Mixing is a sum in
linear light only, so the sRGB curve is undone first. Chroma is projected on the difference that tells marker from
background there whatever the light does, the marker's limb darkening is allowed for, and the edge is where the step
that the lens and the known motion make (a Gaussian, swept along the blur) explains the profile best by least squares.
Brightness and chroma are weighed by their own evidence, ray by ray.
"""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from reference.colour import hsv_of, inside
from spheremcap.core.frame import Frame
from spheremcap.core.look import EdgePoints
from spheremcap.detection.edge import EdgeConfig

FloatArray = npt.NDArray[np.float64]

_STEP = 0.7  # px between samples on a ray
_DEEP = 16  # samples between the edge and the deepest place, at most
_READ_PLAINLY = 0.87  # of chroma's blur is left where every pixel has its own
_SHARED = 2.5  # samples of chroma at half resolution that share an error
_FEW_PX = 9.0  # a marker's radius below which too few pixels tell how its light falls off to carry half of it on
_STILL = 1.5  # pixels of motion that leave the light as it is
_BENT = 8.0  # radii times steps: from the square of such a way on the outline's bend counts
_MOST_TIMES = 32
_STEP_SD = 0.3  # of the step seen, over the step expected
_CARRIED = 0.2  # share of the shading's variance where it has to be carried on by half the radius
_TEXTURE = 0.0125  # share of the variance that the background has along the outline that is expected across it


def find_edges(
    frame: Frame,
    outline_px: FloatArray,
    r_px: float,
    reach_px: float,
    blur_px: FloatArray,
    limits: FloatArray | None,
    config: EdgeConfig,
    coarse: bool = False,
    thinned: bool = True,
    shading: FloatArray | None = None,
    way_px: FloatArray | None = None,
    believed_px: FloatArray | None = None,
    squares: list[FloatArray] | None = None,
    sigma_px: float | None = None,
) -> EdgePoints | None:
    """Edge points near an expected outline (image pixels, (N, 2), clockwise on screen); None when there is no contrast.

    The arguments are those of `spheremcap.detection.edge.find_edges`; not `thinned`: the part of a ray that is deep in
    the marker has places as close together as the part around the edge. With `way_px` the samples reach as far as that
    blur needs, the light is told from a blur of `believed_px`, and `squares` gets the squares (N,) that are left, as
    `spheremcap.detection.edge.misfits_into` has them.
    """
    count = len(outline_px)
    ring = np.concatenate([outline_px[-1:], outline_px, outline_px[:1]])
    tangent = ring[2:] - ring[:-2]
    tangent /= np.sqrt((tangent * tangent).sum(axis=1, keepdims=True))
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)

    across, along = normal @ blur_px, tangent @ blur_px
    farthest = blur_px if way_px is None else way_px
    sigma = config.blur_sigma_px + 0.5 * config.chroma_sigma_px
    margin = sigma + 0.2
    half_blur = np.abs(normal @ farthest) / 2
    outer = reach_px + margin + float(half_blur.max())
    inner = min(max(outer, 0.6 * r_px), 0.95 * r_px)
    step = _STEP * (1 if r_px < 40 else 2) * (2 if coarse else 1) * (1 if half_blur.max() < 2 else 1.4)
    fine = step / 2
    u = np.arange(-np.ceil(inner / step), np.ceil(outer / step) + 1) * step  # (M,)
    close_in = min(int(outer / step), int(np.ceil(inner / step)))
    if thinned:
        stride = max(1, int(np.ceil((inner / step - close_in) / _DEEP)))
        deeper = max(0, int(np.ceil((inner / step - close_in) / stride)))
        u = np.concatenate([-(close_in + np.arange(deeper, 0, -1) * stride) * step, u[u >= -close_in * step]])

    deep_places = int((u < -close_in * step).sum())
    samples = _sample(frame, outline_px[:, None, :] + normal[:, None, :] * u[None, :, None], deep_places)  # (N, M, 3)
    ends = outline_px[:, None, :] + normal[:, None, :] * np.array([-margin, margin])[:, None]
    inside = ((ends >= 0) & (ends <= (frame.width_px - 1, frame.height_px - 1))).all(axis=(1, 2))
    if inside.sum() < 8:
        return None

    # Levels on either side, clear of the blurred edge, and the colour difference between them.
    clear = margin + half_blur
    aside = r_px - np.sqrt(np.maximum(r_px**2 - (tangent @ farthest / 2) ** 2, 0))
    depth = np.minimum(np.maximum(clear, margin + aside) + 0.5 * reach_px, 0.6 * inner)[:, None]
    deep = (u[None, :] < -depth) & (u[None, :] > -0.9 * r_px)
    close = deep & (u[None, :] > -depth - 0.15 * r_px - 0.5)
    far = u[None, :] > (clear + 0.5 * reach_px - 0.5)[:, None]
    far[:, -2:] = True
    colour_in = _level(samples, close)
    colour_out = _level(samples, far)
    reference = np.sort(colour_in[inside], axis=0)[int(inside.sum()) // 2]
    # What may vary without being an edge: the background's texture and the marker's own shading. A direction that is
    # blind to both (Fisher's discriminant) sees a coloured marker's edge whatever the light does to it.
    textured, shaded = _scatter(colour_out[inside]), _scatter(samples[deep & inside[:, None]])
    within = 0.25 * textured + 0.2 * shaded
    difference = reference - colour_out
    direction = np.linalg.solve(within + np.eye(3) * config.balance**2, difference.T).T
    direction[:, 0] = 1
    if not config.chroma:
        direction[:, 1:] = 0
    direction[:, 1:] /= np.sqrt(np.maximum((direction[:, 1:] ** 2).sum(axis=1, keepdims=True), 1e-24))

    shift = np.arange(-np.ceil(reach_px / fine), np.ceil(reach_px / fine) + 1) * fine  # (K,)
    near = np.abs(u) <= outer
    first = int(near.argmax())
    uu = u[near]
    v = np.arange(uu[0] - shift[-1], uu[-1] - shift[0] + fine / 2, fine)  # edge-centred abscissa
    if config.shading and not coarse:
        lit_px = blur_px if believed_px is None else believed_px
        lit = normal @ lit_px, tangent @ lit_px
        way = float(np.hypot(*lit).max())
        times = 1 if way < _STILL else min(max(int(way / _STILL), 4), _MOST_TIMES)
        nz, light, cover = _towards(u, r_px, *lit, times), to_linear(samples[..., 0]), np.ones((count, len(u)))
        if times > 1:
            cover = _covers(np.maximum(r_px + u, 0)[None, :], lit[0][:, None], lit[1][:, None], r_px)
            light = (light - (1 - cover) * to_linear(colour_out[:, :1])) / np.maximum(cover, 0.5)
            nz = nz / np.maximum(cover, 0.5)
        limb = _limb(light, nz, r_px, deep & inside[:, None] & (cover > 0.5), close, v)
        if shading is not None:
            limb = _taken_in(shading, u, r_px, close, v, limb)
    else:
        limb = np.ones((count, len(v)))
    chroma_sigma = config.chroma_sigma_px * (1 if frame.planes.grid[0] > 1 else _READ_PLAINLY)
    expected = _profile(
        v, limb, colour_in, colour_out, across, along, depth[:, 0], r_px, sigma_px or config.blur_sigma_px, chroma_sigma
    )  # (N, V, 3)
    # Template for shift k at sample m: abscissa u_m - shift_k.
    index = (
        np.rint((uu[0] - v[0]) / fine).astype(int)
        + np.arange(len(uu))[None, :] * 2
        - (np.arange(len(shift)) - (len(shift) // 2))[:, None]
    )
    index = np.clip(index, 0, len(v) - 1)
    cost, power, seen, left_over = 0, 0, 0, 0
    for part, shared in ((slice(0, 1), 1), (slice(1, 3), _SHARED if frame.planes.grid[0] > 1 else 1)):
        along_it = direction[:, part]
        data = np.einsum("nmc,nc->nm", samples[:, first : first + len(uu), part], along_it)
        data = data - data.mean(axis=1, keepdims=True)
        template = np.einsum("nvc,nc->nv", (expected - expected[:, -1:])[..., part], along_it)[:, index]  # (N, K, m)
        template = template - template.mean(axis=2, keepdims=True)
        power_of = np.maximum(np.einsum("nkm,nkm->nk", template, template), 1e-9)
        rise = np.einsum("nkm,nm->nk", template, data) / power_of  # step seen over step expected
        whole = (data * data).sum(axis=1)
        sse = np.maximum(whole[:, None] - power_of * rise**2, 0)
        if squares is not None:
            squares.append(sse.min(axis=1))
        own = sse.min(axis=1) / max(1, len(uu) - 3)
        variance = np.maximum((own + np.sort(own)[count // 2]) / 2, config.noise**2)
        texture, shading = (np.einsum("nc,cd,nd->n", along_it, s[part, part], along_it) for s in (textured, shaded))
        variance = variance + _TEXTURE * texture + _CARRIED * (2 * depth[:, 0] / r_px) ** 2 * shading
        # The posterior of the step's height, about 1: its squares and what is left of them.
        held = (variance / _STEP_SD**2)[:, None]
        height = np.maximum((rise * power_of + held) / (power_of + held), 0)
        cost = cost + (sse + power_of * held / (power_of + held) * (rise - 1) ** 2) / variance[:, None] / shared
        power = power + height**2 * power_of / variance[:, None] / shared
        seen, left_over = seen + whole / variance, left_over + sse.min(axis=1) / variance
    best = cost.argmin(axis=1)
    rows = np.arange(count)
    interior = (best > 0) & (best < len(shift) - 1) & inside
    k = np.clip(best, 1, len(shift) - 2)
    left, mid, right = cost[rows, k - 1], cost[rows, k], cost[rows, k + 1]
    bend = left - 2 * mid + right
    interior &= bend > 0
    bend = np.where(interior, bend, 1)
    offset = shift[k] + np.where(interior, 0.5 * (left - right) / bend * fine, 0)
    sd = fine * np.sqrt(2 / bend)  # half the second derivative is the Fisher information
    keep = interior & (np.sqrt(power[rows, k]) > config.least_contrast) & (sd < 2.0)
    if limits is not None:
        back = np.maximum(offset - 1.5 - half_blur - sigma, -0.7 * r_px)
        keep &= _marker_coloured(frame, outline_px + normal * back[:, None], limits)
    if keep.sum() < 6:
        return None
    points = outline_px + normal * offset[:, None]
    explained = 1 - float(left_over[keep].sum()) / max(float(seen[keep].sum()), 1e-12)
    return EdgePoints(
        points[keep],
        np.maximum(sd[keep], 0.02),
        np.flatnonzero(keep),
        offset[keep],
        int(inside.sum()),
        explained,
    )


def _sample(frame: Frame, xy: FloatArray, deep_places: int) -> FloatArray:
    """Luma and chroma (N, M, 3), code values 0..1, at places (N, M, 2), bilinear; chroma of half resolution by a
    quadratic B-spline, but for the first `deep_places` of a ray. The border repeats."""
    y, u, v, grid = frame.planes
    to_bgr = grid[4:].reshape(3, 4)
    at = (xy - grid[2:4]) / grid[:2]
    planes = np.stack([_bilinear(y, xy), _bilinear(u, at), _bilinear(v, at)], axis=-1)
    if grid[0] > 1:
        near = at[:, deep_places:]
        planes[:, deep_places:, 1:] = np.stack([_spline(u, near), _spline(v, near)], axis=-1)
    return (planes @ to_bgr[:, :3].T + to_bgr[:, 3]) @ (_BGR_TO_YCC.T / 255)


def _bilinear(plane: npt.NDArray[np.uint8], xy: FloatArray) -> FloatArray:
    rows, columns = plane.shape
    x, y = np.clip(xy[..., 0], 0, columns - 1), np.clip(xy[..., 1], 0, rows - 1)
    j, i = x.astype(int), y.astype(int)
    a, b, k, n = x - j, y - i, np.minimum(j + 1, columns - 1), np.minimum(i + 1, rows - 1)
    return (1 - b) * ((1 - a) * plane[i, j] + a * plane[i, k]) + b * ((1 - a) * plane[n, j] + a * plane[n, k])


def _spline(plane: npt.NDArray[np.uint8], xy: FloatArray) -> FloatArray:
    """The quadratic B-spline of a plane: weights (1/2 - a)^2 / 2, 3/4 - a^2, (1/2 + a)^2 / 2 of the three nearest."""
    nearest = np.floor(xy + 0.5).astype(int)
    off = xy - nearest
    weights = np.stack([0.5 * (0.5 - off) ** 2, 0.75 - off**2, 0.5 * (0.5 + off) ** 2])
    total = np.zeros(xy.shape[:-1])
    for m in range(3):
        for n in range(3):
            i = np.clip(nearest[..., 1] + m - 1, 0, plane.shape[0] - 1)
            j = np.clip(nearest[..., 0] + n - 1, 0, plane.shape[1] - 1)
            total += weights[m, ..., 1] * weights[n, ..., 0] * plane[i, j]
    return total


def _level(samples: FloatArray, where: npt.NDArray[np.bool_]) -> FloatArray:
    """Mean colour (N, 3) of each ray over the samples chosen."""
    weight = where / np.maximum(where.sum(axis=1, keepdims=True), 1)
    return np.einsum("nmc,nm->nc", samples, weight)


def _scatter(colours: npt.NDArray[np.floating]) -> FloatArray:
    """Covariance (3, 3) of colours (N, 3); zero for none."""
    off = colours - colours.mean(axis=0) if len(colours) else np.zeros((1, 3))
    return (off.T @ off / max(1, len(off))).astype(np.float64)


def _marker_coloured(frame: Frame, at: FloatArray, limits: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether a third of the nine pixels around each place (N, 2) have the marker's colours."""
    y, u, v, grid = frame.planes
    to_bgr = grid[4:].reshape(3, 4)
    own = np.zeros(len(at), int)
    for off in np.ndindex(3, 3):
        xy = at + np.array(off) - 1
        chroma = (xy - grid[2:4]) / grid[:2]
        planes = np.stack([_bilinear(y, xy), _bilinear(u, chroma), _bilinear(v, chroma)], axis=-1)
        own += inside(limits, hsv_of(np.clip(planes @ to_bgr[:, :3].T + to_bgr[:, 3], 0, 255)))
    return own >= 3


def _taken_in(
    shading: FloatArray, u: FloatArray, r_px: float, close: Any, v: FloatArray, limb: FloatArray
) -> FloatArray:
    """The geometric mean of a frame's limb (N, V) and the one that earlier frames showed, (rings, N)."""
    rings = np.linspace(0, 1, len(shading))
    on_rays = np.array([np.interp(1 + u / r_px, rings, ray) for ray in shading.T])
    here = (on_rays * close).sum(axis=1) / np.maximum(close.sum(axis=1), 1)
    learnt = np.array([np.interp(1 + v / r_px, rings, ray) for ray in shading.T]) / np.maximum(here, 1e-6)[:, None]
    both = np.sqrt(limb * np.clip(learnt, 0.1, 4))
    return np.where(close.any(axis=1)[:, None], both, limb)  # type: ignore[no-any-return]


def _towards(u: FloatArray, r_px: float, across: FloatArray, along: FloatArray, times: int) -> FloatArray:
    """The normal's share towards the camera at places `u` on each ray (N, M), its mean over so many times."""
    out = np.zeros((len(across), len(u)))
    from_centre = np.maximum(r_px + u, 0)[None, :]
    for t in (np.arange(times) + 0.5) / times - 0.5:
        away2 = from_centre**2 - 2 * t * from_centre * across[:, None] + t**2 * (across**2 + along**2)[:, None]
        out += np.sqrt(np.maximum(1 - away2 / r_px**2, 0)) / times
    return out


def _limb(
    brightness: FloatArray,
    nz: FloatArray,
    r_px: float,
    where: npt.NDArray[np.bool_],
    close: npt.NDArray[np.bool_],
    v: FloatArray,
) -> FloatArray:
    """How the marker darkens (or brightens) towards its limb: (N, len(v)) against the distance `v` from the edge,
    relative to each ray's mean over the samples `close`.

    A matt ball lit from all around the camera follows A + C nz, nz the normal's share towards the camera. One C for
    all rays, each with its own brightness, is fitted by ridge to the samples `where`, twice, highlights left out the
    second time. What differs from ray to ray is left to the free level of each: carrying it on to the limb was tried
    with spherical harmonics and moved the centre by 0.1 px.
    """
    limb_nz = np.sqrt(1 - np.clip(1 + v / r_px, 0, 1) ** 2)[None, :]
    keep = where.astype(np.float64)
    slope = 0.0
    for _ in range(2):
        count = np.maximum(keep.sum(axis=1, keepdims=True), 1)
        level = np.maximum((brightness * keep).sum(axis=1, keepdims=True) / count, 1e-6)
        mean_nz = (nz * keep).sum(axis=1, keepdims=True) / count
        off_nz, off = (nz - mean_nz) * keep, (brightness / level - 1) * keep
        squares = float((off_nz * off_nz).sum())
        ridge = min(0.02 * keep.sum(), max(1.0, (_FEW_PX / r_px) ** 2) * squares)
        slope = float((off_nz * off).sum() / (squares + ridge + 1e-9))
        rest = np.abs(off - slope * off_nz)
        kept = rest[keep > 0]
        if len(kept) < 24:
            break
        usual = float(np.partition(kept, len(kept) // 2)[len(kept) // 2])
        keep = keep * (rest < 2.5 * max(1.48 * usual, 0.02))
    near = (nz * close).sum(axis=1, keepdims=True) / np.maximum(close.sum(axis=1, keepdims=True), 1)
    here = np.maximum(1 + slope * (near - mean_nz), 0.1)
    return np.clip((1 + slope * (limb_nz - mean_nz)) / here, 0.1, 4)  # type: ignore[no-any-return]


def _profile(
    v: FloatArray,
    limb: FloatArray,
    colour_in: FloatArray,
    colour_out: FloatArray,
    across: FloatArray,
    along: FloatArray,
    depth: FloatArray,
    r_px: float,
    sigma: float,
    chroma_sigma: float,
) -> FloatArray:
    """What video shows along each ray (N, len(v), 3) of an edge at v = 0, marker at v < 0: luma and chroma.

    Light mixes linearly under the lens blur and the motion, then the camera's curve is applied, then chroma is blurred
    once more by its half resolution. Mixing coded values instead would shift the edge towards the darker side.
    """
    fine = float(v[1] - v[0])
    # Blur moves a curved edge inwards by sigma^2 / 2r: by the lens here, by the chroma further down.
    inwards = sigma**2 / (2 * r_px)
    step = np.clip(0.5 - (v + inwards) / fine, 0, 1)
    both = _gauss(np.concatenate([step[None, :], step * limb]), sigma / fine)
    if float(np.hypot(across, along).max()) ** 2 > _BENT * r_px * fine:
        cover, light = _streak(v, both[0], both[1:], across, along, depth, r_px)
    else:
        cover, light = _swept(both[0], both[1:], across / fine, along / fine, r_px / fine)
    inner, outer = to_linear(_to_bgr(colour_in)), to_linear(_to_bgr(colour_out))
    mixed = light[:, :, None] * inner[:, None, :] + (1 - cover)[:, :, None] * outer[:, None, :]
    coded = to_code(mixed) @ _BGR_TO_YCC.T
    chroma = coded[..., 1:].transpose(0, 2, 1).reshape(-1, len(v))
    soft = _gauss(chroma, chroma_sigma / fine)
    part = min(1.0, 1.5 * chroma_sigma**2 / (2 * r_px) / fine)  # 1.5: sampled twice, in both directions
    soft[:, :-1] += part * (soft[:, 1:] - soft[:, :-1])
    soft = soft.reshape(len(limb), 2, len(v)).transpose(0, 2, 1)
    return np.concatenate([coded[..., :1], soft], axis=2)


def _gauss(rows: FloatArray, sigma: float) -> FloatArray:
    """Each row blurred by a Gaussian of `sigma` samples; the ends repeat."""
    taps = int(np.ceil(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-taps, taps + 1) / sigma) ** 2)
    return cv2.filter2D(rows, -1, (kernel / kernel.sum())[None, :], borderType=cv2.BORDER_REPLICATE)  # type: ignore[return-value]


def _swept(
    cover: FloatArray, light: FloatArray, across: FloatArray, along: FloatArray, r: float
) -> tuple[FloatArray, FloatArray]:
    """Coverage (V,) and light (N, V) averaged over the exposure, as (N, V); all lengths in samples.

    At time t in [-1/2, 1/2] of the exposure the outline lies t * across - (t * along)^2 / 2r further out: a mean over
    `across` samples, from a running sum, about a place that lies along^2 / 24r further in.
    """
    if float(np.hypot(across, along).max()) < 1.0:
        return np.broadcast_to(cover, light.shape), light
    length = light.shape[1]
    both = np.concatenate([np.broadcast_to(cover, light.shape)[:, None], light[:, None]], axis=1)  # (N, 2, V)
    sums = np.concatenate([np.zeros((*both.shape[:2], 1)), both.cumsum(axis=2)], axis=2)  # up to a sample's left side
    half = np.maximum(np.abs(across), 1.0)[:, None] / 2
    middle = np.arange(length) + 0.5 + (along * along / (24 * r))[:, None]
    ends = np.stack([(middle - half).clip(0, length - 1), (middle + half).clip(1, length - 1e-6)], axis=1)  # (N, 2, V)
    low = ends.astype(np.intp)
    part = ends - low
    rows = np.arange(len(light))[:, None, None]
    swept = []
    for one in (0, 1):
        left = sums[rows, one, low]
        swept.append(np.diff(left + part * both[rows, one, low], axis=1)[:, 0] / np.diff(ends, axis=1)[:, 0])
    return swept[0], swept[1]


def _streak(
    v: FloatArray,
    cover: FloatArray,
    light: FloatArray,
    across: FloatArray,
    along: FloatArray,
    depth: FloatArray,
    r_px: float,
) -> tuple[FloatArray, FloatArray]:
    """As `_swept`, place by place and time by time, in pixels; relative to what a place just beyond `depth` shows."""
    way = np.hypot(across, along)
    times = min(max(int(np.ceil(way.max())), 8), _MOST_TIMES)
    swept = np.zeros((2, *light.shape))
    for t in (np.arange(times) + 0.5) / times - 0.5:
        for n, row in enumerate(light):
            from_centre = r_px + v
            away = np.sqrt(np.maximum(from_centre * (from_centre - 2 * t * across[n]) + (t * way[n]) ** 2, 0)) - r_px
            swept[0, n] += np.interp(away, v, cover) / times
            swept[1, n] += np.interp(away, v, row) / times
    there = _covers(r_px - depth - 0.07 * r_px, across, along, r_px)
    swept /= np.maximum(there, 0.25)[None, :, None]
    return swept[0], swept[1]


def _covers(from_centre: FloatArray, across: FloatArray, along: FloatArray, r_px: float) -> FloatArray:
    """The share of the exposure for which a marker covers places on rays, so far from its centre."""
    way = np.hypot(across, along)
    on_way = from_centre * across / way
    chord = np.sqrt(np.maximum(r_px**2 - from_centre**2 + on_way**2, 0))
    return np.maximum(np.minimum(way / 2, on_way + chord) - np.maximum(-way / 2, on_way - chord), 0) / way


_LEVELS = np.linspace(0, 1, 2049)
_TO_LINEAR = np.where(_LEVELS <= 0.04045, _LEVELS / 12.92, ((_LEVELS + 0.055) / 1.055) ** 2.4)
_TO_CODE = np.where(_LEVELS**2 <= 0.0031308, _LEVELS**2 * 12.92, 1.055 * _LEVELS ** (2 / 2.4) - 0.055)
_BGR_TO_YCC = np.array(
    [
        [0.114, 0.587, 0.299],
        [-0.114 * 0.713, -0.587 * 0.713, 0.701 * 0.713],
        [0.886 * 0.564, -0.587 * 0.564, -0.299 * 0.564],
    ]
)
_YCC_TO_BGR = np.linalg.inv(_BGR_TO_YCC)


def to_linear(code: npt.NDArray[np.floating]) -> FloatArray:
    """Linear light 0..1 of code values 0..1, by the sRGB curve (IEC 61966-2-1), from a table."""
    return _TO_LINEAR[(np.clip(code, 0, 1) * 2048 + 0.5).astype(np.intp)]  # type: ignore[no-any-return]


def to_code(linear: npt.NDArray[np.floating]) -> FloatArray:
    """Code values 0..1 of linear light 0..1; the table runs over the square root, which is nearly even in code."""
    return _TO_CODE[(np.sqrt(np.clip(linear, 0, 1)) * 2048 + 0.5).astype(np.intp)]  # type: ignore[no-any-return]


def _to_bgr(ycc: FloatArray) -> FloatArray:
    return ycc @ _YCC_TO_BGR.T
