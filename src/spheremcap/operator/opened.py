"""What is open on the page: a video, a recording with pictures or one of ours, with its files beside it."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, Self, TypeVar, cast

import tomli_w
from pydantic import ValidationError

from spheremcap.api import aspect_of, resolve_camera
from spheremcap.config import CameraSettings, MarkerSettings, Settings, load_settings
from spheremcap.core.camera import Camera
from spheremcap.core.chair import ChairClick
from spheremcap.core.estimate import OperatorRequest
from spheremcap.core.frame import Frame
from spheremcap.core.marker import Answer, Seed
from spheremcap.corrections.run import Run, named_answers, runs_in
from spheremcap.errors import SettingsError, SourceError, UsageError, short
from spheremcap.io.calibration import read_camera_info
from spheremcap.io.course import courses_of
from spheremcap.io.input_file import is_recording
from spheremcap.io.mcap_images import TimeBase
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import write_durably
from spheremcap.io.pictures import Pictures, open_pictures, recorded_pictures
from spheremcap.io.recording import STATE, UNREADABLE, request_of, schema_names
from spheremcap.io.toml_file import first_problem, read_toml
from spheremcap.operator.answers import AnswerFile
from spheremcap.operator.chair import ChairFile
from spheremcap.operator.desk import HELD_BYTES
from spheremcap.operator.lanes import Lanes
from spheremcap.session import check_answers
from spheremcap.stretch import Stretch, base_seeds

Kind = Literal["video", "log", "recording", "attended"]
_Answer = TypeVar("_Answer", bound=Answer)
_HELD_BYTES = 16 << 20  # decompressed chunks that are kept: what is looked at lies close together
_NAME = re.compile(r"[A-Za-z0-9_]{1,100}", re.ASCII)
_NO_NAME = re.compile(r"[^A-Za-z0-9_-]+", re.ASCII)


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


class Opened:
    """A file and all that the page says of it; closed with `close` or as a context manager.

    `path` is a video, a folder of pictures, an MCAP with pictures or a recording of ours, of which the run of one
    `camera` is shown (None: the first; `cameras` are all). Answers go into `answers` (NAME.seeds.toml beside it unless
    `seeds` says another), the clicks on the chair into NAME.chair.toml beside those (NAME.CAMERA.chair.toml where there
    are several cameras), the markers and the camera of what is not tracked yet into NAME.settings.toml or `settings`;
    nothing else is written, and nothing outside of their folders. Frames are numbered as the tracker numbers them.

    `attended` are the settings of a run that is going on, whose questions the page shows; they stand, and the chair is
    not clicked on meanwhile.

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
        camera: str | None = None,
    ) -> None:
        self.path = Path(path)
        self.topic, self.rate = topic, rate
        self.kind: Kind = "video" if attended is None else "attended"
        self.lanes: Lanes | None = None
        self.cameras: tuple[str, ...] = ()
        """Of a recording of ours that has several."""
        self.camera_name = ""
        """The one of them that is shown."""
        self.given: tuple[Answer, ...] = ()
        """Answers that the recording has."""
        self.offset = 0
        """Frame number of the tracker's less the picture's index."""
        self._settings = attended
        self._asked: tuple[OperatorRequest, ...] = ()
        stem = self.path.with_suffix("").name or self.path.name
        beside = self.path.resolve().parent
        self.settings_path = settings if settings is not None else beside / f"{stem}.settings.toml"
        seeds_path = seeds if seeds is not None else beside / f"{stem}.seeds.toml"
        for kept in (seeds_path, self.settings_path):
            _check_kept(kept, self.path)
        if seeds_path.resolve() == self.settings_path.resolve():
            raise UsageError(f"{seeds_path}: seeds and settings cannot be kept in one file")
        with ExitStack() as files:
            runs: list[Run] = []
            if attended is None and is_recording(self.path):
                records = files.enter_context(McapRecords(self.path, held_bytes=_HELD_BYTES))
                runs = _runs(records)
                self.kind = "recording" if runs else "log"
            if runs:
                run = self._chosen(runs, camera)
                self.pictures = _pictures_of(run, records)
                self.offset = run.states.first_index - self._picture_at(run.states.stamp_ns(0))
            else:
                self.pictures = files.enter_context(
                    open_pictures(self.path, topic=topic, rate=rate, held_bytes=HELD_BYTES)
                )
            self.first, self.last = self.pictures.first_index + self.offset, self.pictures.count - 1 + self.offset
            if runs:
                self._settings, self.given = run.settings, tuple(run.answers)
                self._asked = tuple(_requests_of(run, records))
                topics = {spec.name: run.topics.state(spec.name) for spec in run.specs}
                self.lanes = Lanes(records, topics, courses_of(records, run.id), self.first, self.last)
            self.answers = AnswerFile(
                seeds_path,
                [answer for one in runs for answer in named_answers(one, runs)],
                self._check,
                f"{self.camera_name}/" if self.cameras else "",
            )
            self.chair = None if attended is not None else self._chair_file(seeds_path)
            """None while a run is going on."""
            self._files = files.pop_all()
        self._names = [marker.name for marker in self.markers] if attended is not None else []
        """Of a run that is going on: there will be no others."""
        self._camera: tuple[Settings, Camera, bool, str] | None = None

    def _chair_file(self, seeds_path: Path) -> ChairFile:
        stem = seeds_path.name.removesuffix(".toml").removesuffix(".seeds")
        camera = f".{_NO_NAME.sub('_', self.camera_name)}" if self.cameras else ""
        path = seeds_path.with_name(f"{stem}{camera}.chair.toml")
        _check_kept(path, self.path)
        if path.resolve() == self.settings_path.resolve():
            raise UsageError(f"{path}: settings and clicks on the chair cannot be kept in one file")
        return ChairFile(path, self.pictures.width_px, self.pictures.height_px)

    def click(self, was: ChairClick | None, now: ChairClick | None) -> None:
        """See `ChairFile.change`. Raises UsageError where the frame is not there, too."""
        if self.chair is None:
            raise UsageError("the chair is not clicked on while a run waits: open the video")
        if now is not None and not self.first <= now.frame_index <= self.last:
            raise UsageError(f"there is no frame {now.frame_index}: {self.first} to {self.last} are there")
        self.chair.change(was, now)

    def _chosen(self, runs: Sequence[Run], camera: str | None) -> Run:
        """The run of that camera. Raises UsageError when there is none."""
        names = [run.name for run in runs]
        if len(runs) > 1:
            self.cameras, self.camera_name = tuple(names), names[0] if camera is None else camera
        if camera is not None and camera not in names:
            raise UsageError(f"{self.path}: there is no camera {short(camera)}: there are {', '.join(names)}")
        return runs[0 if camera is None else names.index(camera)]

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
        """The same pictures for another thread that goes through them in order."""
        return open_pictures(self.path, topic=self.topic, rate=self.rate, held_bytes=1)

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

    def named(self, answer: _Answer) -> _Answer:
        """An answer by the name that its marker has where the recording has several cameras."""
        return replace(answer, marker=f"{self.camera_name}/{answer.marker}") if self.cameras else answer

    def _check(self, answers: Sequence[Answer]) -> None:
        circles = {(a.marker, a.frame_index): a.circle for a in answers if isinstance(a, Seed)}
        for seed in base_seeds(self.given):
            if circles.get((seed.marker, seed.frame_index), seed.circle) != seed.circle:
                raise UsageError(
                    f"{seed.marker} was tracked from its circle on frame {seed.frame_index}: give the right one on the "
                    "frame after it, or open the video and track it again"
                )
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

    def asked(self, corrected: Iterable[Stretch] = ()) -> list[Request]:
        """The requests, as far as the time line is known: the recording's, but those that stretches stand over, whose
        own come in their place."""
        if self.lanes is None:
            return []
        requests = list(self._asked)
        for one in corrected:
            requests = [r for r in requests if r.marker != one.marker or r.raised_at_frame_index not in one]
            requests += one.requests
        courses, found = self.lanes.courses(), []
        for number, request in enumerate(sorted(requests, key=lambda r: (r.frame_index, r.marker))):
            course = courses[request.marker]
            before = course.measured_before(request.frame_index)
            found.append(Request(number, request, before, course.measured_from(request.raised_at_frame_index)))
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


def _runs(records: McapRecords) -> list[Run]:
    """The runs of ours in a recording; none where it has no markers. Raises SourceError where it has some
    that cannot be corrected."""
    return runs_in(records) if STATE in schema_names(records).values() else []


def _pictures_of(run: Run, records: McapRecords) -> Pictures:
    """The pictures that were tracked. Raises UsageError when the recording has none."""
    there = {channel.topic for channel in records.channels.values() if records.counts.get(channel.id)}
    tracked = run.facts.get("image_topic", "")
    for topic in (tracked, run.topics.video, run.topics.image):
        if topic in there:
            time = run.facts.get("image_time", "header") if topic == tracked else "header"
            return recorded_pictures(records, topic, cast(TimeBase, time), HELD_BYTES)
    raise UsageError(f"{records.path}: a recording without its pictures; open the video that was tracked")


def _requests_of(run: Run, records: McapRecords) -> Iterator[OperatorRequest]:
    """All that stand, with what was answered."""
    for raw in records.messages({run.topics.requests}):
        try:
            yield request_of(raw)
        except UNREADABLE as error:
            records.undecodable(raw.channel.topic, error)
