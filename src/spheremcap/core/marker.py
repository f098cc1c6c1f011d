"""What a person gives: the markers of a session, and where they are on a frame."""

from dataclasses import dataclass

from spheremcap.core.circle import Circle


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """One marker to track: its name (also its topic) and the sphere's true diameter in metres."""

    name: str
    diameter_m: float = 0.04

    @property
    def radius_m(self) -> float:
        return self.diameter_m / 2


@dataclass(frozen=True, slots=True)
class Seed:
    """Where a person says a marker is, on frame `frame_index` (presentation order); a later one is a correction."""

    marker: str
    frame_index: int
    circle: Circle
