"""Strokes: hands are on the rim exactly between contact and release, and all files of a session tell the same."""

import csv
import hashlib
import io
import tomllib
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from spheremcap.synth import Scene, describe, known, names, render, rendered, stroke_names
from spheremcap.synth.ride import EVENT_COLUMNS, wheel_points
from spheremcap.synth.stroke_scenarios import CAMERA, FRAMES, STROKES, build, ride
from spheremcap.synth.strokes import FOREARM_M, UPPER_ARM_M, Mount

CAMBER = np.radians(11.0)
STEP_S = 1 / 8000


@pytest.fixture(scope="module")
def rides():
    return {name: ride(name) for name in STROKES}


def in_wheel(side, xyz_chair_m):
    """Forward and up in the wheel's plane and outward of it, about the hub; the other way round than `in_chair`."""
    x, y, z = np.asarray(xyz_chair_m).T
    out = (y if side == "left" else -y) - 0.30
    return x, np.cos(CAMBER) * z - np.sin(CAMBER) * out, np.cos(CAMBER) * out + np.sin(CAMBER) * z


def polar(arm, t):
    """The wrist about the axle: distance in m, and angle in rad from straight up, forward."""
    u, v, _ = in_wheel(arm.side, arm.joint("wrist")(t))
    return np.hypot(u, v), np.unwrap(np.arctan2(u, v))


def pushes(made):
    """(arm, contact, release) of every whole push."""
    for arm in made.motion.arms:
        events = [event for event in made.events if event.side == arm.side]
        for one, other in pairwise(events):
            if (one.kind, other.kind) == ("CONTACT", "RELEASE") and one.time_s > 0.1 and other.time_s < made.seconds:
                yield arm, one, other


def against_rim(made, arm, t):
    """The wrist's velocity (N,) along and (N,) across what turns with the wheel where it is, in m/s."""
    radius, angle = polar(arm, t)
    along = radius * (np.gradient(angle, t) - np.gradient(made.motion.turned_rad(t), t))
    return along, np.gradient(radius, t)


@pytest.mark.parametrize("name", STROKES)
def test_the_wrist_is_on_the_rim_from_contact_to_release(rides, name):
    made, count = rides[name], 0
    for arm, contact, release in pushes(made):
        t = np.arange(contact.time_s, release.time_s, STEP_S)
        radius, angle = polar(arm, t)
        _, _, outward = in_wheel(arm.side, arm.joint("wrist")(t))
        assert np.abs(radius - 0.205).max() < 0.0085  # the soft hand's 2.4 mm and the wrist's rolling
        np.testing.assert_allclose(outward, 0.02, atol=1e-6)
        settled = t > contact.time_s + 0.04
        turned = made.motion.turned_rad(t) - made.motion.turned_rad(np.array([contact.time_s]))
        np.testing.assert_allclose((angle - contact.angle_rad - turned)[settled], 0, atol=1e-4)
        count += 1
    assert count >= 30


@pytest.mark.parametrize("name", STROKES)
def test_events_are_where_the_path_comes_to_the_circle_and_leaves_it(rides, name):
    made = rides[name]
    for arm, contact, release in pushes(made):
        t = np.arange(contact.time_s + 0.06, release.time_s + 0.05, STEP_S)
        along, across = against_rim(made, arm, t)
        held = np.hypot(along, across) < 0.1
        assert t[held][-1] == pytest.approx(release.time_s, abs=0.0025)  # it leaves at 45 m/s² or more
        # The path's acceleration jumps at contact: the hand's give begins.
        t = np.arange(contact.time_s - 0.02, contact.time_s + 0.02, 0.0005)
        jump = np.linalg.norm(np.diff(arm.joint("wrist")(t), n=3, axis=0), axis=1)
        assert t[jump.argmax() + 1] == pytest.approx(contact.time_s, abs=0.0015)
        for event, side in ((contact, -1), (release, 1)):
            at = np.array([event.time_s])
            assert polar(arm, at)[1][0] % (2 * np.pi) == pytest.approx(event.angle_rad, abs=1e-4)
            a, b = arm.joint("wrist")(at + side * 2e-4)[0], arm.joint("wrist")(at + side * 4e-4)[0]
            assert np.linalg.norm(a - b) / 2e-4 == pytest.approx(event.speed_mps, abs=0.1)


@pytest.mark.parametrize("name", STROKES)
def test_arms_keep_their_lengths_and_markers_are_in_the_picture(rides, name):
    made = rides[name]
    t = np.arange(0, made.seconds, 1 / 240)
    inside = {}
    for arm in made.motion.arms:
        wrist, elbow, shoulder = (arm.joint(joint)(t) for joint in ("wrist", "elbow", "shoulder"))
        np.testing.assert_allclose(np.linalg.norm(wrist - elbow, axis=1), FOREARM_M, atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(elbow - shoulder, axis=1), UPPER_ARM_M, atol=1e-6)
        for joint, xyz in (("wrist", wrist), ("elbow", elbow), ("shoulder", shoulder)):
            pixel = CAMERA.project(made.mount.to_camera(xyz))
            inside[arm.side, joint] = (np.abs(pixel - (639.5, 359.5)) < (620, 340)).all(axis=1).mean()
    assert all(inside[side, "wrist"] == 1 for side in ("left", "right"))
    assert min(inside.values()) > 0.95


def test_there_are_200_strokes_of_both_hands(rides):
    assert sum(sum(1 for _ in pushes(made)) for made in rides.values()) >= 200


def test_missed_catches_have_no_events_and_stay_off_the_rim(rides):
    made = rides["strokes-missed"]
    period = 1 / 1.87
    for side, numbers in (("left", (3, 10)), ("right", (6, 10, 14))):
        arm = made.motion.left if side == "left" else made.motion.right
        times = [event.time_s for event in made.events if event.side == side]
        for number in numbers:
            middle = (number - 0.3) * period + 0.06
            assert min(abs(time - middle) for time in times) > 0.25
            radius, angle = polar(arm, middle + np.linspace(-0.1, 0.1, 400))
            pushing = np.abs(np.degrees(angle) % 360 - 123) < 73  # where a hand that had caught it would push
            assert np.ptp(angle[pushing]) > 2.4
            assert radius[pushing].min() > 0.205 + 0.0125
        contacts = [event.time_s for event in made.events if event.side == side and event.kind == "CONTACT"]
        assert sum(gap > 1.7 * period for gap in np.diff(contacts)) == len(numbers)


def test_a_braking_holds_the_rim_that_goes_on_turning_and_has_no_events(rides):
    made = rides["strokes-brake"]
    start = (9 - 0.3) / 1.87
    assert made.seconds / 3 < start < 2 * made.seconds / 3
    for arm in made.motion.arms:
        t = start + np.linspace(0.1, 0.8, 300)
        radius, angle = polar(arm, t)
        assert np.ptp(angle) < 1e-3
        assert np.abs(radius - 0.205).max() < 0.0085
        times = np.array([event.time_s for event in made.events if event.side == arm.side])
        assert not ((times > start - 0.1) & (times < start + 1.0)).any()
    rate = np.diff(made.motion.turned_rad(np.array([start - 1, start - 0.5, start + 1.5, start + 2.0])))[[0, 2]] / 0.5
    assert rate[1] / rate[0] == pytest.approx(0.75, abs=0.02)


@pytest.mark.parametrize("name", ["strokes", "strokes-low@120"])
def test_events_and_truth_and_wheel_have_one_clock(name):
    """At an event's stamp the wrist of truth.csv, each row at the instant when it is seen, is at the event's angle."""
    scene, made = Scene(build(name)), ride(name)
    assert scene.stamp_ns(len(scene) - 1) == pytest.approx(made.seconds * 1e9, abs=1)
    rows = list(csv.DictReader(io.StringIO(scene.beside["events.csv"])))
    assert tuple(rows[0]) == EVENT_COLUMNS
    stamps = [int(row["stamp_ns"]) for row in rows]
    assert stamps == sorted(stamps)
    assert all(0 <= stamp <= scene.stamp_ns(len(scene) - 1) for stamp in stamps)
    few = rows[4:16]
    off_deg = []
    for row in few:
        near = int(np.searchsorted([scene.stamp_ns(k) for k in range(len(scene))], int(row["stamp_ns"])))
        seen_s, chair = [], []
        for k in range(near - 3, near + 3):
            truth = next(t for t in scene.truth(k) if t.marker == row["marker"])
            late_s = (truth.centre_px[1] - 359.5) * scene.container.readout_s / 719
            seen_s.append(scene.stamp_ns(k) / 1e9 + late_s)
            chair.append(truth.xyz_cam_m @ made.mount.axes + made.mount.xyz_chair_m)
        u, v, _ = in_wheel(row["side"], np.array(chair))
        angle = np.degrees(np.unwrap(np.arctan2(u, v)))
        found = np.interp(int(row["stamp_ns"]) / 1e9, seen_s, angle)
        off_deg.append((found - float(row["angle_deg"]) + 180) % 360 - 180)
    assert np.abs(np.mean(off_deg)) < 0.3  # a millisecond is 1.1 degrees
    assert np.abs(off_deg).max() < 1.0  # the mount shakes
    wheel = list(csv.DictReader(io.StringIO(scene.beside["wheel.csv"])))
    t, turned = np.array([[float(row["time_s"]), float(row["angle_rad"])] for row in wheel]).T
    assert t[0] == 0
    assert scene.stamp_ns(len(scene) - 1) / 1e9 <= t[-1] < scene.stamp_ns(len(scene) - 1) / 1e9 + 0.01
    assert np.diff(turned).min() > 0
    for arm, contact, release in list(pushes(made))[:6]:
        on_wheel = np.degrees(np.diff(np.interp([contact.time_s, release.time_s], t, turned))[0])
        assert on_wheel == pytest.approx(np.degrees(release.angle_rad - contact.angle_rad), abs=0.05), arm.side


def test_a_session_of_strokes_in_its_folder(tmp_path):
    def digests(folder):
        return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}

    one, again = (render("strokes-low@60", tmp_path / folder, frames=4) for folder in ("one", "again"))
    other = render("strokes-low@60", tmp_path / "other", frames=4, seed=1)
    assert digests(one.folder) == digests(again.folder)
    changed = {name for name, digest in digests(other.folder).items() if digests(one.folder)[name] != digest}
    assert changed >= {"session.mp4", "truth.csv", "seeds.toml"}
    assert ride("strokes", seed=1).files()["events.csv"] != ride("strokes").files()["events.csv"]
    assert set(digests(one.folder)) == {
        "session.mp4", "truth.csv", "settings.toml", "seeds.toml", "events.csv", "wheel.csv", "analysis.toml",
    }  # fmt: skip
    said = tomllib.loads((one.folder / "analysis.toml").read_text())
    assert said == {
        "wheel": {"radius_m": 0.35, "rim_radius_m": 0.18, "camber_deg": 11.0, "track_m": 0.6},
        "chair": {"camera_xyz_chair_m": [1.08, 0.0, 0.50], "camera_down_deg": 15.0},
    }
    assert len(one.seeds) == 6
    usual = tomllib.loads(rendered("strokes", frames=2).beside["analysis.toml"])
    assert usual["chair"] == {"camera_xyz_chair_m": [1.08, 0.0, 0.80], "camera_down_deg": 30.0}


def test_other_rates_film_the_same_strokes():
    every, second, fourth = (rendered(f"strokes-start{rate}") for rate in ("", "@120", "@60"))
    assert (len(every), len(second), len(fourth)) == (FRAMES, FRAMES // 2, FRAMES // 4)
    assert (every.stamp_ns(840), every._truth(840, every._find_layers(840))[0].circle) == (
        second.stamp_ns(420), second.truth(420)[0].circle,
    )  # fmt: skip
    assert repr(every.truth(840)) == repr(fourth.truth(210))
    events = [scene.beside["events.csv"].splitlines() for scene in (every, second, fourth)]
    assert events[0][:60] == events[1][:60] == events[2][:60]
    # A shorter one is the beginning of the whole one.
    short = rendered("strokes-start", frames=480)
    assert repr(short.truth(400)) == repr(every.truth(400))
    assert short.beside["events.csv"].splitlines() == events[0][: len(short.beside["events.csv"].splitlines())]


def test_strokes_are_listed_apart_and_other_names_refused():
    assert stroke_names() == tuple(STROKES)
    assert not set(stroke_names()) & set(names())
    assert describe("strokes@120") == f"{describe('strokes')}; 120 frames/s"
    assert all(known(name) for name in (*names(), *stroke_names(), "strokes-fast@60"))
    for wrong in ("strokes@", "strokes@240", "strokes@30", "clean@120", "strokes-none"):
        assert not known(wrong)
        with pytest.raises(KeyError):
            rendered(wrong)
    with pytest.raises(ValueError, match="at least 1 frame"):
        build("strokes", frames=0)


def test_the_wheels_in_the_picture():
    made = ride("strokes", frames=2)
    points = wheel_points(made.motion, Mount(), CAMERA, 8)
    down = np.radians(30)

    def pixel(x, y, z):
        """By OpenCV, from where the mount says that the camera is."""
        x, y, z = x - 1.08, y, z - 0.80
        seen = np.array([[y, np.sin(down) * x - np.cos(down) * z, -np.cos(down) * x - np.sin(down) * z]])
        return cv2.projectPoints(seen, np.zeros(3), np.zeros(3), CAMERA.matrix, np.array(CAMERA.distortion))[0][0, 0]

    for side, sign in (("left", 1), ("right", -1)):
        hub, rim = points[side].hub_px, points[side].rim_px
        assert rim.shape == (8, 2)
        np.testing.assert_allclose(hub, pixel(0, sign * 0.30, 0), atol=1e-6)
        lean, up = 0.18 * np.sin(CAMBER), 0.18 * np.cos(CAMBER)
        np.testing.assert_allclose(rim[0], pixel(0, sign * (0.30 - lean), up), atol=1e-6)  # the top leans inward
        np.testing.assert_allclose(rim[2], pixel(0.18, sign * 0.30, 0), atol=1e-6)  # a quarter on: forward
        np.testing.assert_allclose(rim[4], pixel(0, sign * (0.30 + lean), -up), atol=1e-6)
    assert points["left"].hub_px[0] > 640 > points["right"].hub_px[0]  # the athlete's left is on the picture's right


def test_limbs_and_straps_follow_the_arms():
    """Under every marker there is a dark strap, where the arm has it: without the balls the picture is dark there."""
    world = build("strokes", frames=200)
    bare = Scene(replace(world, balls=()))
    loose = Scene(replace(world, balls=(), athlete=replace(world.athlete, strap_m=0.0)))
    for index in (30, 60):
        strapped, without = (scene.light(index).mean(axis=2) for scene in (bare, loose))
        for ball in world.balls:
            xyz = world.vibration.move(ball.path(t := np.array([bare._stamp_s(index)])), t)
            x, y = np.rint(CAMERA.project(xyz)[0]).astype(int)
            assert strapped[y - 1 : y + 2, x - 1 : x + 2].max() < 0.03, (index, ball.name)
            if ball.name.endswith("elbow"):
                assert without[y, x] > strapped[y, x]
