"""The six maps against OpenCV's six methods, and the search against known places."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.verification.matching import MATCHERS, MatchingConfig, make_template, match, six_maps


def random_picture(seed, size):
    return np.random.default_rng(seed).integers(0, 256, (size, size, 3)).astype(np.float32)


def texture(width=200, height=160, seed=0):
    noise = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal((height, width, 3)), (0, 0), 1.5)
    return np.clip(128 + 45 * noise / noise.std(), 0, 255).astype(np.uint8)


def whole(image):
    return Patch(BgrFrame(0, 0, image), Window(0, 0, image.shape[1], image.shape[0]))


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10**6), n=st.integers(3, 21), more=st.integers(2, 25))
def test_every_map_is_opencvs(seed, n, more):
    template, search = random_picture(seed, n), random_picture(seed + 1, n + more)
    maps = six_maps(template, search)
    assert tuple(sorted(maps)) == tuple(sorted(MATCHERS))
    for name, values in maps.items():
        expected = cv2.matchTemplate(search, template, getattr(cv2, f"TM_{name}"))
        scale = np.abs(expected).max()
        np.testing.assert_allclose(values, expected, rtol=2e-4, atol=max(2e-5 * scale, 1e-4))


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10**6), n=st.integers(5, 21), more=st.integers(2, 25))
def test_under_a_disc_nothing_outside_it_counts(seed, n, more):
    template, search = random_picture(seed, n), random_picture(seed + 1, n + more)
    off = np.arange(n) - (n - 1) / 2
    disc = (off * off + (off * off)[:, None] <= (n / 2) ** 2).astype(np.float32)
    other = np.where(disc[:, :, None] > 0, template, random_picture(seed + 2, n))
    mask = np.repeat(disc[:, :, None], 3, axis=2)
    again = six_maps(other, search, disc=disc)
    for name, values in six_maps(template, search, disc=disc).items():
        np.testing.assert_array_equal(values, again[name])
        expected = cv2.matchTemplate(search, template, getattr(cv2, f"TM_{name}"), mask=mask)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(values, expected, rtol=2e-3, atol=max(2e-5 * scale, 1e-3), err_msg=name)


def test_votes_do_not_depend_on_what_is_behind_the_marker():
    """A uniform ball before one half of a picture and then before the other, ten times as bright."""
    image = np.full((120, 240, 3), 20, np.uint8)
    image[:, 120:] = 215
    circles = [Circle(60.0, 60.0, 14.0), Circle(180.0, 60.0, 14.0)]
    for c in circles:
        cv2.circle(image, (int(c.x_px), int(c.y_px)), 14, (150, 40, 190), -1, cv2.LINE_AA)
    template = make_template(whole(image), circles[0], MatchingConfig())
    found = match(template, whole(image), circles[1], 12.0, MatchingConfig())
    good = [m.matcher for m in found if m.circle.dice(circles[1]) > 0.9]
    assert {"CCORR_NORMED", "SQDIFF", "SQDIFF_NORMED"} <= set(good)  # a plain disc has no coefficient


def test_maps_of_the_definition_written_out():
    """Eq 3.4-3.6 in double precision, window by window; no shift in channel."""
    f, g = random_picture(1, 7).astype(float), random_picture(2, 15).astype(float)
    maps = six_maps(f.astype(np.float32), g.astype(np.float32))
    for v in range(9):
        for u in range(9):
            w = g[v : v + 7, u : u + 7]
            f0, w0 = f - f.mean(axis=(0, 1)), w - w.mean(axis=(0, 1))
            energy = np.sqrt((f * f).sum() * (w * w).sum())
            assert maps["CCORR"][v, u] == pytest.approx((f * w).sum(), rel=1e-5)
            assert maps["CCORR_NORMED"][v, u] == pytest.approx((f * w).sum() / energy, abs=1e-5)
            assert maps["CCOEFF"][v, u] == pytest.approx((f0 * w0).sum(), rel=1e-3, abs=3)
            assert maps["CCOEFF_NORMED"][v, u] == pytest.approx(
                (f0 * w0).sum() / np.sqrt((f0 * f0).sum() * (w0 * w0).sum()), abs=1e-5
            )
            assert maps["SQDIFF"][v, u] == pytest.approx(((f - w) ** 2).sum(), rel=1e-4)
            assert maps["SQDIFF_NORMED"][v, u] == pytest.approx(min(1, ((f - w) ** 2).sum() / energy), abs=1e-5)


def test_sad_is_the_sum_of_absolute_differences():
    f, g = random_picture(3, 6), random_picture(4, 14)
    maps = six_maps(f, g, "SAD")
    brute = np.array([[np.abs(g[v : v + 6, u : u + 6] - f).sum() for u in range(9)] for v in range(9)])
    np.testing.assert_allclose(maps["SAD"], brute, rtol=1e-5)
    assert len(maps) == 6
    assert {"SAD", "SAD_NORMED"} <= set(maps)
    assert not any(name.startswith("SQDIFF") for name in maps)


@pytest.mark.parametrize("difference", ["SQDIFF", "SAD"])
def test_all_six_are_best_where_the_template_was_cut(difference):
    search = random_picture(5, 30)
    maps = six_maps(search[9:18, 13:22].copy(), search, difference)
    for name, values in maps.items():
        best = values.argmin() if name.startswith(("SQDIFF", "SAD")) else values.argmax()
        if name == "CCORR":  # plain correlation likes bright places too
            continue
        assert np.unravel_index(best, values.shape) == (9, 13)


def test_normalised_maps_stay_in_their_range():
    maps = six_maps(random_picture(6, 9), random_picture(7, 40))
    assert 0 <= maps["CCORR_NORMED"].min() <= maps["CCORR_NORMED"].max() <= 1 + 1e-5
    assert np.abs(maps["CCOEFF_NORMED"]).max() <= 1 + 1e-5
    assert 0 <= maps["SQDIFF_NORMED"].min() <= maps["SQDIFF_NORMED"].max() <= 1 + 1e-5


@pytest.mark.parametrize("level", [0, 90])
def test_flat_pictures_give_finite_maps(level):
    flat = np.full((20, 20, 3), level, np.float32)
    for template in (flat[:7, :7].copy(), random_picture(8, 7)):
        for name, values in six_maps(template, flat).items():
            assert np.isfinite(values).all(), name


def test_brightness_changes_move_no_normalised_peak():
    search = random_picture(9, 30)
    template = search[5:14, 11:20] * np.float32(0.6)
    maps = six_maps(template, search)
    for name in ("CCORR_NORMED", "CCOEFF_NORMED", "CCOEFF"):
        assert np.unravel_index(maps[name].argmax(), maps[name].shape) == (5, 11), name


# -- the search on the picture ---------------------------------------------------------------------


@pytest.mark.parametrize(("dx", "dy"), [(0, 0), (5, -3), (-7, 6), (2.4, 3.7), (-0.5, -6.3)])
@pytest.mark.parametrize("r_px", [9.0, 16.0])
def test_every_matcher_finds_a_moved_picture_to_a_fifth_of_a_pixel(dx, dy, r_px):
    image = texture()
    m = np.array([[1, 0, dx], [0, 1, dy]], np.float64)
    moved = cv2.warpAffine(image, m, image.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    circle = Circle(101.0, 83.0, r_px)
    template = make_template(whole(image), circle, MatchingConfig())
    maps = match(template, whole(moved), circle, 10.0, MatchingConfig())
    assert tuple(m.matcher for m in maps) == MATCHERS
    for response in maps:
        if response.matcher in ("CCORR", "CCOEFF"):  # without norms the brighter neighbour pulls
            continue
        assert response.circle.distance(circle.shifted(dx, dy)) < 0.2, response.matcher
        assert response.circle.r_px == r_px


def test_no_vote_lies_beyond_the_reach():
    image = texture()
    circle = Circle(100, 80, 9)
    template = make_template(whole(image), circle, MatchingConfig())
    for seed in range(3):
        for response in match(template, whole(texture(seed=seed + 1)), circle, 6.0, MatchingConfig()):
            assert abs(response.circle.x_px - 100) < 8
            assert abs(response.circle.y_px - 80) < 8


def test_the_peak_is_the_best_of_the_map_and_low_is_best_for_differences():
    image = texture()
    template = make_template(whole(image), Circle(100, 80, 9), MatchingConfig())
    for response in match(template, whole(image), Circle(103, 79, 9), 8.0, MatchingConfig()):
        column, row = response.peak
        best = response.values.min() if response.best_is_low else response.values.max()
        assert response.values[row, column] == best
        assert response.best_is_low == response.matcher.startswith("SQDIFF")


def test_votes_have_the_size_expected_now():
    """A marker 8 % larger than its template is matched at its own scale."""
    image = texture()
    grown = cv2.warpAffine(
        image, np.array([[1.08, 0, -8.0], [0, 1.08, -6.4]]), image.shape[1::-1], borderMode=cv2.BORDER_REFLECT
    )
    template = make_template(whole(image), Circle(100, 80, 15), MatchingConfig())
    maps = match(template, whole(grown), Circle(102, 78, 16.2), 6.0, MatchingConfig())
    for response in maps:
        if response.matcher == "CCORR":
            continue
        assert response.circle.r_px == 16.2
        assert response.circle.distance(Circle(100, 80, 1)) < 0.35, response.matcher


def test_coordinates_are_the_images_not_the_patches():
    frame = BgrFrame(0, 0, texture())
    circle = Circle(100, 80, 9)
    answers = []
    for window in (Window(0, 0, 200, 160), Window(70, 50, 61, 61)):
        patch = Patch(frame, window)
        template = make_template(patch, circle, MatchingConfig())
        answers.append([m.circle for m in match(template, patch, circle.shifted(2, 1), 6.0, MatchingConfig())])
    for a, b in zip(*answers, strict=True):
        assert a.distance(b) < 1e-3


def test_a_search_too_small_for_the_template_still_answers_six_times():
    image = texture()
    template = make_template(whole(image), Circle(100, 80, 9), MatchingConfig())
    assert len(match(template, whole(image), Circle(100, 80, 9), 0.0, MatchingConfig())) == 6
