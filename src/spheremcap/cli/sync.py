"""spheremcap sync: how a sensor's clock stands against the video's."""

from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.progress import loaded
from spheremcap.cli.said import warn


def sync(
    recording: Annotated[
        Path, typer.Argument(help="An MCAP with a marker's track and a sensor, as `merge` writes it.")
    ],
    marker: Annotated[str, typer.Option("--marker", help="The marker beside the sensor, or on the wheel.")],
    sensor: Annotated[
        str, typer.Option("--sensor", help="The sensor's topic without /sensors/, such as imu_left_wrist.")
    ],
    max_offset: Annotated[
        float, typer.Option("--max-offset", min=0.1, help="How far the clocks may be apart, seconds.")
    ] = 15.0,
) -> None:
    """Find a sensor's offset and drift from the motion that it and the camera both saw.

    A marker's acceleration is held against an accelerometer's (or its speed against a wheel's rate) in sliding
    windows. There is no answer, and exit code 1, where the signals do not support one. `merge --sync` applies it.
    """
    from spheremcap.io.recording import open as open_recording
    from spheremcap.merging.dataset import sync_recording
    from spheremcap.merging.sync import SyncConfig

    loaded()
    opened = open_recording(recording)
    if opened.damage is not None:
        warn(opened.damage)
    found = sync_recording(opened, marker, sensor, config=SyncConfig(max_offset_s=max_offset))
    print(f"{sensor}: {found.line()}")
    print(f"merge again with --sync NAME={marker}, or add to what was given: "
          f"--offset NAME={found.offset_s * 1e3:+.4f}ms --drift NAME={found.drift_ppm:+.3f}ppm")  # fmt: skip
    if opened.damage is not None:
        raise typer.Exit(3)
