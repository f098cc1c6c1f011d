"""Which of the things that may be a marker is which marker: by the colours that the settings give them, or, where they
list no markers, each named after its colour. What cannot be told apart is asked, never guessed.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from spheremcap.config import MarkerSettings, Settings
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Answer, Seed
from spheremcap.detection.hues import is_meant
from spheremcap.errors import UsageError
from spheremcap.proposals import Proposal

AUTHOR = "auto"
"""The author of a seed that nobody gave."""
_SURE, _OF_THE_BEST = 0.2, 0.3  # score, and share of the best one of all, from which one is taken without a person
_SURE_OF_ITS_COLOUR = 0.1  # score that will do where it has the colour that was asked for
_RIVAL = 0.5  # of the best one's score, from which another that fits too might be meant
_THE_SAME = 0.3  # Dice with a person's circle from which a proposal is what the person has shown


@dataclass(frozen=True)
class Found:
    """What `--auto` made of the first seconds.

    `seeds` begin the markers that were found and `settings` list these and the ones that a person seeded; `told` says
    in a line each what was taken for which marker, why, and what was left. `missing` names the markers that were not
    found, with what to do; `unclear` those for which several things could be meant, with these.
    """

    settings: Settings
    seeds: tuple[Seed, ...]
    told: tuple[str, ...]
    missing: tuple[str, ...]
    unclear: tuple[tuple[str, tuple[Proposal, ...]], ...]


def assign(proposals: Sequence[Proposal], settings: Settings, answers: Sequence[Answer], looked: str) -> Found:
    """Give the markers that nobody seeded what was found for them; `looked` says where that was sought. Raises
    UsageError where nothing was found at all."""
    given = [answer for answer in answers if isinstance(answer, Seed)]
    free = [p for p in proposals if not any(_shown(p, seed) for seed in given)]
    best = max((p.score for p in proposals), default=0.0)
    good = [p for p in free if p.score >= _OF_THE_BEST * best]
    if settings.markers:
        seeded = {seed.marker for seed in given}
        wanted = [marker for marker in settings.markers if marker.name not in seeded]
        taken, unclear = _by_settings(good, wanted)
        lost = [m for m in wanted if m.name not in taken and m.name not in dict(unclear)]
        kept = tuple(m for m in settings.markers if m not in lost)
    else:
        taken, unclear, lost, kept = _by_colour([p for p in good if p.score >= _SURE]), [], [], ()
    if not taken and not unclear and not given:
        raise UsageError(f"{_nothing(settings, free)} {looked}: give --seed MARKER@FRAME=X,Y,R{_likeliest(free)}")
    told = [f"{name} is {_told(name, p)}" for name, p in taken.items()]
    others = [p for p in free if p not in taken.values()]
    told += [f"left alone: {_told(p.colour, p)}" for p in others]
    missing = [
        f"{m.name}{_described(m)} was not found {looked} and is not tracked; where it comes into the picture, give "
        f"--seed {m.name}@FRAME=X,Y,R{_likeliest([p for p in others if _fits(p, m)])}"
        for m in lost
    ]
    return Found(
        settings.model_copy(update={"markers": kept}),
        tuple(Seed(name, p.frame_index, rounded(p.circle), AUTHOR) for name, p in taken.items()),
        tuple(told),
        tuple(missing),
        tuple((name, tuple(rivals)) for name, rivals in unclear),
    )


def as_seed(marker: str, proposal: Proposal) -> str:
    """A proposal as `--seed` takes it."""
    x, y, r = rounded(proposal.circle)
    return f"{marker}@{proposal.frame_index}={x:g},{y:g},{r:g}"


def rounded(circle: Circle) -> Circle:
    """A circle as it is written for a person, who then gives exactly the same one."""
    return Circle(*(round(value, 2) for value in circle))


def _by_settings(
    proposals: Sequence[Proposal], wanted: Sequence[MarkerSettings]
) -> tuple[dict[str, Proposal], list[tuple[str, list[Proposal]]]]:
    """What each marker is, by name, and what each of the others could be. One that can only be one thing takes it, and
    so may leave another with one; those that say their colour choose first."""
    taken: dict[str, Proposal] = {}
    rest = list(wanted)
    while rest:
        free = [p for p in proposals if p not in taken.values()]
        rivals = {m.name: _rivals([p for p in free if _fits(p, m) and _surely(p, m)]) for m in rest}
        coloured = [m for m in rest if m.colour is not None and rivals[m.name]]
        turn = coloured or [m for m in rest if rivals[m.name]]
        sure = [
            m
            for m in turn
            if len(rivals[m.name]) == 1 and not any(rivals[o.name] == rivals[m.name] for o in turn if o is not m)
        ]
        if not sure:
            return taken, [(m.name, rivals[m.name]) for m in turn]
        taken |= {m.name: rivals[m.name][0] for m in sure}
        rest = [m for m in rest if m not in sure]
    return taken, []


def _rivals(fitting: Iterable[Proposal]) -> list[Proposal]:
    """The likeliest and those that are not far behind."""
    ranked = sorted(fitting, key=lambda p: -p.score)
    return [p for p in ranked if p.score >= _RIVAL * ranked[0].score]


def _by_colour(proposals: Sequence[Proposal]) -> dict[str, Proposal]:
    """Each proposal under its colour's name; a second one of a colour is `orange_2`."""
    count: Counter[str] = Counter()
    named = {}
    for proposal in proposals:
        count[proposal.colour] += 1
        nth = count[proposal.colour]
        named[proposal.colour if nth == 1 else f"{proposal.colour}_{nth}"] = proposal
    return named


def _fits(proposal: Proposal, marker: MarkerSettings) -> bool:
    return marker.colour is None or is_meant(marker.colour, proposal.hsv)


def _surely(proposal: Proposal, marker: MarkerSettings) -> bool:
    return proposal.score >= (_SURE if marker.colour is None else _SURE_OF_ITS_COLOUR)


def _shown(proposal: Proposal, seed: Seed) -> bool:
    """Whether a person has shown this thing."""
    return any(index == seed.frame_index and circle.dice(seed.circle) > _THE_SAME for index, circle in proposal.seen)


def _told(name: str, proposal: Proposal) -> str:
    return f"{as_seed(name, proposal)} (score {proposal.score:.2f}): {proposal.reason}"


def _described(marker: MarkerSettings) -> str:
    if marker.colour is None:
        return ""
    return f" ({marker.colour if isinstance(marker.colour, str) else 'hue {:g} to {:g}'.format(*marker.colour)})"


def _nothing(settings: Settings, free: Sequence[Proposal]) -> str:
    wanted = ", ".join(m.name + _described(m) for m in settings.markers)
    return f"nothing that is surely {wanted or 'a coloured sphere'} was found"


def _likeliest(weak: Sequence[Proposal]) -> str:
    """The likeliest of those that were not taken, for a person to judge."""
    best = max(weak, key=lambda p: p.score, default=None)
    return "" if best is None else f" (likeliest, but hardly: {as_seed('MARKER', best)}, {best.colour})"
