"""spheremcap export: a recording for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import loaded
from spheremcap.cli.said import warn
from spheremcap.cli.selection import From, Markers, To, selection


def export(
    recording: Annotated[Path, typer.Argument(help="An MCAP that `track` wrote.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="NAME.csv, .parquet, .c3d or .trc: the ending chooses.")
    ],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
    table: Annotated[
        str, typer.Option("--table", help="In .csv and .parquet: poses, or cycles or events of what `analyse` wrote.")
    ] = "poses",
    excel: Annotated[
        bool,
        typer.Option("--excel", help="A CSV for workbooks with decimal commas: semicolons, units in the header."),
    ] = False,
    fill: Annotated[
        float | None,
        typer.Option(
            "--fill", metavar="MS", help="In .c3d: fill gaps of at most so many ms from the smoothed track, marked."
        ),
    ] = None,
    marker: Markers = None,
    start: From = None,
    end: To = None,
) -> None:
    """Write a recording for other programs; where nothing was measured, nothing is.

    .csv, .parquet: a row per frame and marker, empty where there is no value; in Parquet each column's metadata has its
    unit. --table cycles has a row per stroke, --table events one per contact and release.

    .c3d (Vicon, Mokka, Visual3D, Kinetics Toolkit): mm at the true rate, residual -1 where not measured, events, and
    IMUs and wheels whose samples keep the frames' time. At most 65,534 frames: longer ones go in pieces.

    .trc (OpenSim): mm, times from the stamps, blank cells where not measured.

    docs/files.md says how each program shows a gap, and in which axes positions are.
    """
    from spheremcap.io.export import export_recording

    loaded()
    wanted = selection(marker, start, end)
    done = export_recording(recording, output, overwrite, wanted=wanted, table=table, excel=excel, fill_ms=fill)
    for note in done.notes:
        warn(note)
    print(f"{done.rows} {'frames' if output.suffix.lower() in ('.c3d', '.trc') else 'rows'} -> {output}")
    if done.damage is not None:
        warn(done.damage)
        raise typer.Exit(3)
