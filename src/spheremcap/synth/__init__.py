"""Rendered sessions with exact truth: `names()`, `describe(name)`, `render(name, folder)`, and `rendered(name)` in
memory. Two renderers make them that share no line of drawing: `Scene` (cards and balls over photographs), whose
modules lie here, and `daylight` (rays cast into a small world), whose scenarios begin with `day-`. Sessions of strokes
(`stroke_names()`) have exact contacts and releases besides.
"""

from spheremcap.synth.catalogue import describe, known, names, rendered, stroke_names
from spheremcap.synth.scenarios import SCENARIOS, Scenario, build
from spheremcap.synth.scene import Scene
from spheremcap.synth.session import TRUTH_COLUMNS, SynthSession, render
from spheremcap.synth.truth import Container, MarkerTruth, Rendered

__all__ = [
    "SCENARIOS",
    "TRUTH_COLUMNS",
    "Container",
    "MarkerTruth",
    "Rendered",
    "Scenario",
    "Scene",
    "SynthSession",
    "build",
    "describe",
    "known",
    "names",
    "render",
    "rendered",
    "stroke_names",
]
