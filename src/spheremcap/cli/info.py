"""spheremcap info: what is inside a recording or a video."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremcap.core.time import format_time
from spheremcap.errors import printable

if TYPE_CHECKING:
    from spheremcap.io.summary import MarkerSummary, Summary
    from spheremcap.io.video_summary import VideoSummary


def info(
    file: Annotated[Path, typer.Argument(help="Any MCAP (one of ours says the most), or a video.")],
    check: Annotated[
        bool,
        typer.Option("--check", help="Read all of it: chunks, checksums, messages, pictures."),
    ] = False,
) -> None:
    """Say what is inside a recording: per marker the share of its frames that is verified, then all else; or what a
    video is, and whether its pictures go into a recording as they are.

    Without --check only as much is read as that takes. Exit code 3 says that something in the file is damaged.
    """
    from spheremcap.io.input_file import is_recording

    if is_recording(file):
        from spheremcap.io.summary import summarise

        lost = _recording(summarise(file, check=check), check)
    else:
        from spheremcap.io.video_summary import summarise_video

        lost = _video(summarise_video(file, check=check))
    for line in lost:
        typer.echo(f"spheremcap: {line}", err=True)
    if lost:
        raise typer.Exit(3)


def _recording(summary: "Summary", check: bool) -> list[str]:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    for marker in summary.markers:
        typer.echo(printable(_marker(marker)))
    for marker in summary.markers:
        for request in marker.requests:
            at = f"frame {request.frame_index} ({format_time(request.stamp_ns)})"
            said = f"answered ({request.answered})" if request.answered else "request"
            typer.echo(printable(f"{said}: where is {marker.marker} on {at}? {request.reason}"))
    for line in _head(summary):
        typer.echo(printable(line))
    topics = Table("topic", "messages", "schema", "encoding", box=None, pad_edge=False)
    for t in summary.topics:
        topics.add_row(*(escape(printable(cell)) for cell in (t.topic, str(t.messages), t.schema, t.encoding)))
    Console(highlight=False, soft_wrap=True).print(topics)
    if summary.unread_chunks:
        typer.echo(
            f"not looked into: most of its {summary.unread_chunks} chunks; the numbers of messages are the file's own. "
            "info --check reads everything"
        )
    if check:
        more = f", except {summary.undecoded} messages of encodings that are not read here" if summary.undecoded else ""
        damaged = f"{len(summary.lost)} faults" if summary.lost else "nothing is damaged"
        typer.echo(f"checked: every chunk, checksum and message{more}: {damaged}")
        return [f"{summary.path}: {line}" for line in summary.lost]
    return [] if summary.damage is None else [summary.damage]


def _marker(m: "MarkerSummary") -> str:
    by_status = ", ".join(f"{count} {name.lower()}" for name, count in m.frames_by_status.items() if count)
    gap = f"longest gap {m.longest_gap_frames} frames, {m.longest_gap_s:.3f} s" if m.longest_gap_frames else "no gap"
    asked = f", {len(m.requests)} request{'s' * (len(m.requests) != 1)}" if m.requests else ""
    still_open = sum(not request.answered for request in m.requests)
    asked += f", {still_open} of them open" if still_open < len(m.requests) else ""
    return f"{m.marker}: {m.verified_share:.1%} verified of {m.frames} frames ({by_status}), {gap}{asked}"


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


def _video(video: "VideoSummary") -> list[str]:
    frames = "an unstated number of frames" if video.frames is None else f"{video.frames} frames"
    frames += " decoded" if video.checked else "" if video.frames is None else " by the container's word"
    rate = "no stated rate" if video.rate is None else f"{float(video.rate):.6g} frames/s ({video.rate})"
    lines = [
        f"{video.path}: {video.size_bytes / 1e6:.1f} MB, {frames}, {rate}",
        f"pictures: {video.width_px}x{video.height_px} {video.codec} {video.pixel_format}"
        + (", interlaced" if video.interlaced else "")
        + (f", stored turned: shown {video.rotation_deg} degrees clockwise" if video.rotation_deg else "")
        + (f", pixels {video.pixel_aspect:.4g} times as wide as high" if video.pixel_aspect != 1 else ""),
        _START[video.start_time_source].format(format_time(video.start_time_ns)),
    ]
    if video.chapters:
        lines.insert(1, f"{len(video.chapters)} files: {', '.join(file.name for file in video.chapters)}")
    if video.duration_s is not None:
        lines.append(f"first to last picture: {video.duration_s:.6f} s")
    if video.passthrough_reason is None:
        lines.append("goes into a recording as it is, without being encoded again")
    else:
        lines.append(f"is encoded once as H.264 for a recording: {video.passthrough_reason}")
    if not video.checked:
        lines.append("not looked into: all pictures but the first; info --check decodes them")
    for line in lines:
        typer.echo(printable(line))
    return [line if line.startswith(str(video.path)) else f"{video.path}: {line}" for line in video.lost]


_START = {
    "creation-time": "starts at {} by the file's creation time",
    "zero": "says no time of its own: track gives it --start-time, else {}",
    "start-time": "starts at {}",
}
