"""The mean cycle: of cycles that are alike it is each of them, and a gap leaves its cycle out."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from spheremcap.analysis.cycles import PERCENT, bands_of
from spheremcap.core.stroke import Stroke

START_NS, RATE_HZ, CYCLE_S = 10**18, 240, 0.5


@dataclass
class Arm:
    values: dict


@dataclass
class Hand:
    strokes: tuple


@dataclass
class Found:
    """What of the findings a mean cycle is made of: one hand whose cycles take half a second, from 0.25 s on."""

    values: dict
    angle: np.ndarray
    strokes: tuple
    stamp_ns: np.ndarray = field(
        default_factory=lambda: START_NS + (np.arange(4 * RATE_HZ) * 1e9 / RATE_HZ).astype(np.int64)
    )

    @property
    def arms(self):
        return {"left": Arm(self.values)}

    @property
    def hands(self):
        return {"left": Hand(self.strokes)}

    def about(self, side, part):
        return {"angle_deg": self.angle[part]}


def cycles(push=0.15, count=7, **more):
    return tuple(
        Stroke(START_NS + round((0.25 + k * CYCLE_S) * 1e9), "left", "m", k, push_s=push, cycle_s=CYCLE_S, **more)
        for k in range(count)
    )


def found(values=None, strokes=None):
    t = np.arange(4 * RATE_HZ) / RATE_HZ
    share = (t - 0.25) / CYCLE_S
    speed = (3 + np.sin(2 * np.pi * share)).astype(np.float32)
    angle = (48 + 360 * share + 90) % 360 - 90  # a turn a cycle
    return Found({"speed_mps": speed if values is None else values}, angle, strokes or cycles())


def test_of_cycles_that_are_alike_the_band_is_each_of_them():
    bands = {band.quantity: band for band in bands_of(found())}
    band = bands["speed_mps"]
    assert (band.side, band.cycles) == ("left", 7)
    np.testing.assert_allclose(band.mean, 3 + np.sin(2 * np.pi * PERCENT / 100), atol=1e-3)
    np.testing.assert_allclose(band.sd, 0, atol=1e-3)
    assert band.release_percent == pytest.approx(30)


def test_an_angle_goes_on_across_a_whole_turn():
    (band,) = [band for band in bands_of(found()) if band.quantity == "angle_deg"]
    np.testing.assert_allclose(np.diff(band.mean), 3.6, atol=1e-6)
    assert band.mean[0] == pytest.approx(48)
    np.testing.assert_allclose(band.sd, 0, atol=1e-6)


def test_a_long_gap_leaves_its_cycle_out_and_a_short_one_does_not():
    values = found().values["speed_mps"].copy()
    values[200:205] = np.nan  # 25 ms from frame to frame
    assert next(b for b in bands_of(found(values)) if b.quantity == "speed_mps").cycles == 7
    values[200:212] = np.nan
    band = next(b for b in bands_of(found(values)) if b.quantity == "speed_mps")
    assert band.cycles == 6
    np.testing.assert_allclose(band.mean, 3 + np.sin(2 * np.pi * PERCENT / 100), atol=1e-3)


def test_the_deviation_is_that_of_cycles():
    t = np.arange(4 * RATE_HZ) / RATE_HZ
    values = np.floor((t - 0.25 + 1e-9) / CYCLE_S).astype(np.float32)
    (band,) = [b for b in bands_of(found(values, cycles(count=6))) if b.quantity == "speed_mps"]
    assert band.sd[50] == pytest.approx(np.std(np.arange(6), ddof=1))
    assert band.mean[50] == pytest.approx(2.5)


def test_strokes_without_a_push_or_the_next_contact_count_for_nothing():
    some = [*cycles(count=3), *cycles(push=None, count=7)[3:]]
    assert next(b for b in bands_of(found(strokes=tuple(some))) if b.quantity == "speed_mps").cycles == 3
    assert bands_of(found(strokes=cycles(count=1))) == []
