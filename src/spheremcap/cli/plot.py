"""spheremcap plot: the tracks of a recording as pictures."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import loaded
from spheremcap.cli.selection import From, Markers, To, selection


def plot(
    recording: Annotated[Path, typer.Argument(help="An MCAP that `track` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The folder to write into.")],
    marker: Markers = None,
    start: From = None,
    end: To = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace outputs that exist.")] = False,
) -> None:
    """Plot every marker's position, speed, votes and status over time: MARKER.png and MARKER.svg in a folder.

    Points are measured, lines smoothed. Needs the extra `report`.
    """
    from spheremcap.io.plots import write_plots

    loaded()
    for path in write_plots(recording, output, wanted=selection(marker, start, end), overwrite=overwrite):
        print(path)
