"""spheremcap export: the tracks of a recording as a table."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import loaded
from spheremcap.cli.said import warn
from spheremcap.cli.selection import From, Markers, To, selection


def export(
    recording: Annotated[Path, typer.Argument(help="An MCAP that `track` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="tracks.csv or tracks.parquet")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
    excel: Annotated[
        bool,
        typer.Option("--excel", help="A CSV for workbooks with decimal commas: semicolons, units in the header."),
    ] = False,
    marker: Markers = None,
    start: From = None,
    end: To = None,
) -> None:
    """Write every marker's track as CSV or Parquet: a row per frame and marker, empty where there is no value.

    In Parquet each column's metadata has its unit.
    """
    from spheremcap.io.export import export_tracks

    loaded()
    wanted = selection(marker, start, end)
    done = export_tracks(recording, output, overwrite, wanted=wanted, excel=excel)
    for note in done.notes:
        warn(note)
    print(f"{done.rows} rows -> {output}")
    if done.damage is not None:
        warn(done.damage)
        raise typer.Exit(3)
