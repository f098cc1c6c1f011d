"""What a verb says where an extra is not installed."""

from collections.abc import Iterator
from contextlib import contextmanager

from spheremcap.errors import UsageError


@contextmanager
def needed(what: str, extra: str) -> Iterator[None]:
    """Around imports of what only that extra brings. Raises UsageError where it is not installed."""
    try:
        yield
    except ImportError as error:
        raise UsageError(f"{what} needs more: pip install 'spheremcap[{extra}]' ({error.name} is missing)") from error
