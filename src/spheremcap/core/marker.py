"""What a person gives: the markers of a session, and where they are on some frames, or that they are not to be seen."""

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
    """Where a person says a marker is, on frame `frame_index` (presentation order). `author` and `time` (RFC 3339, as
    it was given) are "" where nobody said."""

    marker: str
    frame_index: int
    circle: Circle
    author: str = ""
    time: str = ""


@dataclass(frozen=True, slots=True)
class Hidden:
    """A person says that a marker is not to be seen from frame `frame_index` to `to_frame_index`, both included."""

    marker: str
    frame_index: int
    to_frame_index: int
    author: str = ""
    time: str = ""

    def __contains__(self, frame_index: int) -> bool:
        return self.frame_index <= frame_index <= self.to_frame_index


@dataclass(frozen=True, slots=True)
class Keep:
    """A person says that what was estimated from frame `frame_index` to `to_frame_index` stands, both included."""

    marker: str
    frame_index: int
    to_frame_index: int
    author: str = ""
    time: str = ""


Answer = Seed | Hidden | Keep
"""What a person says of a marker: the first circle starts its track, all that comes later answers for some frames."""
