"""Positions read in little memory are those that a whole reading gives."""

import numpy as np
import pytest
from session_data import COVARIANCE_M2, NAMES, stamp, write_session

from spheremcap.core.estimate import Status
from spheremcap.io import recording
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.poses import Poses, read_poses, without_focal

GAPS = {NAMES[0]: {4: Status.ESTIMATED, 5: Status.LOST, 6: Status.OUT_OF_VIEW, 9: Status.SEEDED}}


def read(path, topics=None):
    with McapRecords(path) as records:
        return read_poses(records, topics)


def test_poses_are_the_recordings_tracks(tmp_path):
    path = write_session(tmp_path / "r.mcap", range(12), GAPS)
    poses = read(path)
    tracks = recording.open(path).tracks
    assert set(poses) == set(tracks) == set(NAMES)
    for name, track in tracks.items():
        own = poses[name]
        assert len(own) == len(track.stamp_ns) == 12
        np.testing.assert_array_equal(own.stamp_ns, track.stamp_ns)
        measured = np.isin(track.status, [s.value for s in Status if s.measured])
        np.testing.assert_array_equal(own.measured, measured)
        np.testing.assert_allclose(own.xyz_cam_m[measured], track.xyz_cam_m[measured], rtol=1e-6)
        np.testing.assert_allclose(own.circle_px[measured], track.circle_px[measured], rtol=1e-6)
        np.testing.assert_array_equal(own.bridged, track.status == Status.ESTIMATED.value)
    np.testing.assert_allclose(poses[NAMES[1]].covariance_m2[0], COVARIANCE_M2[np.triu_indices(3)])
    assert (poses[NAMES[0]].measured.sum(), poses[NAMES[1]].measured.sum()) == (9, 12)


def test_topics_can_be_chosen(tmp_path):
    path = write_session(tmp_path / "r.mcap", range(3))
    assert list(read(path, [f"/markers/{NAMES[1]}/state"])) == [NAMES[1]]
    assert read(path, []) == {}


def test_frames_are_by_time_and_gaps_stay_frames(tmp_path):
    poses = read(write_session(tmp_path / "r.mcap", [0, 1, 5]))[NAMES[0]]
    assert poses.stamp_ns.tolist() == [stamp(0), stamp(1), stamp(5)]


def test_what_the_focal_length_adds_to_each_position_is_taken_out():
    xyz = np.array([[0.2, -0.1, 1.5], [np.nan] * 3], np.float32)
    own = np.diag([1e-6, 2e-6, 9e-6])
    said = own + 0.02**2 * np.outer(xyz[0], xyz[0])
    packed = np.array([said[np.triu_indices(3)], [np.nan] * 6], np.float32)
    poses = Poses("m", np.arange(2), xyz, packed, np.zeros((2, 3), np.float32), np.zeros(2, np.bool_))
    np.testing.assert_allclose(without_focal(poses, 0.02)[0], own[np.triu_indices(3)], atol=2e-10)
    np.testing.assert_array_equal(without_focal(poses, 0.0)[0], packed[0])
    assert np.isnan(without_focal(poses, 0.02)[1]).all()
    assert poses.covariance_m2[0, 5] == pytest.approx(said[2, 2])  # the poses' own stay
