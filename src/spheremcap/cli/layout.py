"""spheremcap layout: how a viewer shows a recording."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import loaded
from spheremcap.cli.said import warn
from spheremcap.errors import UsageError

NoLayout = Annotated[bool, typer.Option("--no-layout", help="Write no viewer layout beside the output.")]


def layout(
    recording: Annotated[Path, typer.Argument(help="What `track`, `retrack` or `merge` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="layout.json")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
) -> None:
    """Write a layout for Foxglove and Lichtblick that shows what is in a recording: import it in the layout menu."""
    from spheremcap.io.layout import write_layout

    loaded()
    for note in write_layout(recording, output, overwrite=overwrite):
        warn(note)
    print(how_to_see(recording, output))


def beside(recording: Path, wanted: bool, overwrite: bool) -> None:
    """The layout beside a recording that was just written. One that is there already stays, and that is said."""
    from spheremcap.io.layout import layout_path, write_layout

    path = layout_path(recording)
    if not wanted:
        return
    if path.exists() and not overwrite:
        warn(f"{path} is there already and stays; --overwrite replaces it")
        return
    try:
        write_layout(recording, path, overwrite=overwrite)
    except UsageError as error:
        warn(f"no layout beside it: {error}")
    else:
        print(how_to_see(recording, path))


def how_to_see(recording: Path, layout: Path) -> str:
    return f"to see it: open {recording} in Foxglove or Lichtblick, and there Layouts > Import from file: {layout}"
