"""What analysing half an hour costs: `spheremcap analyse` on a recording of 432,000 frames of a racer's strokes.

usage: python benchmarks/analyse.py [--seconds 1800] [--markers 6] [--keep FOLDER]

The markers' positions are simulated (rendered strokes without pictures, 3 mm of noise along the line of sight) and
written as `track` writes states; a wheel's log at 200 Hz lies beside them. The command is a process of its own, its
memory is read from the system while it runs; the compiled loops are there already.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from spheremcap.io import _pb
from spheremcap.io.mcap_log import schema_id
from spheremcap.io.messages import calibration, time_fields
from spheremcap.io.output import open_output
from spheremcap.synth.kinematics import JOINTS
from spheremcap.synth.ride import Ride
from spheremcap.synth.stroke_scenarios import CAMERA
from spheremcap.synth.strokes import Manner, Mount, motion

STEP_NS = 1001 * 10**9 // 240_000
BLOCK = 2400


def make(folder: Path, seconds: float, markers: int) -> Path:
    """The recording; analysis.toml is written beside it."""
    rng = np.random.default_rng(0)
    moved, mount = motion(Manner(), seconds, rng), Mount()
    ride = Ride(moved, mount, CAMERA, seconds)
    (folder / "analysis.toml").write_text(ride.files()["analysis.toml"])
    out = folder / "long.mcap"
    frames = int(seconds * 1e9) // STEP_NS
    verified = _pb.MarkerState.Status.Value("VERIFIED")
    with open_output(out, [], overwrite=True) as writer:
        states = schema_id(writer, _pb.MarkerState)
        channels = {
            name: writer.register_channel(f"/markers/{name}/state", "protobuf", states) for name in JOINTS[:markers]
        }
        wheel = writer.register_channel("/sensors/wheel", "protobuf", schema_id(writer, _pb.WheelSample))
        first = calibration(0, CAMERA, "camera_optical")
        camera = writer.register_channel("/camera/calibration", "protobuf", schema_id(writer, type(first)))
        writer.add_message(camera, 0, first.SerializeToString(), 0, 0)
        for start in range(0, frames, BLOCK):
            index = np.arange(start, min(start + BLOCK, frames))
            stamps, t = index * STEP_NS, index * (STEP_NS / 1e9)
            rows: list[tuple[int, int, bytes]] = []
            for name, channel in channels.items():
                side, _, joint = name.partition("_")
                xyz = mount.to_camera((moved.left if side == "left" else moved.right).joint(joint)(t))
                ray = xyz / np.linalg.norm(xyz, axis=1, keepdims=True)
                cov = 1.5e-4**2 * np.eye(3) + (3e-3**2 - 1.5e-4**2) * ray[:, :, None] * ray[:, None, :]
                xyz = xyz + np.einsum("nij,nj->ni", np.linalg.cholesky(cov), rng.standard_normal(xyz.shape))
                pixels = CAMERA.project(xyz)
                for k, stamp, p, c, q in zip(
                    index.tolist(),
                    stamps.tolist(),
                    xyz.tolist(),
                    cov.reshape(-1, 9).tolist(),
                    pixels.tolist(),
                    strict=True,
                ):
                    state = _pb.MarkerState(
                        timestamp=time_fields(stamp), marker=name, frame_index=k, status=verified,
                        circle={"x_px": q[0], "y_px": q[1], "r_px": 15.0},
                        position={"x": p[0], "y": p[1], "z": p[2]}, covariance=c,
                    )  # fmt: skip
                    rows.append((stamp, channel, state.SerializeToString()))
            at = np.arange(int(t[0] * 200), int((t[-1] + STEP_NS / 1e9) * 200)) / 200
            for s, angle in zip(at.tolist(), moved.turned_rad(at).tolist(), strict=True):
                stamp = round(s * 1e9)
                sample = _pb.WheelSample(timestamp=time_fields(stamp), angle_rad=angle)
                rows.append((stamp, wheel, sample.SerializeToString()))
            for stamp, channel, data in sorted(rows, key=lambda row: row[0]):
                writer.add_message(channel, stamp, data, stamp, 0)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=1800.0)
    parser.add_argument("--markers", type=int, default=6)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        recording = folder / "long.mcap"
        if not recording.exists():
            recording = make(folder, given.seconds, given.markers)
        size_mb = recording.stat().st_size / 1e6
        command = [
            sys.executable, "-m", "spheremcap", "analyse", str(recording), "-o", str(folder / "analysed.mcap"),
            "--settings", str(folder / "analysis.toml"), "--overwrite", "--no-layout",
        ]  # fmt: skip
        started, peak_kb = time.monotonic(), 0
        with subprocess.Popen(command) as running:
            while running.poll() is None:
                peak_kb = max(peak_kb, resident_kb(running.pid))
                time.sleep(0.05)
        spent = time.monotonic() - started
        print(
            f"{given.markers} markers, {size_mb:.0f} MB: {spent:.1f} s, {peak_kb / 1e3:.0f} MB at most, "
            f"exit {running.returncode}"
        )


def resident_kb(pid: int) -> int:
    """What a process has in memory, at most since its start; 0 once it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)


if __name__ == "__main__":
    main()
