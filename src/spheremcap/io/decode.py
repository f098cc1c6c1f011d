"""Messages by the schema that is stored with them: whatever a decoder raises is one kind of error."""

import json
from collections.abc import Callable
from typing import Any

from mcap.records import Channel, Schema
from mcap_protobuf.decoder import DecoderFactory

from spheremcap.errors import short
from spheremcap.io import ros

Decode = Callable[[bytes], Any]


def decoder(channel: Channel, schema: Schema | None) -> Decode | None:
    """What turns a channel's messages into objects: protobuf, JSON, and the ROS messages that are known here; None for
    others. It and its result raise ValueError for a schema or message that cannot be read.
    """
    encoding = channel.message_encoding
    if encoding == "json":
        return _guarded(json.loads)
    if encoding in ("cdr", "ros1") and schema is not None and ros.short_name(schema.name) in ros.KNOWN:
        layout = ros.layout_of(schema.name, schema.encoding, schema.data.decode("utf-8", "replace"))
        return _guarded(lambda data: ros.read_message(data, layout, encoding == "cdr"))
    if encoding != "protobuf" or schema is None:
        return None
    try:
        decode = DecoderFactory().decoder_for(encoding, schema)
    except Exception as error:  # whatever protobuf and its descriptor pool say to bytes that are no schema
        raise ValueError(f"its schema {short(schema.name)} cannot be read ({short(error)})") from error
    return None if decode is None else _guarded(decode)


def _guarded(decode: Decode) -> Decode:
    def guarded(data: bytes) -> Any:
        try:
            return decode(data)
        except Exception as error:  # DecodeError, RecursionError, and what a message does to its decoder else
            raise ValueError(short(error)) from error

    return guarded
