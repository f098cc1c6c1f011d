"""Two balls over a background as a video, and as recordings that another tool could have written."""

import itertools
from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path

import cv2
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import NonSeekingReader
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.schema import build_file_descriptor_set

from scenes import BLUE, CAMERA, ORANGE, ball_at, picture, truth
from spheremcap.io.encode import write_video

COUNT = 16
START_NS = 1_700_000_000_123_456_789
STEP_NS = 4_166_667
LATER_NS = 2_000_000
"""Log times are this much after the header stamps."""


def balls(index: int):
    return (
        ball_at(100 + 2.5 * index, 90 + index, 18, rgb=ORANGE),
        ball_at(240 - 2 * index, 170, 15, rgb=BLUE),
    )


@cache
def pictures():
    return [picture(*balls(index), noise_seed=index) for index in range(COUNT)]


def seed(marker: str, ball: int = 0, index: int = 0) -> str:
    """MARKER@FRAME=X,Y,R as a person would give it."""
    circle = truth(balls(index)[ball])
    return f"{marker}@{index}={circle.x_px:.0f},{circle.y_px:.0f},{circle.r_px:.0f}"


def write_clip(path: Path, count: int = COUNT) -> Path:
    """The balls go back and forth when the clip is longer than COUNT."""
    there_and_back = [*pictures(), *pictures()[-2:0:-1]]
    shown = itertools.islice(itertools.cycle(there_and_back), count)
    write_video(path, shown, Fraction(240), creation_time="2025-06-01T10:00:00Z")
    return path


def write_truth(path: Path) -> Path:
    rows = ["frame,x,y,r,marker"]
    for index in range(COUNT):
        for marker, ball in zip(("orange", "blue"), balls(index), strict=True):
            circle = truth(ball)
            rows.append(f"{index},{circle.x_px},{circle.y_px},{circle.r_px},{marker}")
    path.write_text("\n".join(rows) + "\n")
    return path


def write_messages(path: Path, topic: str, messages: Sequence) -> Path:
    """Protobuf messages of one kind on one topic, a second apart."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = type(messages[0])
        data = build_file_descriptor_set(kind).SerializeToString()
        schema = writer.register_schema(kind.DESCRIPTOR.full_name, "protobuf", data)
        channel = writer.register_channel(topic, "protobuf", schema)
        for index, message in enumerate(messages):
            message.timestamp.seconds = 1_700_000_000 + index
            writer.add_message(channel, (1_700_000_000 + index) * 10**9, message.SerializeToString(), 5)
        writer.finish()
    return path


def write_recording(
    path: Path,
    topics: Sequence[str],
    *,
    calibrated: bool = True,
    other: str = "/tf",
    frame_id: str = "cam0",
    calibrated_for: tuple[int, int] = (CAMERA.width_px, CAMERA.height_px),
) -> Path:
    """JPEG pictures on each topic with a calibration beside them, and a topic of somebody else's."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=50_000)
        writer.start(profile="", library="another tool")
        writer.add_metadata("about", {"a": "b"})
        writer.add_attachment(1, 2, "notes.txt", "text/plain", b"x")

        def channel(topic: str, kind) -> int:
            data = build_file_descriptor_set(kind).SerializeToString()
            return writer.register_channel(
                topic, "protobuf", writer.register_schema(kind.DESCRIPTOR.full_name, "protobuf", data)
            )

        foreign = writer.register_channel(other, "json", writer.register_schema("thing", "jsonschema", b"{}"))
        images = [channel(topic, CompressedImage) for topic in topics]
        calibrations = [
            channel(topic.rpartition("/")[0] + "/camera_info", CameraCalibration) for topic in topics if calibrated
        ]
        for index, image in enumerate(pictures()):
            stamp = START_NS + index * STEP_NS
            log = stamp + LATER_NS
            writer.add_message(foreign, log, b"{}", stamp, index)
            for id_ in calibrations if index == 0 else []:
                f, c = CAMERA.fx_px, (CAMERA.cx_px, CAMERA.cy_px)
                message = CameraCalibration(
                    frame_id=frame_id, width=calibrated_for[0], height=calibrated_for[1],
                    K=[f, 0, c[0], 0, f, c[1], 0, 0, 1],
                )  # fmt: skip
                writer.add_message(id_, log, message.SerializeToString(), stamp, index)
            for id_ in images:
                jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
                message = CompressedImage(frame_id=frame_id, format="jpeg", data=jpeg)
                message.timestamp.seconds, message.timestamp.nanos = divmod(stamp, 10**9)
                writer.add_message(id_, log, message.SerializeToString(), stamp, index)
        writer.add_message(foreign, START_NS + 10**9, b"{}", 7, 99)
        writer.finish()
    return path


def rows(path: Path):
    """(topic, log time, publish time, sequence, data) in the order of the file, with all checksums checked."""
    with path.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)
        return [
            (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
            for _, c, m in reader.iter_messages(log_time_order=False)
        ]


def decoded(path: Path):
    """Topic to its decoded messages; every record is read strictly, every protobuf message parsed."""
    with path.open("rb") as file:
        assert list(StreamReader(file, validate_crcs=True).records)
    found: dict[str, list] = {}
    last = 0
    with path.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)
        factory = DecoderFactory()
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert message.log_time >= last
            last = message.log_time
            decode = factory.decoder_for(channel.message_encoding, schema)
            found.setdefault(channel.topic, []).append(decode(message.data) if decode else message.data)
    return found
