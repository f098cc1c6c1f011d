"""The manifest that `dataset init` proposes: what was found, in words that a person reads and changes."""

import glob
from collections.abc import Mapping
from pathlib import Path

from spheremcap.errors import printable
from spheremcap.season.finding import Finding, Found, FoundSensor, quoted, real_path, times, when, written
from spheremcap.season.manifest import sensor_name

_PREFACE = """\
# Edit this file as you like. A line that begins with # and no blank behind it is an example: take the # away.
#
# What [defaults] say holds for all sessions, what [[overrides]] say for those whose names match (the last one counts),
# and what a session says itself counts most. Paths start at this file's folder. They may have *, ? and ** where several
# files are meant, and {folder}, {stem} and {name}: the folder of the session's video, the video's name without its
# ending, and the session's name. {stem}.settings.toml and {stem}.seeds.toml beside the video need not be named; such
# settings count more than those of [defaults].
"""


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
        lines += _comments(*found.leftovers)
    if found.notes:
        lines += ["", *_comments(*found.notes)]
    return "\n".join(lines) + "\n"


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
