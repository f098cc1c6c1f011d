"""From six votes to a verdict (thesis section 3.1.4.1, eq 3.8)."""

from collections.abc import Sequence

from pydantic import Field

from spheremcap.core.circle import Circle
from spheremcap.core.stage import StageConfig
from spheremcap.core.view import ResponseMap
from spheremcap.core.vote import Verdict, Vote


class JuryConfig(StageConfig):
    """TH1 and TH2 are the thesis'; the seed's say is the project's (docs/method.md section 5)."""

    th1: float = Field(4.0, ge=0, le=6, description="a sum of votes above this verifies the claim")
    th2: float = Field(3.0, ge=0, le=6, description="a sum below this rejects it; between: doubtful")
    seed_colour: float = Field(
        0.6, ge=0, le=1, description="least share in the seed's colours, over share of outline seen"
    )
    lost_colour: float = Field(0.8, ge=0, le=1, description="the same for a marker that was lost")
    seed_around: float = Field(
        0.55, ge=0, le=1, description="most that colour may surround a claim of which little is seen"
    )
    seed_template: float = Field(
        0.6, ge=0, le=1, description="least vote of the seed's template, on average, for a claim little seen"
    )
    lost_visible: float = Field(0.4, ge=0, le=1, description="least share of the outline of a marker that was lost")
    visible: float = Field(0.3, ge=0, le=1, description="least share of the outline that shows an edge")


def cast_votes(maps: Sequence[ResponseMap], claim: Circle | None) -> tuple[Vote, ...]:
    """Each matcher's circle and its Dice overlap with the claim; 0 when nothing is claimed."""
    return tuple(
        Vote(
            m.matcher,
            m.circle,
            float(m.values[m.peak[1], m.peak[0]]),
            0.0 if claim is None else m.circle.dice(claim),
        )
        for m in maps
    )


def vote_sum(votes: Sequence[Vote]) -> float:
    """Sum of the overlaps, in [0, 6]."""
    return float(sum(v.overlap for v in votes))


def judge(total: float, config: JuryConfig) -> Verdict:
    """The verdict that a sum of votes gives."""
    if total > config.th1:
        return Verdict.VERIFIED
    return Verdict.DOUBTFUL if total >= config.th2 else Verdict.REJECTED
