"""Recordings into one, by log time: messages, schemas, channels, metadata and attachments byte for byte.

Schemas coalesce by (name, encoding, data) and channels by (topic, schema, encoding, metadata), as the
official tool does it. Metadata records of one name and the same content become one; of one name and other
content the later one gets a number (`name#2`). Every input is read a few chunks at a time.
"""

import hashlib
import heapq
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from spheremcap.errors import UsageError
from spheremcap.io.frames import FrameNames
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.output import Compression, SharedWriter, open_output

CLOCK_METADATA = "spheremcap/clock/"
ASK_EVERY = 1024
"""After so many messages it is asked whether to go on: often enough for a person, seldom enough to cost nothing."""


class StampMap(Protocol):
    """How an input's stamps become those of the common time line; merging.clock.Clock is one."""

    def __call__(self, stamp_ns: int) -> int: ...

    def lines(self) -> dict[str, str]:
        """What a metadata record says of it."""


class OutMessage(NamedTuple):
    """A message on its way out: a channel id of the SharedWriter, times in ns, encoded data."""

    log_time: int
    publish_time: int
    sequence: int
    channel_id: int
    data: bytes


class Stream(Protocol):
    """Something that can be joined: it registers what it needs with the writer, then gives its messages in
    order.
    """

    @property
    def count(self) -> int:
        """How many messages it has, as far as is known before they are read."""

    def begin(self, writer: SharedWriter) -> None:
        """Register schemas and channels, write metadata and attachments."""

    def messages(self) -> Iterator[OutMessage]:
        """Messages by log time, after `begin`."""


class McapStream:
    """An MCAP input, or some topics of it, on the common time line; publish times stay what they were.

    `prefix` goes before every topic, and before the coordinate frames in protobuf messages: two recordings of the same
    tool would otherwise share them. `extras` says whether metadata and attachments come along. `facts` are a name and
    what is said of the input's times.
    """

    def __init__(
        self,
        records: McapRecords,
        *,
        clock: StampMap | None = None,
        prefix: str = "",
        topics: Collection[str] | None = None,
        extras: bool = True,
        facts: tuple[str, Mapping[str, str]] | None = None,
    ) -> None:
        self.records = records
        self.facts = facts
        self.clock = clock
        self.prefix = prefix
        self.wanted = topics
        self.extras = extras
        self._writer: SharedWriter | None = None
        self._ids: dict[int, int] = {}
        self._frames: dict[int, FrameNames] = {}

    @property
    def count(self) -> int:
        """How many of the input's messages are wanted."""
        channels = self.records.channels.values()
        wanted = [c.id for c in channels if self.wanted is None or c.topic in self.wanted]
        return sum(self.records.counts.get(id_, 0) for id_ in wanted)

    def begin(self, writer: SharedWriter) -> None:
        """Register every channel that is wanted, messages or not, and copy the extras."""
        self._writer = writer
        for channel_id in self.records.channels:
            self._register(channel_id)
        if self.extras:
            if self.wanted is None:
                for schema in self.records.schemas.values():
                    writer.register_schema(schema.name, schema.encoding, schema.data)
            for record in self.records.metadata:
                writer.add_metadata(record.name, record.metadata)
            for file in self.records.attachments():
                writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        name, facts = self.facts or (self.records.path.stem, {})
        if facts or self.clock is not None:
            lines = {} if self.clock is None else self.clock.lines()
            add_clock(writer, name, {"input": self.records.path.name} | lines | dict(facts))

    def messages(self) -> Iterator[OutMessage]:
        """The input's messages by log time; stamps before 1970 are an error, for MCAP cannot hold them."""
        clock, before = self.clock, frame_prefix(self.prefix)
        for channel, sequence, log_time, publish_time, data in self.records.messages(self.wanted):
            out = self._ids.get(channel.id)
            if out is None:
                out = self._register(channel.id)
            if clock is not None:
                log_time = in_range(clock(log_time), self.records.path.name)
            if before:
                data = self._frames[channel.id].prefixed(data, before)
            yield OutMessage(log_time, publish_time, sequence, out, data)

    def _register(self, channel_id: int) -> int:
        channel = self.records.channels[channel_id]
        if self._writer is None or (self.wanted is not None and channel.topic not in self.wanted):
            return -1
        schema = self.records.schemas.get(channel.schema_id)
        schema_id = 0 if schema is None else self._writer.register_schema(schema.name, schema.encoding, schema.data)
        self._frames[channel_id] = FrameNames(channel, schema)
        self._ids[channel_id] = self._writer.register_channel(
            self.prefix + channel.topic, channel.message_encoding, schema_id, channel.metadata
        )
        return self._ids[channel_id]


def frame_prefix(prefix: str) -> str:
    """What goes before an input's coordinate frames where `prefix` goes before its topics."""
    return f"{prefix.strip('/')}/" if prefix.strip("/") else ""


def add_clock(writer: SharedWriter, name: str, facts: Mapping[str, str]) -> None:
    """Write how an input's stamps were mapped; the record's name is of this input and mapping alone, for the official
    tool merges no files that share one."""
    told = "\0".join(text for pair in sorted(facts.items()) for text in pair)
    writer.add_metadata(f"{CLOCK_METADATA}{name}/{hashlib.sha256(told.encode()).hexdigest()[:12]}", dict(facts))


class Join:
    """Streams into one writer by log time, as far as somebody asks; at equal times in the streams' order.

    For a run that adds its own messages to a copy: `until(stamp)` before each frame's are written, `rest()`
    at the end, so that log times never go back over the whole file. `go_on` is asked now and then, with the
    number of messages written; when it says no, `stopped` is set and nothing more is written.
    """

    def __init__(
        self, writer: SharedWriter, streams: Sequence[Stream], go_on: Callable[[int], bool] = lambda written: True
    ) -> None:
        self.writer = writer
        self.written = 0
        self.stopped = False
        self._go_on = go_on
        for stream in streams:
            stream.begin(writer)
        self._messages = heapq.merge(*(s.messages() for s in streams), key=lambda m: m.log_time)
        self._next: OutMessage | None = None

    def until(self, log_time: int) -> None:
        """Write all messages up to and at `log_time`."""
        self._write(log_time)

    def rest(self) -> None:
        """Write all messages that are left."""
        self._write(None)

    def _write(self, limit: int | None) -> None:
        add = self.writer.add_message
        message = self._next if self._next is not None else next(self._messages, None)
        while message is not None and not self.stopped and (limit is None or message.log_time <= limit):
            log_time, publish_time, sequence, channel_id, data = message
            add(channel_id, log_time, data, publish_time, sequence)
            self.written += 1
            if self.written % ASK_EVERY == 0:
                self.stopped = not self._go_on(self.written)
            message = next(self._messages, None)
        self._next = message


@dataclass(frozen=True, slots=True)
class Merged:
    """What a merge did: messages by topic, renamed metadata (new name -> old), what the inputs had lost, and
    whether it was stopped, which leaves what was written in `part` (None: there was nothing). `end_ns` is the last log
    time, `notes` are for the user.
    """

    counts: dict[str, int]
    renamed: dict[str, str]
    lost: tuple[str, ...]
    stopped: bool = False
    part: Path | None = None
    end_ns: int | None = None
    notes: tuple[str, ...] = ()


def merge_streams(
    streams: Sequence[Stream],
    output: str | os.PathLike[str],
    *,
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
    compression: Compression = "zstd",
    progress: Callable[[int, int | None], None] = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> Merged:
    """Join the streams into a new file. Inputs that are damaged give what can be read; `lost` says what is
    missing.

    `inputs` are further files and folders that the output must not be. `progress` gets messages done and expected,
    `stop` ends the merge: both are called now and then. Raises UsageError when the output exists or is an input,
    OutputError when it cannot be written.
    """
    copied = [s.records for s in streams if isinstance(s, McapStream)]
    profiles = {records.profile for records in copied}
    alike = len(profiles) == 1 and len(copied) == len(streams)
    expected = sum(stream.count for stream in streams)

    def go_on(written: int) -> bool:
        progress(written, expected)
        return not stop()

    with open_output(
        output,
        [*inputs, *(records.path for records in copied)],
        overwrite=overwrite,
        compression=compression,
        profile=profiles.pop() if alike else "",
    ) as writer:
        join = Join(writer, streams, go_on)
        join.stopped = not go_on(0)
        join.rest()
        writer.complete = not join.stopped
    lost = tuple(f"{records.path}: {loss}" for records in copied for loss in records.lost)
    part = writer.part if join.stopped and writer.counts else None
    return Merged(dict(writer.counts), writer.renamed, lost, join.stopped, part, writer.end_ns, writer.notes)


def in_range(stamp_ns: int, name: str) -> int:
    """The stamp, when MCAP can hold it. Raises UsageError."""
    if not 0 <= stamp_ns < 1 << 64:
        raise UsageError(f"{name}: the offset moves a stamp to {stamp_ns} ns, before 1970: MCAP has no such time")
    return stamp_ns
