"""The message classes of proto/spheremcap, made at import from the committed descriptor set.

protoc's own Python output refuses every runtime older than the protoc that made it (and one two majors
newer); a descriptor set has no such tie, so the same file serves protobuf 5, 6 and 7. `python
proto/generate.py` makes it.
"""

from importlib.resources import files
from typing import Any

import foxglove_schemas_protobuf.Quaternion_pb2
import foxglove_schemas_protobuf.Vector3_pb2  # noqa: F401
import google.protobuf.timestamp_pb2  # noqa: F401  (the three imports put what ours depend on into the pool)
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_POOL = descriptor_pool.Default()
DESCRIPTORS = descriptor_pb2.FileDescriptorSet.FromString(
    files(__name__).joinpath("spheremcap.binpb").read_bytes()
)
for _file in DESCRIPTORS.file:
    _POOL.AddSerializedFile(_file.SerializeToString())


def _message_class(name: str) -> Any:
    return message_factory.GetMessageClass(_POOL.FindMessageTypeByName(f"spheremcap.{name}"))


ArmSample = _message_class("ArmSample")
ChairFrame = _message_class("ChairFrame")
Circle = _message_class("Circle")
ImuSample = _message_class("ImuSample")
MarkerState = _message_class("MarkerState")
MarkerVotes = _message_class("MarkerVotes")
OperatorRequest = _message_class("OperatorRequest")
PartialVector3 = _message_class("PartialVector3")
Proposal = _message_class("Proposal")
Replaced = _message_class("Replaced")
Stroke = _message_class("Stroke")
StrokeEvent = _message_class("StrokeEvent")
TrunkSample = _message_class("TrunkSample")
Vote = _message_class("Vote")
WheelSample = _message_class("WheelSample")
Window = _message_class("Window")
