"""Strokes and their events as messages, and read back from a recording that `analyse` wrote."""

import math
from collections.abc import Sequence
from dataclasses import fields
from enum import Enum
from typing import Any

import numpy as np

from spheremcap.core.stroke import EventKind, Stroke, StrokeEvent
from spheremcap.io import _pb
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.messages import Message, stamp_of, time_fields
from spheremcap.io.recording import UNREADABLE, schema_names

EVENT = _pb.StrokeEvent.DESCRIPTOR.full_name
STROKE = _pb.Stroke.DESCRIPTOR.full_name


def event_message(event: StrokeEvent) -> Message:
    """spheremcap.StrokeEvent."""
    return _pb.StrokeEvent(**_told(event) | {"kind": _pb.StrokeEvent.Kind.Value(event.kind.value)})


def stroke_message(stroke: Stroke) -> Message:
    """spheremcap.Stroke."""
    return _pb.Stroke(**_told(stroke))


def event_of(data: bytes) -> StrokeEvent:
    """The event of a serialised spheremcap.StrokeEvent. Raises UNREADABLE."""
    message = _pb.StrokeEvent.FromString(data)
    kind = EventKind(_pb.StrokeEvent.Kind.Name(message.kind))
    return StrokeEvent(**_read(message, StrokeEvent) | {"kind": kind})


def stroke_of(data: bytes) -> Stroke:
    """The stroke of a serialised spheremcap.Stroke. Raises UNREADABLE."""
    return Stroke(**_read(_pb.Stroke.FromString(data), Stroke))


def read_strokes(records: McapRecords) -> tuple[list[StrokeEvent], list[Stroke]]:
    """All events and strokes of a recording by log time; `records` counts those that do not decode."""
    names = schema_names(records)
    topics = {c.topic for c in records.channels.values() if names[c.id] in (EVENT, STROKE)}
    events, strokes = list[StrokeEvent](), list[Stroke]()
    for raw in records.messages(topics) if topics else ():
        try:
            if names.get(raw.channel.id) == EVENT:
                events.append(event_of(raw.data))
            elif names.get(raw.channel.id) == STROKE:
                strokes.append(stroke_of(raw.data))
        except UNREADABLE as error:
            records.undecodable(raw.channel.topic, error)
    return events, strokes


def has_strokes(records: McapRecords) -> bool:
    """Whether somebody has looked for strokes in a recording, found or not."""
    return any(name in (EVENT, STROKE) for name in schema_names(records).values())


def columns_of(kind: type[StrokeEvent] | type[Stroke], nouns: Sequence[StrokeEvent | Stroke]) -> dict[str, Any]:
    """The fields of events or strokes as columns, each (N,), by name; NaN where there is no value."""
    kinds: dict[Any, type[np.generic]] = {int: np.int64, float: np.float64, float | None: np.float64}
    return {
        f.name: np.array([_cell(getattr(noun, f.name)) for noun in nouns], kinds.get(f.type, np.str_))
        for f in fields(kind)
    }


def _cell(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else math.nan if value is None else value


def _told(noun: StrokeEvent | Stroke) -> dict[str, Any]:
    told = {f.name: getattr(noun, f.name) for f in fields(noun)}
    stamp_ns = told.pop("stamp_ns")
    return {name: value for name, value in told.items() if value is not None} | {"timestamp": time_fields(stamp_ns)}


def _read(message: Message, noun: type[StrokeEvent] | type[Stroke]) -> dict[str, Any]:
    found: dict[str, Any] = {"stamp_ns": stamp_of(message.timestamp)}
    for field in fields(noun):
        if field.name != "stamp_ns":
            known = message.DESCRIPTOR.fields_by_name[field.name]
            there = not known.has_presence or message.HasField(field.name)
            found[field.name] = getattr(message, field.name) if there else None
    return found
