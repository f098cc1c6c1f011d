"""The jobs of spheremcap as functions: track a video into a recording. Wires io to the session."""

import hashlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from spheremcap.config import CameraSettings, MarkerSettings, Settings, seeds_toml
from spheremcap.core.camera import Camera
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.frame import BgrImage, EncodedPicture, Frame
from spheremcap.core.marker import Seed
from spheremcap.core.presets import PRESETS, assumed_camera
from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.errors import UsageError
from spheremcap.io.camera_file import read_camera_info
from spheremcap.io.encode import H264Encoder, jpeg_encode
from spheremcap.io.mcap_log import McapLog, RunInfo
from spheremcap.io.video import VideoSource
from spheremcap.session import Session


@dataclass
class TrackReport:
    """What `track` did: frames read, statuses per marker, what was lost, and what the user should know."""

    output: Path
    frames: int = 0
    statuses: dict[str, Counter[Status]] = field(default_factory=dict)
    requests: int = 0
    lost: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stopped: bool = False

    @property
    def complete(self) -> bool:
        """Nothing was lost: every frame decoded, and no marker lost at the end."""
        return not self.lost and not self.stopped


Progress = Callable[[int, int | None], None]
"""Called with frames done and frames expected (None when the container does not say)."""


def resolve_camera(settings: CameraSettings, width_px: int, height_px: int, folder: Path) -> tuple[Camera, bool, str]:
    """The camera for pictures of this size, whether its metres may be given out, and a note for the user.

    A calibration for another size of the same shape is scaled. Raises UsageError for an unknown preset or a camera
    of another shape.
    """
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
    elif (width_px, height_px) == (1280, 720):
        camera = PRESETS["gopro-hero4-black-720p240-narrow"]
        note = (
            "no camera given: 1280x720 is taken for gopro-hero4-black-720p240-narrow, "
            "so distances are good to 3 % only if that is true; give --camera"
        )
    else:
        note = "no camera given: circles are written, positions in metres are not; give --camera"
        return assumed_camera(width_px, height_px), False, note
    if (camera.width_px, camera.height_px) != (width_px, height_px):
        if abs(camera.width_px * height_px - camera.height_px * width_px) > max(width_px, height_px):
            raise UsageError(
                f"the camera is for {camera.width_px}x{camera.height_px}, the pictures are {width_px}x{height_px}: "
                "another shape, so another calibration is needed"
            )
        note += f"; scaled from {camera.width_px}x{camera.height_px}"
        camera = camera.scaled(width_px, height_px)
    return camera, True, note


def track(
    source_path: Path,
    output: Path,
    settings: Settings,
    seeds: Sequence[Seed],
    *,
    folder: Path = Path(),
    overwrite: bool = False,
    start_time_ns: int | None = None,
    progress: Progress = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> TrackReport:
    """Track every marker through a video and write the annotated recording.

    Markers that only the seeds name get the default diameter. `folder` is where relative paths in the settings start;
    `stop` is asked before every frame and ends the recording there, readable under OUT.part. Raises SpheremcapError.
    """
    settings = _with_seeded_markers(settings, seeds)
    if not settings.markers:
        raise UsageError("no marker to track: give --seed NAME@FRAME=X,Y,R, or markers in a settings file and seeds")
    report = TrackReport(output)
    with VideoSource(source_path, start_time_ns=start_time_ns, packets=settings.output.video in ("auto", "passthrough")) as source:
        last = source.frame_count_hint
        for seed in seeds:
            if last is not None and seed.frame_index >= last:
                raise UsageError(f"seed of {seed.marker} on frame {seed.frame_index}: {source_path} has {last} frames (0 to {last - 1})")
        camera, metric, camera_note = resolve_camera(settings.camera, source.width_px, source.height_px, folder)
        encode, video_note = _picture_maker(settings, source)
        report.notes += [camera_note, video_note]
        specs = [m.spec() for m in settings.markers]
        statuses = {spec.name: Counter[Status]() for spec in specs}
        report.statuses = statuses
        session = Session(
            camera, specs, seeds, settings.chain, settings.session,
            exposure_s=settings.camera.exposure_s, metric=metric, keep_view=_view_keeper(settings),
        )  # fmt: skip
        size, digest = _fingerprint(source_path)
        run = RunInfo(
            source_path.name, size, digest, source.start_time_source, video_note,
            settings.to_toml(), seeds_toml(list(seeds)), {"camera_note": camera_note},
        )  # fmt: skip
        waiting: deque[tuple[EncodedPicture | None, BgrImage | None]] = deque()
        overview_due = _Rate(settings.output.debug_rate_hz)
        step = max(1, round(source.width_px / 640))

        def frames() -> Iterator[Frame]:
            for frame in source.frames():
                if stop():
                    report.stopped = True
                    return
                full = settings.output.debug_images == "full" and overview_due(frame.stamp_ns)
                waiting.append((encode(frame), frame.reduced(step) if full else None))
                progress(frame.index + 1, last)
                yield frame

        with McapLog(
            output, camera=camera if metric else None, markers=specs, run=run,
            overwrite=overwrite, compression=settings.output.compression,
        ) as log:  # fmt: skip
            for note in report.notes:
                log.log("WARNING" if note.startswith("no camera") else "INFO", note, source.start_time_ns)
            before: dict[str, Status] = {}
            stamp_ns = source.start_time_ns
            for result in session.run(frames()):
                stamp_ns = result.stamp_ns
                report.frames += 1
                report.requests += len(result.requests)
                for estimate in result.estimates:
                    statuses[estimate.marker][estimate.status] += 1
                    _log_change(log, estimate, before)
                picture, overview = waiting.popleft()
                log.write(result, picture, overview, step)
            report.lost += source.lost.lines() if source.lost else []
            report.lost += [
                f"{name} is {status.value} at the end" for name, status in before.items() if status is Status.LOST
            ]
            for line in report.lost:
                log.log("WARNING", line, stamp_ns)
            log.close({"frames": str(report.frames), "lost": "; ".join(report.lost)}, complete=not report.stopped)
    return report


def _with_seeded_markers(settings: Settings, seeds: Sequence[Seed]) -> Settings:
    """Settings that also list the markers only the seeds name."""
    known = [m.name for m in settings.markers]
    new = [name for name in dict.fromkeys(seed.marker for seed in seeds) if name not in known]
    if known and new:
        raise UsageError(f"seed for marker {new[0]!r}, which the settings do not list ({', '.join(known)})")
    return settings.model_copy(update={"markers": settings.markers + tuple(MarkerSettings(name=n) for n in new)})


def _picture_maker(settings: Settings, source: VideoSource) -> tuple[Callable[[Frame], EncodedPicture | None], str]:
    """How a frame becomes the picture that viewers show, and a line that says so."""
    kind = settings.output.video
    if kind in ("auto", "passthrough"):
        reason = source.passthrough_reason
        if reason is None:
            return (lambda frame: frame.encoded), f"video passed through as recorded ({source.codec})"
        if kind == "passthrough":
            raise UsageError(f"--video passthrough: {reason}; use --video auto to encode it once")
        return H264Encoder(rate_hint=source.stated_rate).encode, f"video encoded once as H.264: {reason}"
    if kind == "h264":
        return H264Encoder(rate_hint=source.stated_rate).encode, "video encoded as H.264 as asked"
    if kind == "jpeg":
        return jpeg_encode, "video written as JPEG pictures as asked"
    return (lambda frame: None), "no video written as asked"


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
    """Which estimates get a debug picture: some of all, and as many again of those that were not verified."""
    if settings.output.debug_images == "none":
        return lambda estimate: False
    rate = settings.output.debug_rate_hz
    usual = {m.name: _Rate(rate) for m in settings.markers}
    doubted = {m.name: _Rate(rate) for m in settings.markers}

    def keep(estimate: MarkerEstimate) -> bool:
        lane = usual if estimate.status.measured else doubted
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


def _fingerprint(path: Path) -> tuple[int, str]:
    """Size in bytes and SHA-256 of a file."""
    with path.open("rb") as file:
        return path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()
