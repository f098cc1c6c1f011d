"""Lens and shutter: what they make of an outline, and what is learnt from pictures that lean by construction."""

from functools import lru_cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes import CAMERA, PERIOD_NS, RADIUS_M, Ball, bgr_frame, picture, truth
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.circle import Circle
from spheremcap.core.look import EdgePoints, Measured
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.optics import Motion, Optics
from spheremcap.core.time import NS_PER_S
from spheremcap.detection.optics import OpticsLearner
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


@settings(deadline=None)
@given(
    rate=st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
    exposure_s=st.floats(0, 0.02),
    readout_s=st.floats(-0.02, 0.02),
    r_px=st.floats(2, 300),
)
def test_blur_and_lean_are_bounded_whatever_the_speed(rate, exposure_s, readout_s, r_px):
    """A wild speed must not ask for a wild picture, nor turn an outline inside out."""
    motion = Optics(exposure_s, readout_s, 0.001, 1.5).motion(np.array(rate), Circle(50, 50, r_px), 720)
    way = np.array(rate) * exposure_s
    assert np.hypot(*motion.blur_px) <= 3.5 * r_px * (1 + 1e-9)
    if np.hypot(*way) <= 3.5 * r_px:
        np.testing.assert_allclose(motion.blur_px, way)
    else:
        assert motion.blur_px @ way > 0.999 * np.hypot(*motion.blur_px) * np.hypot(*way)
    assert np.abs(motion.lean).max() <= 0.3
    assert 0 <= motion.stretch_sd <= 0.3
    assert motion.softness == 1.5


def test_a_row_is_later_than_the_one_above_it_by_its_share_of_the_readout():
    motion = Optics(0.002, 0.0036, 0.0002).motion(np.array([300.0, -2500.0]), Circle(0, 0, 24), 720)
    np.testing.assert_allclose(motion.blur_px, [0.6, -5.0])
    np.testing.assert_allclose(motion.lean, np.array([300.0, -2500.0]) * 0.0036 / 719)
    assert motion.stretch_sd == pytest.approx(2500 * 0.0002 / 719)


def claimed(circle, points, outside, motion, **how):
    """A claim with so many edge points (N, 2), `outside` (N,) pixels outside the fitted outline."""
    ones = np.ones(len(points))
    edges = EdgePoints(points, 0.1 * ones, np.arange(len(points)), 0 * ones, len(points), 0.99)
    given = {"visible": 1.0, "proposer": "prediction"} | how
    return Measured(
        circle, (0.05, 0.05, 0.05), np.array([0, 0, 1.0]), np.eye(3) * 1e-6, edges=edges, edge_weights=ones,
        edges_outside_px=outside, motion=motion, **given,
    )  # fmt: skip


def swing(learner, readout_s, frames=150, seed=1, marker="m", **how):
    """A marker that goes up and down, read row by row in `readout_s`."""
    rng = np.random.default_rng(seed)
    for frame in range(frames):
        rate_px = np.array([300.0, 2500.0 * np.sin(frame / 9)])
        circle = Circle(100.0 + frame, 300.0, 24.0)
        used = learner.now(INTERVAL_S).motion(rate_px, circle, 720)
        seen = Motion(np.zeros(2), rate_px * readout_s / 719).seen(24.0 * NORMAL + (circle.x_px, 300.0), 300.0)
        still = used.still(seen, 300.0) - (circle.x_px, 300.0)
        outside = np.hypot(still[:, 0], still[:, 1]) - 24.0 + 0.1 * rng.standard_normal(len(ANGLES))
        claim = claimed(circle, seen, outside, used, **how)
        learner.learn(marker, claim, rate_px, INTERVAL_S, lambda *asked: None)
    return learner


UNKNOWN = (0.0, pytest.approx(INTERVAL_S / 3**0.5))


def shutter(learner):
    optics = learner.now(INTERVAL_S)
    return optics.readout_s, optics.readout_sd_s


@pytest.mark.parametrize("readout_s", [0.0, 0.0012, 0.0036, -0.0036])
def test_the_readout_time_is_learnt_from_going_up_and_down(readout_s):
    """That of an upside-down camera is negative; a global shutter's stays zero, not nearly zero."""
    learner = OpticsLearner(0.0, None, False, 720)
    assert shutter(learner) == UNKNOWN
    learnt_s, sd_s = shutter(swing(learner, readout_s))
    assert sd_s < 0.0003
    assert abs(learnt_s - readout_s) < 4 * sd_s
    if readout_s == 0.0:
        assert learnt_s == 0.0


def test_a_few_outlines_teach_no_readout_time_and_neither_do_unclear_ones():
    assert shutter(swing(OpticsLearner(0.0, None, False, 720), 0.0036, frames=40)) == UNKNOWN
    assert shutter(swing(OpticsLearner(0.0, None, False, 720), 0.0036, visible=0.5)) == UNKNOWN
    # One that KCF or colour proposed may be a leap: its speed is not the filter's.
    assert shutter(swing(OpticsLearner(0.0, None, False, 720), 0.0036, proposer="kcf")) == UNKNOWN


def test_a_given_readout_time_is_not_learnt():
    learner = OpticsLearner(0.0, 0.002, False, 720)
    assert shutter(swing(learner, 0.0036, frames=80)) == (0.002, 0.0)


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


@lru_cache(maxsize=300)
def rolled_frame(i, readout_s):
    return bgr_frame(rolled(i, readout_s), i)


def range_errors(given_s, indices, readout_s=0.0036):
    chain = MarkerChain(MarkerSpec("m", 2 * RADIUS_M), CAMERA, ChainConfig(), readout_s=given_s)
    chain.seed(rolled_frame(0, readout_s), truth(ball(0)))
    estimates = [chain.step(rolled_frame(i, readout_s)) for i in indices]
    assert all(e.status.measured for e in estimates)
    true = np.array([np.linalg.norm(ball(i).xyz) for i in indices])
    return np.array([np.linalg.norm(e.xyz_cam_m) for e in estimates]) / true - 1


def test_a_rolling_shutter_does_not_change_the_distance():
    """Known from the start, learnt when the evidence is beyond doubt (after some ninety frames of swinging), wrong
    when taken for a global one."""
    indices = range(1, 160)
    known, learnt, wrong = (range_errors(s, indices) for s in (0.0036, None, 0.0))
    assert known.std() < 0.003
    assert learnt[100:].std() < 0.004
    assert wrong.std() > 0.008


def test_a_camera_that_hangs_upside_down_is_learnt_too():
    assert range_errors(None, range(1, 120), -0.0036)[80:].std() < 0.004


def test_a_global_shutter_is_not_taken_for_a_rolling_one():
    """What is learnt of it is nothing, so the distance neither shrinks nor grows with the vertical speed."""
    indices = range(1, 160)
    chain = MarkerChain(MarkerSpec("m", 2 * RADIUS_M), CAMERA, ChainConfig())
    chain.seed(rolled_frame(0, 0.0), truth(ball(0)))
    found = [chain.step(rolled_frame(i, 0.0)) for i in indices]
    assert chain.optics.now(INTERVAL_S).readout_s == 0.0
    error = [np.linalg.norm(e.xyz_cam_m) / np.linalg.norm(ball(e.frame_index).xyz) - 1 for e in found]
    speed = [ball(i + 0.5).xyz[1] - ball(i - 0.5).xyz[1] for i in indices]
    assert abs(np.corrcoef(error[80:], speed[80:])[0, 1]) < 0.3
