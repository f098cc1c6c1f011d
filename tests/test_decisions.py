"""What chain and session decide and hand out, on rendered frames: each rule where only it makes the difference."""

from copy import deepcopy
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache

import numpy as np
import pytest

from scenes import (
    BLUE,
    CAMERA,
    COUNTED,
    GREEN,
    ORANGE,
    PERIOD_NS,
    RADIUS_M,
    Ball,
    Cover,
    ball_at,
    bgr_frame,
    picture,
    truth,
)
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.frame import BgrFrame
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.core.presets import PRESETS
from spheremcap.core.time import NS_PER_S
from spheremcap.core.vote import Verdict
from spheremcap.detection import acquire
from spheremcap.detection.optics import OpticsLearner
from spheremcap.errors import UsageError
from spheremcap.positioning.kalman import KalmanConfig
from spheremcap.positioning.sphere import PositionConfig
from spheremcap.session import Session, SessionConfig
from spheremcap.tracking import follower
from spheremcap.verification.matching import MATCHERS
from spheremcap.verification.reacquired import Reacquired

SPEC = MarkerSpec("wrist", 2 * RADIUS_M)
HERO4 = PRESETS["gopro-hero4-black-720p240-narrow"]
INTERVAL_S = PERIOD_NS / NS_PER_S


def gliding(i):
    """To the right at 240 px/s and a little nearer all the time."""
    return Ball((-0.05 + 0.0015 * i, 0.01, 0.9 - 0.001 * i))


@lru_cache(maxsize=100)
def seen(i):
    return picture(gliding(i), noise_seed=i)


@lru_cache(maxsize=100)
def empty(i):
    return picture(noise_seed=i)


def seeded(ball=gliding, image=seen, config=None, camera=CAMERA, **how):
    chain = MarkerChain(SPEC, camera, config or ChainConfig(policy=COUNTED), **how)
    chain.seed(bgr_frame(image(0), 0), truth(ball(0), camera))
    return chain


def steps(chain, indices, image=seen):
    return [chain.step(bgr_frame(image(i), i)) for i in indices]


@pytest.fixture
def cuts(monkeypatch):
    """Sizes (columns, rows) of all patches that are cut from here on."""
    sizes = []
    for module in (follower, acquire):
        cut = module.cut_bgr

        def spied(*given, cut=cut):
            sizes.append(given[-2:])
            return cut(*given)

        monkeypatch.setattr(module, "cut_bgr", spied)
    return sizes


def assert_same(a, b, where="result"):
    """Every field of two results, down to the last bit."""
    assert type(a) is type(b), where
    if isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b, err_msg=where)
    elif isinstance(a, tuple | list):
        assert len(a) == len(b), where
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}[{k}]")
    elif is_dataclass(a):
        for f in fields(a):
            assert_same(getattr(a, f.name), getattr(b, f.name), f"{where}.{f.name}")
    else:
        assert a == b, where


# -- velocity --------------------------------------------------------------------------------------


def test_velocity_is_none_until_two_measurements_say_something_of_it():
    chain = MarkerChain(SPEC, CAMERA, ChainConfig())
    first = chain.seed(bgr_frame(seen(0), 0), truth(gliding(0)))
    assert first.status is Status.SEEDED
    assert first.xyz_cam_m is not None
    assert first.velocity_cam_mps is None
    followed = steps(chain, range(1, 8))
    assert all(e.velocity_cam_mps is not None for e in followed)
    np.testing.assert_allclose(followed[-1].velocity_cam_mps[:2], [0.0015 / INTERVAL_S, 0], atol=0.1)
    again = chain.seed(bgr_frame(seen(8), 8), truth(gliding(8)))
    assert again.velocity_cam_mps is None


def test_a_frame_missed_right_after_the_seed_has_no_velocity_either():
    (missed,) = steps(seeded(), [1], empty)
    assert missed.status is Status.ESTIMATED
    assert missed.xyz_cam_m is not None
    assert missed.velocity_cam_mps is None


def test_velocity_is_none_where_a_lost_marker_is_found_again_and_known_from_the_next_frame_on():
    chain = seeded()
    steps(chain, range(1, 8))
    assert steps(chain, range(8, 14), empty)[-1].status is Status.LOST
    found = [e for e in steps(chain, range(14, 20)) if e.status is Status.VERIFIED]
    assert found[0].velocity_cam_mps is None
    assert all(e.velocity_cam_mps is not None for e in found[1:])
    np.testing.assert_allclose(found[-1].velocity_cam_mps[:2], [0.0015 / INTERVAL_S, 0], atol=0.2)


# -- lost ------------------------------------------------------------------------------------------


def near(i):
    return ball_at(90, 120, 30)


def swollen(i):
    """The marker; nothing; then two balls, each three tenths larger, one in its place and one elsewhere."""
    if i < 5:
        return picture(near(i), noise_seed=i)
    if i < 11:
        return empty(i)
    return picture(*(Ball(ball_at(x, 120, 30).xyz, ORANGE, 1.3 * RADIUS_M) for x in (90, 210)), noise_seed=i)


def test_lost_frames_carry_votes_and_reasons_of_the_best_candidate():
    chain = seeded(near, swollen)
    steps(chain, range(1, 11), swollen)
    assert chain.status is Status.LOST
    for i in range(11, 16):
        frame = bgr_frame(swollen(i), i)
        chain.predict(frame)
        looks = chain.look(frame)
        assert len(looks) == 2
        best = max(looks, key=lambda look: look.vote_sum)
        other_way_round = deepcopy(chain).settle(frame, looks[::-1])
        estimate = chain.settle(frame, looks)
        assert_same(estimate, other_way_round)
        assert estimate.status is Status.LOST
        assert [v.matcher for v in estimate.votes] == list(MATCHERS)
        assert (estimate.votes, estimate.vote_sum, estimate.verdict) == (best.votes, best.vote_sum, best.verdict)
        assert estimate.vote_sum > max(look.vote_sum for look in looks if look is not best)
        assert estimate.claim == best.claim.circle
        assert estimate.reasons == best.doubts != ()
        assert estimate.proposals == best.proposals != ()
        assert estimate.search == best.patch.window


def test_misses_grow_by_one_a_frame_however_many_candidates_there_were():
    chain = seeded(near, swollen)
    steps(chain, range(1, 5), swollen)
    assert chain.misses == 0
    misses = []
    for i in range(5, 16):
        steps(chain, [i], swollen)
        misses.append(chain.misses)
    assert misses == list(range(1, 12))


def test_a_verified_frame_ends_the_count_of_misses():
    chain = seeded()
    counts = []
    for i in range(1, 19):
        steps(chain, [i], seen if i % 4 == 0 or i < 4 else empty)
        counts.append(chain.misses)
    assert counts[3:] == [0, 1, 2, 3] * 3 + [0, 1, 2]
    assert chain.status is Status.ESTIMATED
    again = chain.seed(bgr_frame(seen(19), 19), truth(gliding(19)))
    assert (again.status, chain.misses) == (Status.SEEDED, 0)


def test_where_nothing_was_found_the_reason_says_so():
    chain = seeded()
    missed = steps(chain, range(1, 9), empty)
    assert [e.reasons for e in missed] == [("no outline",)] * 5 + [("not found",)] * 3
    assert all(e.verdict is Verdict.REJECTED for e in missed[:5])
    assert missed[-1].votes == ()


def test_looking_changes_nothing():
    chain, other = seeded(), seeded()
    for i in range(1, 6):
        frame = bgr_frame(seen(i), i)
        chain.predict(frame)
        for _ in range(3):
            looks = chain.look(frame)
        assert_same(chain.settle(frame, looks), other.step(bgr_frame(seen(i), i)))


def test_a_marker_found_again_says_nothing_of_the_optics_until_it_is_foreseen(monkeypatch):
    taught = []
    monkeypatch.setattr(OpticsLearner, "learn", lambda self, marker, claim, *rest: taught.append(claim.circle))
    chain = seeded()
    estimates = steps(chain, range(1, 8)) + steps(chain, range(8, 14), empty) + steps(chain, range(14, 20))
    found = [e.circle for e in estimates if e.status is Status.VERIFIED]
    again = next(e.circle for e in estimates if e.frame_index >= 14 and e.status is Status.VERIFIED)
    assert taught == [circle for circle in found if circle != again]


def test_what_is_thrown_right_after_the_seed_is_found_on_that_frame_and_teaches_nothing(monkeypatch):
    """At 30 frames a second, three radii away: no motion was known, so that nothing says what blurred it."""
    taught = []
    monkeypatch.setattr(OpticsLearner, "learn", lambda self, marker, claim, *rest: taught.append(claim.circle))

    def ball(i):
        return ball_at(50 + 70 * i, 120, 16)

    chain = MarkerChain(SPEC, CAMERA, ChainConfig())
    frames = [BgrFrame(i, i * 33_333_333, picture(ball(i), noise_seed=i)) for i in range(4)]
    chain.seed(frames[0], truth(ball(0)))
    found = [chain.step(frame) for frame in frames[1:]]
    assert [e.status for e in found] == [Status.VERIFIED] * 3
    assert all(e.circle.dice(truth(ball(e.frame_index))) > 0.97 for e in found)
    assert found[0].proposer in ("acquire", "colour")
    assert found[0].circle not in taught
    assert found[2].circle in taught


def test_a_streak_that_is_not_as_the_filter_expects_is_followed_all_the_same():
    """A stated exposure of a whole frame interval, and pictures without any: no outline fits a streak of 1.5 radii, and
    only the place is right."""

    def ball(i):
        return ball_at(30 + 24 * i, 120, 16)

    chain = MarkerChain(SPEC, CAMERA, ChainConfig(), exposure_s=1 / 30)
    frames = [BgrFrame(i, i * 33_333_333, picture(ball(i), noise_seed=i)) for i in range(10)]
    chain.seed(frames[0], truth(ball(0)))
    found = [chain.step(frame) for frame in frames[1:]]
    assert {e.status for e in found} == {Status.VERIFIED}
    assert {e.proposer for e in found[2:]} <= {"prediction", "kcf", "colour", "hough"}
    assert (
        min(e.circle.dice(truth(ball(e.frame_index))) for e in found) > 0.9
    )  # the nearest exposure is not the true one


def test_what_a_lost_marker_is_found_as_has_to_be_confirmed_and_a_followed_one_has_not(monkeypatch):
    asked = []

    def never(self, looks):
        asked.extend(looks)
        return [replace(look, doubts=("unconfirmed",)) for look in looks]

    chain = seeded()
    monkeypatch.setattr(Reacquired, "confirmed", never)
    estimates = steps(chain, range(1, 8)) + steps(chain, range(8, 14), empty)
    assert all(e.status is Status.VERIFIED for e in estimates[:7])
    back = steps(chain, range(14, 20))
    assert {e.status for e in back} == {Status.LOST}
    assert {e.reasons for e in back} == {("unconfirmed",)}
    assert asked


@pytest.mark.parametrize(("came_at", "it_is"), [(4, False), (12, True)])
def test_what_stood_there_when_the_marker_was_last_seen_is_not_it(came_at, it_is):
    """Another ball just like it lies beside the way from the fourth frame on; or comes when the marker has gone."""
    beside = ball_at(210, 190, 16)

    def image(i):
        balls = [gliding(i)] if i < 8 else []
        return picture(*balls, *([beside] if i >= came_at else []), noise_seed=i)

    chain = seeded(image=image)
    found = steps(chain, range(1, 30), image)
    assert all(e.status is Status.VERIFIED for e in found[:7])
    taken = [e for e in found[7:] if e.status is Status.VERIFIED]
    assert bool(taken) is it_is
    assert any("stood there" in e.reasons for e in found[7:]) is not it_is


@pytest.mark.parametrize(
    ("cover", "reasons"),
    [(None, ()), (Cover(100, 60, 165, 180), ("little outline",)), (Cover(100, 60, 220, 180), ("no outline",))],
)
def test_a_seed_says_how_little_of_an_outline_there_was(cover, reasons):
    ball = ball_at(160, 120, 22)
    image = picture(ball, covers=(cover,) if cover else (), noise_seed=1)
    chain = MarkerChain(SPEC, CAMERA, ChainConfig())
    estimate = chain.seed(bgr_frame(image, 0), truth(ball))
    assert (estimate.status, estimate.reasons) == (Status.SEEDED, reasons)


def test_what_is_seeded_on_nothing_is_not_verified_on_nothing():
    def wall(i):
        """Soft shadows and noise."""
        random = np.random.default_rng(i)
        shadows = 130 + 12 * np.sin(np.arange(320) / 23)[None, :, None] + 9 * np.cos(np.arange(240) / 17)[:, None, None]
        return np.clip(shadows + random.normal(0, 3, (240, 320, 3)), 0, 255).astype(np.uint8)

    for x, y in ((60, 50), (160, 120), (250, 60), (80, 180)):
        chain = MarkerChain(SPEC, CAMERA, ChainConfig())
        assert chain.seed(bgr_frame(wall(0), 0), Circle(x, y, 18.0)).reasons == ("no outline",)
        assert not any(e.status.measured for e in steps(chain, range(1, 9), wall))


# -- bounds before work ----------------------------------------------------------------------------

SPEED_MPS = 4.0
BEFORE = 8


def rushing(t_s):
    return Ball((-0.2 + SPEED_MPS * t_s, 0.02, 1.2))


@lru_cache(maxsize=20)
def rush(i):
    return picture(rushing(i * INTERVAL_S), camera=HERO4, noise_seed=i)


@pytest.mark.parametrize("gap_s", [1.0, 5.0])
@pytest.mark.parametrize("exposure_s", [0.0, 0.002])
def test_a_gap_in_the_stamps_is_a_miss_and_costs_nothing(gap_s, exposure_s, cuts):
    """The built-in camera; a marker at 4 m/s would be far out of its picture, where the lens model means nothing."""
    chain = MarkerChain(SPEC, HERO4, ChainConfig(), exposure_s=exposure_s)
    chain.seed(BgrFrame(0, 0, rush(0)), truth(rushing(0), HERO4))
    for i in range(1, BEFORE):
        assert chain.step(BgrFrame(i, i * PERIOD_NS, rush(i))).status is Status.VERIFIED
    cuts.clear()
    stamp_ns = BEFORE * PERIOD_NS + int(gap_s * NS_PER_S)
    for k in range(4):
        estimate = chain.step(BgrFrame(BEFORE + k, stamp_ns + k * PERIOD_NS, rush(BEFORE + k)))
        assert not estimate.status.measured
        assert estimate.reasons
        assert chain.misses == k + 1
    for columns, rows in cuts:
        assert columns <= HERO4.width_px
        assert rows <= HERO4.height_px


def test_a_marker_foreseen_outside_the_picture_is_a_miss_before_any_patch_is_cut(cuts):
    chain = MarkerChain(SPEC, CAMERA, ChainConfig(kalman=KalmanConfig(acceleration_mps2=5)))

    def leaving(i):
        return ball_at(230 + 9 * i, 120, 13)

    frames = [bgr_frame(picture(leaving(i), noise_seed=i), i) for i in range(9)]
    chain.seed(frames[0], truth(leaving(0)))
    for frame in frames[1:]:
        assert chain.step(frame).status is Status.VERIFIED
    cuts.clear()
    late = BgrFrame(9, 16 * PERIOD_NS, empty(9))  # seven frames were dropped: it is 60 px out of the picture by now
    estimate = chain.step(late)
    assert cuts == []
    assert not estimate.status.measured
    assert estimate.status is Status.OUT_OF_VIEW
    assert estimate.reasons in {("out of view",), ("not found",)}
    assert (estimate.claim, estimate.search, estimate.votes) == (None, None, ())


WIDE = Camera(1280, 720, 1400.0, 1400.0, 639.5, 359.5)


@pytest.mark.parametrize("r_px", [24, 240])
def test_a_patch_is_as_large_for_a_near_marker_as_for_a_far_one(r_px, cuts):
    def ball(i):
        return ball_at(640 + 0.05 * r_px * i, 360, r_px, camera=WIDE)

    def image(i):
        return picture(*([ball(i)] if i < 3 else []), camera=WIDE, noise_seed=i)

    chain = seeded(ball, image, camera=WIDE)
    followed = steps(chain, range(1, 3), image)
    assert [e.status for e in followed] == [Status.VERIFIED] * 2
    steps(chain, range(3, 7), image)  # the reach grows while it is missed
    assert len(cuts) == 7 + 4  # where it is missed it is sought all around, on a reduced picture
    assert max(max(size) for size in cuts) <= 160


# -- a person's word -------------------------------------------------------------------------------


def standing(i):
    return ball_at(120, 120, 15)


def passing(i):
    return ball_at(200 - 0.1 * i, 120, 15)


def two(i):
    return bgr_frame(picture(standing(i), passing(i), noise_seed=i), i)


PAIR = (SPEC, MarkerSpec("elbow", 2 * RADIUS_M))


def test_a_persons_seed_wins_over_another_marker_that_sits_at_its_place():
    """Both were shown the same ball by mistake; the correction is believed, and the other one has to go."""
    at_once = Seed("elbow", 0, truth(standing(0)))
    correction = Seed("wrist", 4, truth(standing(4)))
    seeds = (Seed("wrist", 0, truth(passing(0))), at_once, correction)
    results = list(Session(CAMERA, PAIR, seeds).run(two(i) for i in range(8)))
    wrist, elbow = ([r.estimates[k] for r in results] for k in (0, 1))
    assert [e.status for e in elbow[:4]] == [Status.SEEDED] + [Status.VERIFIED] * 3
    assert wrist[4].status is Status.SEEDED
    assert wrist[4].circle.distance(truth(standing(4))) < 0.5
    assert elbow[4].reasons == ("covered",)
    assert not any(e.status.measured for e in elbow[4:])
    assert [e.status for e in wrist[5:]] == [Status.VERIFIED] * 3


def test_a_marker_that_is_only_estimated_hides_nobody():
    """The nearer one is gone; the other one crosses the place where the filter still has it."""

    def other(i):
        return ball_at(120 - 24 + 3 * i, 120, 14, rgb=GREEN)

    def image(i):
        return picture(other(i), *([standing(i)] if i < 6 else []), noise_seed=i)

    seeds = (Seed("wrist", 0, truth(standing(0))), Seed("elbow", 0, truth(other(0))))
    results = list(Session(CAMERA, PAIR, seeds).run(bgr_frame(image(i), i) for i in range(10)))
    wrist, elbow = ([r.estimates[k] for r in results] for k in (0, 1))
    assert [e.status for e in wrist[6:]] == [Status.ESTIMATED] * 4
    crossing = [
        e for e, w in zip(elbow[6:], wrist[6:], strict=True) if w.circle.dice(truth(other(e.frame_index))) > 0.8
    ]
    assert len(crossing) >= 3
    for estimate in crossing:
        assert "covered" not in estimate.reasons
    assert any(e.status is Status.VERIFIED for e in crossing)


def test_a_seed_on_a_frame_that_never_comes_asks_for_another_and_seeds_nothing():
    seeds = (Seed("wrist", 0, truth(standing(0))), Seed("wrist", 4, truth(standing(4))))
    frames = [two(i) for i in (0, 1, 2, 3, 6, 7, 8)]
    results = list(Session(CAMERA, PAIR[:1], seeds).run(iter(frames)))
    assert [e.status for r in results for e in r.estimates] == [Status.SEEDED] + [Status.VERIFIED] * 6
    (request,) = [q for r in results for q in r.requests]
    assert results[4].requests == (request,)
    assert (request.marker, request.frame_index, request.raised_at_frame_index) == ("wrist", 6, 6)
    assert "frame 4 did not come" in request.reason


def test_a_first_seed_that_never_comes_leaves_its_marker_out():
    results = list(Session(CAMERA, PAIR[:1], [Seed("wrist", 1, truth(standing(1)))]).run([two(0), two(2), two(3)]))
    assert all(r.estimates == () for r in results)
    assert [q.raised_at_frame_index for r in results for q in r.requests] == [2]


@pytest.mark.parametrize(
    ("seeds", "words"),
    [
        ([("wrist", 0, 100, 100, 12), ("wrist", 5, 90, 90, 12), ("wrist", 5, 91, 90, 12)], "two seeds of wrist"),
        ([("wrist", 0, 100, 100, 12), ("knee", 5, 90, 90, 12)], "'knee', which is not among wrist"),
        ([("wrist", 0, 100, 100, 12), ("wrist", 9, 320, 90, 12)], "outside the 320x240 picture"),
        ([("wrist", 0, 100, 100, 12), ("wrist", 9, 90, -0.1, 12)], "outside the 320x240 picture"),
        ([("wrist", 0, 100, 100, 12), ("wrist", 9, 90, 239.1, 12)], "outside the 320x240 picture"),
        ([("wrist", 0, 100, 100, 0.5)], "outside the 320x240 picture"),
        ([("wrist", 0, 100, 100, 321)], "outside the 320x240 picture"),
        ([], "'wrist' has no seed"),
    ],
)
def test_seeds_that_cannot_be_are_refused_before_the_first_frame(seeds, words):
    with pytest.raises(UsageError, match=words):
        Session(CAMERA, PAIR[:1], [Seed(name, i, Circle(x, y, r)) for name, i, x, y, r in seeds])


def test_seeds_at_the_very_border_are_taken():
    for x, y in ((0, 0), (319, 239)):
        Session(CAMERA, PAIR[:1], [Seed("wrist", 0, Circle(x, y, 1)), Seed("wrist", 1, Circle(x, y, 320))])


# -- what is reported and what steers --------------------------------------------------------------


def test_the_thesis_formula_reports_and_never_steers():
    """Its metres are another matter; circles, statuses and the filter are those of the edges."""
    by_edges = seeded(config=ChainConfig(position=PositionConfig(formula="edges")))
    by_thesis = seeded(config=ChainConfig(position=PositionConfig(formula="thesis")))
    for i in range(1, 16):
        image = empty if i in (8, 9) else seen
        (a,), (b,) = steps(by_edges, [i], image), steps(by_thesis, [i], image)
        assert_same(replace(a, xyz_cam_m=None, covariance_m2=None), replace(b, xyz_cam_m=None, covariance_m2=None))
        np.testing.assert_array_equal(by_edges.moment.state, by_thesis.moment.state)
        np.testing.assert_array_equal(by_edges.moment.covariance, by_thesis.moment.covariance)
        if a.status.measured:
            assert np.linalg.norm(a.xyz_cam_m - b.xyz_cam_m) > 0.05


def test_the_estimated_circle_is_the_one_as_seen():
    """A rolling shutter stretches what goes down; the filter's circle is given out as the picture would have it."""
    readout_s = 0.0036

    def falling(i):
        return ball_at(160, 50 + 7 * i, 15)

    def image(i):
        return picture(falling(i), noise_seed=i) if i < 12 else empty(i)

    chain = seeded(falling, image, readout_s=readout_s)
    steps(chain, range(1, 12), image)
    (estimate,) = steps(chain, [12], image)
    assert estimate.status is Status.ESTIMATED
    lean = 7 / INTERVAL_S * readout_s / (CAMERA.height_px - 1)
    under_a_global_one = chain.whereabouts.image().r_px
    assert lean > 0.02
    assert estimate.circle.r_px / under_a_global_one - 1 == pytest.approx(1 / np.sqrt(1 - lean) - 1, rel=0.15)


def test_smoothed_covariance_has_the_focal_lengths_share():
    loose = replace(CAMERA, focal_sd=0.03)
    session = Session(loose, PAIR[:1], [Seed("wrist", 0, truth(standing(0)))])
    results = list(session.run(two(i) for i in range(8)))
    for result in results:
        (measured,), (smoothed,) = result.estimates, result.smoothed
        for given in (measured, smoothed):
            place = given.xyz_cam_m
            distance = np.linalg.norm(place)
            sd = np.sqrt(place @ given.covariance_m2 @ place) / distance
            assert 0.03 <= sd / distance < 0.031


def test_requests_carry_the_reasons_since_the_first_miss_most_frequent_first():
    """A ball alike, a leap away: twice by itself, then nothing."""

    def image(i):
        return picture(*([standing(i)] if i < 5 else [ball_at(142, 120, 15)] if i < 7 else []), noise_seed=i)

    session = Session(CAMERA, PAIR[:1], [Seed("wrist", 0, truth(standing(0)))], ChainConfig(policy=COUNTED))
    results = list(session.run(bgr_frame(image(i), i) for i in range(11)))
    reasons = [r.estimates[0].reasons for r in results]
    assert reasons[5:10] == [("gate",), ("gate",), ("no outline",), ("no outline",), ("no outline",)]
    (request,) = [q for r in results for q in r.requests]
    assert request.reasons == ("no outline", "gate")
    assert "no outline, gate" in request.reason
    assert (request.frame_index, request.raised_at_frame_index) == (5, 9)


def test_reasons_of_an_earlier_gap_do_not_come_into_a_request():
    def image(i):
        alike = i in (5, 6)
        return picture(*([ball_at(142, 120, 15)] if alike else [standing(i)] if i < 12 else []), noise_seed=i)

    session = Session(CAMERA, PAIR[:1], [Seed("wrist", 0, truth(standing(0)))], ChainConfig(policy=COUNTED))
    results = list(session.run(bgr_frame(image(i), i) for i in range(18)))
    (request,) = [q for r in results for q in r.requests]
    assert request.reasons == ("no outline",)


# -- side by side ----------------------------------------------------------------------------------


def test_results_are_the_same_to_the_last_bit_whatever_the_number_of_threads():
    balls = {
        "a": lambda i: Ball((-0.13 + 0.002 * i, -0.05, 0.95), ORANGE),
        "b": lambda i: Ball((0.0, 0.05 + 0.001 * i, 0.8), GREEN),
        "c": lambda i: Ball((0.12 - 0.003 * i, -0.02, 0.9), BLUE),
        "d": lambda i: Ball((0.1 - 0.006 * i, -0.05, 0.85), ORANGE),  # crosses the first
    }
    markers = tuple(MarkerSpec(name, 2 * RADIUS_M) for name in balls)
    images = [picture(*(ball(i) for ball in balls.values()), noise_seed=i) for i in range(45)]
    for i in range(20, 32):
        images[i] = empty(i)

    def run(threads):
        seeds = [Seed(name, 0, truth(ball(0))) for name, ball in balls.items()]
        config = SessionConfig(smoother_lag_frames=5)
        session = Session(
            CAMERA, markers, seeds, config=config, threads=threads, keep_view=lambda e: e.frame_index % 9 == 0
        )
        return list(session.run(bgr_frame(image, i) for i, image in enumerate(images)))

    alone, together = run(1), run(4)
    statuses = {e.status for r in alone for e in r.estimates}
    assert {Status.SEEDED, Status.VERIFIED, Status.ESTIMATED, Status.LOST} <= statuses
    assert_same(alone, together)


# -- at the picture's border -----------------------------------------------------------------------

BORDERS = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize(("r_px", "share"), [(22, 0.36), (36, 1 / 3)])
def test_a_marker_with_a_third_of_its_outline_in_the_picture_is_verified_and_rightly(border, r_px, share):
    """It goes out until that share of its outline is left, stays there and jitters; a small one's last rays end so
    near to the border that they show no edge."""
    dx, dy = BORDERS[border]
    jitter = np.random.default_rng(r_px).uniform(-0.5, 0.5, (46, 2))
    arrives = 1.6 * r_px / 1.5

    def ball(i):
        out = np.cos(np.pi * share) * r_px - max(0.0, 1.5 * (arrives - i)) + jitter[i, 0]
        along = 100.0 + i + jitter[i, 1]
        if dx:
            return ball_at(159.5 + dx * (160 + out), along, r_px)
        return ball_at(along, 119.5 + dy * (120 + out), r_px)

    def image(i):
        return picture(ball(i), noise_seed=i)

    estimates = steps(seeded(ball, image), range(1, 46), image)
    verified = [e for e in estimates if e.status is Status.VERIFIED]
    for estimate in verified:
        assert estimate.circle.dice(truth(ball(estimate.frame_index))) > 0.9
    third = [e for e in verified if e.frame_index >= arrives]
    assert third
    assert all(e.visible < 0.42 for e in third)
