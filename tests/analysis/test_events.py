"""The instants themselves, in paths about the axle whose contact and release are known."""

from dataclasses import replace

import numpy as np
import pytest

from spheremcap.analysis.events import Path, instant, shake_of
from spheremcap.core.stroke import EventKind

CONTACT, RELEASE = EventKind.CONTACT, EventKind.RELEASE
RIM_M, RATE, STEP_S = 0.2, 20.0, 1 / 240
AT_S = 0.1513
"""Between two frames."""


def path(kind, *, seed=0, at_s=AT_S, wheel=True, noise_m=0.0004, shake_m=0.0, gap=None, step_s=STEP_S):
    """A hand that comes to the rim inward and slower than it is, or is cast off it."""
    t = np.arange(0, 0.3, step_s)
    since = t - at_s
    turned = RATE * t
    if kind is CONTACT:
        off = np.minimum(since, 0)
        radius, arc = RIM_M - 1.2 * off - 6 * off**2, RIM_M * turned - 0.9 * off
    else:
        off = np.maximum(since, 0)
        radius, arc = RIM_M + 30 * off**2, RIM_M * turned - 25 * off**2
    rng = np.random.default_rng(seed)
    shaken = shake_m * np.sin(2 * np.pi * 60 * t)
    radius, arc = (values + noise_m * rng.standard_normal(len(t)) + shaken for values in (radius, arc))
    covariance = np.tile(noise_m**2 * np.eye(2), (len(t), 1, 1))
    keep = np.ones(len(t), np.bool_)
    if gap is not None:
        keep[gap] = False
    return Path(
        t[keep], radius[keep], arc[keep], covariance[keep], 1.0, turned[keep], np.full(keep.sum(), wheel), RIM_M, step_s
    )


@pytest.mark.parametrize("wheel", [True, False])
@pytest.mark.parametrize("kind", EventKind)
def test_an_instant_between_frames_is_found_to_what_it_says(kind, wheel):
    off, angles = [], []
    for seed in range(25):
        at_s = AT_S + seed * 0.00037
        guess = at_s + 0.004 * np.cos(seed)
        found = instant(path(kind, seed=seed, at_s=at_s, wheel=wheel), kind, guess, 0.0, 0.3)
        assert (found.fitted, found.by_wheel) == (True, wheel)
        off.append(((found.t_s - at_s), (found.t_s - at_s) / found.sd_s))
        angles.append((found.angle_rad - RATE * at_s, found.angle_sd_rad))
    error, z = np.array(off).T
    assert np.median(np.abs(error)) < 0.0012
    assert 0.3 < np.sqrt((z**2).mean()) < 1.6
    angle, sd = np.array(angles).T
    assert np.abs(angle).max() < 0.08
    assert np.sqrt(np.mean((angle / sd) ** 2)) < 1.8


def test_speeds_are_those_just_before_contact_and_at_release():
    before = instant(path(CONTACT), CONTACT, AT_S, 0.0, 0.3)
    assert before.speed_mps == pytest.approx(np.hypot(1.2, RATE * RIM_M - 0.9), abs=3 * before.speed_sd_mps + 0.1)
    after = instant(path(RELEASE), RELEASE, AT_S, 0.0, 0.3)
    assert after.speed_mps == pytest.approx(RATE * RIM_M, abs=3 * after.speed_sd_mps + 0.1)


def test_noisier_positions_tell_it_worse():
    sds = [instant(path(CONTACT, noise_m=noise), CONTACT, AT_S, 0.0, 0.3).sd_s for noise in (0.0002, 0.001, 0.003)]
    assert sds[0] < sds[1] < sds[2] < 0.006


def test_why_there_is_none_is_said():
    whole = path(CONTACT)
    # The third frame before the first on the rim is the last before the gap
    first = int(np.searchsorted(whole.t_s, AT_S))
    for start in (first - 9, first - 4, first - 1):
        some = path(CONTACT, gap=slice(start, start + 10))
        seen = float(some.t_s[np.searchsorted(some.t_s, AT_S)])
        assert instant(some, CONTACT, seen + 0.004, 0.0, 0.3) == "10 frames are missing at it"
    release = path(RELEASE)
    last = int(np.searchsorted(release.t_s, AT_S)) - 1
    for start in (last - 9, last - 4, last):
        some = path(RELEASE, gap=slice(start, start + 10))
        seen = float(some.t_s[np.searchsorted(some.t_s, AT_S) - 1])
        assert instant(some, RELEASE, seen - 0.012, 0.0, 0.3) == "10 frames are missing at it"
    assert instant(whole, CONTACT, 0.01, 0.0, 0.02) == "too few positions were measured at it"
    begins = path(CONTACT, gap=slice(0, first - 2))
    assert instant(begins, CONTACT, AT_S, 0.0, 0.3) == "the hand was not seen off the rim before it"
    ends = path(RELEASE, gap=slice(last + 3, None))
    assert instant(ends, RELEASE, AT_S, 0.0, 0.3) == "the hand was not seen off the rim after it"


def test_two_missing_frames_hide_nothing():
    first = int(np.searchsorted(path(CONTACT).t_s, AT_S))
    found = instant(path(CONTACT, gap=slice(first - 1, first + 1)), CONTACT, AT_S, 0.0, 0.3)
    assert found.t_s == pytest.approx(AT_S, abs=0.004)


def test_a_path_that_tells_nothing_leaves_the_guess_as_wide_as_it_is():
    """Positions so bad that any instant fits: the guess comes back, with its own uncertainty, and is said not to be
    fitted, or the fit is as unsure as the guess."""
    found = instant(path(CONTACT, noise_m=0.05), CONTACT, AT_S, 0.0, 0.3)
    assert found.sd_s >= 0.002
    assert abs(found.t_s - AT_S) < 3 * found.sd_s


def test_how_far_the_camera_shakes_is_told_by_how_badly_the_fits_fit():
    guesses = [(CONTACT, AT_S, 0.0, 0.3)]
    quiet, shaken = path(CONTACT), path(CONTACT, shake_m=0.0009)
    assert shake_of(quiet, guesses) == 0
    assert shake_of(shaken, guesses) > 0
    assert shake_of(path(CONTACT, noise_m=0.0001, shake_m=0.0003), guesses) in (0.0002, 0.0004)
    said = replace(shaken, shake_m=shake_of(shaken, guesses))
    assert instant(said, CONTACT, AT_S, 0.0, 0.3).sd_s > instant(quiet, CONTACT, AT_S, 0.0, 0.3).sd_s


def test_near_is_what_lies_between_two_times():
    some = path(CONTACT).near(0.1, 0.2)
    assert some.t_s[0] >= 0.1
    assert some.t_s[-1] <= 0.2
    assert len(some.t_s) == len(some.radius_m) == len(some.covariance) == 25
