"""Strokes of simulated hands: every contact and release is found, and nothing else; and what a stroke is made of."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from simulated import START_NS, simulated, told, truth

from spheremcap.analysis.rim import AboutAxle
from spheremcap.analysis.strokes import _pattern, _rim_rate, strokes_of
from spheremcap.core.stroke import EventKind
from spheremcap.synth.strokes import Manner

SIDES = ("left", "right")
FRAME_MS = 1000 / 240
RIM_M = 0.18


@pytest.fixture(scope="module")
def plain():
    return simulated()


@pytest.fixture(scope="module")
def found(plain):
    return {(side, wheel): plain.strokes(side, wheel=wheel) for side in SIDES for wheel in (True, False)}


def errors_ms(made, strokes, side, kind):
    """Of each true event; all of them are there, and no other."""
    true, own = truth(made, side, kind), told(made, strokes, kind)
    assert len(true) == len(own) > 5
    assert np.abs(true - own).max() < 0.02
    return (own - true) * 1e3


@pytest.mark.parametrize("wheel", [True, False])
def test_all_contacts_and_releases_are_found_and_none_is_invented(plain, found, wheel):
    for kind in EventKind:
        off = np.concatenate([errors_ms(plain, found[side, wheel], side, kind) for side in SIDES])
        assert np.median(np.abs(off)) < (1.8 if wheel else 2.2)  # well within a frame of 4.2 ms
        assert np.abs(off).max() < FRAME_MS
        assert abs(off.mean()) < 1.3
        sd = np.array([e.sd_ms for side in SIDES for e in found[side, wheel].events if e.kind is kind])
        assert 0.3 < np.sqrt((off**2).mean()) / np.sqrt((sd**2).mean()) < 1.6
    for side in SIDES:
        strokes = found[side, wheel]
        assert strokes.push_radius_m == pytest.approx(0.205, abs=0.003)
        assert strokes.notes == ()
        # The first and the last stroke are cut by the ends
        assert {e.evidence for e in strokes.events[1:-1]} == {"radius and slip" if wheel else "radius and angle"}


@pytest.mark.parametrize(("rate_hz", "wheel"), [(120.0, True), (120.0, False)])
def test_a_slower_camera_finds_them_too(rate_hz, wheel):
    made = simulated(rate_hz=rate_hz, seed=3)
    for side in SIDES:
        strokes = made.strokes(side, wheel=wheel)
        for kind in EventKind:
            off = errors_ms(made, strokes, side, kind)
            assert np.median(np.abs(off)) < 4.2


def test_angles_and_speeds_are_those_of_the_wrist(plain, found):
    off, speeds = [], []
    for side in SIDES:
        true = {round(e.time_s, 1): e for e in getattr(plain.motion, side).events}
        for event in found[side, True].events[1:-1]:
            time_s = (event.stamp_ns - START_NS) / 1e9
            one = min(true.values(), key=lambda e, t=time_s: abs(e.time_s - t))
            assert one.kind == event.kind.value
            assert -90 <= event.angle_deg < 270
            gap = (event.angle_deg - np.degrees(one.angle_rad) + 180) % 360 - 180
            assert event.angle_sd_deg > 0
            off.append((gap, gap / event.angle_sd_deg))
            speeds.append((event.kind, event.speed_mps - one.speed_mps, event.speed_sd_mps))
    gaps, z = np.array(off).T
    assert np.median(np.abs(gaps)) < 3.0
    assert 0.2 < np.sqrt((z**2).mean()) < 1.6
    for kind in EventKind:
        error, sd = np.array([(error, sd) for of, error, sd in speeds if of is kind]).T
        assert np.median(np.abs(error)) < 0.35
        assert np.sqrt(np.mean((error / sd) ** 2)) < 3


def test_missed_catches_are_no_contacts():
    made = simulated(Manner(missed=(("left", 3), ("right", 6))), seed=1)
    for side in SIDES:
        for wheel in (True, False):
            strokes = made.strokes(side, wheel=wheel)
            for kind in EventKind:
                errors_ms(made, strokes, side, kind)
            assert max(s.cycle_s for s in strokes.strokes if s.cycle_s) > 1.7 / 1.87


def test_a_braking_is_no_stroke():
    made = simulated(Manner(braked=5), seed=2)
    start_s = (5 - 0.3) / 1.87
    for side in SIDES:
        for wheel in (True, False):
            strokes = made.strokes(side, wheel=wheel)
            for kind in EventKind:
                own = told(made, strokes, kind)
                errors_ms(made, strokes, side, kind)
                assert not ((own > start_s) & (own < start_s + 0.8)).any()


def test_a_stretch_that_is_no_push_does_not_tell_the_rims_rate(plain):
    hand = plain.hand("left")
    angle = np.where(plain.t_s < 3, 20 * plain.t_s, 60 + 15 * (plain.t_s - 3))
    rate = np.gradient(angle, plain.t_s)
    about = AboutAxle(0.2 + 0 * angle, angle, 0 * angle, np.zeros((len(angle), 2, 2)))
    pushes, short = [(100, 132), (230, 262), (360, 392), (1000, 1036), (1130, 1166)], [(140, 147), (270, 277)]
    for first, last in short:
        rate[first : last + 1] = 8.0
    turning = _rim_rate(hand, about, rate, sorted([*pushes, *short]))
    for first, last in pushes:  # and it is one rate over each push
        np.testing.assert_allclose(turning[first : last + 1], rate[first], rtol=1e-6)
    assert 15 < turning[700] < 20


def test_a_hand_that_begins_on_the_rim_has_no_contact_and_one_that_ends_there_no_release(plain):
    events = plain.motion.left.events
    contact, release = next(
        (a.time_s, b.time_s) for a, b in pairwise(events) if a.kind == "CONTACT" and a.time_s > plain.t_s[0] + 0.2
    )
    for start, end, kinds in (
        ((contact + release) / 2, release + 1.3, ["RELEASE", "CONTACT", "RELEASE", "CONTACT", "RELEASE"]),
        (contact - 0.2, release + 0.0 - 0.04, ["CONTACT"]),
    ):
        part = replace(plain, t_s=plain.t_s[(plain.t_s >= start) & (plain.t_s <= end)])
        strokes = part.strokes("left")
        own = [e.kind.value for e in strokes.events]
        assert own == kinds[: len(own)]
        assert own[0] == kinds[0]
        if kinds[0] == "RELEASE":
            first = strokes.strokes[0]
            assert "contact: the hand was not seen off the rim before it" in first.missing
            assert (first.push_s, first.cycle_s, first.contact_deg) == (None, None, None)
            assert first.recovery_s > 0.2
            assert first.release_deg is not None
            assert first.stamp_ns == strokes.events[0].stamp_ns
        else:
            assert "release" in strokes.strokes[0].missing
            assert strokes.strokes[0].contact_deg is not None


@pytest.mark.parametrize("kind", EventKind)
def test_a_gap_over_an_event_is_named_and_the_rest_is_there(plain, found, kind):
    """Wherever in a gap of 10 frames the instant lies, none is made up beside the gap."""
    event = next(e for e in plain.motion.left.events if e.time_s > 2 and e.kind == kind.value)
    middle = int(np.searchsorted(plain.t_s, event.time_s))
    for start in (-9, -5, -1):
        strokes = plain.strokes("left", gap=slice(middle + start, middle + start + 10))
        lost = [s for s in strokes.strokes if s.missing == f"{kind.value.lower()}: 10 frames are missing at it"]
        assert len(lost) == 1
        stroke = lost[0]
        assert f"left hand, stroke {stroke.stroke}: {stroke.missing}" in strokes.notes
        assert (stroke.push_s, stroke.push_deg) == (None, None)
        before, contact = strokes.strokes[stroke.stroke - 1], kind is EventKind.CONTACT
        assert before.push_s is not None
        assert (stroke.contact_deg is None, stroke.release_deg is None) == (contact, not contact)
        assert (stroke.cycle_s is None, stroke.recovery_s is None) == (contact, not contact)
        assert (before.cycle_s is None, before.recovery_s is None) == (contact, contact)
        assert (stroke.measured < 1.0) is not contact  # it begins with release where contact was not seen
        assert len(strokes.events) == len(found["left", True].events) - 1
        for other in EventKind:
            own, true = told(plain, strokes, other), truth(plain, "left", other)
            assert len(own) == len(true) - (other is kind)
            assert np.abs(own[:, None] - true).min(axis=1).max() < 0.005


@pytest.mark.parametrize("kind", EventKind)
def test_a_gap_a_few_frames_off_an_event_does_not_hide_it(plain, kind):
    event = next(e for e in plain.motion.left.events if e.time_s > 2 and e.kind == kind.value)
    middle = int(np.searchsorted(plain.t_s, event.time_s))
    for start in (-14, 6):
        strokes = plain.strokes("left", gap=slice(middle + start, middle + start + 6))
        assert np.abs(told(plain, strokes, kind) - event.time_s).min() < 0.004


def test_a_strokes_fields_agree_with_each_other_and_with_its_events(found):
    for (_, wheel), hand in found.items():
        whole = [s for s in hand.strokes if s.cycle_s is not None and s.push_s is not None]
        assert len(whole) >= 9
        at = {(e.stroke, e.kind): e for e in hand.events}
        for stroke in whole:
            contact, release = at[stroke.stroke, EventKind.CONTACT], at[stroke.stroke, EventKind.RELEASE]
            assert stroke.stamp_ns == contact.stamp_ns
            assert stroke.push_s == pytest.approx((release.stamp_ns - contact.stamp_ns) / 1e9, abs=2e-9)
            assert stroke.push_s + stroke.recovery_s == pytest.approx(stroke.cycle_s)
            assert stroke.frequency_hz == pytest.approx(1 / stroke.cycle_s)
            assert stroke.frequency_sd_hz == pytest.approx(stroke.cycle_sd_s * stroke.frequency_hz**2)
            assert stroke.push_sd_s == pytest.approx(np.hypot(contact.sd_ms, release.sd_ms) / 1e3)
            assert (stroke.push_deg - (stroke.release_deg - stroke.contact_deg)) % 360 in (
                pytest.approx(0, abs=1e-6),
                pytest.approx(360),
            )
            assert (stroke.contact_deg, stroke.release_deg) == (contact.angle_deg, release.angle_deg)
            assert stroke.contact_mps == contact.speed_mps
            assert stroke.pattern == "around"
            assert stroke.measured == 1.0
            assert 1 < stroke.recovery_end_mps < 6
            if wheel:
                assert stroke.wheel_rad_s == pytest.approx(20, rel=0.05)
            else:
                assert stroke.wheel_rad_s is None
        assert hand.strokes[-1].cycle_s is None


def test_without_upright_there_are_times_but_no_angles(plain, found):
    hand = replace(plain.hand("left"), tilt_sd_rad=None)
    strokes = strokes_of(hand, RIM_M)
    assert [e.stamp_ns for e in strokes.events] == [e.stamp_ns for e in found["left", True].events]
    assert {(e.angle_deg, e.angle_sd_deg) for e in strokes.events} == {(None, None)}
    assert {(s.contact_deg, s.contact_sd_deg, s.release_deg, s.release_sd_deg) for s in strokes.strokes} == {
        (None,) * 4
    }
    assert strokes.strokes[3].push_deg == found["left", True].strokes[3].push_deg


def test_what_the_chairs_frame_is_unsure_of_goes_into_angles_and_not_into_a_pushs_own(plain, found):
    unsure = strokes_of(
        replace(plain.hand("left"), tilt_sd_rad=np.radians(2.0), hub_sd_m=0.205 * np.radians(1.0)), RIM_M
    )
    for own, other in zip(found["left", True].strokes[1:-1], unsure.strokes[1:-1], strict=True):
        assert other.contact_sd_deg == pytest.approx(np.sqrt(own.contact_sd_deg**2 + 4 + 1), rel=0.01)
        assert other.push_sd_deg == own.push_sd_deg


def test_a_wrist_that_never_goes_along_a_rim_has_no_strokes(plain):
    hand = plain.hand("left")
    still = replace(hand.track, xyz_m=(hand.track.xyz_m + np.array([0.0, 0.0, 0.6])).astype(np.float32))
    strokes = strokes_of(replace(hand, track=still), RIM_M)
    assert (strokes.events, strokes.strokes) == ((), ())
    assert "left hand" in strokes.notes[0]


@pytest.mark.parametrize(
    ("above_m", "below_m", "turned", "expected"),
    [
        (0.0, 0.0, -2.0, "arc"),
        (0.0, 0.08, -2.0, "semicircular"),
        (0.08, 0.0, -2.0, "single loop"),
        (0.08, 0.08, -2.0, "double loop"),
        (0.08, 0.08, 4.0, "around"),
        (0.02, 0.02, -2.0, "arc"),
    ],
)
def test_a_recoverys_path_is_told_by_where_it_goes(above_m, below_m, turned, expected):
    share = np.linspace(0, 1, 60)
    radius = (
        0.2
        + above_m * np.sin(np.pi * np.minimum(2 * share, 1))
        - below_m * np.sin(np.pi * np.maximum(2 * share - 1, 0))
    )
    about = AboutAxle(radius, turned * share, 0 * share, np.zeros((60, 2, 2)))
    assert _pattern(about, 0.2, slice(0, 60)) == expected
    half = radius.copy()
    half[20:50] = np.nan
    assert _pattern(replace(about, radius_m=half), 0.2, slice(0, 60)) == ""
    assert _pattern(about, 0.2, slice(0, 4)) == ""
