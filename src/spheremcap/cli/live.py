"""spheremcap live: track a camera, and show it while it goes on."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.extras import needed
from spheremcap.cli.layout import beside
from spheremcap.cli.progress import bar, loaded
from spheremcap.cli.said import warn
from spheremcap.cli.track import answers_of, time_ns
from spheremcap.cli.view import Open, Port, connect
from spheremcap.interrupt import Interrupt


def live(
    source: Annotated[str, typer.Argument(help="camera:0, rtsp://…, or a video file, taken in real time.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="session.mcap")],
    seeds: Annotated[Path | None, typer.Option("--seeds", help="Seeds file: one circle a marker.")] = None,
    seed: Annotated[
        list[str] | None, typer.Option("--seed", help="MARKER@FRAME=X,Y,R in pixels; as often as needed.")
    ] = None,
    settings: Annotated[Path | None, typer.Option("-s", "--settings", help="Markers, camera, stages; TOML.")] = None,
    camera: Annotated[str | None, typer.Option("--camera", help="Preset name or ROS camera_info YAML.")] = None,
    start_time: Annotated[str | None, typer.Option("--start-time", help="Time of a file's first picture.")] = None,
    port: Port = 8765,
    open_: Open = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
) -> None:
    """Track markers while they are filmed, show it in a viewer on this machine, and write the recording beside it.

    Where tracking is slower than the camera, the newest picture is taken and the others are skipped; how many is said,
    and the exit code is then 3. Viewers get states, poses and votes of every tracked picture and at most 30 pictures a
    second; the recording has all. Ctrl-C ends the recording.
    """
    with needed("live", "live"):
        from spheremcap.live.server import ViewerServer
        from spheremcap.live.tracking import track_live
    from spheremcap.config import Settings, load_settings, with_camera
    from spheremcap.io.contents import Contents
    from spheremcap.io.layout import layout_path, write_layout_of
    from spheremcap.io.output import checked_output

    loaded()
    chosen = load_settings(settings) if settings is not None else Settings()
    if camera is not None:
        chosen = with_camera(chosen, camera)
    given = answers_of(seeds, seed)
    inputs = [path for path in (settings, seeds) if path is not None]
    checked_output(output, inputs, overwrite=overwrite)
    shown_by = layout_path(output)
    keeps = shown_by.exists() and not overwrite

    def begins(found: Contents) -> None:
        if not keeps:
            write_layout_of(found, output, shown_by, overwrite=True)
            print(f"and there Layouts > Import from file: {shown_by}")

    with Interrupt() as interrupted, ViewerServer(port) as server, bar() as shown:
        connect(server, open_)
        task = shown.add_task("live", total=None)
        report = track_live(
            source, output, chosen, given, server,
            folder=settings.parent if settings is not None else Path(), inputs=inputs, overwrite=overwrite,
            start_time_ns=time_ns("--start-time", start_time), stop=interrupted, begins=begins,
            progress=lambda done, skipped: shown.update(task, completed=done, description=f"live, {skipped} skipped"),
        )  # fmt: skip
    for line in [*report.notes, *report.lost]:
        warn(line)
    print(f"{report.frames} frames -> {output}")
    beside(output, True, not keeps)
    if not report.complete:
        raise typer.Exit(3)
