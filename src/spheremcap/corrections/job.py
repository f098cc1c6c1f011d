"""The jobs: put all answers into a recording, or see what one circle would change."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from spheremcap.config import seeds_toml
from spheremcap.core.estimate import Status
from spheremcap.core.marker import Answer, Seed
from spheremcap.corrections.footage import Footage
from spheremcap.corrections.rewriting import Rewriting
from spheremcap.corrections.run import (
    ANSWERS,
    Run,
    ViewKeeper,
    answered_markers,
    by_run,
    named_answers,
    new_id,
    opened,
)
from spheremcap.corrections.told import lost_marker, said, told_of
from spheremcap.errors import UsageError
from spheremcap.io.course import ANSWERED_METADATA, COURSE_METADATA, course_lines
from spheremcap.io.join import OutMessage
from spheremcap.io.mcap_log import OUTCOME_METADATA, RUN_METADATA
from spheremcap.io.mcap_records import McapRecords, Piece
from spheremcap.io.output import records_output
from spheremcap.io.rewrite import ChunkWriter, copy_piece, same, write_piece
from spheremcap.stretch import Corrected, Stretch, base_seeds, correct


@dataclass
class Report:
    """What a job on a recording did: frames tracked, statuses per marker, requests, what was lost, and what the user
    should know.

    One that was `stopped` left what it had written in `part` (None: it had written nothing).
    """

    output: Path
    frames: int = 0
    statuses: dict[str, Counter[Status]] = field(default_factory=dict)
    requests: int = 0
    lost: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stopped: bool = False
    part: Path | None = None

    @property
    def complete(self) -> bool:
        """Nothing was lost: every frame decoded, and no marker lost at the end."""
        return not self.lost and not self.stopped


@dataclass
class RetrackReport(Report):
    """What `retrack` did: `frames` were tracked again; `statuses` is by how much their numbers have changed; `requests`
    are still open. `stretches` says in a line each what the answers changed."""

    stretches: list[str] = field(default_factory=list)


def stretch_of(
    recording: Path, answer: Seed, *, others: Sequence[Answer], source: Path | None, view_keeper: ViewKeeper,
    go_on: Callable[[], bool],
) -> Stretch:  # fmt: skip
    """What one circle changes, given the recording's answers and `others`; nothing is written."""
    with opened(recording) as (records, runs), ExitStack() as files:
        given = dict.fromkeys([*(a for run in runs for a in named_answers(run, runs)), *others, answer])
        for run, answers in zip(runs, by_run(runs, list(given), recording), strict=True):
            marker = answer.marker.removeprefix(f"{run.name}/") if len(runs) > 1 else answer.marker
            only = replace(answer, marker=marker)
            if only not in answers:
                continue
            if only in base_seeds(answers):
                raise UsageError(f"{recording}: {said(answer)} is where {answer.marker} began: nothing changes")
            footage = Footage(run, records, source, True, files)
            corrected = correct(marker, answers, run.terms(view_keeper), run.states.at, footage.at, go_on, only)
            return next(stretch for stretch in corrected.stretches if stretch.answer == only)
    raise UsageError(f"{recording}: no camera has {answer.marker}")


def retrack(
    recording: Path, output: Path, answers: Sequence[Answer], *, source: Path | None, checked: bool,
    view_keeper: ViewKeeper, inputs: Sequence[Path], overwrite: bool, progress: Callable[[int, int | None], None],
    stop: Callable[[], bool], ids: Collection[str] | None = None,
) -> RetrackReport:  # fmt: skip
    """As `api.retrack`, of all runs or those of these ids; `checked` says that the source is known to be the input."""
    report = RetrackReport(output)

    def go_on() -> bool:
        report.stopped = report.stopped or stop()
        if not report.stopped:
            report.frames += 1
            progress(report.frames, None)
        return not report.stopped

    with opened(recording, ids) as (records, runs), ExitStack() as files:
        done: list[tuple[Run, list[Answer], dict[str, Corrected], Footage | None]] = []
        for run, own in zip(runs, by_run(runs, answers, recording), strict=True):
            markers = answered_markers(own)
            begun = base_seeds(own)
            circles = any(isinstance(answer, Seed) and answer not in begun for answer in own)
            footage = Footage(run, records, source, checked, files) if circles else None
            terms = run.terms(view_keeper)
            found = {}
            for marker in markers:
                at = footage.at if footage is not None else lambda index: None
                found[marker] = correct(marker, own, terms, run.states.at, at, go_on)
            if report.stopped:
                return report
            done.append((run, own, found, footage))
            report.notes += [footage.note] if footage is not None and footage.note else []
            for one in found.values():
                report.stretches += [told_of(stretch) for stretch in one.stretches if len(stretch)]
                report.stretches += [f"{one.marker}: {said(hidden)}" for hidden in one.hidden]
                report.lost += [told_of(stretch) for stretch in one.stretches if not len(stretch)]
        given = [recording, *([source] if source is not None else []), *inputs]
        with records_output(
            output, lambda file: ChunkWriter(file, records.schemas, records.channels), given, overwrite, records.profile
        ) as writer:
            work = [Rewriting(run, records, own, found, footage, writer) for run, own, found, footage in done]
            renamed = _write_facts(records, done, writer)
            for piece in records.pieces:
                report.stopped = report.stopped or stop()
                if report.stopped:
                    break
                progress(report.frames, None)
                _write_piece(records, piece, work, writer)
            for _, _, _, footage in done:
                if footage is not None:
                    footage.confirm()
            report.lost += _write_outcomes(records, done, work, renamed, report.stopped, writer)
            writer.complete = not report.stopped
            report.part = writer.part if report.stopped and writer.counts else None
            report.notes += writer.notes
        for one_run, rewriting in zip(runs, work, strict=True):
            place = f"{one_run.name}/" if one_run.name else ""
            report.statuses |= {place + name: counts for name, counts in rewriting.statuses.items()}
            report.requests += rewriting.open_requests
    return report


def _write_piece(records: McapRecords, piece: Piece, work: Sequence[Rewriting], writer: ChunkWriter) -> None:
    """One chunk: as it is, where nothing in it changes."""
    if not any(run.changes(piece) for run in work):
        copy_piece(records, piece, writer)
        return
    out: list[OutMessage] = []
    for raw in records.messages_of(piece):
        changed = (made for run in work if (made := run.rewritten(raw)) is not None)
        found = next(changed, None)
        out += [same(raw)] if found is None else found
    write_piece(records, piece, out, writer)


_Done = Sequence[tuple[Run, list[Answer], dict[str, Corrected], Footage | None]]


def _write_facts(records: McapRecords, done: _Done, writer: ChunkWriter) -> dict[str, str]:
    """Metadata and attachments, with the runs' new answers; the runs' new ids by their old ones."""
    renamed, seeds = {}, {}
    for run, own, found, _ in done:
        text = seeds_toml(own)
        seeds[run.seeds_place] = text
        renamed[run.id] = new_id(run.facts, run.settings_toml, text)
        lines = [told_of(stretch) for one in found.values() for stretch in one.stretches]
        lines += [f"{one.marker}: {said(hidden)}" for one in found.values() for hidden in one.hidden]
        facts = {key: told for key, told in run.own_facts.items() if key != ANSWERS}
        writer.add_metadata(RUN_METADATA + renamed[run.id], facts | ({ANSWERS: "; ".join(lines)} if lines else {}))
    names = {COURSE_METADATA + old: COURSE_METADATA + new for old, new in renamed.items()}
    anew = {prefix + old for old in renamed for prefix in (RUN_METADATA, ANSWERED_METADATA)}
    for record in records.metadata:
        if record.name not in anew and not record.name.startswith(OUTCOME_METADATA):
            writer.add_metadata(names.get(record.name, record.name), record.metadata)
    for place, attachment in enumerate(records.attachments()):
        if place in seeds:
            attachment = replace(attachment, data=seeds[place].encode())
        writer.add_attachment(attachment)
    return renamed


def _write_outcomes(
    records: McapRecords, done: _Done, work: Sequence[Rewriting], renamed: Mapping[str, str], stopped: bool,
    writer: ChunkWriter,
) -> list[str]:  # fmt: skip
    """How each run ended, with its answers; and what is lost of them, a line each."""
    lost: list[str] = []
    for record in records.metadata:
        id_ = record.name.removeprefix(OUTCOME_METADATA)
        if id_ == record.name:
            continue
        facts = dict(record.metadata)
        for (run, _, found, _), rewriting in zip(done, work, strict=True):
            if run.id != id_:
                continue
            place, lines = (
                f"{run.name}/" if run.name else "",
                [line for line in facts.get("lost", "").split("; ") if line],
            )
            for one in found.values():
                lines = _lost_at_the_end(run, one, rewriting, place, lines)
            facts["lost"] = "; ".join(lines)
            lost += lines
            if lines_of_course := course_lines(rewriting.courses):
                writer.add_metadata(ANSWERED_METADATA + renamed[id_], lines_of_course)
        facts["complete"] = "no" if stopped else facts.get("complete", "yes")
        writer.add_metadata(OUTCOME_METADATA + renamed.get(id_, id_), facts)
    return lost


def _lost_at_the_end(run: Run, one: Corrected, rewriting: Rewriting, place: str, lines: list[str]) -> list[str]:
    """The outcome's lines with what is so of this marker where an answer changed its last frame."""
    states = run.states
    if one.at(states.last_index) is None:
        return lines
    lines = [line for line in lines if not line.startswith(f"{place}{one.marker} is LOST at the end")]
    stretch = one.stretch_at(states.last_index)
    at_last = rewriting.estimates(states.count - 1).get(one.marker)
    if stretch is not None and at_last is not None and at_last.status is Status.LOST:
        found = (stretch.estimate(index) for index in reversed(stretch.frames))
        lines.append(lost_marker(place, one.marker, next((e for e in found if e.status.measured), None)))
    return lines
