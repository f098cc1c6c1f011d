"""spheremcap calibrate: the camera, from a film of a printed board, or from a session's own limbs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from spheremcap.cli.progress import bar, loaded
from spheremcap.cli.said import warn
from spheremcap.errors import UsageError

if TYPE_CHECKING:
    from spheremcap.analysis.filmed import FilmedBoard


def calibrate(
    source: Annotated[
        Path | None,
        typer.Argument(
            help="A film of the board: a video, pictures, an MCAP; or, without --board, a tracked recording."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The camera_info YAML to write; with --print, the SVG.")
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(
            "--board",
            help="What was printed, squares counted, not inner corners: checkerboard:10x7:25mm, or "
            "charuco:7x5:30mm:22mm (square, marker; then :DICT_5X5_100, if it is not DICT_4X4_50).",
        ),
    ] = None,
    model: Annotated[
        Literal["plumb_bob", "rational", "fisheye"],
        typer.Option("--model", help="The lens: rational or fisheye for very wide ones."),
    ] = "plumb_bob",
    print_: Annotated[bool, typer.Option("--print", help="Write the board itself, to be printed at 100 %.")] = False,
    topic: Annotated[str | None, typer.Option("--topic", help="Image topic of an MCAP that has several.")] = None,
    settings: Annotated[
        Path | None,
        typer.Option("--settings", help="analysis.toml that says which marker is which joint, for a recording."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
) -> None:
    """Find the camera's focal length and distortion from a film of a printed board, and say how well they are known.
    Without a board the focal length alone, from a tracked recording in which arms move: they keep their lengths.

    Print a board, film it as the session is filmed, and give what comes out to track as --camera:

        spheremcap calibrate --print --board charuco:7x5:30mm:22mm -o board.svg

        spheremcap calibrate board.mp4 --board charuco:7x5:30mm:22mm -o camera.yaml

        spheremcap calibrate session.mcap -o camera.yaml

    With a board, beside camera.yaml is camera.png, which shows where in the picture the board was, and what does not
    fit. What does not say enough is refused, with what to film instead.
    """
    from spheremcap.analysis.board import Board
    from spheremcap.analysis.filmed import calibrate_board, write_sheet

    loaded()
    if output is None:
        raise UsageError("give the file to write with -o")
    if board is None and source is not None and not print_ and ".mcap" in source.name.lower():
        _from_limbs(source, output, settings, overwrite)
        return
    if board is None:
        raise UsageError("which board was printed? Give --board, as in --board charuco:7x5:30mm:22mm")
    printed = Board.of(board)
    if print_:
        if source is not None:
            raise UsageError(f"{source}: --print writes a board and reads nothing")
        write_sheet(output, printed, overwrite=overwrite)
        print(f"{printed} -> {output}: print it at 100 %, measure a square, and glue it to something flat")
        return
    if source is None:
        raise UsageError("name the film of the board; or --print the board first")
    with bar() as shown:
        task = shown.add_task("looking for the board", total=None)
        report = calibrate_board(
            source, output, printed, model=model, topic=topic, overwrite=overwrite,
            progress=lambda done, total: shown.update(task, completed=done, total=total),
        )  # fmt: skip
    for line in report.lost:
        warn(line)
    _tell(report)
    print(f"-> {output}, {report.picture}")
    if report.lost:
        raise typer.Exit(3)


def _from_limbs(recording: Path, output: Path, settings: Path | None, overwrite: bool) -> None:
    """The focal length from a recording's arms."""
    from spheremcap.analysis.focal_job import calibrate_recording
    from spheremcap.analysis.settings import load_analysis_settings

    given = None if settings is None else load_analysis_settings(settings)
    report = calibrate_recording(recording, output, given, overwrite=overwrite)
    camera, focal = report.camera, report.focal
    print(f"fx {camera.fx_px:.2f} ± {camera.fx_px * camera.focal_sd:.2f} px ({camera.focal_sd:.2%}), "
          f"{focal.factor:.4f} times what the recording was tracked with")  # fmt: skip
    for name, length_m, varies in zip(report.pairs, focal.lengths_m, focal.varies, strict=True):
        print(f"{name}: {length_m * 1e3:.1f} mm, varies by {varies:.1%}")
    print(f"they turned through {focal.turned_deg:.0f} degrees in depth; the lens' distortion is left as it was")
    print(f"-> {output}: track the session again with --camera {output}")
    for line in report.lost:
        warn(line)
    if report.lost:
        raise typer.Exit(3)


def _tell(report: "FilmedBoard") -> None:
    """The camera and what it rests on."""
    found = report.found
    for name, value in found.values.items():
        sd = found.sd[name]
        if name in ("fx", "fy"):
            print(f"{name} {value:.2f} ± {sd:.2f} px ({sd / value:.2%})")
        else:
            print(f"{name} {value:.2f} ± {sd:.2f} px" if name in ("cx", "cy") else f"{name} {value:+.5f} ± {sd:.5f}")
    print(
        f"rms {found.rms_px:.2f} px over {len(found.views)} views, {len(found.image_px)} corners "
        f"(the board was on {report.seen} of the {report.looked} pictures that were looked at)"
    )
    print(
        f"the board was in {found.covered:.0%} of the picture, tilted by {found.tilt_deg.min():.0f} to "
        f"{found.tilt_deg.max():.0f} degrees"
    )
    print(f"the board is {found.bend_m * 1e3:.1f} mm from flat, which the camera was corrected for")
    if found.odd:
        print(f"left out: {found.odd} view{'s' * (found.odd != 1)} that fit much worse than the others")
