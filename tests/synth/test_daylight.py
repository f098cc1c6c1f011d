"""What the second renderer draws agrees with its truth, and its truth with closed forms and counts."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from reference import daylight as reference
from spheremcap.core.camera import Camera
from spheremcap.synth.daylight import rays
from spheremcap.synth.daylight.film import Film
from spheremcap.synth.daylight.paths import limb, moved, still, stops
from spheremcap.synth.daylight.world import (
    Capsule,
    Daylight,
    DayWorld,
    Electronics,
    Paint,
    Sphere,
    Stage,
    Strap,
    View,
)

CAMERA = Camera(240, 180, 400.0, 400.0, 119.5, 89.5)
OBLONG = Camera(240, 180, 300.0, 400.0, 121.0, 87.5)
VIEW = View(1.0, 0.15)
BARE = Electronics(exposure_s=1e-7, readout_s=0.0, psf_px=0.0, noise=False)
BLACK = Paint((0.0, 0.0, 0.0))
WHITE = Paint((0.8, 0.8, 0.8))
EVEN = Daylight((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


def at(x, y, z, vx=0.0, vy=0.0, vz=0.0):
    """A path on the stage through a place given in the optical frame, with a speed on the stage."""
    place = VIEW.to_stage(np.array([[x, y, z]]))[0]
    return lambda t: place + np.asarray(t)[:, None] * (vx, vy, vz)


def film(path, *, diameter_m=0.08, paint=BLACK, **parts):
    ball = Sphere("ball", path, diameter_m, paint, strap=parts.pop("strap", None))
    usual = DayWorld(
        "test", CAMERA, (0, 1001), Fraction(1, 240_000), (ball,), daylight=EVEN, view=VIEW, electronics=BARE,
        edge_samples=600, stage=Stage("floor", (0.6,) * 3, "plaster", (0.6,) * 3),
    )  # fmt: skip
    return Film(replace(usual, **parts))


def covered(scene, index=0):
    """The part of each pixel that a black ball takes from the backdrop's light."""
    empty = Film(replace(scene.world, spheres=()))
    behind = empty._backdrop[0] + empty._backdrop[1]
    return 1 - (scene.light(index) / behind)[..., 1].astype(float)


# --- truth against closed forms ---


@pytest.mark.parametrize("camera", [CAMERA, OBLONG])
@pytest.mark.parametrize("place", [(0.0, 0.0, 1.0), (0.21, -0.11, 1.003), (-0.1, 0.06, 0.5), (0.02, 0.3, 3.2)])
def test_the_circle_is_that_of_the_cone_of_rays_that_touch_the_sphere(place, camera):
    truth = film(at(*place), camera=camera).truth(0)[0]
    # q is on the outline if q' (c c' - (c'c - R**2) I) q = 0 (Hartley and Zisserman, 8.3): a conic in pixels.
    c = np.array(place)
    inverse = np.linalg.inv(camera.matrix)
    conic = inverse.T @ (np.outer(c, c) - (c @ c - 0.04**2) * np.eye(3)) @ inverse
    centre = np.linalg.solve(conic[:2, :2], -conic[:2, 2])
    scale = -np.linalg.det(conic) / np.linalg.det(conic[:2, :2])
    axes = np.sqrt(scale / np.linalg.eigvalsh(conic[:2, :2]))
    assert (truth.circle.x_px, truth.circle.y_px) == pytest.approx(tuple(centre), abs=1e-4)
    assert truth.circle.r_px == pytest.approx(np.sqrt(axes[0] * axes[1]), abs=1e-4)
    assert (truth.ellipse.a_px, truth.ellipse.b_px) == pytest.approx((axes.max(), axes.min()), abs=1e-3)
    assert truth.xyz_cam_m == pytest.approx(place, abs=1e-9)
    assert truth.centre_px == pytest.approx(tuple(camera.project(c[None])[0]), abs=1e-9)
    assert (truth.visible, truth.in_picture) == (1.0, True)


def test_velocity_is_in_the_optical_frame():
    truth = film(at(0.0, 0.0, 1.0, 1.0, 2.0, 3.0)).truth(0)[0]
    c, s = np.cos(VIEW.down_rad), np.sin(VIEW.down_rad)
    assert truth.velocity_cam_mps == pytest.approx((1.0, -3 * c - 2 * s, 2 * c - 3 * s), abs=1e-5)


def test_a_sphere_behind_the_camera_has_no_circle():
    truth = film(at(0.0, 0.0, -1.0)).truth(0)[0]
    assert (truth.circle, truth.ellipse, truth.centre_px, truth.visible) == (None, None, None, 0.0)


# --- the picture against the truth ---


@pytest.mark.parametrize("camera", [CAMERA, OBLONG])
@pytest.mark.parametrize("place", [(0.0, 0.0, 1.0), (0.2013, -0.1107, 1.003), (-0.11, 0.15, 3.2)])
def test_the_disc_has_the_area_and_centre_of_its_truth(place, camera):
    scene = film(at(*place), camera=camera)
    circle, part = scene.truth(0)[0].circle, covered(scene)
    y, x = np.mgrid[: part.shape[0], : part.shape[1]]
    assert np.sqrt(part.sum() / np.pi) == pytest.approx(circle.r_px, abs=0.01)
    assert ((part * x).sum() / part.sum(), (part * y).sum() / part.sum()) == pytest.approx(
        (circle.x_px, circle.y_px), abs=0.01
    )


@pytest.mark.parametrize(("readout_s", "speed"), [(0.0, 0.0), (0.0036, 4.0)])
def test_the_edge_of_the_disc_is_at_the_true_outline(readout_s, speed):
    """Row by row, under a rolling shutter too: where the light falls off is where the outline crosses the row."""
    scene = film(
        at(0.1013, 0.0507, 1.0, speed, 0.0, -speed), diameter_m=0.14, electronics=replace(BARE, readout_s=readout_s)
    )
    truth, part = scene.truth(0)[0], covered(scene)
    e, middle = truth.ellipse, round(truth.circle.x_px)
    cos, sin = np.cos(e.angle_rad), np.sin(e.angle_rad)
    off = []
    for r in range(round(e.y_px - 0.75 * e.b_px), round(e.y_px + 0.75 * e.b_px)):
        v = r - e.y_px + (np.arange(8)[:, None] + 0.5) / 8 - 0.5
        u = np.linspace(-1.3 * e.a_px, 1.3 * e.a_px, 200_001)
        inside = ((u * cos + v * sin) / e.a_px) ** 2 + ((v * cos - u * sin) / e.b_px) ** 2 < 1
        left = e.x_px + u[inside.argmax(axis=1)].mean()
        right = e.x_px + u[len(u) - 1 - inside[:, ::-1].argmax(axis=1)].mean()
        off.append(middle - 0.5 - part[r, :middle].sum() - left)
        off.append(middle - 0.5 + part[r, middle:].sum() - right)
    assert len(off) > 60
    assert np.abs(off).max() < 0.05
    assert abs(np.mean(off)) < 0.005


def test_blur_keeps_light_and_centre_and_spreads_along_the_motion():
    electronics = replace(BARE, exposure_s=1 / 300)
    scene = film(at(0.0, 0.02, 1.0, 9.0), electronics=electronics)
    circle, part = scene.truth(0)[0].circle, covered(scene)
    y, x = np.mgrid[: part.shape[0], : part.shape[1]]
    assert part.sum() == pytest.approx(circle.area_px2, rel=3e-3)
    assert ((part * x).sum() / part.sum(), (part * y).sum() / part.sum()) == pytest.approx(
        (circle.x_px, circle.y_px), abs=0.03
    )
    columns, rows = np.nonzero(part.max(axis=0) > 0.02)[0], np.nonzero(part.max(axis=1) > 0.02)[0]
    assert np.ptp(columns) == pytest.approx(2 * circle.r_px + 12, abs=2)
    assert np.ptp(rows) == pytest.approx(2 * circle.r_px, abs=2)


def test_few_rays_find_the_same_edge_as_many():
    few, many = (covered(film(at(0.01, 0.02, 1.0, 5.0), edge_samples=n)) for n in (40, 600))
    assert few.sum() == pytest.approx(many.sum(), rel=3e-3)
    assert np.abs(few - many).max() < 0.15


# --- the visible share ---


def counted(scene, hides, count=4000):
    """The share of random rays to the ball that `hides(rays)` leaves, and are in the picture."""
    truth, camera = scene.truth(0)[0], scene.camera
    rng = np.random.default_rng(1)
    c, r = truth.circle, 1.2 * truth.ellipse.a_px
    points = rng.uniform((c.x_px - r, c.y_px - r), (c.x_px + r, c.y_px + r), (4 * count, 2))
    ray = reference.rays(camera, VIEW, points)
    centre = scene.world.spheres[0].path(np.array([0.0]))[0] - (0, 0, VIEW.height_m)
    hit = np.linalg.norm(np.cross(ray, centre), axis=1) < scene.world.spheres[0].diameter_m / 2
    inside = ((points > -0.5) & (points < (camera.width_px - 0.5, camera.height_px - 0.5))).all(axis=1)
    return (inside & ~hides(ray))[hit].mean()


def marched(ray, kind, *shape, upto):
    """Whether rays (N, 3) from the camera come within a shape before the distance `upto`, by small steps."""
    out = np.zeros(len(ray), bool)
    for t in np.linspace(0.3, upto, 300):
        out |= reference.distance(kind, t * ray + (0, 0, VIEW.height_m), *shape) < 0
    return out


def test_the_visible_share_is_that_of_rays_which_meet_nothing_before():
    start, end = (p(np.zeros(1))[0] for p in (at(-0.1, -0.2, 0.8), at(0.05, 0.2, 0.85)))
    bar = Capsule(at(-0.1, -0.2, 0.8), at(0.05, 0.2, 0.85), 0.02, WHITE)
    scene = film(at(0.0, 0.0, 1.0), capsules=(bar,))
    share = counted(scene, lambda ray: marched(ray, "capsule", start, end, 0.02, upto=0.96))
    assert 0.2 < share < 0.8
    assert scene.truth(0)[0].visible == pytest.approx(share, abs=0.02)
    behind = Capsule(at(-0.1, -0.2, 1.2), at(0.05, 0.2, 1.25), 0.02, WHITE)
    assert film(at(0.0, 0.0, 1.0), capsules=(behind,)).truth(0)[0].visible == 1.0
    wide = Capsule(at(-0.1, -0.2, 0.8), at(0.05, 0.2, 0.85), 0.12, WHITE)
    assert film(at(0.0, 0.0, 1.0), capsules=(wide,)).truth(0)[0].visible == 0.0


def test_what_is_out_of_the_picture_is_not_visible():
    edge = film(at(-0.3, 0.0, 1.0)).truth(0)[0]
    assert edge.visible == pytest.approx(0.5, abs=0.01)
    assert edge.in_picture == (edge.circle.x_px >= -0.5)
    gone = film(at(-0.5, 0.0, 1.0)).truth(0)[0]
    assert (gone.visible, gone.in_picture) == (0.0, False)
    assert gone.circle is not None


def test_a_strap_covers_what_lies_between_its_two_planes():
    strap = Strap((0.0, 0.0, 1.0), 0.1, 0.25, 0.001)
    scene = film(at(0.0, 0.0, 1.0), strap=strap)
    centre = scene.world.spheres[0].path(np.array([0.0]))[0] - (0, 0, VIEW.height_m)

    def hides(ray):
        along = ray @ centre
        half = np.sqrt(np.maximum(0.04**2 - (centre @ centre - along**2), 0))
        height = ((along - half)[:, None] * ray - centre)[:, 2]
        return np.abs(height - 0.1 * 0.04) < 0.25 * 0.04

    assert scene.truth(0)[0].visible == pytest.approx(counted(scene, hides), abs=0.02)
    # It is there to be seen: the sphere is white, its strap black.
    striped = film(at(0.0, 0.0, 1.0), paint=WHITE, strap=replace(strap, paint=BLACK), edge_samples=40).light(0)[..., 1]
    assert striped[90, 119] < 0.02 < 0.5 < striped[80, 119]


# --- shapes and light ---


@pytest.mark.parametrize("kind", ["sphere", "capsule", "box", "band"])
def test_where_a_ray_meets_a_shape_it_touches_its_surface_for_the_first_time(kind):
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(300):
        a = rng.uniform((-0.3, 1.7, -0.3), (0.3, 2.3, 0.3))
        end, half, axis = rng.uniform((-0.3, 1.7, -0.3), (0.3, 2.3, 0.3)), rng.uniform(0.05, 0.3, 3), rng.normal(size=3)
        b = {"sphere": a, "capsule": end, "box": half, "band": axis / np.linalg.norm(axis)}[kind]
        solid = np.zeros((1, rays.COLUMNS))
        solid[0, rays.KIND] = {"sphere": rays.SPHERE, "capsule": rays.CAPSULE, "box": rays.BOX, "band": rays.BAND}[kind]
        solid[0, rays.RADIUS], solid[0, rays.HALF_WIDTH], solid[0, rays.OFFSET] = 0.15, 0.06, 0.03
        knots = np.tile(np.concatenate([a, b, [0.0]]), (2, 1, 1))
        d = a + rng.normal(size=3) * 0.15
        d /= np.linalg.norm(d)
        t = rays._meets(knots, solid, 0, 0, 0.5, 0.0, 0.0, 0.0, *d)
        steps = np.linspace(0, 4, 4001)
        away = reference.distance(kind, steps[:, None] * d, a, b, 0.15, 0.06, 0.03)
        if t > 100:
            assert (away > -1e-9).all() if kind != "band" else (away > 1e-4).all()
            continue
        hits += 1
        assert abs(reference.distance(kind, (t * d)[None], a, b, 0.15, 0.06, 0.03)[0]) < 1e-7 or kind == "band"
        assert reference.distance(kind, (t * d)[None], a, b, 0.15, 0.06, 0.03)[0] < 1e-7
        assert (away[steps < t - 1e-3] > 0).all()
    assert 60 < hits < 290


def lit_ball(limb_at=None, sun_from=(-1.0, 0.0, 0.3)):
    """The mean light on the left and on the right half of a white ball with the sun on its left."""
    light = Daylight((0.2, 0.2, 0.2), (0.2, 0.2, 0.2), (0.8, 0.8, 0.8), sun_from)
    capsules = ()
    if limb_at is not None:
        x = limb_at
        capsules = (Capsule(at(x, -0.2, 1.0), at(x, 0.2, 1.0), 0.05, BLACK),)
    scene = film(at(0.0, 0.0, 1.0), paint=WHITE, daylight=light, capsules=capsules, edge_samples=16)
    circle, picture = scene.truth(0)[0].circle, scene.light(0)[..., 1]
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    disc = (x - circle.x_px) ** 2 + (y - circle.y_px) ** 2 < (0.9 * circle.r_px) ** 2
    assert scene.truth(0)[0].visible == 1.0
    return picture[disc & (x < circle.x_px - 4)].mean(), picture[disc & (x > circle.x_px + 4)].mean()


def test_a_limb_between_the_sun_and_the_marker_darkens_the_side_that_is_lit():
    left, right = lit_ball()
    assert left > 2 * right  # beyond the terminator there is only the sky
    assert right == pytest.approx(0.8 * 0.2, abs=0.01)
    shaded = lit_ball(limb_at=-0.15)
    assert shaded[0] < 0.6 * left
    assert shaded[1] == pytest.approx(right, abs=0.005)
    assert lit_ball(limb_at=0.15) == pytest.approx((left, right), abs=0.005)


def test_a_limb_throws_its_shadow_on_the_ground_away_from_the_sun():
    ball = film(at(0.0, -0.1, 1.0), camera=CAMERA, daylight=Daylight(sun_from=(-1.0, 0.0, 1.0)), view=View(1.0, 0.6))
    bar = Capsule(still(-0.4, 1.6, 0.3), still(-0.4, 1.3, 0.3), 0.03, WHITE)
    with_bar = Film(replace(ball.world, capsules=(bar,), spheres=()))
    without = Film(replace(ball.world, spheres=()))
    # 0.3 m up and a sun at 45 degrees: 0.3 m to the right of the bar.
    pixel = CAMERA.project(with_bar.world.view.to_camera(np.array([[-0.1, 1.45, 0.0], [-0.7, 1.45, 0.0]])))
    for (x, y), dark in zip(np.rint(pixel).astype(int), (True, False), strict=True):
        ratio = with_bar.light(0)[y, x, 1] / without.light(0)[y, x, 1]
        assert bool(ratio < 0.75) is dark, ratio
        assert dark or ratio == pytest.approx(1.0, abs=1e-5)


def test_gloss_adds_a_highlight_that_has_the_colour_of_the_light():
    light = Daylight((0.2, 0.2, 0.2), (0.2, 0.2, 0.2), (0.8, 0.8, 0.8), (0.0, -1.0, 0.3))
    red = Paint((0.5, 0.02, 0.02))
    dull, shiny = (
        film(at(0.0, 0.0, 1.0), paint=replace(red, gloss=g), daylight=light, edge_samples=16).light(0)
        for g in (0.0, 1.0)
    )
    added = shiny - dull
    y, x = np.unravel_index(added[..., 1].argmax(), added.shape[:2])
    assert added[y, x, 1] > 0.1
    assert added[y, x, 0] == pytest.approx(added[y, x, 1], rel=0.2)
    assert y < 89  # above the middle, towards a sun above


def test_a_print_turns_with_its_ball():
    printed = Paint((0.7, 0.7, 0.7), (0.0, 0.0, 0.0), "printed", strength=1.0)
    ball = Sphere("ball", at(0.0, 0.0, 1.0), 0.2, printed, (0.0, 0.0, 1.0), np.pi / 2)
    scene = film(at(0.0, 0.0, 1.0))
    # The mark on the side of +x is turned by half a turn to the camera's side between -0.5 and +0.5 s.
    marks = []
    for turn in (-np.pi / 2, 0.0, np.pi / 2):
        light = Film(replace(scene.world, spheres=(replace(ball, turn_rad=turn),), edge_samples=8)).light(0)[..., 1]
        marks.append(light[60:120, 90:150])
    assert np.abs(marks[0] - marks[2]).max() > 0.3
    assert np.abs(marks[0] - marks[1]).max() > 0.3


def test_stops_arrive_and_stay():
    value = stops([0.0, 1.0, 2.0], [0.0, 1.0, 3.0], 0.5)
    np.testing.assert_allclose(value(np.array([0.0, 0.4, 1.0, 1.49, 1.75, 2.0, 9.0])), (0, 0, 1, 1, 2, 3, 3))


def test_a_limb_follows_what_it_hides():
    path = moved(at(0.0, 0.0, 0.8), at(0.0, 0.0, 1.0, 1.0))
    arm = limb(path, 0.3, stops([0.0], [0.05], 1.0), 0.2, 0.03, WHITE)
    middle = (arm.start(np.array([0.0, 1.0])) + arm.end(np.array([0.0, 1.0]))) / 2
    np.testing.assert_allclose(middle[1] - middle[0], (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(
        middle[0] - path(np.zeros(1))[0], 0.05 * np.array((np.cos(0.3), 0, np.sin(0.3))), atol=1e-12
    )
