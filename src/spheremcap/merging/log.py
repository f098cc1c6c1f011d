"""One sensor's samples in SI units, in order of time, and what is odd about their times."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import NS_PER_S
from spheremcap.merging.times import StampArray, Timing

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Kind = Literal["imu", "wheel", "record"]

_LEAST_GAP_NS = NS_PER_S
_LEAST_GAP_STEPS = 20
_SWITCHES = 3
"""So often sorted samples go from one run of rising stamps to another for a single late one; more are a clock that ran
twice through the same times."""


@dataclass(frozen=True)
class SensorLog:
    """One sensor's samples in SI units, by rising stamp.

    `values` has (N,) arrays, NaN where there is none. Of an `imu`: `linear_acceleration.x` (m/s^2, gravity
    included), `angular_velocity.x` (rad/s), `magnetic_field.x` (T), `orientation.w`, `temperature_c`. Of a
    `wheel`: `angle_rad` (unwrapped), `rate_rad_s`, `force.x` (N), `moment.x` (N m). Of a `record` whatever
    its columns are. `saturated` (N,) is None when nothing is known of it. `notes` are lines for the user, `lost`
    what could not be read, `doubts` what makes the times unlikely to be right.
    """

    name: str
    kind: Kind
    stamp_ns: StampArray
    values: Mapping[str, FloatArray]
    frame_id: str
    source: str
    timing: Timing = field(default_factory=Timing)
    saturated: BoolArray | None = None
    notes: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def relative(self) -> bool:
        """Whether the stamps count from the start of the sensor's recording, and not from 1970."""
        return self.timing.zero == "start"

    @property
    def rate_hz(self) -> float | None:
        """One over the median step; None where there is none."""
        steps = np.diff(self.stamp_ns)
        steps = steps[steps > 0]
        return NS_PER_S / float(np.median(steps)) if len(steps) else None

    def vector(self, name: str) -> FloatArray | None:
        """(N, 3) of `linear_acceleration`, `angular_velocity`, ...; None when an axis is missing."""
        axes = [self.values.get(f"{name}.{axis}") for axis in "xyz"]
        return None if any(a is None for a in axes) else np.stack([a for a in axes if a is not None], axis=1)


def sensor_log(
    name: str,
    kind: Kind,
    stamp_ns: StampArray,
    values: dict[str, FloatArray],
    timing: Timing,
    path: Path,
    *,
    frame_id: str = "",
    saturated: BoolArray | None = None,
    notes: tuple[str, ...] = (),
    lost: tuple[str, ...] = (),
) -> SensorLog:
    """Samples by rising stamp, angles unwrapped, clipping found; what is odd about the stamps is said."""
    odd, doubts = _oddities(stamp_ns, timing, path)
    if np.any(np.diff(stamp_ns) < 0):
        order = np.argsort(stamp_ns, kind="stable")
        stamp_ns = stamp_ns[order]
        values = {axis: column[order] for axis, column in values.items()}
        saturated = None if saturated is None else saturated[order]
    named: dict[str, FloatArray] = {}
    for axis, column in values.items():
        if kind == "wheel" and axis == "angle":
            named["angle_rad"] = _unwrapped(column)
        elif kind != "record":
            named[{"rate": "rate_rad_s", "temperature": "temperature_c"}.get(axis, axis)] = column
        else:
            named[axis] = column
    if kind == "imu" and saturated is None:
        saturated = _clipped(named)
    return SensorLog(
        name, kind, stamp_ns, named, frame_id or name, path.name, timing, saturated, (*notes, *odd), lost, doubts
    )


def _oddities(stamp_ns: StampArray, timing: Timing, path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Lines about stamps that fall, repeat or leave a gap, and about a clock that began again."""
    notes, doubts = [], []
    steps = np.diff(stamp_ns)
    falls = np.flatnonzero(steps < 0)
    order = np.argsort(stamp_ns, kind="stable")
    if len(falls):
        runs = np.concatenate([[0], np.cumsum(steps < 0)])
        switches = int(np.count_nonzero(np.diff(runs[order])))
        ends = [*(falls + 1).tolist(), len(stamp_ns)]
        again = any(b - a > 1 and stamp_ns[a] <= stamp_ns[0] and a > 1 for a, b in pairwise(ends))
        if again or switches > _SWITCHES * len(falls) + 2 * _SWITCHES:
            deepest = int(falls[np.argmin(steps[falls])])
            before, after = (timing.text(int(stamp_ns[k])) for k in (deepest, deepest + 1))
            doubts.append(
                f"{path}: its clock starts again after sample {deepest + 1} ({before}, then {after}), and the parts "
                "lie over each other: cut the file there and give each part its own --offset"
            )
        else:
            late = f"{len(falls)} stamps go back" if len(falls) > 1 else "1 stamp goes back"
            notes.append(f"{path}: {late}; the samples are sorted by stamp")
    steps = np.diff(stamp_ns[order])
    repeated = int(np.count_nonzero(steps == 0))
    if repeated:
        first = timing.text(int(stamp_ns[order][int(np.argmax(steps == 0))]))
        count = f"{repeated} samples have" if repeated > 1 else "1 sample has"
        notes.append(f"{path}: {count} the time of the one before (kept as they are), first at {first}")
    rising = steps[steps > 0]
    if len(rising):
        least = max(_LEAST_GAP_NS, _LEAST_GAP_STEPS * float(np.median(rising)))
        gaps = np.flatnonzero(steps > least)
        if len(gaps):
            longest = int(gaps[np.argmax(steps[gaps])])
            at = timing.text(int(stamp_ns[order][longest]))
            count = f"{len(gaps)} gaps in its times, the longest" if len(gaps) > 1 else "a gap in its times"
            notes.append(f"{path}: {count} of {steps[longest] / NS_PER_S:,.3f} s after {at}")
    return tuple(notes), tuple(doubts)


def _unwrapped(angle: FloatArray) -> FloatArray:
    """Angles without the jumps of a full turn; NaN stays."""
    out = angle.copy()
    good = np.isfinite(angle)
    out[good] = np.unwrap(angle[good])
    return out


def _clipped(values: Mapping[str, FloatArray]) -> BoolArray | None:
    """Where an axis stands still at its own extreme for three samples or more, as at its range's end."""
    found: BoolArray | None = None
    for axis, column in values.items():
        least = {"linear_acceleration": 15.0, "angular_velocity": 2.0}.get(axis.split(".")[0])
        if least is None or not len(column):
            continue
        size = np.abs(column)
        top = np.nanmax(size) if np.isfinite(size).any() else 0.0
        at_end = (size == top) & (top >= least)
        three = at_end[:-2] & at_end[1:-1] & at_end[2:]
        flat = np.zeros(len(size), np.bool_)
        for shift in range(3):
            flat[shift : shift + len(three)] |= three
        found = flat if found is None else found | flat
    return found
