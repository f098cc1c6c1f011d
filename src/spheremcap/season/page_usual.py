"""What is usual of a number over the sessions, and from where on it is far off."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST = 5
"""With fewer sessions nothing is usual."""
_DEVIATIONS = 3.0
_LEAST = 0.1
"""Of the median: so much is no difference, however much alike the others are."""
_LEAST_SHARE = 0.005
RULE = (
    f"more than {_DEVIATIONS:g} robust standard deviations above the median session. A robust standard deviation is "
    "1.48 times the median distance from the median, which a few far-off sessions do not change, and here at least a "
    f"tenth of the median. It is told from {FEWEST} sessions on"
)
SHARES_RULE = (
    f"more than {_DEVIATIONS:g} robust standard deviations below the median session. A robust standard deviation is "
    "1.48 times the median distance from the median, which a few far-off sessions do not change, and here at least "
    f"{100 * _LEAST_SHARE:g} %. It is told from {FEWEST} sessions on."
)


@dataclass(frozen=True)
class Usual:
    """The median session's value, and the value beyond which a session is far off."""

    median: float
    limit: float


def usual_residual(values: Sequence[float]) -> Usual | None:
    """Of residuals, of which large ones are far off; None of fewer than FEWEST."""
    return _usual(values, _LEAST * float(np.median(values)), _DEVIATIONS) if len(values) >= FEWEST else None


def usual_share(values: Sequence[float]) -> Usual | None:
    """Of shares from 0 to 1, of which small ones are far off; None of fewer than FEWEST."""
    return _usual(values, _LEAST_SHARE, -_DEVIATIONS) if len(values) >= FEWEST else None


def _usual(values: Sequence[float], least: float, deviations: float) -> Usual:
    median = float(np.median(values))
    deviation = 1.4826 * float(np.median(np.abs(np.asarray(values) - median)))
    return Usual(median, median + deviations * max(deviation, least))
