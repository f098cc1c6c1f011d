"""Offset and drift from motion, against a simulated racer: real joint paths at a varying cadence, a marker
track with noise and exits, an accelerometer that turns, has bias, noise and an end to its range.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from spheremcap.merging.sync import (
    Sync,
    SyncConfig,
    SyncError,
    magnitude,
    residual_log,
    sync_marker,
    synchronise,
    track_speed,
)
from spheremcap.synth.kinematics import cadence_hz, chair_to_camera, joint_chair_m

FloatArray = npt.NDArray[np.float64]
EPOCH = 1_700_000_000_000_000_000
G = 9.80665


@dataclass
class Session:
    """A marker's track and an accelerometer beside it; `true_s` is when the samples really were taken."""

    stamp_ns: npt.NDArray[np.int64]
    xyz_m: FloatArray
    imu_stamp_ns: npt.NDArray[np.int64]
    force: FloatArray
    true_s: FloatArray

    def sync(self, **options: object) -> Sync:
        values = {f"linear_acceleration.{axis}": self.force[:, k] for k, axis in enumerate("xyz")}
        saturated = (np.abs(self.force) >= 15.99 * G).any(axis=1)
        return sync_marker(
            self.stamp_ns, self.xyz_m, self.imu_stamp_ns, values, saturated=saturated, **options,  # type: ignore[arg-type]
        )  # fmt: skip

    def errors_ms(self, sync: Sync) -> FloatArray:
        """(2,) at the sensor's first and last sample."""
        ends = sync.clock.all(self.imu_stamp_ns[[0, -1]].tolist()) - EPOCH
        return np.asarray(ends / 1e6 - self.true_s[[0, -1]] * 1e3, np.float64)


def smooth_noise(rng: np.random.Generator, count: int, sigma: float) -> FloatArray:
    walk = gaussian_filter1d(rng.normal(size=count), sigma)
    return np.asarray(walk / walk.std(), np.float64)


def session(
    seconds: float,
    *,
    seed: int = 0,
    offset_s: float = 7.3,
    drift_ppm: float = 20.0,
    fps: float = 240.0,
    imu_hz: float = 200.0,
    varying: float = 0.06,
    surge: float = 0.0,
    motion: float = 1.0,
) -> Session:
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds + 40, 0.01) - 20
    phase = CubicSpline(t, np.cumsum(1 + varying * smooth_noise(rng, len(t), 80)) * 0.01)
    size = CubicSpline(t[::100], 1 + varying * smooth_noise(rng, len(t[::100]), 3))

    def path(at: FloatArray) -> FloatArray:
        out: FloatArray = motion * joint_chair_m("right_wrist", phase(at)) * size(at)[:, None]
        return out

    frames = np.arange(int(seconds * fps)) / fps
    xyz = chair_to_camera(path(frames)) + rng.normal(size=(len(frames), 3)) * (0.0005, 0.0005, 0.003)
    xyz[(phase(frames) * cadence_hz()) % 1 < 0.16] = np.nan  # out of the picture in every cycle
    xyz[rng.random(len(frames)) < 0.02] = np.nan

    own = np.arange(int(seconds * imu_hz)) / imu_hz
    true = own * (1 + drift_ppm * 1e-6) + offset_s - 5
    h = 0.002
    force = (path(true + h) - 2 * path(true) + path(true - h)) / h**2 + (0, 0, G)
    push = 2 * np.pi * cadence_hz() * phase(true)
    force += np.outer(np.sin(push), (surge, 0, 0))
    turn = 1.5 * np.stack([np.sin(1.3 * true), np.cos(0.7 * true), np.sin(push)], axis=1)
    force = Rotation.from_rotvec(turn).inv().apply(force)
    force += np.array([0.3, -0.3, 0.15]) + 0.1 * rng.normal(size=force.shape)
    stamps = EPOCH + np.rint(frames * 1e9).astype(np.int64)
    own_stamps = EPOCH + np.rint((own - 5) * 1e9).astype(np.int64)
    return Session(stamps, xyz, own_stamps, force.clip(-16 * G, 16 * G), true)


@pytest.mark.parametrize(
    ("offset_s", "drift_ppm", "seed"),
    [(7.3, 20.0, 0), pytest.param(-9.7, -20.0, 1, marks=pytest.mark.slow)],
)
def test_ten_minutes_to_a_millisecond_at_both_ends(offset_s: float, drift_ppm: float, seed: int) -> None:
    made = session(600, seed=seed, offset_s=offset_s, drift_ppm=drift_ppm)
    sync = made.sync()
    assert np.abs(made.errors_ms(sync)).max() < 0.6
    assert abs(sync.drift_ppm - drift_ppm) < 0.3
    assert sync.agreed.mean() > 0.9
    assert sync.residual_s < 0.0005
    assert f"{sync.offset_s * 1e3:+.3f} ms" in sync.line()


@pytest.mark.parametrize(
    "how",
    [
        pytest.param({"surge": 3.0}, id="chair that surges with the pushes"),
        pytest.param({"fps": 60.0, "imu_hz": 60.0}, id="60 fps and 60 Hz"),
        pytest.param({"imu_hz": 800.0}, id="800 Hz"),
        pytest.param({"drift_ppm": 200.0}, id="200 ppm"),
        pytest.param({"motion": 0.4}, id="gentle motion"),
    ],
)
def test_a_minute_of_other_kinds(how: dict[str, float]) -> None:
    made = session(60, seed=5, **how)
    sync = made.sync()
    assert np.abs(made.errors_ms(sync)).max() < 1.0


def test_a_guess_takes_the_large_part_of_the_offset() -> None:
    made = session(60, seed=3)
    made.imu_stamp_ns -= EPOCH - 10**9  # a sensor that counts from zero
    sync = made.sync(guess_ns=EPOCH - 10**9)
    assert np.abs(made.errors_ms(sync)).max() < 1.0
    assert abs(sync.offset_s - 7.3) < 0.001


def test_strictly_periodic_motion_is_refused() -> None:
    with pytest.raises(SyncError, match="no lag stands out"):
        session(90, varying=0.0).sync()


@pytest.mark.parametrize("seed", range(20, 24))
def test_somebody_elses_sensor_is_refused(seed: int) -> None:
    made, other = session(40, seed=seed), session(40, seed=seed + 100)
    made.force = other.force
    with pytest.raises(SyncError):
        made.sync()


def test_what_is_missing_is_named() -> None:
    made = session(30, seed=4)
    with pytest.raises(SyncError, match="neither acceleration, rate nor angle, only temperature_c"):
        sync_marker(made.stamp_ns, made.xyz_m, made.imu_stamp_ns, {"temperature_c": made.true_s})
    track = made.xyz_m
    made.xyz_m = np.full_like(track, np.nan)
    with pytest.raises(SyncError, match="only 0 measured positions"):
        made.sync()
    made.xyz_m = track
    made.imu_stamp_ns += 10**12
    with pytest.raises(SyncError, match="do not overlap"):
        made.sync()


def test_a_wheel_against_the_speed_of_a_marker_on_it() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(0, 100, 1 / 120)
    rate = 12 + 3 * smooth_noise(rng, len(t), 25)
    angle = np.cumsum(rate) / 120
    xyz = np.stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), np.full(len(t), 0.8)], axis=1)
    xyz += rng.normal(size=xyz.shape) * 0.0003
    stamps = EPOCH + np.rint(t * 1e9).astype(np.int64)
    own = np.arange(0, 90, 1 / 200)
    true = own * (1 + 20e-6) + 4.2
    values = {"angle_rad": np.interp(true, t, angle)}
    sync = sync_marker(stamps, xyz, EPOCH + np.rint(own * 1e9).astype(np.int64), values)
    ends = (sync.clock.all([EPOCH, EPOCH + 89 * 10**9]) - EPOCH) / 1e9
    assert np.abs(ends - (np.array([0, 89]) * (1 + 20e-6) + 4.2)).max() < 0.003


def test_too_short_or_calm_is_refused() -> None:
    made = session(3, seed=6, offset_s=5.0)
    with pytest.raises(SyncError):
        made.sync()
    calm = session(60, seed=6, motion=0.0)
    with pytest.raises(SyncError):
        calm.sync()


def test_the_residuals_become_a_channel() -> None:
    made = session(60, seed=3)
    sync = made.sync(config=SyncConfig(window_s=10.0))
    log = residual_log(sync, "imu")
    assert log.kind == "record"
    assert sorted(log.values) == ["agreed", "residual_ms"]
    assert len(log) == len(sync.agreed)
    assert (np.diff(log.stamp_ns) > 0).all()


def test_a_reference_may_be_any_signal() -> None:
    made = session(30, seed=4)
    with pytest.raises(SyncError, match="usable samples"):
        synchronise(track_speed(made.stamp_ns, made.xyz_m), magnitude(made.imu_stamp_ns[:5], made.true_s[:5]))
