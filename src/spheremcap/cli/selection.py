"""--marker, --from and --to, as several verbs take them."""

from typing import TYPE_CHECKING, Annotated

import typer

from spheremcap.cli.track import time_ns

if TYPE_CHECKING:
    from spheremcap.io.selection import Selection

Markers = Annotated[list[str] | None, typer.Option("--marker", help="Only this marker; as often as needed.")]
From = Annotated[
    str | None, typer.Option("--from", help="From here: seconds after the recording's start, ISO 8601 or Unix seconds.")
]
To = Annotated[str | None, typer.Option("--to", help="Up to here, in the same way.")]


def selection(markers: list[str] | None, start: str | None, end: str | None) -> "Selection":
    """What the flags say. Raises UsageError for a time that is none, or an end that is not after the start."""
    from spheremcap.errors import UsageError
    from spheremcap.io.selection import Selection

    start_ns, end_ns = time_ns("--from", start), time_ns("--to", end)
    if start_ns is not None and end_ns is not None and start_ns >= end_ns:
        raise UsageError(f"--from {start} is not before --to {end}")
    return Selection(tuple(markers or ()), start_ns, end_ns)
