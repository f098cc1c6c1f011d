"""The manifest that `dataset init` proposes: what was found, in words that a person reads and changes; and what it
adds to one that somebody has changed already."""

import glob
import os
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from spheremcap.errors import SettingsError, SourceError, printable
from spheremcap.io.chapter_list import chapters_in, is_list
from spheremcap.io.toml_file import toml_text
from spheremcap.season.addresses import is_address
from spheremcap.season.finding import Finding, Found, FoundSensor, quoted, real_path, times, when, written
from spheremcap.season.manifest import Place, Season, free, general_of, listed, sensor_name, sensors_in

_PREFACE = """\
# Edit this file as you like. A line that begins with # and no blank behind it is an example: take the # away.
#
# What [defaults] say holds for all sessions, what [[overrides]] say for those whose names match (the last one counts),
# and what a session says itself counts most. Paths start at this file's folder. Those of videos and sensors may have
# *, ? and ** where several files are meant; all but the video's {folder}, {stem} and {name}: the folder of the video,
# its name without its ending, and the session's name. {stem}.settings.toml and {stem}.seeds.toml beside the video need
# not be named; such settings count more than those of [defaults].
"""

_ANSWERS = {
    "settings": ("settings", "camera"), "auto": ("seeds",), "seeds": ("seeds",), "rate": ("rate",), "topic": ("topic",),
    "start_time": ("start time",),
}  # fmt: skip
"""Keys of a manifest, and what is not missing any more where they are said."""
_BOM = b"\xef\xbb\xbf"


def manifest_text(found: Finding, folder: Path, manifest: Path, season_name: str = "") -> str:
    """A manifest of what was found in `folder`, to be written as `manifest`; `load_season` reads it back. The season is
    called as the file where it has no name.

    A comment above each session says what it lacks, one at the end what belongs to none.
    """
    root, base = real_path(folder), real_path(manifest).parent
    shared = {kind: path for kind in ("settings", "analysis") if (path := _shared(found, kind, root)) is not None}
    said = {kind: written(path, base) for kind, path in shared.items()}
    lines = [
        *_comments(f"The sessions that were found in {written(root, base)}."),
        *_PREFACE.splitlines(),
        f"name = {quoted(season_name or manifest.stem)}",
        "",
        "[defaults]",
        *(f"{kind} = {quoted(path)}" for kind, path in said.items()),
        *(f'#{kind} = "{kind}.toml"' for kind in ("settings", "analysis") if kind not in said),
        "#auto = true  # look for markers that nobody seeded",
        '#merge.imu.sync = "left_wrist"  # find the clock of the sensor that is called imu',
        '#merge.wheel.offset = "+2h"',
        "",
        *_examples(found, root, base),
    ]
    for session in found.sessions:
        lines += ["", *_session_lines(session, base, root, said)]
    if found.leftovers:
        lines += ["", *_comments("In no session:")]
        lines += _comments(*(left.line for left in found.leftovers))
    if found.notes:
        lines += ["", *_comments(*found.notes)]
    return "\n".join(lines) + "\n"


def not_yet_in(manifest: Path, season: Season, found: Finding, folder: Path) -> Finding:
    """What was found in `folder` and is in no session of a manifest: sessions by names that are free in it, without
    what its [defaults] and [[overrides]] say for them, and left-over files that no session of it merges. A chapter or a
    log that came to a session later is one of the notes."""
    base = real_path(manifest).parent
    general = general_of(manifest)
    owner = {real: plan.name for plan in season.plans for video in plan.videos for real in _files(video)}
    merged = {real for plan in season.plans for sensor in plan.sensors for real in _files(sensor.path)}
    names = {plan.name for plan in season.plans}
    new, notes = [], list(found.notes)
    for session in found.sessions:
        if known := [owner[video] for path in session.videos if (video := real_path(path)) in owner]:
            if {real_path(path) for path in session.videos} - owner.keys():
                order = ", ".join(quoted(written(path, base)) for path in session.videos)
                notes.append(f"{known[0]}: its recording has more chapters now: video = [{order}]")
            elif len(set(known)) > 1:
                notes.append(f"{', '.join(sorted(set(known)))}: chapters of one recording, but sessions of their own")
            more = [written(s.path, base) for s in session.sensors if real_path(s.path) not in merged]
            notes += [f"{known[0]}: not in its sensors: {', '.join(more)}"] if more else []
        else:
            names.add(name := free(session.name, names))
            others = merged - set(_general_logs(general(name), Place(base, str(session.videos[0]), name)))
            own = tuple(sensor for sensor in session.sensors if real_path(sensor.path) not in others)
            told = [f"{written(s.path, base)} is another session's already" for s in session.sensors if s not in own]
            alone = replace(session, name=name, sensors=own, notes=(*session.notes, *told))
            new.append(_with(general(name), alone, base, real_path(folder)))
    leftovers = tuple(left for left in found.leftovers if real_path(left.path) not in merged)
    return Finding(tuple(new), leftovers, tuple(notes))


def _with(said: Mapping[str, Any], session: Found, base: Path, root: Path) -> Found:
    """A session that does not lack what a manifest says in general."""
    place = Place(base, str(session.videos[0]), session.name)
    answers = {key for key in _ANSWERS if said.get(key)}
    if session.settings is not None and session.settings != root / "settings.toml":
        answers.discard("settings")  # its own count
    if "seeds" in answers and not os.path.isfile(place.path(said["seeds"])):
        answers.discard("seeds")
    mapped = {name for name, how in said.get("merge", {}).items() if "mapping" in how}
    answered = {word for key in answers for word in _ANSWERS[key]} | {f"sensor {name}" for name in mapped}
    missing = tuple(line for line in session.missing if line.partition(":")[0] not in answered)
    return replace(session, unread=session.unread - mapped, missing=missing)


def added_text(found: Finding, manifest: Path, folder: Path) -> str:
    """The text of a manifest, as it stands, with what was found in `folder` as sessions at its end. Raises
    SettingsError where it has none that others can be put behind."""
    base, root = real_path(manifest).parent, real_path(folder)
    general = general_of(manifest)
    text = toml_text(manifest)
    end = "\r\n" if "\r\n" in text else "\n"
    lines = [
        line for session in found.sessions for line in ("", *_session_lines(session, base, root, general(session.name)))
    ]
    whole = text + end * (not text.endswith("\n")) + "".join(line + end for line in lines)
    try:
        tomllib.loads(whole)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(
            f"{manifest}: nothing can be added to it ({error}): begin each session with [[sessions]]"
        ) from error
    return "\ufeff" * manifest.read_bytes().startswith(_BOM) + whole


def _general_logs(said: Mapping[str, Any], place: Place) -> list[Path]:
    """The logs of a session that are merged without its naming them, links followed."""
    return [real_path(Path(sensor.path)) for sensor in sensors_in(listed(said.get("sensors", ())), place)[0]]


def _files(path: str) -> list[Path]:
    """The files that a manifest means with a path, links followed: a list's chapters, and file:// as what it is."""
    if is_address(path) and not path.startswith("file://"):
        return []
    whole = Path(path.removeprefix("file://"))
    try:
        return [real_path(file) for file in (chapters_in(whole) if is_list(whole) else [whole])]
    except SourceError:  # which its run will say
        return [real_path(whole)]


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


def _session_lines(session: Found, base: Path, root: Path, said: Mapping[str, Any]) -> list[str]:
    """A session's row, with what the manifest does not say of it in general."""
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
    place = Place(base, str(video), session.name)
    for kind in ("settings", "seeds", "analysis"):
        path = getattr(session, kind)
        if path is not None and not _goes_without(kind, path, place, root, said):
            lines.append(f"{kind} = {quoted(written(path, base).replace('{', '[{]'))}")
    return lines + _sensor_lines(session, base, place, said)


def _goes_without(kind: str, path: Path, place: Place, root: Path, said: Mapping[str, Any]) -> bool:
    """Whether a session has a file without naming it, or what is said in general counts more."""
    general = real_path(Path(place.path(said[kind]))) if kind in said else None
    beside = kind != "analysis" and path == Path(place.beside(kind))
    if kind == "seeds" and general is not None:
        return path == general or general.is_file()
    return beside or path == general or (general is not None and path == root / f"{kind}.toml")


def _sensor_lines(session: Found, base: Path, place: Place, said: Mapping[str, Any]) -> list[str]:
    sensors = [(_sensor_text(sensor, session.videos[0].stem, base), sensor) for sensor in session.sensors]
    general = _general_logs(said, place)
    lines = []
    if general and {sensor.path for sensor in session.sensors} <= set(general):
        pass  # all of it is said already
    elif len(session.unread) < len(sensors):
        own = {sensor.path for sensor in session.sensors}
        rows = [f"    {'#' * (s.name in session.unread)}{text},  # {s.name}, {s.why}" for text, s in sensors]
        rows += [f"    {quoted(_pattern(written(path, base)))}," for path in general if path not in own]
        lines = ["sensors = [", *rows, "]"]
    elif sensors:
        lines = [f"#sensors = [{', '.join(text for text, _ in sensors)}]"]
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
