"""What decides a session's result: the same key is the same result. (Its tables are so byte for byte. Of a recording
that was taken up, messages are the same and may be laid out otherwise.)

It is in three parts, so that only what a change touches is made again: what was tracked (pictures, settings), the
answers in it (seeds), and all that is done afterwards (sensors, analysis). Files count by their content; one that
looks as it did is not read again. Settings count by what they come to, so that a comment changes nothing.
"""

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from spheremcap.analysis.settings import AnalysisSettings, load_analysis_settings
from spheremcap.config import Settings, load_seeds, load_settings, seeds_toml
from spheremcap.core.marker import Answer
from spheremcap.errors import SourceError, SpheremcapError
from spheremcap.io.chapter_list import chapters_in, is_list
from spheremcap.io.output import VERSION
from spheremcap.season.addresses import is_address, looked_at
from spheremcap.season.manifest import Plan
from spheremcap.season.outcome import InputFile, Outcome, is_whole

_READ_BYTES = 16 << 20


@dataclass(frozen=True)
class Given:
    """A session's settings and answers as they are read, and its files by the path that the plan has for them."""

    settings: Settings
    answers: tuple[Answer, ...]
    analysis: AnalysisSettings
    files: Mapping[str, InputFile]
    tracked: str
    """Key of what is tracked, without answers."""
    answered: str
    """Key of the answers."""
    key: str
    """Key of all."""


def given(
    plan: Plan,
    known: Outcome | None,
    local: Callable[[str], Path] | None,
    going_on: Callable[[], None] = lambda: None,
) -> Given | None:
    """What decides the session's result. `known` is how it ended before: a file that looks as it did then is not read
    again. `local` gives the path of an input, where that is an address a copy's; without it no other is read either,
    and None is returned where there are some. `going_on` is called while a file is read, and may raise.

    Raises SettingsError for what is wrong in settings, seeds or manifest, SourceError for a file that is not there.
    """
    if gone := [line for line in plan.missing if line.startswith("no video")]:  # or one of several chapters
        raise SourceError(gone[0])
    if not plan.videos:
        raise SourceError(f"{plan.name}: no video")
    settings = Settings() if plan.settings is None else load_settings(Path(plan.settings))
    analysis = AnalysisSettings() if plan.analysis is None else load_analysis_settings(Path(plan.analysis))
    answers = tuple(load_seeds(Path(plan.seeds))) if os.path.isfile(plan.seeds) else ()
    before = {file.path: file for file in known.inputs} if known is not None else {}
    tracked_files = [*plan.videos, *_named_by(plan.settings, settings.camera.file)]
    merged_files = [path for s in plan.sensors for path in (s.path, s.how.mapping) if path is not None]
    merged_files += _named_by(plan.analysis, analysis.chair.clicks) if plan.analyse else []
    files: dict[str, InputFile] = {}
    for path in (*tracked_files, *merged_files):
        try:
            size, state = _look(path)
        except SourceError:
            if path in (sensor.path for sensor in plan.sensors):
                continue  # the others are merged, and it is named
            raise
        same = before.get(path)
        if same is not None and same.state == state:
            files[path] = same
        elif local is None:
            return None
        else:
            content = _content(local(path), going_on)
            files[path] = InputFile(path=path, size_bytes=size, state=state, sha256=content)
    tracked = key_of(
        VERSION, plan.name, settings.to_toml(), plan.auto, plan.start_time, plan.rate, plan.topic,
        *_contents(tracked_files, files),
    )  # fmt: skip
    answered = key_of(seeds_toml(answers))
    absent = [line for line in plan.missing if line.startswith("no sensor")]
    rest = key_of(
        plan.subject, *absent, plan.force, plan.analyse, plan.fill_ms, analysis.model_dump_json(),
        *(text for sensor in plan.sensors for text in (sensor.name, sensor.how.model_dump_json(exclude={"mapping"}))),
        *_contents(merged_files, files),
    )  # fmt: skip
    return Given(settings, answers, analysis, files, tracked, answered, key_of(tracked, answered, rest))


def check_unchanged(files: Mapping[str, InputFile], going_on: Callable[[], None] = lambda: None) -> None:
    """Raises SourceError where a file is another one now than when it was read; `going_on` is as in `given`."""
    for path, file in files.items():
        if file.state != _look(path)[1] and (is_address(path) or file.sha256 != _content(Path(path), going_on)):
            raise SourceError(f"{path}: was changed while the session was made from it: run it again")


def is_done(plan: Plan, known: Outcome | None, folder: Path) -> bool:
    """Whether a session has its result in its folder already, without reading a video or a log."""
    if known is None or known.status == "failed" or not is_whole(folder, known):
        return False
    try:
        now = given(plan, known, None)
    except (SpheremcapError, OSError):  # which its run will say
        return False
    return now is not None and now.key == known.key


def size_of(plan: Plan) -> int:
    """Bytes of a session's video: by them its length is guessed before it is opened."""
    size = 0
    for video in plan.videos:
        with suppress(SpheremcapError, OSError):  # which its run will say
            size += _look(video)[0]
    return size


def _named_by(settings: str | None, file: str | None) -> list[str]:
    """A file that a settings file names, which starts at its folder."""
    return [] if settings is None or file is None else [str(Path(settings).parent / file)]


def _contents(paths: Sequence[str], files: Mapping[str, InputFile]) -> Iterator[str]:
    """Names and contents; a file's folder does not count."""
    for path in paths:
        yield Path(path).name
        yield files[path].sha256 if path in files else "none"


def key_of(*told: object) -> str:
    """Of texts and numbers, none of which runs into the next."""
    return hashlib.sha256("".join(f"{len(str(one))}:{one}" for one in told).encode()).hexdigest()


def _members(path: Path) -> list[Path]:
    """The files that a path stands for: a folder's, or a list of chapters and what it lists; else itself."""
    if path.is_dir():
        return sorted(p for p in path.rglob("*") if p.is_file())
    return [path, *(chapters_in(path) if is_list(path) else ())]


def _look(path: str) -> tuple[int, str]:
    """Bytes, and what is another text when the content may be another one: names, sizes and dates of all files (also
    when they were last touched at all, for a copy may take its original's date with it). Of an address what stands for
    it."""
    if is_address(path):
        return looked_at(path)
    try:
        members = _members(Path(path))
        states = [member.stat() for member in members]
    except FileNotFoundError:
        raise SourceError(f"{path}: no such file; the manifest names it") from None
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    told = ((one.name, s.st_size, s.st_mtime_ns, s.st_ctime_ns) for one, s in zip(members, states, strict=True))
    return sum(s.st_size for s in states), key_of(*(fact for facts in told for fact in facts))


def _content(path: Path, going_on: Callable[[], None]) -> str:
    """SHA-256 of a file; of a folder, of its files' names and contents."""
    members = _members(path)
    if members == [path]:
        return _digest(path, going_on)
    return key_of(*(text for m in members for text in (os.path.relpath(m, path), _digest(m, going_on))))


def _digest(path: Path, going_on: Callable[[], None]) -> str:
    whole = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while part := file.read(_READ_BYTES):
                whole.update(part)
                going_on()
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    return whole.hexdigest()
