"""What is rendered agrees with its truth: area, centre, hidden part, blur, rolling shutter, repeatability."""

from dataclasses import replace
from fractions import Fraction
from itertools import islice

import numpy as np
import pytest

from spheremcap.core.camera import Camera
from spheremcap.synth.backdrop import _limb
from spheremcap.synth.parts import Athlete, Backdrop, Ball, Card, Sensor, World
from spheremcap.synth.scene import Scene

CAMERA = Camera(240, 180, 400.0, 400.0, 119.5, 89.5, "plumb_bob", (-0.31, 0.17, 0.0, 0.0))
BARE = Sensor(exposure_s=1e-6, readout_s=0.0, psf_px=0.0, noise=False)


def world(path, *, diameter_m=0.08, sensor=BARE, cards=(), camera=CAMERA, ticks=(0, 1001)):
    """A flat white ball on black."""
    ball = Ball("ball", path, (255, 255, 255), diameter_m, gloss=0.0, ambient=1.0, grain=0.0)
    black = Backdrop("gravel", 1.0, (0, 0), brightness=0.0)
    scene = World("test", camera, ticks, Fraction(1, 240_000), (ball,), cards, backdrop=black, sensor=sensor)
    return Scene(scene)


def still(x, y, z):
    return lambda t_s: np.repeat(np.array([[x, y, z]], float), len(t_s), axis=0)


def moving(x, y, z, vx, vy=0.0):
    return lambda t_s: np.stack([x + vx * t_s, y + vy * t_s, z + 0 * t_s], axis=1)


def disc(scene, index=0):
    """Area in px² and centroid of the white light over the black (gravel's own light taken off)."""
    empty = Scene(replace(scene.world, balls=()))
    behind = empty.light(index)[..., 1].astype(float)
    white = ((scene.light(index)[..., 1] - behind) / (1 - behind)).clip(0, 1)
    y, x = np.mgrid[: white.shape[0], : white.shape[1]]
    return white.sum(), (white * x).sum() / white.sum(), (white * y).sum() / white.sum(), white


@pytest.mark.parametrize("sensor", [BARE, replace(BARE, psf_px=0.6)])
@pytest.mark.parametrize("place", [(0.0, 0.0, 1.0), (0.2013, -0.1107, 1.003), (-0.11, 0.15, 3.2)])
def test_disc_has_the_area_and_centre_of_its_truth(place, sensor):
    scene = world(still(*place), sensor=sensor)
    truth = scene.truth(0)[0]
    area, x, y, _ = disc(scene)
    assert np.sqrt(area / np.pi) == pytest.approx(truth.circle.r_px, abs=0.01)
    assert (x, y) == pytest.approx((truth.circle.x_px, truth.circle.y_px), abs=0.02)
    assert truth.visible == 1.0
    assert truth.in_picture


def test_coverage_is_that_of_a_finely_sampled_disc():
    scene = world(still(0.0503, 0.0201, 1.0))
    circle = scene.truth(0)[0].ellipse
    *_, white = disc(scene)
    fine = (np.arange(16) + 0.5) / 16 - 0.5
    y = (np.arange(180)[:, None] + fine).ravel()
    x = (np.arange(240)[:, None] + fine).ravel()
    cos, sin = np.cos(circle.angle_rad), np.sin(circle.angle_rad)
    dx, dy = x[None, :] - circle.x_px, y[:, None] - circle.y_px
    inside = ((dx * cos + dy * sin) / circle.a_px) ** 2 + ((dy * cos - dx * sin) / circle.b_px) ** 2 < 1
    expected = inside.reshape(180, 16, 240, 16).mean(axis=(1, 3))
    assert abs(white - expected).max() < 0.02
    assert np.sqrt(np.mean((white - expected)[(expected > 0) & (expected < 1)] ** 2)) < 0.008


def test_blur_keeps_light_and_centre_and_spreads_along_the_motion():
    sensor = replace(BARE, exposure_s=1 / 240)
    scene = world(moving(0.0, 0.02, 1.0, 9.6), sensor=sensor)
    truth = scene.truth(0)[0]
    area, x, y, white = disc(scene)
    assert area == pytest.approx(truth.circle.area_px2, rel=3e-3)
    assert (x, y) == pytest.approx((truth.circle.x_px, truth.circle.y_px), abs=0.03)
    columns, rows = np.nonzero(white.max(axis=0) > 0.02)[0], np.nonzero(white.max(axis=1) > 0.02)[0]
    assert np.ptp(columns) == pytest.approx(2 * truth.circle.r_px + 16, abs=2)
    assert np.ptp(rows) == pytest.approx(2 * truth.circle.r_px, abs=2)
    # Half-way up the streak's ramp the light is even: no steps from too few instants.
    ramp = white[round(truth.circle.y_px), columns[0] : columns[0] + 14]
    assert np.all(np.diff(ramp) > -0.01)
    assert np.diff(ramp).max() < 0.12


def test_rolling_shutter_picture_agrees_with_its_truth():
    sensor = replace(BARE, readout_s=0.0036)
    scene = world(moving(0.05, 0.12, 1.0, 6.0, 4.0), sensor=sensor)
    truth = scene.truth(0)[0]
    area, x, y, _ = disc(scene)
    assert area == pytest.approx(truth.circle.area_px2, rel=3e-3)
    assert (x, y) == pytest.approx((truth.circle.x_px, truth.circle.y_px), abs=0.02)
    late = (truth.centre_px[1] - 89.5) * scene.row_s
    assert truth.xyz_cam_m == pytest.approx((0.05 + 6 * late, 0.12 + 4 * late, 1.0), abs=1e-6)
    assert truth.velocity_cam_mps == pytest.approx((6, 4, 0), abs=1e-4)


def test_visible_fraction_behind_a_card_and_the_border():
    card = Card(lambda t: np.tile([119.5 + 50, 89.5, 0.0], (len(t), 1)), (50.0, 80.0), 0.5)
    truth = world(still(0.0, 0.0, 1.0), cards=(card,)).truth(0)[0]
    assert truth.visible == pytest.approx(0.5, abs=0.005)
    over = Card(lambda t: np.tile([119.5, 89.5, 0.3], (len(t), 1)), (50.0, 80.0), 0.5)
    assert world(still(0.0, 0.0, 1.0), cards=(over,)).truth(0)[0].visible == 0.0
    behind = replace(over, depth_m=2.0)
    assert world(still(0.0, 0.0, 1.0), cards=(behind,)).truth(0)[0].visible == 1.0
    free = replace(CAMERA, model="none", distortion=())
    edge = world(still(-0.3, 0.0, 1.0), camera=free).truth(0)[0]
    assert edge.visible == pytest.approx(0.5, abs=0.01)
    assert edge.in_picture == (edge.circle.x_px >= -0.5)
    gone = world(still(-0.5, 0.0, 1.0), camera=free).truth(0)[0]
    assert (gone.visible, gone.in_picture) == (0.0, False)
    assert gone.circle is not None
    assert world(still(0.0, 0.0, -1.0)).truth(0)[0].circle is None


def test_noise_has_the_stated_strength():
    sensor = Sensor(exposure_s=1e-6, psf_px=0.0, sharpen=0.0, full_well_e=4000, read_e=8)
    scene = world(still(0, 0, 1.0), sensor=sensor, diameter_m=0.3)
    grey = Ball("ball", still(0, 0, 1.0), (128, 128, 128), 0.3, gloss=0.0, ambient=1.0, grain=0.0)
    scene = Scene(replace(scene.world, balls=(grey,)))
    patch = scene.picture(0)[70:110, 100:140, 1].astype(float)
    light = ((128 / 255 + 0.055) / 1.055) ** 2.4
    sd = np.sqrt(light / 4000 + (8 / 4000) ** 2) * 255 * 1.055 / 2.4 * light ** (1 / 2.4 - 1)
    assert patch.mean() == pytest.approx(128, abs=0.5)
    assert patch.std() == pytest.approx(sd, rel=0.1)


def test_frames_are_the_same_whatever_the_number_of_threads():
    made = world(moving(0.0, 0.02, 1.0, 6.0), sensor=Sensor(), ticks=tuple(1001 * k for k in range(9))).world
    alone = [(made_picture, repr(truth)) for made_picture, _, truth in Scene(made).frames(workers=1)]
    assert len(alone) == 9
    for workers in (2, 5, None):
        for (one, truth), (picture, _, other) in zip(alone, Scene(made).frames(workers=workers), strict=True):
            assert (one == picture).all()
            assert truth == repr(other)
    assert all((Scene(made).picture(k) == one).all() for k, (one, _) in enumerate(alone))
    left_early = Scene(made).frames(workers=3)
    assert [stamp for _, stamp, _ in islice(left_early, 2)] == [0, 4170833]
    left_early.close()


FOLDING = replace(CAMERA, distortion=(-0.31, 0.0, 0.0, 0.0))
"""Its polynomial folds back 46 degrees off axis: there a point far out would lie in the picture again."""


@pytest.mark.filterwarnings("error")
def test_what_the_lens_model_does_not_reach_is_not_drawn():
    scene = world(still(1.8, 0.0, 1.0), camera=FOLDING)
    assert np.isnan(FOLDING.project(np.array([[1.8, 0.0, 1.0]]))).all()
    truth = scene.truth(0)[0]
    assert (truth.circle, truth.ellipse, truth.centre_px) == (None, None, None)
    assert (truth.visible, truth.in_picture) == (0.0, False)
    assert truth.xyz_cam_m == pytest.approx((1.8, 0.0, 1.0))
    empty = Scene(replace(scene.world, balls=()))
    assert (scene.light(0) == empty.light(0)).all()


@pytest.mark.filterwarnings("error")
def test_a_card_that_goes_along_with_a_marker_beyond_the_lens_is_not_drawn():
    lost = Card(lambda t: np.tile([np.nan, 89.5, 0.0], (len(t), 1)), (50.0, 80.0), 0.5)
    scene = world(still(0.0, 0.0, 1.0), cards=(lost,))
    assert scene.truth(0)[0].visible == 1.0
    assert (scene.light(0) == world(still(0.0, 0.0, 1.0)).light(0)).all()


@pytest.mark.filterwarnings("error")
def test_a_body_beyond_the_lens_is_not_drawn():
    made = world(still(0.0, 0.0, 1.0), camera=replace(FOLDING, fx_px=1600.0, fy_px=1600.0)).world
    with_body, without = Scene(replace(made, athlete=Athlete())), Scene(made)
    assert np.isfinite(with_body.light(0)).all()
    assert (with_body.light(0) == without.light(0)).all()
    picture = np.zeros((180, 240, 3), np.uint8)
    _limb(picture, np.array([119.5, 89.5]), np.array([np.nan, np.nan]), 20.0, 10.0, (9.0, 9.0, 9.0))
    assert not picture.any()
