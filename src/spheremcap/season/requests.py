"""All that the tracker asks of a season, as one list."""

from dataclasses import dataclass
from pathlib import Path

from spheremcap.config import load_seeds, seeds_toml
from spheremcap.errors import SpheremcapError
from spheremcap.operator.opened import Opened
from spheremcap.season.key import key_of
from spheremcap.season.manifest import Plan
from spheremcap.season.outcome import RECORDING, Asked, Outcome, read_outcome, read_season


@dataclass(frozen=True)
class Question:
    """What one session asks; `seeds` is where the answer goes. `answered`: it is there already, and only the session
    has not been run since."""

    session: str
    recording: Path
    seeds: Path
    start_ns: int
    asked: Asked
    answered: bool


def questions(out: Path) -> list[Question]:
    """The open questions of all sessions that were run into `out`, by session and frame. Raises SourceError."""
    found = []
    for plan in read_season(out).plans:
        outcome = read_outcome(out / plan.name)
        if outcome is None or outcome.status == "failed" or not outcome.open_requests:
            continue
        recording = out / plan.name / RECORDING
        unanswered = _unanswered(plan, outcome, recording)
        for asked in sorted(outcome.open_requests, key=lambda asked: (asked.frame, asked.marker)):
            answered = unanswered is not None and (asked.marker, asked.frame) not in unanswered
            found.append(
                Question(plan.name, recording, Path(plan.seeds), outcome.start_ns or 0, asked, answered)
            )  # fmt: skip
    return found


def _unanswered(plan: Plan, outcome: Outcome, recording: Path) -> set[tuple[str, int]] | None:
    """Marker and frame of what is still open where the seeds file has changed since the run; None where it has not, or
    cannot be read."""
    seeds = Path(plan.seeds)
    try:
        if not seeds.is_file() or outcome.recorded is None:
            return None
        if key_of(seeds_toml(load_seeds(seeds))) == outcome.recorded.answers:
            return None
        left: set[tuple[str, int]] = set()
        with Opened(recording, seeds=seeds) as first:
            cameras = first.cameras or (None,)
        for camera in cameras:
            with Opened(recording, seeds=seeds, camera=camera) as opened:
                place = f"{camera}/" if camera is not None else ""
                answers = opened.answers.answers()
                left |= {
                    (place + request.asked.marker, request.asked.frame_index)
                    for request in opened.asked()
                    if not request.asked.answered and not request.answered(answers, opened.last)
                }
    except SpheremcapError:
        return None
    return left
