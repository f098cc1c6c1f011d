"""The coordinate frames that protobuf messages name, whatever their schema: found, and renamed."""

from collections.abc import Iterator
from typing import Any

from mcap.records import Channel, Schema

from spheremcap.io.decode import Decode, decoder
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.messages import Message

_NAMES = ("frame_id", "parent_frame_id", "child_frame_id")
_DEEPEST = 8  # levels of a message that are looked into; a message may hold itself
_TRANSFORMS = 500
"""So many messages of a topic tell which frame stands in which."""


class FrameNames:
    """The frames of one channel's messages."""

    def __init__(self, channel: Channel, schema: Schema | None) -> None:
        self._decode: Decode | None = None
        if channel.message_encoding == "protobuf":
            try:
                self._decode = decoder(channel, schema)
            except ValueError:  # it goes as it is
                return

    def prefixed(self, data: bytes, before: str) -> bytes:
        """A message with `before` in front of every frame that it names; as it is where it names none."""
        if self._decode is None:
            return data
        try:
            message = self._decode(data)
        except ValueError:
            return data
        found = [(holder, name) for holder in _holders(message) for name in _NAMES if getattr(holder, name, "")]
        for holder, name in found:
            setattr(holder, name, before + getattr(holder, name))
        return bytes(message.SerializeToString(deterministic=True)) if found else data

    def of(self, data: bytes) -> tuple[set[str], dict[str, str]]:
        """The frames that a message's things are in, and in which frame each stands of those that it places."""
        used: set[str] = set()
        parents: dict[str, str] = {}
        if self._decode is not None:
            try:
                message = self._decode(data)
            except ValueError:
                return used, parents
            for holder in _holders(message):
                used |= {holder.frame_id} if getattr(holder, "frame_id", "") else set()
                if getattr(holder, "child_frame_id", ""):
                    parents[holder.child_frame_id] = holder.parent_frame_id
        return used, parents


def frames_of(records: McapRecords) -> tuple[set[str], dict[str, str]] | None:
    """The frames that a recording's messages are in, and in which frame each stands; by the first message of each
    topic. None where some of it is said in a way that is not read here."""
    used: set[str] = set()
    parents: dict[str, str] = {}
    for channel in list(records.channels.values()):
        schema = records.schemas.get(channel.schema_id)
        placing = schema is not None and any(kind in schema.name for kind in ("TFMessage", "FrameTransform"))
        if placing and channel.message_encoding != "protobuf":
            return None
        names = FrameNames(channel, schema)
        for number, raw in enumerate(records.messages([channel.topic])):
            if number >= (_TRANSFORMS if placing else 1):
                break
            if raw.channel.id == channel.id:
                own_used, own_parents = names.of(raw.data)
                used |= own_used
                parents |= own_parents
    return used, parents


def _holders(message: Message, depth: int = 0) -> Iterator[Any]:
    """The message and those inside it that name a frame."""
    if any(name in message.DESCRIPTOR.fields_by_name for name in _NAMES):
        yield message
    if depth == _DEEPEST:
        return
    for field in message.DESCRIPTOR.fields:
        inner = field.message_type
        if inner is None or inner.GetOptions().map_entry or inner.full_name.startswith("google.protobuf."):
            continue
        value = getattr(message, field.name)
        if not hasattr(value, "DESCRIPTOR"):
            for one in value:
                yield from _holders(one, depth + 1)
        elif message.HasField(field.name):
            yield from _holders(value, depth + 1)
