"""spheremcap dataset: many sessions, from finding them to one table of all."""

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from spheremcap.cli.extras import needed
from spheremcap.cli.progress import bar, loaded
from spheremcap.cli.said import warn
from spheremcap.core.time import LARGEST_RELATIVE_NS, NS_PER_S, format_time
from spheremcap.errors import SettingsError, UsageError, printable
from spheremcap.interrupt import Interrupt

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from spheremcap.season.outcome import Outcome
    from spheremcap.season.run import Doing

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Many sessions: find them, run them overnight or on a cluster, answer what is asked, and put all into one "
    "table.\n\nStart with: [bold]spheremcap dataset init videos/ -o season.toml[/bold]",
)

Manifest = Annotated[Path, typer.Argument(help="The manifest that `dataset init` wrote.")]
Out = Annotated[Path, typer.Argument(help="The folder that `dataset run -o` was given.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the output when it exists.")]


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(help="Where the videos and logs are, folders in it too.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The manifest to write: season.toml")],
    overwrite: Overwrite = False,
    add: Annotated[
        bool, typer.Option("--add", help="Add what is new to a manifest that is there; all that it says stays.")
    ] = False,
) -> None:
    """Find the sessions in a folder: videos (a GoPro's chapters together), the sensors' logs that belong to them by
    name or time, settings and seeds; and write them into a manifest that you can read and edit.

    What is missing for each is listed here and stands in the manifest. When more videos have come, --add puts their
    sessions at its end.

        spheremcap dataset init videos/ -o season.toml
    """
    from spheremcap.io.output import whole_file
    from spheremcap.season.finding import find_sessions
    from spheremcap.season.manifest import load_season
    from spheremcap.season.proposed import added_text, manifest_text, not_yet_in

    if add and overwrite:
        raise UsageError("--overwrite makes the manifest anew, --add keeps what it says: give one of them")
    loaded()
    known = load_season(output, growing=True) if add and output.exists() else None
    with bar("files") as shown:
        task = shown.add_task("looking", total=None)
        found = find_sessions(
            folder, output, progress=lambda done, total: shown.update(task, completed=done, total=total)
        )
    if known is not None:
        found = not_yet_in(output, known, found, folder)
    if known is None or found.sessions:
        text = manifest_text(found, folder, output) if known is None else added_text(found, output, folder)
        with whole_file(output, () if known is not None else found.files, overwrite=overwrite or add) as part:
            part.path.write_text(text, encoding="utf-8", newline="")
            if known is not None:
                part.path.chmod(output.stat().st_mode)
            try:  # what cannot be read is not written
                load_season(part.path, growing=known is not None)
            except SettingsError as error:
                raise SettingsError(str(error).replace(str(part.path), f"{output} as it would be")) from error
    for session in found.sessions:
        chapters = f", {len(session.videos)} chapters" if len(session.videos) > 1 else ""
        sensors = f", {', '.join(name for name, _, _ in session.sensors)}" if session.sensors else ""
        print(printable(f"{session.name}: {session.videos[0].name}{chapters}{sensors}"))
        for line in (*session.missing, *session.notes):
            print(printable(f"    {line}"))
    for line in (*(left.line for left in found.leftovers), *found.notes):
        warn(line)
    if output.parent.resolve() != Path.cwd().resolve():
        warn(f"paths are told as from {output.parent}, where the manifest is")
    many = f"session{'s' * (len(found.sessions) != 1)}"
    if known is None:
        print(f"{len(found.sessions)} {many} -> {output}")
    else:
        print(f"{len(found.sessions)} new {many} -> {output} ({len(known.plans)} there already)")


@app.command(name="list")
def list_(
    manifest: Manifest,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The folder that `dataset run` writes into.")
    ] = None,
) -> None:
    """Say of each session what it is made from, and whether it is done, has changed, failed or was never run."""
    from spheremcap.season.key import is_done
    from spheremcap.season.manifest import load_season
    from spheremcap.season.outcome import others_in, read_outcome

    season = load_season(manifest)
    for plan in season.plans:
        outcome = read_outcome(output / plan.name) if output is not None else None
        if output is None or outcome is None:
            state = "not run"
        elif outcome.status == "failed":
            state = f"{outcome.line()}; the next run tries again"
        elif is_done(plan, outcome, output / plan.name):
            state = outcome.line()
        else:
            state = "changed since it was run"
        made_from = [*(Path(video).name for video in plan.videos), *(sensor.name for sensor in plan.sensors)]
        print(printable(f"{plan.name}: {state} ({', '.join(made_from) or 'no video'})"))
        for line in (*plan.missing, *([plan.seedless] if plan.seedless and outcome is None else [])):
            print(printable(f"    {line}"))
    if output is not None and (others := others_in(output, season)):
        warn(f"of no session of the manifest: {', '.join(str(folder) for folder in others)}")


@app.command()
def run(
    manifest: Manifest,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results, made when missing.")],
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, help="Sessions at once. (by default half as many as there are processors)"),
    ] = None,
    dask: Annotated[
        str | None, typer.Option("--dask", metavar="ADDRESS", help="Run them on a Dask cluster: tcp://host:8786")
    ] = None,
    share: Annotated[
        str | None,
        typer.Option("--shard", metavar="I/N", help="Only every N-th session, for N jobs beside each other."),
    ] = None,
) -> None:
    """Track, merge, synchronise and analyse every session that has no result yet, each in a process of its own.

    A second run does only what is new or has changed. A session that fails, crashes or hangs is named with its reason,
    and the others go on: exit code 3. Ctrl-C ends what is in work, and nothing that was done is lost.

    OUT/SESSION/ has session.mcap, session.report.html, tables, log.txt and run.json.

        spheremcap dataset run season.toml -o out/ --workers 4
    """
    from spheremcap.io.export.tables import arrow
    from spheremcap.season.manifest import load_season
    from spheremcap.season.run import default_workers, here, on_dask, run_season, shard

    loaded()
    arrow()  # else it would be missed only when the first session has been tracked
    if workers is not None and dask is not None:
        raise UsageError("--workers is for this machine; a Dask cluster has as many as it has")
    season = load_season(manifest)
    plans = shard(season.plans, share) if share is not None else season.plans
    with ExitStack() as open_:
        if dask is not None:
            with needed("--dask", "cluster"):
                import distributed  # noqa: F401
        submit = open_.enter_context(on_dask(dask) if dask is not None else here(workers or default_workers()))
        interrupted = open_.enter_context(Interrupt())
        results = sys.stdout  # which a bar takes over
        lines = _Lines(open_.enter_context(bar("MB")), results)
        done = run_season(season, plans, output, submit, show=lines.show, ended=lines.ended, stop=interrupted)
    for name, outcome in done.outcomes.items():
        if name not in done.made and outcome.status != "done":
            print(printable(f"{name}: {outcome.line()}"))
    for name in done.left:
        print(f"{name}: left to another run that is at work on it")
    count = {status: sum(o.status == status for o in done.outcomes.values()) for status in ("done", "lost", "failed")}
    before = len(done.outcomes) - len(done.made)
    print(
        f"{count['done']} done, {count['lost']} with losses, {count['failed']} failed, "
        f"{len(plans) - len(done.outcomes)} not run -> {output}" + (f" ({before} were done before)" if before else "")
    )
    asked = sum(len(outcome.open_requests) for outcome in done.outcomes.values())
    if asked:
        print(f"{asked} question{'s' * (asked != 1)} for a person: spheremcap dataset requests {output}")
    if done.stopped:
        warn("stopped: the same command goes on with what is left")
        raise typer.Exit(1)
    if not done.complete:
        raise typer.Exit(3)


class _Lines:
    """What is shown of a run: a line for each session that has ended, bars for those in work and for all."""

    def __init__(self, shown: "Progress", results: TextIO) -> None:
        self._shown, self._results = shown, results
        self._tasks: dict[str, TaskID] = {}
        self._all: TaskID | None = None

    def ended(self, outcome: "Outcome") -> None:
        """A session has ended."""
        line = printable(f"{outcome.session}: {outcome.line()}")
        print(line, file=sys.stdout if self._results.isatty() else self._results, flush=True)

    def show(self, doing: "Doing") -> None:
        """How far all of them are."""
        if self._all is None:
            self._shown.speed_estimate_period = 3600
            self._all = self._shown.add_task("all", total=sum(doing.sizes.values()) / 1e6)
        self._shown.update(
            self._all, completed=doing.done_bytes / 1e6, description=f"all, {len(doing.ended)} of {len(doing.sizes)}"
        )
        for name in [name for name in self._tasks if name not in doing.working]:
            self._shown.remove_task(self._tasks.pop(name))
        for name, (step, share) in doing.working.items():
            size = doing.sizes[name] / 1e6
            if name not in self._tasks:
                self._tasks[name] = self._shown.add_task(name, total=size)
            self._shown.update(self._tasks[name], completed=share * size, description=f"{name}: {step}")


@app.command()
def requests(out: Out) -> None:
    """List what the tracker asks of all sessions: where was this marker?

    `spheremcap annotate OUT` opens the next session that asks. Answers go into its seeds file, and the next
    `dataset run` tracks just those stretches again.
    """
    from spheremcap.season.requests import questions

    loaded()
    found = questions(out)
    for question in found:
        asked = question.asked
        since_s = (asked.stamp_ns - question.start_ns) / NS_PER_S
        told = f"{since_s:.3f} s" if asked.stamp_ns < LARGEST_RELATIVE_NS else format_time(asked.stamp_ns)
        at = f"frame {asked.frame} ({told})"
        state = " (answered; run the season again)" if question.answered else ""
        print(printable(f"{question.session}: where is {asked.marker} on {at}? {asked.reason}{state}"))
    still = [question for question in found if not question.answered]
    sessions = len({question.session for question in still})
    print(f"{len(still)} open in {sessions} session{'s' * (sessions != 1)}" + _next(still, out))


def _next(still: Sequence[object], out: Path) -> str:
    return f"; the next one: spheremcap annotate {out}" if still else ""


@app.command()
def tables(
    out: Out,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write, made anew.")],
    overwrite: Overwrite = False,
) -> None:
    """Put poses, strokes, events and quality of all sessions into Parquet tables, one folder a session, and all into
    one page for people: report.html.

        spheremcap dataset tables out/ -o season/

    reads in DuckDB as: SELECT * FROM 'season/poses/*/*.parquet'
    """
    from spheremcap.season.tables import season_tables

    loaded()
    with Interrupt() as interrupted, bar("sessions") as shown:
        task = shown.add_task("tables", total=None)
        report = season_tables(
            out, output, overwrite=overwrite, stop=interrupted,
            progress=lambda done, total: shown.update(task, completed=done, total=total),
        )  # fmt: skip
    for line in (*report.notes, *report.lost):
        warn(line)
    if report.stopped:
        warn(f"stopped; nothing was written to {output}")
        raise typer.Exit(1)
    print(f"{report.sessions} sessions -> {output}; to read: {output / 'report.html'}")
    if report.lost:
        raise typer.Exit(3)
