"""The command line: one file a verb; each parses, calls the api and prints.

What a verb works with is imported inside its function, so that help and errors of usage are there at once.
"""

import os
import sys
import traceback

import typer

from spheremcap import __version__
from spheremcap.cli import (
    analyse,
    annotate,
    calibrate,
    config,
    dataset,
    evaluate,
    experiment,
    export,
    info,
    layout,
    live,
    merge,
    plot,
    recover,
    render,
    retrack,
    sync,
    synth,
    track,
    tune,
    view,
)
from spheremcap.cli.said import warn
from spheremcap.errors import SpheremcapError, UsageError, short
from spheremcap.interrupt import Interrupted

DEBUG = "SPHEREMCAP_DEBUG"
"""When it is set, what is nobody's error but ours is shown with its trace."""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Track coloured sphere markers in video into an annotated MCAP that opens in Foxglove.\n\n"
    "Start with: [bold]spheremcap annotate session.mp4[/bold] (a page in the browser), or with\n\n"
    "[bold]spheremcap track session.mp4 -o session.mcap --seed left_wrist@0=812,430,24[/bold] "
    "(marker, frame, centre x, y and radius in pixels of that frame).",
    epilog="Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done but something was lost.",
)


def _paragraphs(text: str) -> str:
    """A docstring with each paragraph on one line, as typer wants it."""
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"spheremcap {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    pass


for verb in (
    annotate.annotate, calibrate.calibrate, track.track, retrack.retrack, merge.merge, analyse.analyse, recover.recover,
    sync.sync, info.info, layout.layout, export.export, render.render, plot.plot, view.view, live.live,
    evaluate.evaluate, experiment.experiment, synth.synth,
):  # fmt: skip
    app.command(help=_paragraphs(verb.__doc__ or ""))(verb)
for name, group in (("dataset", dataset.app), ("tune", tune.app), ("config", config.app)):
    for command in group.registered_commands:
        command.help = _paragraphs(getattr(command.callback, "__doc__", None) or "")
    app.add_typer(group, name=name)


def main() -> None:
    """Run the command line; every error is one line on stderr and an exit code."""
    try:
        app()
    except UsageError as error:
        warn(error)
        sys.exit(2)
    except SpheremcapError as error:
        warn(error)
        sys.exit(1)
    except (Interrupted, KeyboardInterrupt) as error:
        warn(str(error) or "interrupted")
        sys.exit(1)
    except BrokenPipeError:
        # Whoever read has gone; Python would try once more to write what is left.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        if os.environ.get(DEBUG):
            traceback.print_exc()
        else:
            print(
                f"spheremcap: a fault of spheremcap's own, please report it: {type(error).__name__}: {short(error)} "
                f"(run the same with {DEBUG}=1 for the trace that belongs into the report)",
                file=sys.stderr,
            )
        sys.exit(1)
