"""The verifier's templates: which one is asked when, and what becomes of what they say."""

import numpy as np
import pytest

from scenes import BLUE, Cover, ball_at, bgr_frame, picture, truth
from spheremcap.core.frame import Patch, Window
from spheremcap.core.look import EdgePoints, Measured
from spheremcap.core.optics import AT_REST
from spheremcap.core.vote import Verdict
from spheremcap.detection.appearance import Appearance
from spheremcap.detection.colour import ColourConfig
from spheremcap.detection.detector import Detected
from spheremcap.verification import verifier as rooms
from spheremcap.verification.jury import JuryConfig
from spheremcap.verification.matching import MatchingConfig
from spheremcap.verification.verifier import Prior, Verifier

BALL = ball_at(160, 120, 15)
HERE = truth(BALL)


def marked(dx, dy, seed=0):
    """The ball with a dark mark off its middle."""
    mark = ball_at(160 + dx, 120 + dy, 5, rgb=(20, 30, 60), radius_m=0.0065)
    return Patch(bgr_frame(picture(BALL, mark, noise_seed=seed)), Window(100, 60, 121, 121))


def claim(circle=HERE, visible=1.0):
    edges = EdgePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.intp), np.zeros(0), 48, 1.0)
    return Measured(
        circle, (0.1,) * 3, np.array([0, 0, 1.0]), np.eye(3), visible, "kcf", edges, np.zeros(0), np.zeros(0), AT_REST
    )


def started(patch, **jury):
    appearance = Appearance(patch, HERE, 1.0, ColourConfig())
    return Verifier(patch, HERE, appearance, JuryConfig(**jury), MatchingConfig(), colour=True)


def look(verifier, patch, lost=False, missed=False, measured=None, reach_px=7.0, around=HERE):
    found = Detected((("kcf", HERE),), (), None, measured)
    return verifier.look(patch, found, Prior(around, reach_px, lost, around, 2.0, 0.1, missed))


FIRST, LATER = marked(-5, -5), marked(5, 5)


def test_a_followed_marker_is_compared_with_its_last_verified_picture_alone():
    verifier = started(FIRST)
    as_first = look(verifier, FIRST, measured=claim()).vote_sum
    verifier.learn(LATER, HERE)
    assert look(verifier, marked(5, 5, 1), measured=claim()).vote_sum > 5.5
    assert look(verifier, marked(-5, -5, 1), measured=claim()).vote_sum < as_first - 1


@pytest.mark.parametrize("dx", [-5, 5])
def test_one_that_was_missed_may_look_as_it_did_last_or_as_it_did_when_a_person_showed_it(dx):
    verifier = started(FIRST)
    verifier.learn(LATER, HERE)
    assert look(verifier, marked(dx, dx, 1), missed=True, measured=claim()).vote_sum > 5.5


def test_the_seeds_template_does_not_follow(monkeypatch):
    asked = []
    vote = rooms.template_vote

    def spied(template, *rest):
        asked.append((template, vote(template, *rest)))
        return asked[-1][1]

    monkeypatch.setattr(rooms, "template_vote", spied)
    verifier = started(FIRST)
    look(verifier, FIRST, measured=claim(visible=0.69))
    for _ in range(3):
        verifier.learn(LATER, HERE)
    look(verifier, FIRST, measured=claim(visible=0.69))
    look(verifier, FIRST, measured=claim(visible=0.7))  # seen well enough
    look(verifier, FIRST, measured=claim(visible=0.1), lost=True)  # it has had its vote
    assert len(asked) == 2
    np.testing.assert_array_equal(asked[0][0].pixels, asked[1][0].pixels)
    assert asked[1][1] > 0.97


def test_votes_too_few_are_the_first_of_the_reasons():
    verifier = started(FIRST, th1=6.0, th2=5.99)
    doubted = look(verifier, marked(-5, -5, 1), measured=claim())
    assert (doubted.verdict, doubted.doubts) == (Verdict.REJECTED, ("votes",))
    doubtful = look(started(FIRST, th1=6.0, th2=3.0), marked(-5, -5, 1), measured=claim())
    assert (doubtful.verdict, doubtful.doubts) == (Verdict.DOUBTFUL, ("votes",))
    hidden = look(verifier, marked(-5, -5, 1), measured=claim(visible=0.1))
    assert hidden.doubts == ("votes", "outline")


def test_without_a_claim_all_six_are_cast_and_the_reason_is_that_there_was_no_outline():
    nothing = look(started(FIRST), marked(-5, -5, 1))
    assert (nothing.verdict, nothing.doubts, nothing.vote_sum) == (Verdict.REJECTED, ("no outline",), 0)
    assert len(nothing.votes) == 6


def test_without_colours_the_checks_of_colour_are_not_asked():
    blue = Patch(bgr_frame(picture(ball_at(160, 120, 15, rgb=BLUE))), Window(100, 60, 121, 121))
    plain = Patch(bgr_frame(picture(BALL)), Window(100, 60, 121, 121))
    for colour, named in ((True, True), (False, False)):
        appearance = Appearance(plain, HERE, 1.0, ColourConfig())
        verifier = Verifier(plain, HERE, appearance, JuryConfig(), MatchingConfig(), colour=colour)
        assert ("colour" in look(verifier, blue, measured=claim()).doubts) == named


def test_votes_reach_as_far_as_the_claim_lies_but_only_so_far():
    def reach(measured, reach_px):
        return (look(started(FIRST), FIRST, measured=measured, reach_px=reach_px).maps.values.shape[1] - 1) / 2

    a_px = 12.8 / HERE.r_px
    assert reach(claim(), 7.0) == round(7.0 * a_px)
    assert reach(claim(), 40.0) == round(HERE.r_px * a_px)  # of the prior's reach no more than a radius
    assert reach(claim(HERE.shifted(20, 0)), 7.0) == round((20 + 0.3 * HERE.r_px) * a_px)
    assert reach(claim(HERE.shifted(60, 0)), 7.0) == round(3.5 * HERE.r_px * a_px)


# -- what is hidden --------------------------------------------------------------------------------


def half(circle):
    """A claim of which only the left half of the outline shows an edge; on the right something else has weak ones."""
    angles = np.arange(48) * 2 * np.pi / 48
    points = np.stack([circle.x_px + circle.r_px * np.cos(angles), circle.y_px + circle.r_px * np.sin(angles)], axis=1)
    weights = np.where(np.cos(angles) <= 1e-9, 1.0, 0.2)
    edges = EdgePoints(points, np.full(48, 0.1), np.arange(48), np.zeros(48), 48, 1.0)
    return Measured(
        circle, (0.1,) * 3, np.array([0, 0, 1.0]), np.eye(3), 0.52, "kcf", edges, weights, np.zeros(48), AT_REST
    )


def covered_half(seed=1):
    mark = ball_at(155, 115, 5, rgb=(20, 30, 60), radius_m=0.0065)
    cover = Cover(160, 80, 200, 160, (90, 200, 240))
    return Patch(bgr_frame(picture(BALL, mark, covers=(cover,), noise_seed=seed)), Window(100, 60, 121, 121))


def test_votes_are_cast_on_what_shows_of_a_claim_as_large_as_the_marker():
    as_a_whole = look(started(FIRST), covered_half(), measured=claim(visible=0.52))
    by_what_shows = look(started(FIRST), covered_half(), measured=half(HERE))
    assert by_what_shows.vote_sum > max(5.0, as_a_whole.vote_sum + 0.5)


@pytest.mark.parametrize(("ratio", "cut"), [(1.21, True), (1.23, False), (0.83, True), (0.81, False)])
def test_one_that_is_larger_or_smaller_is_compared_as_a_whole(monkeypatch, ratio, cut):
    gaps = []
    keep = rooms.less_hidden
    monkeypatch.setattr(rooms, "less_hidden", lambda template, gap: (gaps.append(gap), keep(template, gap))[1])
    look(started(FIRST), FIRST, measured=half(HERE.resized(HERE.r_px * ratio)))
    assert (gaps[0].half > 1.0) == cut


def test_a_look_says_whether_it_is_elsewhere_and_how_alike_that_is():
    verifier = started(FIRST)
    assert not look(verifier, FIRST, measured=claim()).elsewhere
    away = look(verifier, FIRST, measured=claim(), lost=True)
    assert away.elsewhere
    assert "likeness" not in away.doubts
    blue = Patch(bgr_frame(picture(ball_at(160, 120, 15, rgb=BLUE))), Window(100, 60, 121, 121))
    assert "likeness" in look(verifier, blue, measured=claim(), lost=True).doubts
