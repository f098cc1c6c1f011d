"""All scenarios of both renderers in one table: their names, what they show, and the session in memory."""

from spheremcap.synth import scenarios, stroke_scenarios
from spheremcap.synth.daylight import days
from spheremcap.synth.daylight.film import Film
from spheremcap.synth.scene import Scene
from spheremcap.synth.truth import Rendered


def names() -> tuple[str, ...]:
    """The names of the scenarios that experiments on tracking go through when nobody names others: the first renderer's
    before those of the second, which begin with `day-`."""
    return (*scenarios.SCENARIOS, *days.DAYS)


def stroke_names() -> tuple[str, ...]:
    """The names of the scenarios of strokes. Each is also there at other rates, as NAME@120 and NAME@60."""
    return tuple(stroke_scenarios.STROKES)


def known(name: str) -> bool:
    """Whether there is a scenario of that name."""
    try:
        describe(name)
    except KeyError:
        return False
    return True


def describe(name: str) -> str:
    """One line on a scenario. Raises KeyError when there is none of that name."""
    for table in (days.DAYS, scenarios.SCENARIOS):
        if name in table:
            return table[name].about
    return stroke_scenarios.described(name).about


def rendered(name: str, *, seed: int = 0, frames: int | None = None) -> Rendered:
    """A scenario's pictures and truth, in memory, of `frames` pictures (its usual number when None). Raises
    KeyError."""
    if name in days.DAYS:
        return Film(days.build(name, seed=seed, frames=frames))
    first = scenarios if name in scenarios.SCENARIOS else stroke_scenarios
    return Scene(first.build(name, seed=seed, frames=frames))
