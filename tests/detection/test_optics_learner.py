"""What is learnt of a camera's shutter and lens, from outlines made by formula and from rendered frames."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from scenes import CAMERA, PERIOD_NS, RADIUS_M, Ball, ball_at, bgr_frame, picture, to_code, to_linear, truth, yuv_frame
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.look import EdgePoints, Measured
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.core.optics import AT_REST
from spheremcap.core.time import NS_PER_S
from spheremcap.detection.edge import EdgeConfig
from spheremcap.detection.optics import LENSES, OpticsLearner
from spheremcap.session import Session

INTERVAL_S = PERIOD_NS / NS_PER_S
ROWS = 720
READOUT_S = 0.0036
ANGLES = np.linspace(0, 2 * np.pi, 48, endpoint=False)
NORMAL = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
UNKNOWN = (0.0, pytest.approx(INTERVAL_S / 3**0.5))  # a readout of up to a frame interval, either way


def outline(outside, motion=AT_REST, visible=1.0, proposer="prediction", r_px=24.0):
    """A claim whose edge points lie so far outside (48,) the fitted circle, pixels."""
    circle = Circle(100.0, 300.0, r_px)
    points = r_px * NORMAL + (circle.x_px, circle.y_px)
    edges = EdgePoints(points, np.full(48, 0.1), np.arange(48), np.zeros(48), 48, 0.95)
    return Measured(
        circle, (0.1, 0.1, 0.1), np.array([0.0, 0.0, 1.0]), np.eye(3), visible, proposer, edges, np.ones(48), outside,
        motion,
    )  # fmt: skip


def nothing(way_px, softnesses, exposures):
    return None


def learner(exposure_s=0.0, readout_s=None, learn_blur=True):
    return OpticsLearner(exposure_s, readout_s, learn_blur, ROWS)


def readout_s(optics):
    now = optics.now(INTERVAL_S)
    return now.readout_s, now.readout_sd_s


def swing(frame):
    """Pixels a second, sideways and down."""
    return np.array([900.0 * np.cos(frame / 7), 2500.0 * np.sin(frame / 9)])


def watch(optics, true_s, rate=swing, frames=range(150), marker="m", light=0.0, streak=0.0, noise=0.1, **how):
    """Accepted claims of a marker under a shutter of this readout time: a residual stretch and shear by what the
    optics do not allow for yet, by `light` of any kind, and by a `streak` of a wrong length, in pixels a row."""
    rng = np.random.default_rng(frames.start)
    for frame in frames:
        rate_px = rate(frame)
        motion = optics.now(INTERVAL_S).motion(rate_px, Circle(0, 0, 24.0), ROWS)
        shear, stretch = rate_px * true_s / (ROWS - 1) - motion.lean
        stretch += light + streak * abs(rate_px[1]) / ROWS
        shear += light
        outside = 24.0 * NORMAL[:, 1] * (stretch * NORMAL[:, 1] + shear * NORMAL[:, 0])
        outside = outside + noise * rng.standard_normal(48)
        optics.learn(marker, outline(outside, motion, **how), rate_px, INTERVAL_S, nothing)


# -- readout, by formula ---------------------------------------------------------------------------


@pytest.mark.parametrize("true_s", [0.0012, READOUT_S, -0.0012, -READOUT_S])
def test_the_readout_time_is_learnt_from_going_up_and_down_upside_down_too(true_s):
    optics = learner()
    assert readout_s(optics) == UNKNOWN
    watch(optics, true_s, frames=range(600))
    found, sd = readout_s(optics)
    assert 0 < sd < 0.0003
    assert abs(found - true_s) < 4 * sd


@pytest.mark.parametrize("light", [0.0, 0.02])
@pytest.mark.parametrize("streak", [0.0, 0.01])
def test_a_global_shutter_is_not_taken_for_a_rolling_one_whatever_the_light(light, streak):
    for start in (0, 1000, 2000, 3000):
        optics = learner()
        watch(optics, 0.0, frames=range(start, start + 200), light=light, streak=streak)
        assert readout_s(optics)[0] == 0.0


@pytest.mark.parametrize("true_s", [0.0, READOUT_S])
def test_a_marker_that_only_goes_one_way_cannot_tell(true_s):
    """Its lean and a streak or a shadow that grows with speed look the same."""
    optics = learner()
    watch(optics, true_s, rate=lambda i: np.array([500.0 + 300 * np.sin(i / 5), 1500.0 + 900 * np.sin(i / 9)]))
    assert readout_s(optics)[0] == 0.0


def test_uneven_light_does_not_bend_what_is_learnt():
    optics = learner()
    watch(optics, READOUT_S, light=0.02, streak=0.01)
    found, sd = readout_s(optics)
    assert abs(found - READOUT_S) < 4 * sd


def test_sixty_claims_are_the_least_that_is_believed():
    optics = learner()
    watch(optics, READOUT_S, frames=range(59), noise=0.01)
    assert readout_s(optics) == UNKNOWN
    watch(optics, READOUT_S, frames=range(59, 64), noise=0.01)  # looked at after every eighth
    assert readout_s(optics)[0] == pytest.approx(READOUT_S, rel=0.05)


def test_a_readout_longer_than_frames_are_apart_is_not_believed():
    optics = learner()
    watch(optics, 1.3 * INTERVAL_S, rate=lambda i: 0.3 * swing(i))
    found, sd = readout_s(optics)
    assert found == 0.0
    assert sd == pytest.approx(INTERVAL_S / 3**0.5)


def test_two_markers_of_a_camera_learn_one_readout_sooner_than_either():
    """Each has its own light: what they agree on is the shutter."""
    alone, together = learner(), learner()
    watch(alone, READOUT_S, frames=range(80), light=0.02)
    watch(together, READOUT_S, frames=range(80), light=0.02)
    watch(together, READOUT_S, frames=range(400, 480), marker="other", light=-0.03)
    found, sd = readout_s(together)
    assert sd < 0.85 * readout_s(alone)[1]
    assert abs(found - READOUT_S) < 4 * sd


@pytest.mark.parametrize("how", [{"visible": 0.59}, {"proposer": "colour"}], ids=["part hidden", "found anew"])
def test_a_claim_that_shows_too_little_or_was_not_foreseen_says_nothing_of_the_readout(how):
    optics = learner()
    watch(optics, READOUT_S, **how)
    assert readout_s(optics) == UNKNOWN


@pytest.mark.parametrize("given_s", [0.0, 0.002, -0.002])
def test_a_given_readout_is_never_changed(given_s):
    optics = learner(readout_s=given_s)
    watch(optics, READOUT_S)
    assert readout_s(optics) == (given_s, 0.0)


# -- exposure, by formula --------------------------------------------------------------------------


def misfit_least_at(share, softness=1.6, gain=0.5, scatter=0.0, seed=0):
    """As outlines do that are blurred over this share of the way, through a lens of this softness."""
    rng = np.random.default_rng(seed)

    def misfits(way_px, softnesses, exposures):
        soft, share_of = np.log(np.array(softnesses) / softness)[:, None], np.array(exposures)[None]
        found = gain * (share_of - share) ** 2 + 4 * gain * soft**2 - 6.0
        return found + scatter * rng.standard_normal(found.shape)

    return misfits


def move(optics, share, way_px=(0.0, 12.0), claims=40, visible=1.0, **how):
    rate_px = np.array(way_px) / INTERVAL_S
    misfits = misfit_least_at(share, **how)
    for _ in range(claims):
        optics.learn("m", outline(np.zeros(48), visible=visible), rate_px, INTERVAL_S, misfits)
    return optics.now(INTERVAL_S).exposure_s / INTERVAL_S


@pytest.mark.parametrize("share", [0.15, 0.25, 0.4, 0.5, 0.6, 0.75])
def test_the_exposure_is_the_one_that_explains_the_outlines_best(share):
    assert move(learner(learn_blur=False), share) == pytest.approx(share, abs=0.02)


def test_a_sharp_outline_has_no_exposure_to_learn():
    assert move(learner(learn_blur=False), 0.0) == 0.0
    for seed in range(20):  # nor has noise
        assert move(learner(learn_blur=False), 0.0, gain=0.1, scatter=0.005, seed=seed) == 0.0


def test_two_looks_are_too_few():
    assert move(learner(learn_blur=False), 0.5, claims=2) == 0.0
    assert move(learner(learn_blur=False), 0.5, claims=3) == pytest.approx(0.5, abs=0.02)


def test_a_slow_marker_is_looked_at_seldom_and_a_part_of_one_never():
    asked = []

    def misfits(way_px, softnesses, exposures):
        asked.append(way_px)
        return misfit_least_at(0.5)(way_px, softnesses, exposures)

    def watched(way_px, visible=1.0):
        asked.clear()
        optics = learner()
        for _ in range(40):
            optics.learn(
                "m", outline(np.zeros(48), visible=visible), np.array(way_px) / INTERVAL_S, INTERVAL_S, misfits
            )
        return len(asked)

    assert watched((3.0, 4.0)) == 3  # the 3rd, the 8th, the 24th
    assert watched((3.1, 4.1)) == 7  # the 1st to the 3rd, the 8th, the 12th, the 24th, the 36th
    assert watched((3.1, 4.1), visible=0.59) == 0
    assert watched((90.0, 0.0)) == 0  # a streak so long that its blur is bounded tells no exposure


def test_a_given_exposure_is_never_changed():
    optics = learner(exposure_s=0.001)
    move(optics, 0.75)
    assert optics.now(INTERVAL_S).exposure_s == 0.001


def test_an_exposure_of_other_frames_is_forgotten_by_and_by():
    optics = learner(learn_blur=False)
    assert move(optics, 0.15) == pytest.approx(0.15, abs=0.02)
    assert move(optics, 0.75, claims=64 * 60) == pytest.approx(0.75, abs=0.1)


# -- softness, by formula --------------------------------------------------------------------------


def stand(optics, misfits, claims=3):
    for _ in range(claims):
        optics.learn("m", outline(np.zeros(48)), np.zeros(2), INTERVAL_S, misfits)
    return optics.now(INTERVAL_S).softness


def test_softness_is_the_seeds_until_three_clear_claims_say_more():
    optics = learner()
    assert optics.now(INTERVAL_S).softness == 1.0
    optics.seeded(outline(np.zeros(48), replace(AT_REST, softness=2.4)))
    assert optics.now(INTERVAL_S).softness == 2.4
    assert stand(optics, misfit_least_at(0.0), claims=2) == 2.4
    assert stand(optics, misfit_least_at(0.0), claims=1) == 1.6
    optics.seeded(outline(np.zeros(48), replace(AT_REST, softness=3.6)))  # a correction does not begin anew
    assert optics.now(INTERVAL_S).softness == 1.6


def test_a_seed_of_which_little_is_seen_says_nothing_of_softness():
    optics = learner()
    optics.seeded(outline(np.zeros(48), replace(AT_REST, softness=2.4), visible=0.6))
    assert optics.now(INTERVAL_S).softness == 1.0


@pytest.mark.parametrize("softness", LENSES)
def test_the_softness_is_the_one_that_explains_the_outlines_best(softness):
    assert stand(learner(), misfit_least_at(0.0, softness, gain=20.0)) == softness


def test_of_lenses_about_as_good_a_sharper_one_is_taken():
    assert stand(learner(), misfit_least_at(0.0, 2.4, gain=0.02)) < 2.4


def test_softness_and_exposure_are_learnt_together():
    """Each alone would do for the other: a soft lens for a long exposure, as far as one direction tells."""
    optics = learner()
    assert move(optics, 0.5) == pytest.approx(0.5, abs=0.03)
    assert optics.now(INTERVAL_S).softness == 1.6


def test_a_given_exposure_is_the_only_one_that_is_tried():
    asked = []

    def misfits(way_px, softnesses, exposures):
        asked.append(tuple(exposures))
        return misfit_least_at(0.5)(way_px, softnesses, exposures)

    optics = learner(exposure_s=0.3 * INTERVAL_S)
    for _ in range(3):
        optics.learn("m", outline(np.zeros(48)), np.array([0.0, 12.0]) / INTERVAL_S, INTERVAL_S, misfits)
    assert asked == [(pytest.approx(0.3),)] * 3
    assert optics.now(INTERVAL_S).softness == 1.6


def test_without_learning_the_lens_is_as_the_settings_say():
    assert stand(learner(learn_blur=False), misfit_least_at(0.0, 2.4, gain=20.0), claims=10) == 1.0


# -- rendered --------------------------------------------------------------------------------------

LINEAR = to_linear(np.arange(256))
SHARES = (np.arange(7) + 0.5) / 7 - 0.5


def swinging(i, x=0.0):
    """Up and down by 12 px a frame at most."""
    return Ball((x, 0.1 * float(np.sin(2 * np.pi * 4.0 * i * INTERVAL_S)), 0.9))


@lru_cache(maxsize=200)
def blurred(i, share, x=0.0):
    """The picture while the shutter is open for this share of the frame interval, mixed in linear light."""
    light = np.mean(
        [LINEAR[picture(swinging(i + share * k, x), noise=0)] for k in (SHARES if share else [0.0])], axis=0
    )
    noise = np.random.default_rng(i).normal(0, 2, light.shape)
    return np.clip(np.rint(to_code(light) + noise), 0, 255).astype(np.uint8)


def softened(ball, sigma_px, seed):
    """The picture through a lens this much softer than the scene's own."""
    light = LINEAR[picture(ball, noise=0)]
    light = cv2.GaussianBlur(light, (0, 0), sigma_px) if sigma_px else light
    noise = np.random.default_rng(seed).normal(0, 2, light.shape)
    return np.clip(np.rint(to_code(light) + noise), 0, 255).astype(np.uint8)


def rolled(i, a_readout_s):
    """The picture with each row as it was when it was read."""
    middle = truth(swinging(i)).y_px
    rate_px = (truth(swinging(i + 0.5)).y_px - truth(swinging(i - 0.5)).y_px) / INTERVAL_S
    rows = np.arange(CAMERA.height_px, dtype=np.float32)
    late = rows - rate_px * a_readout_s / (CAMERA.height_px - 1) * (rows - middle)
    y = np.repeat(late[:, None], CAMERA.width_px, axis=1).astype(np.float32)
    x = np.repeat(np.arange(CAMERA.width_px, dtype=np.float32)[None], CAMERA.height_px, axis=0)
    return cv2.remap(picture(swinging(i), noise_seed=i), x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def tracked(image, count, **how):
    """Followed on 4:2:0 video, which is what the edges' model of chroma is made for."""
    chain = MarkerChain(MarkerSpec("m", 2 * RADIUS_M), CAMERA, ChainConfig(), **how)
    estimates = [chain.seed(yuv_frame(image(0), 0), truth(swinging(0)))]
    estimates += [chain.step(yuv_frame(image(i), i)) for i in range(1, count)]
    assert all(e.status.measured for e in estimates)
    return chain, estimates


def range_errors(estimates):
    return np.array([np.linalg.norm(e.xyz_cam_m) / np.linalg.norm(swinging(e.frame_index).xyz) - 1 for e in estimates])


@pytest.mark.parametrize(("share", "within"), [(0.0, 1e-9), (0.6, 0.1), (0.9, 0.1)])
def test_exposure_is_learnt_on_a_blurred_marker_and_not_on_a_sharp_one(share, within):
    chain, _ = tracked(lambda i: blurred(i, share), 28, readout_s=0.0)
    assert chain.optics.now(INTERVAL_S).exposure_s / INTERVAL_S == pytest.approx(share, abs=within)


@pytest.mark.parametrize("true_s", [READOUT_S, -READOUT_S, 0.0])
def test_readout_is_learnt_on_rolled_frames_and_left_at_zero_on_global_ones(true_s):
    chain, estimates = tracked(lambda i: rolled(i, true_s), 230)
    found = chain.optics.now(INTERVAL_S).readout_s
    assert found == (0.0 if true_s == 0 else pytest.approx(true_s, rel=0.25))
    assert range_errors(estimates[190:]).std() < 0.0065


def test_two_markers_of_one_camera_share_what_is_learnt():
    balls = {"left": -0.1, "right": 0.1}

    def frames():
        for i in range(16):
            both = np.concatenate([blurred(i, 0.6, -0.1)[:, :160], blurred(i, 0.6, 0.1)[:, 160:]], axis=1)
            yield yuv_frame(both, i)

    markers = tuple(MarkerSpec(name, 2 * RADIUS_M) for name in balls)
    session = Session(CAMERA, markers, [Seed(n, 0, truth(swinging(0, x))) for n, x in balls.items()])
    list(session.run(frames()))
    left, right = (lane.chain.optics.now(INTERVAL_S).exposure_s for lane in session._lanes.values())
    assert left == right == pytest.approx(0.6 * INTERVAL_S, rel=0.15)


@pytest.mark.parametrize(("sigma_px", "learn", "softness"), [(0, True, 1.6), (2.5, True, 3.6), (2.5, False, 1.0)])
def test_a_lens_out_of_focus_is_found_to_be_soft(sigma_px, learn, softness):
    ball = ball_at(160, 120, 12)
    chain = MarkerChain(MarkerSpec("m", 2 * RADIUS_M), CAMERA, ChainConfig(edge=EdgeConfig(learn_blur=learn)))
    chain.seed(yuv_frame(softened(ball, sigma_px, 0)), truth(ball))
    for i in range(1, 14):
        assert chain.step(yuv_frame(softened(ball, sigma_px, i), i)).status is Status.VERIFIED
    assert chain.optics.now(INTERVAL_S).softness == softness


def test_a_doubted_claim_teaches_nothing(monkeypatch):
    """A ball alike a leap away: it has an outline, a place and six votes, but not the marker's."""
    taught = []
    learn = OpticsLearner.learn

    def spied(self, marker, claim, *rest):
        taught.append(claim)
        learn(self, marker, claim, *rest)

    monkeypatch.setattr(OpticsLearner, "learn", spied)
    chain = MarkerChain(MarkerSpec("m", 2 * RADIUS_M), CAMERA, ChainConfig())
    ball, away = ball_at(120, 120, 15), ball_at(150, 120, 15)
    estimates = [chain.seed(bgr_frame(picture(ball), 0), truth(ball))]
    for i in range(1, 13):
        estimates.append(chain.step(bgr_frame(picture(ball if i < 10 else away, noise_seed=i), i)))
    doubted = [e for e in estimates if e.reasons]
    assert len(doubted) >= 3
    assert all(e.claim is not None for e in doubted)
    assert [c.circle for c in taught] == [e.circle for e in estimates if e.status is Status.VERIFIED]
