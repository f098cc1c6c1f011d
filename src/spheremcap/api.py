"""The jobs of spheremcap as functions: track a video into a recording, correct one by what a person answers, merge
recordings and sensor files, open what came out. Wires io to the session.
"""

import heapq
import os
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from copy import copy
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from spheremcap.analysis import job as analysing
from spheremcap.analysis.filmed import calibrate_board
from spheremcap.analysis.job import AnalysisReport
from spheremcap.analysis.settings import AnalysisSettings
from spheremcap.attended import Asked, Attended, Operator
from spheremcap.config import CameraSettings, MarkerSettings, Settings, seeds_toml
from spheremcap.core.camera import Camera
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import FrameResult, MarkerEstimate, Status
from spheremcap.core.frame import BgrImage, EncodedPicture, Frame
from spheremcap.core.marker import Answer, MarkerSpec, Seed
from spheremcap.core.presets import PRESETS, assumed_camera
from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.corrections import job
from spheremcap.corrections.job import Report, RetrackReport
from spheremcap.corrections.run import camera_fact
from spheremcap.corrections.told import lost_marker
from spheremcap.detection.aspect import pixel_aspect
from spheremcap.errors import UsageError
from spheremcap.found import Found, assign
from spheremcap.io import overlays
from spheremcap.io.ahead import ahead, in_order
from spheremcap.io.calibration import read_camera_info
from spheremcap.io.chapters import Chapters
from spheremcap.io.encode import H264Encoder, jpeg_encode
from spheremcap.io.folder import PictureFolder
from spheremcap.io.join import Join
from spheremcap.io.mcap_images import McapImageSource
from spheremcap.io.mcap_log import McapLog, RunInfo, Sink
from spheremcap.io.output import SharedWriter, checked_output, open_output
from spheremcap.io.pictures import Pictures, open_pictures
from spheremcap.io.recording import Recording, open
from spheremcap.io.source import Source as FrameSource
from spheremcap.io.sources import CameraView, FromMcap, Input, fingerprint, open_input
from spheremcap.io.video import VideoSource
from spheremcap.merging.dataset import Dataset, Source, merge
from spheremcap.proposals import Proposal
from spheremcap.proposals import propose as proposed_on
from spheremcap.session import Session, check_answers
from spheremcap.snap import Snap, snapped
from spheremcap.stretch import Stretch, Terms, base_seeds

__all__ = [
    "AnalysisReport",
    "Asked",
    "Dataset",
    "Found",
    "Operator",
    "Proposal",
    "Recording",
    "RetrackReport",
    "Snap",
    "Source",
    "Stretch",
    "TrackReport",
    "analyse",
    "calibrate_board",
    "find",
    "merge",
    "open",
    "propose",
    "resolve_camera",
    "retrack",
    "snap",
    "stretch_of",
    "track",
    "track_input",
]


class TrackReport(Report):
    """What `track` did: all frames that were read, and the statuses and requests of all."""


_UNDOUBTED = 0.05  # of the rate of debug pictures, while nothing is doubted
_AHEAD = 300  # frames of a video that may be decoded twice, to see the first seed before tracking begins

Progress = Callable[[int, int | None], None]
"""Called with frames done and frames expected (None when the container does not say)."""


def resolve_camera(
    settings: CameraSettings,
    width_px: int,
    height_px: int,
    folder: Path,
    found: Camera | None = None,
    pixel_aspect: float = 1.0,
    aspect_by: str = "as the video says",
) -> tuple[Camera, bool, str]:
    """The camera for pictures of this size, whether its metres may be given out, and a note for the user.

    `found` is the calibration beside the pictures, for when the settings name no camera. A calibration for another
    size of the same shape is scaled. `pixel_aspect` is how much wider than high a pixel is: a calibration for pictures
    of square pixels is then squeezed to those that are stored, so that a sphere is as it is seen in them; `aspect_by`
    says in the note who says so. Raises UsageError for an unknown preset or a camera of another shape.
    """
    square_px = round(width_px * pixel_aspect)
    shape = "" if square_px == width_px else f"; pixels are {pixel_aspect:.4g} times as wide as high, {aspect_by}"
    if settings.preset is not None:
        if settings.preset not in PRESETS:
            raise UsageError(f"unknown camera preset {settings.preset!r}; there are: {', '.join(PRESETS)}")
        camera = PRESETS[settings.preset]
        note = f"camera preset {settings.preset}: {camera.source}"
    elif settings.file is not None:
        path = folder / settings.file
        camera, note = read_camera_info(path), f"camera from {path.name}"
    elif settings.fx_px is not None:
        assert settings.fy_px and settings.cx_px is not None and settings.cy_px is not None  # noqa: PT018
        assert settings.width_px and settings.height_px  # noqa: PT018
        try:
            camera = Camera(
                settings.width_px, settings.height_px, settings.fx_px, settings.fy_px, settings.cx_px, settings.cy_px,
                settings.model, settings.distortion, settings.focal_sd, "settings",
            )  # fmt: skip
        except ValueError as error:
            raise UsageError(f"camera: {error}") from error
        note = "camera from the settings"
    elif found is not None:
        camera, note = found, f"camera from {found.source}"
    elif (square_px, height_px) == (1280, 720):
        camera = PRESETS["gopro-hero4-black-720p240-narrow"]
        note = (
            "no camera given: 1280x720 is taken for gopro-hero4-black-720p240-narrow, "
            "so distances are good to 3 % only if that is true; give --camera"
        )
    else:
        note = "no camera given: circles are written, positions in metres are not; give --camera"
        return assumed_camera(square_px, height_px).scaled(width_px, height_px), False, note + shape
    if settings.focal_sd:
        camera = replace(camera, focal_sd=settings.focal_sd)
    if (camera.width_px, camera.height_px) != (width_px, height_px):
        if square_px != width_px and camera.width_px * height_px == camera.height_px * square_px:
            return camera.scaled(width_px, height_px), True, note + shape
        if abs(camera.width_px * height_px - camera.height_px * width_px) > max(width_px, height_px):
            raise UsageError(
                f"the camera is for {camera.width_px}x{camera.height_px}, the pictures are {width_px}x{height_px}: "
                f"another shape, so another calibration is needed ({note})"
            )
        note += f"; scaled from {camera.width_px}x{camera.height_px}"
        camera = camera.scaled(width_px, height_px)
    return camera, True, note


def aspect_of(source: FrameSource, answers: Sequence[Answer]) -> tuple[float, str]:
    """How much wider than high a video's pixels are, and who says so: the video, else the outline of its first seed, if
    that is among the first `_AHEAD` frames and plainly that of an ellipse. Without seeds the video alone is asked."""
    seeds = (answer for answer in answers if isinstance(answer, Seed))
    first = min(seeds, key=lambda seed: seed.frame_index, default=None)
    a_video = isinstance(source, VideoSource | Chapters)
    if first is None or first.frame_index > _AHEAD or source.pixel_aspect != 1 or not a_video:
        return source.pixel_aspect, "as the video says"
    # Its frames can be gone through only once.
    with open_input(source.path, packets=False) as again:
        for frame in again.views[0].source.frames():
            if frame.index == first.frame_index:
                return pixel_aspect(frame, first.circle), (
                    f"by the outline of {first.marker}'s seed, as the video does not say: "
                    "if the marker is no sphere, give --camera"
                )
    return 1.0, ""


def snap(
    frame: Frame, circle: Circle, settings: Settings, camera: Camera | None = None, *, diameter_m: float = 0.04
) -> Snap:
    """A person's circle (pixels) as the chain would start from it, and what it learns there; nothing is kept.

    `camera` is the one for these pictures (see `resolve_camera`): without one there are no metres. Raises UsageError
    for a circle that is not in the picture.
    """
    assumed = assumed_camera(frame.width_px, frame.height_px)
    return snapped(
        frame, circle, MarkerSpec("marker", diameter_m), camera or assumed, settings.chain,
        metric=camera is not None, exposure_s=settings.camera.exposure_s, readout_s=settings.camera.readout_s,
    )  # fmt: skip


def propose(frames: Iterable[Frame], settings: Settings, camera: Camera | None = None) -> list[Proposal]:
    """What may be a coloured marker on frames in a row, such as those of a video's first seconds: the likeliest first.

    `camera` as for `snap`. The frames are gone through once, one at a time; of a single one nothing is known of how
    things move on it.
    """
    given = iter(frames)
    first = next(given, None)
    if first is None:
        return []
    chosen = camera or assumed_camera(first.width_px, first.height_px)
    return proposed_on(chain([first], given), chosen, settings.chain)


def find(
    source_path: str | os.PathLike[str],
    settings: Settings,
    answers: Sequence[Answer] = (),
    *,
    folder: Path = Path(),
    start_time_ns: int | None = None,
    rate: Fraction | None = None,
    mcap: FromMcap | None = None,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> Found:
    """Look for the markers that no answer seeds in the first `settings.auto.seconds`: those that the settings list, by
    the colours that these give them; all coloured spheres where they list none.

    Its seeds and settings are for `track`, which is told of it as `found`. What is `unclear` has to be seeded by a
    person first. The other parameters are those of `track`; where `stop` says so, what was seen until then counts.
    Raises SpheremcapError, UsageError also where nothing was found.
    """
    if answers and not settings.markers:
        raise UsageError(
            "--auto beside seeds: which markers are still to be found? List all in a settings file, with their colours"
        )
    seeded = {answer.marker for answer in answers if isinstance(answer, Seed)}
    if settings.markers and seeded.issuperset(marker.name for marker in settings.markers):
        return Found(settings, (), (), (), ())
    path, seconds = Path(source_path), settings.auto.seconds
    with open_input(path, mcap, start_time_ns=start_time_ns, rate=rate, packets=False) as given:
        if len(given.views) > 1:
            topics = ", ".join(view.source.topic for view in given.views)
            raise UsageError(f"{path}: --auto looks at one camera, here are {topics}: choose one with --topic, or seed")
        source = given.views[0].source
        beside = None if settings.camera.given else source.calibration
        camera, _, _ = resolve_camera(
            settings.camera, source.width_px, source.height_px, folder, beside, source.pixel_aspect
        )
        shown: list[int] = []

        def frames() -> Iterator[Frame]:
            end_ns: int | None = None
            for frame in source.frames():
                end_ns = frame.stamp_ns + round(seconds * NS_PER_S) if end_ns is None else end_ns
                if frame.stamp_ns >= end_ns or stop():
                    return
                shown.append(frame.index)
                progress(len(shown), None)
                yield frame

        proposals = propose(frames(), settings, camera)
    where = f"in the first {seconds:g} s (frames {shown[0]} to {shown[-1]})" if shown else "as there are no frames"
    try:
        return assign(proposals, settings, answers, where)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error


def track(
    source_path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    settings: Settings,
    seeds: Sequence[Answer],
    *,
    folder: Path = Path(),
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    start_time_ns: int | None = None,
    rate: Fraction | None = None,
    mcap: FromMcap | None = None,
    operator: Operator | None = None,
    found: Found | None = None,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> TrackReport:
    """Track every marker through a video, or through image topics of an MCAP, and write the annotated recording.

    A marker's first seed is where its track begins; what comes after it in `seeds` are answers, for which the frames
    are gone over once more when all have been tracked, as `retrack` does it. Markers that only the seeds name get the
    default diameter. With several image topics, each is a camera of its own, and a seed's marker is named after the
    camera's topic: `front/left_wrist` is on /front/image. `folder` is where relative paths in the settings start,
    `inputs` the files that settings and seeds came from: the output must be none of them. `start_time_ns` is for videos
    and folders of pictures, `rate` (pictures a second) for folders, `mcap` for recordings. `operator` is asked at each
    request, and tracking waits for it; without one, requests are only written. `found` is where seeds came from that
    nobody gave (`find`): its words go into the recording. `stop` is asked before every frame and ends the recording
    there, readable under OUT.part. Raises SpheremcapError.
    """
    path = Path(source_path)
    packets = settings.output.video in ("auto", "passthrough")
    checked_output(output, _given_files(path, settings, folder, inputs), overwrite=overwrite)
    with open_input(path, mcap, start_time_ns=start_time_ns, rate=rate, packets=packets) as given:
        return track_input(
            given, RunInfo(path.name, *fingerprint(path)), output, settings, seeds, folder=folder, inputs=inputs,
            overwrite=overwrite, operator=operator, found=found, progress=progress, stop=stop,
        )  # fmt: skip


def track_input(
    given: Input,
    run: RunInfo,
    output: str | os.PathLike[str],
    settings: Settings,
    seeds: Sequence[Answer],
    *,
    folder: Path = Path(),
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    operator: Operator | None = None,
    found: Found | None = None,
    sink: Callable[[SharedWriter], Sink] = lambda writer: writer,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> TrackReport:
    """`track` of what is open already, which whoever opened it closes; `run` is what is known of it.

    `sink` makes of the recording's writer what our messages are added to. The other parameters are those of `track`.
    """
    out = Path(output)
    given_files = _given_files(given.path, settings, folder, inputs)
    report = TrackReport(out)
    cameras = [_Camera(*one, folder, run, found) for one in _by_camera(given.views, settings, seeds)]
    hints = [view.source.frame_count_hint for view in given.views]
    done, expected = 0, sum(hint or 0 for hint in hints) if all(hints) else None

    def go_on() -> bool:
        nonlocal done
        report.stopped = report.stopped or stop()
        if not report.stopped:
            done += 1
            progress(done, expected)
        return not report.stopped

    with (
        open_output(out, given_files, overwrite=overwrite, compression=settings.output.compression) as writer,
        ExitStack() as logs,
    ):
        copy = Join(writer, given.streams, lambda written: not stop())
        added = sink(writer)
        for camera in cameras:
            logs.enter_context(camera.begin(added))
            if operator is not None:
                camera.attend(operator, logs)
        last_ns = 0
        steps = [logs.enter_context(closing(camera.steps(go_on))) for camera in cameras]
        with in_order() as writing:
            for log_ns, write in heapq.merge(*steps, key=lambda step: step[0]):
                writing(copy.until, log_ns)
                writing(write)
                last_ns = log_ns
        for camera in cameras:
            camera.end(report, last_ns)
        if not report.stopped:
            copy.rest()
            report.stopped = copy.stopped
        seeds = [*seeds, *(answer for camera in cameras for answer in camera.answers)]
        answered = len(base_seeds(seeds)) < len(seeds) and not report.stopped
        writer.complete = not report.stopped and not answered
        report.part = writer.part if report.stopped and writer.counts else None
        report.notes += writer.notes
    report.lost = given.lost() + report.lost
    if answered and writer.part is not None:
        ids = [camera.run_id for camera in cameras]
        _answer(report, writer.part, given.path, seeds, ids, given_files, overwrite, progress, stop)
    return report


def _given_files(path: Path, settings: Settings, folder: Path, inputs: Sequence[Path]) -> list[Path]:
    """What the output must not be."""
    return [path, *inputs, *([folder / settings.camera.file] if settings.camera.file is not None else [])]


def _answer(
    report: TrackReport, base: Path, source: Path, seeds: Sequence[Answer], ids: Sequence[str], inputs: Sequence[Path],
    overwrite: bool, progress: Progress, stop: Callable[[], bool],
) -> None:  # fmt: skip
    """The second half of `track` where there are answers: `base` becomes the output with them, and goes."""
    try:
        done = job.retrack(
            base, report.output, seeds, source=source, checked=True, view_keeper=_view_keeper, inputs=inputs,
            overwrite=overwrite, progress=progress, stop=stop, ids=ids,
        )  # fmt: skip
    except UsageError:
        base.unlink(missing_ok=True)
        raise
    if done.stopped:
        if done.part is not None:
            done.part.unlink(missing_ok=True)
        report.stopped, report.part = True, base
        return
    base.unlink(missing_ok=True)
    for name, counts in done.statuses.items():
        report.statuses[name].update(counts)
        report.statuses[name] = +report.statuses[name]
    report.requests = done.requests
    report.notes += done.stretches
    report.lost = list(dict.fromkeys(done.lost))


def retrack(
    recording: str | os.PathLike[str],
    output: str | os.PathLike[str],
    answers: Sequence[Answer],
    *,
    source: str | os.PathLike[str] | None = None,
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> RetrackReport:
    """Put a person's answers into a recording of `track`: what they change is tracked again, all else is copied.

    `answers` are all that hold, those that are in the recording already too: what is not among them is taken back. The
    circles that the recording began with need not be. What comes out has the same messages as `track` with all answers
    at once. Where the pictures in the recording are not those of the input, the input is needed: beside the recording,
    or as `source`. `inputs` are further files that the output must not be. `progress` gets the number of frames that
    were tracked again. Raises SpheremcapError.
    """
    return job.retrack(
        Path(recording), Path(output), answers, source=None if source is None else Path(source), checked=False,
        view_keeper=_view_keeper, inputs=inputs, overwrite=overwrite, progress=progress, stop=stop,
    )  # fmt: skip


def stretch_of(
    recording: str | os.PathLike[str],
    answer: Seed,
    *,
    others: Sequence[Answer] = (),
    source: str | os.PathLike[str] | None = None,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> Stretch:
    """What `retrack` would make of one more circle, beside the answers that the recording has and `others`; nothing is
    written. Where `stop` said so, the stretch ends there. Raises SpheremcapError.
    """
    done = 0

    def go_on() -> bool:
        nonlocal done
        done += 1
        progress(done, None)
        return not stop()

    where = None if source is None else Path(source)
    return job.stretch_of(Path(recording), answer, others=others, source=where, view_keeper=_view_keeper, go_on=go_on)


class _Camera:
    """One camera: its pictures go through its session, and what comes out into its part of the recording."""

    def __init__(
        self,
        view: CameraView,
        settings: Settings,
        seeds: Sequence[Answer],
        folder: Path,
        run: RunInfo,
        found: Found | None,
    ) -> None:
        source = view.source
        self._view, self._output = view, settings.output
        self._attended: Attended | None = None
        self.answers: list[Answer] = []
        """Those that were given while it ran, by the names that they have in a seeds file."""
        begun = base_seeds(seeds)
        last = source.frame_count_hint
        for seed in seeds:
            if last is not None and seed.frame_index >= last:
                raise UsageError(
                    f"{source.path}: seed of {seed.marker} on frame {seed.frame_index}: "
                    f"there are {last} frames (0 to {last - 1})"
                )
            if seed.frame_index < source.first_index:
                raise UsageError(
                    f"{source.path}: seed of {seed.marker} on frame {seed.frame_index}: "
                    f"tracking starts on frame {source.first_index}"
                )
        beside = None if settings.camera.given else source.calibration
        camera, metric, camera_note = resolve_camera(
            settings.camera, source.width_px, source.height_px, folder, beside,
            *aspect_of(source, [] if settings.camera.given or beside is not None else begun),
        )  # fmt: skip
        self._encode, video_note = _picture_maker(settings, view)
        notes = camera_note, video_note, source.chroma_note, *view.notes, *(found.told if found is not None else ())
        self._notes = [note for note in notes if note]
        self._missing = list(found.missing) if found is not None else []
        self._specs = [m.spec() for m in settings.markers]
        try:
            check_answers(seeds, [spec.name for spec in self._specs], camera.width_px, camera.height_px)
            self._given, self._settings, self._camera, self._metric = list(seeds), settings, camera, metric
            self._session = Session(
                camera, self._specs, begun, settings.chain, settings.session,
                exposure_s=settings.camera.exposure_s, readout_s=settings.camera.readout_s,
                metric=metric, keep_view=_view_keeper(settings),
            )  # fmt: skip
        except UsageError as error:
            raise UsageError(f"{source.path}: {error}") from error
        writes_calibration = metric and not (view.calibrated and camera is beside)
        self._calibration = camera if writes_calibration else None
        pictures = _PICTURE_TOPICS.get(settings.output.video)
        self._topics = view.topics(pictures=pictures, calibration=writes_calibration)
        more = {"image_topic": source.topic, "camera_note": camera_note, "name": view.name.strip("/")}
        more |= {"camera": camera_fact(camera, metric)} | self._topics.facts()
        more["image_time"] = source.time if isinstance(source, McapImageSource) else ""
        more["rate"] = str(source.stated_rate) if isinstance(source, PictureFolder) else ""
        more["auto"] = "" if found is None else " | ".join((*found.told, *found.missing))
        self._run = replace(
            run, time_source=source.time_source, video=video_note, settings_toml=settings.to_toml(),
            seeds_toml=seeds_toml(begun), more={key: text for key, text in more.items() if text},
        )  # fmt: skip
        self._statuses = {spec.name: Counter[Status]() for spec in self._specs}
        self._before: dict[str, Status] = {}
        self._latest: Frame | None = None
        self._measured: dict[str, MarkerEstimate] = {}
        self._frames = self._requests = 0

    @property
    def run_id(self) -> str:
        """The id of its run in the recording."""
        return self._run.id

    def begin(self, writer: Sink) -> McapLog:
        """Start this camera's part of the recording."""
        size_px = self._camera.width_px, self._camera.height_px
        self._log = McapLog(
            writer, camera=self._calibration, markers=self._specs, picture_px=size_px, run=self._run,
            topics=self._topics,
        )  # fmt: skip
        return self._log

    def attend(self, operator: Operator, files: ExitStack) -> None:
        """From now on a person is asked at each request."""
        source, camera, settings = self._view.source, self._camera, self._settings
        place = f"{name}/" if (name := self._view.name.strip("/")) else ""
        pictures: list[Pictures] = []

        def frame_at(index: int) -> Frame | None:
            if not pictures:  # opened when it is first asked for
                time = source.time if isinstance(source, McapImageSource) else "header"
                rate = source.stated_rate if isinstance(source, PictureFolder) else None
                opened = open_pictures(source.path, topic=source.topic or None, time=time, rate=rate)
                pictures.append(files.enter_context(opened))
            there = pictures[0]
            frame = there.frame(index) if there.first_index <= index < there.count else None
            if frame is None or self._latest is None:
                return frame
            shifted = copy(frame)
            shifted.stamp_ns += self._latest.stamp_ns - there.stamp_ns(self._latest.index)
            return shifted

        def check(answers: Sequence[Answer]) -> None:
            names = [spec.name for spec in self._specs]
            known = {(type(answer), answer.marker, answer.frame_index) for answer in self._given}
            for answer in answers:
                if (type(answer), answer.marker, answer.frame_index) in known:
                    raise UsageError(f"{answer.marker} has such an answer on frame {answer.frame_index} already")
            check_answers([*self._given, *answers], names, camera.width_px, camera.height_px)

        def plain(answer: Answer) -> Answer:
            return replace(answer, marker=answer.marker.removeprefix(place))

        def ask(asked: Asked) -> Sequence[Answer]:
            request = replace(asked.request, marker=place + asked.request.marker)
            named = replace(asked, request=request, check=lambda answers: check(list(map(plain, answers))))
            given = list(operator.ask(named))
            self.answers += given
            self._given += map(plain, given)
            return [plain(answer) for answer in given]

        known = settings.camera
        terms = Terms(
            camera, self._metric, tuple(self._specs), settings.chain, settings.session, known.exposure_s,
            known.readout_s, source.first_index, 10**9,
        )  # fmt: skip
        begun = base_seeds(self._given)
        self._attended = Attended(terms, frame_at, ask, [a for a in self._given if a not in begun])

    def steps(self, go_on: Callable[[], bool]) -> Generator[tuple[int, Callable[[], None]], None, None]:
        """For each frame the log time of its messages, which never falls, and what writes them.

        `go_on` is asked before each frame. Pictures are decoded and encoded ahead, until this is closed; live ones as
        they are due, since those that come later are newer.
        """
        source = self._view.source
        encode = self._encode or (lambda frame: None)
        waiting: deque[tuple[EncodedPicture | None, BgrImage | None]] = deque()
        overview_due = _Rate(self._output.debug_rate_hz)
        step = overlays.overview_step(source.width_px)
        stopped = False

        def frames() -> Iterator[Frame]:
            nonlocal stopped
            for frame, picture in pictures:
                if stopped := not go_on():
                    return
                full = self._output.debug_images == "full" and overview_due(frame.stamp_ns)
                waiting.append((picture, frame.reduced(step) if full else None))
                self._latest = frame
                yield frame
                if self._attended is not None and self._session.latest is not None:
                    self._attended.after(frame, self._session.latest)

        log_ns = 0
        made = ((frame, encode(frame)) for frame in source.frames())
        with closing(made if self._view.live else ahead(made)) as pictures:
            try:
                for result in self._session.run(frames()):
                    log_ns = max(log_ns, result.stamp_ns)
                    picture, overview = waiting.popleft()
                    yield log_ns, partial(self._write, result, picture, overview, step)
            except UsageError as error:
                if self._view.live:  # what was filmed does not come again
                    self._missing.append(str(error))
                elif not stopped:  # else the seeds that are left are no error
                    raise UsageError(f"{source.path}: {error}") from error

    def _write(self, result: FrameResult, picture: EncodedPicture | None, overview: BgrImage | None, step: int) -> None:
        if not self._frames:
            for note in self._notes:
                self._log.log("WARNING" if note.startswith("no camera") else "INFO", note, result.stamp_ns)
        self._frames += 1
        self._requests += len(result.requests)
        for estimate in result.estimates:
            self._statuses[estimate.marker][estimate.status] += 1
            if estimate.status.measured:
                self._measured[estimate.marker] = estimate
            if estimate.status is Status.SEEDED and estimate.reasons:
                said = f"{estimate.reasons[0]} there; is it the marker?"
                line = f"seed of {estimate.marker} on frame {estimate.frame_index}: {said}"
                self._notes.append(line)
                self._log.log("WARNING", line, estimate.stamp_ns)
            _log_change(self._log, estimate, self._before)
        self._log.write(result, picture, overview, step)

    def end(self, report: TrackReport, stamp_ns: int) -> None:
        """Finish this camera's part, and put what it did into the report; `stamp_ns` is the last log time of all."""
        name = self._view.name.strip("/")
        place = f"{name}/" if name else ""
        gone = [
            lost_marker(place, m, self._measured.get(m)) for m, status in self._before.items() if status is Status.LOST
        ]
        lost = [*self._view.lost(), *self._missing, *gone]
        for line in lost:
            self._log.log("WARNING", line, stamp_ns)
        outcome = {"frames": str(self._frames), "lost": "; ".join(lost)}
        self._log.close(outcome, complete=not report.stopped)
        report.frames += self._frames
        report.requests += self._requests
        report.statuses |= {place + marker: counts for marker, counts in self._statuses.items()}
        report.notes += [f"{name}: {note}" if name else note for note in self._notes]
        report.lost += self._missing + gone


def _by_camera(
    views: Sequence[CameraView], settings: Settings, seeds: Sequence[Answer]
) -> list[tuple[CameraView, Settings, list[Answer]]]:
    """Each camera with its markers and seeds. With several, `front/left_wrist` is a marker of camera /front."""
    if len(views) == 1:
        return [(views[0], with_seeded_markers(settings, seeds), list(seeds))]
    own: dict[str, list[Answer]] = {view.name.strip("/"): [] for view in views}
    for seed in seeds:
        camera, _, marker = seed.marker.strip("/").rpartition("/")
        if camera not in own:
            places = ", ".join(f"{name}/{marker}" for name in own)
            raise UsageError(f"seed of {seed.marker!r}: which camera? With several topics, name it as one of {places}")
        own[camera].append(replace(seed, marker=marker))
    seeded = {seed.marker for some in own.values() for seed in some}
    for m in settings.markers:
        if m.name not in seeded:
            raise UsageError(f"marker {m.name!r} has no seed on any of {', '.join(own)}")
    cameras = []
    for view, some in zip(views, own.values(), strict=True):
        if not some:
            raise UsageError(
                f"no seed for {view.source.topic}: give one, --seed {view.name.strip('/')}/MARKER@FRAME=X,Y,R"
            )
        names = {seed.marker for seed in some}
        here = settings.model_copy(update={"markers": tuple(m for m in settings.markers if m.name in names)})
        cameras.append((view, with_seeded_markers(here, some), some))
    return cameras


def with_seeded_markers(settings: Settings, seeds: Sequence[Answer]) -> Settings:
    """Settings that also list the markers only the seeds name."""
    known = [m.name for m in settings.markers]
    new = [name for name in dict.fromkeys(seed.marker for seed in seeds) if name not in known]
    if known and new:
        raise UsageError(f"seed for marker {new[0]!r}, which the settings do not list ({', '.join(known)})")
    if not known and not new:
        raise UsageError("no marker to track: give --seed NAME@FRAME=X,Y,R, or markers in a settings file and seeds")
    try:
        return settings.model_copy(update={"markers": settings.markers + tuple(MarkerSettings(name=n) for n in new)})
    except ValidationError:
        raise UsageError(f"marker {new[0]!r}: a name has letters, digits and underscores only") from None


_PICTURE_TOPICS: dict[str, Literal["video", "image"]] = {"h264": "video", "jpeg": "image"}
"""Beside pictures that are copied we only write others when they are asked for by name."""

PictureMaker = Callable[[Frame], EncodedPicture | None]


def _picture_maker(settings: Settings, view: CameraView) -> tuple[PictureMaker | None, str]:
    """How a frame becomes the picture that viewers show (None: we write none), and a line that says so."""
    kind, source = settings.output.video, view.source
    if kind == "none":
        return None, "no video written as asked"
    if kind == "jpeg":
        return jpeg_encode, "video written as JPEG pictures as asked"
    if kind == "h264":
        return H264Encoder(rate_hint=source.stated_rate).encode, "video encoded as H.264 as asked"
    if view.copied:
        return None, f"pictures of {source.topic} copied as they are"
    reason = source.passthrough_reason
    if reason is None:
        return (lambda frame: frame.encoded), f"video passed through as recorded ({source.codec})"
    if kind == "passthrough":
        raise UsageError(f"{source.path}: --video passthrough: {reason}; use --video auto to encode it once")
    return H264Encoder(rate_hint=source.stated_rate).encode, f"video encoded once as H.264: {reason}"


class _Rate:
    """True at most so many times a second of recording time."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = int(NS_PER_S / rate_hz)
        self._next_ns: int | None = None

    def __call__(self, stamp_ns: int) -> bool:
        if self._next_ns is not None and stamp_ns < self._next_ns:
            return False
        self._next_ns = stamp_ns + self._period_ns
        return True


def _view_keeper(settings: Settings) -> Callable[[MarkerEstimate], bool]:
    """Which estimates get a debug picture: at once where a doubt begins (but for one in the last period), some of it,
    and few while nothing is doubted."""
    output = settings.output
    if output.debug_images == "none":
        return lambda estimate: False
    usual = {m.name: _Rate(output.debug_rate_hz * _UNDOUBTED) for m in settings.markers}
    doubted = {m.name: _Rate(output.debug_rate_hz) for m in settings.markers}

    def keep(estimate: MarkerEstimate) -> bool:
        lane = usual if estimate.status.measured and not estimate.reasons else doubted
        return lane[estimate.marker](estimate.stamp_ns)

    return keep


def _log_change(log: McapLog, estimate: MarkerEstimate, before: dict[str, Status]) -> None:
    """A log line whenever a marker is lost, leaves, or is found again; not for every estimated frame."""
    name, status = estimate.marker, estimate.status
    was = before.get(name)
    before[name] = status
    if status is was or status is Status.ESTIMATED:
        if status is Status.ESTIMATED and was in (Status.LOST, Status.OUT_OF_VIEW):
            before[name] = was
        return
    at = f"frame {estimate.frame_index}, {format_time(estimate.stamp_ns)}"
    if status is Status.LOST:
        log.log("WARNING", f"{name} lost at {at}", estimate.stamp_ns)
    elif status is Status.OUT_OF_VIEW:
        log.log("INFO", f"{name} left the picture at {at}", estimate.stamp_ns)
    elif was in (Status.LOST, Status.OUT_OF_VIEW):
        log.log("INFO", f"{name} found again at {at}", estimate.stamp_ns)


def analyse(
    recording: str | os.PathLike[str],
    output: str | os.PathLike[str],
    settings: AnalysisSettings | None = None,
    *,
    folder: Path = Path(),
    fill_ms: float = 0.0,
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> AnalysisReport:
    """Find strokes, angles and lengths in a tracked or merged recording, and write it again with them beside the rest.

    The output has every message of the recording as it is. Tables and a page for the session are written beside it
    (`AnalysisReport.files`). `folder` is where relative paths in the settings start. Where a marker was not measured
    nothing is told that needs it, but in gaps of at most `fill_ms`, which the smoothed path then stands in for, marked
    as such. What could not be had is in the report's notes. Raises SpheremcapError.
    """
    return analysing.analyse(
        Path(recording), Path(output), settings or AnalysisSettings(), folder=folder, fill_ms=fill_ms, inputs=inputs,
        overwrite=overwrite, progress=progress, stop=stop,
    )  # fmt: skip
