"""The manifest that `dataset init` proposes: what was found, in words that a person reads and changes; and what it
adds to one that somebody has changed already."""

import glob
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from spheremcap.errors import SettingsError, printable
from spheremcap.io.toml_file import read_toml, toml_text
from spheremcap.season.addresses import is_address
from spheremcap.season.finding import Finding, Found, FoundSensor, free, quoted, real_path, times, when, written
from spheremcap.season.manifest import Season, sensor_name

_PREFACE = """\
# Edit this file as you like. A line that begins with # and no blank behind it is an example: take the # away.
#
# What [defaults] say holds for all sessions, what [[overrides]] say for those whose names match (the last one counts),
# and what a session says itself counts most. Paths start at this file's folder. They may have *, ? and ** where several
# files are meant, and {folder}, {stem} and {name}: the folder of the session's video, the video's name without its
# ending, and the session's name. {stem}.settings.toml and {stem}.seeds.toml beside the video need not be named; such
# settings count more than those of [defaults].
"""

_ANSWERS = {
    "settings": ("settings", "camera"), "auto": ("seeds",), "rate": ("rate",), "topic": ("topic",),
    "start_time": ("start time",),
}  # fmt: skip
"""Keys of a manifest, and what is not missing any more where they are said."""


def manifest_text(found: Finding, folder: Path, manifest: Path, season_name: str = "") -> str:
    """A manifest of what was found in `folder`, to be written as `manifest`; `load_season` reads it back. The season is
    called as the file where it has no name.

    A comment above each session says what it lacks, one at the end what belongs to none.
    """
    root, base = real_path(folder), real_path(manifest).parent
    shared = {kind: path for kind in ("settings", "analysis") if (path := _shared(found, kind, root)) is not None}
    lines = [
        *_comments(f"The sessions that were found in {written(root, base)}."),
        *_PREFACE.splitlines(),
        f"name = {quoted(season_name or manifest.stem)}",
        "",
        "[defaults]",
        *(f"{kind} = {quoted(written(path, base))}" for kind, path in shared.items()),
        *(f'#{kind} = "{kind}.toml"' for kind in ("settings", "analysis") if kind not in shared),
        "#auto = true  # look for markers that nobody seeded",
        '#merge.imu.sync = "left_wrist"  # find the clock of the sensor that is called imu',
        '#merge.wheel.offset = "+2h"',
        "",
        *_examples(found, root, base),
    ]
    for session in found.sessions:
        lines += ["", *_session_lines(session, base, shared)]
    if found.leftovers:
        lines += ["", *_comments("In no session:")]
        lines += _comments(*(left.line for left in found.leftovers))
    if found.notes:
        lines += ["", *_comments(*found.notes)]
    return "\n".join(lines) + "\n"


def not_yet_in(manifest: Path, season: Season, found: Finding) -> Finding:
    """What was found and is in no session of a manifest: sessions by names that are free in it, without what its
    [defaults] say for them, and left-over files that no session of it merges. A chapter that came to a recording later
    is one of the notes."""
    owner = {_real(video): plan.name for plan in season.plans for video in plan.videos}
    merged = {_real(sensor.path) for plan in season.plans for sensor in plan.sensors}
    names = {plan.name for plan in season.plans}
    said = read_toml(manifest).get("defaults", {})
    new, notes = [], list(found.notes)
    for session in found.sessions:
        if known := [owner[video] for path in session.videos if (video := real_path(path)) in owner]:
            more = [path.name for path in session.videos if real_path(path) not in owner]
            notes += [f"{known[0]}: of its recording is {', '.join(more)}, too: add to its video"] if more else []
        else:
            names.add(name := free(session.name, names))
            new.append(replace(_with(said, session), name=name))
    leftovers = tuple(left for left in found.leftovers if real_path(left.path) not in merged)
    return Finding(tuple(new), leftovers, tuple(notes))


def _with(said: Mapping[str, Any], session: Found) -> Found:
    """A session that does not lack what `[defaults]` say."""
    mapped = {name for name, how in said.get("merge", {}).items() if "mapping" in how}
    answered = {word for key, words in _ANSWERS.items() if said.get(key) for word in words}
    answered |= {f"sensor {name}" for name in mapped}
    missing = tuple(line for line in session.missing if line.partition(":")[0] not in answered)
    return replace(session, unread=session.unread - mapped, missing=missing)


def added_text(found: Finding, manifest: Path) -> str:
    """The text of a manifest, as it stands, with what was found as sessions at its end. Raises SettingsError where it
    has none that others can be put behind."""
    base = real_path(manifest).parent
    said = read_toml(manifest).get("defaults", {})
    shared = {kind: base / said[kind] for kind in ("settings", "analysis") if kind in said}
    text = toml_text(manifest)
    end = "\r\n" if "\r\n" in text else "\n"
    lines = [line for session in found.sessions for line in ("", *_session_lines(session, base, shared))]
    whole = text + end * (not text.endswith("\n")) + "".join(line + end for line in lines)
    try:
        tomllib.loads(whole)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(
            f"{manifest}: nothing can be added to it ({error}): begin each session with [[sessions]]"
        ) from error
    return whole


def _real(path: str) -> Path | None:
    return None if is_address(path) else real_path(Path(path))


def _shared(found: Finding, kind: str, root: Path) -> Path | None:
    """A settings or analysis file that [defaults] name: the folder's own."""
    path = root / f"{kind}.toml"
    return path if any(getattr(session, kind) == path for session in found.sessions) else None


def _examples(found: Finding, root: Path, base: Path) -> list[str]:
    """What could be said of several sessions, and sessions that are found by a pattern."""
    first = found.sessions[0]
    ending = first.videos[0].suffix if first.videos[0].is_file() else ""
    return [
        "#[[overrides]]",
        f"#sessions = {quoted(first.name)}  # or a list, and with * and ?",
        '#subject = "anna"',
        "",
        *_comments("Without a name: a session for each video that is in none with a name."),
        "#[[sessions]]",
        f"#video = {quoted(_pattern(written(root, base)) + '/**/*' + ending)}",
        '#sensors = "{folder}/{stem}_*.csv"',
    ]


def _session_lines(session: Found, base: Path, shared: Mapping[str, Path]) -> list[str]:
    video = session.videos[0]
    told = [
        "" if session.size is None else times(session.size),
        "" if session.rate is None else f"{float(session.rate):.6g} pictures a second",
        "" if session.duration_s is None else f"{session.duration_s:.1f} s",
        "" if session.start_ns is None else f"from {when(session.start_ns)}",
    ]
    lines = _comments(*([line] if (line := ", ".join(filter(None, told))) else []))
    lines += _comments(*(f"missing: {line}" for line in session.missing), *session.notes)
    paths = [quoted(_pattern(written(path, base))) for path in session.videos]
    lines += ["[[sessions]]", f"name = {quoted(session.name)}"]
    lines += [f"video = {paths[0]}"] if len(paths) == 1 else ["video = [", *(f"    {path}," for path in paths), "]"]
    for kind in ("settings", "seeds", "analysis"):
        path = getattr(session, kind)
        beside = video.parent / f"{video.stem}.{kind}.toml"
        by_default = beside if kind != "analysis" and path == beside else shared.get(kind)
        if path is not None and path != by_default:
            lines.append(f"{kind} = {quoted(written(path, base))}")
    sensors = [(_sensor_text(sensor, video.stem, base), sensor) for sensor in session.sensors]
    if len(session.unread) < len(sensors):
        rows = (f"    {'#' * (s.name in session.unread)}{text},  # {s.name}, {s.why}" for text, s in sensors)
        lines += ["sensors = [", *rows, "]"]
    elif sensors:
        lines.append(f"#sensors = [{', '.join(text for text, _ in sensors)}]")
    return lines + [f"#merge.{name}.offset = {quoted(offset)}" for name, offset in session.offsets.items()]


def _sensor_text(sensor: FoundSensor, stem: str, base: Path) -> str:
    """PATH, or NAME=PATH where the manifest's reader would give it another name."""
    path = _pattern(written(sensor.path, base)).replace("{", "[{]")
    told = "=" not in path and sensor.name == sensor_name(sensor.path.as_posix(), stem)
    return quoted(path if told else f"{sensor.name}={path}")


def _pattern(path: str) -> str:
    """A path where patterns are taken: one that matches nothing else."""
    return glob.escape(path)


def _comments(*lines: str) -> list[str]:
    return [f"# {printable(line)}".rstrip() for line in lines]
