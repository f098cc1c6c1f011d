"""The gradient Hough with OpenCV's Sobel and Canny and NumPy's sums, which the compiled one must equal."""

import cv2
import numpy as np

HAIR = 1e-9  # what lies on a border counts as beyond it


def edges(bgr, threshold):
    """(N, 4) column, row and unit gradient of Canny's edge pixels, none of them on the border."""
    gray = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    gx, gy = (cv2.Sobel(gray, cv2.CV_16S, *axis) for axis in ((1, 0), (0, 1)))
    inner = np.zeros(gray.shape, bool)
    inner[1:-1, 1:-1] = True
    gx, gy = np.where(inner, gx, 0).astype(np.int16), np.where(inner, gy, 0).astype(np.int16)
    rows, columns = np.nonzero(cv2.Canny(gx, gy, threshold / 2, threshold))
    gradient = np.stack([gx[rows, columns], gy[rows, columns]], axis=1).astype(np.float64)
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    return np.concatenate([columns[:, None], rows[:, None], gradient], axis=1)


def vote_circles(bgr, low, high, dp, least_distance, threshold, least_votes, keep):
    """(N, 3) centre and radius of circles, most votes first."""
    height, width = bgr.shape[:2]
    found = edges(bgr, threshold)
    radii = np.arange(low, high + HAIR)
    steps = np.concatenate([-radii, radii])
    x = found[:, :1] + steps * found[:, 2:3]
    y = found[:, 1:2] + steps * found[:, 3:4]
    across, down = x + 0.5 + HAIR, y + 0.5 + HAIR
    kept = (across >= 0) & (down >= 0) & (across < width) & (down < height)
    x, y = x[kept], y[kept]
    cell = 1 + (down[kept] / dp).astype(int), 1 + (across[kept] / dp).astype(int)
    shape = int(height / dp) + 3, int(width / dp) + 3
    votes, sum_x, sum_y = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for total, value in ((votes, 1), (sum_x, x), (sum_y, y)):
        np.add.at(total, cell, value)
    peaks = []
    for i in range(1, shape[0] - 1):
        for j in range(1, shape[1] - 1):
            peak = votes[i, j]
            later, earlier = max(votes[i + 1, j], votes[i, j + 1]), max(votes[i - 1, j], votes[i, j - 1])
            if peak > least_votes and peak >= later and peak > earlier:
                around = np.s_[i - 1 : i + 2, j - 1 : j + 2]
                total = votes[around].sum()
                peaks.append((peak, sum_x[around].sum() / total, sum_y[around].sum() / total))
    out = []
    for _, cx, cy in sorted(peaks, key=lambda peak: -peak[0]):
        if len(out) == keep or any(np.hypot(cx - a, cy - b) < least_distance for a, b, _ in out):
            continue
        radius, support = radius_of(found, cx, cy, low, high)
        if support > least_votes:
            out.append((cx, cy, radius))
    return np.array(out).reshape(-1, 3)


def radius_of(found, x, y, low, high):
    """The mean distance of the three one-pixel bins with most edge pixels, for their length, that face (x, y)."""
    dx, dy = found[:, 0] - x, found[:, 1] - y
    d = np.hypot(dx, dy)
    d = d[(d >= low - HAIR) & (d <= high + HAIR) & (np.abs(dx * found[:, 2] + dy * found[:, 3]) > 0.9 * d)]
    count = int(high - low + HAIR) + 1
    bins = np.minimum((d - low + HAIR).astype(int), count - 1)
    best = (0.0, 0.0, 0)
    for n in range(count):
        some = d[np.abs(bins - n) <= 1]
        if len(some) and len(some) / some.mean() > best[0]:
            best = (len(some) / some.mean(), some.mean(), len(some))
    return best[1], best[2]
