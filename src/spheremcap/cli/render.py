"""spheremcap render: a recording as a video with circles, names and numbers burnt in."""

import sys
from fractions import Fraction
from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import bar, loaded
from spheremcap.cli.said import warn
from spheremcap.cli.selection import From, Markers, To, selection
from spheremcap.interrupt import Interrupt


def render(
    recording: Annotated[Path, typer.Argument(help="An MCAP that `track` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="marked.mp4 or marked.mkv")],
    crop: Annotated[str, typer.Option("--crop", metavar="MARKER", help="A cut-out that follows this marker.")] = "",
    slow: Annotated[float, typer.Option("--slow", min=0.01, max=1000, help="So many times slower.")] = 1.0,
    marker: Markers = None,
    start: From = None,
    end: To = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
) -> None:
    """Write the pictures with circles, names, trails of a second, status, votes, distance and time, as H.264.

    A circle is thick where it was measured and thin where the filter stands in. Ctrl-C ends the video there.

        spheremcap render session.mcap -o marked.mp4 --crop left_wrist --slow 8 --from 2.5 --to 4
    """
    from spheremcap.io.marked import render as rendered

    loaded()
    wanted = selection(marker, start, end)
    with Interrupt() as interrupted, bar() as shown:
        task = shown.add_task("rendering", total=None)
        done = rendered(
            recording, output, wanted=wanted, crop=crop, slow=Fraction(slow).limit_denominator(1000),
            overwrite=overwrite, stop=interrupted,
            progress=lambda done, total: shown.update(task, completed=done, total=total),
        )  # fmt: skip
    for note in done.notes:
        warn(note)
    print(f"{done.pictures} pictures -> {output}")
    if interrupted():
        print("spheremcap: interrupted: the video ends there", file=sys.stderr)
        raise typer.Exit(1)
