"""The list of a video's files in order, as FFmpeg's concat demuxer takes it, by a name that ends in .ffconcat; and
which files are one recording, by the names that a camera gives them."""

import os
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

from spheremcap.errors import SourceError, UsageError, short
from spheremcap.io.input_file import checked_input

SUFFIX = ".ffconcat"
_HEAD = "ffconcat version 1.0"
_LARGEST_BYTES = 1 << 20
_WORD = re.compile(r"(?:'[^']*'|\\.|[^\s'\\])+")
"""What stands between blanks: quotes keep all but themselves as it is, and outside of them a backslash what follows."""
_PART = re.compile(r"'([^']*)'|\\(.)|([^\s'\\])")

_CHAPTER = re.compile(
    r"(GOPR|GP(?P<old>\d\d)|(?P<kind>G[HXL])(?P<new>\d\d))(?P<number>\d{4})", re.ASCII | re.IGNORECASE
)


def is_list(path: Path) -> bool:
    """Whether an input is taken as a list of chapters: by its name."""
    return path.suffix.lower() == SUFFIX


def chapters_in(path: Path) -> list[Path]:
    """The files that a list names, in its order, each of which is there; relative paths start at the list's folder.

    Raises SourceError for what is no such list, names no file, or a file that cannot be opened.
    """
    if checked_input(path, "a list of chapters") > _LARGEST_BYTES:
        raise SourceError(f"{path}: not a list of chapters: larger than {_LARGEST_BYTES >> 20} MB")
    try:
        text = path.read_bytes().decode("utf-8-sig", "surrogateescape")
    except OSError as error:
        raise SourceError(f"{path}: cannot be opened: {error.strerror}") from error
    found: list[Path] = []
    for number, name in _names(path, text):
        where = f"{path}: line {number}"
        try:
            chapter = path.parent / name
            if is_list(chapter):
                raise SourceError(f"{where} names a list, {name}: name the video files themselves")
            checked_input(chapter, "a video")
        except SourceError as error:
            raise error if str(error).startswith(where) else SourceError(f"{where}: {error}") from error
        if chapter in found:
            raise SourceError(f"{where}: {name} is there twice; name each file once")
        found.append(chapter)
    if not found:
        raise SourceError(f"{path}: names no file; expected lines such as file 'GOPR0001.MP4'")
    return found


def _names(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """Line numbers and the names that `file` lines give."""
    begun = False
    for number, line in enumerate(re.split(r"\r?\n", text), start=1):
        where = f"{path}: line {number}"
        if not (line := line.strip()) or line.startswith("#"):
            continue
        if not begun:
            begun = line.split() == _HEAD.split()
            if not begun:
                raise SourceError(f"{where} is {short(line)}; a list of chapters begins with the line {_HEAD}")
            continue
        directive, *rest = line.split(maxsplit=1)
        if directive != "file":
            raise SourceError(
                f"{where} is {short(line)}; expected lines such as file 'GOPR0001.MP4' alone: files are taken whole"
            )
        if not rest or not _WORD.fullmatch(rest[0]):
            raise SourceError(
                f"{where} is {short(line)}; expected one name, as in file 'GOPR0001.MP4' "
                r"(with blanks in quotes, and an apostrophe as '\'')"
            )
        yield number, "".join(a or b or c for a, b, c in _PART.findall(rest[0]))


def write_list(files: Sequence[Path], at: Path) -> str:
    """The text of a list that is kept in the file `at`: names below its folder are relative to it, others absolute.

    Raises UsageError for a name with a line break, which such a list cannot hold.
    """
    folder = Path(os.path.abspath(at)).parent
    lines = [_HEAD]
    for file in files:
        whole = Path(os.path.abspath(file))
        name = str(whole.relative_to(folder) if whole.is_relative_to(folder) else whole)
        if "\n" in name or "\r" in name:
            raise UsageError(f"{file}: a name with a line break cannot stand in a list of chapters; rename it")
        lines.append("file '" + name.replace("'", r"'\''") + "'")
    return "\n".join([*lines, ""])


def recordings_of(videos: Sequence[Path]) -> list[tuple[list[Path], list[str]]]:
    """Videos, by folder and name chapters of one recording of a GoPro's together: in order, and the names of those
    that are missing."""
    chapters: dict[tuple[Path, str, str, str], dict[int, Path]] = defaultdict(dict)
    found: list[tuple[list[Path], list[str]]] = []
    for video in videos:
        told = _CHAPTER.fullmatch(video.stem)
        if told is None:
            found.append(([video], []))
            continue
        of = (video.parent, (told["kind"] or "").upper(), told["number"], video.suffix.lower())
        if chapters[of].setdefault(int(told["new"] or told["old"] or 0), video) is not video:
            found.append(([video], []))
    for (_, kind, number, _), own in chapters.items():
        ending = next(iter(own.values())).suffix
        absent = [at for at in range(1 if kind else 0, max(own)) if at not in own]
        begins = [f"{kind or 'GP'}{at:02}" if kind or at else "GOPR" for at in absent]
        names = [f"{begin}{number}{ending}" for begin in begins]
        found.append(([own[at] for at in sorted(own)], names))
    return found
