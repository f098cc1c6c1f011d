"""What is inside an MCAP, ours or anybody's."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel

from spheremcap.core.estimate import OperatorRequest, Status
from spheremcap.core.time import NS_PER_S
from spheremcap.io.decode import Decode, decoder
from spheremcap.io.mcap_records import McapRecords, RawMessage
from spheremcap.io.recording import (
    REQUEST,
    STATE,
    UNREADABLE,
    StateRow,
    damage_line,
    request_of,
    runs_of,
    schema_names,
    state_row,
    track_name,
)

PICTURES = ("foxglove.CompressedVideo", "foxglove.CompressedImage", "foxglove.RawImage")


@dataclass(frozen=True)
class TopicSummary:
    """One topic of a file: its schema, encoding and number of messages."""

    topic: str
    schema: str
    encoding: str
    messages: int


@dataclass(frozen=True)
class MarkerSummary:
    """One marker of a recording.

    The longest gap is the longest run of frames without a measured position: in frames, and in seconds from
    the measured frame before to the one after (from the first or to the last frame where there is none).
    """

    marker: str
    frames: int
    frames_by_status: Mapping[str, int]
    longest_gap_frames: int
    longest_gap_s: float
    requests: tuple[OperatorRequest, ...]

    @property
    def verified_share(self) -> float:
        """Share of the frames that are VERIFIED, 0 to 1."""
        return self.frames_by_status.get(Status.VERIFIED.value, 0) / self.frames if self.frames else 0.0


@dataclass(frozen=True)
class Summary:
    """What is inside an MCAP, ours or anybody's. Times are log times; None when there are no messages.

    `video` is a line for each image topic. `runs` is what our tool wrote of each run, by its id:
    `input_name`, `input_sha256`, `time_source`, `version` and so on. `unread_chunks` of the file's chunks were not
    opened, and the numbers of messages are then the file's own; `undecoded` messages have an encoding that is not
    read here. `damage` is one line about what is damaged (None: nothing was found), `lost` are all of them.
    """

    path: Path
    size_bytes: int
    profile: str
    library: str
    start_ns: int | None
    end_ns: int | None
    topics: tuple[TopicSummary, ...]
    markers: tuple[MarkerSummary, ...]
    video: tuple[str, ...]
    runs: Mapping[str, Mapping[str, str]]
    attachments: tuple[str, ...]
    unread_chunks: int
    undecoded: int
    damage: str | None
    lost: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last message."""
        return ((self.end_ns or 0) - (self.start_ns or 0)) / NS_PER_S


def summarise(path: str | os.PathLike[str], *, check: bool = False) -> Summary:
    """Say what is inside an MCAP file; `check` reads all of it: every chunk, checksum and message.

    Raises SourceError when it is none.
    """
    gaps: dict[str, _Gap] = {}
    requests: dict[str, list[OperatorRequest]] = {}
    with McapRecords(path) as records:
        names = schema_names(records)
        ours = {c.topic for c in records.channels.values() if names[c.id] in (STATE, REQUEST)}
        all_of_it = _Checked(records)
        if check:
            records.check_data()
        for raw in records.messages(None if check else ours):
            try:
                schema = names.get(raw.channel.id)  # of a channel that only a damaged chunk has, nobody knew before
                if schema == STATE:
                    row = state_row(raw.data, raw.log_time)
                    gaps.setdefault(track_name(raw.channel.topic, row.marker), _Gap()).add(row)
                elif schema == REQUEST:
                    request = request_of(raw)
                    requests.setdefault(track_name(raw.channel.topic, request.marker), []).append(request)
                else:
                    all_of_it.decode(raw)
            except UNREADABLE as error:
                records.undecodable(raw.channel.topic, error)
        channels = sorted(records.channels.values(), key=lambda channel: (channel.topic, channel.id))
        names = schema_names(records)
        shown = {c.topic: c for c in reversed(channels) if names[c.id] in PICTURES}
        video = tuple(_picture_line(records, shown[topic], count_bad=not check) for topic in sorted(shown))
        start_ns, end_ns = records.span_ns or (None, None)
        return Summary(
            path=Path(path),
            size_bytes=Path(path).stat().st_size,
            profile=records.profile,
            library=records.library,
            start_ns=start_ns,
            end_ns=end_ns,
            topics=_topics(records, channels, names),
            markers=tuple(gap.summary(name, requests.get(name, [])) for name, gap in gaps.items()),
            video=video,
            runs=runs_of(records),
            attachments=tuple(attachment.name for attachment in records.attachments()),
            unread_chunks=0 if check or records.all_read else records.chunk_count,
            undecoded=all_of_it.undecoded,
            damage=damage_line(records),
            lost=tuple(records.damage()),
        )


def _topics(records: McapRecords, channels: Sequence[Channel], names: Mapping[int, str]) -> tuple[TopicSummary, ...]:
    """A line for each topic; what rests on a person's answers is on a channel of its own, and counted in."""
    counts: dict[tuple[str, str, str], int] = {}
    for c in channels:
        key = c.topic, names[c.id], c.message_encoding
        counts[key] = counts.get(key, 0) + records.counts.get(c.id, 0)
    return tuple(TopicSummary(*key, count) for key, count in counts.items())


class _Checked:
    """Decodes messages only to see that it can be done."""

    def __init__(self, records: McapRecords) -> None:
        self.undecoded = 0
        self._records = records
        self._decoders: dict[int, Decode | ValueError | None] = {}

    def decode(self, raw: RawMessage) -> None:
        """Raises ValueError when the message, or its schema, cannot be read."""
        channel = raw.channel
        if channel.id not in self._decoders:
            try:
                self._decoders[channel.id] = decoder(channel, self._records.schemas.get(channel.schema_id))
            except ValueError as error:
                self._decoders[channel.id] = error
        decode = self._decoders[channel.id]
        if isinstance(decode, ValueError):
            raise decode
        if decode is None:
            self.undecoded += 1
        else:
            decode(raw.data)


class _Gap:
    """Counts one marker's frames by status and finds its longest run without a measurement."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._longest = (0, 0)
        self._frames = 0
        self._since_ns = 0
        self._requests: list[OperatorRequest] = []

    def add(self, row: StateRow) -> None:
        if not self._counts:
            self._since_ns = row.stamp_ns
        self._counts[row.status] += 1
        measured = Status(row.status).measured if row.status else False
        self._frames += not measured
        if self._frames:
            self._longest = max(self._longest, (self._frames, row.stamp_ns - self._since_ns))
        if measured:
            self._frames, self._since_ns = 0, row.stamp_ns

    def summary(self, marker: str, requests: Sequence[OperatorRequest]) -> MarkerSummary:
        counts = {s.value: self._counts[s.value] for s in Status if self._counts[s.value]}
        frames, gap_ns = self._longest
        return MarkerSummary(marker, self._counts.total(), counts, frames, gap_ns / NS_PER_S, tuple(requests))


def _picture_line(records: McapRecords, channel: Channel, count_bad: bool) -> str:
    """`/camera/video: h264, 480 pictures`; `count_bad` says whether a message that does not decode is a new one."""
    schema = records.schemas[channel.schema_id]
    kind = schema.name.removeprefix("foxglove.")
    count = sum(records.counts.get(c.id, 0) for c in records.channels.values() if c.topic == channel.topic)
    raw = next(iter(records.messages([channel.topic])), None)
    try:
        decode = decoder(channel, schema)
        if raw is not None and decode is not None:
            message = decode(raw.data)
            kind = getattr(message, "format", "") or getattr(message, "encoding", "") or kind
    except ValueError as error:
        if count_bad:
            records.undecodable(channel.topic, error)
    return f"{channel.topic}: {kind}, {count} pictures"
