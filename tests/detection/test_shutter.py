"""The rolling shutter against pictures that lean by construction."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes import CAMERA, PERIOD_NS, RADIUS_M, Ball, bgr_frame, picture, truth
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.circle import Circle
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.time import NS_PER_S
from spheremcap.detection.shutter import AT_REST, Motion, Shutter
from spheremcap.positioning.sphere import polygon_circle

INTERVAL_S = PERIOD_NS / NS_PER_S
ANGLES = np.linspace(0, 2 * np.pi, 200, endpoint=False)
NORMAL = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])


@settings(deadline=None)
@given(lean_x=st.floats(-0.3, 0.3), lean_y=st.floats(-0.3, 0.3), r_px=st.floats(3, 60))
def test_seen_and_still_are_inverse_and_the_circle_has_the_outlines_area(lean_x, lean_y, r_px):
    motion = Motion(np.zeros(2), np.array([lean_x, lean_y]))
    circle = Circle(50.0, 80.0, r_px)
    outline = r_px * NORMAL + (50.0, 80.0)
    seen = motion.seen(outline, 80.0)
    np.testing.assert_allclose(motion.still(seen, 80.0), outline, atol=1e-9)
    # A row's place in time is where it is read: what it shows has moved by that many rows' lean.
    np.testing.assert_allclose(seen - outline, np.outer(seen[:, 1] - 80.0, motion.lean), atol=1e-9)
    assert motion.seen_circle(circle).r_px == pytest.approx(polygon_circle(seen).r_px, rel=1e-3)
    assert motion.still_circle(motion.seen_circle(circle)).r_px == pytest.approx(r_px)


@pytest.mark.parametrize("readout_s", [0.0, 0.0012, 0.0036])
def test_the_readout_time_is_learnt_from_going_up_and_down(readout_s):
    rng = np.random.default_rng(1)
    shutter = Shutter(None, 720)
    unknown_s, unknown_sd_s = shutter.readout_s(INTERVAL_S)
    assert (unknown_s, unknown_sd_s) == (0.0, pytest.approx(INTERVAL_S / 3**0.5))
    for frame in range(150):
        rate_px = np.array([300.0, 2500.0 * np.sin(frame / 9)])
        circle = Circle(100.0 + frame, 300.0, 24.0)
        used = shutter.motion(rate_px, 0.0, INTERVAL_S)
        seen = Motion(np.zeros(2), rate_px * readout_s / 719).seen(24.0 * NORMAL + (circle.x_px, 300.0), 300.0)
        still = used.still(seen, 300.0) - (circle.x_px, 300.0)
        outside = np.hypot(still[:, 0], still[:, 1]) - 24.0 + 0.1 * rng.standard_normal(len(ANGLES))
        shutter.learn(seen, outside, np.ones(len(ANGLES)), circle, used, rate_px)
    learnt_s, sd_s = shutter.readout_s(INTERVAL_S)
    assert sd_s < 0.0003
    assert abs(learnt_s - readout_s) < 4 * sd_s


def test_a_given_readout_time_is_not_learnt():
    shutter = Shutter(0.002, 720)
    shutter.learn(24.0 * NORMAL, np.sin(2 * ANGLES), np.ones(200), Circle(0, 0, 24.0), AT_REST, np.array([0, 900.0]))
    assert shutter.readout_s(INTERVAL_S) == (0.002, 0.0)


def ball(i):
    """Down and up by 12 px a frame at most."""
    w = 2 * np.pi * 4.0
    return Ball((0.02, 0.1 * float(np.sin(w * i * INTERVAL_S)), 0.9))


def rolled(i, readout_s):
    """The picture with each row as it was when read."""
    middle = truth(ball(i)).y_px
    rate_px = (truth(ball(i + 0.5)).y_px - truth(ball(i - 0.5)).y_px) / INTERVAL_S
    lean = rate_px * readout_s / (CAMERA.height_px - 1)
    rows = np.arange(CAMERA.height_px, dtype=np.float32)
    y = np.repeat((rows - lean * (rows - middle))[:, None], CAMERA.width_px, axis=1).astype(np.float32)
    x = np.repeat(np.arange(CAMERA.width_px, dtype=np.float32)[None], CAMERA.height_px, axis=0)
    return cv2.remap(picture(ball(i), noise_seed=i), x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def range_errors(given_s, indices):
    chain = MarkerChain(MarkerSpec("m", 2 * RADIUS_M), CAMERA, ChainConfig(), readout_s=given_s)
    chain.seed(bgr_frame(rolled(0, 0.0036)), truth(ball(0)))
    estimates = [chain.step(bgr_frame(rolled(i, 0.0036), i)) for i in indices]
    assert all(e.status.measured for e in estimates)
    true = np.array([np.linalg.norm(ball(i).xyz) for i in indices])
    return np.array([np.linalg.norm(e.xyz_cam_m) for e in estimates]) / true - 1


def test_a_rolling_shutter_does_not_change_the_distance():
    """Known from the start, learnt after a swing, wrong when taken for a global one."""
    indices = range(1, 120)
    known, learnt, wrong = (range_errors(s, indices) for s in (0.0036, None, 0.0))
    assert known.std() < 0.003
    assert learnt[40:].std() < 0.004
    assert wrong.std() > 0.008
