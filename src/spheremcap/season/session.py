"""One session: track, merge, analyse, tables; made beside what its folder has, and put in its place when it is whole.

What can be kept is kept: where only answers have changed, their stretches alone are tracked again, and where only
sensors or the analysis have, nothing is. What the recording had from merging and analysing goes first, so that a result
is of its inputs and never of its past.
"""

import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from spheremcap import api
from spheremcap.core.estimate import Status
from spheremcap.corrections.run import named_answers, runs_in
from spheremcap.corrections.told import HOW_TO_ANSWER
from spheremcap.errors import OutputError, SpheremcapError, UsageError
from spheremcap.interrupt import Interrupted
from spheremcap.io.chapters import write_list
from spheremcap.io.join import Join, McapStream
from spheremcap.io.layout import layout_path, write_layout
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import VERSION, make_folder, open_output, output_error
from spheremcap.io.sources import FromMcap
from spheremcap.io.strokes import has_strokes, read_strokes
from spheremcap.io.summary import summarise
from spheremcap.merging.clock import parse_drift, parse_offset
from spheremcap.merging.dataset import Dataset
from spheremcap.merging.mapping import load_mapping
from spheremcap.merging.sync import SyncError
from spheremcap.season.addresses import fetched, is_address
from spheremcap.season.key import Given, check_unchanged, given
from spheremcap.season.manifest import Plan, Sensor
from spheremcap.season.outcome import (
    OUT_OF_MEMORY,
    RECORDING,
    RUN,
    TABLES,
    WORK,
    Asked,
    ClockOutcome,
    MarkerOutcome,
    Outcome,
    Recorded,
    failed,
    is_whole,
    read_outcome,
    write_outcome,
)
from spheremcap.season.tables import write_session_tables
from spheremcap.stretch import base_seeds

Progress = Callable[[str, int, int | None], None]
"""Called with the step that is worked at, how much of it is done, and of how much (None: nobody knows)."""


def run_session(
    plan: Plan, folder: Path, *, progress: Progress, say: Callable[[str], None], stop: Callable[[], bool]
) -> tuple[Outcome, bool]:
    """Make a session's result in its folder, where it is not there already, and say how it ended; and whether anything
    was made, or tried.

    What the session itself is to blame for is an outcome that failed. `say` gets lines for its log. Raises
    Interrupted where `stop` says so, and nothing has changed then; OutputError where nothing can be written.
    """
    before = read_outcome(folder)
    work = folder / WORK
    shutil.rmtree(work, ignore_errors=True)
    make_folder(work)
    making = _Making(plan, folder, before, progress, say, stop)
    try:
        outcome = making.outcome()
    except OutputError:
        raise
    except SpheremcapError as error:
        told = str(error).replace(f"{work}/", "").partition("; what was written until then")[0]  # as it goes now
        outcome = failed(plan, told, before)
    except MemoryError:
        outcome = failed(plan, OUT_OF_MEMORY, before)
    except OSError as error:
        raise output_error(error, folder) from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
    write_outcome(folder, outcome)
    say(outcome.line())
    return outcome, not making.kept


@dataclass
class _Making:
    """A result while it is made; files are in the work folder until it is whole."""

    plan: Plan
    folder: Path
    before: Outcome | None
    progress: Progress
    say: Callable[[str], None]
    stop: Callable[[], bool]
    lost: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    copies: dict[str, Path] = field(default_factory=dict)
    kept: bool = False
    """Its result was there."""

    def outcome(self) -> Outcome:
        """Make what is not there yet."""
        plan, before = self.plan, self.before
        with self._step("reading"):
            found = given(plan, before, self._local, self._go_on)
        assert found is not None  # as everything may be read
        inputs = tuple(found.files[path] for path in sorted(found.files))
        if (
            before is not None
            and before.key == found.key
            and before.status != "failed"
            and is_whole(self.folder, before)
        ):
            self.kept = True
            return before.model_copy(update={"inputs": inputs, "videos": plan.videos, "seeds": plan.seeds})
        tracked, recorded = self._tracked(found)
        self.lost += [line for line in plan.missing if line.startswith("no sensor")]
        merged, clocks = self._merged(tracked, found)
        analysed = self._analysed(merged, found)
        with self._step("tables"):
            outcome = self._described(analysed, found, clocks).model_copy(
                update={"inputs": inputs, "recorded": recorded}
            )
            damage = write_session_tables(analysed, self._made(TABLES), outcome)
            if damage is not None:
                outcome = outcome.model_copy(update={"status": "lost", "lost": (*outcome.lost, damage)})
            self._write_layout(analysed)
        check_unchanged(found.files, self._go_on)
        files = self._publish(analysed, strokes=bool(outcome.strokes))
        seconds = {step: round(s, 3) for step, s in self.seconds.items()}
        return outcome.model_copy(update={"files": files, "seconds": seconds})

    # --- steps ---

    def _tracked(self, found: Given) -> tuple[Path, Recorded]:
        """The recording with all answers in it, and nothing else."""
        out = self._made("tracked") / f"{self.plan.name}.mcap"
        earlier = self._earlier(found)
        if earlier is not None and self.before is not None and self.before.recorded is not None:
            if self.before.recorded.answers == found.answered:
                self.say("tracked already")
                recorded = self.before.recorded
                earlier.rename(out)
                self._reported(recorded.lost, (*recorded.notes, *recorded.stretches), False)
                return out, recorded
            with self._step("tracking again"):
                video = self._video()  # where its pictures are looked for, if those in the recording will not do
                (earlier.parent / video.name).symlink_to(video.resolve())
                report = api.retrack(
                    earlier, out, found.answers, progress=lambda done, total: self.progress("tracking", done, total),
                    stop=self.stop,
                )  # fmt: skip
                self._reported([], self.before.recorded.notes, False)
                notes = tuple(self.notes)
                self._reported(report.lost, [*report.notes, *report.stretches], report.stopped)
                earlier.unlink()
        else:
            self._track(out, found)
            notes = tuple(self.notes)
        with McapRecords(out) as records:
            recorded = Recorded(
                tracked=found.tracked, answers=found.answered, lost=tuple(self.lost), notes=notes,
                stretches=tuple(self.notes[len(notes) :]),
                topics=tuple(sorted({channel.topic for channel in records.channels.values()})),
                metadata=tuple(record.name for record in records.metadata),
                attachments=sum(1 for _ in records.attachments()),
            )  # fmt: skip
        return out, recorded

    def _track(self, out: Path, found: Given) -> None:
        plan, answers, settings = self.plan, list(found.answers), found.settings
        folder = Path(plan.settings).parent if plan.settings is not None else Path()
        video = self._video()
        start_ns, rate = plan.start_time_ns, None if plan.rate is None else Fraction(plan.rate)
        mcap = FromMcap((plan.topic,)) if plan.topic is not None else None
        told = None
        if plan.auto and (settings.markers or not base_seeds(answers)):
            with self._step("looking for markers"):
                told = api.find(
                    video, settings, answers, folder=folder, start_time_ns=start_ns, rate=rate, mcap=mcap,
                    progress=lambda done, total: self.progress("looking for markers", done, total), stop=self.stop,
                )  # fmt: skip
            self._reported([], told.told, False)
            if told.unclear:
                names = ", ".join(name for name, _ in told.unclear)
                raise UsageError(f"auto cannot tell which is {names}: show it: spheremcap annotate {video}")
            settings, answers = told.settings, [*answers, *told.seeds]
        if not base_seeds(answers):
            raise UsageError(plan.seedless or f"no seeds: {plan.seeds} has no circle")
        with self._step("tracking"):
            report = api.track(
                video, out, settings, answers, folder=folder, start_time_ns=start_ns, rate=rate, mcap=mcap, found=told,
                progress=lambda done, total: self.progress("tracking", done, total), stop=self.stop,
            )  # fmt: skip
        self._reported(report.lost, report.notes, report.stopped)

    def _merged(self, tracked: Path, found: Given) -> tuple[Path, tuple[ClockOutcome, ...]]:
        """The recording with its sensors; those that cannot be merged are left out, and that is said."""
        there = [sensor for sensor in self.plan.sensors if sensor.path in found.files]
        gone = [sensor for sensor in self.plan.sensors if sensor not in there]
        self._reported([f"sensor {one.name} is left out: {one.path} is not there" for one in gone], [], False)
        if not there:
            return tracked, ()
        out = self._made("merged") / tracked.name
        with self._step("merging"):
            try:
                dataset = self._merge(tracked, there, out)
            except OutputError:  # a disk that is full is no sensor's fault
                raise
            except SpheremcapError as error:
                alone = [(sensor, self._unfit(tracked, sensor)) for sensor in there]
                fit = [sensor for sensor, why in alone if why is None]
                lost = [f"sensor {sensor.name} is left out: {why}" for sensor, why in alone if why is not None]
                if fit and lost:
                    shutil.rmtree(out.parent)
                    try:
                        dataset = self._merge(tracked, fit, self._made("merged") / tracked.name)
                    except UsageError as other:
                        lost.append(f"sensors {', '.join(s.name for s in fit)} are left out: {other}")
                        fit = []
                elif fit:  # each alone would do
                    lost.append(f"sensors {', '.join(s.name for s in fit)} are left out: {error}")
                    fit = []
                self._reported(lost, [], False)
                if not fit:
                    return tracked, ()
        self._reported(dataset.lost, dataset.notes, dataset.merged.stopped)
        tracked.unlink()  # large, and all of it is in the other
        return out, _clocks(dataset)

    def _merge(self, tracked: Path, sensors: list[Sensor], out: Path) -> Dataset:
        return api.merge(
            [api.Source(tracked, self.plan.name), *(self._source(sensor) for sensor in sensors)], out,
            force=self.plan.force, stop=self.stop,
            progress=lambda done, total: self.progress("merging", done, total),
        )  # fmt: skip

    def _source(self, sensor: Sensor) -> api.Source:
        how = sensor.how
        return api.Source(
            self._local(sensor.path), sensor.name, parse_offset(how.offset) if how.offset is not None else 0,
            parse_drift(how.drift) if how.drift is not None else Fraction(0), "",
            load_mapping(how.mapping) if how.mapping is not None else None, how.rate_hz, how.sync or None,
        )  # fmt: skip

    def _unfit(self, tracked: Path, sensor: Sensor) -> str | None:
        """Why a sensor alone cannot be merged; None where it can. Nothing is written."""
        begun = False

        def planned(done: int, total: int | None) -> None:
            nonlocal begun
            begun = True

        out = self._made("tried") / f"{sensor.name}.mcap"
        try:
            sources = [api.Source(tracked, self.plan.name), self._source(sensor)]
            api.merge(sources, out, force=self.plan.force, progress=planned, stop=lambda: begun)
        except SyncError as error:
            return f'{error}; where its times are right as they are, merge.{sensor.name}.sync = ""'
        except SpheremcapError as error:
            return str(error)
        finally:
            shutil.rmtree(out.parent)
        return None

    def _analysed(self, merged: Path, found: Given) -> Path:
        """The recording with strokes; as it was where they cannot be looked for, and that is said."""
        if not self.plan.analyse:
            return merged
        out = self._made("analysed") / merged.name
        with self._step("analysing"):
            try:
                report = api.analyse(
                    merged, out, found.analysis, fill_ms=self.plan.fill_ms, stop=self.stop,
                    folder=Path(self.plan.analysis).parent if self.plan.analysis is not None else Path(),
                    progress=lambda done, total: self.progress("analysing", done, total),
                )  # fmt: skip
            except OutputError:
                raise
            except SpheremcapError as error:
                line = [f"not analysed: {error}"]
                asked = self.plan.analysis is not None  # else nothing is missed that somebody wants
                self._reported(line if asked else [], [] if asked else line, False)
                return merged
        self._reported(report.lost, report.notes, report.stopped)
        merged.unlink()
        return out

    # --- what is there already ---

    def _earlier(self, found: Given) -> Path | None:
        """What was tracked before of the same pictures with the same settings and first circles, alone in a file."""
        before, recording = self.before, self.folder / RECORDING
        if before is None or before.recorded is None or before.recorded.tracked != found.tracked:
            return None
        made = before.recorded
        out = self._made("earlier") / f"{self.plan.name}.earlier.mcap"  # beside a link by the video's name
        try:
            with self._step("taking up"), McapRecords(recording) as records:
                if records.lost:
                    return None
                runs = runs_in(records)
                answers = [answer for run in runs for answer in named_answers(run, runs)]
                if made.answers != found.answered and set(base_seeds(answers)) != set(base_seeds(found.answers)):
                    return None
                _copy_alone(records, made, out)
        except SpheremcapError as error:
            self.say(f"tracked anew, as {recording.name} cannot be taken up: {error}")
            return None
        return out

    # --- the end ---

    def _described(self, recording: Path, found: Given, clocks: tuple[ClockOutcome, ...]) -> Outcome:
        """What is in the recording, in numbers."""
        told = summarise(recording)
        measured = {status.value for status in Status if status.measured}
        markers = tuple(
            MarkerOutcome(
                marker=m.marker, frames=m.frames, frames_by_status=dict(m.frames_by_status),
                measured=sum(count for status, count in m.frames_by_status.items() if status in measured),
                longest_gap_frames=m.longest_gap_frames, longest_gap_s=m.longest_gap_s,
            )
            for m in told.markers
        )  # fmt: skip
        requests = tuple(
            Asked(
                marker=m.marker, frame=r.frame_index, stamp_ns=r.stamp_ns, raised_at_frame=r.raised_at_frame_index,
                reason=r.reason, reasons=tuple(r.reasons), answered=r.answered,
            )
            for m in told.markers for r in m.requests
        )  # fmt: skip
        strokes: dict[str, int] = {}
        with McapRecords(recording) as records:
            if has_strokes(records):
                found_strokes = read_strokes(records)[1]
                strokes = {side: sum(s.side == side for s in found_strokes) for side in ("left", "right")}
        lost = tuple(dict.fromkeys(self.lost))
        return Outcome(
            session=self.plan.name, subject=self.plan.subject, status="lost" if lost else "done", lost=lost,
            notes=tuple(dict.fromkeys(self.notes)), key=found.key, version=VERSION, videos=self.plan.videos,
            seeds=self.plan.seeds, frames=max((m.frames for m in markers), default=0), start_ns=told.start_ns,
            duration_s=told.duration_s, markers=markers, requests=requests, clocks=clocks, strokes=strokes,
        )  # fmt: skip

    def _publish(self, recording: Path, *, strokes: bool) -> dict[str, int]:
        """All files into their places, tables of strokes where some were looked for; what was there of an earlier run
        goes. Without run.json there is no result, so that one which is ended in between is made again. Returns how many
        bytes the recording and each table has."""
        ready = {RECORDING: recording, TABLES: self.folder / WORK / TABLES}
        stem = recording.with_suffix("")
        for ending in (".layout.json", ".report.html"):
            ready[f"session{ending}"] = stem.with_name(stem.name + ending)
        for ending in ("events", "strokes", "mean_cycle"):
            table = stem.with_name(f"{stem.name}.{ending}.csv")
            if table.exists() and strokes:
                table.rename(ready[TABLES] / f"{ending}.csv")
        files = {RECORDING: recording} | {f"{TABLES}/{path.name}": path for path in sorted(ready[TABLES].iterdir())}
        for path in files.values():
            with path.open("rb") as file:
                os.fsync(file.fileno())
        sizes = {name: path.stat().st_size for name, path in files.items()}
        (self.folder / RUN).unlink(missing_ok=True)
        for name, made in ready.items():
            there = self.folder / name
            if there.is_dir():
                shutil.rmtree(there)
            if made.exists():
                made.rename(there)
            else:
                there.unlink(missing_ok=True)
        return sizes

    def _write_layout(self, recording: Path) -> None:
        try:
            write_layout(recording, layout_path(recording))
        except UsageError as error:
            self.say(f"no layout: {error}")

    # --- small things ---

    def _video(self) -> Path:
        """What is tracked: the video, or a list of its chapters."""
        videos = [self._local(video) for video in self.plan.videos]
        if len(videos) == 1:
            return videos[0]
        listed = self.folder / WORK / f"{self.plan.name}.ffconcat"
        listed.write_text(write_list(videos, listed.parent), encoding="utf-8")
        return listed

    def _local(self, path: str) -> Path:
        """Where an input is read: an address is copied first, once."""
        if not is_address(path):
            return Path(path)
        if path not in self.copies:
            self.copies[path] = fetched(path, self.folder / WORK / "inputs" / str(len(self.copies)), self._go_on)
        return self.copies[path]

    def _go_on(self) -> None:
        """Raises Interrupted where whoever runs it wants it to end."""
        if self.stop():
            raise Interrupted

    def _made(self, name: str) -> Path:
        """A folder in the work folder."""
        folder = self.folder / WORK / name
        make_folder(folder)
        return folder

    def _reported(self, lost: Iterable[str], notes: Iterable[str], stopped: bool) -> None:
        """Take over what a step says. Raises Interrupted."""
        if stopped:
            raise Interrupted
        self._go_on()
        for lines, own in ((self.lost, lost), (self.notes, notes)):
            for line in own:
                told = line.replace(HOW_TO_ANSWER, "spheremcap annotate OUT, and run the season again")
                lines.append(told.replace(f"{self.folder / WORK}/", ""))
                self.say(lines[-1])

    @contextmanager
    def _step(self, name: str) -> Iterator[None]:
        """Say which step begins, and take its time."""
        self.say(f"{name} ...")
        self.progress(name, 0, None)
        since = time.monotonic()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - since


def _clocks(dataset: Dataset) -> tuple[ClockOutcome, ...]:
    """Where each sensor lies, and how well that is known."""
    clocks = []
    for place in dataset.placements:
        if place.what != "samples":
            continue
        first_ns, last_ns = place.span_ns
        sync = dataset.syncs.get(place.name)
        clocks.append(
            ClockOutcome(
                sensor=place.name, samples=place.count, first_ns=first_ns, last_ns=last_ns,
                added=", ".join(place.added) or "nothing",
                residual_ms=None if sync is None else sync.residual_s * 1e3,
                error_ms=None if sync is None else sync.error_s * 1e3,
                windows=None if sync is None else sync.facts()["sync_windows"],
                drift_ppm=None if sync is None else sync.drift_ppm,
            )
        )  # fmt: skip
    return tuple(clocks)


def _copy_alone(records: McapRecords, made: Recorded, out: Path) -> None:
    """What was tracked, without what merging and analysing added to it."""
    with open_output(out, profile=records.profile) as writer:
        for record in records.metadata:
            if record.name in made.metadata:
                writer.add_metadata(record.name, record.metadata)
        for file in list(records.attachments())[: made.attachments]:
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        Join(writer, [McapStream(records, topics=set(made.topics), extras=False)]).rest()
