"""spheremcap analyse: strokes, angles and lengths of a recording."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.layout import NoLayout, beside
from spheremcap.cli.progress import bar, loaded, stopped
from spheremcap.cli.said import warn
from spheremcap.interrupt import Interrupt


def analyse(
    recording: Annotated[Path, typer.Argument(help="What `track`, `retrack` or `merge` wrote; it stays.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The MCAP to write.")],
    settings: Annotated[
        Path | None,
        typer.Option("--settings", help="TOML on the chair: wheels, where the camera is, which marker is which joint."),
    ] = None,
    fill: Annotated[
        float,
        typer.Option(
            "--fill", metavar="MS", min=0, max=1000, help="Stand in for gaps of at most so many milliseconds."
        ),
    ] = 0.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the outputs when they exist.")] = False,
    no_layout: NoLayout = False,
) -> None:
    """Find contact and release of each hand, strokes, speeds, joint angles and segment lengths, with their uncertainty.

    Markers are joints by their names (left_wrist, right_elbow, ...) or as the settings say. Where the axle is comes
    from a tape measure, from clicks in `annotate`, from markers on the chair, or from the pushes themselves. With a
    wheel's sensor in the recording (`merge`) contact and release are surer. Beside OUT.mcap come OUT.report.html for
    people, and OUT.events.csv, OUT.strokes.csv and OUT.mean_cycle.csv. What the markers do not support is absent, and
    why is said.

        spheremcap analyse dataset.mcap -o analysed.mcap --settings analysis.toml
    """
    from spheremcap.analysis import job
    from spheremcap.analysis.settings import AnalysisSettings, load_analysis_settings

    loaded()
    given = AnalysisSettings() if settings is None else load_analysis_settings(settings)
    with Interrupt() as interrupted, bar("chunks") as shown:
        task = shown.add_task("analysing", total=None)
        report = job.analyse(
            recording, output, given, folder=settings.parent if settings is not None else Path(), fill_ms=fill,
            inputs=[settings] if settings is not None else [], overwrite=overwrite, stop=interrupted,
            progress=lambda done, total: shown.update(task, completed=done, total=total),
        )  # fmt: skip
    for line in (*report.notes, *report.lost):
        warn(line)
    if report.stopped:
        raise stopped("the analysis", report.part)
    found = report.findings
    for side, hand in found.hands.items():
        whole = [stroke.cycle_s for stroke in hand.strokes if stroke.cycle_s is not None]
        rate = f", {1 / (sum(whole) / len(whole)):.2f} a second" if whole else ""
        print(f"{side} hand: {len(hand.strokes)} strokes{rate}")
    for length in found.lengths:
        if length.median_m is not None and length.spread is not None:
            told = "" if length.constant else ": that is no constant length"
            print(f"{length.segment}: {length.median_m * 1e3:.1f} mm, varies by {length.spread:.1%}{told}")
    print(f"{len(found.stamp_ns)} frames analysed -> {output}, {', '.join(path.name for path in report.files)}")
    beside(output, not no_layout, overwrite)
    if report.lost:
        raise typer.Exit(3)
