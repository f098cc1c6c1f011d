"""The mean cycle: what an arm does from contact to contact, 0 to 100 %, with how much its cycles differ."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.analysis.findings import Findings
from spheremcap.core.time import NS_PER_S

FloatArray = npt.NDArray[np.float64]

PERCENT = np.arange(101)
SHOWN = ("speed_mps", "angle_deg", "gap_mm", "elbow_deg", "forearm_elevation_deg", "upper_arm_elevation_deg")
"""What of a spheremcap.ArmSample has a mean cycle."""
_LONGEST_GAP_S = 0.03
"""A cycle with a longer gap is left out of a mean."""
_FEWEST = 2


@dataclass(frozen=True)
class Band:
    """One quantity over the cycle: mean and standard deviation over the cycles at each of `PERCENT` (101,), how many
    cycles they are of, and where in the mean the release is, in percent."""

    side: str
    quantity: str
    cycles: int
    mean: FloatArray
    sd: FloatArray
    release_percent: float


def bands_of(found: Findings) -> list[Band]:
    """The mean cycles of both arms, of quantities that at least two whole cycles have."""
    bands = []
    stamp_s = (found.stamp_ns - found.stamp_ns[0]) / NS_PER_S
    for side, hand in found.hands.items():
        whole = [s for s in hand.strokes if s.cycle_s is not None and s.push_s is not None]
        starts = [(s.stamp_ns - int(found.stamp_ns[0])) / NS_PER_S for s in whole]
        releases = [100 * (s.push_s or 0.0) / (s.cycle_s or 1.0) for s in whole]
        curves = _curves(found, side)
        for quantity in SHOWN:
            if quantity not in curves:
                continue
            rows, at = [], []
            for stroke, start_s, release in zip(whole, starts, releases, strict=True):
                row = _resampled(stamp_s, curves[quantity], start_s, stroke.cycle_s or 0.0, quantity == "angle_deg")
                if row is not None:
                    rows.append(row)
                    at.append(release)
            if len(rows) >= _FEWEST:
                table = np.array(rows)
                bands.append(
                    Band(side, quantity, len(rows), table.mean(axis=0), table.std(axis=0, ddof=1), float(np.mean(at)))
                )
    return bands


def _curves(found: Findings, side: str) -> Mapping[str, npt.NDArray[np.floating]]:
    return {**found.arms[side].values, **found.about(side, slice(None))}


def _resampled(
    stamp_s: FloatArray, values: npt.NDArray[np.floating], start_s: float, cycle_s: float, turns: bool
) -> FloatArray | None:
    """A curve's values at 101 times of a cycle, between its frames; None where a gap is too long."""
    part = slice(int(np.searchsorted(stamp_s, start_s)) - 1, int(np.searchsorted(stamp_s, start_s + cycle_s)) + 1)
    if part.start < 0:
        return None
    t, y = stamp_s[part], values[part].astype(np.float64)
    seen = np.isfinite(y)
    t, y = t[seen], y[seen]
    at = start_s + cycle_s * PERCENT / 100
    if len(t) < 4 or t[0] > at[0] or t[-1] < at[-1] or np.diff(t).max() > _LONGEST_GAP_S:
        return None
    if turns:
        y = np.degrees(np.unwrap(np.radians(y)))
    return np.interp(at, t, y)
