"""KCF and points together: how large the patch is, and whose word on the size counts."""

import numpy as np
import pytest

from scenes import ball_at, bgr_frame, picture, truth
from spheremcap.core.circle import Circle
from spheremcap.core.look import Expected
from spheremcap.core.optics import AT_REST
from spheremcap.tracking.follower import Follower
from spheremcap.tracking.kcf import KcfConfig
from spheremcap.tracking.points import PointsConfig

SMALL, LARGE = ball_at(160, 120, 20), ball_at(161, 120, 21.2)
BEFORE, NOW = truth(SMALL), truth(LARGE)


def expected(circle=BEFORE, range_sd=0.1, reach_px=10.0):
    return Expected(circle, 1.0, 0.8, range_sd, np.zeros(2), 1 / 240, AT_REST, reach_px)


def followed(what, kcf=None, points=None, miss=False):
    follower = Follower(kcf or KcfConfig(), points or PointsConfig())
    first, second = bgr_frame(picture(SMALL, noise_seed=1)), bgr_frame(picture(LARGE, noise_seed=2), 1)
    follower.learn(follower.patch(first, BEFORE), BEFORE)
    if miss:
        follower.miss()
    return follower.follow(follower.patch(second, what.circle, what.reach_px), what)


def test_points_say_how_large_it_has_become_where_the_filter_does_not_know():
    found = followed(expected(range_sd=1.0))
    assert found.r_px / BEFORE.r_px == pytest.approx(NOW.r_px / BEFORE.r_px, abs=0.012)
    assert found.distance(NOW) < 1.5


def test_the_filters_size_stands_where_it_is_sure_of_the_distance():
    assert followed(expected(range_sd=1e-6)).r_px == pytest.approx(BEFORE.r_px, rel=1e-4)


@pytest.mark.parametrize("how", [{"miss": True}, {"points": PointsConfig(enabled=False)}], ids=["missed", "left out"])
def test_without_points_the_filters_size_stands(how):
    assert followed(expected(range_sd=1.0), **how).r_px == BEFORE.r_px


@pytest.mark.parametrize("wrong", [0.8, 1.25])
def test_points_move_the_filters_size_by_a_tenth_at_most(wrong):
    what = expected(BEFORE.resized(BEFORE.r_px * wrong), range_sd=10.0)
    assert followed(what).r_px / what.circle.r_px == pytest.approx(1.1 if wrong < 1 else 0.9, abs=1e-3)


def test_without_kcf_the_prediction_is_followed():
    what = expected(BEFORE.shifted(3, -2), range_sd=1e-6)
    found = followed(what, kcf=KcfConfig(enabled=False))
    assert (found.x_px, found.y_px) == (what.circle.x_px, what.circle.y_px)
    assert followed(what).distance(NOW) < 1.5


@pytest.mark.parametrize("r_px", [6.0, 24.0, 240.0])
def test_a_patch_grows_with_the_reach_in_radii_and_not_with_the_marker(r_px):
    follower, frame = Follower(KcfConfig(), PointsConfig()), bgr_frame(picture())
    circle = Circle(150.3, 110.2, r_px)
    sides = [follower.patch(frame, circle, share * r_px).bgr.shape[0] for share in (0.0, 0.5, 1.0, 3.0)]
    assert sides[0] == sides[1] == 64
    assert sides[2] > sides[1]
    assert 100 < sides[3] <= 130
    patch = follower.patch(frame, circle, 3 * r_px)
    local, half = patch.local(circle), (sides[3] - 1) / 2
    assert (local.x_px, local.y_px) == pytest.approx((half, half))
    assert half * patch.step_px > 2.5 * r_px + 2 * r_px  # the window of KCF, that far away


def test_kcf_is_trained_on_every_so_many_verified_circles(monkeypatch):
    follower = Follower(KcfConfig(train_every=3), PointsConfig())
    trained = []
    monkeypatch.setattr(follower._kcf, "train", lambda patch, circle: trained.append(circle))
    patch = follower.patch(bgr_frame(picture(SMALL)), BEFORE)
    for k in range(8):
        follower.learn(patch, BEFORE.resized(20.0 + k))
    assert [c.r_px for c in trained] == [20, 23, 26]
