import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference.hog import hog as reference_hog
from spheremcap.tracking.hog import FEATURES, hog

CELL = 4
RNG = np.random.default_rng(4)


def smooth_picture(rows=32, columns=40, channels=3):
    coarse = RNG.integers(30, 220, (rows // 4 + 1, columns // 4 + 1, channels)).astype(np.uint8)
    return np.kron(coarse, np.ones((4, 4, 1)))[2 : rows + 2, 2 : columns + 2].astype(np.uint8)


def untied_picture(rows, columns):
    """Random colours in which no pixel's gradient lies exactly between two bins (straight up or down)."""
    for seed in range(500):
        image = np.random.default_rng(seed).integers(0, 256, (rows, columns, 3)).astype(np.uint8)
        image[:, [0, -1]] = 128  # the picture is mirrored there, so nothing but straight up and down is left
        wide = np.pad(image.astype(float), ((1, 1), (1, 1), (0, 0)), mode="reflect")
        dx, dy = wide[1:-1, 2:] - wide[1:-1, :-2], wide[2:, 1:-1] - wide[:-2, 1:-1]
        power = dx**2 + dy**2
        best = power.argmax(axis=2)[..., None]
        if (np.take_along_axis(dx, best, 2)[..., 0][power.max(axis=2) > 0] != 0).all():
            return image
    raise RuntimeError("no such picture")


def felzenszwalb(image, cell):
    """Section 6 of the paper, one pixel and one cell at a time."""
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    wide = np.pad(image.astype(float), ((1, 1), (1, 1), (0, 0)), mode="reflect")
    signed = np.zeros((18, rows, columns))
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            dx = wide[y + 1, x + 2] - wide[y + 1, x]
            dy = wide[y + 2, x + 1] - wide[y, x + 1]
            c = int(np.argmax(dx**2 + dy**2))
            angle = np.arctan2(dy[c], dx[c]) % (2 * np.pi)
            k = int(np.rint(angle / (2 * np.pi) * 18)) % 18
            cy, cx = (y + 0.5) / cell - 0.5, (x + 0.5) / cell - 0.5
            for i in (int(np.floor(cy)), int(np.floor(cy)) + 1):
                for j in (int(np.floor(cx)), int(np.floor(cx)) + 1):
                    if 0 <= i < rows and 0 <= j < columns:
                        share = (1 - abs(cy - i)) * (1 - abs(cx - j))
                        signed[k, i, j] += share * np.hypot(dx[c], dy[c])
    unsigned = signed[:9] + signed[9:]
    energy = np.pad((unsigned**2).sum(axis=0), 1, mode="edge")
    out = np.zeros((31, rows, columns))
    for i in range(rows):
        for j in range(columns):
            for k, (a, b) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
                norm = np.sqrt(energy[i + a : i + a + 2, j + b : j + b + 2].sum() + 1e-4)
                cut = np.minimum(signed[:, i, j] / norm, 0.2)
                out[:18, i, j] += cut / 2
                out[18:27, i, j] += np.minimum(unsigned[:, i, j] / norm, 0.2) / 2
                out[27 + k, i, j] = 0.2357 * cut.sum()
    return out


def test_a_cell_has_31_features():
    assert FEATURES == 31
    assert hog(smooth_picture(), CELL).shape == (31, 8, 10)
    assert hog(smooth_picture()[..., 0].copy(), CELL).shape == (31, 8, 10)


def test_features_are_those_of_the_paper_pixel_by_pixel():
    image = untied_picture(16, 20)
    np.testing.assert_allclose(hog(image, CELL), felzenszwalb(image, CELL), atol=2e-3)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9), st.integers(2, 8), st.sampled_from([2, 40, 256])
)
def test_the_kernel_equals_the_reference(seed, rows, columns, cell, levels):
    """To float32's rounding; few grey levels make many flat places, equal channels and gradients on a bin's edge."""
    image = np.random.default_rng(seed).integers(0, levels, (rows * cell, columns * cell, 3)).astype(np.uint8)
    np.testing.assert_allclose(hog(image, cell), reference_hog(image, cell), atol=2e-6)


@pytest.mark.parametrize(("contrast", "brightness"), [(0.5, 0), (1.0, 30), (0.7, 60)])
def test_contrast_and_brightness_change_nothing(contrast, brightness):
    image = smooth_picture()
    image = (image // 10 * 10).astype(np.uint8)  # so that the changed picture is exact too
    changed = (image * contrast + brightness).astype(np.uint8)
    np.testing.assert_allclose(hog(changed, CELL), hog(image, CELL), atol=1e-3)


def test_moving_the_picture_by_a_cell_moves_the_features_by_a_cell():
    image = smooth_picture(40, 48)
    here, right, down = (hog(image[y : y + 32, x : x + 40].copy(), CELL) for y, x in ((0, 0), (0, 4), (4, 0)))
    # Two cells at the border feel what is beyond it.
    np.testing.assert_allclose(right[:, 2:-2, 2:-3], here[:, 2:-2, 3:-2], atol=1e-5)
    np.testing.assert_allclose(down[:, 2:-3, 2:-2], here[:, 3:-2, 2:-2], atol=1e-5)


def assert_sign_blind(image):
    plain, negative = hog(image, CELL), hog(255 - image, CELL)
    np.testing.assert_allclose(negative[18:27], plain[18:27], atol=1e-5)
    np.testing.assert_allclose(negative[:9], plain[9:18], atol=1e-5)
    assert np.abs(negative[:18] - plain[:18]).max() > 0.1


def test_the_nine_insensitive_features_do_not_tell_dark_on_bright_from_bright_on_dark():
    assert_sign_blind(untied_picture(16, 20))


def test_that_holds_for_gradients_straight_up_and_down_too():
    assert_sign_blind(smooth_picture())


@pytest.mark.parametrize(("along", "bin_"), [((1, 0), 0), ((0, 1), 4.5), ((-1, 0), 9), ((0, -1), 13.5)])
def test_a_ramp_falls_into_the_bin_of_its_direction(along, bin_):
    x, y = np.meshgrid(np.arange(32.0), np.arange(32.0))
    ramp = np.clip(128 + 3 * (along[0] * (x - 16) + along[1] * (y - 16)), 0, 255).astype(np.uint8)
    features = hog(ramp, CELL)[:18, 4, 4]
    strong = np.flatnonzero(features > 0.05)
    assert len(strong) == 1
    assert min(abs(strong[0] - bin_), 18 - abs(strong[0] - bin_)) <= 0.5


def test_a_flat_picture_has_no_features():
    assert np.abs(hog(np.full((16, 16, 3), 90, np.uint8), CELL)).max() == 0


def test_no_feature_grows_beyond_the_truncation():
    features = hog(RNG.integers(0, 256, (64, 64, 3)).astype(np.uint8), CELL)
    assert features.min() >= 0
    assert features[:27].max() <= 0.4 + 1e-6  # four blocks of at most 0.2, halved


def test_the_strongest_channel_counts():
    gray = smooth_picture(channels=1)
    faint = gray // 4 + 60
    np.testing.assert_allclose(hog(np.concatenate([faint, gray, faint], axis=2), CELL), hog(gray, CELL), atol=1e-6)
