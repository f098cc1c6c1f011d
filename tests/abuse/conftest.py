"""Puts the clips and media of the other tests on the path; what has to be compiled is, before stderr is looked at."""

import sys
from pathlib import Path

from spheremcap import api
from spheremcap.cli.progress import loaded

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "io")]
assert api.track
loaded()
