"""Recordings of simulated strokes, as `track` and `merge` would write them, without a picture."""

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from simulated import CAMERA, MOUNT, START_NS, Simulated

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, OperatorRequest, SmoothedPose, Status
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.time import NS_PER_S
from spheremcap.io import _pb
from spheremcap.io.mcap_log import McapLog, schema_id
from spheremcap.io.messages import time_fields

RADIUS_M = 0.02
NAMES = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in ("wrist", "elbow", "shoulder"))
ENCODER_HZ = 200
SETTINGS = {
    "wheel": {"radius_m": 0.35, "rim_radius_m": 0.18, "camber_deg": 11.0, "track_m": 0.6},
    "chair": {"camera_xyz_chair_m": MOUNT.xyz_chair_m, "camera_down_deg": float(np.degrees(MOUNT.down_rad))},
}


def write_strokes(
    path: Path,
    made: Simulated,
    names: Collection[str] = NAMES,
    *,
    wheels: Mapping[str, str] | None = None,
    gaps: Mapping[str, slice] | None = None,
    camera: Camera | None = CAMERA,
    requests: int = 0,
) -> Path:
    """`wheels` are the sensors' names with what they measure: angle_rad, rate_rad_s or neither; `gaps` are LOST."""
    tracks = {name: made.in_camera(*name.split("_"), gap=(gaps or {}).get(name)) for name in names}
    stamps = START_NS + np.rint(made.t_s * NS_PER_S).astype(np.int64)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=200_000)
        writer.start()
        with McapLog(writer, camera=camera, markers=[MarkerSpec(name, 2 * RADIUS_M) for name in names]) as log:
            for index, stamp_ns in enumerate(stamps.tolist()):
                estimates = tuple(_estimate(track, index, stamp_ns, camera) for track in tracks.values())
                smoothed = tuple(
                    SmoothedPose(e.marker, index, stamp_ns, e.xyz_cam_m, e.covariance_m2, np.zeros(3))
                    for e in estimates
                    if e.xyz_cam_m is not None and e.covariance_m2 is not None
                )
                asked = tuple(
                    OperatorRequest(estimates[0].marker, index, stamp_ns, index, stamp_ns, "lost", ("gate",))
                    for _ in range(index < requests)
                )
                log.write(FrameResult(index, stamp_ns, estimates, smoothed, asked), None)
        for name, quantity in (wheels or {}).items():
            channel = writer.register_channel(f"/sensors/{name}", "protobuf", schema_id(writer, _pb.WheelSample))
            t = np.arange(-0.05, made.t_s[-1] + 0.05, 1 / ENCODER_HZ)
            values = {"angle_rad": made.motion.turned_rad(t), "rate_rad_s": made.motion.rate_rad_s(t)}
            for k, (at_s, value) in enumerate(zip(t, values.get(quantity, 0 * t), strict=True)):
                stamp_ns = START_NS + round(at_s * NS_PER_S)
                fields = {quantity: float(value)} if quantity in values else {}
                sample = _pb.WheelSample(timestamp=time_fields(stamp_ns), **fields)
                writer.add_message(channel, stamp_ns, sample.SerializeToString(), stamp_ns, k)
        writer.add_metadata("about", {"somebody": "else"})
        writer.add_attachment(1, 2, "notes.txt", "text/plain", b"x")
        writer.finish()
    return path


def _estimate(track, index, stamp_ns, camera):
    if not track.measured[index]:
        return MarkerEstimate(track.marker, index, stamp_ns, Status.LOST)
    metric = {}
    if camera is not None:
        xyz = track.xyz_m[index].astype(np.float64)
        # A run's covariance has what the focal length's own uncertainty makes of each position
        covariance = track.covariance(slice(index, index + 1))[0] + camera.focal_sd**2 * np.outer(xyz, xyz)
        metric = {"xyz_cam_m": xyz, "covariance_m2": covariance}
    return MarkerEstimate(track.marker, index, stamp_ns, Status.VERIFIED, Circle(640, 360, 20), **metric)
