"""Writes a rendered session to a folder: the video, its truth, settings and seeds."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import tomli_w

from spheremcap.core.circle import Circle
from spheremcap.core.marker import Seed
from spheremcap.io.output import make_folder, whole_file
from spheremcap.synth.catalogue import rendered
from spheremcap.synth.truth import Container, MarkerTruth

TRUTH_COLUMNS = (
    "frame", "stamp_ns", "marker", "x_px", "y_px", "r_px",
    "ellipse_x_px", "ellipse_y_px", "ellipse_a_px", "ellipse_b_px", "ellipse_angle_rad",
    "x_cam_m", "y_cam_m", "z_cam_m", "vx", "vy", "vz", "visible", "in_picture", "centre_x_px", "centre_y_px",
)  # fmt: skip
_CLICK_PX = 0.7


@dataclass(frozen=True, slots=True)
class SynthSession:
    """Where a rendered session's files are, and the seeds that a person would have given."""

    scenario: str
    folder: Path
    video: Path
    truth: Path
    settings: Path
    seeds_file: Path
    seeds: tuple[Seed, ...]
    frames: int
    notes: tuple[str, ...] = ()


def render(
    scenario: str,
    folder: Path | str,
    *,
    seed: int = 0,
    frames: int | None = None,
    megabits: float | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SynthSession:
    """Render a scenario into `folder` (made if missing): session.mp4, truth.csv, settings.toml, seeds.toml; of strokes
    also events.csv, wheel.csv and analysis.toml (`ride`).

    The same scenario, seed, frames and megabits (Mbit/s at 240 frames/s; None: the scenario's own) give the
    same bytes. `progress` is called with (frames done, frames in all). truth.csv has the columns
    `TRUTH_COLUMNS`, a row per frame and marker, in pixels, metres, m/s and radians, empty where there is no
    value; what instant it is of is said in `scene`. Raises KeyError for an unknown scenario, UsageError when one of the
    files exists and `overwrite` is False, OutputError when they cannot be written.
    """
    scene = rendered(scenario, seed=seed, frames=frames)
    container = scene.container
    folder = Path(folder)
    make_folder(folder)
    video, truth, settings, seeds_file = (
        folder / name for name in ("session.mp4", "truth.csv", "settings.toml", "seeds.toml")
    )
    seeds: dict[str, Seed] = {}
    clicks = np.random.default_rng([seed, 40_961])
    with ExitStack() as files:
        # The seeds are the first to be begun and so the last to be there: with them the session is complete.
        begun = [
            files.enter_context(whole_file(path, overwrite=overwrite)) for path in (seeds_file, settings, truth, video)
        ]
        more = {name: files.enter_context(whole_file(folder / name, overwrite=overwrite)) for name in scene.beside}
        begun += more.values()
        parts = [part.path for part in begun]
        with (
            encoder(parts[3], container, megabits) as write,
            parts[2].open("w", encoding="utf-8", newline="\n") as table,
        ):
            table.write(",".join(TRUTH_COLUMNS) + "\n")
            for index, (picture, stamp_ns, truths) in enumerate(scene.frames()):
                write(scene.planes(picture), container.ticks[index])
                for marker in truths:
                    table.write(truth_row(index, stamp_ns, marker) + "\n")
                    if marker.marker not in seeds and marker.circle is not None and marker.visible >= container.clear:
                        seeds[marker.marker] = Seed(marker.marker, index, _click(marker.circle, clicks))
                if progress is not None:
                    progress(index + 1, len(scene))
        for name, text in scene.beside.items():
            more[name].path.write_text(text, encoding="utf-8", newline="\n")
        given = tuple(seeds[name] for name, _ in container.markers if name in seeds)
        parts[1].write_text(settings_toml(container), encoding="utf-8", newline="\n")
        parts[0].write_text(seeds_toml(given), encoding="utf-8", newline="\n")
    notes = tuple(note for part in begun for note in part.notes)
    return SynthSession(scenario, folder, video, truth, settings, seeds_file, given, len(scene), notes)


def truth_row(index: int, stamp_ns: int, truth: MarkerTruth) -> str:
    """One line of truth.csv."""
    numbers: list[float | None] = [None] * 8
    centre: tuple[float | None, float | None] = (None, None)
    if truth.circle is not None and truth.ellipse is not None:
        c, e = truth.circle, truth.ellipse
        numbers = [c.x_px, c.y_px, c.r_px, e.x_px, e.y_px, e.a_px, e.b_px, e.angle_rad]
        centre = truth.centre_px or centre
    cells = [str(index), str(stamp_ns), truth.marker]
    cells += [_number(x, 5) for x in numbers]
    cells += [_number(x, 7) for x in truth.xyz_cam_m] + [_number(x, 5) for x in truth.velocity_cam_mps]
    cells += [_number(truth.visible, 4), str(int(truth.in_picture)), *(_number(x, 5) for x in centre)]
    return ",".join(cells)


def settings_toml(container: Container) -> str:
    """The settings of a session: its camera and its markers."""
    c = container.camera
    camera = {
        "width_px": c.width_px, "height_px": c.height_px, "fx_px": c.fx_px, "fy_px": c.fy_px, "cx_px": c.cx_px,
        "cy_px": c.cy_px, "model": c.model, "distortion": list(c.distortion),
        "exposure_s": float(f"{container.exposure_s:.9g}"), "readout_s": float(f"{container.readout_s:.9g}"),
    }  # fmt: skip
    markers = [tomli_w.dumps({"name": name, "diameter_m": diameter_m}) for name, diameter_m in container.markers]
    return tomli_w.dumps({"camera": camera}) + "".join(f"\n[[markers]]\n{marker}" for marker in markers)


def seeds_toml(seeds: tuple[Seed, ...]) -> str:
    """Seeds as a readable file."""
    rows = [
        {"marker": s.marker, "frame": s.frame_index} | dict(zip(("x_px", "y_px", "r_px"), s.circle, strict=True))
        for s in seeds
    ]
    return "\n".join("[[seeds]]\n" + tomli_w.dumps(row) for row in rows)


def _click(circle: Circle, rng: np.random.Generator) -> Circle:
    """What a person clicks: off by up to 0.7 px in each number, and in whole pixels."""
    dx, dy, dr = rng.uniform(-_CLICK_PX, _CLICK_PX, 3)
    return Circle(
        float(round(circle.x_px + dx)), float(round(circle.y_px + dy)), float(max(1, round(circle.r_px + dr)))
    )


def _number(value: float | None, digits: int) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.{digits}f}"


@contextmanager
def encoder(
    path: Path, written: Container, megabits: float | None = None
) -> Iterator[Callable[[npt.NDArray[np.uint8], int], None]]:
    """An H.264 file as an action camera writes it; call the result with (4:2:0 planes, container ticks).

    High profile, BT.709 limited range, where chroma lies left unsaid, no B-frames, a key frame every 60
    frames, and no looking ahead. The bit rate is `megabits` Mbit/s (None: the session's own) at 240 frames/s
    and falls with the frame rate as the bits of a frame stay.
    """
    import av

    ticks = np.diff(written.ticks) if len(written.ticks) > 1 else np.array([1001])
    rate = 1 / (written.time_base * int(np.median(ticks)))
    container = av.open(str(path), "w", format="mp4", options={"fflags": "+bitexact", "movflags": "+faststart"})
    stream = container.add_stream("libx264", rate=rate)
    context = stream.codec_context
    stream.width, stream.height, stream.pix_fmt = written.camera.width_px, written.camera.height_px, "yuv420p"
    context.time_base = stream.time_base = written.time_base
    context.bit_rate = round((written.megabits if megabits is None else megabits) * 1e6 * float(rate) / 240)
    context.gop_size, context.max_b_frames, context.thread_count = 60, 0, 1
    context.color_range, context.colorspace = (
        av.video.reformatter.ColorRange.MPEG,
        av.video.reformatter.Colorspace.ITU709,
    )
    context.color_primaries, context.color_trc = 1, 1
    if written.sample_aspect is not None:
        context.sample_aspect_ratio = written.sample_aspect
    context.options = {"preset": "superfast", "profile": "high", "flags": "+bitexact"}

    def write(planes: npt.NDArray[np.uint8], pts: int) -> None:
        frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        frame.pts, frame.time_base = pts, written.time_base
        frame.color_range, frame.colorspace = context.color_range, context.colorspace
        container.mux(stream.encode(frame))

    try:
        yield write
        container.mux(stream.encode(None))
    finally:
        container.close()
