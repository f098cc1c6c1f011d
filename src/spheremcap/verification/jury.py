"""From six votes to a verdict (thesis section 3.1.4.1, eq 3.8)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

from pydantic import Field, model_validator

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.core.stage import StageConfig
from spheremcap.core.vote import Verdict, Vote
from spheremcap.verification.matching import Matches, MatchingConfig, Template, match


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
    near_visible: float = Field(
        0.25, ge=0, le=1, description="least share of the outline of a claim just where the marker is expected"
    )
    lost_likeness: float = Field(
        0.7, ge=0, le=1, description="least correlation (CCORR_NORMED) with the template of a marker that was lost"
    )
    lost_visible: float = Field(0.4, ge=0, le=1, description="least share of the outline of a marker that was lost")
    visible: float = Field(0.3, ge=0, le=1, description="least share of the outline that shows an edge")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.th2 > self.th1:
            raise ValueError(
                f"th2 = {self.th2:g} is above th1 = {self.th1:g}: give th2 <= th1, a sum below th2 rejects a claim "
                "and one above th1 verifies it"
            )
        return self


def cast_votes(matches: Matches) -> tuple[Vote, ...]:
    """Each matcher's circle and its overlap with the claim."""
    return tuple(map(Vote, matches.matchers, matches.circles, matches.scores, matches.overlaps))


def vote_sum(votes: Sequence[Vote]) -> float:
    """Sum of the overlaps, in [0, 6]."""
    return sum([v.overlap for v in votes])


def judge(total: float, config: JuryConfig) -> Verdict:
    """The verdict that a sum of votes gives."""
    if total > config.th1:
        return Verdict.VERIFIED
    return Verdict.DOUBTFUL if total >= config.th2 else Verdict.REJECTED


def template_vote(template: Template, gain: float, patch: Patch, claim: Circle, config: MatchingConfig) -> float:
    """The mean vote, in [0, 1], of a template that may be old for a claim (image pixels): the seed's own, `gain` times
    as bright as it was (`Appearance.gain`)."""
    brighter = replace(template, pixels=template.pixels * template.pixels.dtype.type(gain))
    matches = match(brighter, patch, claim, 0.6 * claim.r_px, config, claim)
    return sum(matches.overlaps) / len(matches)
