"""Sub-pixel edge points on a marker's outline, each with its own uncertainty.

Along rays across the expected outline the pixel values are mixtures of marker and background. Mixing is a sum in
linear light only, so the sRGB curve is undone first. Each ray is projected on the colour difference that tells
marker from background there whatever the light does, the marker's limb darkening is allowed for, and the edge is
where the step that the lens and the known motion make (a Gaussian, swept along the blur) explains the profile best by
least squares, both levels left free.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field

from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig

FloatArray = npt.NDArray[np.float64]


class EdgeConfig(StageConfig):
    """Ours throughout; the defaults were judged on seven rendered scenarios at once, never on one."""

    rays: int = Field(48, ge=16, le=360, description="rays around the outline")
    blur_sigma_px: float = Field(0.5, gt=0, description="Gaussian blur of lens, sensor and codec")
    learn_blur: bool = Field(True, description="look at the seed for a softer lens than `blur_sigma_px`")
    chroma_sigma_px: float = Field(1.0, gt=0, description="further blur of chroma at half resolution")
    noise: float = Field(0.006, gt=0, description="least pixel noise, code values with full scale 1")
    balance: float = Field(
        0.02, gt=0, description="colour differences below this do not steer the projection, code values"
    )
    least_contrast: float = Field(4.0, gt=0, description="step over its own standard deviation that makes an edge")
    shading: bool = Field(True, description="carry the marker's shading on to the limb")
    chroma: bool = Field(True, description="false: edges in brightness alone (ablation)")


@dataclass(frozen=True, slots=True)
class EdgePoints:
    """Edge points in image pixels (N, 2), the standard deviation of each along its normal (N,) in pixels, and the ray
    each came from (N,). Rays without an edge, or out of the picture, have none. `rays` is how many rays lay inside
    the picture; `offset_px` (N,) how far outside the expected outline each point is; `explained` the share in [0, 1]
    of the profiles' variance that the blurred step explains, a measure of how well the blur is known."""

    points_px: FloatArray
    sd_px: FloatArray
    ray: npt.NDArray[np.intp]
    offset_px: FloatArray
    rays: int
    explained: float


_STEP = 0.5  # px between samples on a ray
_FINE = 0.25  # px between the shifts that are tried


def find_edges(
    patch: Patch,
    outline_px: FloatArray,
    r_px: float,
    reach_px: float,
    blur_px: FloatArray,
    mask: npt.NDArray[np.uint8] | None,
    config: EdgeConfig,
    coarse: bool = False,
) -> EdgePoints | None:
    """Edge points near an expected outline (image pixels, (N, 2), clockwise on screen); None when there is no contrast.

    `reach_px` is how far from the outline an edge may be; `blur_px` (2,) the motion during the exposure;
    `mask` the colour mask of the patch (edges whose inner side is not marker-coloured are left out), or None.
    `coarse` samples at half the density and leaves the shading out: a quarter of the work, for a first look.
    """
    count = len(outline_px)
    local = outline_px - (patch.window.x, patch.window.y)
    ring = np.concatenate([local[-1:], local, local[:1]])
    tangent = ring[2:] - ring[:-2]
    tangent /= np.sqrt((tangent * tangent).sum(axis=1, keepdims=True))
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)

    across, along = normal @ blur_px, tangent @ blur_px
    sigma = config.blur_sigma_px + 0.5 * config.chroma_sigma_px
    margin = sigma + 0.2
    half_blur = np.abs(across) / 2
    outer = reach_px + margin + float(half_blur.max())
    inner = min(max(outer, 0.6 * r_px), 0.95 * r_px)
    step = _STEP * (1 if r_px < 40 else 2) * (2 if coarse else 1)
    fine = step / 2
    u = np.arange(-np.ceil(inner / step), np.ceil(outer / step) + 1) * step  # (M,)

    samples = _sample(patch.bgr, local, normal, u)  # (N, M, 3)
    x0, y0, x1, y1 = patch.picture
    ends = local[:, None, :] + normal[:, None, :] * np.array([-margin, margin])[:, None]
    inside = ((ends[..., 0] >= x0) & (ends[..., 0] <= x1 - 1) & (ends[..., 1] >= y0) & (ends[..., 1] <= y1 - 1)).all(
        axis=1
    )
    if inside.sum() < 8:
        return None

    # Levels on either side, clear of the blurred edge, and the colour difference between them.
    clear = margin + half_blur
    depth = np.minimum(clear + 0.5 * reach_px, 0.6 * inner)[:, None]
    deep = (u[None, :] < -depth) & (u[None, :] > -0.9 * r_px)
    close = deep & (u[None, :] > -depth - 0.15 * r_px - 0.5)
    far = u[None, :] > (clear + 0.5 * reach_px - 0.5)[:, None]
    far[:, -2:] = True
    colour_in = _level(samples, close)
    colour_out = _level(samples, far)
    reference = np.sort(colour_in[inside], axis=0)[int(inside.sum()) // 2]
    # What may vary without being an edge: the background's texture and the marker's own shading. A direction that is
    # blind to both (Fisher's discriminant) sees a coloured marker's edge whatever the light does to it.
    within = 0.25 * _scatter(colour_out[inside]) + 0.2 * _scatter(samples[deep & inside[:, None]])
    difference = reference - colour_out
    direction = np.linalg.solve(within + np.eye(3) * config.balance**2, difference.T).T
    if not config.chroma:
        direction[:, 1:] = 0
    direction /= np.sqrt(np.maximum((direction * direction).sum(axis=1, keepdims=True), 1e-24))
    profile = np.einsum("nmc,nc->nm", samples, direction)  # (N, M)

    shift = np.arange(-np.ceil(reach_px / fine), np.ceil(reach_px / fine) + 1) * fine  # (K,)
    near = np.abs(u) <= reach_px + margin + float(half_blur.max())
    first = int(near.argmax())
    uu = u[near]
    v = np.arange(uu[0] - shift[-1], uu[-1] - shift[0] + fine / 2, fine)  # edge-centred abscissa
    if config.shading and not coarse:
        limb = _limb(to_linear(samples[..., 0]), u, r_px, deep & inside[:, None], close, v)
    else:
        limb = np.ones((count, len(v)))
    expected = _profile(v, limb, colour_in, colour_out, across, along, r_px, config)  # (N, V, 3)
    shape = np.einsum("nvc,nc->nv", expected - expected[:, -1:], direction)

    wanted = np.arange(len(shift))
    # Template for shift k at sample m: abscissa u_m - shift_k.
    index = (
        np.rint((uu[0] - v[0]) / fine).astype(int)
        + np.arange(len(uu))[None, :] * 2
        - (wanted - (len(shift) // 2))[:, None]
    )
    index = np.clip(index, 0, len(v) - 1)
    data = profile[:, first : first + len(uu)]
    data = data - data.mean(axis=1, keepdims=True)
    template = shape[:, index]  # (N, K, m)
    template = template - template.mean(axis=2, keepdims=True)
    power = np.maximum(np.einsum("nkm,nkm->nk", template, template), 1e-12)
    like = np.einsum("nkm,nm->nk", template, data)
    rise = like / power  # step seen over step expected
    sse = (data * data).sum(axis=1)[:, None] - like * rise
    sse = np.where(rise > 0.2, np.maximum(sse, 0), np.inf)
    best = sse.argmin(axis=1)
    rows = np.arange(count)
    interior = (best > 0) & (best < len(shift) - 1) & inside & np.isfinite(sse[rows, best])
    k = np.clip(best, 1, len(shift) - 2)
    left, mid, right = sse[rows, k - 1], sse[rows, k], sse[rows, k + 1]
    with np.errstate(invalid="ignore"):
        bend = left - 2 * mid + right
        interior &= np.isfinite(bend) & (bend > 0)
        offset = shift[k] + np.where(interior, 0.5 * (left - right) / np.where(bend > 0, bend, 1) * fine, 0)
        noise2 = np.maximum(mid / max(1, len(uu) - 3), config.noise**2)
        # Half the second derivative of the SSE is the Fisher information times the noise variance.
        sd = np.sqrt(noise2 / np.maximum(bend / fine**2 / 2, 1e-12))
    contrast = rise[rows, k] * np.sqrt(power[rows, k] / noise2)
    keep = interior & (contrast > config.least_contrast) & np.isfinite(sd) & (sd < 2.0)
    if mask is not None:
        back = local + normal * (offset - 1.5 - half_blur - sigma)[:, None]
        keep &= _marker_coloured(mask, back)
    if keep.sum() < 6:
        return None
    points = outline_px + normal * offset[:, None]
    total = float((data[keep] ** 2).sum())
    explained = 1 - float(mid[keep].sum()) / max(total, 1e-12)
    return EdgePoints(
        points[keep],
        np.maximum(sd[keep], 0.02),
        np.flatnonzero(keep),
        offset[keep],
        int(inside.sum()),
        explained,
    )


def _sample(image: npt.NDArray[np.uint8], origin: FloatArray, normal: FloatArray, u: FloatArray) -> FloatArray:
    """Luma and chroma (N, M, 3), code values 0..1, at origin + u * normal, bilinear; the patch's border repeats."""
    xy = (origin[:, None, :] + normal[:, None, :] * u[None, :, None]).astype(np.float32)
    bgr = cv2.remap(image, xy, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    return bgr @ (_BGR_TO_YCC.T / 255)


def _level(samples: FloatArray, where: npt.NDArray[np.bool_]) -> FloatArray:
    """Mean colour (N, 3) of each ray over the samples chosen."""
    weight = where / np.maximum(where.sum(axis=1, keepdims=True), 1)
    return np.einsum("nmc,nm->nc", samples, weight)


def _scatter(colours: npt.NDArray[np.floating]) -> FloatArray:
    """Covariance (3, 3) of colours (N, 3); zero for none."""
    off = colours - colours.mean(axis=0) if len(colours) else np.zeros((1, 3))
    return (off.T @ off / max(1, len(off))).astype(np.float64)


def _marker_coloured(mask: npt.NDArray[np.uint8], at: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether the mask holds around each point (N, 2) of the patch."""
    xy = at.astype(np.float32)[:, None, :]
    soft = cv2.remap(cv2.blur(mask, (3, 3)), xy, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
    return soft[:, 0] >= 85  # type: ignore[no-any-return]


def _limb(
    brightness: FloatArray,
    u: FloatArray,
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
    nz = np.sqrt(1 - np.clip(1 + u / r_px, 0, 1) ** 2)[None, :]
    limb_nz = np.sqrt(1 - np.clip(1 + v / r_px, 0, 1) ** 2)[None, :]
    keep = where.astype(np.float64)
    slope = 0.0
    for _ in range(2):
        count = np.maximum(keep.sum(axis=1, keepdims=True), 1)
        level = np.maximum((brightness * keep).sum(axis=1, keepdims=True) / count, 1e-6)
        mean_nz = (nz * keep).sum(axis=1, keepdims=True) / count
        off_nz, off = (nz - mean_nz) * keep, (brightness / level - 1) * keep
        slope = float((off_nz * off).sum() / ((off_nz * off_nz).sum() + 0.02 * keep.sum() + 1e-9))
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
    r_px: float,
    config: EdgeConfig,
) -> FloatArray:
    """What video shows along each ray (N, len(v), 3) of an edge at v = 0, marker at v < 0: luma and chroma.

    Light mixes linearly under the lens blur and the motion, then the camera's curve is applied, then chroma is blurred
    once more by its half resolution. Mixing coded values instead would shift the edge towards the darker side.
    """
    fine = float(v[1] - v[0])
    # Blur moves a curved edge inwards by sigma^2 / 2r: by the lens here, by the chroma further down.
    inwards = config.blur_sigma_px**2 / (2 * r_px)
    step = np.clip(0.5 - (v + inwards) / fine, 0, 1)
    both = _gauss(np.concatenate([step[None, :], step * limb]), config.blur_sigma_px / fine)
    cover, light = _swept(both[0], both[1:], across / fine, along / fine, r_px / fine)
    inner, outer = to_linear(_to_bgr(colour_in)), to_linear(_to_bgr(colour_out))
    mixed = light[:, :, None] * inner[:, None, :] + (1 - cover)[:, :, None] * outer[:, None, :]
    coded = to_code(mixed) @ _BGR_TO_YCC.T
    chroma = coded[..., 1:].transpose(0, 2, 1).reshape(-1, len(v))
    soft = _gauss(chroma, config.chroma_sigma_px / fine)
    part = min(1.0, 1.5 * config.chroma_sigma_px**2 / (2 * r_px) / fine)  # 1.5: sampled twice, in both directions
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
