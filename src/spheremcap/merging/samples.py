"""Sensor logs as typed messages: spheremcap.ImuSample, spheremcap.WheelSample, or a record made from the
columns.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap_protobuf.schema import build_file_descriptor_set

from spheremcap.core.time import NS_PER_S
from spheremcap.io import _pb
from spheremcap.io.join import OutMessage, add_clock, in_range
from spheremcap.io.mcap_log import schema_id
from spheremcap.io.output import SharedWriter
from spheremcap.merging.clock import Clock
from spheremcap.merging.header import topic_name
from spheremcap.merging.log import SensorLog


@dataclass
class SensorStream:
    """A SensorLog as messages on `/sensors/NAME`: log time and stamp on the common time line, publish time
    its own.

    `clock` maps the sensor's stamps; how is written as metadata, as `facts` or in short.
    """

    log: SensorLog
    clock: Clock = field(default_factory=Clock)
    topic: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    _channel: int = field(default=-1, repr=False)

    @property
    def count(self) -> int:
        """How many samples there are."""
        return len(self.log)

    def begin(self, writer: SharedWriter) -> None:
        """Register the sensor's schema and channel, and write how its stamps were mapped."""
        self._message_class = _message_class(self.log)
        if self.log.kind == "record":
            data = build_file_descriptor_set(self._message_class).SerializeToString(deterministic=True)
            full_name = self._message_class.DESCRIPTOR.full_name
            schema = writer.register_schema(full_name, "protobuf", data)
        else:
            schema = schema_id(writer, self._message_class)
        self._channel = writer.register_channel(self.topic or f"/sensors/{self.log.name}", "protobuf", schema)
        if self.log.source:
            facts = dict(self.facts) or {"input": self.log.source} | self.clock.lines()
            add_clock(writer, self.log.name, facts)

    def messages(self) -> Iterator[OutMessage]:
        """One message a sample, by time."""
        log = self.log
        make = {"imu": _imu_samples, "wheel": _wheel_samples, "record": _records}[log.kind]
        for k, (own_ns, message) in enumerate(zip(log.stamp_ns.tolist(), make(self), strict=True)):
            stamp_ns = in_range(self.clock(own_ns), log.source)
            seconds, nanos = divmod(stamp_ns, NS_PER_S)
            message.timestamp.seconds, message.timestamp.nanos = seconds, nanos
            data = message.SerializeToString()
            yield OutMessage(stamp_ns, max(own_ns, 0), k + 1, self._channel, data)


def _message_class(log: SensorLog) -> Any:
    if log.kind == "imu":
        return _pb.ImuSample
    return _pb.WheelSample if log.kind == "wheel" else _record_class(log.name, tuple(log.values))


def _imu_samples(stream: SensorStream) -> Iterator[Any]:
    log = stream.log
    vectors = {name: log.vector(name) for name in ("linear_acceleration", "angular_velocity", "magnetic_field")}
    rows = {name: v.tolist() for name, v in vectors.items() if v is not None}
    q = [log.values.get(f"orientation.{axis}") for axis in "wxyz"]
    quaternions = None if any(a is None for a in q) else np.stack([a for a in q if a is not None], axis=1).tolist()
    temperature = log.values.get("temperature_c")
    for k in range(len(log)):
        message = _pb.ImuSample(frame_id=log.frame_id)
        for name, values in rows.items():
            x, y, z = values[k]
            if x == x and y == y and z == z:  # NaN: there is none
                getattr(message, name).CopyFrom(Vector3(x=x, y=y, z=z))
        if quaternions is not None:
            w, x, y, z = quaternions[k]
            if w == w:
                message.orientation.CopyFrom(Quaternion(w=w, x=x, y=y, z=z))
        if temperature is not None and temperature[k] == temperature[k]:
            message.temperature_c = float(temperature[k])
        if log.saturated is not None:
            message.saturated = bool(log.saturated[k])
        yield message


def _wheel_samples(stream: SensorStream) -> Iterator[Any]:
    log = stream.log
    numbers = {n: log.values[n].tolist() for n in ("angle_rad", "rate_rad_s") if n in log.values}
    parts = [
        (where, axis, log.values[f"{name}.{axis}"].tolist())
        for name, where in (("force", "force_n"), ("moment", "moment_nm"))
        for axis in "xyz"
        if f"{name}.{axis}" in log.values
    ]
    for k in range(len(log)):
        message = _pb.WheelSample(frame_id=log.frame_id)
        for name, column in numbers.items():
            if column[k] == column[k]:
                setattr(message, name, column[k])
        for where, axis, column in parts:
            if column[k] == column[k]:
                setattr(getattr(message, where), axis, column[k])
        yield message


def _records(stream: SensorStream) -> Iterator[Any]:
    make = stream._message_class
    columns = [(name, column.tolist()) for name, column in stream.log.values.items()]
    for k in range(len(stream.log)):
        yield make(**{name: column[k] for name, column in columns if column[k] == column[k]})


def _record_class(name: str, columns: tuple[str, ...]) -> Any:
    """A protobuf class `spheremcap.record.Name` with a timestamp and an optional double for each column."""
    title = "".join(part.capitalize() for part in topic_name(name).split("_")) or "Record"
    title = title if title[0].isalpha() else f"R{title}"
    file = descriptor_pb2.FileDescriptorProto(
        name=f"spheremcap/record/{title}.proto", package="spheremcap.record", syntax="proto3"
    )
    file.dependency.append("google/protobuf/timestamp.proto")
    message = file.message_type.add(name=title)
    kinds = descriptor_pb2.FieldDescriptorProto
    message.field.add(
        name="timestamp", number=1, label=kinds.LABEL_OPTIONAL, type=kinds.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
    )  # fmt: skip
    for k, column in enumerate(columns):
        message.oneof_decl.add(name=f"_{column}")
        message.field.add(
            name=column, number=k + 2, label=kinds.LABEL_OPTIONAL, type=kinds.TYPE_DOUBLE, oneof_index=k,
            proto3_optional=True,
        )  # fmt: skip
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.AddSerializedFile(file.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"spheremcap.record.{title}"))
