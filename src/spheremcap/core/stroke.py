"""A hand takes hold of the rim and lets it go: events and strokes of one hand.

The chair's frame has its origin midway between the hubs of the rear wheels, x forward, y to the athlete's left, z up,
in metres. Angles about the axle are in degrees from straight up, growing as the wheel turns when the chair goes
forward. An `_sd` is a standard deviation in the unit of its value; None is no such value.
"""

from dataclasses import dataclass
from enum import Enum


class EventKind(Enum):
    """What a hand does with the rim."""

    CONTACT = "CONTACT"
    RELEASE = "RELEASE"


@dataclass(frozen=True, slots=True)
class StrokeEvent:
    """A hand's contact or release at `stamp_ns`, between two frames, good to `sd_ms`.

    `stroke` counts the strokes of this hand from 0. Angle and speed are those of the wrist's marker: the speed just
    before contact, just after release. `evidence` is what told it.
    """

    stamp_ns: int
    side: str
    marker: str
    kind: EventKind
    stroke: int
    sd_ms: float
    angle_deg: float | None
    angle_sd_deg: float | None
    speed_mps: float | None
    speed_sd_mps: float | None
    evidence: str


@dataclass(frozen=True, slots=True)
class Stroke:
    """One stroke of one hand, from contact to the next contact; the fields are those of spheremcap.Stroke.

    `stamp_ns` is that of contact, or of release where contact was not seen. `missing` says what is not there and why.
    """

    stamp_ns: int
    side: str
    marker: str
    stroke: int
    push_s: float | None = None
    push_sd_s: float | None = None
    recovery_s: float | None = None
    recovery_sd_s: float | None = None
    cycle_s: float | None = None
    cycle_sd_s: float | None = None
    frequency_hz: float | None = None
    frequency_sd_hz: float | None = None
    contact_deg: float | None = None
    contact_sd_deg: float | None = None
    release_deg: float | None = None
    release_sd_deg: float | None = None
    push_deg: float | None = None
    push_sd_deg: float | None = None
    contact_mps: float | None = None
    contact_sd_mps: float | None = None
    recovery_end_mps: float | None = None
    recovery_end_sd_mps: float | None = None
    wheel_rad_s: float | None = None
    pattern: str = ""
    measured: float = 0.0
    missing: str = ""
