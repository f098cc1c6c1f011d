"""The seed's colours at the brightness the marker has by now."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference import colour as reference
from scenes import BLUE, GREEN, ORANGE, Cover, ball_at, bgr_frame, picture, truth
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.core.sampling import cut_bgr
from spheremcap.detection.appearance import Appearance, ring_colours
from spheremcap.detection.colour import ColourBox, ColourConfig, box_mask

BALL = ball_at(150.3, 117.8, 18)
CIRCLE = truth(BALL)


def own_scale(image, circle):
    """The patch in which the marker has 12.8 px."""
    frame, step = BgrFrame(0, 0, image), circle.r_px / 12.8
    x0, y0 = circle.x_px - 32 * step, circle.y_px - 32 * step
    return Patch.scaled(frame, cut_bgr(*frame.planes, x0, y0, step, 64, 64), x0, y0, step)


def dimmed(image, gain):
    return np.rint(np.clip(image * gain, 0, 255)).astype(np.uint8)


def seeded(image=None, circle=CIRCLE):
    return Appearance(own_scale(picture(BALL) if image is None else image, circle), circle, 1.0, ColourConfig())


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    x=st.floats(-10, 40),
    y=st.floats(-10, 40),
    beyond=st.sampled_from([-1.0, 1.0, 4.0, 7.5]),
    within=st.floats(1, 14),
    picture=st.tuples(st.integers(0, 8), st.integers(0, 8), st.integers(18, 30), st.integers(18, 26)),
    hue=st.floats(0, 179),
    half=st.floats(5, 95),
)
def test_the_compiled_counts_equal_the_reference(seed, x, y, beyond, within, picture, hue, half):
    """Exactly: they are counts, and medians of whole values."""
    bgr = np.random.default_rng(seed).integers(0, 256, (26, 30, 3)).astype(np.uint8)
    limits = ColourBox(hue, half, (40.0, 230.0), (30.0, 220.0)).limits()
    ours = ring_colours(bgr, *picture, x, y, beyond, within, limits)
    assert ours == pytest.approx(reference.ring_colours(bgr, picture, x, y, beyond, within, limits), nan_ok=True)


@pytest.mark.parametrize("gain", [0.45, 0.8, 1.0, 1.6])
@pytest.mark.parametrize("rgb", [ORANGE, GREEN, BLUE])
def test_shares_equal_the_reference(rgb, gain):
    ball = ball_at(150.3, 117.8, 18, rgb=rgb)
    image, circle = picture(ball, covers=(Cover(150, 90, 200, 130),)), truth(ball)
    appearance = seeded(picture(ball), circle)
    for claim in (circle, Circle(141, 112, 9), Circle(165, 121, 25), Circle(2, 118, 18), Circle(-200, 0, 9)):
        patch = own_scale(dimmed(image, gain), claim) if claim.x_px > 0 else Patch(bgr_frame(image), Window(0, 0, 9, 9))
        assert appearance.shares(patch, claim) == pytest.approx(reference.shares(appearance, patch, claim))


def test_a_seed_has_its_own_colours_inside_and_few_around():
    appearance = seeded()
    assert appearance.inside > 0.85
    assert appearance.around < 0.3
    assert appearance.gain == 1.0


@pytest.mark.parametrize("step", [0.5, 1.0, 1.4])
def test_shares_hardly_depend_on_the_patchs_scale(step):
    frame, (x0, y0) = bgr_frame(picture(BALL)), (CIRCLE.x_px - 35.3, CIRCLE.y_px - 36.1)
    side = int(72 / step)
    patch = Patch.scaled(frame, cut_bgr(*frame.planes, x0, y0, step, side, side), x0, y0, step)
    assert seeded().shares(patch, CIRCLE) == pytest.approx(
        seeded().shares(own_scale(frame.image, CIRCLE), CIRCLE), abs=0.05
    )


def test_a_claim_on_a_part_of_the_marker_has_its_colour_all_around():
    patch = own_scale(picture(BALL), CIRCLE)
    inside, around = seeded().shares(patch, Circle(CIRCLE.x_px, CIRCLE.y_px, 9.0))
    assert inside > 0.9
    assert around > 0.9


@pytest.mark.parametrize("gain", [0.5, 0.7, 1.3])
def test_the_gain_follows_the_markers_brightness_by_half_a_frame(gain):
    appearance = seeded()
    darker = own_scale(dimmed(picture(BALL), gain), CIRCLE)
    # What the middle of the ball has over what the seed's disc had.
    local = darker.local(CIRCLE)
    rows, columns = np.indices(darker.bgr.shape[:2])
    middle = np.hypot(columns - local.x_px, rows - local.y_px) <= 0.6 * local.r_px
    target = np.median(darker.bgr.max(axis=2)[middle]) / appearance._value
    for k in range(1, 7):
        appearance.follow(darker, CIRCLE, 1.0)
        assert appearance.gain == pytest.approx(target + (1 - target) * 0.5**k, abs=0.02)
    assert appearance.gain == pytest.approx(gain, rel=0.15)


def test_an_occluders_brightness_is_not_taken_in():
    appearance = seeded()
    patch = own_scale(picture(BALL), CIRCLE)
    appearance.follow(patch, CIRCLE, 1.0)
    before = appearance.gain
    grey = picture(BALL, covers=(Cover(152, 90, 200, 140, (40, 40, 45)),))
    appearance.follow(own_scale(grey, CIRCLE), CIRCLE, 0.61)
    assert appearance.gain == pytest.approx(before, abs=0.08)  # half of the ball is still to be seen
    covered = picture(BALL, covers=(Cover(120, 90, 200, 140, (40, 40, 45)),))
    before = appearance.gain
    appearance.follow(own_scale(covered, CIRCLE), CIRCLE, 0.2)
    assert appearance.gain == before


def test_what_hides_much_of_a_dark_marker_may_be_as_dark_and_teaches_no_brightness():
    """A dark red ball behind red trousers."""
    dark = ball_at(150.3, 117.8, 18, rgb=(40, 22, 22))
    appearance = seeded(picture(dark, backdrop=3))
    trousers = own_scale(picture(dark, covers=(Cover(120, 105, 200, 160, (80, 44, 44)),), backdrop=3), CIRCLE)
    appearance.follow(trousers, CIRCLE, 0.6)
    assert appearance.gain == 1.0
    appearance.follow(trousers, CIRCLE, 0.61)
    assert appearance.gain > 1.1


def test_unlike_is_how_far_a_colour_is_from_the_seeds_over_its_contrast():
    appearance, patch = seeded(), own_scale(picture(BALL), CIRCLE)
    assert appearance.unlike(patch, CIRCLE) < 0.1
    assert appearance.unlike(own_scale(picture(ball_at(150.3, 117.8, 18, rgb=BLUE)), CIRCLE), CIRCLE) > 0.8
    assert appearance.unlike(patch, CIRCLE.shifted(60, 0)) > 0.8  # bare background
    assert appearance.unlike(patch, CIRCLE.shifted(1000, 0)) == np.inf
    wall = np.full((240, 320, 3), np.median(patch.bgr[26:38, 26:38], axis=(0, 1)) - 12, np.uint8)
    assert appearance.unlike(own_scale(wall, CIRCLE), CIRCLE) > 10  # nearly its colour, as all around


def test_unlike_knows_the_brightness_that_the_marker_has_by_now():
    appearance, darker = seeded(), own_scale(dimmed(picture(BALL), 0.6), CIRCLE)
    before = appearance.unlike(darker, CIRCLE)
    for _ in range(8):
        appearance.follow(darker, CIRCLE, 1.0)
    assert appearance.unlike(darker, CIRCLE) < 0.6 * before


def mixed(image, share):
    """A picture with a share of grey in it, as motion blur mixes the background into a marker."""
    return np.rint((1 - share) * image + share * 110).astype(np.uint8)


def test_a_seed_in_a_blurred_picture_learns_what_the_marker_is_in_a_clear_one():
    """By whole outlines alone, and no further than half of the seed's own range on each side."""
    clear, pale = own_scale(picture(BALL), CIRCLE), mixed(picture(BALL), 0.3)
    appearance = seeded(pale)
    before, box = appearance.shares(clear, CIRCLE)[0], appearance.box
    assert before < 0.5 * appearance.inside
    for _ in range(8):
        appearance.follow(clear, CIRCLE, 0.9)
    assert appearance.box == box
    for _ in range(8):
        appearance.follow(clear, CIRCLE, 1.0)
    assert appearance.shares(clear, CIRCLE)[0] > before + 0.2
    grown = appearance.box
    assert (grown.hue_mean, grown.hue_half) == (box.hue_mean, box.hue_half)
    for (low, high), (seed_low, seed_high) in ((grown.saturation, box.saturation), (grown.value, box.value)):
        room = 0.5 * (seed_high - seed_low)
        assert seed_low - room <= low <= seed_low
        assert seed_high <= high <= seed_high + room


def hsv(hue, saturation, value, count=100):
    return np.tile(np.array([hue, saturation, value], np.uint8), (count, 1))


def test_the_box_grows_by_pixels_of_its_hue_and_at_the_seeds_exposure():
    appearance = seeded()
    box, room = appearance.box, 0.5 * np.diff(appearance.box.saturation)[0]
    least = box.saturation[0] - 0.5 * room
    own, other = hsv(box.hue_mean, least, box.value[0]), hsv(box.hue_mean + 60, 0, 0, 60)
    appearance._grow(np.concatenate([own, other]))
    assert appearance.box.saturation == pytest.approx((least, box.saturation[1]), abs=1)
    assert appearance.box.value == pytest.approx(box.value, abs=1)
    appearance._grow(hsv(box.hue_mean, 0, box.value[0]))
    assert appearance.box.saturation == pytest.approx((box.saturation[0] - room, box.saturation[1]))
    appearance.gain = 0.5
    appearance._grow(hsv(box.hue_mean, box.saturation[0], 0.5 * (box.value[0] - 5)))
    assert appearance.box.value == pytest.approx((box.value[0] - 5, box.value[1]), abs=2)


def test_another_hue_is_not_learnt():
    appearance = seeded()
    box, other = appearance.box, np.ascontiguousarray(picture(BALL)[..., ::-1])
    for _ in range(4):
        appearance.follow(own_scale(other, CIRCLE), CIRCLE, 1.0)
    assert appearance.box == box


def test_limits_are_looked_up_anew_where_the_exposure_has_changed():
    appearance = seeded()
    same, dark = own_scale(picture(BALL), CIRCLE), own_scale(dimmed(picture(BALL), 0.4), CIRCLE)
    assert appearance.limits(same, CIRCLE).tolist() == appearance.box.limits(1.0).tolist()
    limits = appearance.limits(dark, CIRCLE)
    assert limits[4] < 0.6 * appearance.box.limits(1.0)[4]
    np.testing.assert_array_equal(appearance.mask(dark, CIRCLE), box_mask(dark.bgr, limits))
    assert ring_colours(dark.bgr, *dark.picture, 32.0, 32.0, -1.0, 7.0, limits)[1] > 0.9 * np.pi * 49
    assert appearance.gain == 1.0  # looking changes nothing
    # Where another colour lies there is nothing to be looked up.
    other = own_scale(picture(ball_at(150.3, 117.8, 18, rgb=BLUE)), CIRCLE)
    assert appearance.limits(other, CIRCLE).tolist() == appearance.box.limits(1.0).tolist()


def test_a_dark_half_does_not_hide_that_the_inside_has_the_seeds_colours():
    """The marker is half as bright, and a third of it covered: the share is taken at the exposure that suits it."""
    image = dimmed(picture(BALL), 0.5)
    covers = image.copy()
    cv2.rectangle(covers, (159, 90), (200, 140), (250, 250, 250), -1)
    inside, _ = seeded().shares(own_scale(covers, CIRCLE), CIRCLE)
    assert 0.5 < inside < 0.85


def test_a_seed_outside_the_picture_is_refused():
    patch = Patch(bgr_frame(picture(BALL)), Window(-60, 0, 60, 60))
    with pytest.raises(ValueError, match="no pixels"):
        Appearance(patch, Circle(-30, 30, 10), 1.0, ColourConfig())
