"""Reads what is scored: truth tables, and tracks from a recording, a CSV or a Parquet file."""

import csv
import importlib
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.errors import SourceError, UsageError
from spheremcap.evaluation.metrics import Comparison, Score, TruthRow, compare, score, summary
from spheremcap.io import recording

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Scores:
    """The score of each marker, and `overall`, of all of them together."""

    markers: Mapping[str, Score]
    overall: Score
    comparisons: tuple[Comparison, ...] = ()


def read_truth(path: str | os.PathLike[str], marker: str = "") -> list[TruthRow]:
    """Truth from a CSV: that of a rendered session, or one made by hand.

    By hand: `frame,x,y,r` and optionally `err_px`, `marker` and `visible` (0..1); a row without x, y and r
    says that the marker is hidden on that frame. `marker` names the rows that do not. Frames count pictures
    as decoded, from 0; x, y and r are pixels. Raises SourceError.
    """
    rows = []
    for number, row in enumerate(_csv_rows(Path(path)), 2):
        try:
            rows.append(_truth_row(row, marker))
        except (KeyError, ValueError) as error:
            raise SourceError(
                f"{path}: line {number}: {error}; expected frame,x,y,r[,err_px] or a rendered truth.csv"
            ) from error
    if not rows:
        raise SourceError(f"{path}: has no rows")
    return rows


def _truth_row(row: Row, marker: str) -> TruthRow:
    rendered = "x_px" in row
    x, y, r = (_number(row[name]) for name in (("x_px", "y_px", "r_px") if rendered else ("x", "y", "r")))
    circle = Circle(x, y, r) if math.isfinite(x + y + r) else None
    xyz = [_number(row.get(f"{axis}_cam_m")) for axis in "xyz"]
    velocity = [_number(row.get(f"v{axis}")) for axis in "xyz"]
    visible = _number(row.get("visible"))
    return TruthRow(
        str(row.get("marker") or marker),
        int(row["frame"]),
        circle,
        np.array(xyz) if np.isfinite(xyz).all() else None,
        visible if math.isfinite(visible) else float(circle is not None),
        0.0 if rendered else max(0.0, _number(row.get("err_px") or 0)),
        np.array(velocity) if np.isfinite(velocity).all() else None,
    )


def read_tracks(path: str | os.PathLike[str]) -> tuple[list[MarkerEstimate], Mapping[str, int] | None]:
    """Estimates from an MCAP, or from a CSV or Parquet with the columns of `spheremcap export`, and
    requests.

    The requests are counted by marker; None when the file does not tell. A CSV needs marker, frame,
    stamp_ns, status, x_px, y_px, r_px; positions are taken where it has them. It holds no full covariance,
    so none is given. Raises SourceError or UsageError.
    """
    source = Path(path)
    readers: dict[str, Callable[[Path], Iterator[Row]]] = {".csv": _csv_rows, ".parquet": _parquet_rows}
    if source.suffix.lower() not in (*readers, ".mcap"):
        raise UsageError(
            f"{source}: tracks are read from .mcap, .csv or .parquet, not {source.suffix or 'no ending'!r}"
        )
    if source.suffix.lower() in readers:
        try:
            return [_estimate(row) for row in readers[source.suffix.lower()](source)], None
        except (KeyError, ValueError) as error:
            raise SourceError(
                f"{source}: {error}; expected the columns of `spheremcap export`: marker, frame, stamp_ns, "
                "status, x_px, y_px, r_px, ..."
            ) from error
    whole = recording.open(source)
    estimates = []
    for name, track in whole.tracks.items():
        for k in range(len(track)):
            if not track.status[k]:
                continue
            xyz, covariance = track.xyz_cam_m[k], track.covariance_m2[k]
            estimates.append(
                MarkerEstimate(
                    name,
                    int(track.frame[k]),
                    int(track.stamp_ns[k]),
                    Status(str(track.status[k])),
                    circle=_circle(track.circle_px[k]),
                    xyz_cam_m=xyz if np.isfinite(xyz).all() else None,
                    covariance_m2=covariance if np.isfinite(covariance).all() else None,
                )
            )
    return estimates, Counter(request.marker for request in whole.requests)


def _estimate(row: Row) -> MarkerEstimate:
    xyz = [_number(row.get(f"{axis}_cam_m")) for axis in "xyz"]
    return MarkerEstimate(
        str(row["marker"]), int(row["frame"]), int(row["stamp_ns"]), Status(str(row["status"])),
        circle=_circle([_number(row[f"{name}_px"]) for name in "xyr"]),
        xyz_cam_m=np.array(xyz) if np.isfinite(xyz).all() else None,
    )  # fmt: skip


def evaluate(
    tracks_path: str | os.PathLike[str], truth_path: str | os.PathLike[str], marker: str | None = None
) -> Scores:
    """Score a recording (.mcap) or exported table (.csv, .parquet) against a truth CSV.

    `marker` picks one of the tracks and says whose truth a hand-made table without names is; it need not be
    given when there is only one track. Raises SourceError or UsageError.
    """
    estimates, requests = read_tracks(tracks_path)
    names = list(dict.fromkeys(e.marker for e in estimates))
    if marker is not None and marker not in names:
        raise UsageError(f"{tracks_path}: has no marker {marker!r}; there are: {', '.join(names) or 'none'}")
    names = [marker] if marker is not None else names
    truth = read_truth(truth_path, names[0] if len(names) == 1 else "")
    told = list(dict.fromkeys(row.marker for row in truth))
    if told == [""]:
        raise UsageError(
            f"{truth_path} names no marker and the tracks have {', '.join(names)}: say which with --marker"
        )
    both = [name for name in told if name in names]
    if not both:
        raise UsageError(f"the truth is of {', '.join(told)}, the tracks of {', '.join(names) or 'none'}")
    return score_all(truth, estimates, both, requests)


def score_all(
    truth: Sequence[TruthRow],
    estimates: Sequence[MarkerEstimate],
    markers: Sequence[str],
    requests: Mapping[str, int] | None = None,
) -> Scores:
    """Scores of these markers; `requests` counts operator requests by marker."""
    comparisons = tuple(compare(truth, estimates, name) for name in markers)
    asked = {name: None if requests is None else requests.get(name, 0) for name in markers}
    total = None if requests is None else sum(n or 0 for n in asked.values())
    return Scores({c.marker: score([c], asked[c.marker]) for c in comparisons}, score(comparisons, total), comparisons)


def scores_table(scores: Scores) -> str:
    """The scores as text for a terminal: a few lines a marker, and all together when there are several."""
    parts = [summary(name, one) for name, one in scores.markers.items()]
    if len(parts) > 1:
        parts.append(summary("all markers", scores.overall))
    return "\n".join(parts)


def _csv_rows(path: Path) -> Iterator[Row]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            yield from csv.DictReader(file)
    except FileNotFoundError:
        raise SourceError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SourceError(f"{path}: cannot be read as CSV: {error}") from error


def _parquet_rows(path: Path) -> Iterator[Row]:
    try:
        parquet = importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise UsageError("Parquet needs pyarrow: pip install 'spheremcap[parquet]', or export .csv") from None
    try:
        yield from parquet.read_table(path).to_pylist()
    except FileNotFoundError:
        raise SourceError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise SourceError(f"{path}: cannot be read as Parquet: {error}") from error


def _number(value: Any) -> float:
    """A cell as a number; NaN for an empty one."""
    return math.nan if value is None or value == "" else float(value)


def _circle(xyr: Any) -> Circle | None:
    x, y, r = (float(v) for v in xyr)
    return Circle(x, y, r) if math.isfinite(x + y + r) else None
