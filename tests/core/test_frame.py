import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Frame, Patch, Window, YuvFrame, crop, yuv_to_bgr_matrix

WIDTH, HEIGHT = 41, 30
BT709 = yuv_to_bgr_matrix("bt709", False)
windows = st.builds(Window, st.integers(-30, 60), st.integers(-30, 50), st.integers(1, 50), st.integers(1, 40))


def padded(image, window, margin=100):
    """The window by brute force: a border of repeated pixels, then a plain slice."""
    wide = np.pad(image, ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    y, x = window.y + margin, window.x + margin
    return wide[y : y + window.height, x : x + window.width]


def yuv_picture(step=(2, 2), origin=(0.0, 0.5), size=(WIDTH, HEIGHT), seed=0):
    rng = np.random.default_rng(seed)
    columns, rows = -(-size[0] // step[0]), -(-size[1] // step[1])
    y = rng.integers(16, 236, (size[1], size[0]), np.uint8)
    u, v = rng.integers(60, 200, (2, rows, columns)).astype(np.uint8)
    return YuvFrame(3, 1234, y, (u, v), step, origin, BT709)


IMAGE = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)


# -- windows ---------------------------------------------------------------------------------------


@given(windows)
def test_a_clipped_window_holds_just_the_pixels_inside_the_picture(window):
    inside = window.clipped(WIDTH, HEIGHT)
    columns = [x for x in range(window.x, window.x + window.width) if 0 <= x < WIDTH]
    rows = [y for y in range(window.y, window.y + window.height) if 0 <= y < HEIGHT]
    assert (inside.width, inside.height) == (len(columns), len(rows))
    if columns and rows:
        assert (inside.x, inside.y) == (columns[0], rows[0])


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(0.1, 40))
def test_a_window_around_a_circle_holds_its_square_and_is_no_larger_than_needed(x, y, half):
    window = Window.around(Circle(x, y, 1), half)
    assert window.x <= x - half < window.x + 1
    last = window.x + window.width - 1
    assert last - 1 < x + half <= last
    assert window.y <= y - half
    assert y + half <= window.y + window.height - 1


def test_a_window_holds_points_up_to_half_a_pixel_beyond_its_pixel_centres():
    window = Window(10, 20, 5, 4)
    assert window.holds(9.5, 19.5)
    assert window.holds(14.49, 23.49)
    assert not window.holds(9.49, 20)
    assert not window.holds(14.5, 20)
    assert not window.holds(12, 23.5)


# -- patches ---------------------------------------------------------------------------------------


@given(windows)
def test_crop_repeats_the_border_outside_the_picture(window):
    np.testing.assert_array_equal(crop(IMAGE, window), padded(IMAGE, window))


@given(windows)
def test_a_bgr_frames_patch_is_that_window_of_its_picture(window):
    frame = BgrFrame(0, 0, IMAGE)
    np.testing.assert_array_equal(frame.patch(window), padded(IMAGE, window))


@settings(deadline=None, max_examples=40)
@pytest.mark.parametrize(
    ("step", "origin"),
    [
        ((2, 2), (0.0, 0.5)),
        ((2, 2), (0.5, 0.5)),
        ((2, 1), (0.0, 0.0)),
        ((1, 1), (0.0, 0.0)),
        ((4, 1), (0.0, 0.0)),
    ],
)
@given(window=windows)
def test_a_yuv_frames_patch_is_that_window_of_its_full_picture(step, origin, window):
    frame = yuv_picture(step, origin)
    got = frame.patch(window).astype(int)
    expected = padded(frame.full, window).astype(int)
    # Chroma is interpolated beyond the last column too, so where a window reaches out only luma must repeat.
    inside = window.clipped(WIDTH, HEIGHT)
    y0, x0 = inside.y - window.y, inside.x - window.x
    part = np.s_[y0 : y0 + inside.height, x0 : x0 + inside.width]
    assert np.abs(got[part] - expected[part]).max(initial=0) <= 1
    assert got.shape == expected.shape


@pytest.mark.parametrize("window", [Window(-9, -7, 20, 18), Window(30, 22, 25, 20), Window(-5, -5, 60, 50)])
def test_a_yuv_patch_that_reaches_out_of_the_picture_repeats_its_border(window):
    y = np.full((HEIGHT, WIDTH), 90, np.uint8)
    y[:, -1], y[-1, :], y[0, :], y[:, 0] = 200, 210, 40, 30
    u, v = np.full((2, 15, 21), 110, np.uint8)
    frame = YuvFrame(0, 0, y, (u, v), (2, 2), (0.0, 0.5), BT709)
    np.testing.assert_allclose(frame.patch(window), padded(frame.full, window), atol=1)


def test_bgr_and_yuv_frames_of_the_same_picture_give_the_same_patches():
    yuv = yuv_picture()
    bgr = BgrFrame(yuv.index, yuv.stamp_ns, yuv.full)
    for window in (Window(3, 4, 12, 9), Window(0, 0, WIDTH, HEIGHT), Window(20, 11, 21, 19)):
        difference = yuv.patch(window).astype(int) - bgr.patch(window)
        assert np.abs(difference).max() <= 1


def test_chroma_is_placed_where_its_origin_says():
    """A chroma ramp of 4 a luma column reads the same luma column whatever the siting."""
    y = np.full((HEIGHT, 40), 128, np.uint8)
    for origin in ((0.0, 0.5), (0.5, 0.5)):
        columns = origin[0] + 2 * np.arange(20)
        v = np.tile((80 + 2 * columns).astype(np.uint8), (15, 1))
        frame = YuvFrame(0, 0, y, (np.full_like(v, 128), v), (2, 2), origin, yuv_to_bgr_matrix("bt601", True))
        red = frame.patch(Window(4, 4, 30, 8))[..., 2].astype(float)
        expected = 128 + 1.402 * (80 + 2 * np.arange(4, 34) - 128)
        assert np.abs(red - expected).max() < 2.5
        assert abs((red - expected).mean()) < 1.0


def test_a_patch_costs_only_its_own_area():
    frame = yuv_picture(size=(640, 480))
    frame.patch(Window(100, 100, 30, 30))
    Patch(frame, Window(300, 200, 50, 50))
    assert "full" not in vars(frame)


@pytest.mark.parametrize("step", [1, 2, 3, 5])
def test_a_reduced_picture_samples_every_nth_pixel(step):
    bgr = BgrFrame(0, 0, IMAGE)
    expected = IMAGE[step // 2 :: step, step // 2 :: step]
    np.testing.assert_array_equal(bgr.reduced(step), expected)
    yuv = yuv_picture()
    assert yuv.reduced(step).shape == expected.shape


def test_a_reduced_yuv_picture_has_the_colours_of_the_full_one():
    y = np.tile(np.linspace(40, 200, 64).astype(np.uint8), (48, 1))
    u = np.tile(np.linspace(90, 160, 32).astype(np.uint8), (24, 1))
    frame = YuvFrame(0, 0, y, (u, 255 - u), (2, 2), (0.0, 0.5), BT709)
    difference = frame.reduced(4).astype(int) - frame.full[2::4, 2::4]
    assert np.abs(difference).max() <= 6


def test_a_bgr_frame_refuses_what_is_no_picture():
    for image in (np.zeros((4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4, 3), np.float32)):
        with pytest.raises(ValueError, match="BgrFrame takes"):
            BgrFrame(0, 0, image)


@pytest.mark.parametrize("window", [Window(0, 0, WIDTH, HEIGHT), Window(3, 4, 10, 9), Window(-2, 0, 9, 9)])
def test_a_driver_that_fills_its_buffer_again_does_not_change_a_patch(window):
    buffer = IMAGE.copy()
    frame = BgrFrame(0, 0, buffer)
    patch = frame.patch(window)
    assert not np.shares_memory(patch, buffer)
    buffer[:] = 0
    np.testing.assert_array_equal(patch, padded(IMAGE, window))


def test_a_frames_picture_and_planes_are_not_to_be_written_to():
    buffer = IMAGE.copy()
    frame = BgrFrame(0, 0, buffer)
    for array in (frame.image, frame.full, *frame.planes[:3], *yuv_picture().planes[:3]):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1
    buffer[0, 0] = 1  # it stays the caller's own


def test_planes_say_how_they_become_colours():
    yuv = yuv_picture((2, 1), (0.0, 0.0))
    assert yuv.planes.grid.tolist() == [2, 1, 0, 0, *BT709.ravel()]
    assert np.shares_memory(yuv.planes.y, yuv.y)
    own = BgrFrame(0, 0, IMAGE).planes
    np.testing.assert_array_equal(np.dstack(own[:3]), IMAGE)
    np.testing.assert_array_equal(own.grid[4:].reshape(3, 4), np.eye(3, 4))


def test_a_frame_knows_its_number_time_and_size():
    frame = BgrFrame(7, 99, IMAGE)
    assert (frame.index, frame.stamp_ns, frame.width_px, frame.height_px) == (7, 99, WIDTH, HEIGHT)
    assert frame.encoded is None
    with pytest.raises(NotImplementedError):
        Frame(0, 0, 4, 4).patch(Window(0, 0, 1, 1))


# -- colours ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("matrix", ["bt601", "bt709", "bt2020"])
@pytest.mark.parametrize("full_range", [False, True])
def test_black_grey_and_white_are_neutral(matrix, full_range):
    to_bgr = yuv_to_bgr_matrix(matrix, full_range)
    black, white = (0, 255) if full_range else (16, 235)
    for luma, expected in ((black, 0), (white, 255), ((black + white) / 2, 127.5)):
        np.testing.assert_allclose(to_bgr @ [luma, 128, 128, 1], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("matrix", "full_range", "yuv", "rgb"),
    [
        ("bt601", False, (81, 90, 240), (255, 0, 0)),  # 8-bit primaries as the standards print them
        ("bt601", False, (145, 54, 34), (0, 255, 0)),
        ("bt601", False, (41, 240, 110), (0, 0, 255)),
        ("bt709", False, (63, 102, 240), (255, 0, 0)),
        ("bt709", False, (173, 42, 26), (0, 255, 0)),
        ("bt709", False, (32, 240, 118), (0, 0, 255)),
        ("bt601", True, (76, 85, 255), (255, 0, 0)),  # JPEG
        ("bt601", True, (150, 44, 21), (0, 255, 0)),
        ("bt601", True, (29, 255, 107), (0, 0, 255)),
    ],
)
def test_the_primaries_come_out_as_the_standards_have_them(matrix, full_range, yuv, rgb):
    bgr = yuv_to_bgr_matrix(matrix, full_range) @ [*yuv, 1]
    np.testing.assert_allclose(bgr[::-1], rgb, atol=2.0)


def test_full_range_bt601_is_jpegs_and_opencvs_ycrcb():
    rng = np.random.default_rng(2)
    bgr = rng.integers(0, 256, (20, 20, 3)).astype(np.uint8)
    ycc = cv2.cvtColor(bgr, cv2.COLOR_BGR2YCrCb)
    frame = YuvFrame(
        0, 0, ycc[..., 0], (ycc[..., 2], ycc[..., 1]), (1, 1), (0.0, 0.0), yuv_to_bgr_matrix("bt601", True)
    )
    assert np.abs(frame.full.astype(int) - bgr).max() <= 3


# -- the colour spaces of a patch ------------------------------------------------------------------


def test_a_patch_knows_which_part_of_it_lies_inside_the_picture():
    frame = BgrFrame(0, 0, IMAGE)
    assert Patch(frame, Window(5, 6, 10, 9)).picture == (0, 0, 10, 9)
    assert Patch(frame, Window(-3, -4, 10, 9)).picture == (3, 4, 10, 9)
    assert Patch(frame, Window(WIDTH - 4, HEIGHT - 2, 10, 9)).picture == (0, 0, 4, 2)


def test_a_patch_turns_circles_into_its_own_pixels():
    patch = Patch(BgrFrame(0, 0, IMAGE), Window(-3, 6, 20, 20))
    assert patch.local(Circle(10.25, 8.5, 3)) == Circle(13.25, 2.5, 3)


@pytest.mark.parametrize("step", [0.4, 1.0, 3.3])
def test_a_patch_at_another_scale_goes_there_and_back(step):
    patch = Patch.scaled(BgrFrame(0, 0, IMAGE), np.zeros((20, 24, 3), np.uint8), -4.2, 3.1, step)
    circle = Circle(10.25, 8.5, 3)
    local = patch.local(circle)
    assert (local.x_px * step - 4.2, local.y_px * step + 3.1) == pytest.approx((10.25, 8.5))
    back = patch.in_picture(local)
    assert (back.x_px, back.y_px, back.r_px) == pytest.approx((10.25, 8.5, 3))
    # Just the pixels that lie on the picture.
    x0, y0, x1, y1 = patch.picture
    columns, rows = -4.2 + step * np.arange(24), 3.1 + step * np.arange(20)
    inside = [np.flatnonzero((at >= 0) & (at <= size - 1)) for at, size in ((columns, WIDTH), (rows, HEIGHT))]
    assert (x0, x1) == (inside[0][0], inside[0][-1] + 1)
    assert (y0, y1) == (inside[1][0], inside[1][-1] + 1)
    assert patch.window.holds(*(-4.2 + step * 12, 3.1 + step * 10))


def test_hue_counts_two_degrees_a_step():
    colours = np.array([[[0, 0, 255], [0, 255, 255], [0, 255, 0], [255, 255, 0], [255, 0, 0], [255, 0, 255]]], np.uint8)
    patch = Patch(BgrFrame(0, 0, colours), Window(0, 0, 6, 1))
    assert patch.hsv[0, :, 0].tolist() == [0, 30, 60, 90, 120, 150]
    assert (patch.hsv[0, :, 1:] == 255).all()


def test_gray_is_luma():
    patch = Patch(BgrFrame(0, 0, IMAGE), Window(0, 0, WIDTH, HEIGHT))
    np.testing.assert_allclose(patch.gray, IMAGE @ [0.114, 0.587, 0.299], atol=1)
