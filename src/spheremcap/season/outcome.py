"""run.json: how a session ended, what decided it, and what is in it; lists and pages are made of that."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from spheremcap.errors import SourceError
from spheremcap.io.output import VERSION, write_durably
from spheremcap.season.manifest import SEASON as SEASON
from spheremcap.season.manifest import Plan, Season

RUN = "run.json"
RECORDING = "session.mcap"
SESSIONS, REPORT = "sessions.parquet", "report.html"
"""What `dataset tables` writes for all sessions, beside a folder for each table."""
TABLES = "tables"
LOG = "log.txt"
WORK = ".work"
"""Where a session is made until it is whole, in its folder."""

OUT_OF_MEMORY = "out of memory: it needed more than there was: run fewer at once (--workers)"

Status = Literal["done", "lost", "failed"]
"""done: all of it. lost: done, and something of it could not be had. failed: there is no result."""


class _Noun(BaseModel):
    model_config = ConfigDict(frozen=True)


class InputFile(_Noun):
    """A file or folder that decided the result, as it was; `sha256` is that of its content. `state` is what can be told
    of it without reading it: it is another one whenever the content is."""

    path: str
    size_bytes: int
    state: str
    sha256: str


class Asked(_Noun):
    """A question that the tracker asks: where is the marker from this frame on? `answered` says by what, "" if not."""

    marker: str
    frame: int
    stamp_ns: int
    raised_at_frame: int
    reason: str
    reasons: tuple[str, ...] = ()
    answered: str = ""


class MarkerOutcome(_Noun):
    """A marker's frames by status, and its longest run of frames without a measured position."""

    marker: str
    frames: int
    frames_by_status: dict[str, int]
    measured: int
    """Frames with a position that was measured."""
    longest_gap_frames: int
    longest_gap_s: float


class ClockOutcome(_Noun):
    """How a sensor's times were placed on the video's: what was added, in words; what `sync` found, None without it."""

    sensor: str
    samples: int
    first_ns: int
    last_ns: int
    added: str
    residual_ms: float | None = None
    error_ms: float | None = None
    windows: str | None = None
    drift_ppm: float | None = None


class Recorded(_Noun):
    """What session.mcap was made from, so that only what has changed is made again: keys of what was tracked and of
    the answers in it; which topics, metadata and attachments are those of the tracking alone, and what that said."""

    tracked: str
    answers: str
    topics: tuple[str, ...]
    metadata: tuple[str, ...]
    attachments: int
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    stretches: tuple[str, ...] = ()
    """What tracking them again after an answer said."""


class Outcome(_Noun):
    """How a session ended.

    `reason` says why it failed, `lost` what could not be had, a line each. `key` is of all that decided it: the same
    key is the same result. `frames`, `start_ns` and `duration_s` are those of the recording. `seconds` by step and
    `peak_mb` are of the run, and no result.
    """

    session: str
    subject: str = ""
    status: Status
    reason: str = ""
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    key: str = ""
    version: str
    videos: tuple[str, ...] = ()
    seeds: str = ""
    inputs: tuple[InputFile, ...] = ()
    frames: int = 0
    start_ns: int | None = None
    duration_s: float = 0.0
    markers: tuple[MarkerOutcome, ...] = ()
    requests: tuple[Asked, ...] = ()
    clocks: tuple[ClockOutcome, ...] = ()
    strokes: dict[str, int] = {}
    """Strokes of each side that was looked at."""
    recorded: Recorded | None = None
    files: dict[str, int] = {}
    """Bytes of the recording and of each table, by where it is in the session's folder."""
    seconds: dict[str, float] = {}
    peak_mb: int | None = None

    @property
    def measured(self) -> float | None:
        """Share of all markers' frames that were measured, 0 to 1; None where there are none."""
        frames = sum(marker.frames for marker in self.markers)
        return sum(marker.measured for marker in self.markers) / frames if frames else None

    @property
    def open_requests(self) -> tuple[Asked, ...]:
        """Those that nobody has answered."""
        return tuple(asked for asked in self.requests if not asked.answered)

    def line(self) -> str:
        """How it ended, for a person."""
        if self.status == "failed":
            return f"failed: {self.reason}"
        share = "" if self.measured is None else f", {self.measured:.1%} measured"
        asked = len(self.open_requests)
        questions = f", {asked} question{'s' * (asked != 1)}" if asked else ""
        lost = f"; lost: {'; '.join(self.lost)}" if self.lost else ""
        return f"done{share}{questions}{lost}"


def failed(plan: Plan, reason: str, before: Outcome | None) -> Outcome:
    """A session that has no result; what was recorded `before` stays for when it is mended."""
    return Outcome(
        session=plan.name, subject=plan.subject, status="failed", reason=reason, version=VERSION, videos=plan.videos,
        seeds=plan.seeds, inputs=before.inputs if before is not None else (),
        recorded=before.recorded if before is not None else None,
    )  # fmt: skip


def read_outcome(folder: Path) -> Outcome | None:
    """What a session's run.json says; None where there is none, or one that is damaged or of another version's."""
    try:
        return Outcome.model_validate_json((folder / RUN).read_bytes())
    except (OSError, ValidationError):
        return None


def is_whole(folder: Path, outcome: Outcome) -> bool:
    """Whether what a result consists of is there still, as large as it was."""
    try:
        return bool(outcome.files) and all(
            (folder / name).stat().st_size == size for name, size in outcome.files.items()
        )
    except OSError:
        return False


def write_outcome(folder: Path, outcome: Outcome) -> None:
    """The same as a file, whole or not at all. Raises OutputError."""
    write_durably(folder / RUN, outcome.model_dump_json(indent=1) + "\n")


def others_in(out: Path, season: Season) -> list[Path]:
    """Folders of sessions that the season does not have any more, or calls otherwise."""
    names = {plan.name for plan in season.plans}
    try:
        return sorted(folder for folder in out.iterdir() if folder.name not in names and (folder / RUN).is_file())
    except FileNotFoundError:
        return []


def write_season(out: Path, season: Season) -> None:
    """Note in the output's folder which sessions there are, run or not. Raises OutputError."""
    write_durably(out / SEASON, season.model_dump_json(indent=1) + "\n")


def read_season(out: Path) -> Season:
    """The season whose sessions were run into `out`. Raises SourceError where nothing was."""
    try:
        return Season.model_validate_json((out / SEASON).read_bytes())
    except FileNotFoundError:
        raise SourceError(
            f"{out}: no season was run into it (there is no {SEASON}); name the folder that `dataset run -o` was given"
        ) from None
    except OSError as error:
        raise SourceError(f"{out / SEASON}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise SourceError(
            f"{out / SEASON}: is damaged, or of another version: run `dataset run` once more, which writes it anew"
        ) from error
