"""The job: read a recording, analyse it, and write it again with what was found beside it."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tomli_w
from mcap.records import Attachment

from spheremcap.analysis import messages
from spheremcap.analysis.findings import Findings, Session, findings_of
from spheremcap.analysis.page import page
from spheremcap.analysis.settings import AnalysisSettings
from spheremcap.analysis.tables import write_tables
from spheremcap.config import load_chair
from spheremcap.core.time import NS_PER_S
from spheremcap.errors import UsageError
from spheremcap.io.calibration import camera_of
from spheremcap.io.join import CLOCK_METADATA, OutMessage
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import VERSION, records_output, whole_file
from spheremcap.io.poses import read_poses
from spheremcap.io.recording import read_facts
from spheremcap.io.rewrite import ChunkWriter

ANALYSIS_METADATA = "spheremcap/analysis/"
_CHUNK_MESSAGES = 4096


@dataclass
class AnalysisReport:
    """What an analysis did: where it wrote, what it found, what the person should know, and what was lost.

    One that was `stopped` left what it had written in `part` (None: it had written nothing).
    """

    output: Path
    page: Path
    tables: tuple[Path, ...] = ()
    findings: Findings | None = None
    notes: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    stopped: bool = False
    part: Path | None = None
