"""Is it true: six votes on a claim, and the named checks that the votes alone would not make."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from spheremcap.core.circle import Circle
from spheremcap.core.frame import Patch
from spheremcap.core.look import Look, Measured
from spheremcap.core.vote import Verdict
from spheremcap.detection.appearance import Appearance
from spheremcap.detection.detector import Detected
from spheremcap.verification.checks import Case, covered, doubts
from spheremcap.verification.jury import JuryConfig, cast_votes, judge, template_vote, vote_sum
from spheremcap.verification.matching import (
    MATCHERS,
    Gap,
    Matches,
    MatchingConfig,
    less_hidden,
    make_template,
    match,
    widest_gap,
)

_CCORR_NORMED = MATCHERS.index("CCORR_NORMED")
_NOTHING_HIDDEN = 0.77  # share of an outline with an edge that leaves no gap of a quarter
_AS_LARGE = 0.2  # logarithm of the ratio of radii up to which a claim may be a marker of which a part is hidden
_FARTHEST = 3.5  # radii from the expected place that matchers look for a claim that far off


@dataclass(frozen=True, slots=True)
class Prior:
    """What was known of a marker before a look: the circle `around` which it was sought and how far, pixels; whether it
    is sought as one that was `lost`; the circle it should have (`expected`), the greatest ratio of radii (`growth`),
    and how `surprise`d one is to find it there, as in `Case`; whether it was not verified on the frame before
    (`missed`)."""

    around: Circle
    reach_px: float
    lost: bool
    expected: Circle
    growth: float
    surprise: float
    missed: bool = False


class Verifier:
    """One marker's templates and jury. The last verified picture may drift with what is followed; the seed's cannot."""

    def __init__(
        self,
        patch: Patch,
        circle: Circle,
        appearance: Appearance,
        jury: JuryConfig,
        matching: MatchingConfig,
        colour: bool,
    ) -> None:
        """From a seed's circle (image pixels); `colour` False leaves the checks of colour out."""
        self._jury, self._matching, self._colour = jury, matching, colour
        self._appearance = appearance
        self._seeded = self._template = make_template(patch, circle, matching)

    def look(self, patch: Patch, found: Detected, prior: Prior) -> Look:
        """Six votes on what was found, and the names of what speaks against it."""
        claim, size = found.claim, prior.around.r_px
        circle = claim.circle if claim is not None else None
        reach_px = min(prior.reach_px, size)
        if circle is not None:
            reach_px = max(reach_px, min(circle.distance(prior.around) + 0.3 * size, _FARTHEST * size))
        # One that was missed may look as it did when last verified or as it did when a person showed it.
        gap, tried = _hidden(claim, prior), []
        for template in (self._template, self._seeded) if prior.missed else (self._template,):
            matches = match(less_hidden(template, gap), patch, prior.around, reach_px, self._matching, circle)
            votes = cast_votes(matches)
            tried.append((vote_sum(votes), votes, matches))
        total, votes, matches = max(tried, key=lambda one: one[0])
        verdict = judge(total, self._jury) if claim is not None else Verdict.REJECTED
        against = ("no outline",) if claim is None else self._doubts(patch, claim, prior, gap.shown, matches)
        if claim is not None and verdict is not Verdict.VERIFIED:
            against = ("votes", *against)
        return Look(
            prior.around,
            patch,
            found.proposals,
            found.hough,
            found.limits,
            claim,
            matches,
            votes,
            total,
            verdict,
            against,
            prior.lost,
        )

    def _doubts(self, patch: Patch, claim: Measured, prior: Prior, shown: float, matches: Matches) -> tuple[str, ...]:
        appearance, vote = self._appearance, None
        if claim.visible < 0.7 and not prior.lost:
            vote = template_vote(self._seeded, appearance.gain, patch, claim.circle, self._matching)
        shares, unlike = appearance.shares(patch, claim.circle) if self._colour else None, math.inf
        if shares is not None and not prior.lost and shares[0] < self._jury.seed_colour * appearance.inside:
            unlike = appearance.unlike(patch, claim.circle)
        case = Case(
            claim.circle, prior.expected, claim.visible, appearance.visible, prior.lost, prior.surprise, prior.growth,
            colour=shares,
            seeded_colour=(appearance.inside, appearance.around),
            seed_vote=vote,
            in_picture=claim.in_picture, shown=shown, likeness=matches.scores[_CCORR_NORMED], unlike=unlike,
        )  # fmt: skip
        return doubts(case, self._jury)

    def learn(self, patch: Patch, circle: Circle) -> None:
        """Take the template from a verified circle (image pixels)."""
        self._template = make_template(patch, circle, self._matching)


def _hidden(claim: Measured | None, prior: Prior) -> Gap:
    """The part of a claim that something may hide: none of one that shows more than three quarters of its outline, or
    that is not as large as the marker should be, which may be a part itself."""
    if (
        claim is None
        or claim.visible > _NOTHING_HIDDEN
        or abs(math.log(claim.circle.r_px / prior.expected.r_px)) > _AS_LARGE
    ):
        return Gap()
    return widest_gap(claim.circle, claim.edges.points_px[claim.agreeing])


def uncovered(look: Look, taken: Sequence[Circle]) -> Look:
    """The look, doubted when the circle of another marker covers its claim."""
    if look.claim is None or not covered(look.claim.circle, taken):
        return look
    return replace(look, doubts=(*look.doubts, "covered"))
