"""The second renderer's camera: each switch changes what it should; its files, and what its scenarios promise."""

import csv
import hashlib
from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest

from spheremcap.synth import TRUTH_COLUMNS, render
from spheremcap.synth.daylight import days
from spheremcap.synth.daylight.electronics import curve, develop, planes420, tone
from spheremcap.synth.daylight.film import Film
from spheremcap.synth.daylight.world import Electronics, Glare
from spheremcap.synth.truth import Container

QUIET = Electronics(noise=False)


def developed(light, electronics, seed=0):
    flat = np.ascontiguousarray(np.broadcast_to(np.asarray(light, np.float32)[..., None], (*np.shape(light), 3)))
    return develop(flat, electronics, curve(electronics), np.random.default_rng(seed))


def small(name, **parts):
    """A scenario's world with a quarter of the picture's sides."""
    world = days.build(name, frames=parts.pop("frames", 2))
    width, height = world.camera.width_px // 4, world.camera.height_px // 4
    return Film(replace(world, camera=world.camera.scaled(width, height), **parts))


# --- electronics ---


def test_a_plain_picture_has_plain_planes_in_both_sitings():
    for siting in ("left", "centre"):
        planes = planes420(np.full((6, 8, 3), 77, np.uint8), siting)
        assert set(planes[:6].ravel()) == {round(16 + 77 * 219 / 255)}
        assert set(planes[6:].ravel()) == {128}


def test_planes_are_where_a_decoder_looks_for_them():
    """FFmpeg's own conversion, which sites chroma at the centre when it goes from RGB, agrees."""
    picture = np.zeros((32, 48, 3), np.uint8)
    picture[:, 16:] = (20, 60, 220)
    picture[16:, :24] = (200, 90, 10)
    frame = av.VideoFrame.from_ndarray(planes420(picture, "centre"), format="yuv420p")
    frame.colorspace, frame.color_range = 1, 1
    back = frame.reformat(format="bgr24", src_colorspace=1, dst_colorspace=1, src_color_range=1, dst_color_range=2)
    assert np.median(np.abs(back.to_ndarray().astype(int) - picture)) <= 2
    for y, x in ((4, 4), (4, 40), (28, 4), (28, 40)):
        assert np.abs(back.to_ndarray()[y, x].astype(int) - picture[y, x]).max() <= 4


def test_siting_shifts_chroma_by_half_a_pixel_to_the_side():
    ramp = np.zeros((4, 200, 3), np.uint8)
    ramp[..., 0] = np.arange(200)
    by_column = planes420(ramp, "left"), planes420(ramp, "centre")
    blue = [planes[4:].reshape(-1)[:200].reshape(2, 100)[0].astype(float) for planes in by_column]
    slope = (blue[0][90] - blue[0][10]) / 160  # code values for each luma column
    assert slope == pytest.approx(112 / 255, rel=0.02)
    assert (blue[1] - blue[0])[5:95].mean() / slope == pytest.approx(0.5, abs=0.05)
    assert (by_column[0][:4] == by_column[1][:4]).all()


def test_sharpening_overshoots_at_an_edge_and_nothing_else_does():
    edge = np.where(np.arange(60) < 30, 0.1, 0.4) * np.ones((40, 1))
    plain, sharp = (developed(edge, replace(QUIET, sharpen=s))[20, :, 1].astype(int) for s in (0.0, 0.8))
    assert (plain.min(), plain.max()) == (plain[5], plain[-5])
    assert sharp.min() < sharp[5] - 5
    assert sharp.max() > sharp[-5] + 5
    assert (sharp[5], sharp[-5]) == (plain[5], plain[-5])


def test_noise_follows_the_light_and_the_gain():
    def noise(light, **more):
        e = Electronics(full_well_e=4000.0, read_e=8.0, shoulder=1.0, **more)
        return developed(np.full((200, 200), light), e).std(), developed(np.full((200, 200), light), e).mean()

    level = 0.2
    slope = (tone(np.array([0.201]), 1.0) - tone(np.array([0.199]), 1.0))[0] / 0.002
    expected = slope * np.sqrt(level / 4000 + (8 / 4000) ** 2)
    assert noise(level)[0] == pytest.approx(expected, rel=0.05)
    dim = noise(level / 16, gain=16.0)
    assert dim[1] == pytest.approx(noise(level)[1], abs=1.5)
    assert dim[0] == pytest.approx(slope * np.sqrt(level * 16 / 4000 + (8 * 16 / 4000) ** 2), rel=0.05)
    assert noise(level, noise=False)[0] == 0


def test_noise_reduction_takes_noise_away_and_leaves_edges():
    edge = np.where(np.arange(100) < 50, 0.02, 0.5) * np.ones((80, 1))
    rough, smooth = (developed(edge, Electronics(full_well_e=900.0, smooth=s)).astype(float) for s in (0.0, 40.0))
    assert smooth[:, 10:40].std() < 0.7 * rough[:, 10:40].std()
    assert smooth[:, 53].mean() - smooth[:, 46].mean() == pytest.approx(
        rough[:, 53].mean() - rough[:, 46].mean(), rel=0.05
    )


def test_the_tone_curve_is_srgb_up_to_its_shoulder():
    x = np.linspace(0, 2, 400)
    plain, bent = tone(x, 1.0), tone(x, 0.6)
    assert tone(np.array([0.0, 0.0031308, 0.2140, 1.0]), 1.0) == pytest.approx((0, 10.31, 127.5, 255), abs=0.05)
    assert (plain[x < 0.6] == bent[x < 0.6]).all()
    assert (np.diff(bent) > 0).all()
    assert bent[-1] < 255
    assert plain[x >= 1] == pytest.approx(255)


def test_glare_adds_light_and_takes_colour_away():
    veiled = small("day-glare")
    clear = small("day-glare", glare=Glare())
    added = veiled.light(0) - clear.light(0)
    y, x = np.unravel_index(added[..., 0].argmax(), added.shape[:2])
    height, width = added.shape[:2]
    assert (x / width, y / height) == pytest.approx((0.32, 0.25), abs=0.01)
    assert added.min() > 0

    def saturation(scene):
        c, picture = scene.truth(0)[0].circle, scene.picture(0).astype(float)
        bgr = picture[round(c.y_px), round(c.x_px)]
        return np.ptp(bgr) / bgr.max()

    assert saturation(veiled) < saturation(clear)


# --- files ---


def test_same_bytes_again_and_other_bytes_with_another_seed(tmp_path, monkeypatch):
    build = days.build
    monkeypatch.setattr(days, "build", lambda *a, **k: _shrunk(build(*a, **k)))

    def digests(folder, seed=0):
        session = render("day-strap", tmp_path / folder, frames=3, seed=seed)
        return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(session.folder.iterdir())}

    first = digests("a")
    assert set(first) == {"session.mp4", "truth.csv", "settings.toml", "seeds.toml"}
    assert digests("b") == first
    other = digests("c", seed=1)
    assert other["session.mp4"] != first["session.mp4"]
    assert other["truth.csv"] != first["truth.csv"]


def _shrunk(world):
    return replace(world, camera=world.camera.scaled(world.camera.width_px // 4, world.camera.height_px // 4))


def test_files_agree_and_say_the_pixels_shape(tmp_path, monkeypatch):
    build = days.build
    monkeypatch.setattr(days, "build", lambda *a, **k: _shrunk(build(*a, **k)))
    session = render("day-wide-pixels", tmp_path / "wide", frames=3)
    with av.open(str(session.video)) as container:
        stream = container.streams.video[0]
        assert stream.sample_aspect_ratio == Fraction(4, 3)
        assert stream.average_rate == Fraction(50_000, 1001)
        assert not stream.codec_context.has_b_frames
        frames = list(container.decode(video=0))
        assert (frames[0].width, frames[0].height) == (240, 180)
    with session.truth.open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == TRUTH_COLUMNS
    assert [int(row["stamp_ns"]) for row in rows] == [0, 20_020_000, 40_040_000]
    # A sphere near the axis is higher than wide in pixels that are wider than high.
    assert float(rows[0]["ellipse_a_px"]) / float(rows[0]["ellipse_b_px"]) == pytest.approx(4 / 3, rel=0.03)
    assert abs(abs(float(rows[0]["ellipse_angle_rad"])) - np.pi / 2) < 0.1
    assert session.seeds[0].frame_index == 0
    monkeypatch.setattr(days, "build", lambda *a, **k: replace(_shrunk(build(*a, **k)), says_aspect=False))
    silent = render("day-wide-pixels", tmp_path / "silent", frames=2)
    with av.open(str(silent.video)) as container:
        assert not container.streams.video[0].sample_aspect_ratio
        assert silent.settings.read_text() == session.settings.read_text()


def test_the_container_says_nothing_of_a_pixels_shape_by_itself():
    assert Container.__dataclass_fields__["sample_aspect"].default is None


# --- scenarios ---


@pytest.mark.parametrize("name", days.DAYS)
def test_every_scenario_renders_two_frames_that_show_the_marker(name):
    scene = small(name)
    assert name.startswith("day-")
    (first, stamp, truths), (second, later, _) = scene.frames(workers=1)
    assert first.shape == (scene.camera.height_px, scene.camera.width_px, 3)
    assert first.dtype == np.uint8
    assert (stamp, len(truths)) == (0, 1)
    assert later == round(1e9 * scene.world.ticks[1] * scene.world.time_base)
    assert (first != second).any()
    assert 20 < first.mean() < 235
    assert (scene.picture(0) == first).all()  # any frame on its own
    assert truths[0].visible > 0.6
    without = Film(replace(scene.world, spheres=scene.world.spheres[1:])).light(0)
    c = truths[0].circle
    changed = np.abs(scene.light(0) - without).max(axis=2)
    assert changed[round(c.y_px), round(c.x_px)] > 0.004 * changed.max() or changed.max() < 1
    far = np.hypot(*(np.mgrid[: first.shape[0], : first.shape[1]] - np.array([c.y_px, c.x_px])[:, None, None]))
    assert changed[far < 0.7 * c.r_px].mean() > 0.0
    assert scene.planes(first).shape == (first.shape[0] * 3 // 2, first.shape[1])


def truths(name, every=1):
    scene = Film(days.build(name))
    return [scene.truth(k)[0] for k in range(0, len(scene), every)]


def runs(flags):
    """The lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, int), [0]])))
    return list(edges[1::2] - edges[::2])


def test_hidden_hides_for_as_long_as_it_says():
    hidden = runs([t.visible < 0.01 for t in truths("day-hidden")])
    assert len(hidden) == 4
    assert np.abs(np.array(hidden) - (6, 12, 24, 40)).max() <= 3


def test_spokes_hide_a_third_to_two_thirds_for_a_while():
    visible = np.array([t.visible for t in truths("day-spokes")])
    assert ((visible > 0.4) & (visible < 0.7)).sum() > 30
    assert (visible > 0.9).sum() > 30


def test_small_is_small_and_clean_is_not():
    r = [t.circle.r_px for t in truths("day-small", 10)]
    assert 4 <= min(r) < max(r) <= 7
    r = [t.circle.r_px for t in truths("day-clean", 10)]
    assert 20 < min(r) < max(r) < 32


def test_blur_reaches_twenty_pixels_and_not_much_more():
    scene = Film(days.build("day-blur"))
    speed = [np.hypot(*t.velocity_cam_mps[:2]) / t.xyz_cam_m[2] for t in truths("day-blur", 3)]
    blur_px = max(speed) * scene.camera.fx_px * scene.world.electronics.exposure_s
    assert 15 < blur_px < 25
    assert scene.world.electronics.exposure_s * 240_000 / 1001 == pytest.approx(0.8)


def test_gone_is_gone_for_good_while_something_of_its_colour_stays():
    flags = [t.in_picture for t in truths("day-gone")]
    assert flags[:110] == [True] * 110
    assert runs([not flag for flag in flags])[-1] > 60
    assert len(runs([not flag for flag in flags])) == 1
    assert len([s for s in days.build("day-gone").spheres if not s.tracked]) == 1


def test_the_strap_always_covers_something_but_never_most():
    visible = [t.visible for t in truths("day-strap", 5)]
    assert 0.6 < min(visible) < max(visible) < 1.0


@pytest.mark.parametrize("name", [n for n in days.DAYS if n not in ("day-gone", "day-hidden", "day-spokes")])
def test_the_marker_stays_in_the_picture(name):
    assert all(t.in_picture and t.visible > 0.6 for t in truths(name, 4))


def test_a_throw_falls_as_things_fall():
    world = days.build("day-thirty")
    t = np.linspace(0.1, 0.7, 200)
    fall = np.gradient(np.gradient(world.spheres[0].path(t)[:, 2], t), t)
    assert fall[5:-5] == pytest.approx(-9.81, abs=0.01)


def test_an_unknown_scenario_and_no_frames_are_refused():
    with pytest.raises(KeyError):
        days.build("day-none")
    with pytest.raises(ValueError, match="at least 1 frame"):
        days.build("day-clean", frames=0)


def test_frames_are_the_same_whatever_the_number_of_threads():
    scene = small("day-sun", frames=7)
    alone, beside = (list(scene.frames(workers=workers)) for workers in (1, 3))
    assert [stamp for _, stamp, _ in alone] == [scene.stamp_ns(k) for k in range(7)]
    for (picture, stamp, truth), (other, late, same) in zip(alone, beside, strict=True):
        assert (picture == other).all()
        assert stamp == late
        assert repr(truth) == repr(same)
    assert len(list(scene.frames(3))) == 3
    assert list(scene.frames(0)) == []
