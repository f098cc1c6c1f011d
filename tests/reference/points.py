"""GeometryScale with OpenCV's pyramidal Lucas-Kanade (thesis section 2.3.3, eq 2.18)."""

import cv2
import numpy as np

ANGLES = np.arange(16) * (2 * np.pi / 16)
SPOKES = np.concatenate([share * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1) for share in (0.8, 0.97)])


def geometry_scale(before, circle_before, now, circle_now, config):
    """`spheremcap.tracking.points.geometry_scale` for patches of the same scale, without the deviation's bounds."""
    was, start = before.local(circle_before), now.local(circle_now)
    side = 2 * (int(was.r_px) + 12)
    first, second = (square(p, c, side) for p, c in ((before, was), (now, start)))
    points = (SPOKES * was.r_px + (was.x_px % 1 + side // 2, was.y_px % 1 + side // 2)).astype(np.float32)
    away = np.subtract((start.x_px % 1, start.y_px % 1), (was.x_px % 1, was.y_px % 1)).astype(np.float32)
    options = {"winSize": (5, 5), "maxLevel": 1, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    forward, ok, _ = cv2.calcOpticalFlowPyrLK(first, second, points, points + away, **options)
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(second, first, forward, forward - away, **options)
    keep = (ok.ravel() == 1) & (ok_back.ravel() == 1)
    keep &= np.linalg.norm(back - points, axis=1) < config.max_round_trip_px
    if keep.sum() < config.min_points:
        return None
    was, is_now = spread(points[keep]), spread(forward[keep])
    ratio = is_now.sum() / was.sum()
    scatter = (is_now - ratio * was).std() / was.mean()
    return np.clip(ratio, 1 - config.max_step, 1 + config.max_step), scatter * np.sqrt(3 / keep.sum())


def square(patch, circle, side):
    """The luma (side, side) of the patch's own pixels around a circle in patch coordinates."""
    rows, columns = (int(v) - side // 2 + np.arange(side) for v in (circle.y_px, circle.x_px))
    height, width = patch.gray.shape
    return patch.gray[np.clip(rows, 0, height - 1)][:, np.clip(columns, 0, width - 1)]


def spread(points):
    """Distances (N,) to the mean point; eq 2.18 has their sums."""
    return np.linalg.norm(points - points.mean(axis=0), axis=1)
