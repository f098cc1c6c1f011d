"""What is said beside a verb's output."""

import sys

from spheremcap.errors import printable


def warn(said: object) -> None:
    """A line on stderr, or some: with what a file has in it, but nothing that a terminal would obey."""
    lines = f"spheremcap: {said}".split("\n")
    print("\n".join(map(printable, lines)), file=sys.stderr)
