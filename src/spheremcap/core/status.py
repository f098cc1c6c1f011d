"""What the chain says of a marker, and how one status follows from another."""

from dataclasses import dataclass
from enum import Enum

from pydantic import Field

from spheremcap.core.stage import StageConfig


class Status(Enum):
    """SEEDED: a person gave it. VERIFIED: measured and accepted. ESTIMATED: the Kalman filter stands in.
    LOST: not seen for too long. OUT_OF_VIEW: predicted outside the picture. The last two have no pose."""

    SEEDED = "SEEDED"
    VERIFIED = "VERIFIED"
    ESTIMATED = "ESTIMATED"
    LOST = "LOST"
    OUT_OF_VIEW = "OUT_OF_VIEW"

    @property
    def measured(self) -> bool:
        """Whether the circle and pose rest on this frame's picture (SEEDED or VERIFIED)."""
        return self in (Status.SEEDED, Status.VERIFIED)

    @property
    def tracked(self) -> bool:
        """Whether the Kalman filter knows where the marker is (not LOST, not OUT_OF_VIEW)."""
        return self not in (Status.LOST, Status.OUT_OF_VIEW)


class PolicyConfig(StageConfig):
    """When a marker is lost and how far it is looked for (docs/method.md section 5)."""

    lost_after: int = Field(5, ge=1, description="unverified frames in a row that mean LOST, at least")
    lost_radii: float = Field(
        1.0, ge=0, description="and the filter's deviation sideways from which it no longer stands in, radii; ours"
    )
    immediate: bool = Field(False, description="true: lost at the first sum below TH2 (thesis line 1143)")
    steered_s: float = Field(
        1.0, ge=0, description="seconds that KCF may steer the filter while no outline verifies; ours"
    )
    out_of_view_s: float = Field(1.0, ge=0, description="seconds out of the picture before it counts as LOST")


@dataclass(frozen=True, slots=True)
class Sight:
    """A frame without a verified circle: whether the claim was `rejected` (votes below TH2, or nothing to claim);
    whether the marker is surely `gone` from the picture; how many frames in a row were not verified (`misses`, this one
    included), how long ago the last verified one was, and how unsure the filter is of its place sideways, standard
    deviation in radii."""

    rejected: bool
    gone: bool
    misses: int
    away_s: float
    unsure_radii: float


def next_status(status: Status, sight: Sight, policy: PolicyConfig) -> Status:
    """The status after a frame without a verified circle (docs/method.md section 5)."""
    if not status.tracked:
        return Status.LOST if sight.away_s > policy.out_of_view_s else status
    if sight.gone:
        return Status.OUT_OF_VIEW
    given_up = sight.misses >= policy.lost_after and sight.unsure_radii >= policy.lost_radii
    if given_up or (policy.immediate and sight.rejected):
        return Status.LOST
    return Status.ESTIMATED
