"""Votes of the six template matchers, and the verdict on a claim."""

from enum import Enum
from typing import NamedTuple

from spheremcap.core.circle import Circle


class Verdict(Enum):
    """What the votes say of a claim (section 3.1.4.1 of the thesis)."""

    VERIFIED = "VERIFIED"
    DOUBTFUL = "DOUBTFUL"
    REJECTED = "REJECTED"


class Vote(NamedTuple):
    """One matcher's answer: the circle it found, its score there, and the Dice overlap with the claim (eq 3.8).

    `overlap` is 0 when there was no claim. `score` is on the matcher's own scale (OpenCV's TM_ definitions).
    """

    matcher: str
    circle: Circle
    score: float
    overlap: float
