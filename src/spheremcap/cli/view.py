"""spheremcap view: a recording in a viewer, over a connection."""

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremcap.cli.extras import needed
from spheremcap.cli.progress import loaded
from spheremcap.cli.said import warn
from spheremcap.interrupt import Interrupt

if TYPE_CHECKING:
    from spheremcap.live.server import ViewerServer

Port = Annotated[int, typer.Option("--port", min=0, max=65535, help="Where viewers connect; 0 takes a free one.")]
Open = Annotated[bool, typer.Option("--open", help="Open Foxglove's page in the browser.")]


def view(
    recording: Annotated[Path, typer.Argument(help="Any MCAP.")],
    port: Port = 8765,
    open_: Open = False,
) -> None:
    """Play a recording to a viewer on this machine, with a time bar where the viewer has one for connections.

    It plays as soon as a viewer shows something of it. Ctrl-C ends it.
    """
    with needed("view", "live"):
        from spheremcap.live.playback import Playback
    from spheremcap.io.mcap_records import McapRecords

    loaded()
    with McapRecords(recording) as records:
        with Interrupt() as interrupted, Playback(records, port) as playback:
            connect(playback.server, open_)
            playback.run(interrupted)
        for line in records.damage():
            warn(f"{recording}: {line}")
        if records.damage():
            raise typer.Exit(3)


def connect(server: "ViewerServer", open_: bool) -> None:
    """Say how a viewer gets there."""
    print(server.address)
    print(f"Foxglove: {server.app_url}")
    print(f"Lichtblick: Open connection > Foxglove WebSocket > {server.address}", flush=True)
    if open_:
        webbrowser.open(server.app_url)
