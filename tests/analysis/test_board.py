"""A rendered board gives the camera that filmed it, within what it says of itself, or is refused with what to do."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from filmed_boards import CAMERA, CHARUCO, CHECKERBOARD, film, picture, poses, transform

from spheremcap.analysis.board import Board, Calibrated, View, solve
from spheremcap.analysis.filmed import calibrate_board
from spheremcap.core.camera import Camera
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.calibration import read_camera_info

TRUTH = dict(
    zip(("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"), (596, 599, 324, 176, *CAMERA.distortion), strict=True)
)


def views(
    camera: Camera, board: Board, seeds: int = 24, *, bend_m: float = 0.0, tilt_deg: float = 38, noise_px: float = 0.1
) -> list[View]:
    """The board's corners as `camera` sees them, with noise; its left and right edges `bend_m` behind."""
    rng = np.random.default_rng(0)
    made = []
    for index, pose in enumerate(poses(seeds, tilt_deg=tilt_deg)):
        turn, shift = transform(pose, camera)
        own = board.corners_m.copy()
        own[:, 2] = bend_m * (own[:, 0] / own[:, 0].max()) ** 2
        seen = camera.project(own @ turn.T + shift)
        inside = ((seen > 2) & (seen < (camera.width_px - 3, camera.height_px - 3))).all(axis=1)
        if inside.sum() >= 8:
            made.append(View(index, board.corners_m[inside], (seen + rng.normal(0, noise_px, seen.shape))[inside]))
    return made


@pytest.mark.parametrize("board", [CHARUCO, CHECKERBOARD], ids=["charuco", "checkerboard"])
def test_corners_are_where_the_camera_sees_them(board):
    for index, pose in enumerate(poses(4, spread=0.3)):
        found = board.find(cv2.cvtColor(picture(board, pose), cv2.COLOR_BGR2GRAY))
        assert found is not None
        turn, shift = transform(pose)
        own, seen = found
        apart = [seen - CAMERA.project(way @ turn.T + shift) for way in (own, own * (-1, -1, 1))]
        best = min(apart, key=lambda d: np.abs(d).max())  # a checkerboard is the same upside down
        assert len(seen) == (board.columns - 1) * (board.rows - 1) or board.dictionary
        assert np.abs(best).max() < 0.4, index
        assert np.abs(best.mean(axis=0)).max() < 0.1


def test_a_charuco_film_gives_its_camera_within_the_stated_uncertainty(tmp_path):
    out = tmp_path / "camera.yaml"
    report = calibrate_board(film(tmp_path / "a.mp4", CHARUCO, poses(30)), out, CHARUCO)
    found = report.found
    assert abs(found.values["fx"] / 596 - 1) < 0.003
    assert abs(found.values["cx"] - 324) < 0.003 * 640
    for name in ("fx", "fy", "cx", "cy", "k1"):
        assert abs(found.values[name] - TRUTH[name]) < 3 * found.sd[name], name
    assert found.sd["fx"] / 596 < 0.004
    assert found.rms_px < 0.3
    read = read_camera_info(out)
    assert (read.fx_px, read.focal_sd) == (found.camera.fx_px, found.camera.focal_sd)
    assert read.focal_sd == max(found.sd[f] / found.values[f] for f in ("fx", "fy"))
    shown = cv2.imread(str(tmp_path / "camera.png"))
    assert shown.shape == (360 + 26, 640, 3)


def test_a_checkerboard_filmed_in_stills_gives_its_camera(tmp_path):
    folder = tmp_path / "stills"
    folder.mkdir()
    for index, pose in enumerate(poses(30, spread=0.55)):
        cv2.imwrite(str(folder / f"{index:03}.png"), picture(CHECKERBOARD, pose, seed=index))
    found = calibrate_board(folder, tmp_path / "camera.yaml", CHECKERBOARD).found
    assert abs(found.values["fx"] / 596 - 1) < 0.003
    for name in ("fx", "fy", "cx", "cy", "k1"):
        assert abs(found.values[name] - TRUTH[name]) < 3 * found.sd[name], name


@pytest.mark.parametrize(
    "camera",
    [
        Camera(640, 360, 596, 599, 324, 176, "plumb_bob", (-0.28, 0.12, 0, 0)),
        Camera(640, 360, 596, 599, 324, 176, "plumb_bob", (-0.28, 0.12, 0, 0, -0.4)),
        Camera(640, 360, 400, 401, 324, 176, "fisheye", (-0.03, 0.01, 0.002, 0)),
    ],
    ids=["plumb_bob", "k3", "fisheye"],
)
@pytest.mark.parametrize("bend_m", [0, 0.001])
def test_every_lens_is_found_whether_the_board_is_flat_or_not(camera, bend_m):
    found = solve(
        views(camera, CHARUCO, 32, bend_m=bend_m), 640, 360, "fisheye" if camera.model == "fisheye" else "plumb_bob"
    )
    assert isinstance(found, Calibrated), found
    assert abs(found.values["fx"] - camera.fx_px) < min(3 * found.sd["fx"], 0.004 * camera.fx_px)
    assert abs(found.bend_m - bend_m) < 0.0004
    assert len(found.camera.distortion) == len(camera.distortion)
    edge = np.array([[x, y] for x in (20, 320, 620) for y in (20, 180, 340)], float)
    assert np.abs(found.camera.project(camera.rays(edge)) - edge).max() < 2


def test_the_stated_uncertainty_grows_with_errors_that_a_view_shares():
    quiet = views(CAMERA, CHARUCO)
    rng = np.random.default_rng(1)
    shared = [View(v.frame_index, v.board_m, v.image_px * (1 + rng.normal(0, 0.01, 2))) for v in quiet]
    one, other = (solve(given, 640, 360, "plumb_bob") for given in (quiet, shared))
    assert isinstance(one, Calibrated)
    assert isinstance(other, Calibrated)
    assert other.sd["fx"] > 2 * one.sd["fx"]


def test_a_view_that_fits_much_worse_is_left_out():
    given = views(CAMERA, CHARUCO)
    rng = np.random.default_rng(2)
    given[3] = View(3, given[3].board_m, given[3].image_px + rng.normal(0, 3, given[3].image_px.shape))
    found = solve(given, 640, 360, "plumb_bob")
    assert isinstance(found, Calibrated)
    assert (found.odd, len(found.views)) == (1, len(given) - 1)
    assert 3 not in [view.frame_index for view in found.views]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (views(CAMERA, CHARUCO, 6), "6 different poses, at least 10"),
        (views(CAMERA, CHARUCO, tilt_deg=2), "from the front"),
        (views(CAMERA, CHARUCO, tilt_deg=0), "tilt the board by 30 to 45"),
        ([v for v in views(CAMERA, CHARUCO, 90) if np.abs(v.image_px - (320, 180)).max() < 175], "of the picture"),
        (views(CAMERA, CHARUCO, noise_px=0.8), "px beside"),
    ],
    ids=["few", "frontal", "exactly frontal", "middle", "shaken"],
)  # fmt: skip
def test_what_does_not_say_enough_is_refused_with_what_to_film(given, words):
    said = solve(given, 640, 360, "plumb_bob")
    assert isinstance(said, str)
    assert words in said


def test_a_still_film_is_one_pose(tmp_path):
    path = film(tmp_path / "a.mp4", CHARUCO, [poses(1)[0]] * 15)
    with pytest.raises(SourceError, match="in 1 different poses"):
        calibrate_board(path, tmp_path / "camera.yaml", CHARUCO)
    assert not list(tmp_path.glob("camera*"))


@pytest.mark.parametrize(
    ("printed", "said"),
    [
        (CHECKERBOARD, "checkerboard:7x5:30mm"),
        (CHARUCO, "charuco:8x5:30mm:22mm"),
        (CHARUCO, "charuco:7x5:30mm:22mm:DICT_5X5_50"),
    ],
)
def test_another_board_than_the_printed_one_is_refused_with_the_printed_one(tmp_path, printed, said):
    path = film(tmp_path / "a.mp4", printed, poses(2, spread=0.2))
    with pytest.raises(SourceError, match=f"there is a {printed} there"):
        calibrate_board(path, tmp_path / "camera.yaml", Board.of(said))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("circles:7x5:30mm", "expected checkerboard:COLUMNSxROWS"),
        ("checkerboard:10x7", "expected"),
        ("checkerboard:10:25mm", "3 to 50|expected"),
        ("checkerboard:10x7:25", "expected"),
        ("checkerboard:2x7:25mm", "3 to 50"),
        ("checkerboard:7x7:0mm", "no size"),
        ("charuco:7x5:22mm:30mm", "smaller than its square"),
        ("charuco:7x5:30mm:22mm:DICT_9X9", "there are: DICT_4X4_50"),
        ("charuco:20x20:30mm:22mm", "has 50 markers, 20x20 squares need 200"),
    ],
)
def test_a_board_that_is_none_is_told(text, words):
    with pytest.raises(UsageError, match=words):
        Board.of(text)


def test_a_board_is_written_as_it_is_read():
    for text in ("checkerboard:10x7:25mm", "charuco:7x5:30mm:22.5mm:DICT_5X5_100"):
        assert str(Board.of(text)) == text
    assert Board.of("charuco:7x5:3cm:22mm:5x5_100").dictionary == "DICT_5X5_100"


def test_a_board_with_a_white_corner_as_old_opencv_drew_it_is_found(tmp_path):
    board = Board.of("charuco:7x6:30mm:22mm")
    old = cv2.aruco.CharucoBoard((7, 6), 0.03, 0.022, board.markers)
    old.setLegacyPattern(True)
    folder = Path(tmp_path)
    cv2.imwrite(str(folder / "0.png"), old.generateImage((640, 560), marginSize=40))
    cv2.imwrite(str(folder / "1.png"), old.generateImage((640, 560), marginSize=50))
    out = tmp_path.parent / f"{tmp_path.name}.yaml"
    with pytest.raises(SourceError, match="different poses"):  # found, and only then too few
        calibrate_board(folder, out, board)
