"""Named checks: what may speak against a claim that the votes are for.

Each is a pure function of a `Case` that says whether the claim passes; its name goes into the estimate, the recording,
the debug picture and the request, so that a person reads why a frame was doubted.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from spheremcap.core.circle import Circle
from spheremcap.verification.jury import JuryConfig

_COVERED = 0.8  # share of a claim's disc from which the marker before it hides it
_LITTLE, _LEAST_IN_PICTURE = 0.6, 0.3  # shares of the outline
_SEEDED = 0.5  # of a seed that shows less of its outline, claims are asked for as much as if it had shown this
_CLEAR, _NO_LEAP = 0.7, 0.6  # share of the outline, and `off_expected`, of a claim that is no leap
_WHOLE = 0.9  # share of the outline of a claim that nothing hides
_AS_EXPECTED = 0.15  # `off_expected` of a claim that is just where the filter has the marker
_ON_ITS_WAY = 2.0  # radii from where a lost marker would be, had it moved on evenly
_NOT_HIDDEN = 0.4  # share of a disc's hidden part in the marker's colours from which nothing can hide it
_ALIKE = 0.25  # `unlike` of a colour that is the seed's, whatever its hue and saturation are called
_ALL_AROUND = 0.85  # share of a ring in the seed's colours from which those say nothing of an outline
_INSIDE = 0.9  # share of the outline in the picture from which a claim can be compared as a whole


@dataclass(frozen=True, slots=True)
class Case:
    """A claim and what is known of the marker that it would be.

    `claim` and `expected` are circles in the picture, `visible` the share of the claim's outline with an edge and
    `seeded_visible` that of the seed's. `lost` says that the marker was not being followed. `surprise` is the distance
    from where the filter has the marker, 1 at the gate (for one that was lost: at the farthest it can have gone);
    `growth` the greatest ratio of radii, either way, that time allows. `colour` is the shares of the seed's colours
    inside the claim and in a ring around it, `seeded_colour` those of the seed; None where colour is not asked.
    `seed_vote` is the mean vote in [0, 1] of the seed's template; None where it is not asked. `in_picture` is the share
    of the claim's outline inside the picture, `shown` that of its disc that nothing seems to hide (`Gap.shown`), and
    `likeness` the normalised correlation of what is seen with the template. `unlike` is how far the colour inside is
    from the seed's, as a share of its contrast to what is around (`Appearance.unlike`); infinite where it is not asked.
    """

    claim: Circle
    expected: Circle
    visible: float
    seeded_visible: float
    lost: bool
    surprise: float
    growth: float
    colour: tuple[float, float] | None
    seeded_colour: tuple[float, float]
    seed_vote: float | None
    in_picture: float = 1.0
    shown: float = 1.0
    likeness: float = 1.0
    unlike: float = math.inf

    @property
    def off_expected(self) -> float:
        """How far the claim is from the expected circle: radii aside, and three times the logarithm of the sizes."""
        r_px = self.expected.r_px
        return self.claim.distance(self.expected) / r_px + 3 * abs(math.log(self.claim.r_px / r_px))

    @property
    def as_expected(self) -> bool:
        """Whether it is just where, and as large as, a marker that is followed was expected."""
        return not self.lost and self.surprise <= 1 and self.off_expected < _AS_EXPECTED

    @property
    def little_seen(self) -> bool:
        """Whether something may hide a good part of the outline; what the picture's border cuts off is not hidden."""
        return self.visible < _LITTLE * max(self.in_picture, _LEAST_IN_PICTURE)


def _outline(case: Case, jury: JuryConfig) -> bool:
    """Enough of the outline shows an edge."""
    if case.seeded_visible == 0:  # no outline where a person said that the marker is: it has to show itself
        return case.visible > _CLEAR
    least = jury.lost_visible if case.lost else jury.visible
    on_its_way = case.lost and case.claim.distance(case.expected) < _ON_ITS_WAY * case.expected.r_px
    if on_its_way or case.as_expected:
        least = min(least, jury.near_visible)
    return case.visible >= min(least, 0.5 * max(case.seeded_visible, _SEEDED))


def _seed(case: Case, jury: JuryConfig) -> bool:
    """The seed's template, which does not follow, agrees with a claim of which little is seen; or it is just where and
    as large as a marker that is followed was expected. What hides the rest of it hides it from the template too."""
    return case.as_expected or case.seed_vote is None or case.seed_vote > jury.seed_template


def _colour(case: Case, jury: JuryConfig) -> bool:
    """The claim holds the seed's colours, as far as it is seen. Where one can be, half as much of them will do in a
    whole outline, and none in one that is followed and as good as the seed's colour beside all that is around: motion
    blur and light change colours, what else is there has none of them."""
    if case.colour is None:
        return True
    shown = min(max(0.4, case.visible), case.shown)
    least = jury.lost_colour if case.lost else jury.seed_colour
    if case.surprise <= 1 and (case.lost or case.off_expected < _NO_LEAP):
        if case.unlike < _ALIKE and not case.lost:
            return True
        if case.visible > _WHOLE:
            least *= 0.5
    return case.colour[0] >= least * shown * case.seeded_colour[0]


def _part(case: Case, jury: JuryConfig) -> bool:
    """The seed's colours do not go on around a claim of which little is seen, nor, unless it is just as expected, over
    what would be hidden of it: it would be a part of the marker, or of something larger."""
    if case.colour is None or not case.little_seen:
        return True
    if not case.as_expected and case.colour[0] > case.shown + _NOT_HIDDEN:
        return False
    return case.colour[1] <= min(_ALL_AROUND, jury.seed_around + case.seeded_colour[1])


def _gate(case: Case, jury: JuryConfig) -> bool:
    """It is where the marker can be. A clear outline hardly off the prediction is no leap, whatever a filter that has
    learnt a wrong speed says."""
    if case.surprise <= 1:
        return True
    return not case.lost and case.visible > _CLEAR and case.off_expected < _NO_LEAP


def _size(case: Case, jury: JuryConfig) -> bool:
    """It is as large as the marker can have become."""
    return 1 / case.growth <= case.claim.r_px / case.expected.r_px <= case.growth


def _likeness(case: Case, jury: JuryConfig) -> bool:
    """What was lost looks like the marker: six matchers find their best place in anything. What the picture's border
    cuts off cannot be compared."""
    return not case.lost or case.in_picture < _INSIDE or case.likeness >= jury.lost_likeness


CHECKS: Mapping[str, Callable[[Case, JuryConfig], bool]] = {
    "outline": _outline,
    "seed": _seed,
    "colour": _colour,
    "part": _part,
    "gate": _gate,
    "size": _size,
    "likeness": _likeness,
}
"""By name. Three more are asked when a frame is settled: "covered", by the frame's other markers, and of a marker that
was lost "stood there" and "unconfirmed" (`reacquired`)."""


def doubts(case: Case, jury: JuryConfig) -> tuple[str, ...]:
    """The names of the checks that a claim fails."""
    return tuple(name for name, passes in CHECKS.items() if not passes(case, jury))


def covered(claim: Circle, taken: Sequence[Circle]) -> bool:
    """Whether a circle of another marker covers this one: that marker then hides it, or is what was found."""
    return any(
        claim.distance(other) < claim.r_px + other.r_px and claim.shared_area(other) > _COVERED * claim.area_px2
        for other in taken
    )
