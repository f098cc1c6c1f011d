"""How a marker's light falls off towards its outline, on each side of it, as its last verified frames showed it.

One frame's limb tells little of the side that lies in shade: the shadow's border has an edge of its own, and a small
marker creeps on to its lit half. What earlier frames showed there, ray by ray, says where the marker ends.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from spheremcap.core.compiled import BOOL, F4, F8, array, kernel
from spheremcap.core.linear import middle

Rings = npt.NDArray[np.float32]
Light = Callable[[], tuple[Rings, npt.NDArray[np.bool_], float]]
"""What a verified frame shows of the shading, for `Shading.follow` (`Outline.light`)."""

RINGS = 25
"""Places along a ray from the outline's middle (0) to the outline (1)."""
_MEMORY = 30  # looks that the mean reaches back
_CLOSELY = 15  # so many looks are taken one by one
_EVERY_NS = 8_000_000  # between later ones, at least: frames closer together show the same
_LEAST_CLEAR = 0.45  # share of the radius that counts as clear of the background, however small or blurred the marker
_SLOPE_FROM = 0.4  # of the radius, inwards from where the background mixes in: there the fall towards the limb is seen
_CARRIED_ON = 0.5  # share of that fall that goes on to the limb: all of it would feed on a circle that is too large


class Shading:
    """The mean light of one marker, over its own level, along the rays of its outline. Begins anew with every seed.

    `profile` (RINGS, rays) is what `edge.find_edges` takes; it has no rows until there is something to tell.
    """

    def __init__(self, rays: int) -> None:
        self.profile: Rings = np.empty((0, 0), np.float32)
        self._mean, self._looks = np.zeros((RINGS, rays)), np.zeros(rays)
        self._taken, self._looked_ns = 0, 0

    def learn(self, stamp_ns: int, light: Light) -> None:
        """Look at the light of a verified frame, where the last look is some time ago."""
        if self._taken < _CLOSELY or abs(stamp_ns - self._looked_ns) >= _EVERY_NS:
            self.follow(*light())
            self._taken, self._looked_ns = self._taken + 1, stamp_ns

    def follow(self, light: Rings, shown: npt.NDArray[np.bool_], clear: float) -> None:
        """Take in the linear light (RINGS, rays) of a verified frame, on the rays (rays,) that `shown` an edge; `clear`
        is the share of the radius up to which neither blur nor half resolution mixes the background in."""
        profile = np.empty(light.shape, np.float32)
        if _follow(light, shown, max(clear, _LEAST_CLEAR), self._mean, self._looks, profile):
            self.profile = profile


@kernel(BOOL, array(F4, 2), array(BOOL, 1), F8, F8[:, ::1], F8[::1], F4[:, ::1])
def _follow(light, shown, clear, mean, looks, profile):
    """`Shading.follow` on `mean` (RINGS, N) and `looks` (N,), and the profile that comes of it; False where too little
    was shown.

    The fall up to the limb is carried on from a straight line through the last rings that are clear; rays that never
    showed an edge have the mean of those that did; neighbouring rays are averaged.
    """
    rings, count = light.shape
    part = 1.0 / (rings - 1.0)
    last = int(clear / part)
    first = max(0, int(np.ceil((clear - _SLOPE_FROM) / part)))
    inner_rings = np.empty(rings * count)
    some = 0
    for k in range(rings // 2):
        for n in range(count):
            if shown[n]:
                inner_rings[some] = light[k, n]
                some += 1
    level = middle(inner_rings, some) if some > 0 else 0.0
    if not level > 0.0:
        return False
    known = 0
    for n in range(count):
        if shown[n]:
            looks[n] = min(looks[n] + 1.0, _MEMORY)
            for k in range(rings):
                mean[k, n] += (light[k, n] / level - mean[k, n]) / looks[n]
        known += looks[n] > 0.0
    own = np.empty((rings, count))
    for k in range(rings):
        usual = 0.0
        for n in range(count):
            usual += mean[k, n] / known
        for n in range(count):
            own[k, n] = mean[k, n] if looks[n] > 0.0 else usual
    middle_ring = 0.5 * (first + last)
    squares = 0.0
    for k in range(first, last + 1):
        squares += (k - middle_ring) ** 2
    for n in range(count):
        before, after = n - 1 if n > 0 else count - 1, n + 1 if n + 1 < count else 0
        slope = 0.0
        for k in range(last + 1):
            value = 0.25 * own[k, before] + 0.5 * own[k, n] + 0.25 * own[k, after]
            profile[k, n] = value
            if k >= first:
                slope += (k - middle_ring) * value
        slope *= _CARRIED_ON / max(squares, 1e-9)
        for k in range(last + 1, rings):
            profile[k, n] = profile[last, n] + slope * (k - last)
        for k in range(rings):
            profile[k, n] = max(profile[k, n], np.float32(0.02))
    return True
