"""Coordinate frames of several inputs under one, so that a viewer can show them together."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from spheremcap.io.join import OutMessage
from spheremcap.io.mcap_log import STATIC_PERIOD_NS, schema_id
from spheremcap.io.messages import UPRIGHT, transforms
from spheremcap.io.output import SharedWriter
from spheremcap.io.topics import WORLD_FRAME

_MOST = 10_000
"""Messages for one input: a damaged file may state any end."""


def loose(used: Iterable[str], parents: Mapping[str, str]) -> list[str]:
    """The frames that would have to hang on the world for all that are used to be connected; by name."""
    tops = set()
    for frame in used:
        seen = set()
        while frame in parents and frame not in seen:
            seen.add(frame)
            frame = parents[frame]
        tops.add(frame)
    return sorted(tops - {WORLD_FRAME}) if len(tops) > 1 else []


@dataclass
class FramesStream:
    """Says every few seconds of the inputs' time that these frames stand at the world's origin."""

    frames: Sequence[str]
    topic: str
    spans_ns: Sequence[tuple[int, int]]
    _channel: int = field(default=-1, repr=False)

    @property
    def count(self) -> int:
        """How many messages there are."""
        return sum(1 for _ in self._stamps())

    def begin(self, writer: SharedWriter) -> None:
        """Register the channel."""
        self._channel = writer.register_channel(self.topic, "protobuf", schema_id(writer, FrameTransforms))

    def messages(self) -> Iterator[OutMessage]:
        """One message a while, by time."""
        edges = [(WORLD_FRAME, frame, UPRIGHT) for frame in self.frames]
        for number, stamp_ns in enumerate(self._stamps(), 1):
            data = transforms(stamp_ns, edges).SerializeToString()
            yield OutMessage(stamp_ns, stamp_ns, number, self._channel, data)

    def _stamps(self) -> Iterator[int]:
        after = -1
        for start, end in sorted(self.spans_ns):
            first = max(start, after + 1)
            for stamp_ns in range(first, min(end + 1, first + _MOST * STATIC_PERIOD_NS), STATIC_PERIOD_NS):
                yield stamp_ns
                after = stamp_ns + STATIC_PERIOD_NS - 1
