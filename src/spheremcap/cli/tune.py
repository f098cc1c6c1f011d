"""spheremcap tune: settings found on frames with known circles."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import bar, loaded

app = typer.Typer(no_args_is_help=True, help="Find settings on frames whose circles are known.")


@app.callback()
def _root() -> None:
    pass


@app.command("hough")
def hough(
    video: Annotated[Path, typer.Argument(help="A video whose circles are known.")],
    truth: Annotated[Path, typer.Option("--truth", help="CSV: a rendered truth.csv, or frame,x,y,r by hand.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="TOML to write; `track --settings` reads it.")],
    settings: Annotated[
        Path | None, typer.Option("--settings", "-s", help="TOML that all other keys are taken from.")
    ] = None,
    draws: Annotated[int, typer.Option("--draws", min=0, help="Random points to try after the grid.")] = 200,
    grid: Annotated[bool, typer.Option("--grid/--no-grid", help="Try a grid of points first.")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
) -> None:
    """Find the Hough transform's (dp, minDist, param1, param2) with the least mean error (eq 2.19)."""
    from spheremcap.evaluation.hough_tuning import THESIS, tune_hough

    loaded()
    with bar("points") as shown:
        task = shown.add_task("tuning", total=None)
        tuned = tune_hough(
            video, truth, output, settings, draws=draws, grid=grid, overwrite=overwrite,
            tell=lambda done, total: shown.update(task, completed=done, total=total),
        )  # fmt: skip
    best = ", ".join(f"{name} {getattr(tuned.best, name):g}" for name in THESIS)
    print(
        f"{best}: mean error {tuned.error:.5f} on {tuned.samples} patches ({tuned.thesis_error:.5f} with 4, 1, 77, 1)"
    )
    print(f"-> {output}")
