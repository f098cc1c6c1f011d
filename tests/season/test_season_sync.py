"""An IMU on a marker, its clock set half a second wrong: the season finds it, and says how well."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from seasons import SETTINGS, write_manifest, write_seeds

from scenes import ball_at, picture, truth
from spheremcap.io.encode import write_video
from spheremcap.season.manifest import load_season
from spheremcap.season.run import here, run_season

RATE_HZ, SECONDS, LATE_S = 120, 14, 0.4
ABOUT = np.array([0.7, 1.13, 1.71, 2.3])  # Hz, none a multiple of another


def ball(time_s):
    """Swings to the sides and up, never twice in the same way."""
    x = 160 + sum(14 * np.sin(2 * np.pi * f * time_s + k) for k, f in enumerate(ABOUT))
    y = 120 + sum(9 * np.sin(2 * np.pi * 0.9 * f * time_s + 2 * k) for k, f in enumerate(ABOUT))
    return ball_at(float(x), float(y), 30)


def write_imu(path: Path) -> None:
    """What an accelerometer on it feels, 200 a second, on a clock that is `LATE_S` behind."""
    step = 1 / 200
    times = np.arange(-3 * step, SECONDS, step)
    xyz = np.array([ball(t).xyz for t in times])
    felt = np.diff(xyz, 2, axis=0) / step**2 - np.array([0, 9.81, 0])  # the camera's y is down
    rows = [f"{t - LATE_S:.4f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(times[1:], felt, strict=False)]
    rows = [row for row in rows if not row.startswith("-")]
    path.write_text("\n".join(["time (s),acc_x (m/s^2),acc_y (m/s^2),acc_z (m/s^2)", *rows]) + "\n")


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    folder = tmp_path_factory.mktemp("synced")
    (folder / "a").mkdir()
    times = [k / RATE_HZ for k in range(RATE_HZ * SECONDS)]
    write_video(
        folder / "a" / "v.mp4", (picture(ball(t), noise_seed=k) for k, t in enumerate(times)), Fraction(RATE_HZ)
    )
    (folder / "a" / "v.settings.toml").write_text(tomli_w.dumps(SETTINGS))
    x, y, r = truth(ball(0))
    write_seeds(folder / "a" / "v.seeds.toml", f"wrist@0={x:.1f},{y:.1f},{r:.1f}")
    write_imu(folder / "a" / "imu.csv")
    said = {"video": "a/v.mp4", "sensors": "a/imu.csv", "analyse": False}
    return write_manifest(folder, {"a": said}, defaults={"merge": {"imu": {"sync": "wrist"}}})


def test_the_clock_is_found_and_what_it_is_good_to(manifest, tmp_path):
    season = load_season(manifest)
    with here(1) as submit:
        done = run_season(season, season.plans, tmp_path / "out", submit)
    (clock,) = done.outcomes["a"].clocks
    assert done.complete, done.outcomes["a"]
    assert clock.first_ns == pytest.approx(LATE_S * 1e9, abs=4e6)
    assert clock.residual_ms is not None
    assert clock.error_ms is not None
    assert clock.residual_ms < 5
    assert "sync with wrist" in clock.added
