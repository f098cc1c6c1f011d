"""spheremcap retrack: a person's answers into a recording that was tracked without them."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.layout import NoLayout, beside
from spheremcap.cli.progress import bar, loaded, stopped
from spheremcap.cli.said import warn
from spheremcap.cli.track import answers_of
from spheremcap.interrupt import Interrupt


def retrack(
    recording: Annotated[Path, typer.Argument(help="What `spheremcap track` or `retrack` wrote; it stays.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The MCAP to write.")],
    seeds: Annotated[
        Path | None,
        typer.Option(
            "--seeds", help="TOML with all that a person said: circles, what is hidden from-to, what is kept."
        ),
    ] = None,
    seed: Annotated[
        list[str] | None, typer.Option("--seed", help="MARKER@FRAME=X,Y,R in pixels; as often as needed.")
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option("--source", help="What was tracked, where it is no longer beside the recording."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
    no_layout: NoLayout = False,
) -> None:
    """Track again only what answers change, and copy every other message as it is.

    The first circle of a marker is where its track began; each later one is followed both ways in time, until it meets
    the track that was there. What is written is what `track` makes of the same seeds at once. An answer that is no
    longer among the seeds is taken back.

        spheremcap retrack session.mcap --seeds seeds.toml -o session2.mcap
    """
    from spheremcap import api

    loaded()
    given = answers_of(seeds, seed)
    with Interrupt() as interrupted, bar() as shown:
        task = shown.add_task("tracking again", total=None)
        report = api.retrack(
            recording, output, given, source=source, inputs=[seeds] if seeds is not None else [], overwrite=overwrite,
            progress=lambda done, total: shown.update(task, completed=done, total=total), stop=interrupted,
        )  # fmt: skip
    for line in (*report.notes, *report.lost):
        warn(line)
    if report.stopped:
        raise stopped(f"{report.frames} frames", report.part)
    for line in report.stretches:
        print(line)
    if report.requests:
        print(f"{report.requests} request{'s' * (report.requests != 1)} still open: see `spheremcap info {output}`")
    print(f"{report.frames} frames tracked again -> {output}")
    beside(output, not no_layout, overwrite)
    if not report.complete:
        raise typer.Exit(3)
