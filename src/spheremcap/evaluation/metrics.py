"""How good a track is: estimates held against truth, row by row, and the numbers that sum it up.

Visible means that at least half of the marker's outline is seen, hidden that less than a twentieth is. A
seeded frame is a person's and counts in no error. Accuracy is eq 3.14, 100 * Dice (eq 3.8); a failure is the
thesis': no overlap while visible, but a marker that comes into view again may take `GRACE_FRAMES` to be
found.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.time import NS_PER_S

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

VISIBLE = 0.5
"""Least part of the outline that is seen for a marker to count as visible."""
HIDDEN = 0.05
"""A marker of which less than this is seen counts as hidden: nobody can have verified it."""
FALSE_DICE = 0.5
"""A verified circle that overlaps the truth by less than this is a false accept."""
GRACE_FRAMES = 3
"""Frames in which a marker that came into view again need not be found yet (issue 3's "within 3 frames")."""
CHI2_95_3DOF = 7.815
"""95 % quantile of the chi-squared distribution with 3 degrees of freedom."""


@dataclass(frozen=True, slots=True)
class TruthRow:
    """What is true of a marker on a frame. `circle` (pixels) is None when it is not known, as when it is
    hidden.

    `xyz_cam_m` (3,) metres and `velocity_cam_mps` (3,) in the optical frame, None when unknown; `visible` in
    [0, 1], the part of the outline's area that is seen; `err_px` how far the circle itself may be off (0 for
    rendered truth).
    """

    marker: str
    frame_index: int
    circle: Circle | None
    xyz_cam_m: FloatArray | None = None
    visible: float = 1.0
    err_px: float = 0.0
    velocity_cam_mps: FloatArray | None = None


@dataclass(frozen=True)
class Comparison:
    """One marker's truth and estimates side by side, (N,) each, by rising frame; NaN where there is no such
    value.

    Starts with the first estimate. `status` holds names of Status, "" where there was no estimate. `dice` is
    0..1. `centre_px` and `radius_px` are errors (estimate - truth; the centre's as a distance), `truth_r_px`
    the true radius. `position_m` is the 3D error's length, `range_m` the estimate's distance minus the
    truth's, `truth_range_m` the distance itself. `nees` is the normalised error squared, expected to be 3.
    """

    marker: str
    frame: npt.NDArray[np.int64]
    stamp_ns: npt.NDArray[np.int64]
    status: npt.NDArray[np.str_]
    visible: FloatArray
    dice: FloatArray
    centre_px: FloatArray
    radius_px: FloatArray
    truth_r_px: FloatArray
    position_m: FloatArray
    range_m: FloatArray
    truth_range_m: FloatArray
    nees: FloatArray

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, rows: BoolArray) -> "Comparison":
        """Only some of the rows, (N,) True where kept."""
        kept = {f.name: getattr(self, f.name)[rows] for f in fields(self) if f.name != "marker"}
        return replace(self, **kept)

    @property
    def measured(self) -> BoolArray:
        """(N,) whether the method measured the marker on this frame: VERIFIED. A person's seed does not
        count.
        """
        return np.asarray(self.status == Status.VERIFIED.value)

    @property
    def seeded(self) -> BoolArray:
        """(N,) whether a person gave the circle on this frame."""
        return np.asarray(self.status == Status.SEEDED.value)


def compare(truth: Iterable[TruthRow], estimates: Iterable[MarkerEstimate], marker: str) -> Comparison:
    """Hold one marker's estimates against its truth. Frames without truth are left out."""
    found = {e.frame_index: e for e in estimates if e.marker == marker}
    first = min(found, default=0)
    rows = sorted((t for t in truth if t.marker == marker and t.frame_index >= first), key=lambda t: t.frame_index)
    numbers = np.full((len(rows), 8), np.nan)
    for out, row in zip(numbers, rows, strict=True):
        estimate = found.get(row.frame_index)
        if row.circle is not None:
            out[3] = row.circle.r_px
            if estimate is not None and estimate.circle is not None:
                circle = estimate.circle
                out[:3] = circle.dice(row.circle), circle.distance(row.circle), circle.r_px - row.circle.r_px
        if row.xyz_cam_m is not None:
            out[6] = np.linalg.norm(row.xyz_cam_m)
            if estimate is not None and estimate.xyz_cam_m is not None:
                error = estimate.xyz_cam_m - row.xyz_cam_m
                out[4], out[5] = np.linalg.norm(error), np.linalg.norm(estimate.xyz_cam_m) - out[6]
                out[7] = _nees(error, estimate.covariance_m2)
    at = [found.get(row.frame_index) for row in rows]
    return Comparison(
        marker,
        np.array([row.frame_index for row in rows], np.int64),
        np.array([e.stamp_ns if e is not None else -1 for e in at], np.int64),
        np.array([e.status.value if e is not None else "" for e in at], np.str_),
        np.array([row.visible for row in rows], np.float64),
        *numbers.T,
    )


def _nees(error_m: FloatArray, covariance_m2: FloatArray | None) -> float:
    """e^T P^-1 e; NaN where there is no covariance or a singular one."""
    if covariance_m2 is None or not np.isfinite(covariance_m2).all():
        return math.nan
    try:
        return float(error_m @ np.linalg.solve(covariance_m2, error_m))
    except np.linalg.LinAlgError:
        return math.nan


@dataclass(frozen=True)
class Score:
    """The numbers of one row of a table; None where there is nothing to tell from.

    Errors are of VERIFIED frames. `false_accepts` are VERIFIED frames with Dice < 0.5 or a hidden marker;
    `missed_pct` of the visible frames were not measured; `failures` are those of `FailureWatch`, whether the
    runner seeded again after each or the method went on alone.
    """

    frames: int
    visible_frames: int
    measured_frames: int
    accuracy_pct: float | None
    """100 * mean Dice over measured frames."""
    accuracy_circle_pct: float | None
    """100 * mean Dice over all frames with a circle, measured or stood in for, where the truth has one."""
    accuracy_visible_pct: float | None
    """100 * mean Dice over all visible frames; one without a circle counts 0."""
    failures: int
    centre_median_px: float | None
    centre_mean_px: float | None
    centre_p95_px: float | None
    radius_mean_abs_px: float | None
    radius_bias_px: float | None
    radius_bias_pct: float | None
    position_mean_mm: float | None
    position_p95_mm: float | None
    position_mean_pct: float | None
    """Mean 3D error, % of the true distance."""
    range_bias_pct: float | None
    range_sd_pct: float | None
    false_accepts: int
    false_accepts_pct: float | None
    """% of all scored frames."""
    missed_pct: float | None
    reacquired: int
    """How often the marker came into view again and was measured before it left again."""
    never_reacquired: int
    reacquire_mean_frames: float | None
    reacquire_max_frames: int | None
    """Frames from the first visible one to the first measured with Dice >= 0.5; 0 is the same frame."""
    requests_per_min: float | None
    nees_mean: float | None
    """Expected 3; an honest covariance gives 1.5 to 6."""
    nees_within_95_pct: float | None
    """% of measured frames inside the 95 % ellipsoid."""
    status_pct: Mapping[str, float]


def score(comparisons: Sequence[Comparison], requests: int | None = None) -> Score:
    """Sum up one marker's comparison, or several markers' together; `requests` None: nobody counted them."""

    def joined(name: str) -> npt.NDArray[Any]:
        return np.concatenate([getattr(c, name) for c in comparisons]) if comparisons else np.zeros(0)

    status, visible, dice = joined("status"), joined("visible"), joined("dice")
    verified = status == Status.VERIFIED.value
    scored = status != Status.SEEDED.value
    seen = scored & (visible >= VISIBLE)
    wrong = verified & (~(dice >= FALSE_DICE) & np.isfinite(joined("truth_r_px")) | (visible < HIDDEN))
    known = verified & np.isfinite(joined("truth_r_px"))
    centre, radius = joined("centre_px")[known], joined("radius_px")[known]
    position, distance = joined("position_m")[verified], joined("truth_range_m")[verified]
    ranges = 100 * joined("range_m")[verified] / distance
    nees = joined("nees")[verified]
    nees = nees[np.isfinite(nees)]
    events = [event for c in comparisons for event in reacquisitions(c)]
    waits = [frames for _, frames in events if frames is not None]
    span_s = max((_span_s(c) for c in comparisons), default=0.0)
    return Score(
        frames=int(scored.sum()),
        visible_frames=int(seen.sum()),
        measured_frames=int(verified.sum()),
        accuracy_pct=_mean(100 * dice[known]),
        accuracy_circle_pct=_mean(100 * dice[scored & np.isfinite(dice)]),
        accuracy_visible_pct=_mean(100 * np.nan_to_num(dice[seen])),
        failures=sum(len(failure_frames(c)) for c in comparisons),
        centre_median_px=_quantile(centre, 0.5),
        centre_mean_px=_mean(centre),
        centre_p95_px=_quantile(centre, 0.95),
        radius_mean_abs_px=_mean(np.abs(radius)),
        radius_bias_px=_mean(radius),
        radius_bias_pct=_mean(100 * radius / joined("truth_r_px")[known]),
        position_mean_mm=_mean(1000 * position),
        position_p95_mm=_quantile(1000 * position, 0.95),
        position_mean_pct=_mean(100 * position / distance),
        range_bias_pct=_mean(ranges),
        range_sd_pct=_sd(ranges),
        false_accepts=int(wrong.sum()),
        false_accepts_pct=100 * float(wrong.sum()) / int(scored.sum()) if scored.any() else None,
        missed_pct=100 * float((seen & ~verified).sum()) / int(seen.sum()) if seen.any() else None,
        reacquired=len(waits),
        never_reacquired=len(events) - len(waits),
        reacquire_mean_frames=_mean(np.array(waits, np.float64)),
        reacquire_max_frames=max(waits) if waits else None,
        requests_per_min=60 * requests / span_s if requests is not None and span_s > 0 else None,
        nees_mean=_mean(nees),
        nees_within_95_pct=_mean(100.0 * (nees <= CHI2_95_3DOF)),
        status_pct={
            s.value: 100 * float((status == s.value).sum()) / len(status) for s in Status if (status == s.value).any()
        },
    )


class FailureWatch:
    """Says of each frame in order whether the method fails there: no overlap while visible.

    A stretch of such frames fails once, on its first. A marker that comes into view again has `GRACE_FRAMES`.
    """

    def __init__(self) -> None:
        self._came = -(10**9)  # the frame on which the marker last came into view after having been out of it
        self._out = self._failing = False

    def fails(self, frame_index: int, visible: float, dice: float) -> bool:
        """Whether a failure starts on this frame. `dice` is 0 or NaN where there is no overlap."""
        if visible < VISIBLE:
            self._out, self._failing = True, False
            return False
        if self._out:
            self._out, self._came = False, frame_index
        if dice > 0:
            self._failing = False
            return False
        if self._failing or frame_index < self._came + GRACE_FRAMES:
            return False
        self._failing = True
        return True


def failure_frames(comparison: Comparison) -> list[int]:
    """The first frame of every failure."""
    c, watch = comparison, FailureWatch()
    return [
        int(frame)
        for frame, visible, dice, seeded in zip(c.frame, c.visible, c.dice, c.seeded, strict=True)
        if watch.fails(int(frame), float(visible), 1.0 if seeded else float(dice))
    ]


def reacquisitions(comparison: Comparison) -> list[tuple[int, int | None]]:
    """(frame on which the marker came into view again, frames until it was measured or None) for each time.

    Only where it had been less than half visible and not measured just before; None when it went out of view
    again, or the video ended, before it was measured with Dice >= 0.5.
    """
    c = comparison
    right = c.measured & (c.dice >= FALSE_DICE)
    events: list[tuple[int, int | None]] = []
    for k in range(1, len(c)):
        if not (c.visible[k] >= VISIBLE and c.visible[k - 1] < VISIBLE) or right[k - 1]:
            continue
        wait: int | None = None
        for j in range(k, len(c)):
            if right[j]:
                wait = int(c.frame[j] - c.frame[k])
            if right[j] or c.visible[j] < VISIBLE or c.seeded[j]:
                break
        events.append((int(c.frame[k]), wait))
    return events


def false_accept_frames(comparison: Comparison) -> list[int]:
    """Frames that are VERIFIED with Dice < 0.5 or with the marker hidden."""
    c = comparison
    known = np.isfinite(c.truth_r_px)
    wrong = c.measured & ((known & ~(c.dice >= FALSE_DICE)) | (c.visible < HIDDEN))
    return [int(f) for f in c.frame[wrong]]


def missed_frames(comparison: Comparison) -> list[int]:
    """Frames on which the marker was visible and not measured."""
    c = comparison
    return [int(f) for f in c.frame[(c.visible >= VISIBLE) & ~c.measured & ~c.seeded]]


def stretches(frames: Sequence[int]) -> str:
    """`12-15, 40`: rising frame numbers for a person."""
    if not frames:
        return "-"
    breaks = [0] + [i + 1 for i, (a, b) in enumerate(pairwise(frames)) if b != a + 1] + [len(frames)]
    runs = [(frames[a], frames[b - 1]) for a, b in pairwise(breaks)]
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)


# --- tables ---

COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("frames", "frames", "d"),
    ("measured_frames", "measured", "d"),
    ("accuracy_pct", "accuracy %", ".2f"),
    ("accuracy_circle_pct", "with a circle %", ".2f"),
    ("accuracy_visible_pct", "of visible %", ".2f"),
    ("failures", "failures", "d"),
    ("centre_median_px", "centre median px", ".3f"),
    ("centre_mean_px", "mean px", ".3f"),
    ("centre_p95_px", "95 % px", ".3f"),
    ("radius_mean_abs_px", "radius px", ".3f"),
    ("radius_bias_px", "radius bias px", "+.3f"),
    ("radius_bias_pct", "radius bias %", "+.3f"),
    ("position_mean_mm", "3D mm", ".2f"),
    ("position_mean_pct", "3D % of range", ".3f"),
    ("range_bias_pct", "range bias %", "+.3f"),
    ("range_sd_pct", "range sd %", ".3f"),
    ("false_accepts", "false accepts", "d"),
    ("missed_pct", "missed %", ".2f"),
    ("reacquired", "came back", "d"),
    ("never_reacquired", "not found again", "d"),
    ("reacquire_max_frames", "found after, most", "d"),
    ("requests_per_min", "requests/min", ".1f"),
    ("nees_mean", "NEES (3)", ".2f"),
    ("nees_within_95_pct", "in 95 % ellipsoid %", ".1f"),
)
"""(field of Score, heading, format)."""


def table_cells(rows: Mapping[str, Score], columns: Sequence[str]) -> list[list[str]]:
    """Scores as rows of cells, "-" where there is no value; `columns` names fields of Score that `COLUMNS`
    has.
    """
    known = {field: (heading, form) for field, heading, form in COLUMNS}
    cells = [["", *(known[name][0] for name in columns)]]
    for name, row in rows.items():
        values = [getattr(row, column) for column in columns]
        forms = [known[column][1] for column in columns]
        cells.append([name, *("-" if v is None else format(v, f) for v, f in zip(values, forms, strict=True))])
    return cells


def table(rows: Mapping[str, Score], columns: Sequence[str] | None = None, markdown: bool = False) -> str:
    """Scores as a text or markdown table, one row each."""
    return layout(table_cells(rows, columns or [name for name, _, _ in COLUMNS]), markdown)


def layout(cells: Sequence[Sequence[str]], markdown: bool = False) -> str:
    """Rows of cells as aligned text or a markdown table; the first row is the heading."""
    widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
    lines = []
    for n, row in enumerate(cells):
        padded = [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
        lines.append("| " + " | ".join(padded) + " |" if markdown else "  ".join(padded).rstrip())
        if markdown and n == 0:
            lines.append("|" + "|".join(["---", *(["--:"] * (len(row) - 1))]) + "|")
    return "\n".join(lines)


def summary(name: str, row: Score) -> str:
    """One marker's score as a few lines for a person."""

    def told(value: float | None, form: str, unit: str = "") -> str:
        return "unknown" if value is None else f"{value:{form}}{unit}"

    statuses = ", ".join(f"{pct:.1f} % {status.lower()}" for status, pct in row.status_pct.items())
    accuracy = told(row.accuracy_pct, ".2f", " %")
    of_visible = told(row.accuracy_visible_pct, ".2f", " %")
    missed = told(row.missed_pct, ".2f", " %")
    median, p95 = told(row.centre_median_px, ".3f", " px"), told(row.centre_p95_px, ".3f", " px")
    bias_px, bias_pct = told(row.radius_bias_px, "+.3f", " px"), told(row.radius_bias_pct, "+.3f", " %")
    lines = [
        f"{name}: {row.frames} frames scored, visible on {row.visible_frames}, measured on "
        f"{row.measured_frames} ({statuses})",
        f"  accuracy {accuracy} measured, {of_visible} of all visible frames; failures {row.failures}; "
        f"false accepts {row.false_accepts}; missed {missed}",
        f"  centre error {median} median, {p95} for 95 %; radius bias {bias_px} ({bias_pct})",
    ]
    if row.position_mean_mm is not None:
        mean_mm, mean_pct = told(row.position_mean_mm, ".2f", " mm"), told(row.position_mean_pct, ".3f", " %")
        bias, sd = told(row.range_bias_pct, "+.3f", " %"), told(row.range_sd_pct, ".3f", " %")
        lines.append(f"  3D error {mean_mm} ({mean_pct} of range); distance bias {bias}, sd {sd}")
    if row.nees_mean is not None:
        inside = told(row.nees_within_95_pct, ".1f", " %")
        lines.append(f"  covariance: NEES {row.nees_mean:.2f} (honest: 3), {inside} inside the 95 % ellipsoid")
    came = row.reacquired + row.never_reacquired
    if came:
        most = told(row.reacquire_max_frames, "d", " frames")
        lines.append(f"  came into view again {came} times: found {row.reacquired} times, after at most {most}")
    if row.requests_per_min is not None:
        lines.append(f"  {row.requests_per_min:.1f} operator requests a minute")
    return "\n".join(lines)


def _span_s(comparison: Comparison) -> float:
    stamps = comparison.stamp_ns[comparison.stamp_ns >= 0]
    return float(stamps[-1] - stamps[0]) / NS_PER_S if len(stamps) > 1 else 0.0


def _mean(values: FloatArray) -> float | None:
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else None


def _sd(values: FloatArray) -> float | None:
    values = values[np.isfinite(values)]
    return float(values.std()) if len(values) else None


def _quantile(values: FloatArray, q: float) -> float | None:
    values = values[np.isfinite(values)]
    return float(np.quantile(values, q)) if len(values) else None
