"""spheremcap experiment: the measurements behind the numbers in the docs."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import loaded
from spheremcap.errors import UsageError


def experiment(
    name: Annotated[
        str,
        typer.Argument(help="Which one; `list` prints them all, `report` runs what is missing and writes report.html."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of sessions and results.")] = Path(
        "experiments"
    ),
    sessions: Annotated[
        Path | None, typer.Option("--sessions", help="Rendered sessions, when they are elsewhere.")
    ] = None,
    clips: Annotated[
        list[Path] | None,
        typer.Option("--clips", help="Folder of clips made elsewhere, each with its truth; as often as needed."),
    ] = None,
    only: Annotated[list[str] | None, typer.Option("--only", help="Only this scenario; as often as needed.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small, for a first look; the numbers mean little.")] = False,
    again: Annotated[bool, typer.Option("--again", help="With report: run all of them anew.")] = False,
) -> None:
    """Run an experiment on rendered sessions (made when missing), print its tables, keep them and its plots."""
    from spheremcap.evaluation.experiments import EXPERIMENTS, describe, run_experiment, run_report
    from spheremcap.evaluation.lab import Lab
    from spheremcap.io.output import refuse_inputs

    loaded()
    if name == "list":
        for one in EXPERIMENTS:
            print(f"{one:14s} {describe(one)}")
        return
    for folder in (sessions, *(clips or ())):
        if folder is not None and not folder.is_dir():
            raise UsageError(f"{folder}: no such folder")
    refuse_inputs(output, clips or [])
    lab = Lab(output, sessions, tuple(clips or ()), quick, tuple(only or ()))
    if name == "report":
        print(f"-> {run_report(lab, again=again)}")
        return
    print(run_experiment(name, lab).text())
    print(f"-> {output / name}")
