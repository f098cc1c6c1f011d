"""The errors a user can meet: one root, a few children, each with what was found and what to do next."""


class SpheremcapError(Exception):
    """Root of every error that spheremcap raises on purpose; its message is one line for the user."""


class UsageError(SpheremcapError):
    """What was asked for cannot be: a seed outside the picture, an unknown preset, an output that exists."""


class SettingsError(UsageError):
    """A settings or seeds file has an unknown key, a missing one or a value out of range."""


class SourceError(SpheremcapError):
    """An input cannot be read at all: no such file, not a video, no video stream, no such topic."""


class OutputError(SpheremcapError):
    """The output cannot be written: the disk is full, the folder is missing."""


def short(found: object) -> str:
    """What was found, for an error's one line: an exception's own words, anything else as Python writes it; cut off
    where it gets long.
    """
    text = " ".join(str(found).split()) or type(found).__name__ if isinstance(found, BaseException) else repr(found)
    return text if len(text) <= 160 else f"{text[:140]} ... ({len(text)} characters)"


def printable(text: str) -> str:
    """Text of a file without control characters, which a terminal would obey, on one line."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
