"""The sessions in a folder: which videos there are, what belongs to each, and the manifest that says so.

Videos are found by their endings, and what belongs to one by its name, else by where it lies, else by its times.
Nothing is decoded, and of a sensor's table the head alone is read where that will do. What cannot be read or told is
named with what to do about it; it is never left out without a word.
"""

import os
import re
import shlex
import unicodedata
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import tomli_w

from spheremcap.config import Settings, load_settings
from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.errors import SettingsError, SourceError, SpheremcapError, UsageError
from spheremcap.io.chapter_list import recordings_of
from spheremcap.io.folder import PICTURE_ENDINGS, PictureFolder
from spheremcap.io.mcap_images import calibration_topics, image_topics
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import STATE, schema_names
from spheremcap.merging.clock import format_offset
from spheremcap.merging.mapping import UnreadTableError
from spheremcap.merging.sensors import TABLE_ENDINGS, read_sensors
from spheremcap.merging.tables import open_table
from spheremcap.merging.times import YEAR_2000_NS
from spheremcap.season.heads import Facts, head_of, is_ours, is_output, span_of, video_facts
from spheremcap.season.manifest import NAME, SEPARATORS, free, sensor_name, session_name
from spheremcap.season.outcome import TABLES

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".mts", ".m2ts", ".mpg", ".mpeg", ".wmv", ".webm", ".3gp")
_DEVICE = ("sensors", "inertial")
"""A folder with a table of this name (x-io's) is one device's, and merged as one."""
_MARKED = re.compile(r"(.*[._ -])?marked", re.IGNORECASE)
_NO_TABLE = "no row of numbers"
_APART_S = 2
"""Creation times are whole seconds: chapters that are farther off by them do not follow one another."""
_QUARTER_NS = 900 * NS_PER_S
_ZONES = [quarters * _QUARTER_NS for quarters in range(-56, 57) if quarters]
"""What a clock that has local time for UTC may be off by: up to 14 h."""

Why = Literal["by name", "only one here", "by time"]
Kind = Literal["settings", "seeds", "analysis"]


class FoundSensor(NamedTuple):
    """A sensor's file or folder, what it is called, and why it is taken for this video's."""

    name: str
    path: Path
    why: Why


@dataclass(frozen=True)
class Found:
    """A session: its video, a folder of pictures, an MCAP, or a camera's chapters in order; and what belongs to it.

    `start_ns` (Unix time), `duration_s`, `size` (width and height as stored, px) and `rate` (pictures a second) are the
    video's own words, None where it has none. `unread` are the sensors that cannot be merged as they are, `offsets`
    what to add to a sensor's times so that they lie on the video's, where that is a guess. `missing` says what the
    session lacks and how to get it, `notes` what else is odd, a line each.
    """

    name: str
    videos: tuple[Path, ...]
    sensors: tuple[FoundSensor, ...] = ()
    settings: Path | None = None
    seeds: Path | None = None
    analysis: Path | None = None
    start_ns: int | None = None
    duration_s: float | None = None
    size: tuple[int, int] | None = None
    rate: Fraction | None = None
    unread: frozenset[str] = frozenset()
    offsets: Mapping[str, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class Left(NamedTuple):
    """A file that is in no session; `line` names it and says why."""

    path: Path
    line: str


@dataclass(frozen=True)
class Finding:
    """What a folder has: its sessions by name, what is in none of them by path, and what else is odd, a line each."""

    sessions: tuple[Found, ...]
    leftovers: tuple[Left, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[Path, ...]:
        """What belongs to a session or is left over; no folder."""
        own = [
            path
            for one in self.sessions
            for path in (*one.videos, *(s.path for s in one.sensors), one.settings, one.seeds, one.analysis)
        ]
        return tuple(path for path in (*own, *(left.path for left in self.leftovers)) if path and path.is_file())


def find_sessions(
    folder: Path, manifest: Path, progress: Callable[[int, int | None], None] = lambda done, total: None
) -> Finding:
    """The sessions in a folder and in those in it; what is said of files names them as `manifest` (which need not be
    there) would. `progress` gets how many videos and logs were looked at, and of how many.

    Raises SourceError where the folder is none, or has no session.
    """
    if not folder.is_dir():
        found = "is a file, not a folder" if folder.exists() else "no such folder"
        raise SourceError(f"{folder}: {found}; name the folder that the videos are in")
    search = _Search(real_path(folder), real_path(manifest).parent)
    for path in (search.root, search.base):
        try:
            str(path).encode()
        except UnicodeEncodeError:
            raise SourceError(f"{path}: its name is no UTF-8 text, which a manifest is: rename the folder") from None
    search.walk()
    total = len(search.drafts) + len(search.tables)
    for done, draft in enumerate(search.drafts):
        progress(done, total)
        search.look_into(draft)
    search.drafts = [draft for draft in search.drafts if not draft.none]
    if not search.drafts:
        passed = "".join(f"; {line}" for line in search.notes[:3])
        raise SourceError(
            f"{folder}: no session in it: expected videos ({', '.join(VIDEOS)}), MCAPs with pictures that are no "
            f"recordings of ours, or folders of numbered pictures{passed}"
        )
    search.index()
    for draft in search.drafts:
        search.find_beside(draft)
    waiting = []
    for done, path in enumerate(search.tables, total - len(search.tables)):
        progress(done, total)
        if not search.belongs(path):
            waiting.append(path)
    search.by_time(waiting)
    progress(total, total)
    return search.finding()


@dataclass
class _Draft:
    """A session while it is looked for. `home` is the folder that what belongs to it may lie in."""

    videos: list[Path]
    home: Path
    kind: Literal["video", "pictures", "mcap"]
    chapters_missing: list[str] = field(default_factory=list)
    none: bool = False
    """It turned out to be no session."""
    facts: Facts = field(default_factory=Facts)
    beside: dict[Kind, Path] = field(default_factory=dict)
    sensors: list[FoundSensor] = field(default_factory=list)
    unread: set[str] = field(default_factory=set)
    offsets: dict[str, str] = field(default_factory=dict)
    absolute: list[str] = field(default_factory=list)
    """Sensors whose times count from 1970."""
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def stem(self) -> str:
        """Its first video's name without the ending, as the manifest has it."""
        return self.videos[0].stem


class _Search:
    """What was found below `root` so far; a manifest in `base` would name it."""

    def __init__(self, root: Path, base: Path) -> None:
        self.root, self.base = root, base
        self.drafts: list[_Draft] = []
        self.tables: list[Path] = []
        """Files that merging could read, and folders of devices."""
        self.leftovers: list[Left] = []
        self._recordings = 0  # of ours
        self.notes: list[str] = []
        self._settings = cache(_settings)
        self._here: dict[Path, list[_Draft]] = defaultdict(list)
        self._below: dict[Path, list[_Draft]] = defaultdict(list)
        self._stems: dict[Path, dict[str, list[_Draft]]] = defaultdict(lambda: defaultdict(list))

    def shown(self, path: Path) -> str:
        """A path as the manifest has it."""
        return written(path, self.base)

    def _leave(self, path: Path, why: str) -> None:
        """A file that is in no session."""
        place = f"{self.shown(path)}: "
        self.leftovers.append(Left(path, place + why.removeprefix(place)))

    # --- what there is ---

    def walk(self) -> None:
        """Go through all folders, each once: those that only links lead to last, and none that the root lies in."""
        ahead, linked = deque([self.root]), deque[Path]()
        been: set[Path] = set()
        while ahead or linked:
            folder = (ahead or linked).popleft()
            if (real := real_path(folder)) in been:
                continue
            been.add(real)
            try:
                with os.scandir(folder) as entries:
                    visible = [entry for entry in entries if entry.name[:1] != "."]
                listed = sorted((entry.name, os.path.isdir(entry), entry.is_symlink()) for entry in visible)
            except OSError as error:
                self.notes.append(f"{self.shown(folder)}: cannot be opened: {error.strerror}")
                continue
            readable = [(folder / name, is_dir, link) for name, is_dir, link in listed if self._is_text(folder, name)]
            folders = [(path, link) for path, is_dir, link in readable if is_dir]
            outputs = {path for path, _ in folders if is_output(path)}
            if outputs:
                self.notes.append(f"{self.shown(folder)}: results of sessions in it are left out: {len(outputs)}")
            for path, link in folders:
                if path in outputs or (outputs and path.name == TABLES):
                    continue
                if not link:
                    ahead.append(path)
                elif not self.root.is_relative_to(real_path(path)):
                    linked.append(path)
            self._take(folder, [path for path, is_dir, _ in readable if not is_dir], bool(outputs))
        devices = {path for path in self.tables if os.path.isdir(path)}
        self.tables = [path for path in self.tables if devices.isdisjoint(path.parents)]

    def _is_text(self, folder: Path, name: str) -> bool:
        """Whether a name can be written into a manifest; it is left over if not."""
        try:
            name.encode()
        except UnicodeEncodeError:
            self._leave(folder / name, "its name is no UTF-8 text, which a manifest is: rename it")
            return False
        return True

    def _take(self, folder: Path, files: Sequence[Path], results: bool) -> None:
        """The videos and tables of one folder; `results`: those of sessions are in it."""

        def ending(endings: Sequence[str]) -> list[Path]:
            return [path for path in files if path.suffix.lower() in endings]

        videos = [path for path in ending(VIDEOS) if self._is_new(path)]
        for group, absent in recordings_of(videos):
            self.drafts.append(_Draft(group, folder, "video", absent))
        self.drafts += [_Draft([path], folder, "mcap") for path in ending([".mcap"])]
        pictures = ending(PICTURE_ENDINGS)
        if len(pictures) > 1 and not videos:
            home = folder.parent if folder != self.root else folder
            self.drafts.append(_Draft([folder], home, "pictures"))
        elif len(pictures) > 1:
            self.notes.append(f"{self.shown(folder)}: {len(pictures)} pictures beside videos are taken for no session")
        tables = [] if results and not videos and not ending([".mcap"]) else ending(TABLE_ENDINGS)
        tables = [path for path in tables if not is_ours(path) and not self._is_link(path, TABLE_ENDINGS)]
        if folder != self.root and not videos and any(path.stem.lower() in _DEVICE for path in tables):
            tables = [folder]
        self.tables += tables

    def _is_new(self, video: Path) -> bool:
        """Whether a video is to be tracked: it is none of ours, and no other name of one that is there already."""
        if _MARKED.fullmatch(video.stem):
            self._leave(video, "by its name a rendered video of ours")
            return False
        return not self._is_link(video, VIDEOS)

    def _is_link(self, path: Path, endings: Sequence[str]) -> bool:
        """Whether it is another name of a file that is found by its own; then it is left over."""
        if not os.path.islink(path):
            return False
        real = real_path(path)
        inside = real.relative_to(self.root).parts if real.is_relative_to(self.root) else (".",)
        hidden = any(part.startswith(".") for part in inside) or real.suffix.lower() not in endings
        if hidden or not os.path.exists(real) or _MARKED.fullmatch(real.stem):
            return False
        self._leave(path, f"is a link to {self.shown(real)}")
        return True

    # --- what a video says of itself ---

    def look_into(self, draft: _Draft) -> None:
        """Size, rate, start and duration, without its pictures."""
        try:
            if draft.kind == "video":
                self._look_into_videos(draft)
            elif draft.kind == "pictures":
                self._look_into_pictures(draft)
            else:
                self._look_into_recording(draft)
        except SourceError as error:
            if draft.kind == "mcap":
                draft.none = True
                self._leave(draft.videos[0], self._plain(error))
            else:
                draft.missing.append(f"video: {self._plain(error)}")

    def _look_into_videos(self, draft: _Draft) -> None:
        if draft.chapters_missing:
            draft.notes.append(f"chapters that are not here: {', '.join(draft.chapters_missing)}")
        seen: list[tuple[Path, Facts]] = []
        for video in draft.videos:
            try:
                seen.append((video, video_facts(video)))
            except SourceError as error:
                draft.missing.append(f"video: {self._plain(error)}")
        if len(seen) < len(draft.videos):
            return
        _, draft.facts = seen[0]
        start_ns, after_s = draft.facts.start_ns, 0.0
        for video, facts in seen:
            if facts.size != draft.facts.size:
                draft.notes.append(f"{video.name} is {times(facts.size)}, the first chapter {times(draft.facts.size)}")
            if start_ns is not None and facts.start_ns is not None and facts.start_ns != start_ns:
                late_s = (facts.start_ns - start_ns) / NS_PER_S - after_s
                if abs(late_s) > _APART_S:
                    draft.notes.append(
                        f"by its creation time {video.name} comes {abs(late_s):.0f} s "
                        f"{'later' if late_s > 0 else 'earlier'} than it follows the chapters before it: "
                        "is it of another recording?"
                    )
            if facts.duration_s is None:
                draft.facts = replace(draft.facts, duration_s=None)
                return
            after_s += facts.duration_s
        draft.facts = replace(draft.facts, duration_s=after_s)

    def _look_into_pictures(self, draft: _Draft) -> None:
        folder = draft.videos[0]
        try:
            with PictureFolder(folder, Fraction(1)) as pictures:
                draft.facts = Facts(size=(pictures.width_px, pictures.height_px))
                draft.notes += pictures.notes
        except UsageError as error:
            draft.none = True
            self.notes.append(f"{self._plain(error)}; no session is made of it")
        draft.missing.append('rate: how many pictures a second, as in rate = "240"')

    def _look_into_recording(self, draft: _Draft) -> None:
        path = draft.videos[0]
        with McapRecords(path) as records:
            topics = image_topics(records)
            ours = STATE in schema_names(records).values()
            draft.none = ours or not topics
            if ours:
                self._recordings += 1
            elif not topics:
                self._leave(path, "has no image topic")
            if len(topics) > 1:
                there = ", ".join(topic.topic for topic in topics)
                draft.missing.append(f'topic: which of {there}, as in topic = "{topics[0].topic}"')
            first_ns, last_ns = records.span_ns or (0, 0)
            known = YEAR_2000_NS <= first_ns <= last_ns
            draft.facts = Facts(
                first_ns if known else None, (last_ns - first_ns) / NS_PER_S if known else None,
                camera=bool(calibration_topics(records)),
            )  # fmt: skip

    # --- what belongs to it ---

    def index(self) -> None:
        """By folders and names, once all sessions are known."""
        for draft in self.drafts:
            self._here[draft.home].append(draft)
            self._stems[draft.home][_folded(draft.stem)].append(draft)
            for folder in (draft.home, *draft.home.parents):
                if folder.is_relative_to(self.root):
                    self._below[folder].append(draft)

    def find_beside(self, draft: _Draft) -> None:
        """Settings, seeds and what is said of the chair."""
        kinds: tuple[Kind, ...] = ("settings", "seeds", "analysis")
        video = draft.videos[0]
        alone = len(self._here[draft.home]) == 1
        stems = (draft.stem, *(unicodedata.normalize(form, draft.stem) for form in ("NFC", "NFD")))
        for kind in kinds:
            plain = draft.home / f"{kind}.toml"
            places = [folder / f"{stem}.{kind}.toml" for folder in (draft.home, video.parent) for stem in stems]
            places += [video / f"{kind}.toml"] if draft.kind == "pictures" else []
            places += [plain] if alone else []
            places += [self.root / f"{kind}.toml"] if kind != "seeds" else []
            there = next((path for path in places if os.path.isfile(path)), None)
            if there is not None:
                draft.beside[kind] = there
            if plain not in places and os.path.isfile(plain):
                draft.missing.append(
                    f"{kind}: {self.shown(plain)} lies beside several videos; if it is this one's, say "
                    f"{kind} = {quoted(self.shown(plain))}"
                )
        if len(same := self._stems[draft.home][_folded(draft.stem)]) > 1:
            others = ", ".join(other.videos[0].name for other in same if other is not draft)
            draft.notes.append(f"{others} has the same name but for its ending, so both share {draft.stem}.seeds.toml")
        if "seeds" not in draft.beside:
            by_itself = draft.home / f"{draft.stem}.settings.toml"
            rate = " --rate N" if draft.kind == "pictures" else ""
            own = draft.beside.get("settings")
            settings = f" --settings {shlex.quote(self.shown(own))}" if own not in (None, by_itself) else ""
            make = f"spheremcap annotate {shlex.quote(self.shown(video))}{settings}{rate}"
            draft.missing.append(f"seeds: {make}, or say auto = true")
        draft.missing += self._camera_missing(draft)

    def _camera_missing(self, draft: _Draft) -> list[str]:
        guessed = "so its distances rest on a guess: spheremcap config presets lists cameras"
        path = draft.beside.get("settings")
        if path is None:
            told = f"settings: no {draft.stem}.settings.toml, {guessed}"
            return [] if draft.facts.camera else [told]
        settings = self._settings(path)
        if isinstance(settings, str):
            return [f"settings: {settings.replace(str(path), self.shown(path))}"]
        known = settings.camera.given or draft.facts.camera
        return [] if known else [f"camera: {self.shown(path)} names none, {guessed}"]

    def belongs(self, path: Path) -> bool:
        """Whether a log's name or place says whose it is; then it is there, or left over with the reason."""
        name = path.stem if path.suffix.lower() in TABLE_ENDINGS else path.name
        why: Why
        own, why = _of_name(name, self._stems[path.parent]), "by name"
        for folder in (path.parent, *path.parent.parents):
            if own or not folder.is_relative_to(self.root) or folder == self.root:
                break
            own = self._stems[folder].get(_folded(folder.name), [])
            if not own and not self._below[folder]:
                own = _of_name(folder.name, self._stems[folder.parent])
        if not own:
            own, why = self._only(path.parent), "only one here"
        if len(own) == 1:
            self._add(own[0], path, why)
        elif own:
            self._left(path, own, "by its name it may belong to")
        return bool(own)

    def _only(self, folder: Path) -> list[_Draft]:
        """The session of a folder with one video; of one without, that of the folder above, as long as there is one."""
        if here := self._here[folder]:
            return here if len(here) == 1 else []
        while not self._below[folder] and folder != self.root:
            folder = folder.parent
        return self._below[folder] if len(self._below[folder]) == 1 else []

    def by_time(self, paths: Sequence[Path]) -> None:
        """Logs that neither name nor place tells: by their times, where these count from 1970 as the video's do."""
        spans: dict[Path, tuple[int, int]] = {}
        for path in paths:
            try:
                span = span_of(path)
            except (SpheremcapError, OSError) as error:
                self._leave(path, self._plain(error))
                continue
            if span is None:
                self._leave(path, "neither its name nor its times say which video it belongs to: name it in sensors")
            else:
                spans[path] = span
        known = [draft for draft in self.drafts if None not in (draft.facts.start_ns, draft.facts.duration_s)]
        starts = np.array([draft.facts.start_ns for draft in known], np.int64)
        ends = starts + np.array([round((draft.facts.duration_s or 0) * NS_PER_S) for draft in known], np.int64)

        def over(path: Path, shift_ns: int) -> list[_Draft]:
            first, last = (stamp_ns + shift_ns for stamp_ns in spans[path])
            return [known[k] for k in np.flatnonzero((starts <= last) & (ends >= first))]

        for path in list(spans):
            if own := over(path, 0):
                del spans[path]
                if len(own) == 1:
                    self._add(own[0], path, "by time")
                else:
                    self._left(path, own, "in time it lies over")
        # A clock that is off is so for all logs: one shift that suits several of them is surer than one for each.
        suited = {shift: [path for path in spans if len(over(path, shift)) == 1] for shift in _ZONES}
        most = max(map(len, suited.values()))
        best = [shift for shift in _ZONES if len(suited[shift]) == most]
        for path in spans:
            shifts = best if most > 1 and len(best) == 1 and path in suited[best[0]] else _ZONES
            pairs = [(shift, draft) for shift in shifts for draft in over(path, shift)]
            if len(pairs) == 1:
                self._add(pairs[0][1], path, "by time", pairs[0][0])
            else:
                several = "; moved by whole quarter-hours it lies over several, or in several ways" if pairs else ""
                told = " to ".join(map(when, spans[path]))
                self._leave(path, f"its times, {told}, lie over no video{several}")

    def _add(self, draft: _Draft, path: Path, why: Why, shift_ns: int = 0) -> None:
        """A log as the session's, unless it is a text that happens to lie there."""
        begins = path.name[: len(draft.stem)]
        wanted = sensor_name(path.as_posix(), begins if begins.casefold() == draft.stem.casefold() else draft.stem)
        name = free(wanted, {sensor.name for sensor in draft.sensors})
        problem, absolute = (None, True) if why == "by time" else self._understood(path, name)
        if problem is not None and path.suffix.lower() == ".txt" and _NO_TABLE in problem:
            self._leave(path, problem)
            return
        if name != wanted:
            other = next(sensor.path for sensor in draft.sensors if sensor.name == wanted)
            draft.notes.append(
                f"{self.shown(other)} and {self.shown(path)} would both be called {wanted}: the second is {name}"
            )
        if problem is not None:
            draft.unread.add(name)
            draft.missing.append(f"sensor {name}: {problem}")
        elif absolute:
            draft.absolute.append(name)
        if shift_ns:
            draft.offsets[name] = offset = format_offset(shift_ns)
            draft.notes.append(
                f"{self.shown(path)} lies over the video only when moved by {offset} (does a clock have local time for "
                f"UTC?): if that is right, say merge.{name}.offset = {quoted(offset)}"
            )
        draft.sensors.append(FoundSensor(name, path, why))

    def _left(self, path: Path, own: Sequence[_Draft], why: str) -> None:
        several = ", ".join(self.shown(draft.videos[0]) for draft in own[:5]) + (", ..." if len(own) > 5 else "")
        self._leave(path, f"{why} {several}: name it in that session's sensors")

    def _understood(self, path: Path, name: str) -> tuple[str | None, bool]:
        """Why a log cannot be merged as it is (None: it can), and whether its times count from 1970, by its head."""
        with head_of(path) as (head, before):
            try:
                if path.suffix.lower() == ".xlsx":  # of which reading all takes long
                    open_table(path)
                    return None, False
                return None, any(log.timing.zero == "1970" for log in read_sensors(head))
            except UnreadTableError as error:
                make = f"spheremcap merge {shlex.quote(self.shown(path))} -o x.mcap > {name}.mapping.toml"
                return (
                    f"{self._plain(error, before)}; a mapping to start from: {make}; "
                    f'then merge.{name}.mapping = "{name}.mapping.toml"'
                ), False
            except (SpheremcapError, OSError) as error:
                return self._plain(error, before), False

    def _plain(self, error: Exception, before: str = "") -> str:
        """An error with its files as the manifest names them; `before` stands in front of them."""
        return str(error).replace(f"{before}{self.root}/", self.shown(self.root / "x").removesuffix("x"))

    # --- what comes of it ---

    def finding(self) -> Finding:
        """All of it, by names that are each other's only one."""
        names: set[str] = set()
        found = []
        for draft in sorted(self.drafts, key=lambda draft: draft.videos):
            video = draft.videos[0]
            name = session_name(video, self.root if video != self.root else self.root.parent)
            name = name if re.fullmatch(NAME, name) else "session"
            names.add((name := free(name, names)).casefold())
            facts, beside = draft.facts, draft.beside
            if draft.absolute and facts.start_ns is None:
                draft.missing.append(
                    f"start time: the video does not say when it was, {', '.join(draft.absolute)} does: "
                    'start_time = "2025-06-01T10:00:00Z"'
                )
            found.append(
                Found(
                    name, tuple(draft.videos), tuple(sorted(draft.sensors, key=lambda sensor: sensor.path)),
                    beside.get("settings"), beside.get("seeds"), beside.get("analysis"),
                    facts.start_ns, facts.duration_s, facts.size, facts.rate, frozenset(draft.unread), draft.offsets,
                    tuple(draft.missing), tuple(draft.notes),
                )
            )  # fmt: skip
        notes = [*self.notes, *([f"recordings of ours are left out: {self._recordings}"] if self._recordings else [])]
        return Finding(tuple(sorted(found, key=lambda one: one.name)), tuple(sorted(self.leftovers)), tuple(notes))


# --- files ---


def real_path(path: Path) -> Path:
    """Absolute, with its links followed as far as it is there."""
    return Path(os.path.realpath(path))


def _settings(path: Path) -> Settings | str:
    """A settings file, or what is wrong with it."""
    try:
        return load_settings(path)
    except SettingsError as error:
        return str(error)


def _of_name(name: str, stems: Mapping[str, list[_Draft]]) -> list[_Draft]:
    """Those whose name it begins with, the longest that there is, and a separator behind it."""
    name = _folded(name)
    ends = [k for k in range(len(name), 0, -1) if k == len(name) or name[k] in SEPARATORS]
    return next((stems[name[:k]] for k in ends if name[:k] in stems), [])


def _folded(name: str) -> str:
    """A name as names are compared: capitals do not count, nor how an umlaut is written (a Mac writes it in two)."""
    return unicodedata.normalize("NFC", name).casefold()


# --- as the manifest has it ---


def written(path: Path, base: Path) -> str:
    """A path as seen from `base`, where it lies in it or in the folder that has it; else the whole of it."""
    if path.is_relative_to(base):
        return path.relative_to(base).as_posix()
    above = base.parent
    if above != above.parent and path.is_relative_to(above):
        return f"../{path.relative_to(above).as_posix()}"
    return path.as_posix()


def quoted(text: str) -> str:
    """A TOML string."""
    return tomli_w.dumps({"x": text}).removeprefix("x = ").rstrip("\n")


def times(size: tuple[int, int] | None) -> str:
    return "of no known size" if size is None else f"{size[0]}x{size[1]}"


def when(stamp_ns: int) -> str:
    """To the second."""
    return f"{format_time(stamp_ns)[:19]}Z"
