"""The chain of one marker on rendered pictures with known truth, through its public face."""

from copy import deepcopy
from functools import lru_cache

import numpy as np
import pytest

from scenes import (
    BLUE,
    CAMERA,
    ORANGE,
    PERIOD_NS,
    RADIUS_M,
    Ball,
    Cover,
    bgr_frame,
    picture,
    truth,
    yuv_frame,
)
from spheremcap.chain import ChainConfig, MarkerChain, PolicyConfig
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.frame import Frame
from spheremcap.core.marker import MarkerSpec
from spheremcap.core.time import NS_PER_S
from spheremcap.core.vote import Verdict
from spheremcap.detection.colour import ColourConfig
from spheremcap.detection.hough import HoughConfig
from spheremcap.positioning.sphere import PositionConfig
from spheremcap.tracking.kcf import KcfConfig
from spheremcap.tracking.points import PointsConfig
from spheremcap.verification.matching import MATCHERS

SPEC = MarkerSpec("left_wrist", 2 * RADIUS_M)


def path(index) -> Ball:
    """Round the picture's middle and to and fro, up to 3 m/s."""
    t = index * PERIOD_NS / NS_PER_S
    w = 2 * np.pi * 3.0
    return Ball((0.12 * float(np.sin(w * t)), 0.07 * float(np.cos(w * t)), 0.9 + 0.1 * float(np.sin(0.7 * w * t))))


@lru_cache(maxsize=400)
def moving(index):
    return picture(path(index), noise_seed=index)


@lru_cache(maxsize=60)
def hidden(index, cover=None):
    """The same scene without the ball, or with something plain held over it."""
    c = truth(path(index))
    if cover is None:
        return picture(noise_seed=index)
    box = Cover(int(c.x_px - 30), int(c.y_px - 26), int(c.x_px + 30), int(c.y_px + 26), cover)
    return picture(path(index), covers=(box,), noise_seed=index)


def started(config=None, first=0, **how):
    chain = MarkerChain(SPEC, CAMERA, config or ChainConfig(), **how)
    chain.seed(bgr_frame(moving(first), first), truth(path(first)))
    return chain


def steps(chain, indices, image_of=moving):
    return [chain.step(bgr_frame(image_of(i), i)) for i in indices]


@lru_cache(maxsize=1)
def _settled():
    chain = started()
    steps(chain, range(1, 12))
    return chain


def settled():
    """A chain that has followed the ball up to frame 11."""
    return deepcopy(_settled())


def statuses(estimates):
    return [e.status.value for e in estimates]


# -- a marker in plain sight -----------------------------------------------------------------------


@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
def test_a_moving_ball_is_followed_for_sixty_frames(frame_of):
    chain = MarkerChain(SPEC, CAMERA, ChainConfig())
    first = chain.seed(frame_of(moving(0), 0), truth(path(0)).shifted(0.7, -0.5))
    estimates = [first] + [chain.step(frame_of(moving(i), i)) for i in range(1, 60)]
    assert statuses(estimates) == ["SEEDED"] + ["VERIFIED"] * 59
    truths = [truth(path(i)) for i in range(60)]
    errors = [e.circle.distance(t) for e, t in zip(estimates, truths, strict=True)]
    assert np.median(errors) < 0.15
    assert max(errors) < 0.3
    assert np.mean([e.circle.dice(t) for e, t in zip(estimates, truths, strict=True)]) > 0.98
    distance = [np.linalg.norm(e.xyz_cam_m) / np.linalg.norm(path(i).xyz) - 1 for i, e in enumerate(estimates)]
    assert abs(np.median(distance)) < (0.01 if frame_of is bgr_frame else 0.015)


def test_an_estimate_carries_all_that_it_is_meant_to():
    chain = started()
    estimate = steps(chain, range(1, 8))[-1]
    assert (estimate.marker, estimate.frame_index, estimate.stamp_ns) == ("left_wrist", 7, 7 * PERIOD_NS)
    assert [v.matcher for v in estimate.votes] == list(MATCHERS)
    assert estimate.vote_sum == pytest.approx(sum(v.overlap for v in estimate.votes))
    assert estimate.vote_sum > 4
    assert estimate.verdict is Verdict.VERIFIED
    assert estimate.claim == estimate.circle
    assert estimate.proposer in {name for name, _ in estimate.proposals}
    assert estimate.search.holds(estimate.circle.x_px, estimate.circle.y_px)
    assert 0.6 < estimate.visible <= 1
    assert min(estimate.circle_sd_px) > 0
    assert np.linalg.eigvalsh(estimate.covariance_m2).min() > 0
    velocity = (np.array(path(7).xyz) - path(6).xyz) / PERIOD_NS * NS_PER_S
    assert np.linalg.norm(estimate.velocity_cam_mps[:2] - velocity[:2]) < 0.4


def test_the_errors_in_metres_are_as_large_as_their_covariance_says():
    chain = started()
    nees = []
    for estimate in steps(chain, range(1, 30)):
        error = estimate.xyz_cam_m - path(estimate.frame_index).xyz
        nees.append(error @ np.linalg.solve(estimate.covariance_m2, error) / 3)
    assert 0.1 < np.median(nees) < 6


@pytest.mark.parametrize(
    "config",
    [
        ChainConfig(kcf=KcfConfig(kernel="linear")),
        ChainConfig(points=PointsConfig(enabled=False)),
        ChainConfig(hough=HoughConfig(enabled=False)),
        ChainConfig(colour=ColourConfig(enabled=False)),
        ChainConfig(colour=ColourConfig(stop="gain")),
        ChainConfig(position=PositionConfig(formula="circle")),
    ],
    ids=["dcf", "no points", "no hough", "no colour", "gain rule", "penne"],
)
def test_each_stage_can_be_left_out_or_exchanged(config):
    estimates = steps(started(config), range(1, 7))
    assert statuses(estimates) == ["VERIFIED"] * 6
    assert max(e.circle.distance(truth(path(e.frame_index))) for e in estimates) < 0.4


def test_a_careless_seed_is_sharpened_and_an_absurd_one_kept():
    true = truth(path(0))
    chain = MarkerChain(SPEC, CAMERA, ChainConfig())
    careless = chain.seed(bgr_frame(moving(0)), Circle(true.x_px + 1.2, true.y_px - 0.9, true.r_px * 1.06))
    assert careless.circle.distance(true) < 0.2
    assert careless.status is Status.SEEDED
    assert careless.proposer == "seed"
    # A person may know better than the edges: what they say stands, sharpened where there are some.
    nowhere = Circle(40.0, 200.0, 12.0)
    assert chain.seed(bgr_frame(moving(0)), nowhere).circle.dice(nowhere) >= 0.7
    flat = np.full((240, 320, 3), 110, np.uint8)
    assert chain.seed(bgr_frame(flat), nowhere).circle == nowhere


def test_two_runs_give_the_same_estimates_to_the_last_bit():
    def run():
        chain = started()
        return steps(chain, [*range(1, 15)]) + steps(chain, range(15, 18), hidden) + steps(chain, range(18, 24))

    for a, b in zip(run(), run(), strict=True):
        for name in ("status", "circle", "claim", "votes", "vote_sum", "proposals", "search", "circle_sd_px"):
            assert getattr(a, name) == getattr(b, name), name
        for name in ("xyz_cam_m", "covariance_m2", "velocity_cam_mps"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_without_a_calibrated_camera_nothing_is_said_in_metres():
    chain = started(metric=False)
    estimates = steps(chain, range(1, 4)) + steps(chain, range(4, 6), hidden)
    assert statuses(estimates) == ["VERIFIED"] * 3 + ["ESTIMATED"] * 2
    for estimate in estimates:
        assert estimate.circle is not None
        assert estimate.xyz_cam_m is estimate.covariance_m2 is estimate.velocity_cam_mps is None


def test_an_uncertain_focal_length_is_in_every_covariance():
    loose = type(CAMERA)(320, 240, 600.0, 600.0, 159.5, 119.5, focal_sd=0.03)
    sizes = []
    for camera in (CAMERA, loose):
        chain = MarkerChain(SPEC, camera, ChainConfig())
        estimate = chain.seed(bgr_frame(moving(0)), truth(path(0)))
        sizes.append(np.sqrt(estimate.covariance_m2[2, 2]))
    assert np.hypot(sizes[0], 0.03 * path(0).xyz[2]) == pytest.approx(sizes[1], rel=0.01)


def test_a_step_before_the_seed_says_so():
    with pytest.raises(RuntimeError, match="left_wrist has not been seeded"):
        MarkerChain(SPEC, CAMERA, ChainConfig()).step(bgr_frame(moving(0)))


# -- hidden, lost, found ---------------------------------------------------------------------------


@pytest.mark.parametrize("cover", [None, (150, 130, 120), (225, 170, 140)], ids=["gone", "grey", "skin"])
def test_three_hidden_frames_are_bridged(cover):
    chain = settled()
    bridged = steps(chain, range(12, 15), lambda i: hidden(i, cover))
    assert statuses(bridged) == ["ESTIMATED"] * 3
    for estimate in bridged:
        true = truth(path(estimate.frame_index))
        assert estimate.circle.distance(true) < true.r_px
        assert np.linalg.norm(estimate.xyz_cam_m - path(estimate.frame_index).xyz) < 0.02
    after = steps(chain, range(15, 18))
    assert statuses(after) == ["VERIFIED"] * 3
    assert after[0].circle.distance(truth(path(15))) < 0.3


def test_uncertainty_grows_while_the_filter_stands_in():
    chain = settled()
    sizes = [np.trace(e.covariance_m2) for e in steps(chain, range(12, 16), hidden)]
    assert (np.diff(sizes) > 0).all()


@pytest.mark.parametrize("lost_after", [3, 5, 8])
def test_so_many_unverified_frames_in_a_row_mean_lost_and_then_there_is_no_pose(lost_after):
    chain = started(ChainConfig(policy=PolicyConfig(lost_after=lost_after)))
    steps(chain, range(1, 12))
    missed = steps(chain, range(12, 12 + lost_after + 4), hidden)
    assert statuses(missed) == ["ESTIMATED"] * (lost_after - 1) + ["LOST"] * 5
    for estimate in missed[lost_after - 1 :]:
        assert estimate.circle is None
        assert estimate.circle_sd_px is None
        assert estimate.xyz_cam_m is estimate.covariance_m2 is estimate.velocity_cam_mps is None
    assert chain.moment is None


@pytest.mark.parametrize("gap", [6, 20])
def test_a_lost_marker_is_found_again_within_three_frames(gap):
    chain = settled()
    assert statuses(steps(chain, range(12, 12 + gap), hidden))[-1] == "LOST"
    back = steps(chain, range(12 + gap, 20 + gap))
    assert "VERIFIED" in statuses(back[:3])
    assert back[-1].status is Status.VERIFIED
    assert back[-1].circle.distance(truth(path(19 + gap))) < 0.3


def test_one_bad_frame_does_not_count_towards_the_next():
    """Misses count in a row: four hidden, one seen, four hidden is never LOST."""
    chain = settled()
    seen = []
    for start in (12, 17, 22):
        seen += steps(chain, range(start, start + 4), hidden)
        seen += steps(chain, [start + 4])
    assert "LOST" not in statuses(seen)


def test_the_immediate_policy_gives_up_at_the_first_rejection():
    chain = started(ChainConfig(policy=PolicyConfig(immediate=True)))
    steps(chain, range(1, 12))
    assert statuses(steps(chain, [12], hidden)) == ["LOST"]


@pytest.mark.parametrize("cover", [None, (150, 130, 120), (225, 170, 140), (20, 20, 25), (250, 250, 250)])
def test_a_hidden_marker_is_never_verified(cover):
    chain = settled()
    for estimate in steps(chain, range(12, 24), lambda i: hidden(i, cover)):
        assert not estimate.status.measured
        assert estimate.verdict is not Verdict.VERIFIED


def test_a_ball_of_another_colour_in_its_place_is_never_verified():
    chain = settled()
    swapped = [chain.step(bgr_frame(picture(Ball(path(i).xyz, BLUE), noise_seed=i), i)) for i in range(12, 24)]
    assert not any(e.status.measured for e in swapped)


def test_a_marker_that_turns_into_another_little_by_little_is_not_verified():
    """The template follows a slow change six votes to nought; the seed's own colours keep a say."""
    chain = settled()
    for i in range(12, 36):
        share = min(1.0, (i - 12) / 16)
        rgb = tuple(round(a + share * (b - a)) for a, b in zip(ORANGE, BLUE, strict=True))
        estimate = chain.step(bgr_frame(picture(Ball(path(i).xyz, rgb), noise_seed=i), i))
        if share == 1.0:
            assert not estimate.status.measured


def test_another_ball_that_crosses_does_not_carry_the_track_away():
    def crossing(i):
        mine, t = path(i), (i - 26) / 14
        other = Ball((mine.xyz[0] + 0.12 * t, mine.xyz[1] - 0.03, 0.75), BLUE)
        return picture(mine, other, noise_seed=i)

    chain = settled()
    estimates = steps(chain, range(12, 40), crossing) + steps(chain, range(40, 46))
    for estimate in estimates:
        if estimate.status.measured:
            assert estimate.circle.distance(truth(path(estimate.frame_index))) < 1.5
    assert estimates[-1].status is Status.VERIFIED


def test_a_sudden_change_of_exposure_is_lived_through():
    for gain in (0.5, 1.5):
        chain = settled()
        after = steps(chain, range(12, 18), lambda i, gain=gain: picture(path(i), gain=gain, noise_seed=i))
        assert after[-1].status is Status.VERIFIED
        assert after[-1].circle.distance(truth(path(17))) < 0.4


# -- out of the picture ----------------------------------------------------------------------------


def leaving(index) -> Ball:
    """Leaves on the right at 2.5 m/s, turns, and comes back."""
    t = index * PERIOD_NS / NS_PER_S
    x = 0.13 + 2.5 * t - 9.0 * t * t
    return Ball((x, 0.0, 0.9))


@lru_cache(maxsize=100)
def leaving_picture(index):
    return picture(leaving(index), noise_seed=index)


@lru_cache(maxsize=1)
def run_out_and_back():
    chain = MarkerChain(SPEC, CAMERA, ChainConfig())
    estimates = [chain.seed(bgr_frame(leaving_picture(0), 0), truth(leaving(0)))]
    estimates += [chain.step(bgr_frame(leaving_picture(i), i)) for i in range(1, 75)]
    return estimates


def test_a_marker_that_leaves_the_picture_is_out_of_view_and_verified_when_it_is_back():
    estimates = run_out_and_back()
    wholly_out = [
        e for e in estimates if truth(leaving(e.frame_index)).x_px > 319.5 + truth(leaving(e.frame_index)).r_px
    ]
    assert len(wholly_out) > 10
    assert all(not e.status.measured for e in wholly_out)
    assert Status.OUT_OF_VIEW in {e.status for e in wholly_out}
    assert Status.LOST not in {e.status for e in estimates}
    wholly_in = [
        e.frame_index for e in estimates[len(estimates) // 2 :]
        if truth(leaving(e.frame_index)).x_px < 319.5 - truth(leaving(e.frame_index)).r_px
    ]  # fmt: skip
    back = next(e for e in estimates if e.frame_index == wholly_in[0] + 3)
    assert back.status is Status.VERIFIED
    assert back.circle.distance(truth(leaving(back.frame_index))) < 0.4


def test_a_marker_out_of_view_has_no_pose():
    for estimate in run_out_and_back():
        if estimate.status is Status.OUT_OF_VIEW:
            assert estimate.circle is None
            assert estimate.xyz_cam_m is None


def test_a_marker_that_does_not_come_back_becomes_lost():
    chain = MarkerChain(SPEC, CAMERA, ChainConfig(policy=PolicyConfig(out_of_view_s=0.1)))
    chain.seed(bgr_frame(leaving_picture(0), 0), truth(leaving(0)))
    empty = picture(noise_seed=1)
    seen = [chain.step(bgr_frame(leaving_picture(i), i)) for i in range(1, 22)]
    gone = [chain.step(bgr_frame(empty, i)) for i in range(22, 70)]
    assert Status.OUT_OF_VIEW in {e.status for e in seen + gone}
    assert gone[-1].status is Status.LOST


# -- cost ------------------------------------------------------------------------------------------


class CountingFrame(Frame):
    """Counts the pixels that are converted, and full or reduced pictures."""

    def __init__(self, inner):
        super().__init__(inner.index, inner.stamp_ns, inner.width_px, inner.height_px)
        self.inner, self.pixels, self.wholes = inner, 0, 0

    def patch(self, window):
        self.pixels += window.width * window.height
        return self.inner.patch(window)

    def reduced(self, step):
        self.wholes += 1
        return self.inner.reduced(step)

    @property
    def full(self):
        self.wholes += 1
        return self.inner.full


def test_in_steady_state_no_frame_is_converted_as_a_whole():
    chain = started()
    for i in range(1, 20):
        frame = CountingFrame(bgr_frame(moving(i), i))
        estimate = chain.step(frame)
        assert estimate.status is Status.VERIFIED
        assert frame.wholes == 0
        # One patch of the search window: padding 1.5 and the reach, never more than (11 r)^2.
        assert frame.pixels <= estimate.search.width * estimate.search.height
        assert frame.pixels < (11.5 * estimate.circle.r_px) ** 2


def test_even_a_search_converts_only_a_reduced_picture():
    chain = settled()
    steps(chain, range(12, 18), hidden)
    frame = CountingFrame(bgr_frame(hidden(18), 18))
    assert chain.step(frame).status is Status.LOST
    assert frame.wholes <= 1


# -- what a person can look at ---------------------------------------------------------------------


def test_the_stages_pictures_are_kept_only_when_asked_for():
    chain = started()
    chain.step(bgr_frame(moving(1), 1))
    assert chain.view is None
    estimate = chain.step(bgr_frame(moving(2), 2), keep_view=True)
    view = chain.view
    assert view.marker == "left_wrist"
    assert view.window == estimate.search
    assert view.patch.shape == (view.window.height, view.window.width, 3)
    assert view.mask.shape == view.patch.shape[:2]
    assert len(view.responses) == 6
    assert len(view.edges_px) == len(view.edge_weights) > 40
    centre = (estimate.circle.x_px, estimate.circle.y_px)
    away = np.hypot(*(view.edges_px - centre).T)[view.edge_weights > 0.5]
    assert np.abs(away - estimate.circle.r_px).max() < 1
    chain.step(bgr_frame(moving(3), 3))
    assert chain.view is None
