"""Whether what a lost marker was found as is believed at once, or only when the next frames agree.

A wrong one is the worst mistake of all: filter, template and optics would learn from it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from spheremcap.core.circle import Circle
from spheremcap.core.look import Look

_SAME_SIZE = 0.2  # logarithm of the ratio of radii up to which a claim is as large as the marker was
_SURE_VOTES = 4.5  # votes above which one as large as that is believed at once
_CLEAR_VOTES = 4.9  # votes above which one of any size is
_FRAMES = 3  # of others, so many frames in a row have to agree
_NEAR = 3.0  # radii from one frame to the next that agree


class Reacquired:
    """What a lost marker may have been found as, frame after frame."""

    def __init__(self) -> None:
        self._circle: Circle | None = None
        self._frames = 0

    def confirmed(self, looks: Sequence[Look], last: Circle) -> list[Look]:
        """One frame's looks, with "unconfirmed" among the doubts where nothing else speaks against a claim but that it
        has to be seen again; `last` is the marker's circle when last verified."""
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
