"""The named checks: each at both sides of its bounds, and each where on rendered frames nothing but it speaks."""

import math
from dataclasses import replace

import pytest

from scenes import BLUE, CAMERA, COUNTED, ORANGE, RADIUS_M, Ball, Cover, ball_at, bgr_frame, picture, truth
from spheremcap.chain import ChainConfig, MarkerChain
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import Status
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.session import Session
from spheremcap.verification.checks import CHECKS, Case, covered, doubts
from spheremcap.verification.jury import JuryConfig

JURY = JuryConfig()
HERE = Circle(100.0, 80.0, 20.0)
GOOD = Case(
    HERE, HERE, visible=1.0, seeded_visible=1.0, lost=False, surprise=0.1, growth=2.0,
    colour=(1.0, 0.0), seeded_colour=(1.0, 0.0), seed_vote=None,
)  # fmt: skip


def less(value):
    return value - 1e-9


def more(value):
    return value + 1e-9


def passes(name, jury=JURY, **changes):
    """What the check says of the good case so changed; no other check may be asked for it."""
    case = replace(GOOD, **changes)
    said = CHECKS[name](case, jury)
    assert (name in doubts(case, jury)) == (not said)
    return said


# -- as functions ----------------------------------------------------------------------------------


def test_a_good_claim_passes_all_of_them():
    assert doubts(GOOD, JURY) == ()
    assert tuple(CHECKS) == ("outline", "seed", "colour", "part", "gate", "size", "likeness")


def test_all_that_speaks_against_a_claim_is_named_in_order():
    bad = Case(HERE.shifted(90, 0), Circle(100, 80, 5), 0.1, 1.0, False, 9.0, 2.0, (0.0, 1.0), (1.0, 0.0), 0.1)
    assert doubts(bad, JURY) == tuple(name for name in CHECKS if name != "likeness")
    unlike = replace(bad, lost=True, seed_vote=None, likeness=0.1)
    assert doubts(unlike, JURY) == tuple(name for name in CHECKS if name != "seed")


@pytest.mark.parametrize(
    ("lost", "seeded_visible", "least"),
    [
        (False, 1.0, 0.3),
        (True, 1.0, 0.4),
        (False, 0.55, 0.275),
        (True, 0.55, 0.275),
        (True, 0.7, 0.35),
        (True, 0.1, 0.25),
    ],
)
def test_outline_asks_for_enough_of_it_but_for_no_more_than_half_of_what_the_seed_showed(lost, seeded_visible, least):
    far = {"claim": HERE.shifted(more(40.0), 0), "seeded_visible": seeded_visible, "lost": lost}
    assert passes("outline", visible=more(least), **far)
    assert not passes("outline", visible=less(least), **far)


def test_outline_asks_for_a_quarter_of_a_claim_just_where_it_is_expected():
    for case in ({}, {"lost": True}, {"lost": True, "claim": HERE.shifted(less(40.0), 0), "surprise": 0.9}):
        assert passes("outline", visible=more(0.25), **case)
        assert not passes("outline", visible=less(0.25), **case)
    assert not passes("outline", visible=0.29, claim=HERE.shifted(more(3.0), 0))  # followed, and 0.15 radii aside
    assert not passes("outline", visible=0.29, surprise=more(1.0))


def test_where_a_seed_showed_no_outline_a_claim_has_to_show_most_of_one():
    assert passes("outline", seeded_visible=0.0, visible=more(0.7))
    assert not passes("outline", seeded_visible=0.0, visible=0.7)


def test_outlines_bounds_are_the_configs():
    far = {"claim": HERE.shifted(50, 0)}
    assert passes("outline", JuryConfig(visible=0.2), visible=0.24, **far)
    assert not passes("outline", JuryConfig(lost_visible=0.45), visible=0.42, lost=True, **far)
    assert passes("outline", JuryConfig(near_visible=0.1), visible=0.15)


def test_what_was_lost_has_to_look_like_the_marker():
    assert passes("likeness", lost=True, likeness=0.7)
    assert not passes("likeness", lost=True, likeness=less(0.7))
    assert passes("likeness", likeness=0.0)  # of one that is followed the votes are enough
    assert not passes("likeness", lost=True, likeness=0.0, in_picture=0.9)
    assert passes("likeness", lost=True, likeness=0.0, in_picture=less(0.9))  # the border cuts into it
    assert not passes("likeness", JuryConfig(lost_likeness=0.8), lost=True, likeness=0.75)


def test_seed_asks_for_more_than_its_least_vote_where_it_is_asked():
    aside = HERE.shifted(4.0, 0.0)
    assert passes("seed", claim=aside, seed_vote=None)
    assert passes("seed", claim=aside, seed_vote=more(0.6))
    assert not passes("seed", claim=aside, seed_vote=0.6)
    assert passes("seed", JuryConfig(seed_template=0.5), claim=aside, seed_vote=0.6)


@pytest.mark.parametrize(
    ("changes", "taken"),
    [
        ({"claim": HERE.shifted(less(3.0), 0)}, True),
        ({"claim": HERE.shifted(more(3.0), 0)}, False),
        ({"claim": HERE.resized(20 * math.exp(0.0499))}, True),
        ({"claim": HERE.resized(20 * math.exp(-0.0501))}, False),
        ({"surprise": 1.0}, True),
        ({"surprise": more(1.0), "visible": 0.9}, False),
        ({"lost": True}, False),
    ],
)
def test_seed_does_not_ask_a_claim_that_is_just_as_expected(changes, taken):
    assert CHECKS["seed"](replace(GOOD, seed_vote=0.1, **changes), JURY) is taken


@pytest.mark.parametrize(
    ("lost", "visible", "seeded", "least"),
    [
        (False, 0.9, 1.0, 0.54),
        (False, 0.5, 1.0, 0.3),
        (False, 0.4, 1.0, 0.24),
        (False, 0.1, 1.0, 0.24),  # little seen asks for no less
        (False, 0.9, 0.5, 0.27),
        (True, 0.9, 1.0, 0.72),
        (True, 0.5, 0.5, 0.2),
    ],
)
def test_colour_asks_for_the_seeds_colours_as_far_as_the_claim_is_seen(lost, visible, seeded, least):
    case = {"lost": lost, "visible": visible, "seeded_colour": (seeded, 0.0)}
    assert passes("colour", **case, colour=(more(least), 0.0))
    assert not passes("colour", **case, colour=(less(least), 0.0))


@pytest.mark.parametrize(
    ("changes", "least"),
    [
        ({"visible": more(0.9)}, 0.27),
        ({"visible": 0.9}, 0.54),
        ({"surprise": more(1.0)}, 0.6),
        ({"claim": HERE.shifted(11.9, 0)}, 0.3),
        ({"claim": HERE.shifted(12.1, 0)}, 0.6),
        ({"lost": True, "claim": HERE.shifted(50, 0)}, 0.4),
        ({"lost": True, "visible": 0.9}, 0.72),
    ],
)
def test_colour_asks_for_half_in_a_whole_outline_where_one_can_be(changes, least):
    assert CHECKS["colour"](replace(GOOD, **changes, colour=(more(least), 0.0)), JURY)
    assert not CHECKS["colour"](replace(GOOD, **changes, colour=(less(least), 0.0)), JURY)


@pytest.mark.parametrize(
    ("changes", "taken"),
    [
        ({}, True),
        ({"unlike": more(0.25)}, False),
        ({"surprise": more(1.0)}, False),
        ({"claim": HERE.shifted(11.9, 0)}, True),
        ({"claim": HERE.shifted(12.1, 0)}, False),
        ({"lost": True}, False),
    ],
)
def test_a_followed_claim_of_the_seeds_colour_beside_what_is_around_needs_no_hue(changes, taken):
    """A dark ball: its hue and saturation are any."""
    case = replace(GOOD, **{"unlike": less(0.25), "visible": 0.5, "colour": (0.0, 0.0), **changes})
    assert CHECKS["colour"](case, JURY) is taken


def test_colour_asks_nothing_of_what_is_hidden():
    case = {"visible": 0.4, "shown": 0.3}
    assert passes("colour", **case, colour=(more(0.18), 0.0))
    assert not passes("colour", **case, colour=(less(0.18), 0.0))
    assert not passes("colour", visible=0.3, shown=0.9, colour=(less(0.24), 0.0))  # no more than that of the outline


def test_where_colour_is_not_asked_it_says_nothing():
    assert passes("colour", colour=None)
    assert passes("part", colour=None, visible=0.1)


@pytest.mark.parametrize(("around", "most"), [(0.0, 0.55), (0.1, 0.65), (0.29, 0.84), (0.5, 0.85)])
def test_part_lets_the_colour_go_on_around_little_more_than_around_the_seed(around, most):
    case = {"visible": 0.5, "seeded_colour": (1.0, around)}
    assert passes("part", **case, colour=(1.0, less(most)))
    assert not passes("part", **case, colour=(1.0, more(most)))


def test_part_does_not_take_for_hidden_what_has_the_markers_colours():
    case = {"visible": 0.3, "shown": 0.2, "claim": HERE.shifted(4.0, 0)}
    assert passes("part", **case, colour=(less(0.6), 0.0))
    assert not passes("part", **case, colour=(more(0.6), 0.0))
    assert passes("part", **{**case, "claim": HERE}, colour=(1.0, 0.0))  # just as expected: a poor contrast
    assert not passes("part", **{**case, "claim": HERE}, colour=(1.0, 0.0), lost=True)


def test_part_says_nothing_of_a_claim_whose_outline_is_seen():
    assert passes("part", colour=(1.0, 1.0), visible=0.6)
    assert not passes("part", colour=(1.0, 1.0), visible=less(0.6))


@pytest.mark.parametrize(("in_picture", "least"), [(1.0, 0.6), (0.55, 0.33), (0.3, 0.18), (0.1, 0.18)])
def test_what_the_pictures_border_cuts_off_is_not_hidden(in_picture, least):
    """Down to a third of the outline: what is less than that proves nothing."""
    assert passes("part", colour=(1.0, 1.0), visible=more(least), in_picture=in_picture)
    assert not passes("part", colour=(1.0, 1.0), visible=less(least), in_picture=in_picture)


def test_gate_opens_up_to_one():
    far = HERE.shifted(60, 0)
    assert passes("gate", claim=far, surprise=1.0)
    assert not passes("gate", claim=far, surprise=more(1.0))


@pytest.mark.parametrize(
    ("claim", "within"),
    [
        (HERE.shifted(less(12.0), 0), True),  # 0.6 of the expected radius
        (HERE.shifted(more(12.0), 0), False),
        (HERE.resized(20 * math.exp(0.1999)), True),  # three times the logarithm of the sizes
        (HERE.resized(20 * math.exp(-0.1999)), True),
        (HERE.resized(20 * math.exp(0.2001)), False),
        (HERE.resized(20 * math.exp(-0.2001)), False),
        (Circle(100 + 6.1, 80, 20 * math.exp(0.1)), False),  # both together
        (Circle(100 + 5.9, 80, 20 * math.exp(0.1)), True),
    ],
)
def test_a_clear_outline_hardly_off_the_prediction_is_no_leap_whatever_the_filter_says(claim, within):
    assert passes("gate", claim=claim, surprise=50.0) == within
    assert not passes("gate", claim=claim, surprise=50.0, visible=0.7)  # not clear
    assert not passes("gate", claim=claim, surprise=50.0, lost=True)  # nothing was predicted


@pytest.mark.parametrize("growth", [1.2, 2.0])
def test_size_may_change_by_the_growth_that_time_allows_either_way(growth):
    assert passes("size", growth=growth, claim=HERE.resized(less(20 * growth)))
    assert passes("size", growth=growth, claim=HERE.resized(more(20 / growth)))
    assert not passes("size", growth=growth, claim=HERE.resized(more(20 * growth)))
    assert not passes("size", growth=growth, claim=HERE.resized(less(20 / growth)))


def test_a_claim_is_covered_from_four_fifths_of_its_disc_on():
    assert not covered(HERE, [])
    assert not covered(HERE, [HERE.resized(less(20 * math.sqrt(0.8)))])
    assert covered(HERE, [HERE.resized(more(20 * math.sqrt(0.8)))])
    assert covered(HERE, [HERE.shifted(200, 0), HERE.resized(60.0)])


def test_two_that_cover_half_each_do_not_cover_it_together():
    assert not covered(HERE, [HERE.shifted(-12, 0), HERE.shifted(12, 0)])


# -- on rendered frames ----------------------------------------------------------------------------


def follow(scene, marker, count, config=None):
    """Seed on frame 0 and follow: `scene(i)` is the picture, `marker(i)` the true ball."""
    chain = MarkerChain(MarkerSpec("marker", 2 * RADIUS_M), CAMERA, config or ChainConfig(policy=COUNTED))
    estimates = [chain.seed(bgr_frame(scene(0), 0), truth(marker(0)))]
    return estimates + [chain.step(bgr_frame(scene(i), i)) for i in range(1, count)]


def doubted_only_by(name, estimates):
    """The frames where this check alone stands between a claim and VERIFIED."""
    found = [e for e in estimates if e.reasons == (name,)]
    assert found
    for estimate in found:
        assert not estimate.status.measured
        assert estimate.claim is not None
        assert estimate.vote_sum > JURY.th1
    return found


def still(i):
    return ball_at(120 + 0.4 * i, 120, 15)


def test_the_colour_check_sees_another_ball_grow_in_the_markers_middle():
    """Little by little: the template follows, six votes to nought; outline and size are the marker's."""

    def scene(i):
        share = min(0.8, 0.02 * max(0, i - 6))
        here = truth(still(i))
        other = ball_at(here.x_px, here.y_px, 15 * share, rgb=BLUE, radius_m=0.8 * RADIUS_M * share) if share else None
        return picture(still(i), *([other] if other else []), noise_seed=i)

    estimates = follow(scene, still, 46)
    doubted = doubted_only_by("colour", estimates)
    assert all(e.status is Status.VERIFIED for e in estimates[1 : doubted[0].frame_index])
    assert not any(e.status.measured for e in estimates[doubted[0].frame_index :])


def test_the_gate_does_not_let_a_hidden_marker_leap_to_one_alike():
    def scene(i):
        return picture(still(i) if i < 12 else ball_at(120 + 0.4 * i + 30, 120, 15), noise_seed=i)

    estimates = follow(scene, still, 15)
    assert [e.frame_index for e in doubted_only_by("gate", estimates)] == [12, 13, 14]
    for estimate in estimates[12:]:
        assert estimate.claim.distance(truth(still(estimate.frame_index))) > 20
        assert estimate.circle.distance(truth(still(estimate.frame_index))) < 5  # the filter's own


def test_the_seeds_template_does_not_give_up_a_marker_that_is_just_where_it_is_expected():
    """Half hidden, and a dark mark goes from the middle to the rim, so that the seed's template is against it."""

    def marker(i):
        return ball_at(160, 120, 15)

    def scene(i):
        moved = 0.3 * max(0, min(i - 8, 27))
        mark = ball_at(162 - moved, 122 - moved, 4.5, rgb=(20, 30, 60), radius_m=0.006)
        return picture(marker(i), mark, covers=(Cover(164, 90, 204, 150),) if i > 3 else (), noise_seed=i)

    estimates = follow(scene, marker, 38)
    assert {e.status for e in estimates[1:]} == {Status.VERIFIED}
    assert max(e.circle.distance(truth(marker(0))) for e in estimates) < 0.5


def test_the_size_check_does_not_take_a_larger_ball_for_a_marker_that_was_lost_for_a_moment():
    def marker(i):
        return ball_at(150, 120, 50)

    def scene(i):
        if i < 6:
            return picture(marker(i), noise_seed=i)
        return picture(*([Ball(marker(i).xyz, ORANGE, 1.35 * RADIUS_M)] if i >= 12 else []), noise_seed=i)

    estimates = follow(scene, marker, 18)
    assert estimates[11].status is Status.LOST
    assert [e.frame_index for e in doubted_only_by("size", estimates)] == [*range(12, 18)]


def test_the_outline_check_ends_it_when_a_board_comes_over_the_marker():
    """Votes on what shows and the seed's template are for it to the end; there is just too little outline left."""

    def scene(i):
        x = truth(still(i)).x_px + 16 - 0.6 * max(0, i - 8)
        return picture(still(i), covers=(Cover(int(x), 0, 320, 240),) if i >= 8 else (), noise_seed=i)

    estimates = follow(scene, still, 62)
    doubted = doubted_only_by("outline", estimates)
    assert max(e.visible for e in doubted) < JURY.near_visible
    verified = [e for e in estimates if e.status is Status.VERIFIED]
    assert min(e.visible for e in verified) >= JURY.near_visible
    assert max(e.circle.distance(truth(still(e.frame_index))) for e in verified) < 3
    assert not any(e.status.measured for e in estimates[doubted[-1].frame_index :])


def test_what_closes_on_the_marker_from_both_sides_is_not_taken_for_it_elsewhere():
    """Its colours and six votes to the end, and the boards' edges for an outline beside it."""

    def scene(i):
        half = max(2, 17 - 0.25 * max(0, i - 10))
        x = truth(still(i)).x_px
        covers = Cover(int(x - half) - 40, 0, int(x - half), 240), Cover(int(x + half), 0, int(x + half) + 40, 240)
        return picture(still(i), covers=covers if i >= 10 else (), noise_seed=i)

    verified = [e for e in follow(scene, still, 62) if e.status is Status.VERIFIED]
    assert len(verified) > 45
    assert max(e.circle.distance(truth(still(e.frame_index))) for e in verified) < 3


def test_a_marker_of_which_too_little_shows_is_followed_by_kcf():
    """It turns back behind a board that leaves a third of its outline, where half is asked for: the filter alone would
    go on as before, 30 pixels too far by the end."""

    def swinging(i):
        return ball_at(160 + 40 * math.sin(i / 12), 120, 15)

    def scene(i):
        x = truth(swinging(i)).x_px - 5
        return picture(swinging(i), covers=(Cover(int(x), 0, 320, 240),) if i >= 12 else (), noise_seed=i)

    asking = ChainConfig(jury=JuryConfig(visible=0.5, near_visible=0.5))
    behind = follow(scene, swinging, 30, asking)[12:]
    assert sum(e.status is Status.ESTIMATED for e in behind) > 12
    assert all(e.status in (Status.ESTIMATED, Status.VERIFIED) for e in behind)
    assert max(e.circle.distance(truth(swinging(e.frame_index))) for e in behind) < 6


def test_the_part_check_doubts_a_claim_around_which_the_colour_goes_on():
    """Before a wall of its own colour: what is still seen of an outline might be a part of something larger."""
    wall = Ball((0.08, 0.0, 1.3), ORANGE, 0.12)

    def marker(i):
        return ball_at(90 + 1.5 * i, 120, 15)

    estimates = follow(lambda i: picture(wall, marker(i), noise_seed=i, shading=0), marker, 52)
    doubted = doubted_only_by("part", estimates)
    assert all(JURY.near_visible <= e.visible < 0.6 for e in doubted)


def test_a_marker_that_another_one_covers_is_not_taken_for_it():
    """Two of one colour cross; the nearer one has the circle, and the farther one is told so."""

    def far(i):
        return Ball((-0.07 + 0.0025 * i, 0.0, 0.9))

    def near(i):
        return Ball((0.07 - 0.0025 * i, 0.0, 0.85))

    markers = tuple(MarkerSpec(name, 2 * RADIUS_M) for name in ("far", "near"))
    session = Session(CAMERA, markers, (Seed("far", 0, truth(far(0))), Seed("near", 0, truth(near(0)))))
    results = list(session.run(bgr_frame(picture(far(i), near(i), noise_seed=i), i) for i in range(56)))
    hidden = [r.estimates[0] for r in results if "covered" in r.estimates[0].reasons]
    assert any(e.reasons == ("covered",) for e in hidden)
    for estimate in hidden:
        assert not estimate.status.measured
    for result in results:
        behind, before = result.estimates
        assert before.status.measured
        assert before.circle.distance(truth(near(result.frame_index))) < 1
        if behind.status.measured:
            assert behind.circle.distance(truth(far(result.frame_index))) < 1.5
    assert results[-1].estimates[0].status is Status.VERIFIED
