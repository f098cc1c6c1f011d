"""The job: the focal length of a recording's camera from its own limbs, written as a camera."""

import os
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from spheremcap.analysis.focal import Focal, Pair, focal_of
from spheremcap.analysis.settings import SIDES, AnalysisSettings
from spheremcap.analysis.smoother import unpacked
from spheremcap.core.camera import Camera
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.calibration import write_camera_info
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import checked_output, whole_file
from spheremcap.io.poses import Poses, read_poses, without_focal
from spheremcap.io.recording import damage_line, first_camera, runs_of

_LIMB = ("wrist", "elbow", "shoulder")
_FEWEST = 200
_USUAL_RADIUS_M = 0.02


@dataclass(frozen=True)
class FocalReport:
    """What came of it: the camera that was written, the pairs by name, the fit, and what was lost of the recording."""

    camera: Camera
    pairs: tuple[str, ...]
    focal: Focal
    lost: tuple[str, ...]


def calibrate_recording(
    recording: str | os.PathLike[str], output: str | os.PathLike[str], settings: AnalysisSettings | None = None,
    *, overwrite: bool = False,
) -> FocalReport:  # fmt: skip
    """Write the camera of a tracked recording with the focal length under which forearms and upper arms keep their
    lengths, as camera_info YAML.

    Markers are joints by their names or as the settings say. Raises SourceError where there are no such pairs or their
    motion does not tell enough: what was found, what is expected, what to film; UsageError, OutputError.
    """
    path, out = Path(recording), Path(output)
    if out.suffix.lower() not in (".yaml", ".yml"):
        raise UsageError(f"{out}: a camera is written as .yaml")
    checked_output(out, [path], overwrite=overwrite)
    with McapRecords(path) as records:
        camera, poses = first_camera(records), read_poses(records)
        radii = _radii(records)
        damage = damage_line(records)
    if camera is None or not any(some.measured.any() for some in poses.values()):
        raise SourceError(
            f"{path}: has no camera, so no positions: track it with --camera, a preset or a guess will do"
        )
    pairs = _pairs(poses, radii, camera, settings or AnalysisSettings())
    if not pairs:
        raise SourceError(
            f"{path}: no two markers of one arm are measured together on {_FEWEST} frames: expected left_wrist and "
            f"left_elbow, or the like; there are: {', '.join(poses)}"
        )
    found = focal_of(pairs, camera)
    if found.refused:
        raise SourceError(f"{path}: {found.refused}")
    written = replace(
        camera, fx_px=camera.fx_px * found.factor, fy_px=camera.fy_px * found.factor,
        focal_sd=found.sd / found.factor, source=path.name,
    )  # fmt: skip
    with whole_file(out, [path], overwrite=overwrite) as part:
        write_camera_info(part.path, written)
    return FocalReport(written, tuple(pair.name for pair in pairs), found, () if damage is None else (damage,))


def _radii(records: McapRecords) -> dict[str, float]:
    """The markers' radii in metres, as the runs say."""
    found = {}
    for facts in runs_of(records).values():
        for fact, value in facts.items():
            if fact.startswith("marker.") and fact.endswith(".diameter_m"):
                found[fact.split(".")[1]] = float(value) / 2
    return found


def _pairs(
    poses: dict[str, Poses], radii: dict[str, float], camera: Camera, settings: AnalysisSettings
) -> list[Pair]:  # fmt: skip
    """Forearms and upper arms, as far as both their markers are measured."""
    names, pairs = tuple(poses), []
    for side in SIDES:
        for low, high in pairwise(_LIMB):
            ends = [settings.marker_of(side, joint, names) for joint in (low, high)]
            if ends[0] is None or ends[1] is None:
                continue
            first, last = poses[ends[0]], poses[ends[1]]
            _, i, j = np.intersect1d(first.stamp_ns, last.stamp_ns, return_indices=True)
            both = first.measured[i] & last.measured[j]
            i, j = i[both], j[both]
            if len(i) < _FEWEST:
                continue
            pairs.append(
                Pair(
                    f"{ends[0]} to {ends[1]}", (first.stamp_ns[i] - first.stamp_ns[0]) / NS_PER_S,
                    first.xyz_cam_m[i].astype(np.float64), last.xyz_cam_m[j].astype(np.float64),
                    unpacked(without_focal(first, camera.focal_sd)[i]),
                    unpacked(without_focal(last, camera.focal_sd)[j]),
                    (radii.get(ends[0], _USUAL_RADIUS_M), radii.get(ends[1], _USUAL_RADIUS_M)),
                )
            )  # fmt: skip
    return pairs
