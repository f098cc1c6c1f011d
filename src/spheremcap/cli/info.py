"""spheremcap info: what is inside an MCAP."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremcap.core.time import format_time

if TYPE_CHECKING:
    from spheremcap.io.recording import Summary


def info(file: Annotated[Path, typer.Argument(help="Any MCAP; one of ours says the most.")]) -> None:
    """Say what is inside a recording: topics, and per marker its frames by status, longest gap and requests."""
    from rich.console import Console
    from rich.table import Table

    from spheremcap.io.recording import summarise

    summary = summarise(file)
    console = Console(highlight=False, soft_wrap=True)
    for line in _head(summary):
        console.print(line, markup=False)
    if summary.markers:
        table = Table("marker", "frames", "by status", "longest gap", "requests", box=None, pad_edge=False)
        for m in summary.markers:
            by_status = ", ".join(f"{count} {name.lower()}" for name, count in m.frames_by_status.items() if count)
            gap = f"{m.longest_gap_frames} frames, {m.longest_gap_s:.3f} s" if m.longest_gap_frames else "none"
            table.add_row(m.marker, str(m.frames), by_status, gap, str(len(m.requests)))
        console.print(table)
        for m in summary.markers:
            for request in m.requests:
                console.print(
                    f"request: where is {m.marker} on frame {request.frame_index} "
                    f"({format_time(request.stamp_ns)})? {request.reason}",
                    markup=False,
                )
    topics = Table("topic", "messages", "schema", "encoding", box=None, pad_edge=False)
    for t in summary.topics:
        topics.add_row(t.topic, str(t.messages), t.schema, t.encoding)
    console.print(topics)
    if summary.damage is not None:
        typer.echo(f"spheremcap: {summary.damage}", err=True)
        raise typer.Exit(3)


def _head(summary: "Summary") -> list[str]:
    lines = [f"{summary.path}: {summary.size_bytes / 1e6:.1f} MB, written by {summary.library or 'an unnamed library'}"]
    if summary.start_ns is not None and summary.end_ns is not None:
        lines.append(
            f"from {format_time(summary.start_ns)} to {format_time(summary.end_ns)} ({summary.duration_s:.3f} s)"
        )
    lines += list(summary.video)
    for name, facts in summary.runs.items():
        lines.append(f"run {name}: " + ", ".join(f"{key} {value}" for key, value in facts.items()))
    if summary.attachments:
        lines.append("attachments: " + ", ".join(summary.attachments))
    return lines
