"""spheremcap track: a video in, an annotated recording out."""

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from spheremcap.cli.layout import NoLayout, beside
from spheremcap.cli.progress import bar, loaded, stopped
from spheremcap.cli.said import warn
from spheremcap.core.time import parse_time_ns
from spheremcap.errors import UsageError, short
from spheremcap.interrupt import Interrupt, Interrupted

if TYPE_CHECKING:
    from rich.progress import Progress

    from spheremcap.api import Operator
    from spheremcap.config import Settings
    from spheremcap.core.marker import Answer, Seed
    from spheremcap.found import Found
    from spheremcap.operator.answers import AnswerFile
    from spheremcap.operator.attending import Attending
    from spheremcap.operator.terminal import Terminal
    from spheremcap.proposals import Proposal

_MCAP = "MCAP input"
_NO_TIME = "is neither ISO 8601 such as 2025-06-01T10:00:00Z nor Unix seconds"


def track(
    source: Annotated[
        Path,
        typer.Argument(
            help="Session video: anything FFmpeg reads; a list of several (.ffconcat); a folder of pictures; an MCAP "
            "with pictures."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="The MCAP to write.")],
    settings: Annotated[
        Path | None,
        typer.Option("--settings", "-s", help="TOML with markers, camera and all else; see `config show`."),
    ] = None,
    seeds: Annotated[
        Path | None,
        typer.Option(
            "--seeds", help="TOML with the seeds: marker, frame, x_px, y_px, r_px of each; and other answers."
        ),
    ] = None,
    seed: Annotated[
        list[str] | None, typer.Option("--seed", help="MARKER@FRAME=X,Y,R in pixels; as often as needed.")
    ] = None,
    auto: Annotated[
        bool,
        typer.Option(
            "--auto",
            help="Look in the first seconds for the markers that no seed names: by the colours in the settings, or all "
            "coloured spheres.",
        ),
    ] = False,
    diameter: Annotated[
        str | None,
        typer.Option("--diameter", help="True diameter of the markers that only seeds name. (by default 4 cm)"),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option("--camera", help="Preset name or ROS camera_info YAML; see `config presets`."),
    ] = None,
    start_time: Annotated[
        str | None,
        typer.Option("--start-time", help="Time of the first picture: ISO 8601 (UTC) or Unix seconds."),
    ] = None,
    rate: Annotated[str | None, typer.Option("--rate", help="Pictures a second of a folder, as in 240.")] = None,
    video: Annotated[
        Literal["auto", "passthrough", "h264", "jpeg", "none"] | None,
        typer.Option("--video", help="How pictures go into the MCAP. (by default auto)"),
    ] = None,
    debug_images: Annotated[
        Literal["none", "crops", "full"] | None,
        typer.Option("--debug-images", help="Pictures of why a frame was doubted. (by default crops)"),
    ] = None,
    operator: Annotated[
        Literal["none", "terminal", "page"],
        typer.Option("--operator", help="Who is asked where a marker is lost; tracking waits for the answer."),
    ] = "none",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
    no_layout: NoLayout = False,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            "--topic",
            rich_help_panel=_MCAP,
            help="Image topic; need not be named when there is one. Several are one camera each, "
            "and the markers' names then begin with the camera's: front/left_wrist is on /front/image.",
        ),
    ] = None,
    time: Annotated[
        Literal["header", "log", "publish"] | None,
        typer.Option(
            "--time",
            rich_help_panel=_MCAP,
            help="Which time of the messages is the picture's. (by default header)",
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            rich_help_panel=_MCAP,
            help="Track from here: seconds after the first picture, ISO 8601 or Unix seconds.",
        ),
    ] = None,
    end: Annotated[
        str | None, typer.Option("--end", rich_help_panel=_MCAP, help="Track up to here, in the same way.")
    ] = None,
    copy: Annotated[
        Literal["all", "images", "none"] | None,
        typer.Option(
            "--copy",
            rich_help_panel=_MCAP,
            help="What of the input goes into the output, byte for byte. (by default all)",
        ),
    ] = None,
) -> None:
    """Track markers through a video and write every circle, pose and vote into an MCAP.

    A marker's first seed is where its track begins. Each later one corrects it: when all is tracked, the marker is
    followed from there both ways in time until it meets the track, as `spheremcap retrack` does it afterwards.

    With --auto nobody has to seed: what was taken for which marker, why, and what was left is said and stands in the
    recording. What cannot be told apart is listed as seeds to choose from.

    Without a settings file the seeds name the markers and each is taken for 4 cm across, unless --diameter says
    otherwise. A folder's pictures are taken in the order of their numbers. An MCAP goes into the
    output as it is, with our channels beside its pictures.
    """
    from spheremcap import api
    from spheremcap.config import Settings, load_settings, with_camera, with_diameter
    from spheremcap.io.output import checked_output
    from spheremcap.io.sources import FromMcap

    loaded()
    chosen = load_settings(settings) if settings is not None else Settings()
    if camera is not None:
        chosen = with_camera(chosen, camera)
    told = {"video": video, "debug_images": debug_images}
    changes = {key: value for key, value in told.items() if value is not None}
    chosen = chosen.model_copy(update={"output": chosen.output.model_copy(update=changes)})
    given = answers_of(seeds, seed)
    mcap = None
    if any(flag is not None for flag in (topic, time, start, end, copy)):
        mcap = FromMcap(
            tuple(topic or ()), time or "header",
            time_ns("--start", start), time_ns("--end", end), copy or "all",
        )  # fmt: skip
    folder, inputs = (
        settings.parent if settings is not None else Path(),
        [p for p in (settings, seeds) if p is not None],
    )
    start_ns, hertz = time_ns("--start-time", start_time), rate_of(rate)
    with Interrupt() as interrupted, bar() as shown:
        found = None
        if auto:
            checked_output(output, [source, *inputs], overwrite=overwrite)
            task = shown.add_task("looking for markers", total=None)
            found = api.find(
                source, chosen, given, folder=folder, start_time_ns=start_ns, rate=hertz, mcap=mcap,
                progress=lambda done, total: shown.update(task, completed=done, total=total), stop=interrupted,
            )  # fmt: skip
            shown.remove_task(task)
            if interrupted():
                raise Interrupted("interrupted while looking for markers; nothing was written")
            _clear(found)
            chosen, given = found.settings, [*given, *found.seeds]
        if diameter is not None:
            chosen = with_diameter(chosen, given, diameter)
        task = shown.add_task("tracking", total=None)
        asked = _seeds_file(seeds, output, given) if operator != "none" else None
        with ExitStack() as attending:
            person: Operator | None = None
            if asked is not None and operator == "terminal":
                person = _terminal(asked, output, shown, interrupted)
            elif asked is not None:
                person = attending.enter_context(_page(source, chosen, settings, asked, topic, hertz, interrupted))
            report = api.track(
                source, output, chosen, given,
                folder=folder, inputs=[*inputs, *([asked.path] if asked else [])], overwrite=overwrite,
                start_time_ns=start_ns, rate=hertz, mcap=mcap, found=found, operator=person,
                progress=lambda done, total: shown.update(task, completed=done, total=total),
                stop=interrupted,
            )  # fmt: skip
    for note in report.notes:
        warn(note)
    for name, counts in report.statuses.items():
        parts = ", ".join(
            f"{count} {status.value.lower()}" for status, count in sorted(counts.items(), key=lambda i: -i[1])
        )
        print(f"{name}: {parts}")
    if report.requests:
        print(f"{report.requests} request{'s' * (report.requests != 1)} for a person: see `spheremcap info {output}`")
    for line in report.lost:
        warn(line)
    if report.stopped:
        raise stopped(f"{report.frames} frames", report.part)
    print(f"{report.frames} frames -> {output}")
    beside(output, not no_layout, overwrite)
    if not report.complete:
        raise typer.Exit(3)


def _clear(found: "Found") -> None:
    """Prints the seeds to choose from where several things may be a marker. Raises UsageError there."""
    from spheremcap.found import as_seed

    alike: dict[tuple[Proposal, ...], list[str]] = {}
    for name, rivals in found.unclear:
        alike.setdefault(rivals, []).append(name)
    for rivals, names in alike.items():
        if len(names) > 1:
            print(f"# NAME is one of {', '.join(names)}")
        for rival in rivals:
            print(f"--seed {as_seed(names[0] if len(names) == 1 else 'NAME', rival)}  # {rival.reason}")
    if found.unclear:
        told = ", ".join(name for name, _ in found.unclear)
        raise UsageError(f"--auto cannot tell which is {told}: add one of the listed seeds for each to the command")


def answers_of(seeds: Path | None, texts: list[str] | None) -> "list[Answer]":
    """What a person said, in a file and on the command line."""
    from spheremcap.config import load_seeds

    return [*(load_seeds(seeds) if seeds is not None else []), *(_seed(text) for text in texts or [])]


def _seeds_file(seeds: Path | None, output: Path, given: "list[Answer]") -> "AnswerFile":
    """Where answers are written while a run goes on, behind all that was given before."""
    from spheremcap.operator.answers import AnswerFile

    path = seeds or output.with_suffix(".seeds.toml")
    if seeds is None and path.exists():
        raise UsageError(f"{path} exists already: give it as --seeds, or move it away")
    answers = AnswerFile(path, given)
    for answer in given:  # those that are not in the file yet
        if answer not in answers.answers():
            answers.put(answer)
    return answers


def _terminal(answers: "AnswerFile", output: Path, shown: "Progress", interrupted: Interrupt) -> "Terminal":
    """Whoever sits at the terminal; the bar is away while they are asked."""
    from spheremcap.cli.annotate import login
    from spheremcap.operator.terminal import Terminal, read_line

    @contextmanager
    def alone() -> Iterator[None]:
        shown.stop()
        yield
        shown.start()

    return Terminal(answers, output, login(), alone, lambda: read_line(interrupted))


def _page(
    source: Path, chosen: "Settings", settings: Path | None, answers: "AnswerFile", topic: list[str] | None,
    rate: Fraction | None, interrupted: Interrupt,
) -> "Attending":  # fmt: skip
    """Whoever answers on the page, which opens at the first question."""
    from spheremcap.cli.annotate import login
    from spheremcap.cli.extras import needed

    with needed("--operator page", "operator"):
        from spheremcap.operator.attending import Attending
    from spheremcap.operator.opened import Opened
    from spheremcap.operator.page import Page

    if topic is not None and len(topic) > 1:
        raise UsageError("--operator page shows one camera: name one --topic")
    opened = Opened(
        source, seeds=answers.path, settings=settings, topic=topic[0] if topic else None, rate=rate, attended=chosen
    )
    say = partial(print, file=sys.stderr, flush=True)
    return Attending(Page(opened, login()), say, interrupted, show="CI" not in os.environ)


def time_ns(flag: str, text: str | None) -> int | None:
    """Nanoseconds of a flag's time. Raises UsageError for what is none."""
    if text is None:
        return None
    try:
        stamp_ns = parse_time_ns(text)
    except ValueError:
        raise UsageError(f"{flag} {short(text)} {_NO_TIME}") from None
    if not 0 <= stamp_ns < 1 << 63:
        raise UsageError(f"{flag} {short(text)} is before 1970 or after 2262, a time that a recording cannot hold")
    return stamp_ns


def rate_of(text: str | None) -> Fraction | None:
    if text is None:
        return None
    try:
        if len(text) < 40 and Fraction(1, 1000) <= (rate := Fraction(text)) <= 1_000_000:
            return rate
    except (ValueError, ZeroDivisionError):
        pass
    raise UsageError(f"--rate {short(text)}: expected pictures a second, 0.001 to 1000000, as in --rate 240")


def _seed(text: str) -> "Seed":
    """A seed whose marker may have its camera before it: `front/left_wrist@0=812,430,24`."""
    from spheremcap.config import parse_seed

    camera, _, rest = text.strip().rpartition("/")
    seed = parse_seed(rest)
    return replace(seed, marker=f"{camera}/{seed.marker}") if camera else seed
