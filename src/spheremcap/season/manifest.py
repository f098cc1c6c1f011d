"""The manifest: a TOML file that says which sessions there are, and for each its video, sensors, settings and seeds.

What `[defaults]` says holds for all sessions (settings where there is no STEM.settings.toml beside the video), what
`[[overrides]]` say for those whose names they match (the last one counts), and what a session says itself counts most.
Paths start at the manifest's folder. They may have `*`, `?` and `**` where several files are meant, and `{folder}`,
`{stem}` and `{name}`: the folder of the session's video, the video's name without its ending, and the session's name.
"""

import glob
import itertools
import os
import re
import shlex
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from fnmatch import fnmatchcase
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from spheremcap.core.stage import StageConfig
from spheremcap.core.time import parse_time_ns
from spheremcap.errors import SettingsError, UsageError
from spheremcap.io.chapter_list import recordings_of
from spheremcap.io.toml_file import first_problem, read_toml
from spheremcap.merging.clock import parse_drift, parse_offset
from spheremcap.season.addresses import is_address

SEASON = "season.json"
"""The name of the manifest as it was understood, beside the sessions' folders."""
NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,99}$"
_NO_NAME = re.compile(r"[^A-Za-z0-9_.-]+")
_SEVERAL = re.compile(r"[*?\[]")
_ESCAPED = re.compile(r"\[([\[*?{])\]")
"""A character that is itself where patterns are taken."""
_PLACEHOLDER = re.compile(r"\{folder\}|\{stem\}|\{name\}|\[\{\]")
_NAMED = re.compile(r"[A-Za-z0-9_]+=")
_EITHER = re.compile(r"\.(str|tuple\[[^]]*\])(?=[.:])")
"""What pydantic puts behind a key whose value may be of two kinds."""
_RATE = re.compile(r"\d{1,12}(\.\d{1,12})?(/\d{1,12})?", re.ASCII)
SEPARATORS = "_-. "
"""What may stand between a video's name and a sensor's in the name of a log."""

Paths = str | tuple[str, ...]


class HowMerged(StageConfig):
    """How a sensor is merged, as the flags of `merge` of these names say it."""

    sync: str | None = Field(None, description='the marker whose motion its clock is found from; "" for none')
    offset: str | None = Field(None, description='what to add to its times, as in "+12.5ms"')
    drift: str | None = Field(None, description='how much too slow its clock runs, as in "-20ppm"')
    mapping: str | None = Field(None, description="TOML: how to read a table of unknown layout")
    rate_hz: float | None = Field(None, gt=0, le=1e6, description="samples a second of files that do not say")

    @field_validator("offset", "drift")
    @classmethod
    def _can_be_read(cls, text: str | None, info: ValidationInfo) -> str | None:
        try:
            if text is not None:
                (parse_offset if info.field_name == "offset" else parse_drift)(text)
        except UsageError as error:
            raise ValueError(str(error)) from None
        return text


class Values(StageConfig):
    """What can be said of a session, of some, or of all; None is not said here."""

    subject: str | None = Field(None, description="whose session it is; a column of the tables")
    settings: str | None = Field(
        None, description="TOML with markers and camera (by default STEM.settings.toml beside the video)"
    )
    seeds: str | None = Field(None, description="TOML with circles and answers (by default STEM.seeds.toml)")
    auto: bool | None = Field(None, description="look for markers that nobody seeded, as `track --auto` does")
    sensors: Paths | None = Field(None, description="files and folders to merge, each as PATH or NAME=PATH")
    merge: dict[str, HowMerged] | None = Field(None, description="how sensors are merged, by their names")
    force: bool | None = Field(None, description="merge what does not overlap the video in time")
    analyse: bool | None = Field(None, description="false: no strokes are looked for")
    analysis: str | None = Field(None, description="TOML on the chair, as `analyse --settings` takes it")
    fill_ms: float | None = Field(None, ge=0, le=1000, description="gaps that the analysis stands in for")
    start_time: str | None = Field(None, description="time of the first picture: ISO 8601 or Unix seconds")
    rate: str | None = Field(None, description="pictures a second of a folder of pictures")
    topic: str | None = Field(None, description="image topic of an MCAP that has several")
    timeout_h: float | None = Field(None, gt=0, le=1000, description="hours after which it counts as hung (12)")
    memory_gb: float | None = Field(None, gt=0, le=10_000, description="memory that its process may have, GiB (any)")

    @field_validator("start_time", "rate", mode="before")
    @classmethod
    def _without_quotes(cls, value: object) -> object:
        """A time or a number as TOML has it."""
        if isinstance(value, datetime):
            return value.isoformat()
        return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value

    @field_validator("sensors")
    @classmethod
    def _paths(cls, paths: Paths | None) -> Paths | None:
        for text in () if paths is None else listed(paths):
            if not text or (_NAMED.match(text) and text.endswith("=")):
                raise ValueError("a path is empty; without sensors write sensors = []")
        return paths

    @field_validator("start_time")
    @classmethod
    def _a_time(cls, text: str | None) -> str | None:
        try:
            stamp_ns = 0 if text is None else parse_time_ns(text)
        except ValueError:
            raise ValueError('neither ISO 8601 such as "2025-06-01T10:00:00Z" nor Unix seconds') from None
        if not 0 <= stamp_ns < 1 << 63:
            raise ValueError("a recording holds times from 1970 to 2262")
        return text

    @field_validator("rate")
    @classmethod
    def _a_rate(cls, text: str | None) -> str | None:
        with suppress(ValueError, ZeroDivisionError):
            if text is None or (_RATE.fullmatch(text) and Fraction(1, 1000) <= Fraction(text) <= 1_000_000):
                return text
        raise ValueError('expected pictures a second, 0.001 to 1000000, as in "240"')


class _Row(Values):
    """A session; or, without a name, one for each video that is found."""

    name: str | None = Field(None, description="letters, digits, - _ and .; also its folder's name")
    video: Paths = Field(description="a video, its chapters in order, their list, a folder of pictures or an MCAP")

    @field_validator("name")
    @classmethod
    def _a_folder(cls, name: str | None) -> str | None:
        if name is not None and (not re.fullmatch(NAME, name) or name == SEASON):
            raise ValueError(f"expected letters, digits, - _ and ., at most 100, and not {SEASON}")
        return name

    @field_validator("video")
    @classmethod
    def _some(cls, paths: Paths) -> Paths:
        if not paths or not all(listed(paths)):
            raise ValueError("no video is named")
        return paths


class _Override(Values):
    """What holds for the sessions whose names one of the patterns matches."""

    sessions: Paths


class _Manifest(StageConfig):
    name: str = Field("", description="what the season is called in its report")
    description: str = ""
    defaults: Values = Values()
    overrides: tuple[_Override, ...] = ()
    sessions: tuple[_Row, ...] = ()


class Sensor(BaseModel):
    """A file or folder to merge: what it is called, where it is, and how."""

    model_config = ConfigDict(frozen=True)
    name: str
    path: str
    how: HowMerged = HowMerged()


class Plan(BaseModel):
    """A session as it is to be run: everything a manifest says of it, paths absolute (or addresses). As JSON it goes to
    where it is run.

    `videos` are the chapters in order; empty where the manifest's patterns match nothing, which `missing` then says, as
    it does for every other file that is named and not there. `seeds` is where answers are kept, whether it is there
    or not; of `settings` and `analysis` None is none.
    """

    model_config = ConfigDict(frozen=True)
    name: str
    subject: str = ""
    videos: tuple[str, ...]
    settings: str | None = None
    seeds: str
    auto: bool = False
    sensors: tuple[Sensor, ...] = ()
    force: bool = False
    analyse: bool = True
    analysis: str | None = None
    fill_ms: float = 0.0
    start_time: str | None = None
    rate: str | None = None
    topic: str | None = None
    timeout_h: float = 12.0
    memory_gb: float | None = None
    missing: tuple[str, ...] = ()
    seedless: str = ""
    """That it has no circles to begin with, and how to give them; "" where it has, or looks for them itself."""

    @property
    def start_time_ns(self) -> int | None:
        """Unix time of the first picture; None where the video is to say it."""
        return None if self.start_time is None else parse_time_ns(self.start_time)


class Season(BaseModel):
    """A manifest as it is read: what the season is called, and its sessions by name."""

    model_config = ConfigDict(frozen=True)
    name: str
    description: str = ""
    plans: tuple[Plan, ...]


def load_season(path: Path, *, growing: bool = False) -> Season:
    """Read a manifest and find its files. `growing`: there need be no session yet, nor one for every override. Raises
    SettingsError for one that is wrong."""
    manifest = _read(path)
    folder = path.resolve().parent
    taken: set[str] = set()  # videos that a session has, links followed
    plans: list[Plan] = []

    def plan_of(row: _Row, name: str, videos: Sequence[str], missing: Sequence[str]) -> None:
        taken.update(map(_real, videos))
        try:
            plans.append(_plan(manifest, row, name, videos, missing, folder))
        except SettingsError as error:
            raise SettingsError(f"{path}: session {name}: {error}") from error

    for row in manifest.sessions:
        if row.name is not None:
            plan_of(row, row.name, *_found(listed(row.video), folder))
    for number, row in enumerate(manifest.sessions, 1):
        if row.name is None:
            found, missing = _found(listed(row.video), folder)
            if not found:
                raise SettingsError(f"{path}: sessions {number}: no video matches {', '.join(missing)}")
            for videos, absent in _recordings(found):
                if taken.isdisjoint(map(_real, videos)):
                    name = session_name(Path(videos[0]), _beginning(row.video, videos[0], folder))
                    plan_of(row, name, videos, absent)
    if not plans and not growing:
        raise SettingsError(f"{path}: no session in it: expected [[sessions]] with name and video")
    named: dict[str, Plan] = {}
    for plan in plans:
        if (same := named.setdefault(plan.name, plan)) is not plan:
            both = f"{', '.join(same.videos)} and {', '.join(plan.videos)}"
            raise SettingsError(f"{path}: two sessions are called {plan.name}: {both}; give them names")
    for number, override in enumerate(manifest.overrides, 1):
        if not growing and not any(_meant(override, name) for name in named):
            raise SettingsError(
                f"{path}: overrides {number}: no session is called {', '.join(listed(override.sessions))}"
            )
    return Season(
        name=manifest.name or path.stem, description=manifest.description,
        plans=tuple(named[name] for name in sorted(named)),
    )  # fmt: skip


def general_of(path: Path) -> Callable[[str], dict[str, Any]]:
    """What a manifest says of a session by its name, in [defaults] and [[overrides]]. Raises SettingsError."""
    manifest = _read(path)
    return lambda name: _general(manifest, name)


def _general(manifest: "_Manifest", name: str, beside: dict[str, Any] | None = None) -> dict[str, Any]:
    """The same; `beside` is what lies beside the session's video, nearer than what holds for all."""
    said = manifest.defaults.model_dump(exclude_none=True) | (beside or {})
    for override in manifest.overrides:
        if _meant(override, name):
            said = _over(said, override.model_dump(exclude_none=True, exclude={"sessions"}))
    return said


def _read(path: Path) -> "_Manifest":
    told = read_toml(path)
    for key in ("sessions", "overrides"):
        if isinstance(told.get(key), dict):
            raise SettingsError(f"{path}: [{key}] is one table: begin each with [[{key}]], in two brackets")
    try:
        return _Manifest.model_validate(told)
    except ValidationError as error:
        said = re.sub(r"\b(sessions|overrides)\.(\d+)", lambda row: f"{row[1]} {int(row[2]) + 1}", first_problem(error))
        raise SettingsError(f"{path}: {re.sub(_EITHER, '', said)}") from error


def _recordings(videos: Sequence[str]) -> list[tuple[list[str], list[str]]]:
    """Which videos are one recording; and the names of the chapters that are missing."""
    files = recordings_of([Path(video) for video in videos if not is_address(video)])
    return [([video], []) for video in videos if is_address(video)] + [([str(v) for v in own], no) for own, no in files]


def _real(path: str) -> str:
    """What tells whether two paths are one file's."""
    return path if is_address(path) else os.path.realpath(path)


def _beginning(patterns: Paths, video: str, folder: Path) -> Path:
    """The folder that a video's session is called from: what stands in its pattern before any `*`."""
    for pattern in listed(patterns):
        parts = itertools.takewhile(lambda part: not _may_be_several(part), Path(pattern).parts[:-1])
        begin = folder.joinpath(*(_ESCAPED.sub(r"\1", part) for part in parts))
        if Path(video).is_relative_to(begin):
            return begin
    return folder


def session_name(video: Path, folder: Path) -> str:
    """What a session is called after its video, by where that is below `folder`: anna/run 1.mp4 is anna_run_1, and
    anna/session.mp4 is anna."""
    inside = video.with_suffix("")
    if inside.is_relative_to(folder):
        inside = inside.relative_to(folder)
    parts = [part for part in inside.parts if part != inside.anchor]
    if len(parts) > 1 and parts[-1] == "session":
        parts.pop()
    name = _NO_NAME.sub("_", "_".join(parts)).strip("_.-")
    return name[:100] or "session"


def _no_seeds(video: str, seeds: str, settings: str | None, beside: str) -> str:
    """That a session has no circles to begin with, and how to give them; `beside` is where `annotate` looks for
    settings by itself."""
    own = "" if settings in (None, beside) else f" --settings {shlex.quote(str(settings))}"
    return f"no seeds: there is no {seeds}: spheremcap annotate {shlex.quote(video)}{own}, or auto = true"


def _plan(
    manifest: _Manifest, row: _Row, name: str, videos: Sequence[str], missing: Sequence[str], folder: Path
) -> Plan:  # fmt: skip
    video = videos[0] if videos else str(folder / name)
    place = Place(folder, video, name)
    beside = place.beside("settings")
    said = _general(manifest, name, {"settings": beside.replace("{", "[{]")} if os.path.isfile(beside) else {})
    said = _over(said, row.model_dump(exclude_none=True, exclude={"name", "video"}))
    gone = [f"no video: nothing matches {pattern}" for pattern in missing]  # a chapter, too
    for key in ("settings", "analysis"):
        if key in said:
            said[key] = place.file(key, said[key])
            gone += _gone(key, said[key])
    said["seeds"] = place.file("seeds", said["seeds"]) if "seeds" in said else place.beside("seeds")
    if not said.get("auto") and not os.path.isfile(said["seeds"]):
        said["seedless"] = _no_seeds(video, said["seeds"], said.get("settings"), place.beside("settings"))
    how = {key: HowMerged.model_validate(one) for key, one in said.pop("merge", {}).items()}
    sensors, unmatched = sensors_in(listed(said.pop("sensors", ())), place)
    gone += [f"no sensor: nothing matches {pattern}" for pattern in unmatched]
    strange = set(row.merge or ()) - {sensor.name for sensor in sensors}
    gone += [f"no sensor is called {one}, of which merge.{one} speaks" for one in sorted(strange)]
    merged = []
    for sensor in sensors:
        own = how.get(sensor.name, HowMerged())
        if own.mapping is not None:
            own = own.model_copy(update={"mapping": place.file("mapping", own.mapping)})
            gone += _gone("mapping", str(own.mapping))
        merged.append(sensor.model_copy(update={"how": own}))
    return Plan(name=name, videos=tuple(videos), sensors=tuple(merged), missing=tuple(gone), **said)


class Place:
    """Where a session's paths start, and what their placeholders stand for."""

    def __init__(self, folder: Path, video: str, name: str) -> None:
        self._folder, self._name = folder, name
        inside = PurePosixPath(video) if is_address(video) else Path(video)
        self._stem = inside.stem if inside.suffix else inside.name
        self._around = video.rpartition("/")[0] if is_address(video) else str(inside.parent)
        self._names = {"{folder}": self._around, "{stem}": self._stem, "{name}": name}

    def path(self, text: str) -> str:
        """Absolute; an address stays. A brace is written [{] where it begins no placeholder."""
        text = _PLACEHOLDER.sub(lambda found: self._names.get(found[0], "{"), text)
        return text if is_address(text) else str(self._folder / text)

    def file(self, key: str, text: str) -> str:
        """The path of what is written by hand. Raises SettingsError for an address: answers are kept in files."""
        path = self.path(text)
        if is_address(path):
            raise SettingsError(f"{key} {path}: is an address: only videos and sensors' logs may lie behind one")
        return path

    def pattern(self, text: str) -> str:
        """The same for what may match several files: only what was written is a pattern, no file's own name."""
        if is_address(text) or is_address(self._around):
            return self.path(text)
        text = _PLACEHOLDER.sub(lambda found: glob.escape(self._names.get(found[0], found[0])), text)
        return str(Path(glob.escape(str(self._folder))) / text)

    def beside(self, kind: str) -> str:
        """Where seeds or settings are looked for: beside the video; the manifest, where that is behind an address."""
        if is_address(self._around):
            return str(self._folder / f"{self._name}.{kind}.toml")
        return f"{self._around}/{self._stem}.{kind}.toml"


def sensors_in(texts: Sequence[str], place: Place) -> tuple[list[Sensor], list[str]]:
    """What is merged, and the patterns that match nothing. Without a name of its own a sensor is called as its file,
    less the video's name that it may begin with, and with a number behind it where another has that name."""
    found: list[Sensor] = []
    unmatched = []
    for text in texts:
        name, equals, path = text.partition("=")
        named = bool(equals) and _NAMED.match(text) is not None
        written = path if named else text
        there = _there(place.path(written), place.pattern(written))
        if not there and not _may_be_several(written):
            unmatched.append(place.path(written))
        if named and len(there) > 1:
            raise SettingsError(f"sensor {text!r}: {len(there)} files match, and all would be called {name}")
        for one in there:
            if one in (other.path for other in found):
                continue
            names = {other.name for other in found}
            if named and name in names:
                raise SettingsError(f"sensor {text!r}: another one is called {name} already")
            found.append(Sensor(name=name if named else free(sensor_name(one, place._stem), names), path=one))
    return found, unmatched


def free(wanted: str, taken: set[str]) -> str:
    """The name, or with a number behind it where it is taken; case does not count."""
    folded = {other.casefold() for other in taken}
    numbered = (wanted if n == 1 else f"{wanted[:90]}_{n}" for n in itertools.count(1))
    return next(name for name in numbered if name.casefold() not in folded)


def sensor_name(path: str, stem: str) -> str:
    """What a sensor's file is called: run1_wheel.csv beside run1.mp4 is wheel."""
    own = PurePosixPath(path).stem
    rest = own.removeprefix(stem)
    short = rest.strip(SEPARATORS) if rest[:1] in tuple(SEPARATORS) else ""
    return _NO_NAME.sub("_", short or own).replace(".", "_").replace("-", "_")


def _found(patterns: Sequence[str], folder: Path) -> tuple[list[str], list[str]]:
    """What patterns match, each one's files by name, and the patterns that match nothing."""
    found: dict[str, None] = {}
    missing = []
    for pattern in patterns:
        whole = pattern if is_address(pattern) else str(Path(glob.escape(str(folder))) / pattern)
        there = _there(str(folder / pattern), whole)
        if not there:
            missing.append(pattern)
        found |= dict.fromkeys(there)
    return list(found), missing


def _there(path: str, pattern: str) -> list[str]:
    """The file of that very name, where there is one; else what the pattern matches. An address stands for itself."""
    if is_address(pattern):
        return [pattern]
    return [path] if os.path.lexists(path) else sorted(glob.glob(pattern, recursive=True))


def _may_be_several(written: str) -> bool:
    return _SEVERAL.search(_ESCAPED.sub("", written)) is not None


def listed(paths: Paths) -> tuple[str, ...]:
    return (paths,) if isinstance(paths, str) else tuple(paths)


def _gone(what: str, path: str) -> list[str]:
    return [] if os.path.isfile(path) else [f"no {what}: there is no {path}"]


def _meant(override: _Override, name: str) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in listed(override.sessions))


def _over(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """What is said further below, and above it what counts more; tables key by key."""
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        merged[key] = _over(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged
