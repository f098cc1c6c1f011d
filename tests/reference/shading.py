"""How a marker's light falls off towards its outline, in NumPy (`spheremcap.detection.shading`)."""

import numpy as np
import numpy.typing as npt

from spheremcap.detection.shading import _CARRIED_ON, _LEAST_CLEAR, _MEMORY, _SLOPE_FROM

FloatArray = npt.NDArray[np.float64]


class Shading:
    """`spheremcap.detection.shading.Shading`, array by array."""

    def __init__(self, rays: int, rings: int) -> None:
        self.mean, self.frames = np.zeros((rings, rays)), np.zeros(rays)
        self.profile: FloatArray | None = None

    def follow(self, light: FloatArray, shown: npt.NDArray[np.bool_], clear: float) -> None:
        rings = len(light)
        inner = np.sort(light[: rings // 2, shown], axis=None)
        level = inner[len(inner) // 2] if len(inner) else 0.0
        if not level > 0:
            return
        self.frames[shown] = np.minimum(self.frames[shown] + 1, _MEMORY)
        self.mean[:, shown] += (light[:, shown] / level - self.mean[:, shown]) / self.frames[shown]
        known = self.frames > 0
        own = np.where(known, self.mean, self.mean.sum(axis=1, keepdims=True) / known.sum())
        own = 0.25 * np.roll(own, 1, axis=1) + 0.5 * own + 0.25 * np.roll(own, -1, axis=1)
        place = np.arange(rings) / (rings - 1)
        clear = max(clear, _LEAST_CLEAR)
        last = int(np.flatnonzero(place <= clear + 1e-12)[-1])
        fit = np.arange(max(0, int(np.ceil((clear - _SLOPE_FROM) * (rings - 1)))), last + 1)
        slope = np.polyfit(fit, own[fit], 1)[0] if len(fit) > 1 else np.zeros(own.shape[1])
        beyond = np.arange(rings) > last
        own[beyond] = own[last] + _CARRIED_ON * slope * (np.arange(rings)[beyond, None] - last)
        self.profile = np.maximum(own, 0.02)
