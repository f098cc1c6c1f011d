"""The compiled loops of the renderer equal their NumPy forms on any input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference import synth_motion, synth_pixels
from spheremcap.core.camera import Camera
from spheremcap.core.frame import Window
from spheremcap.synth import motion, pixels
from spheremcap.synth.raster import to_srgb
from spheremcap.synth.scene import _TO_YUV as TO_YUV
from spheremcap.synth.scene import to_yuv420

CURVE = np.rint(to_srgb(np.arange(16384) / 16383)).astype(np.uint8)
NARROW = Camera(1280, 720, 1150.0, 1150.0, 639.5, 359.5, "plumb_bob", (-0.31, 0.17, 0.001, -0.002))
WIDE = Camera(1280, 720, 585.0, 585.0, 639.5, 359.5, "fisheye", (0.035, -0.012, 0.004, -0.001))
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=40, deadline=None)


def off_by(found, expected):
    """(most levels off, share of values that are off)."""
    assert found.dtype == expected.dtype == np.uint8
    assert found.shape == expected.shape
    off = np.abs(found.astype(int) - expected)
    return off.max(), (off > 0).mean()


# --- motion: to the last few bits ---


@few
@given(seeds)
def test_harmonics(seed):
    rng = np.random.default_rng(seed)
    t, c0, a, b = rng.uniform(-1, 9, 11), *(rng.normal(size=shape) for shape in (3, (6, 3), (6, 3)))
    np.testing.assert_allclose(
        motion.harmonics(t, 1.7, c0, a, b), synth_motion.harmonics(t, 1.7, c0, a, b), rtol=0, atol=1e-11
    )


@few
@given(seeds)
def test_shaking(seed):
    rng = np.random.default_rng(seed)
    t, xyz, hz = rng.uniform(0, 9, 7), rng.normal(size=(7, 3)), rng.uniform(5, 90, 3)
    for found, expected in zip(motion.shaking(t, hz, 0.02, 0.3), synth_motion.shaking(t, hz, 0.02, 0.3), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        motion.shaken(xyz, t, hz, 0.02, 0.3), synth_motion.shaken(xyz, t, hz, 0.02, 0.3), rtol=0, atol=1e-11
    )


@few
@given(seeds, st.sampled_from([NARROW, WIDE]))
def test_outline(seed, camera):
    rng = np.random.default_rng(seed)
    centres = rng.uniform((-1.5, -1.5, 0.3), (1.5, 1.5, 3), (32, 3))
    rays = synth_motion.tangent_rays(centres, 0.05, np.arange(32) * 2 * np.pi / 32)
    found, expected = motion.touched(centres, 0.05, camera.params), camera.project(rays)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)  # NaN where NaN


# --- pixels: to rounding ---


@few
@given(seeds, st.floats(0, 9), st.floats(0, 9), st.floats(0, 9), st.floats(0, 9))
def test_cut(seed, x0, y0, x1, y1):
    image = np.random.default_rng(seed).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    flat = image.reshape(30, -1)
    one, other = synth_pixels.cut(image, x0, y0, 28, 18), synth_pixels.cut(image, x1, y1, 28, 18)
    # Off by one level where float32 tips what lies half-way between two.
    still = pixels.cut(flat, x0, y0, x0, y0, 28, 18).reshape(18, 28, 3)
    assert off_by(still, one) <= (1, 0.07)
    moved = pixels.cut(flat, x0, y0, x1, y1, 28, 18).reshape(18, 28, 3)
    assert off_by(moved, synth_pixels.mean([one, other]))[0] <= 1


@few
@given(seeds)
def test_mean_of_four(seed):
    pictures = np.random.default_rng(seed).integers(0, 256, (4, 7, 15), dtype=np.uint8)
    assert (pixels.mean_of_four(pictures) == synth_pixels.mean(pictures)).all()


@few
@given(seeds, st.booleans(), st.booleans())
def test_paint_ball(seed, gloss, grain):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1:41, -1:51]
    shift, scale = rng.uniform(-0.3, 0.3, 2), 1 / 400
    a, b = ((x - 25) * scale + shift[0]).astype(np.float32), ((y - 20) * scale + shift[1]).astype(np.float32)
    z = rng.uniform(0.5, 2)
    centre = np.array([*(shift + rng.uniform(-0.05, 0.05, 2)), 1.0]) * z
    track = centre + np.linspace(-0.01, 0.01, 42)[:, None] * rng.normal(size=3)
    radius, albedo, turn = rng.uniform(0.01, 0.05) * z, rng.uniform(0, 1, 3), rng.uniform(-2, 2)
    lamp = rng.normal(size=3) - (0, 0, 1)
    lamp /= np.linalg.norm(lamp)
    half = lamp - (0, 0, 1)
    half /= np.linalg.norm(half)
    ambient, gloss, grain = rng.uniform(0, 1), 0.35 * gloss, 0.06 * grain
    under = rng.uniform(0, 1, (40, 50, 4)).astype(np.float32)
    expected = synth_pixels.paint_ball(a, b, track, radius, albedo, lamp, ambient, gloss, grain, turn, under)
    found = under.copy()
    surface = np.array([*lamp, *half, ambient, gloss, grain, turn])
    pixels.paint_ball(a, b, track, radius, albedo, surface, found)
    np.testing.assert_allclose(found[..., 3], expected[..., 3], rtol=0, atol=1e-3)  # float32 at a very flat edge
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3)
    assert np.abs(found - expected).mean() < 2e-5


@few
@given(seeds, st.booleans())
def test_paint_card(seed, plain):
    rng = np.random.default_rng(seed)
    window, half = Window(int(rng.integers(-9, 99)), int(rng.integers(-9, 99)), 50, 40), rng.uniform(4, 22, 2)
    middle = np.array([window.x + rng.uniform(5, 45), window.y + rng.uniform(5, 35), rng.uniform(-4, 4)])
    where = middle + np.linspace(-1, 1, 40)[:, None] * rng.normal(size=3) * (1, 1, 0.05)
    paint = rng.uniform(0, 1, (1, 1, 3) if plain else (7, 9, 3)).astype(np.float32)
    under = rng.uniform(0, 1, (40, 50, 4)).astype(np.float32)
    found = under.copy()
    pixels.paint_card(window.x, window.y, where, *half, paint, found)
    expected = synth_pixels.paint_card(window, where, half, paint, under)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)


def test_a_pixel_without_a_ray_is_left_alone():
    a = np.full((6, 6), np.nan, np.float32)
    out = np.full((4, 4, 4), 0.5, np.float32)
    pixels.paint_ball(a, a, np.ones((6, 3)), 0.5, np.ones(3), np.ones(10), out)
    assert (out == 0.5).all()


@few
@given(seeds)
def test_develop(seed):
    rng = np.random.default_rng(seed)
    light = rng.uniform(0, 1.2, (9, 21)).astype(np.float32)
    grain = rng.standard_normal((15, 40), np.float32)
    top, left, sign = int(rng.integers(0, 6)), int(rng.integers(0, 19)), float(rng.choice([-1, 1]))
    found = pixels.develop(light, grain, top, left, 1 / 900, 4e-5, sign, CURVE)
    expected = synth_pixels.develop(light, grain[top : top + 9, left : left + 21], 1 / 900, 4e-5, sign, CURVE)
    # One step of 16383 in the darkest light, where the curve is steepest, is one level.
    assert off_by(found, expected) <= (1, 0.03)


@few
@given(seeds)
def test_yuv420(seed):
    picture = np.random.default_rng(seed).integers(0, 256, (12, 20, 3), dtype=np.uint8)
    assert off_by(to_yuv420(picture), synth_pixels.yuv420(picture, TO_YUV)) <= (1, 0.02)


@pytest.mark.parametrize("level", [0, 77, 255])
def test_a_plain_picture_has_plain_planes(level):
    planes = to_yuv420(np.full((4, 6, 3), level, np.uint8))
    assert set(planes[:4].ravel()) == {round(16 + level * 219 / 255)}
    assert set(planes[4:].ravel()) == {128}
