"""A recording of ours and a sensor file, synchronised and merged, then read back."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from test_sync import EPOCH, Session, session

from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, Status
from spheremcap.core.marker import MarkerSpec
from spheremcap.errors import UsageError
from spheremcap.io import recording
from spheremcap.io.mcap_log import McapLog
from spheremcap.merging.dataset import Source, merge, sync_recording


def write_recording(path: Path, made: Session) -> Path:
    camera = Camera(640, 480, 500, 500, 320, 240)
    with McapLog(path, camera=camera, markers=[MarkerSpec("left_wrist")]) as log:
        for k, (stamp, xyz) in enumerate(zip(made.stamp_ns.tolist(), made.xyz_m, strict=True)):
            if np.isfinite(xyz).all():
                estimate = MarkerEstimate(
                    "left_wrist", k, stamp, Status.VERIFIED, Circle(100, 100, 20), xyz_cam_m=xyz,
                    covariance_m2=np.eye(3) * 1e-6,
                )  # fmt: skip
            else:
                estimate = MarkerEstimate("left_wrist", k, stamp, Status.OUT_OF_VIEW)
            log.write(FrameResult(k, stamp, (estimate,)), None)
    return path


def write_imu(path: Path, made: Session) -> Path:
    """As an x-IMU3 exports it, its clock counting from zero."""
    rows = ["Timestamp (us),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)"]
    micros = (made.imu_stamp_ns - made.imu_stamp_ns[0]) // 1000
    for t, (x, y, z) in zip(micros.tolist(), (made.force / 9.80665).tolist(), strict=True):
        rows.append(f"{t},{x:.5f},{y:.5f},{z:.5f}")
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def made() -> Session:
    return session(40, seed=3, fps=120, offset_s=5.4)


@pytest.fixture(scope="module")
def inputs(made: Session, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("dataset")
    return write_recording(folder / "out.mcap", made), write_imu(folder / "imu_left_wrist.csv", made)


def errors_ms(stamps: np.ndarray, made: Session) -> np.ndarray:
    return np.abs((stamps - EPOCH) / 1e6 - made.true_s * 1e3)


def test_merge_finds_the_clock_and_writes_the_residuals(
    made: Session, inputs: tuple[Path, Path], tmp_path: Path
) -> None:
    video, imu = inputs
    sources = [Source(video), Source(imu, sync_marker="left_wrist")]
    dataset = merge(sources, tmp_path / "dataset.mcap")
    assert any("offset" in note and "windows agree" in note for note in dataset.notes)
    assert "/sync/imu_left_wrist/residual" in dataset.merged.counts
    back = recording.open(tmp_path / "dataset.mcap")
    sensor = back.sensors["imu_left_wrist"]
    assert len(sensor) == len(made.imu_stamp_ns)
    assert errors_ms(sensor.stamp_ns, made).max() < 1.0
    assert sensor.own_stamp_ns[0] == 0
    assert len(back.tracks["left_wrist"]) == len(made.stamp_ns)


def test_sync_says_what_to_add_and_merge_takes_it(made: Session, inputs: tuple[Path, Path], tmp_path: Path) -> None:
    video, imu = inputs
    merge([Source(video), Source(imu, name="wrist")], tmp_path / "rough.mcap")
    sync = sync_recording(recording.open(tmp_path / "rough.mcap"), "left_wrist", "wrist")
    added = Source(
        imu,
        name="wrist",
        offset_ns=round(sync.offset_s * 1e9),
        drift=Fraction(round(sync.drift_ppm * 1e3), 10**9),
    )
    merge([Source(video), added], tmp_path / "fine.mcap")
    fine = recording.open(tmp_path / "fine.mcap").sensors["wrist"]
    assert errors_ms(fine.stamp_ns, made).max() < 1.0


def test_a_merge_that_is_stopped_early_reads_no_more(inputs: tuple[Path, Path], tmp_path: Path) -> None:
    video, _ = inputs
    asked: list[bool] = []

    def stop() -> bool:
        asked.append(True)
        return len(asked) > 1

    stopped = merge([Source(video), Source(tmp_path / "not there.csv")], tmp_path / "out.mcap", stop=stop)
    assert stopped.merged.stopped
    assert [path.name for path in tmp_path.iterdir()] == []


def test_what_is_not_there_is_listed(inputs: tuple[Path, Path], tmp_path: Path) -> None:
    video, imu = inputs
    with pytest.raises(UsageError, match="no marker 'nose'; there are: left_wrist"):
        sync_recording(recording.open(video), "nose", "imu")
    with pytest.raises(UsageError, match="no sensor 'imu'; there are: none"):
        sync_recording(recording.open(video), "left_wrist", "imu")
    with pytest.raises(UsageError, match="no recording has a marker 'nose'"):
        merge([Source(video), Source(imu, sync_marker="nose")], tmp_path / "x.mcap")
