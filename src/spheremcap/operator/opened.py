"""What is open on the page: a video, a recording with pictures or one of ours, with its files beside it."""

import os
import re
import tomllib
from collections.abc import Container, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, Protocol, Self, cast

import tomli_w
from pydantic import ValidationError

from spheremcap.api import aspect_of, resolve_camera
from spheremcap.config import CameraSettings, MarkerSettings, Settings, answers_in, load_settings
from spheremcap.core.camera import Camera
from spheremcap.core.estimate import OperatorRequest
from spheremcap.core.frame import Frame
from spheremcap.core.marker import Answer, Seed
from spheremcap.errors import SettingsError, SourceError, UsageError, short
from spheremcap.io.calibration import read_camera_info
from spheremcap.io.input_file import is_recording
from spheremcap.io.mcap_images import TimeBase
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.pictures import Pictures, open_pictures
from spheremcap.io.recording import (
    REQUEST,
    STATE,
    UNREADABLE,
    request_of,
    runs_of,
    schema_names,
    state_row,
    track_name,
)
from spheremcap.io.toml_file import first_problem, read_toml
from spheremcap.io.topics import Topics
from spheremcap.operator.answers import AnswerFile, write_durably
from spheremcap.operator.desk import HELD_BYTES
from spheremcap.operator.lanes import Lanes
from spheremcap.session import check_answers

Kind = Literal["video", "log", "recording", "attended"]
_NAME = re.compile(r"[A-Za-z0-9_]{1,100}", re.ASCII)


@dataclass(frozen=True)
class Request:
    """What a recording asks a person: a marker's frames from its first unverified one up to before `end`, the first on
    which it was measured again, and the last frame before on which it was (None: there is none)."""

    number: int
    asked: OperatorRequest
    last_verified: int | None
    end: int | None

    def answered(self, answers: Sequence[Answer], last: int) -> bool:
        """Whether one of the answers is about these frames."""
        first, end = self.asked.frame_index, self.end if self.end is not None else last + 1
        for answer in answers:
            if answer.marker == self.asked.marker:
                to = answer.frame_index if isinstance(answer, Seed) else answer.to_frame_index
                if answer.frame_index < end and to >= first:
                    return True
        return False


class Correction(Protocol):
    """A stretch that stands over the recording: its circle, its states by frame, its requests."""

    @property
    def answer(self) -> Seed: ...

    @property
    def states(self) -> Container[int]: ...

    @property
    def requests(self) -> tuple[OperatorRequest, ...]: ...


@dataclass(frozen=True)
class _Ours:
    """What a recording of ours says besides its messages."""

    markers: tuple[str, ...]
    root: str
    settings: Settings
    answers: tuple[Answer, ...]
    requests: tuple[OperatorRequest, ...]
    run: Mapping[str, str]
    first: tuple[int, int]  # frame and stamp of the first state


class Opened:
    """A file and all that the page says of it; closed with `close` or as a context manager.

    `path` is a video, a folder of pictures, an MCAP with pictures or one of ours. Answers go into `answers`
    (NAME.seeds.toml beside it unless `seeds` says another), the markers and the camera of what is not tracked yet into
    NAME.settings.toml or `settings`; nothing else is written, and nothing outside of their folders. Frames are numbered
    as the tracker numbers them.

    `attended` are the settings of a run that is going on, whose questions the page shows; they stand.

    Raises SourceError for what cannot be read, UsageError where something has to be said.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        seeds: Path | None = None,
        settings: Path | None = None,
        topic: str | None = None,
        rate: Fraction | None = None,
        attended: Settings | None = None,
    ) -> None:
        self.path = Path(path)
        self.topic, self.rate = topic, rate
        self.kind: Kind = "video"
        self.lanes: Lanes | None = None
        ours = None
        time: TimeBase = "header"
        if attended is not None:
            self.kind = "attended"
        elif is_recording(self.path):
            ours = _ours(self.path)
            self.kind = "log" if ours is None else "recording"
        if ours is not None:
            topic = topic or _pictures_of(self.path, ours)
            word = ours.run.get("time_source", "").split(" ", 1)[0]
            time = cast(TimeBase, word) if word in ("log", "publish") and ours.run.get("image_topic") else "header"
        self._topic, self._time = topic, time
        stem = self.path.with_suffix("").name or self.path.name
        beside = self.path.resolve().parent
        self.settings_path = settings if settings is not None else beside / f"{stem}.settings.toml"
        self._settings = ours.settings if ours is not None else attended
        seeds_path = seeds if seeds is not None else beside / f"{stem}.seeds.toml"
        for kept in (seeds_path, self.settings_path):
            _check_kept(kept, self.path)
        if seeds_path.resolve() == self.settings_path.resolve():
            raise UsageError(f"{seeds_path}: seeds and settings cannot be kept in one file")
        with ExitStack() as files:
            self.pictures = files.enter_context(
                open_pictures(self.path, topic=topic, time=time, rate=rate, held_bytes=HELD_BYTES)
            )
            self.offset = 0 if ours is None else ours.first[0] - self._picture_at(ours.first[1])
            """Frame number of the tracker's less the picture's index."""
            self.first, self.last = self.pictures.first_index + self.offset, self.pictures.count - 1 + self.offset
            self.answers = AnswerFile(
                seeds_path,
                ours.answers if ours is not None else (),
                self._check,
            )
            self._files = files.pop_all()
        self.root = ours.root if ours is not None else ""
        if ours is not None:
            self.given = ours.answers
            self.lanes = Lanes(ours.markers, self.first, self.last - self.first + 1)
            self._asked = ours.requests
        else:
            self.given = ()
            self._asked = ()
        self._names = [marker.name for marker in self.markers] if attended is not None else []
        """Of a run that is going on: there will be no others."""
        self._camera: tuple[Settings, Camera, bool, str] | None = None

    def name_of(self, track: str) -> str:
        """The marker of a track, whatever its topics begin with."""
        return track.removeprefix(f"{self.root}/")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; pictures are closed by this only."""
        self._files.close()

    # --- pictures ---

    def frame(self, frame_index: int, pictures: Pictures | None = None) -> Frame | None:
        """The frame by the tracker's number; from other `pictures` of the same file where they are given."""
        return (pictures or self.pictures).frame(frame_index - self.offset)

    def stamp_ns(self, frame_index: int) -> int:
        """When a frame was taken."""
        return self.pictures.stamp_ns(frame_index - self.offset)

    def frame_at(self, since_first_ns: int) -> int:
        """The last frame taken so long after the first one, or before."""
        return self.pictures.index_at(self.pictures.stamp_ns(self.pictures.first_index) + since_first_ns) + self.offset

    def open_again(self) -> Pictures:
        """The same pictures for another thread."""
        return open_pictures(self.path, topic=self._topic, time=self._time, rate=self.rate)

    def _picture_at(self, stamp_ns: int) -> int:
        index = self.pictures.index_at(stamp_ns)
        if self.pictures.stamp_ns(index) != stamp_ns:
            raise SourceError(f"{self.path}: its pictures are not those that were tracked; open the video instead")
        return index

    # --- markers and camera ---

    @property
    def settings(self) -> Settings:
        """A recording's or a run's own; else those of the settings file, if there is one."""
        if self._settings is not None:
            return self._settings
        return load_settings(self.settings_path) if self.settings_path.exists() else Settings()

    @property
    def markers(self) -> list[MarkerSettings]:
        """Those that the settings list, then those that only answers name."""
        listed = list(self.settings.markers)
        names = {marker.name for marker in listed}
        seeded = dict.fromkeys(a.marker for a in self.answers.answers() if a.marker not in names)
        return listed + [MarkerSettings(name=name) for name in seeded]

    def set_marker(
        self, name: str, diameter_m: float, was: str | None = None, colour: str | Sequence[float] | None = None
    ) -> None:
        """List a marker in the settings file, or give the one called `was` another name, diameter or colour."""
        if self._settings is not None:
            raise UsageError("what is tracked has its markers already: open the video for others")
        if not _NAME.fullmatch(name):
            raise UsageError(f"the name {short(name)} has to be letters, digits and underscores")
        if was != name and name in (m.name for m in self.markers):
            raise UsageError(f"there is a marker {name} already")
        new: dict[str, Any] = {"name": name, "diameter_m": diameter_m} | ({"colour": colour} if colour else {})
        rows = [m.model_dump(exclude_none=True) for m in self.markers]
        rows = [new if row["name"] == was else row for row in rows]
        self._write({"markers": rows if new in rows else [*rows, new]})
        if was is not None and was != name:
            self.answers.rename(was, name)

    def drop_marker(self, name: str) -> None:
        """Take a marker without answers off the list."""
        if any(a.marker == name for a in self.answers.answers()):
            raise UsageError(f"{name} has answers: take them back first")
        if self._settings is not None:
            raise UsageError("what is tracked has its markers already")
        self._write({"markers": [m.model_dump(exclude_none=True) for m in self.markers if m.name != name]})

    def set_preset(self, preset: str | None) -> None:
        """Take the camera for a preset, or (None) for what is assumed without one."""
        self._set_camera({"preset": preset} if preset is not None else {})

    def set_calibration(self, text: str) -> None:
        """Take a ROS camera_info YAML, kept beside the settings, for the camera. Raises SettingsError."""
        place = self.settings_path.with_name(
            f"{self.settings_path.name.removesuffix('.settings.toml')}.camera_info.yaml"
        )
        trial = place.with_name(f".{place.name}")
        try:
            write_durably(trial, text)
            read_camera_info(trial)
            write_durably(place, text)
        except SettingsError as error:
            raise SettingsError(str(error).replace(str(trial), "the file")) from error
        finally:
            trial.unlink(missing_ok=True)
        self._set_camera({"file": place.name})

    def _set_camera(self, camera: dict[str, Any]) -> None:
        if self._settings is not None:
            raise UsageError("what is tracked has its camera already: open the video for another")
        before = self.settings
        kept = {"exposure_s": before.camera.exposure_s, "readout_s": before.camera.readout_s}
        changed = before.model_copy(update={"camera": CameraSettings(**camera, **kept)})
        self._resolved(changed)
        self._write({"camera": camera | {key: value for key, value in kept.items() if value}})

    def _write(self, changes: dict[str, Any]) -> None:
        tables = read_toml(self.settings_path) if self.settings_path.exists() else {}
        tables |= changes
        try:
            Settings.model_validate(tables)
        except ValidationError as error:
            raise UsageError(first_problem(error)) from error
        write_durably(self.settings_path, tomli_w.dumps(tables))

    def camera(self) -> tuple[Camera, bool, str]:
        """The camera, whether its metres may be given out, and a note on where it is from."""
        settings = self.settings
        if self._camera is None or self._camera[0] != settings:
            self._camera = settings, *self._resolved(settings)
        return self._camera[1:]

    def _resolved(self, settings: Settings) -> tuple[Camera, bool, str]:
        source = self.pictures.source
        beside = None if settings.camera.given else source.calibration
        return resolve_camera(
            settings.camera,
            source.width_px,
            source.height_px,
            self.settings_path.parent,
            beside,
            *aspect_of(source, []),
        )

    # --- answers and requests ---

    def _check(self, answers: Sequence[Answer]) -> None:
        for answer in answers:
            last = answer.frame_index if isinstance(answer, Seed) else answer.to_frame_index
            if not self.first <= answer.frame_index <= last <= self.last:
                raise UsageError(f"there is no frame {last}: {self.first} to {self.last} are there")
            if not _NAME.fullmatch(answer.marker):
                raise UsageError(f"the name {short(answer.marker)} has to be letters, digits and underscores")
        if self.lanes is not None:
            names = list(self.lanes.by_marker)
        else:
            names = self._names or list(dict.fromkeys(answer.marker for answer in answers))
        check_answers(answers, names, self.pictures.width_px, self.pictures.height_px)

    def unwritten(self) -> list[Answer]:
        """The answers that the recording does not have yet; all, where nothing has been tracked."""
        return [answer for answer in self.answers.answers() if not any(_same(answer, one) for one in self.given)]

    def asked(self, corrected: Iterable[Correction] = ()) -> list[Request]:
        """The requests, as far as the time line is known: the recording's, but those that stretches stand over, whose
        own come in their place."""
        if self.lanes is None:
            return []
        requests = list(self._asked)
        for one in corrected:
            over = one.answer.marker, one.states
            requests = [r for r in requests if r.marker != over[0] or r.raised_at_frame_index not in over[1]]
            requests += one.requests
        found = []
        for number, request in enumerate(sorted(requests, key=lambda r: (r.frame_index, r.marker))):
            lane = self.lanes.by_marker[request.marker]
            before = lane.measured_before(request.frame_index)
            found.append(Request(number, request, before, lane.measured_from(request.raised_at_frame_index)))
        return found


def _check_kept(path: Path, source: Path) -> None:
    """Raises UsageError for a place where nothing can be kept, or the input is."""
    try:
        if not path.resolve().parent.is_dir():
            raise UsageError(f"{path}: there is no folder {path.parent}: create it first")
        if path.exists() and (not path.is_file() or path.samefile(source)):
            what = "is the input" if path.is_file() else "is no regular file"
            raise UsageError(f"{path}: {what}: name another file to keep answers or settings in")
    except (OSError, RuntimeError) as error:  # too long a name; a link that leads to itself
        raise UsageError(f"{path}: cannot be written ({short(error)}): name another file") from error


def _same(a: Answer, b: Answer) -> bool:
    """Whether two answers say the same, whoever gave them and when."""
    return _said(a) == _said(b)


def _said(answer: Answer) -> tuple[Any, ...]:
    if isinstance(answer, Seed):
        return "circle", answer.marker, answer.frame_index, *answer.circle
    return type(answer).__name__, answer.marker, answer.frame_index, answer.to_frame_index


def _ours(path: Path) -> _Ours | None:
    """What a recording of ours says; None for one without markers. Reads no more than that takes."""
    with McapRecords(path) as records:
        names = schema_names(records)
        states = {c.topic for c in records.channels.values() if names[c.id] == STATE and c.topic.count("/") > 1}
        if not states:
            return None
        tracks = {topic: track_name(topic, topic.split("/")[-2]) for topic in sorted(states)}
        roots = {name.rpartition("/")[0] for name in tracks.values()}
        if len(roots) > 1:
            raise UsageError(f"{path}: markers of several cameras ({', '.join(sorted(roots))}): open one that has one")
        first = None
        for topic in states:
            for raw in records.messages({topic}):
                try:
                    row = state_row(raw.data, raw.log_time)
                except UNREADABLE as error:
                    records.undecodable(raw.channel.topic, error)
                    continue
                first = min(first or (row.frame_index, row.stamp_ns), (row.frame_index, row.stamp_ns))
                break
        asking = {c.topic for c in records.channels.values() if names[c.id] == REQUEST}
        requests = []
        for raw in records.messages(asking):
            try:
                requests.append(request_of(raw))
            except UNREADABLE as error:
                records.undecodable(raw.channel.topic, error)
        texts = {a.name: a.data.decode("utf-8", "replace") for a in records.attachments()}
        run = next(iter(runs_of(records).values()), {})
    if first is None:
        raise SourceError(f"{path}: none of its markers' states can be read")
    try:
        settings = Settings.model_validate(tomllib.loads(texts.get("settings.toml", "")))
        answers = tuple(answers_in(tomllib.loads(texts["seeds.toml"]), str(path))) if texts.get("seeds.toml") else ()
    except (ValidationError, ValueError, RecursionError, SettingsError) as error:
        raise SourceError(f"{path}: its settings or seeds are damaged: {short(error)}") from error
    markers = tuple(name.rpartition("/")[2] for name in tracks.values())
    return _Ours(markers, next(iter(roots)), settings, answers, tuple(requests), run, first)


def _pictures_of(path: Path, ours: _Ours) -> str:
    """The topic of the pictures that were tracked. Raises UsageError when the recording has none."""
    with McapRecords(path) as records:
        there = {channel.topic for channel in records.channels.values()}
    for topic in (ours.run.get("image_topic", ""), Topics().video, Topics().image):
        if topic in there:
            return topic
    raise UsageError(f"{path}: a recording without its pictures; open the video that was tracked")
