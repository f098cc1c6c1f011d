"""Whether what a lost marker was found as is believed at once, only when the next frames agree, or not at all.

A wrong one is the worst mistake of all: filter, template and optics would learn from it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Frame
from spheremcap.core.look import Look
from spheremcap.core.sampling import cut_bgr
from spheremcap.detection.colour import box_mask

_SAME_SIZE = 0.2  # logarithm of the ratio of radii up to which a claim is as large as the marker was
_SURE_VOTES = 4.5  # votes above which one as large as that is believed at once
_CLEAR_VOTES = 4.9  # votes above which one of any size is
_FRAMES = 3  # of others, so many frames in a row have to agree
_NEAR = 3.0  # radii from one frame to the next that agree
_STAYED, _SAME = 0.8, 0.9  # share of its own pixels, and correlation, from which a place looks as it did
_SURROUNDED = 1.3  # radii up to which it is compared: the outline has to be there too


class Reacquired:
    """What a lost marker may have been found as, frame after frame; and the frame that it was last verified on."""

    def __init__(self) -> None:
        self._seen: tuple[Frame, Circle] | None = None
        self._circle: Circle | None = None
        self._frames = 0

    def seen(self, frame: Frame, circle: Circle) -> None:
        """The marker was verified at a circle of this frame, which is kept until the next."""
        self._seen = frame, circle

    def confirmed(self, looks: Sequence[Look]) -> list[Look]:
        """One frame's looks at a marker that was `seen` before, with a doubt where nothing else speaks against a claim:
        "stood there" where the frame that it was last verified on shows the same there, and "unconfirmed" where it only
        has to be seen again."""
        if not looks:
            self._circle, self._frames = None, 0
            return []
        assert self._seen is not None
        frame, last = self._seen
        looks = [replace(look, doubts=("stood there",)) if _stood_there(look, frame, last) else look for look in looks]
        found = next((look for look in looks if look.claim is not None and not look.doubts), None)
        if found is None or found.claim is None:
            self._circle, self._frames = None, 0
            return list(looks)
        circle, before = found.claim.circle, self._circle
        agrees = before is not None and circle.distance(before) < _NEAR * before.r_px and _alike(circle, before)
        self._circle, self._frames = circle, self._frames + 1 if agrees else 1
        enough = _SURE_VOTES if _alike(circle, last) else _CLEAR_VOTES
        if found.vote_sum > enough or self._frames >= _FRAMES:
            self._circle, self._frames = None, 0
            return list(looks)
        return [look if look.doubts else replace(look, doubts=("unconfirmed",)) for look in looks]


def _alike(one: Circle, other: Circle) -> bool:
    return abs(math.log(one.r_px / other.r_px)) < _SAME_SIZE


def _stood_there(look: Look, frame: Frame, last: Circle) -> bool:
    """Whether what is claimed, and nothing speaks against, was there already while the marker was elsewhere: nearly all
    pixels of its colours had them then, and all inside and close around correlates (normalised)."""
    if look.claim is None or look.doubts or look.limits is None:
        return False
    circle, patch = look.claim.circle, look.patch
    if circle.distance(last) < circle.r_px + last.r_px:
        return False
    height, width = patch.bgr.shape[:2]
    before = cut_bgr(*frame.planes, patch.x0_px, patch.y0_px, patch.step_px, width, height)
    x, y, r = patch.local(circle)
    rows, columns = np.ogrid[:height, :width]
    away2 = (columns - x) ** 2 + (rows - y) ** 2
    own = (box_mask(patch.bgr, look.limits) > 0) & (away2 <= r * r)
    stayed = own & (box_mask(before, look.limits) > 0)
    if stayed.sum() < _STAYED * own.sum():
        return False
    there = away2 <= (_SURROUNDED * r) ** 2
    now, then = (pixels - pixels.mean(axis=0) for pixels in (patch.bgr[there].astype(float), before[there]))
    power = math.sqrt(float((now * now).sum() * (then * then).sum()))
    return float((now * then).sum()) > _SAME * power
