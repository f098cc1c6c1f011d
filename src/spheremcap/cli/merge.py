"""spheremcap merge: recordings and sensor files into one dataset, on one time line."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from spheremcap.cli.layout import NoLayout, beside
from spheremcap.cli.progress import bar, loaded, stopped
from spheremcap.cli.said import warn
from spheremcap.errors import UsageError
from spheremcap.interrupt import Interrupt

T = TypeVar("T")


def merge(
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="INPUT...",
            help="MCAPs, sensor files (CSV, Parquet, C3D, GoPro MP4, ...) and folders of them; NAME=PATH names one.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="The MCAP to write.")],
    offset: Annotated[
        list[str] | None,
        typer.Option("--offset", metavar="NAME=TIME", help="What to add to an input's times: imu=+12.5ms"),
    ] = None,
    drift: Annotated[
        list[str] | None,
        typer.Option("--drift", metavar="NAME=RATE", help="How much too slow its clock runs: imu=-20ppm"),
    ] = None,
    sync: Annotated[
        list[str] | None,
        typer.Option(
            "--sync",
            metavar="NAME=MARKER",
            help="Find a sensor's offset and drift from a marker's motion: imu=left_wrist",
        ),
    ] = None,
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--mapping",
            metavar="[NAME=]TOML",
            help="How to read a table of unknown layout: its columns and units.",
        ),
    ] = None,
    rate: Annotated[
        list[str] | None,
        typer.Option(
            "--rate",
            metavar="[NAME=]HZ",
            help="Samples a second of files that do not say (SMARTwheel: 240 or 200).",
        ),
    ] = None,
    prefix: Annotated[
        list[str] | None,
        typer.Option(
            "--prefix", metavar="NAME=TOPIC", help="Put an MCAP's topics and frames under another: second=/right"
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")] = False,
    no_layout: NoLayout = False,
    force: Annotated[
        bool, typer.Option("--force", help="Merge inputs that do not overlap, or whose clock began anew, as they are.")
    ] = False,
) -> None:
    """Merge recordings and sensor files by log time; the inputs stay as they are.

    An input is called NAME as its file is without the ending, `wheel` for wheel.csv and `imu` for imu/. Messages of
    MCAPs go over byte for byte, but for coordinate frames that --prefix renames; sensors become topics /sensors/NAME
    in SI units. Where each input was placed and why is said, and written as metadata; each message's publish time stays
    its own. For a table that is not understood, a mapping file to start from is printed.

        spheremcap merge session.mcap wheel.csv imu/ -o dataset.mcap --offset wheel=+12.5ms --sync imu=left_wrist
    """
    from spheremcap.merging.clock import parse_drift, parse_offset
    from spheremcap.merging.dataset import Source, merge
    from spheremcap.merging.mapping import UnreadTableError, load_mapping

    loaded()
    given = [_input(text) for text in inputs]
    names = [name or path.stem for name, path in given]
    for name in names:
        if names.count(name) > 1 and any(
            text.startswith(f"{name}=") for text in [*(offset or []), *(drift or []), *(sync or [])]
        ):
            raise UsageError(f"two inputs are called {name!r}: call one otherwise, as in other=PATH")
    offsets = _by_name("--offset", offset, names, parse_offset)
    drifts = _by_name("--drift", drift, names, parse_drift)
    markers = _by_name("--sync", sync, names, str)
    mappings = _by_name("--mapping", mapping, names, load_mapping, for_all=True)
    rates = _by_name("--rate", rate, names, _rate, for_all=True)
    prefixes = _by_name("--prefix", prefix, names, lambda text: "/" + text.strip("/"))
    sources = []
    for own, (name, path) in zip(names, given, strict=True):
        sources.append(
            Source(
                path, name, offsets.get(own, 0), drifts.get(own) or parse_drift("0ppm"), prefixes.get(own, ""),
                mappings.get(own), rates.get(own), markers.get(own),
            )
        )  # fmt: skip
    with Interrupt() as interrupted, bar("messages") as shown:
        task = shown.add_task("merging", total=None)
        try:
            dataset = merge(
                sources, output, overwrite=overwrite, force=force, say=_say, stop=interrupted,
                inputs=[Path(text.partition("=")[2] or text) for text in mapping or []],
                progress=lambda done, total: shown.update(task, completed=done, total=total),
            )  # fmt: skip
        except UnreadTableError as error:
            print(error.mapping, end="")
            advice = "what it may be is printed as a mapping: save it, complete it, give it with --mapping"
            raise UsageError(f"{error}; {advice}") from error
    for new, old in dataset.merged.renamed.items():
        print(
            f"spheremcap: metadata record {old!r} is there with other content: kept as {new!r}",
            file=sys.stderr,
        )
    for line in dataset.lost:
        _say(line)
    counts = dataset.merged.counts
    written = f"{sum(counts.values())} messages"
    if dataset.merged.stopped:
        raise stopped(written, dataset.merged.part)
    print(f"{written} on {len(counts)} topics -> {output}")
    beside(output, not no_layout, overwrite)
    if dataset.lost:
        raise typer.Exit(3)


def _say(line: str) -> None:
    warn(line)


def _input(text: str) -> tuple[str, Path]:
    """(name, path) of `NAME=PATH`, or ("", path)."""
    name, equals, path = text.partition("=")
    named = bool(equals and name and path) and "/" not in name and not Path(text).exists()
    chosen = Path(path if named else text)
    if not chosen.exists():
        raise UsageError(f"{chosen}: no such file or folder")
    return (name if named else ""), chosen


def _by_name(
    flag: str,
    texts: Sequence[str] | None,
    names: Sequence[str],
    parse: Callable[[str], T],
    *,
    for_all: bool = False,
) -> dict[str, T]:
    """The values of a repeated NAME=VALUE flag; one without NAME is for all inputs where that makes sense."""
    values: dict[str, T] = {}
    for text in texts or []:
        name, equals, value = text.partition("=")
        if not equals and for_all:
            values = dict.fromkeys(names, parse(text)) | values
        elif name not in names or not value:
            raise UsageError(f"{flag} {text}: expected NAME=VALUE with the name of an input: {', '.join(names)}")
        else:
            values[name] = parse(value)
    return values


def _rate(text: str) -> float:
    try:
        if 0 < (rate := float(text.removesuffix("Hz"))) <= 1e6:
            return rate
    except ValueError:
        pass
    raise UsageError(f"--rate {text}: expected samples a second, as in --rate wheel=240")
