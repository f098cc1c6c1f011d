"""Measured positions on an even grid of frames, as C3D and TRC have them.

A recording has a stamp a frame, and frames may be missing. Here the true rate is found from the stamps, and each frame
takes the nearest place of the grid; a place that no frame takes has nothing on it. No position is changed or made up.
"""

import itertools
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.core.estimate import Status
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import SourceError, UsageError
from spheremcap.io import _pb
from spheremcap.io.chair import ChairPose, read_chairs
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import STATE, UNREADABLE, iter_columns, schema_names, track_name
from spheremcap.io.selection import Selection

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

OFF_GRID = 0.1
"""Of a frame: stamps that lie further off the grid than this are said."""

_MEASURED = [status.value for status in Status if status.measured]


@dataclass(frozen=True)
class Axes:
    """Where x, y and z of a file point: `text` in words, the axes that go right and up on a screen, and what takes
    positions (N, 3) in the camera's optical frame, in metres, to them.
    """

    text: str
    right: str
    up: str
    of_camera: Callable[[FloatArray], FloatArray]


OPTICAL = Axes("the camera's optical frame: x right, y down, z forward", "+X", "-Y", lambda xyz_cam_m: xyz_cam_m)


def chair_axes(chair: ChairPose) -> Axes:
    """Those of the chair, seen from its right side."""
    up = "z up" if chair.upright else "z up as far as is known"
    text = f"the chair's frame: x forward, y to the athlete's left, {up}, origin midway between the hubs"
    return Axes(text, "+X", "+Z", chair.place)


@dataclass(frozen=True)
class EvenPoints:
    """M markers on N places of an even grid.

    `stamp_ns` (N,) is the stamp of the frame on each place, -1 where the recording has no frame there. `xyz_m`
    (N, M, 3) is measured where `sd_m` (N, M) is a number, the square root of the covariance's trace; filled from the
    smoothed positions where `filled` (N, M); NaN elsewhere. `notes` are for the user.
    """

    markers: tuple[str, ...]
    axes: Axes
    start_ns: int
    period_ns: float
    stamp_ns: IntArray
    xyz_m: FloatArray
    sd_m: FloatArray
    filled: BoolArray
    notes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def rate_hz(self) -> float:
        """Of the grid."""
        return NS_PER_S / self.period_ns

    @property
    def end_ns(self) -> int:
        """Where the place after the last one would be."""
        return self.start_ns + round(len(self) * self.period_ns)

    @property
    def measured(self) -> BoolArray:
        """(N, M)."""
        return np.isfinite(self.sd_m)


def read_points(
    records: McapRecords,
    chosen: Selection,
    *,
    fill_ms: float | None = None,
    most_frames: int | None = None,
) -> EvenPoints:
    """The chosen markers in the chosen time, gaps of at most `fill_ms` filled; in the chair's frame where the recording
    says where that is, else in the camera's.

    Raises SourceError when there is nothing measured in metres, UsageError when there are more than `most_frames`, or
    markers of several cameras, each in a frame of its own.
    """
    found, seen = _rows(records, chosen, fill_ms is not None, most_frames)
    if not seen:
        raise no_markers(records)
    stamps = np.unique(found.stamp_ns)
    if len(stamps) < 2:
        chosen.check(seen, records.path)
        raise SourceError(f"{records.path}: {len(stamps)} frames in this time: two are needed for a rate")
    grid = even_grid(stamps)
    count = int(grid.place[-1]) + 1
    if most_frames is not None and count > most_frames:
        raise UsageError(
            f"{records.path}: a C3D holds {most_frames} frames, {most_frames * grid.period_ns / NS_PER_S:.0f} s at "
            f"{grid.rate_hz:.3f} Hz, and this is longer: write it in pieces with --from and --to"
        )
    chosen.check(seen, records.path)  # only now: of what is too long not all is read
    names = tuple(sorted({name for name in seen if not chosen.markers or name in chosen.markers}))
    cameras = sorted({name.rpartition("/")[0] for name in names})
    if len(cameras) > 1:
        raise UsageError(
            f"{records.path}: markers of {len(cameras)} cameras, each in a frame of its own: choose those of one with "
            f"--marker; there are: {', '.join(names)}"
        )
    chair = _chair(records, names)
    axes = OPTICAL if chair is None else chair_axes(chair)
    kept, left_out = _nearest(grid)
    stamp_ns = np.full(count, -1, np.int64)
    stamp_ns[grid.place[kept]] = stamps[kept]
    rows = np.flatnonzero(np.isin(found.stamp_ns, stamps[kept]))[::-1]  # of two at the same time the first one stays
    column = np.array([names.index(name) if name in names else -1 for name in seen])
    at = grid.place[np.searchsorted(stamps, found.stamp_ns[rows])], column[found.marker[rows]]
    xyz_m, sd_m = (np.full((count, len(names), *shape), np.nan) for shape in ((3,), ()))
    xyz_m[at], sd_m[at] = axes.of_camera(found.xyz_cam_m[rows]), found.sd_m[rows]
    taken = np.zeros(sd_m.shape, np.bool_)
    taken[at] = True
    repeated = len(rows) - np.count_nonzero(taken)
    if not np.isfinite(sd_m).any():
        raise SourceError(
            f"{records.path}: nothing measured in metres here: `spheremcap track` needs a --camera for it"
        )
    filled = np.zeros((count, len(names)), np.bool_)
    if fill_ms is not None:
        smoothed = np.full(xyz_m.shape, np.nan)
        smoothed[at] = axes.of_camera(found.smoothed_xyz_cam_m[rows])
        within = int(fill_ms * 1e6 / grid.period_ns + 1e-6)
        filled = np.stack([_in_gaps(np.isfinite(sd), within) for sd in sd_m.T], axis=1)
        filled &= np.isfinite(smoothed).all(axis=2)
        xyz_m[filled] = smoothed[filled]
    labels = tuple(name.rpartition("/")[2] for name in names)
    said = () if chair is None else (f"positions are in {axes.text}",)
    return EvenPoints(
        labels,
        axes,
        grid.start_ns,
        grid.period_ns,
        stamp_ns,
        xyz_m,
        sd_m,
        filled,
        (*said, *_notes(grid, left_out, int(repeated))),
    )


def _chair(records: McapRecords, markers: Collection[str]) -> ChairPose | None:
    """The chair in the frame that these markers' positions are in."""
    chairs = read_chairs(records)
    if not chairs:
        return None
    names = schema_names(records)
    for topic in sorted({c.topic for c in records.channels.values() if names[c.id] == STATE}):
        for raw in records.messages([topic]):
            try:
                state = _pb.MarkerState.FromString(raw.data)
            except UNREADABLE:
                continue
            if track_name(topic, state.marker) in markers and state.frame_id:
                return next((chair for chair in chairs if chair.parent_frame_id == state.frame_id), None)
            break
    return None


def no_markers(records: McapRecords) -> SourceError:
    """For a file in which nothing was tracked."""
    topics = ", ".join(sorted({c.topic for c in records.channels.values()})) or "none"
    return SourceError(f"{records.path}: has no markers of spheremcap in it; its topics: {topics}")


@dataclass(frozen=True)
class Grid:
    """Of each of N rising stamps the place on an even grid, and how far it lies off that (N,), in ns."""

    start_ns: int
    period_ns: float
    place: IntArray
    off_ns: FloatArray

    @property
    def rate_hz(self) -> float:
        """Places a second."""
        return NS_PER_S / self.period_ns


def even_grid(stamps: IntArray) -> Grid:
    """The grid that fits rising stamps (N,), two or more, best in the sense of least squares."""
    steps = np.diff(stamps)
    step = steps[steps <= 1.5 * np.median(steps)].mean()  # those between neighbours: stamps may be rounded
    count = np.concatenate([[0], np.cumsum(np.rint(steps / step))])
    since = (stamps - stamps[0]).astype(np.float64)
    period, start = np.polyfit(count, since, 1)
    place = np.rint((since - start) / period).astype(np.int64)
    start += place[0] * period
    place -= place[0]
    return Grid(int(stamps[0]) + round(start), float(period), place, since - start - place * period)


@dataclass(frozen=True)
class _Rows:
    """A row a marker and frame; `marker` is its number. Positions are NaN where not measured, and there are no smoothed
    ones where they are not wanted.
    """

    marker: npt.NDArray[np.int16]
    stamp_ns: IntArray
    xyz_cam_m: FloatArray
    sd_m: FloatArray
    smoothed_xyz_cam_m: FloatArray


def _rows(records: McapRecords, chosen: Selection, smoothed: bool, most_frames: int | None) -> tuple[_Rows, list[str]]:
    """The chosen rows, as far as more than `most_frames`; and the markers seen on the way, by their numbers."""
    numbers: dict[str, int] = {}
    parts: list[tuple[npt.NDArray[np.generic], ...]] = []
    frames, last_ns = 0, -1
    for columns in iter_columns(records, start_ns=chosen.start_ns, end_ns=chosen.end_ns):
        names, which = np.unique(columns["marker"], return_inverse=True)
        number = np.array([numbers.setdefault(name, len(numbers)) for name in names.tolist()], np.int16)
        rows = chosen.rows(columns["stamp_ns"], columns["marker"])
        stamps = columns["stamp_ns"][rows]
        xyz, sd, smooth = (
            np.stack([columns[name.format(axis)][rows] for axis in "xyz"], axis=1)
            for name in ("{}_cam_m", "{}_sd_m", "{}_smoothed_m")
        )
        xyz[~np.isin(columns["status"][rows], _MEASURED)] = np.nan
        sd = np.where(np.isfinite(xyz).all(axis=1), np.sqrt(np.square(sd).sum(axis=1)), np.nan)
        parts.append((number[which[rows]], stamps, xyz, sd, smooth if smoothed else xyz[:0]))
        if len(stamps):
            frames += len(np.unique(stamps[stamps > last_ns]))
            last_ns = int(stamps[-1])
        if most_frames is not None and frames > most_frames:
            break
    if not parts:
        none = np.zeros((0, 3))
        return _Rows(np.zeros(0, np.int16), np.zeros(0, np.int64), none, none[:, 0], none), []
    return _Rows(*map(np.concatenate, zip(*parts, strict=True))), list(numbers)  # type: ignore[arg-type]


def _nearest(grid: Grid) -> tuple[IntArray, int]:
    """The frames (indices) that keep their places, the nearest one each; and how many do not."""
    order = np.lexsort((np.abs(grid.off_ns), grid.place))
    first = np.concatenate([[True], np.diff(grid.place[order]) > 0])
    return np.sort(order[first]), int(np.count_nonzero(~first))


def _in_gaps(there: BoolArray, longest: int) -> BoolArray:
    """Which places (N,) lie between two that are there, in a gap of at most `longest`."""
    places = np.flatnonzero(there)
    inside = np.zeros(len(there), np.bool_)
    for before, after in itertools.pairwise(places.tolist()):
        if after - before - 1 <= longest:
            inside[before + 1 : after] = True
    return inside


def _notes(grid: Grid, left_out: int, repeated: int) -> tuple[str, ...]:
    notes = []
    rate = f"{grid.rate_hz:.3f} Hz"
    furthest = float(np.abs(grid.off_ns).max())
    if furthest > OFF_GRID * grid.period_ns:
        notes.append(
            f"times are not even: frames lie up to {furthest / 1e6:.2f} ms off a rate of {rate}; .csv and .parquet "
            "have each frame's own time"
        )
    if left_out:
        notes.append(f"{left_out} frames are left out: another one is nearer to their place at {rate}")
    if repeated:
        notes.append(f"{repeated} positions are left out: their marker has an earlier one at the same time")
    missing = int(grid.place[-1]) + 1 - (len(grid.place) - left_out)
    if missing:
        notes.append(f"{missing} frames are missing in the recording: nothing is there")
    return tuple(notes)
