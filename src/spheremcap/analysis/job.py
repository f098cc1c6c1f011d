"""The job: read a recording, analyse it, and write it again with what was found beside it."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tomli_w
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from mcap.records import Attachment

from spheremcap.analysis.cycles import PERCENT, Band, bands_of
from spheremcap.analysis.findings import Findings, Session, findings_of
from spheremcap.analysis.messages import ROOT, messages_of
from spheremcap.analysis.page import page
from spheremcap.analysis.settings import AnalysisSettings
from spheremcap.core.camera import Camera
from spheremcap.core.chair import ChairClick
from spheremcap.core.stroke import Stroke, StrokeEvent
from spheremcap.errors import SourceError, UsageError
from spheremcap.io import _pb
from spheremcap.io.chair_file import chair_toml, load_chair
from spheremcap.io.export import tables
from spheremcap.io.join import CLOCK_METADATA, OutMessage
from spheremcap.io.mcap_log import schema_id
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.messages import Message
from spheremcap.io.output import VERSION, checked_output, records_output, whole_file
from spheremcap.io.poses import PoseRows
from spheremcap.io.recording import (
    CALIBRATION,
    REQUEST,
    STATE,
    UNREADABLE,
    WHEEL,
    SensorRows,
    camera_in,
    damage_line,
    first_settings,
    request_of,
    runs_of,
    schema_names,
    sensor_name,
    track_name,
)
from spheremcap.io.rewrite import ChunkWriter, copy_piece
from spheremcap.io.strokes import columns_of
from spheremcap.io.topics import REPLACED, Topics, topics_of

ANALYSIS_METADATA = "spheremcap/analysis/"
_MADE_BY = {"made_by": "analysis"}
_CHUNK_MESSAGES = 8192
_HELD_BYTES = 4 << 20
Progress = Callable[[int, int | None], None]


@dataclass
class AnalysisReport:
    """What an analysis did: what it wrote and found, what the person should know (its notes), and what was lost.

    One that was `stopped` left what it had written in `part` (None: it had written nothing).
    """

    output: Path
    files: tuple[Path, ...]
    findings: Findings
    notes: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    stopped: bool = False
    part: Path | None = None


def analyse(
    recording: Path, output: Path, settings: AnalysisSettings, *, folder: Path, fill_ms: float, inputs: Sequence[Path],
    overwrite: bool, progress: Progress, stop: Callable[[], bool],
) -> AnalysisReport:  # fmt: skip
    """As `api.analyse`."""
    beside = beside_output(output)
    given = [recording, *inputs]
    clicks: Sequence[ChairClick] = ()
    size = 0, 0
    if settings.chair.clicks is not None:
        given.append(folder / settings.chair.clicks)
        clicks, size = load_chair(folder / settings.chair.clicks)
    for path in (output, *beside):
        checked_output(path, given, overwrite=overwrite)
    with McapRecords(recording, held_bytes=_HELD_BYTES) as records:
        found = findings_of(_clicked(_session(records), clicks, size), settings, clicks, fill_ms / 1e3)
        report = AnalysisReport(output, beside, found, list(found.notes))
        with records_output(
            output, lambda file: ChunkWriter(file, records.schemas, records.channels), given, overwrite, records.profile
        ) as writer:
            _write_facts(records, found, settings, clicks, fill_ms, writer)
            own = _outgoing(found, records, writer)
            total = len(records.pieces)
            waiting = next(own, None)
            for number, piece in enumerate(records.pieces):
                report.stopped = report.stopped or stop()
                if report.stopped:
                    break
                progress(number, total)
                batch = []
                while waiting is not None and waiting.log_time <= piece.end:
                    batch.append(waiting)
                    waiting = next(own, None)
                    if len(batch) == _CHUNK_MESSAGES:
                        writer.write(batch, "zstd")
                        batch = []
                writer.write(batch, "zstd")
                copy_piece(records, piece, writer)
            rest = [] if waiting is None or report.stopped else [waiting, *own]
            writer.write(rest, "zstd")
            writer.complete = not report.stopped
            report.part = writer.part if report.stopped and writer.counts else None
            report.notes += writer.notes
        damage = damage_line(records)
        report.lost += [damage] if damage is not None else []
    if not report.stopped:
        _write_beside(report, bands_of(found), given, overwrite)
    return report


def beside_output(output: Path) -> tuple[Path, Path, Path, Path]:
    """The page and the tables of an analysed recording: analysed.report.html, .events.csv, .strokes.csv and
    .mean_cycle.csv beside analysed.mcap."""
    stem = output.with_suffix("")
    page_path, *rest = (
        stem.with_name(stem.name + ending)
        for ending in (".report.html", ".events.csv", ".strokes.csv", ".mean_cycle.csv")
    )
    return page_path, rest[0], rest[1], rest[2]


def _session(records: McapRecords) -> Session:
    """What of a recording is analysed. Raises SourceError where it has no markers, or was analysed before."""
    topics = sorted({channel.topic for channel in records.channels.values()})
    if any(topic.startswith(f"{ROOT}/") for topic in topics):
        raise SourceError(f"{records.path}: was analysed already: analyse the recording that it was made from")
    names = schema_names(records)
    wanted = (STATE, WHEEL, CALIBRATION, REQUEST)
    reading = {c.topic for c in records.channels.values() if names[c.id] in wanted and not c.topic.startswith(REPLACED)}
    poses, wheels, asked = PoseRows(), dict[int, SensorRows](), Counter[str]()
    camera: Camera | None = None
    for raw in records.messages(reading) if reading else ():  # once, for the pictures lie between
        kind = names.get(raw.channel.id)
        try:
            if kind == STATE:
                poses.add(raw)
            elif kind == WHEEL:
                if raw.channel.id not in wheels:
                    wheels[raw.channel.id] = SensorRows(raw.channel, records)
                wheels[raw.channel.id].add(raw)
            elif kind == CALIBRATION:
                camera = camera or camera_in(CameraCalibration.FromString(raw.data), raw.channel)
            elif kind == REQUEST and not (request := request_of(raw)).answered:
                asked[track_name(raw.channel.topic, request.marker)] += 1
        except UNREADABLE as error:
            records.undecodable(raw.channel.topic, error)
    found = poses.poses()
    if not found:
        raise SourceError(
            f"{records.path}: has no markers of spheremcap in it; its topics: {', '.join(topics) or 'none'}"
        )
    said = first_settings(records).get("camera", {})
    readout_s = said.get("readout_s") if isinstance(said, dict) else None
    return Session(
        records.path.stem, found, {sensor_name(rows.topic): rows.sensor() for rows in wheels.values() if len(rows)},
        camera, float(readout_s) if isinstance(readout_s, int | float) else None, dict(asked),
        {
            record.name.removeprefix(CLOCK_METADATA).rpartition("/")[0]: record.metadata
            for record in records.metadata
            if record.name.startswith(CLOCK_METADATA)
        },
    )  # fmt: skip


def _clicked(session: Session, clicks: Sequence[ChairClick], size: tuple[int, int]) -> Session:
    """The session, where the clicks are on pictures like its own. Raises UsageError."""
    camera = session.camera
    if clicks and camera is not None and size != (camera.width_px, camera.height_px):
        raise UsageError(
            f"chair.clicks: they are on {size[0]}x{size[1]} pictures, the recording's are "
            f"{camera.width_px}x{camera.height_px}"
        )
    return session


def _write_facts(
    records: McapRecords, found: Findings, settings: AnalysisSettings, clicks: Sequence[ChairClick], fill_ms: float,
    writer: ChunkWriter,
) -> None:  # fmt: skip
    """The recording's metadata and attachments, and beside them what the analysis was made with."""
    for record in records.metadata:
        writer.add_metadata(record.name, record.metadata)
    for attachment in records.attachments():
        writer.add_attachment(attachment)
    text = tomli_w.dumps(settings.model_dump(exclude_none=True))
    texts = {"analysis.toml": text}
    if clicks and found.session.camera is not None:
        texts["chair.toml"] = chair_toml(clicks, found.session.camera.width_px, found.session.camera.height_px)
    facts = {"version": VERSION, "input": records.path.name, "fill_ms": f"{fill_ms:g}", **_facts(found)}
    told = "\0".join([*texts.values(), *(word for pair in sorted(facts.items()) for word in pair)])
    writer.add_metadata(ANALYSIS_METADATA + hashlib.sha256(told.encode()).hexdigest()[:12], facts)
    for name, content in texts.items():
        stamp_ns = int(found.stamp_ns[0])
        writer.add_attachment(Attachment(stamp_ns, stamp_ns, name, "application/toml", content.encode()))


def _facts(found: Findings) -> dict[str, str]:
    """What the numbers rest on, for whoever has only the file."""
    facts = {"notes": "; ".join(found.notes)}
    if found.chair is not None:
        facts |= {"chair": ", ".join(found.chair.told_by), "chair.upright": str(found.chair.upright).lower()}
        facts |= {f"{side}.too_far": f"{share:+.4f}" for side, share in found.chair.too_far.items()}
    for side, hand in found.hands.items():
        facts |= {f"{side}.push_radius_m": f"{hand.push_radius_m:.5f}", f"{side}.strokes": str(len(hand.strokes))}
    return facts


def _outgoing(found: Findings, records: McapRecords, writer: ChunkWriter) -> Iterator[OutMessage]:
    """The messages of what was found, on channels of their own."""
    facts = next(iter(runs_of(records).values()), {})
    topics = topics_of(facts) or Topics()
    channels: dict[str, int] = {}
    sequences = Counter[str]()

    def register(topic: str, kind: type[Message]) -> None:
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "protobuf", schema_id(writer, kind), dict(_MADE_BY))

    for side in found.arms:  # there also where no stroke was found: somebody has looked
        register(f"{ROOT}/{side}/events", _pb.StrokeEvent)
        register(f"{ROOT}/{side}/strokes", _pb.Stroke)
    for stamp_ns, topic, message in messages_of(found, topics.optical_frame):
        register(topic, type(message))
        sequences[topic] += 1
        yield OutMessage(stamp_ns, stamp_ns, sequences[topic], channels[topic], message.SerializeToString())


def _write_beside(report: AnalysisReport, bands: Sequence[Band], given: Sequence[Path], overwrite: bool) -> None:
    """The tables and the page."""
    found = report.findings
    page_path, events_path, strokes_path, cycle_path = report.files
    events = sorted((e for hand in found.hands.values() for e in hand.events), key=lambda e: (e.stamp_ns, e.side))
    strokes = sorted((s for hand in found.hands.values() for s in hand.strokes), key=lambda s: (s.stamp_ns, s.side))
    rows = {
        events_path: columns_of(StrokeEvent, events),
        strokes_path: columns_of(Stroke, strokes),
        cycle_path: {
            "side": np.repeat([band.side for band in bands], len(PERCENT)),
            "quantity": np.repeat([band.quantity for band in bands], len(PERCENT)),
            "percent": np.tile(PERCENT, len(bands)),
            "mean": np.concatenate([band.mean for band in bands]) if bands else np.zeros(0),
            "sd": np.concatenate([band.sd for band in bands]) if bands else np.zeros(0),
            "cycles": np.repeat(np.array([band.cycles for band in bands], np.int64), len(PERCENT)),
        },
    }
    for path, columns in rows.items():
        with whole_file(path, given, overwrite=overwrite) as part:
            tables.write_csv(part.path, columns, iter(()), 0)
            report.notes += part.notes
    with whole_file(page_path, given, overwrite=overwrite) as part:
        part.path.write_text(page(found, bands), encoding="utf-8")
        report.notes += part.notes
