"""spheremcap evaluate: how good a track is, against truth."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import loaded


def evaluate(
    tracks: Annotated[Path, typer.Argument(help="A recording (.mcap), or an exported table (.csv, .parquet).")],
    truth: Annotated[
        Path,
        typer.Option("--truth", help="CSV: a rendered truth.csv, or frame,x,y,r[,err_px][,marker][,visible]."),
    ],
    marker: Annotated[
        str | None, typer.Option("--marker", help="Score this one only; says whose a truth without names is.")
    ] = None,
) -> None:
    """Score a track against truth: accuracy, failures, false accepts, errors in pixels and millimetres."""
    from spheremcap.evaluation.tracks import evaluate, scores_table

    loaded()
    print(scores_table(evaluate(tracks, truth, marker)))
