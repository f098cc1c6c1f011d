"""Exports of an analysed recording are in the chair's frame, which is checked by places that are known by hand."""

import ezc3d
import numpy as np
import pytest
from session_data import NAMES, START_NS, write_session, xyz_m
from test_export_trc import strictly

from spheremcap.core.estimate import Status
from spheremcap.io import _pb
from spheremcap.io.export import export_recording

COUNT = 24
# A camera on the front of the chair that looks straight back and level, 1.5 m before the axle and 0.4 m above it: its
# right is the athlete's left, its down is down, and forward of it is backward of the chair.
CAMERA_XYZ_M = (1.5, 0.1, 0.4)
WORDS = "the chair's frame: x forward, y to the athlete's left, z up, origin midway between the hubs"


def chair(parent="camera_optical", upright=True):
    """The chair's axes in the camera's are (0, 0, -1), (1, 0, 0) and (0, -1, 0): a quaternion of halves."""
    rotation = {"x": 0.5, "y": 0.5, "z": -0.5, "w": 0.5}
    forward, left, up = CAMERA_XYZ_M
    return _pb.ChairFrame(
        parent_frame_id=parent, child_frame_id="chair", rotation=rotation, upright=upright,
        translation={"x": -left, "y": up, "z": forward},
    )  # fmt: skip


def in_chair(marker, index):
    x, y, z = xyz_m(marker, index)
    forward, left, up = CAMERA_XYZ_M
    return np.array([forward - z, left + x, up - y])


def exported(tmp_path, ending, *said, **how):
    analysed = [("/analysis/chair", START_NS, message) for message in said]
    gaps = {"left_wrist": {5: Status.ESTIMATED, 6: Status.LOST}}
    recording = write_session(tmp_path / "r.mcap", range(COUNT), gaps, analysed=analysed)
    return export_recording(recording, tmp_path / f"out.{ending}", **how)


def test_trc_is_forward_left_up(tmp_path):
    done = exported(tmp_path, "trc", chair())
    assert f"positions are in {WORDS}" in done.notes
    _, names, _, xyz_mm = strictly(tmp_path / "out.trc")
    for k, name in enumerate(names):
        for index in range(COUNT):
            if name == "left_wrist" and index in (5, 6):
                assert np.isnan(xyz_mm[index, k]).all()
            else:
                np.testing.assert_allclose(xyz_mm[index, k], 1000 * in_chair(name, index), atol=6e-5)


def test_c3d_says_its_axes_and_which_way_is_up(tmp_path):
    exported(tmp_path, "c3d", chair(), fill_ms=4.5)
    file = ezc3d.c3d(str(tmp_path / "out.c3d"))
    point, points = file["parameters"]["POINT"], file["data"]["points"][:3]
    assert (point["X_SCREEN"]["value"], point["Y_SCREEN"]["value"]) == (["+X"], ["+Z"])
    assert point["__METADATA__"]["DESCRIPTION"] == WORDS
    assert file["parameters"]["SPHEREMCAP"]["AXES"]["value"] == [WORDS]
    residuals = file["data"]["meta_points"]["residuals"][0]
    for k, name in enumerate(NAMES):
        for index in np.flatnonzero(residuals[k] > 0).tolist():
            np.testing.assert_allclose(points[:, k, index], 1000 * in_chair(name, index), rtol=1e-5, atol=1e-3)
            assert residuals[k, index] == pytest.approx(8.485, abs=0.06)  # a turn changes no standard deviation


def test_what_is_filled_is_turned_too(tmp_path):
    analysed = [("/analysis/chair", START_NS, chair())]
    recording = write_session(
        tmp_path / "r.mcap", range(COUNT), {"left_wrist": {5: Status.ESTIMATED}}, analysed=analysed
    )
    export_recording(recording, tmp_path / "out.c3d", fill_ms=4.5)
    file = ezc3d.c3d(str(tmp_path / "out.c3d"))
    assert file["data"]["meta_points"]["residuals"][0][0, 5] == 0
    smoothed = in_chair("left_wrist", 5) + np.array([-0.001, 0.001, -0.001])  # by 1 mm in each of the camera's axes
    np.testing.assert_allclose(file["data"]["points"][:3, 0, 5], 1000 * smoothed, rtol=1e-5)


def test_a_tilt_that_is_not_known_is_said(tmp_path):
    done = exported(tmp_path, "trc", chair(upright=False))
    assert any("z up as far as is known" in note for note in done.notes)


@pytest.mark.parametrize("said", [(), (chair("other_optical"),)])
def test_without_the_chair_in_their_frame_positions_stay_in_the_cameras(tmp_path, said):
    done = exported(tmp_path, "trc", *said)
    assert not any("positions are in" in note for note in done.notes)
    _, names, _, xyz_mm = strictly(tmp_path / "out.trc")
    np.testing.assert_allclose(xyz_mm[0, names.index("right_wrist")], 1000 * xyz_m("right_wrist", 0), atol=6e-5)
