"""Read a recording into NumPy arrays: `python read_back.py session.mcap`."""

import sys

import numpy as np

from spheremcap.io import recording


def main(path: str) -> None:
    session = recording.open(path)
    if session.damage:
        print(session.damage, file=sys.stderr)
    for name, track in session.tracks.items():
        seconds = (track.stamp_ns - track.stamp_ns[0]) / 1e9
        seen = track.measured
        print(f"{name}: {len(track)} frames in {seconds[-1]:.2f} s, {np.count_nonzero(seen)} measured")
        if np.count_nonzero(seen) > 1:
            steps = np.linalg.norm(np.diff(track.xyz_cam_m[seen], axis=0), axis=1)
            print(f"  path {steps.sum():.3f} m, largest step {steps.max() * 1000:.1f} mm")
        # The same marker on another clock's stamps: NaN where there is no frame within 3 ms.
        every_10_ms = np.arange(track.stamp_ns[0], track.stamp_ns[-1], 10_000_000)
        there = track.at(every_10_ms, tolerance_ns=3_000_000)
        print(f"  at 100 Hz: {np.count_nonzero(np.isfinite(there.vote_sum))} of {len(there)} rows have votes")
    for name, sensor in session.sensors.items():
        print(f"{name}: {len(sensor)} samples of {', '.join(sensor.values)}")
    for request in session.requests:
        print(f"where is {request.marker} on frame {request.frame_index}? ({request.reason})")


if __name__ == "__main__":
    main(sys.argv[1])
