"""What the strokes of a session are in the mean, and the left hand against the right."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.stroke import EventKind, Stroke, StrokeEvent

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Quantity:
    """What is told of a stroke: the field of a Stroke and of its standard deviation, and how it is printed: `factor`
    turns the field's unit into `unit`, `digits` are decimals. `from_zero`: it is zero where there is none of it, so
    that a share of it means something; a position on the rim is not."""

    field: str
    sd_field: str | None
    label: str
    unit: str
    factor: float
    digits: int
    from_zero: bool = True


QUANTITIES = (
    Quantity("push_s", "push_sd_s", "Push time", "ms", 1e3, 0),
    Quantity("recovery_s", "recovery_sd_s", "Recovery time", "ms", 1e3, 0),
    Quantity("cycle_s", "cycle_sd_s", "Cycle time", "ms", 1e3, 0),
    Quantity("push_share", None, "Push share of the cycle", "%", 100, 1),
    Quantity("frequency_hz", "frequency_sd_hz", "Frequency", "strokes/s", 1, 2),
    Quantity("contact_deg", "contact_sd_deg", "Contact angle", "°", 1, 1, False),
    Quantity("release_deg", "release_sd_deg", "Release angle", "°", 1, 1, False),
    Quantity("push_deg", "push_sd_deg", "Push angle", "°", 1, 1),
    Quantity("contact_mps", "contact_sd_mps", "Speed at contact", "m/s", 1, 2),
    Quantity("recovery_end_mps", "recovery_end_sd_mps", "Speed at the end of recovery", "m/s", 1, 2),
)


@dataclass(frozen=True, slots=True)
class Mean:
    """A quantity over the strokes that have it, in the unit it is printed in. `sd` is the standard deviation over
    strokes (None: of one stroke there is none), `measured_to` the uncertainty of one stroke's value: the root mean
    square of their own standard deviations (None: they have none)."""

    strokes: int
    value: float
    sd: float | None
    measured_to: float | None


@dataclass(frozen=True, slots=True)
class Compared:
    """Left minus right of two means. `error` is the difference's standard error, from how much strokes differ (None:
    too few); `index` is the difference over the mean of both, in percent (None: it would mean nothing)."""

    difference: float
    error: float | None
    index: float | None


def value_of(stroke: Stroke, quantity: Quantity) -> float | None:
    """A stroke's value, in the unit of its field; None where there is none."""
    if quantity.field == "push_share":
        return None if stroke.push_s is None or not stroke.cycle_s else stroke.push_s / stroke.cycle_s
    return _finite(getattr(stroke, quantity.field))


def sd_of(stroke: Stroke, quantity: Quantity) -> float | None:
    """Its standard deviation."""
    return None if quantity.sd_field is None else _finite(getattr(stroke, quantity.sd_field))


def _finite(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def mean_of(strokes: Sequence[Stroke], quantity: Quantity) -> Mean | None:
    """The mean over those strokes that have the quantity; None where none has."""
    values = [v for stroke in strokes if (v := value_of(stroke, quantity)) is not None]
    if not values:
        return None
    sds = [s for stroke in strokes if value_of(stroke, quantity) is not None and (s := sd_of(stroke, quantity))]
    scaled = np.array(values) * quantity.factor
    return Mean(
        len(values), float(scaled.mean()), float(scaled.std(ddof=1)) if len(values) > 1 else None,
        float(np.sqrt(np.mean(np.square(sds)))) * quantity.factor if sds else None,
    )  # fmt: skip


def compared(left: Mean | None, right: Mean | None, quantity: Quantity) -> Compared | None:
    """Left against right; None where one of them has no mean."""
    if left is None or right is None:
        return None
    difference, middle = left.value - right.value, (left.value + right.value) / 2
    error = None
    if left.sd is not None and right.sd is not None:
        error = float(np.sqrt(left.sd**2 / left.strokes + right.sd**2 / right.strokes))
    return Compared(difference, error, 100 * difference / middle if quantity.from_zero and middle else None)


def contact_lags(
    left: Sequence[StrokeEvent], right: Sequence[StrokeEvent], strokes: Mapping[str, Sequence[Stroke]]
) -> FloatArray:
    """How much later than the right hand's contact the left hand's is, ms (M,): of each pair of contacts that are each
    other's nearest and less than half a cycle apart."""
    cycles = [s.cycle_s for some in strokes.values() for s in some if s.cycle_s]
    a, b = (
        np.array(sorted(e.stamp_ns for e in events if e.kind is EventKind.CONTACT), np.int64)
        for events in (left, right)
    )
    if not cycles or not len(a) or not len(b):
        return np.zeros(0)
    to_b, to_a = _nearest(a, b), _nearest(b, a)
    lags_ms = (a - b[to_b]) / 1e6
    paired = (to_a[to_b] == np.arange(len(a))) & (np.abs(lags_ms) < float(np.median(cycles)) * 1e3 / 2)
    return lags_ms[paired]


def _nearest(stamps: npt.NDArray[np.int64], among: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Index of the nearest of `among` (rising) of each stamp."""
    after = np.clip(np.searchsorted(among, stamps), 1, max(1, len(among) - 1))
    before = after - 1
    after = np.minimum(after, len(among) - 1)
    return np.where(stamps - among[before] <= among[after] - stamps, before, after)
