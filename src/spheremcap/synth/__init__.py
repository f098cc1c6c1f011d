"""Rendered sessions with exact truth: `names()`, `describe(name)`, `render(name, folder)`, and `Scene` in
memory.
"""

from spheremcap.synth.scenarios import SCENARIOS, Scenario, build, describe, names
from spheremcap.synth.scene import MarkerTruth, Scene
from spheremcap.synth.session import TRUTH_COLUMNS, SynthSession, render

__all__ = [
    "SCENARIOS",
    "TRUTH_COLUMNS",
    "MarkerTruth",
    "Scenario",
    "Scene",
    "SynthSession",
    "build",
    "describe",
    "names",
    "render",
]
