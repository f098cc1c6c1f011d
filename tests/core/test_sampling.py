"""Pixels cut from planes by compiled loops, against the frames' own conversion, OpenCV and NumPy."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference.edge import _bilinear, _spline
from scenes import ball_at, picture
from spheremcap.core.compiled import F8, PLANE, array, kernel
from spheremcap.core.frame import BgrFrame, Window, YuvFrame, yuv_to_bgr_matrix
from spheremcap.core.sampling import GRID, bgr_at, cut_bgr, hsv_of, level_at, soft_levels_at

WIDTH, HEIGHT = 41, 30
BT709 = yuv_to_bgr_matrix("bt709", False)
GRIDS = {
    "4:2:0 left": ((2, 2), (0.0, 0.5)),
    "4:2:0 centre": ((2, 2), (0.5, 0.5)),
    "4:2:2": ((2, 1), (0.0, 0.0)),
    "4:1:1": ((4, 1), (0.0, 0.0)),
    "4:4:4": ((1, 1), (0.0, 0.0)),
}


def planar(name="4:2:0 left", size=(WIDTH, HEIGHT), seed=0, turns=0):
    """Random planes, turned by so many quarters as a rotated video's are: views with other strides."""
    step, origin = GRIDS[name]
    rng = np.random.default_rng(seed)
    columns, rows = -(-size[0] // step[0]), -(-size[1] // step[1])
    y = rng.integers(16, 236, (size[1], size[0]), np.uint8)
    u, v = rng.integers(60, 200, (2, rows, columns)).astype(np.uint8)
    for _ in range(turns):
        # A quarter to the left: column x becomes row width - 1 - x.
        width, columns = y.shape[1], u.shape[1]
        origin = (origin[1], width - 1 - (origin[0] + (columns - 1) * step[0]))
        step, y, u, v = step[::-1], np.rot90(y), np.rot90(u), np.rot90(v)
    return YuvFrame(0, 0, y, (u, v), step, origin, BT709)


def bgr(size=(WIDTH, HEIGHT), turns=0):
    image = np.random.default_rng(1).integers(0, 256, (size[1], size[0], 3)).astype(np.uint8)
    return BgrFrame(0, 0, np.rot90(image, turns))


def cut(frame, window):
    return cut_bgr(*frame.planes, window.x, window.y, 1.0, window.width, window.height)


windows = st.builds(Window, st.integers(-30, 60), st.integers(-30, 50), st.integers(1, 50), st.integers(1, 40))
FRAMES = {
    "bgr": bgr(),
    "bgr turned": bgr(turns=1),
    **{name: planar(name) for name in GRIDS},
    **{f"4:2:0 turned by {turns}": planar(turns=turns) for turns in (1, 2, 3)},
    "4:2:2 turned": planar("4:2:2", turns=1),
}


def exactly(frame, x, y):
    """BGR (..., 3) at places of the planes, not rounded."""
    planes, at = frame.planes, np.stack(np.broadcast_arrays(x, y), axis=-1).astype(float)
    chroma = (at - planes.grid[2:4]) / planes.grid[:2]
    levels = [_bilinear(planes.y, at), _bilinear(planes.u, chroma), _bilinear(planes.v, chroma)]
    to_bgr = planes.grid[4:].reshape(3, 4)
    return np.clip(np.stack(levels, axis=-1) @ to_bgr[:, :3].T + to_bgr[:, 3], 0, 255)


@pytest.mark.parametrize("name", FRAMES)
@settings(deadline=None, max_examples=60)
@given(window=windows)
def test_whole_pixels_are_the_frames_own(name, window):
    """Of BGR frames exactly; within a level where chroma has a sample for every pixel. Elsewhere the frame's own patch
    rounds chroma to whole levels before it becomes colour, and half a level of it is worth 1.06 of blue: within two.
    What is cut here is within half a level, and a hundredth for single precision, of what the planes say. A YUV frame's
    patch goes on interpolating chroma out of the picture, so there only what lies inside is compared."""
    frame = FRAMES[name]
    got, expected = cut(frame, window).astype(int), frame.patch(window).astype(int)
    assert got.shape == expected.shape
    columns, rows = window.x + np.arange(window.width), window.y + np.arange(window.height)
    assert np.abs(got - exactly(frame, columns, rows[:, None])).max() <= 0.51
    if isinstance(frame, BgrFrame):
        np.testing.assert_array_equal(got, expected)
    inside = window.clipped(frame.width_px, frame.height_px)
    y0, x0 = inside.y - window.y, inside.x - window.x
    part = np.s_[y0 : y0 + inside.height, x0 : x0 + inside.width]
    assert np.abs(got[part] - expected[part]).max(initial=0) <= (1 if name == "4:4:4" else 2)


@pytest.mark.parametrize("name", FRAMES)
@settings(deadline=None, max_examples=40)
@given(window=windows)
def test_beyond_the_border_the_border_pixel_repeats(name, window):
    """In luma; chroma, whose samples lie beside the border's pixels, repeats from its own border on."""
    frame = FRAMES[name]
    plain = frame
    if isinstance(frame, YuvFrame):
        u, v = (np.full_like(plane, 120) for plane in frame.uv)
        plain = YuvFrame(0, 0, frame.y, (u, v), frame.uv_step_px, frame.uv_origin_px, frame.to_bgr)
    rows = np.clip(np.arange(window.y, window.y + window.height), 0, frame.height_px - 1)
    columns = np.clip(np.arange(window.x, window.x + window.width), 0, frame.width_px - 1)
    expected = plain.full[rows[:, None], columns].astype(int)
    assert np.abs(cut(plain, window) - expected).max() <= 1


@pytest.mark.parametrize("turns", [1, 2, 3])
@pytest.mark.parametrize("name", GRIDS)
def test_a_turned_picture_is_cut_as_the_one_that_was_not_turned(name, turns):
    upright, turned = planar(name), planar(name, turns=turns)
    whole = Window(0, 0, turned.width_px, turned.height_px)
    expected = np.rot90(cut(upright, Window(0, 0, WIDTH, HEIGHT)), turns)
    assert np.abs(cut(turned, whole).astype(int) - expected).max() <= 1


@pytest.mark.parametrize("name", FRAMES)
@settings(deadline=None, max_examples=60)
@given(x=st.floats(-20, 60), y=st.floats(-20, 50), step=st.floats(0.1, 1.99))
def test_between_pixels_the_planes_are_read_bilinearly(name, x, y, step):
    frame = FRAMES[name]
    got = cut_bgr(*frame.planes, x, y, step, 25, 20)
    sx, sy = frame.planes.grid[:2]
    if max(step / sx, step / sy) < 2:
        exact = exactly(frame, x + np.arange(25) * step, (y + np.arange(20) * step)[:, None])
        assert np.abs(got - exact).max() <= 0.52


@settings(deadline=None, max_examples=60)
@given(x=st.floats(-20, 300), y=st.floats(-20, 230), step=st.floats(0.1, 1.99))
def test_at_other_scales_it_is_opencvs_warp(x, y, step):
    """Within two levels, and what 1/32 px, to which OpenCV rounds a place, is worth where the picture is steep."""
    frame = BgrFrame(0, 0, picture(ball_at(157.3, 119.1, 30), noise=0))
    got = cut_bgr(*frame.planes, x, y, step, 40, 30).astype(float)
    to = np.array([[step, 0, x], [0, step, y]], np.float64)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    expected = cv2.warpAffine(frame.image, to, (40, 30), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    local = cv2.warpAffine(_steepest(frame.image), to, (40, 30), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    assert (np.abs(got - expected).max(axis=2) <= 2 + local / 16).all()


def _steepest(image):
    """The largest difference between neighbours around each pixel."""
    wide = np.ones((3, 3))
    return (cv2.dilate(image, wide).astype(np.float32) - cv2.erode(image, wide)).max(axis=2)


def means(frame, x0, y0, step, width, height, sub):
    """The mean of the sub x sub nearest samples, spread evenly over each step."""
    offsets = ((np.arange(sub) + 0.5) / sub - 0.5) * step
    columns = np.floor(x0 + (np.arange(width)[:, None] * step + offsets).ravel() + 0.5).astype(int)
    rows = np.floor(y0 + (np.arange(height)[:, None] * step + offsets).ravel() + 0.5).astype(int)
    columns, rows = np.clip(columns, 0, frame.width_px - 1), np.clip(rows, 0, frame.height_px - 1)
    fine = frame.image[rows[:, None], columns].astype(float)
    return fine.reshape(height, sub, width, sub, 3).mean(axis=(1, 3))


@pytest.mark.parametrize("step", [1.1, 1.6, 1.9, 2.3, 2.9, 3.7, 4.4, 5.2, 6.8, 8.0])
@pytest.mark.parametrize("corner", [(12.37, 9.81), (-9.63, 71.83)])
def test_a_wide_step_takes_the_mean_of_samples_spread_over_it(step, corner):
    """None up to nearly two pixels a step, then 2 x 2 or 3 x 3, never more than three samples from one to the next."""
    frame = bgr((160, 120))
    got = cut_bgr(*frame.planes, *corner, step, 20, 15)
    if step < 2:
        columns, rows = corner[0] + np.arange(20) * step, corner[1] + np.arange(15) * step
        assert np.abs(got - exactly(frame, columns, rows[:, None])).max() <= 0.52
    else:
        kinds = {sub: np.abs(got - means(frame, *corner, step, 20, 15, sub)).max() for sub in (2, 3)}
        kinds[1] = np.abs(
            got - exactly(frame, corner[0] + np.arange(20) * step, (corner[1] + np.arange(15) * step)[:, None])
        ).max()
        sub = min(kinds, key=kinds.__getitem__)
        assert kinds[sub] <= 0.52
        assert step / sub <= 3


def test_a_grey_picture_stays_grey_at_every_scale():
    frame = YuvFrame(
        0, 0, np.full((50, 60), 126, np.uint8), tuple(np.full((2, 25, 30), 128, np.uint8)), (2, 2), (0.0, 0.5), BT709
    )
    for step in (0.3, 1.0, 1.7, 4.0):
        out = cut_bgr(*frame.planes, -20.0, -20.0, step, 30, 30)
        assert (out == out[0, 0]).all()


# -- single places ---------------------------------------------------------------------------------


@kernel(None, PLANE, array(F8, 2))
def levels(plane, xy):
    out = np.empty(len(xy))
    for k in range(len(xy)):
        out[k] = level_at(plane, xy[k, 0], xy[k, 1])
    return out


@kernel(None, PLANE, PLANE, array(F8, 2))
def soft_levels(first, second, xy):
    out = np.empty((len(xy), 2))
    for k in range(len(xy)):
        out[k, 0], out[k, 1] = soft_levels_at(first, second, xy[k, 0], xy[k, 1])
    return out


@kernel(None, PLANE, PLANE, PLANE, GRID, array(F8, 2))
def colours(y, u, v, grid, xy):
    out = np.empty((len(xy), 3))
    for k in range(len(xy)):
        out[k, 0], out[k, 1], out[k, 2] = bgr_at(y, u, v, grid, xy[k, 0], xy[k, 1])
    return out


@kernel(None, array(F8, 2))
def hsv(bgr):
    out = np.empty((len(bgr), 3))
    for k in range(len(bgr)):
        out[k, 0], out[k, 1], out[k, 2] = hsv_of(bgr[k, 0], bgr[k, 1], bgr[k, 2])
    return out


def places():
    """Inside, on whole and half pixels, on the border, and beyond it."""
    rng = np.random.default_rng(4)
    even = np.stack(np.meshgrid(np.arange(-2, WIDTH + 2, 0.5), np.arange(-2, HEIGHT + 2, 0.5)), axis=-1).reshape(-1, 2)
    return np.concatenate([rng.uniform((-30, -30), (WIDTH + 30, HEIGHT + 30), (3000, 2)), even])


@pytest.mark.parametrize("turns", [0, 1])
def test_levels_between_pixels_are_bilinear(turns):
    plane = np.rot90(FRAMES["bgr"].planes.y, turns)
    found = levels(plane, places())
    np.testing.assert_allclose(found, _bilinear(plane, places()), atol=1e-9)
    whole = np.array([[0.0, 0], [7, 11], [plane.shape[1] - 1, plane.shape[0] - 1]])
    np.testing.assert_array_equal(levels(plane, whole), [plane[0, 0], plane[11, 7], plane[-1, -1]])


def test_soft_levels_are_a_quadratic_spline_of_both_planes():
    first, second = FRAMES["bgr"].planes.u, FRAMES["bgr"].planes.v
    found = soft_levels(first, second, places())
    for k, plane in enumerate((first, second)):
        np.testing.assert_allclose(found[:, k], _spline(plane, places()), atol=1e-9)


def test_soft_levels_blur_a_line_by_as_much_wherever_it_is_read():
    """The second moment of what a single bright column spreads over is that of three boxes: 3/12 of a sample squared,
    at every place; bilinear reading would blur by 0 on the sample and by 1/4 half way."""
    line = np.zeros((9, 21), np.uint8)
    line[:, 10] = 200
    for start in np.arange(0, 1, 0.125):
        x = np.arange(6, 15) + start
        read = soft_levels(line, line, np.column_stack([x, np.full(len(x), 4.0)]))[:, 0]
        assert read.sum() == pytest.approx(200)
        assert (read * x).sum() / 200 == pytest.approx(10)
        assert (read * (x - 10) ** 2).sum() / 200 == pytest.approx(0.25)


@pytest.mark.parametrize("name", FRAMES)
def test_colours_at_a_place_are_those_of_the_planes(name):
    frame, xy = FRAMES[name], places()
    found = np.clip(colours(*frame.planes, xy), 0, 255)
    np.testing.assert_allclose(found, exactly(frame, *xy.T), atol=1e-9)


def test_hsv_is_opencvs_but_not_rounded():
    rng = np.random.default_rng(5)
    colour = np.concatenate([rng.integers(0, 256, (2000, 3)), np.repeat(np.arange(256)[:, None], 3, axis=1)])
    found = hsv(colour.astype(float))
    expected = cv2.cvtColor((colour / 255).astype(np.float32)[None], cv2.COLOR_BGR2HSV)[0]
    off = np.abs(found[:, 0] - expected[:, 0] / 2)
    assert np.minimum(off, 180 - off).max() < 1e-3
    np.testing.assert_allclose(found[:, 1:], expected[:, 1:] * 255, atol=1e-2)
    assert ((found[:, 0] >= 0) & (found[:, 0] < 180)).all()
