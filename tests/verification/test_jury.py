import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.core.vote import Verdict, Vote
from spheremcap.verification.jury import JuryConfig, cast_votes, judge, template_vote, vote_sum
from spheremcap.verification.matching import MATCHERS, Matches, MatchingConfig, make_template

CLAIM = Circle(50, 40, 10)


def maps(circles, claim=CLAIM):
    values = np.zeros((6, 4, 5), np.float32)
    scores = tuple(k + 0.5 for k in range(6))
    values[:, 2, 3] = scores
    overlaps = tuple(0.0 if claim is None else c.dice(claim) for c in circles)
    return Matches(MATCHERS, values, np.tile((3, 2), (6, 1)), scores, tuple(circles), overlaps)


@pytest.mark.parametrize(
    ("total", "verdict"),
    [
        (6.0, Verdict.VERIFIED),
        (math.nextafter(4.0, 5), Verdict.VERIFIED),
        (4.0, Verdict.DOUBTFUL),  # "greater than TH1"
        (3.5, Verdict.DOUBTFUL),
        (3.0, Verdict.DOUBTFUL),  # "less than TH2"
        (math.nextafter(3.0, 2), Verdict.REJECTED),
        (0.0, Verdict.REJECTED),
    ],
)
def test_the_thesis_thresholds_hold_at_their_borders(total, verdict):
    assert judge(total, JuryConfig()) is verdict


def test_thresholds_are_the_configs():
    assert judge(2.5, JuryConfig(th1=2, th2=1)) is Verdict.VERIFIED
    assert judge(1.5, JuryConfig(th1=2, th2=1)) is Verdict.DOUBTFUL
    assert judge(0.9, JuryConfig(th1=2, th2=1)) is Verdict.REJECTED


def test_thresholds_the_wrong_way_round_are_refused():
    with pytest.raises(ValueError, match=r"th2 = 4\.5 is above th1 = 4: give th2 <= th1"):
        JuryConfig(th2=4.5)
    with pytest.raises(ValueError, match="th2"):
        JuryConfig(th1=2.9)
    assert judge(3.0, JuryConfig(th1=3, th2=3)) is Verdict.DOUBTFUL


def test_six_matchers_that_agree_wholly_sum_to_six():
    votes = cast_votes(maps([CLAIM] * 6))
    assert [v.matcher for v in votes] == list(MATCHERS)
    assert vote_sum(votes) == pytest.approx(6)


def test_each_vote_is_the_dice_overlap_with_the_claim():
    circles = [CLAIM.shifted(d, -d / 2) for d in (0, 1, 3, 7, 15, 40)]
    votes = cast_votes(maps(circles))
    for vote, circle in zip(votes, circles, strict=True):
        shared = circle.shared_area(CLAIM)
        assert vote.overlap == pytest.approx(2 * shared / (circle.area_px2 + CLAIM.area_px2))  # eq 3.8
        assert vote.circle == circle
    assert votes[0].overlap == pytest.approx(1)
    assert votes[-1].overlap == 0
    assert vote_sum(votes) == pytest.approx(sum(v.overlap for v in votes))


def test_a_vote_carries_the_score_at_its_peak():
    votes = cast_votes(maps([CLAIM] * 6))
    assert [v.score for v in votes] == [0.5, 1.5, 2.5, 3.5, 4.5, 5.5]


def test_nothing_claimed_gets_no_overlap_but_all_six_circles():
    votes = cast_votes(maps([CLAIM] * 6, None))
    assert vote_sum(votes) == 0
    assert [v.circle for v in votes] == [CLAIM] * 6


@given(st.lists(st.floats(0, 1), min_size=6, max_size=6))
def test_the_sum_stays_between_nought_and_six(overlaps):
    votes = [Vote(name, CLAIM, 0.0, v) for name, v in zip(MATCHERS, overlaps, strict=True)]
    assert 0 <= vote_sum(votes) <= 6


def test_an_old_template_votes_at_the_brightness_the_marker_has_by_now():
    rng = np.random.default_rng(3)
    image = np.clip(cv2.GaussianBlur(rng.standard_normal((120, 120, 3)), (0, 0), 2) * 200 + 100, 0, 160)
    whole = Window(0, 0, 120, 120)
    config, circle = MatchingConfig(), Circle(60, 55, 14)
    template = make_template(Patch(BgrFrame(0, 0, image.astype(np.uint8)), whole), circle, config)
    bright = Patch(BgrFrame(0, 0, (1.5 * image).astype(np.uint8)), whole)
    there = template_vote(template, 1.5, bright, circle, config)
    assert there > 0.98
    assert template_vote(template, 1.0, bright, circle, config) < there
    assert template_vote(template, 1.5, bright, circle.shifted(8, 8), config) < 0.7
