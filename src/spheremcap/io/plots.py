"""A recording's tracks as pictures: positions, speed, votes and status over time, one figure a marker."""

import importlib
import os
from pathlib import Path
from typing import Any

import numpy as np

from spheremcap.core.status import Status
from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.errors import SourceError, UsageError
from spheremcap.io import recording
from spheremcap.io.layout import AXES_RGB
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.messages import STATUS_RGB
from spheremcap.io.output import make_folder, whole_file
from spheremcap.io.recording import Track
from spheremcap.io.selection import Selection

ENDINGS = ("png", "svg")
_SIZE_IN = (10, 8)
_ACCEPTED, _REJECTED = 4, 3


def write_plots(
    recording_path: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    wanted: Selection | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write FOLDER/MARKER.png and .svg for each marker that is wanted; returns them.

    Raises SourceError where there are no markers, UsageError where a marker is not there, there is nothing in the time
    that was asked for, a file exists or matplotlib is not installed, OutputError.
    """
    path, place = Path(recording_path), Path(folder)
    tracks = recording.open(path).tracks
    if not tracks:
        raise SourceError(f"{path}: has no markers of spheremcap in it")
    with McapRecords(path) as records:
        chosen = (wanted or Selection()).from_start_of(records)
    chosen.check(tracks, path)
    names = [name for name in tracks if not chosen.markers or name in chosen.markers]
    shown = {name: tracks[name].at(tracks[name].stamp_ns[chosen.rows(tracks[name].stamp_ns)], 0) for name in names}
    if not any(len(track) for track in shown.values()):
        raise UsageError(f"{path}: there is no frame in the time that was asked for")
    make_folder(place)
    written = []
    for name, track in shown.items():
        if len(track):
            figure = _figure(name, track)
            for ending in ENDINGS:
                out = place / f"{name.replace('/', '_')}.{ending}"
                with whole_file(out, [path], overwrite=overwrite) as part:
                    # No date in it: the same recording gives the same bytes.
                    figure.savefig(part.path, format=ending, metadata={"Date" if ending == "svg" else "Software": None})
                written.append(out)
    return written


def _figure(name: str, track: Track) -> Any:
    try:
        matplotlib = importlib.import_module("matplotlib")
        backend = importlib.import_module("matplotlib.backends.backend_agg")
        figure = importlib.import_module("matplotlib.figure").Figure(figsize=_SIZE_IN, layout="constrained")
    except ImportError:
        raise UsageError("plots need matplotlib: pip install 'spheremcap[report]'") from None
    matplotlib.rcParams["svg.hashsalt"] = "spheremcap"
    backend.FigureCanvasAgg(figure)
    place, speed, votes, status = figure.subplots(4, sharex=True, height_ratios=(3, 2, 2, 0.8))
    time_s = (track.stamp_ns - track.stamp_ns[0]) / NS_PER_S
    figure.suptitle(f"{name}, from {format_time(int(track.stamp_ns[0]))}")
    metric = bool(np.isfinite(track.xyz_cam_m).any())
    values, ends = (track.xyz_cam_m, "xyz") if metric else (track.circle_px, "xyr")
    measured = np.where(track.measured[:, None], values, np.nan)
    for column, (end, rgb) in enumerate(zip(ends, AXES_RGB.values(), strict=True)):
        if metric:
            place.plot(time_s, track.smoothed_xyz_cam_m[:, column], color=rgb, linewidth=0.8, alpha=0.6)
        place.plot(time_s, measured[:, column], ".", color=rgb, markersize=3, label=end)
    place.set_ylabel("in the camera's frame [m]" if metric else "on the picture [px]")
    place.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
    if metric:
        speed.plot(time_s, np.linalg.norm(track.velocity_cam_mps, axis=1), ".", markersize=3, color="0.6")
        speed.plot(time_s, np.linalg.norm(track.smoothed_velocity_cam_mps, axis=1), color="0.1", linewidth=1)
        speed.set_ylabel("speed [m/s]")
    else:
        seconds = np.where(np.diff(time_s) > 0, np.diff(time_s), np.nan)
        speed.plot(time_s[1:], np.linalg.norm(np.diff(measured[:, :2], axis=0), axis=1) / seconds, ".", markersize=3)
        speed.set_ylabel("speed [px/s]")
    votes.plot(time_s, track.vote_sum, ".", markersize=3, color="0.2")
    for limit, said in ((_ACCEPTED, "accepted"), (_REJECTED, "rejected")):
        votes.axhline(limit, color="0.6", linewidth=0.8)
        votes.annotate(said, (1.005, limit), xycoords=("axes fraction", "data"), color="0.4", va="center", fontsize=8)
    votes.set_ylim(-0.1, 6.2)
    votes.set_ylabel("votes of 6")
    for state in Status:
        there = track.status == state.value
        if there.any():
            status.vlines(time_s[there], 0, 1, color=STATUS_RGB[state], linewidth=1.5, label=state.value)
    status.set_yticks([])
    status.set_ylabel("status")
    status.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize=7, borderaxespad=0)
    status.set_xlabel("time [s]")
    return figure
