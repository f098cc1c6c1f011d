"""The second renderer's shapes as signed distances, in NumPy: nothing of how a ray is met with them."""

import numpy as np


def distance(kind, p, a, b, radius, half_width=0.0, offset=0.0):
    """Distances (N,) of places (N, 3) to a thing's surface, negative within. A sphere is about `a`; a capsule from
    `a` to `b`; a box about `a` with half edges `b`; a band is that part of a sphere's surface that lies within
    `half_width` of `offset` along the unit axis `b`, and nothing is within it."""
    if kind == "sphere":
        return np.linalg.norm(p - a, axis=1) - radius
    if kind == "capsule":
        part = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return np.linalg.norm(p - a - part[:, None] * (b - a), axis=1) - radius
    if kind == "box":
        q = np.abs(p - a) - b
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    along = (p - a) @ b - offset
    return np.maximum(np.abs(np.linalg.norm(p - a, axis=1) - radius), np.abs(along) - half_width)


def rays(camera, view, points_px):
    """Unit directions (N, 3) on the stage of pixels (N, 2), by the camera's own matrix."""
    ahead = camera.rays(points_px)
    return ahead @ view.from_stage
