"""spheremcap annotate: the page on which a person sees, clicks and corrects."""

import getpass
import time
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from spheremcap.cli.extras import needed
from spheremcap.cli.progress import loaded
from spheremcap.cli.said import warn
from spheremcap.errors import UsageError
from spheremcap.interrupt import Interrupt


def annotate(
    source: Annotated[
        Path,
        typer.Argument(
            help="A session's video, a folder of pictures, an MCAP with pictures, or a recording of ours; or what "
            "`dataset run` wrote: the next session that asks something."
        ),
    ],
    seeds: Annotated[
        Path | None, typer.Option("--seeds", help="Where answers are kept. (by default NAME.seeds.toml beside it)")
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            "--settings", "-s", help="Where markers and camera are kept. (by default NAME.settings.toml beside it)"
        ),
    ] = None,
    topic: Annotated[str | None, typer.Option("--topic", help="Image topic of an MCAP that has several.")] = None,
    rate: Annotated[str | None, typer.Option("--rate", help="Pictures a second of a folder, as in 240.")] = None,
    author: Annotated[
        str | None, typer.Option("--author", help="Who answers. (by default the name you are logged in by)")
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
    allow_remote: Annotated[
        str | None,
        typer.Option("--allow-remote", help="Another address of this machine's to listen on, for other machines."),
    ] = None,
) -> None:
    """Open a page in the browser: find the markers, give circles, answer requests, track again what is wrong.

    Every answer is in the seeds file as soon as the page says saved. Ctrl-C ends it.
    """
    with needed("annotate", "operator"):
        from spheremcap.operator.server import Server
    from spheremcap.cli.track import rate_of
    from spheremcap.operator.opened import Opened
    from spheremcap.operator.page import Page
    from spheremcap.season.outcome import SEASON

    loaded()
    more = ""
    if (source / SEASON).is_file():
        source, seeds, more = _next_question(source, seeds)
    if allow_remote in ("0.0.0.0", "::", ""):
        raise UsageError("--allow-remote: name the one address that others are to use, not all of them")
    page = Page(
        Opened(source, seeds=seeds, settings=settings, topic=topic, rate=rate_of(rate)),  # no name here keeps it open
        author if author is not None else login(),
    )
    try:
        with Interrupt() as interrupted, Server(page, allow_remote or "127.0.0.1") as server:
            print(server.url, flush=True)
            warn(f"{source} is open on this page; Ctrl-C ends it")
            if not no_browser:
                webbrowser.open(server.url)
            while not interrupted():
                time.sleep(0.1)
    finally:
        page.close()
    if more:
        warn(more)


def _next_question(out: Path, seeds: Path | None) -> tuple[Path, Path, str]:
    """The recording of a season's next open question, where its answer goes, and what is to be done then. Raises
    UsageError where nothing is asked."""
    from spheremcap.season.requests import questions

    if seeds is not None:
        raise UsageError("--seeds: each session of a season has its own seeds file, as its manifest says")
    asked = [question for question in questions(out) if not question.answered]
    if not asked:
        raise UsageError(
            f"{out}: nothing is asked that has no answer yet: `spheremcap dataset requests {out}` lists all"
        )
    first = asked[0]
    own = sum(question.session == first.session for question in asked)
    others = len({question.session for question in asked}) - 1
    ask = "session asks" if others == 1 else "sessions ask"
    warn(f"{first.session} asks {own} question{'s' * (own != 1)}; {others} more {ask}")
    again = f"; the same command opens the next of {others} more" if others else ""
    return first.recording, first.seeds, f"`spheremcap dataset run` takes the answers in{again}"


def login() -> str:
    """The name that whoever runs this is logged in by, "" where there is none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a user without a name
        return ""
