"""spheremcap recover: a whole recording out of what an interrupted run left."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import bar, loaded, stopped
from spheremcap.cli.said import warn
from spheremcap.core.time import format_time
from spheremcap.interrupt import Interrupt


def recover(
    file: Annotated[Path, typer.Argument(help="OUT.mcap.part, or any MCAP that is cut short or damaged; it stays.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The MCAP to write.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
) -> None:
    """Make a whole, indexed MCAP of one that an interrupted run left, or that is damaged.

    While a run writes OUT.mcap, the file is called OUT.mcap.part. Where the run was killed or its machine went down,
    that is what is left: everything up to the last second. All that can be read is copied as it is, in the order
    of log times; what was lost is said, with exit code 3. The part file stays: delete it once you have looked.

        spheremcap recover session.mcap.part -o session.mcap
    """
    from spheremcap.io.recover import recover

    loaded()
    with Interrupt() as interrupted, bar("messages") as shown:
        task = shown.add_task("recovering", total=None)
        done = recover(
            file, output, overwrite=overwrite, stop=interrupted,
            progress=lambda count, total: shown.update(task, completed=count, total=total),
        )  # fmt: skip
    merged = done.merged
    for line in (*merged.notes, *done.lost):
        warn(line)
    written = f"{sum(merged.counts.values())} messages on {len(merged.counts)} topics"
    if merged.stopped:
        raise stopped(written, merged.part)
    until = f", up to {format_time(merged.end_ns)}" if merged.end_ns is not None else ""
    print(f"{written}{until} -> {output}")
    if done.lost:
        raise typer.Exit(3)
