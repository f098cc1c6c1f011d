"""spheremcap synth: render a session with exact truth."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import bar, loaded
from spheremcap.cli.said import warn
from spheremcap.errors import UsageError


def synth(
    scenario: Annotated[str, typer.Argument(help="Which one; `list` prints them all.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Folder to write, made when missing.")] = None,
    frames: Annotated[int | None, typer.Option("--frames", min=2, help="How many frames instead of its own.")] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Another draw of the same scenario.")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Write into a folder that has a session.")] = False,
) -> None:
    """Render a racing session with exact truth: session.mp4, truth.csv, settings.toml and seeds.toml.

    Scenarios of strokes (strokes, strokes-fast, ...) have events.csv (contacts and releases), wheel.csv (an encoder,
    for merge) and analysis.toml (wheels and mount) besides. They are also filmed at 120 and 60 frames/s: strokes@120.
    """
    from spheremcap.synth import describe, known, names, render, stroke_names

    loaded()
    if scenario == "list":
        for name in (*names(), *stroke_names()):
            typer.echo(f"{name:20s} {describe(name)}")
        return
    if not known(scenario):
        raise UsageError(f"unknown scenario {scenario!r}; there are: {', '.join((*names(), *stroke_names()))}")
    if output is None:
        raise UsageError("give the folder to write with -o")
    with bar() as progress:
        task = progress.add_task("rendering", total=frames)
        session = render(
            scenario, output, seed=seed, frames=frames, overwrite=overwrite,
            progress=lambda done, total: progress.update(task, completed=done, total=total),
        )  # fmt: skip
    for note in session.notes:
        warn(note)
    print(f"{session.frames} frames -> {session.video}, truth in {session.truth}")
