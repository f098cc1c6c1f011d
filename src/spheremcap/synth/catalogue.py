"""All scenarios of both renderers in one table: their names, what they show, and the session in memory."""

from spheremcap.synth import scenarios
from spheremcap.synth.daylight import days
from spheremcap.synth.daylight.film import Film
from spheremcap.synth.scene import Scene
from spheremcap.synth.truth import Rendered


def names() -> tuple[str, ...]:
    """The scenarios' names, the first renderer's before those of the second, which begin with `day-`."""
    return (*scenarios.SCENARIOS, *days.DAYS)


def describe(name: str) -> str:
    """One line on a scenario. Raises KeyError when there is none of that name."""
    return days.DAYS[name].about if name in days.DAYS else scenarios.SCENARIOS[name].about


def rendered(name: str, *, seed: int = 0, frames: int | None = None) -> Rendered:
    """A scenario's pictures and truth, in memory, of `frames` pictures (its usual number when None). Raises
    KeyError."""
    if name in days.DAYS:
        return Film(days.build(name, seed=seed, frames=frames))
    return Scene(scenarios.build(name, seed=seed, frames=frames))
