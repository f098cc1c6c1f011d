"""Lets the tests of this folder import tests/scenes.py, also when the folder is run alone."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
