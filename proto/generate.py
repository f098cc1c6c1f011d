"""Compile proto/spheremcap/*.proto into src/spheremcap/io/_pb/spheremcap.binpb (needs grpcio-tools).

Run from anywhere: `python proto/generate.py`. foxglove's and Google's messages come from their packages.
"""

import sys
import tempfile
from pathlib import Path

from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.timestamp_pb2 import Timestamp
from grpc_tools import protoc

HERE = Path(__file__).resolve().parent
TARGET = HERE.parent / "src/spheremcap/io/_pb/spheremcap.binpb"


def compiled() -> bytes:
    """The serialised FileDescriptorSet of our own .proto files, without the files that they import."""
    imports = FileDescriptorSet()
    for message in (Vector3, Quaternion, Timestamp):
        message.DESCRIPTOR.file.CopyToProto(imports.file.add())
    sources = sorted(str(path.relative_to(HERE)) for path in HERE.glob("spheremcap/*.proto"))
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder, "imports.binpb"), Path(folder, "made.binpb")
        given.write_bytes(imports.SerializeToString())
        options = [f"-I{HERE}", f"--descriptor_set_in={given}", f"--descriptor_set_out={made}"]
        if protoc.main(["protoc", *options, *sources]) != 0:
            sys.exit("protoc failed")
        return made.read_bytes()


if __name__ == "__main__":
    TARGET.write_bytes(compiled())
