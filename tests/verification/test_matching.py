"""The six maps against OpenCV's six methods, and the search against known places."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference import matching as reference
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame, Patch, Window
from spheremcap.core.sampling import cut_bgr
from spheremcap.verification import matching
from spheremcap.verification.matching import (
    MATCHERS,
    MATCHERS_SAD,
    Gap,
    MatchingConfig,
    cut_disc,
    less_hidden,
    make_template,
    match,
    widest_gap,
)


def six_maps(template, search, difference="SQDIFF", rows=None):
    """The compiled maps by name; a square template unless the columns that count are given."""
    n = len(template)
    rows = np.tile((0, n), (n, 1)) if rows is None else rows
    values = matching.six_maps(template, rows, search, difference == "SAD")
    return dict(zip(MATCHERS_SAD if difference == "SAD" else MATCHERS, values, strict=True))


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


def some_rows(seed, n):
    """Which columns count, any from none to all in every row."""
    rows = np.sort(np.random.default_rng(seed).integers(0, n + 1, (n, 2)), axis=1)
    rows[n // 2] = 0, n
    return rows


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(3, 27),
    more=st.integers(2, 25),
    zero_mean=st.booleans(),
    difference=st.sampled_from(["SQDIFF", "SAD"]),
)
def test_every_map_equals_the_reference_and_nothing_outside_the_rows_counts(seed, n, more, zero_mean, difference):
    """To 2e-4 of a value, and 2e-5 of the map's greatest: sums of up to 2000 squares in single precision."""
    template, search = random_picture(seed, n), random_picture(seed + 1, n + more)
    if zero_mean:
        template, search = template - 128, search - 128
    rows = some_rows(seed, n)
    disc = reference.disc_of(rows)
    expected = reference.six_maps(template, search, difference, disc)
    ours = six_maps(template, search, difference, rows)
    assert list(ours) == list(expected)
    other = np.where(disc[:, :, None] > 0, template, random_picture(seed + 2, n))
    again = six_maps(other, search, difference, rows)
    for name, values in ours.items():
        scale = np.abs(expected[name]).max()
        # The normalised coefficient of a few pixels divides by a variance that is nearly nothing.
        tolerance = 2e-3 if name == "CCOEFF_NORMED" else max(2e-5 * scale, 1e-4)
        np.testing.assert_allclose(values, expected[name], rtol=2e-4, atol=tolerance, err_msg=name)
        np.testing.assert_array_equal(values, again[name])


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    x=st.floats(8, 32),
    y=st.floats(8, 27),
    step=st.floats(0.3, 4),
    grid=st.booleans(),
)
def test_the_search_is_the_reference_at_any_place_and_scale(seed, x, y, step, grid):
    """Bilinear or, on the patch's own grid, the pixels themselves; maps and peaks as the reference has them."""
    bgr = np.random.default_rng(seed).integers(0, 256, (35, 40, 3)).astype(np.uint8)
    if grid:
        x, y, step = float(round(x)), float(round(y)), 1.0
    pixels, rows = cut_disc(bgr, x, y, step, 4.3)
    assert pixels.shape == (9, 9, 3)
    np.testing.assert_allclose(pixels, reference.square(bgr, x - 4 * step, y - 4 * step, step, 9), atol=2e-3)
    # The patch lies at (7, -5) of an image of half its scale, and a radius of 2 template pixels is sought and claimed.
    around, claim = (7 + 0.5 * (x + 1), -5 + 0.5 * (y - 1), step), (7 + 0.5 * (x + 2), -5 + 0.5 * y, 1.1 * step)
    values, peaks, found = matching.search_six(bgr, 7.0, -5.0, 0.5, *around, *claim, 2.0, 3, pixels, rows, False)
    assert values.shape == (6, 7, 7)
    search = reference.square(bgr, x + 1 - 7 * step, y - 1 - 7 * step, step, 15)
    mean = search.mean(axis=(0, 1))
    expected = reference.six_maps(pixels - mean, search - mean, "SQDIFF", reference.disc_of(rows))
    power = np.abs(expected["SQDIFF"]).max()
    for k, (name, goal) in enumerate(expected.items()):
        scale = 2e-3 if name.endswith("NORMED") else 2e-5 * power
        np.testing.assert_allclose(values[k], goal, rtol=1e-3, atol=scale, err_msg=name)
        column, row, dx, dy = reference.peak(-values[k] if name.startswith("SQDIFF") else values[k])
        assert peaks[k].tolist() == [column, row], name
        circle = Circle(*around).shifted(0.5 * (column + dx - 3) * step, 0.5 * (row + dy - 3) * step)
        np.testing.assert_allclose(found[:3, k], (circle.x_px, circle.y_px, step), atol=1e-3)
        assert found[3, k] == values[k][row, column]
        assert found[4, k] == pytest.approx(Circle(*found[:3, k]).dice(Circle(*claim)), abs=1e-12)


def test_the_template_is_a_disc_of_the_radius_asked_for():
    for radius in (3.0, 4.3, 10.0, 12.8):
        pixels, rows = cut_disc(texture(), 100.0, 80.0, 1.0, radius)
        n = len(pixels)
        off = np.arange(n) - (n - 1) // 2
        np.testing.assert_array_equal(reference.disc_of(rows), off**2 + (off**2)[:, None] <= radius**2)


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


def test_a_window_of_one_colour_has_no_coefficient_rather_than_a_wild_one():
    """Beyond the border of the patch all pixels are alike, and their variance is what rounding leaves of it."""
    image = texture()
    template = make_template(whole(image), Circle(100, 80, 12.8), MatchingConfig())
    values = match(template, whole(image), Circle(-20.3, -25.1, 12.8), 12.8, MatchingConfig()).values
    assert values[3, :5, :5].tolist() == np.zeros((5, 5)).tolist()
    for k in (1, 3, 5):
        assert np.abs(values[k]).max() <= 1 + 1e-5


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


@pytest.mark.parametrize("r_px", [6.0, 12.8, 25.0])
def test_a_patch_at_the_markers_own_scale_gives_the_same_votes(r_px):
    """Template and search from patches in which the marker has 12.8 px, each with its own centre and step."""
    blurred = cv2.GaussianBlur(np.random.default_rng(2).standard_normal((200, 240, 3)), (0, 0), max(1.0, r_px / 5))
    image = np.clip(128 + 45 * blurred / blurred.std(), 0, 255).astype(np.uint8)
    frame = BgrFrame(0, 0, image)
    circle = Circle(111.3, 93.8, r_px)
    seen = circle.shifted(0.21 * r_px, -0.13 * r_px)
    patches = []
    for middle in (circle, seen):
        step = middle.r_px / 12.8
        x0, y0 = middle.x_px - 32 * step, middle.y_px - 32 * step
        patches.append(Patch.scaled(frame, cut_bgr(*frame.planes, x0, y0, step, 64, 64), x0, y0, step))
    template = make_template(patches[0], circle, MatchingConfig())
    for response in match(template, patches[1], seen, 0.5 * r_px, MatchingConfig()):
        if response.matcher == "CCORR":
            continue
        assert response.circle.distance(circle) < 0.03 * r_px, response.matcher
        assert response.circle.r_px == r_px


def test_matches_are_six_maps_in_order():
    image = texture()
    for difference, names in (("SQDIFF", MATCHERS), ("SAD", MATCHERS_SAD)):
        config = MatchingConfig(difference=difference)
        template = make_template(whole(image), Circle(100, 80, 12.8), config)
        found = match(template, whole(image), Circle(101, 80, 12.8), 6.4, config)
        assert len(found) == len(tuple(found)) == 6
        assert tuple(m.matcher for m in found) == names == found.matchers
        assert tuple(m.circle for m in found) == found.circles
        assert found.values.shape == (6, 13, 13)  # 6 template pixels each way
        assert [m.best_is_low for m in found] == [False] * 4 + [True] * 2
        for response, score in zip(found, found.scores, strict=True):
            assert response.values[response.peak[1], response.peak[0]] == np.float32(score)
        # It lies one pixel to the left, and there nothing differs but what single precision leaves of such sums.
        assert found.values[4][6, 5] < 1e-6 * found.values[4].max()


@pytest.mark.parametrize("d", [0.0, 1.5, 6.0, 25.0])
def test_each_circle_is_compared_with_the_claim(d):
    image = texture()
    circle, config = Circle(100, 80, 12.8), MatchingConfig()
    template = make_template(whole(image), circle, config)
    for r_px in (5.0, 12.8, 14.0):
        claim = Circle(100 + d, 80 - d / 3, r_px)
        found = match(template, whole(image), circle, 6.4, config, claim)
        assert found.overlaps == pytest.approx([c.dice(claim) for c in found.circles])
    assert match(template, whole(image), circle, 6.4, config).overlaps == (0.0,) * 6


def test_coordinates_are_the_images_not_the_patches():
    frame = BgrFrame(0, 0, texture())
    circle = Circle(100, 80, 9)
    answers = []
    for window in (Window(0, 0, 200, 160), Window(70, 50, 61, 61)):
        patch = Patch(frame, window)
        template = make_template(patch, circle, MatchingConfig())
        answers.append(match(template, patch, circle.shifted(2, 1), 6.0, MatchingConfig()).circles)
    for a, b in zip(*answers, strict=True):
        assert a.distance(b) < 1e-3


def test_a_search_too_small_for_the_template_still_answers_six_times():
    image = texture()
    template = make_template(whole(image), Circle(100, 80, 9), MatchingConfig())
    assert len(match(template, whole(image), Circle(100, 80, 9), 0.0, MatchingConfig())) == 6


# -- what is hidden --------------------------------------------------------------------------------


def outline(circle, *stretches, rays=48):
    """Edge points (N, 2) on a circle at the rays whose angle, in degrees, lies within one of the stretches."""
    angles = np.arange(rays) * 360 / rays
    kept = np.radians([a for a in angles if any(low <= a <= high for low, high in stretches)])
    return np.stack([circle.x_px + circle.r_px * np.cos(kept), circle.y_px + circle.r_px * np.sin(kept)], axis=1)


DISC = Circle(90.0, 70.0, 20.0)


@pytest.mark.parametrize(
    ("stretches", "towards", "half"),
    [
        ([(90, 270)], 0, 90),  # the right half is hidden: from 270 over 360 to 90
        ([(0, 180)], -90, 90),  # y goes down: the upper half
        ([(0, 90), (270, 352.5)], 180, 90),
        ([(0, 52.5), (142.5, 180), (210, 352.5)], 97.5, 45),  # the wider one of two
        ([(0, 352.5)], None, 3.75),
    ],
)
def test_the_widest_stretch_without_an_edge_is_found(stretches, towards, half):
    gap = widest_gap(DISC, outline(DISC, *stretches))
    assert np.degrees(gap.half) == pytest.approx(half)
    if towards is not None:
        off = (np.degrees(gap.towards) - towards + 180) % 360 - 180
        assert off == pytest.approx(0, abs=1e-9)


def test_without_points_nothing_is_said_to_be_hidden():
    assert widest_gap(DISC, np.zeros((0, 2))) == Gap()
    assert Gap().shown == 1.0


@pytest.mark.parametrize("half", [0.0, 45.0, 45.1, 90.0, 135.0, 180.0])
def test_the_share_shown_is_that_of_the_disc_on_this_side_of_the_chord(half):
    gap, n = Gap(0.0, np.radians(half)), 401
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    disc = np.hypot(x, y) <= 1
    shown = (disc & (x <= np.cos(gap.half))).sum() / disc.sum() if half > 45 else 1.0
    assert gap.shown == pytest.approx(shown, abs=5e-3)


@settings(deadline=None, max_examples=60)
@given(towards=st.floats(-7, 7), half=st.floats(0.8, 3.14))
def test_a_template_loses_just_what_lies_beyond_the_chord(towards, half):
    template = make_template(whole(texture()), DISC, MatchingConfig())
    kept = less_hidden(template, Gap(towards, half))
    middle = (len(template.rows) - 1) // 2
    for i, ((first, end), (low, high)) in enumerate(zip(kept.rows, template.rows, strict=True)):
        columns = np.arange(low, high)
        depth = np.cos(towards) * (columns - middle) + np.sin(towards) * (i - middle)
        this_side = columns[depth <= template.r_px * np.cos(half) + 1e-9]
        near = np.abs(depth - template.r_px * np.cos(half)) < 1e-6
        assert set(range(first, end)) ^ set(this_side.tolist()) <= set(columns[near].tolist())
    assert kept.pixels is template.pixels


def test_a_quarter_that_shows_no_edge_hides_nothing():
    template = make_template(whole(texture()), DISC, MatchingConfig())
    assert less_hidden(template, Gap(0.3, np.pi / 4)) is template


def test_six_matchers_find_a_marker_of_which_half_is_covered_by_what_shows():
    before = (110 + 0.1 * (texture(seed=1) - 128.0)).astype(np.uint8)
    after = before.copy()
    after[:, 88:] = 235  # a bright board comes over its right half
    template = make_template(whole(before), DISC, MatchingConfig())
    claimed = DISC.shifted(0.4, 0.2)
    gap = widest_gap(claimed, outline(claimed, (90, 270)))
    plain = match(template, whole(after), DISC.shifted(6, 4), 20.0, MatchingConfig(), claimed)
    shown = match(less_hidden(template, gap), whole(after), DISC.shifted(6, 4), 20.0, MatchingConfig(), claimed)
    assert sum(shown.overlaps) > 4.9
    assert sum(plain.overlaps) < sum(shown.overlaps) - 1
