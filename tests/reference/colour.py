"""The colour stages by OpenCV and NumPy, which the compiled ones must equal."""

import cv2
import numpy as np

HUES = 180


def mask(box, hsv, gain=1.0):
    """(h, w) 255 inside a ColourBox, 0 outside, of 8-bit HSV: OpenCV's inRange, hue in whole steps outwards."""
    s0, s1 = box.saturation
    v0, v1 = box.value[0] * min(gain, 1.2), box.value[1] * gain
    if v1 > 235:  # a bright marker clips: it may go up to white
        v1, s0 = 255.0, s0 * 0.7
    low, high = box.hue_mean - box.hue_half, box.hue_mean + box.hue_half
    if box.hue_half >= HUES / 2:
        ranges = [(0.0, HUES - 1.0)]
    elif low < 0:
        ranges = [(0, high), (low + HUES, HUES - 1)]
    elif high >= HUES:
        ranges = [(low, HUES - 1), (0, high - HUES)]
    else:
        ranges = [(low, high)]
    parts = [cv2.inRange(hsv, (float(np.floor(a)), s0, v0), (float(np.ceil(b)), s1, v1)) for a, b in ranges]
    return np.bitwise_or.reduce(parts)


def hsv_of(bgr):
    """OpenCV's HSV as float64 (..., 3), not rounded: hue 0..180, saturation and value 0..255."""
    b, g, r = np.moveaxis(bgr.astype(np.float64), -1, 0)
    value = bgr.max(axis=-1).astype(np.float64)
    span = value - bgr.min(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        hue = np.select(
            [span == 0, value == r, value == g],
            [0 * b, 30 * (g - b) / span % HUES, 60 + 30 * (b - r) / span],
            120 + 30 * (r - g) / span,
        )
        saturation = np.where(value > 0, 255 * span / value, 0)
    return np.stack([hue, saturation, value], axis=-1)


def inside(limits, hsv):
    """(...) True where colours (..., 3) lie within `ColourBox.limits`."""
    hue, saturation, value = np.moveaxis(hsv, -1, 0)
    off = np.abs(hue - limits[0])
    near = np.minimum(off, HUES - off) <= limits[1]
    return near & (saturation >= limits[2]) & (saturation <= limits[3]) & (value >= limits[4]) & (value <= limits[5])


def blobs(mask, diagonal, least):
    """(N, 5) pixels, centroid, width and height of the connected parts, by OpenCV."""
    count, _, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8 if diagonal else 4)
    rows = [
        (stats[k, cv2.CC_STAT_AREA], *centres[k], stats[k, cv2.CC_STAT_WIDTH], stats[k, cv2.CC_STAT_HEIGHT])
        for k in range(1, count)
        if stats[k, cv2.CC_STAT_AREA] >= least
    ]
    return np.array(rows, np.float64).reshape(-1, 5)


def ring_colours(bgr, picture, x, y, beyond, within, limits):
    """As `detection.appearance.ring_colours`, with a mask over the whole patch."""
    x0, y0, x1, y1 = picture
    rows, columns = np.indices(bgr.shape[:2])
    away2 = (columns - x) ** 2 + (rows - y) ** 2
    ring = (away2 <= within**2) & (away2 > beyond * abs(beyond))
    ring &= (columns >= x0) & (columns < x1) & (rows >= y0) & (rows < y1)
    hsv = hsv_of(bgr[ring])
    own = inside(limits, hsv)
    values = hsv[:, 2]
    if not len(values):
        return 0, 0, np.nan, np.nan, np.nan, np.nan
    quarter = len(values) // 4
    low, high = np.sort(values)[[quarter, 3 * quarter]]
    return len(values), own.sum(), low, np.median(values), high, np.median(values[own]) if own.any() else np.nan


def shares(appearance, patch, circle):
    """`Appearance.shares` from whole masks: inside 0.9 r, and between 1.1 r and 1.35 r, at the best exposure."""
    local = patch.local(circle)
    rows, columns = np.indices(patch.bgr.shape[:2])
    x0, y0, x1, y1 = patch.picture
    seen = (columns >= x0) & (columns < x1) & (rows >= y0) & (rows < y1)
    away = np.hypot(columns - local.x_px, rows - local.y_px)
    disc = seen & (away <= max(1, 0.9 * local.r_px))
    ring = seen & (away > max(1, 1.1 * local.r_px)) & (away <= max(1, 1.35 * local.r_px))
    if not disc.any():
        return 0.0, 0.0
    hsv = hsv_of(patch.bgr)
    found = inside(appearance.box.limits(appearance.gain), hsv)
    if found[disc].mean() < 0.8:
        values = np.sort(hsv[disc][:, 2])
        halves = values[[len(values) // 4, 3 * (len(values) // 4)]] / appearance._value
        masks = [found, *(inside(appearance.box.limits(gain), hsv) for gain in np.clip(halves, 0.1, 4))]
        found = max(masks, key=lambda m: m[disc].sum())
    return found[disc].mean(), found[ring].mean() if ring.any() else 0.0
