"""TRC, as OpenSim reads it: text with tabs, three columns a marker, blank cells where nothing was measured."""

from pathlib import Path

import numpy as np

from spheremcap.core.time import NS_PER_S
from spheremcap.io.export.even import EvenPoints

_KEYS = (
    "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames",
)  # fmt: skip


def write(path: Path, points: EvenPoints, name: str) -> tuple[str, ...]:
    """Write `points` in mm under the `name` that goes into the first line; notes name what is blank.

    Time is that of each frame's own stamp, from the first one on. A tab ends every line, as in OpenSim's own files:
    without it a row whose last cells are blank has too few for OpenSim.
    """
    rate, count = f"{points.rate_hz:.6f}", len(points)
    values = (rate, rate, count, len(points.markers), "mm", rate, 1, count)
    coordinates = [f"{axis}{k + 1}" for k in range(len(points.markers)) for axis in "XYZ"]
    on_grid = points.start_ns + points.period_ns * np.arange(count)
    stamps = np.where(points.stamp_ns < 0, on_grid.astype(np.int64), points.stamp_ns)
    seconds = (stamps - stamps[0]) / NS_PER_S
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"PathFileType\t4\t(X/Y/Z)\t{name}\n")
        file.write("\t".join(_KEYS) + "\n" + "\t".join(map(str, values)) + "\n")
        file.write("Frame#\tTime\t" + "".join(f"{marker}\t\t\t" for marker in points.markers) + "\n")
        file.write("\t\t" + "\t".join(coordinates) + "\t\n\n")
        for k, (time, xyz) in enumerate(zip(seconds.tolist(), points.xyz_m, strict=True)):
            cells = "\t".join("" if mm != mm else f"{mm:.4f}" for mm in (1000 * xyz).ravel().tolist())
            file.write(f"{k + 1}\t{time:.6f}\t{cells}\t\n")
    return tuple(_blank(points, k) for k in range(len(points.markers)) if np.isnan(points.sd_m[:, k]).any())


def _blank(points: EvenPoints, k: int) -> str:
    blank = np.isnan(points.sd_m[:, k])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], blank, [False]]).astype(np.int8)))
    longest = int((edges[1::2] - edges[::2]).max())
    return (
        f"{points.markers[k]}: {np.count_nonzero(blank)} of {len(points)} frames are blank, the longest gap has "
        f"{longest} frames ({longest * points.period_ns / 1e6:.1f} ms)"
    )
