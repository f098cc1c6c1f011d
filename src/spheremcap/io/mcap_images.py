"""Image channels of an MCAP as frames: Foxglove's protobuf and JSON messages, ROS 2 (CDR) and ROS 1.

A frame's stamp is the message's own header stamp, or its log or publish time. Still pictures are decoded one
by one; compressed video is decoded from a key frame on, and its packets (and JPEG pictures) are handed on as
they are. YUV pictures whose message does not say otherwise are BT.601, limited range, as camera drivers send
them.
"""

import base64
import itertools
import json
import os
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import av
import av.error
import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from mcap.records import Channel, Schema

from spheremcap.core.camera import Camera, DistortionModel
from spheremcap.core.frame import BgrFrame, EncodedPicture, Frame, YuvFrame, yuv_to_bgr_matrix
from spheremcap.errors import SourceError, UsageError
from spheremcap.io import ros
from spheremcap.io.mcap_records import Loss, McapRecords, RawMessage

TimeBase = Literal["header", "log", "publish"]
Plane = npt.NDArray[np.uint8]

_PROTOBUF: dict[str, Any] = {
    "CompressedImage": CompressedImage,
    "CompressedVideo": CompressedVideo,
    "RawImage": RawImage,
    "CameraCalibration": CameraCalibration,
}
_IMAGES = {"CompressedImage", "CompressedVideo", "RawImage", "Image"}
_CALIBRATIONS = {"CameraCalibration", "CameraInfo"}
_PACKAGES = {"foxglove", "foxglove_msgs", "sensor_msgs"}
_VIDEO = {"h264": "h264", "avc": "h264", "h265": "hevc", "hevc": "hevc", "av1": "libdav1d", "vp9": "vp9"}
_STILLS = ("jpeg", "jpg", "png", "webp")
_UNREADABLE = (ValueError, KeyError, TypeError, AttributeError, DecodeError)
"""What reading a message that is not what its schema says ends in."""


# --- which topics there are ---


@dataclass(frozen=True, slots=True)
class ImageTopic:
    """A topic with pictures: its schema's name, the message encoding and how many messages it has."""

    topic: str
    schema: str
    encoding: str
    messages: int

    def __str__(self) -> str:
        return f"{self.topic} ({self.schema}, {self.encoding}, {self.messages} messages)"


def image_topics(source: McapRecords | str | os.PathLike[str]) -> list[ImageTopic]:
    """The image topics of a recording, by name."""
    if not isinstance(source, McapRecords):
        with McapRecords(source) as records:
            return image_topics(records)
    found: dict[str, ImageTopic] = {}
    for channel in source.channels.values():
        schema = source.schemas.get(channel.schema_id)
        count = source.counts.get(channel.id, 0)
        if schema is not None and _kind(schema, channel) in _IMAGES:
            if channel.topic in found:
                count += found[channel.topic].messages
            found[channel.topic] = ImageTopic(channel.topic, schema.name, channel.message_encoding, count)
    return [found[topic] for topic in sorted(found)]


def _kind(schema: Schema, channel: Channel) -> str | None:
    """The message's name without its package, when its package and encoding are read here."""
    parts = schema.name.replace("::", "/").replace(".", "/").split("/")
    readable = channel.message_encoding in ("protobuf", "json", "cdr", "ros1")
    return parts[-1] if readable and parts[0] in _PACKAGES else None


# --- messages ---


@dataclass(frozen=True, slots=True)
class _Picture:
    """An image message of whatever schema. `format` is jpeg, h264, ... or a raw encoding, which has width >
    0.
    """

    stamp_ns: int | None
    format: str
    data: bytes
    width: int = 0
    height: int = 0
    step: int = 0


def _decoder(schema: Schema | None, channel: Channel) -> Callable[[bytes], dict[str, Any]]:
    """What turns a message's bytes into its fields, lower-case names, `stamp_ns` for its time."""
    kind = None if schema is None else _kind(schema, channel)
    if schema is None or kind is None:
        raise ValueError("its schema is missing or not an image's")
    if channel.message_encoding == "protobuf":
        message_class = _PROTOBUF[kind]

        def from_protobuf(data: bytes) -> dict[str, Any]:
            message = message_class.FromString(data)
            fields = {f.name.lower(): getattr(message, f.name) for f in message.DESCRIPTOR.fields}
            stamp = fields.pop("timestamp")
            return fields | {"stamp_ns": stamp.seconds * 1_000_000_000 + stamp.nanos}

        return from_protobuf
    if channel.message_encoding == "json":
        return _from_json
    layout = ros.layout_of(schema.name, schema.encoding, schema.data.decode("utf-8", "replace"))
    ros2 = channel.message_encoding == "cdr"
    return lambda data: ros.read_message(data, layout, ros2)


def _from_json(data: bytes) -> dict[str, Any]:
    message = json.loads(data)
    fields = {str(name).lower(): value for name, value in message.items()}
    stamp = fields.pop("timestamp", None) or {}
    if isinstance(fields.get("data"), str):
        fields["data"] = base64.b64decode(fields["data"])
    seconds = stamp.get("sec", stamp.get("seconds", 0))
    nanos = stamp.get("nsec", stamp.get("nanosec", stamp.get("nanos", 0)))
    return fields | {"stamp_ns": int(seconds) * 1_000_000_000 + int(nanos)}


def _picture(fields: dict[str, Any]) -> _Picture:
    if "encoding" in fields:
        return _Picture(
            fields["stamp_ns"], fields["encoding"], fields["data"],
            int(fields["width"]), int(fields["height"]), int(fields["step"]),
        )  # fmt: skip
    return _Picture(fields["stamp_ns"], fields["format"].lower(), fields["data"])


def _camera(fields: dict[str, Any], rectified: bool, source: str) -> Camera | None:
    """The Camera of a CameraCalibration or CameraInfo; None when it is empty (K[0] = 0 means uncalibrated).

    A rectified picture has the projection matrix P and no distortion.
    """
    k, p = [list(map(float, fields.get(name, ()))) for name in ("k", "p")]
    if len(k) != 9 or k[0] <= 0 or not fields.get("width") or not fields.get("height"):
        return None
    width, height = int(fields["width"]), int(fields["height"])
    if rectified and len(p) == 12 and p[0] > 0:
        return Camera(width, height, p[0], p[5], p[2], p[6], source=source)
    d = list(map(float, fields.get("d", ())))
    name = fields.get("distortion_model", "")
    model: DistortionModel = "fisheye" if name in ("kannala_brandt", "equidistant", "fisheye") else "plumb_bob"
    lengths = (4,) if model == "fisheye" else (4, 5, 8)
    while d and d[-1] == 0 and len(d) not in lengths:
        d.pop()
    if not any(d):
        return Camera(width, height, k[0], k[4], k[2], k[5], source=source)
    if model == "plumb_bob":
        d += [0.0] * (next((n for n in lengths if n >= len(d)), len(d)) - len(d))
    if len(d) not in lengths:
        raise SourceError(f"{source}: distortion model {name!r} with {len(d)} coefficients is not supported")
    return Camera(width, height, k[0], k[4], k[2], k[5], model, tuple(d), source=source)


# --- raw pictures ---

_TO_BGR = {
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "8uc4": (4, cv2.COLOR_BGRA2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8uc1": (1, cv2.COLOR_GRAY2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
    "bgr8": (3, None),
    "8uc3": (3, None),
}
_YUV422 = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}  # the byte the first luma sample is at
RAW_ENCODINGS = (*_TO_BGR, *_YUV422, "nv12")


def _raw_frame(index: int, stamp_ns: int, picture: _Picture) -> Frame:
    """The frame of a raw picture; YUV stays in its planes. Raises ValueError when the data do not fit the
    size.
    """
    kind, width, height = picture.format.lower(), picture.width, picture.height
    channels = 1 if kind == "nv12" else 2 if kind in _YUV422 else _TO_BGR[kind][0]
    rows = height * 3 // 2 if kind == "nv12" else height
    step = picture.step or width * channels
    last = width * channels
    if width <= 0 or height <= 0 or step < last or len(picture.data) < step * (rows - 1) + last:
        raise ValueError(
            f"{len(picture.data)} bytes do not hold {width}x{height} {picture.format} with {step} bytes a row"
        )
    if kind in (*_YUV422, "nv12") and width % 2:
        raise ValueError(f"{picture.format} pictures have an even width, not {width}")
    data = np.frombuffer(picture.data, np.uint8, min(len(picture.data), step * rows))
    if len(data) < step * rows:
        data = np.pad(data, (0, step * rows - len(data)))
    grid = data.reshape(rows, step)[:, :last]
    if kind == "nv12":
        uv = grid[height:]
        planes = (uv[:, 0::2], uv[:, 1::2])
        return YuvFrame(index, stamp_ns, grid[:height], planes, (2, 2), (0.0, 0.5), _BT601)
    if kind in _YUV422:
        luma = _YUV422[kind]
        planes = (grid[:, 1 - luma :: 4], grid[:, 3 - luma :: 4])
        return YuvFrame(index, stamp_ns, grid[:, luma::2], planes, (2, 1), (0.0, 0.0), _BT601)
    code = _TO_BGR[kind][1]
    pixels = grid if channels == 1 else grid.reshape(height, width, channels)
    image = np.ascontiguousarray(pixels)
    if code is not None:
        image = cv2.cvtColor(image, code)  # type: ignore[assignment]
    return BgrFrame(index, stamp_ns, image)


_BT601 = yuv_to_bgr_matrix("bt601", False)


# --- compressed video ---

_PLANAR = {"yuv420p": (2, 2), "yuvj420p": (2, 2), "yuv422p": (2, 1), "yuvj422p": (2, 1), "yuv444p": (1, 1)}
_MATRICES = {1: "bt709", 5: "bt601", 6: "bt601", 9: "bt2020", 10: "bt2020"}


def _video_frame(index: int, stamp_ns: int, picture: av.VideoFrame) -> Frame:
    """A decoded picture in its planes; colour as tagged, else BT.709 from 720 rows on and BT.601 below."""
    name = picture.format.name
    if name not in _PLANAR:
        return BgrFrame(index, stamp_ns, picture.to_ndarray(format="bgr24"))  # type: ignore[arg-type]
    step = _PLANAR[name]
    width, height = picture.width, picture.height
    sizes = [(width, height)] + [(-(-width // step[0]), -(-height // step[1]))] * 2
    y, u, v = (
        np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)[:rows, :columns]
        for plane, (columns, rows) in zip(picture.planes, sizes, strict=True)
    )
    matrix = _MATRICES.get(int(picture.colorspace), "bt709" if height >= 720 else "bt601")
    full = name.startswith("yuvj") or int(picture.color_range) == 2
    origin = (0.0, 0.5 if step[1] == 2 else 0.0)
    return YuvFrame(index, stamp_ns, y, (u, v), step, origin, yuv_to_bgr_matrix(matrix, full))


def is_key_picture(data: bytes, format_: str) -> bool:
    """Whether an access unit (h264, h265: Annex B; av1; vp9) can be decoded without those before it."""
    if format_ in ("h264", "h265"):
        at = data.find(b"\0\0\1")
        while 0 <= at < len(data) - 3:
            kind = data[at + 3] & 31 if format_ == "h264" else data[at + 3] >> 1 & 63
            if kind == 5 if format_ == "h264" else 16 <= kind <= 21:
                return True
            if kind == 1 if format_ == "h264" else kind < 16:
                return False
            at = data.find(b"\0\0\1", at + 3)
        return False
    if format_ == "vp9":
        return bool(data) and not data[0] & 0x0C
    return any(data[at] >> 3 & 15 == 1 for at in (0, 2) if at < len(data))  # AV1: a sequence header


# --- the source ---


@dataclass
class ImageLosses:
    """What could not be had from an image topic, counted while its frames are read; truthy when anything was
    lost.

    Counts are of messages of the topic. `stopped` says why reading ended before the topic's end.
    """

    undecodable: int = 0
    damaged: int = 0
    out_of_order: int = 0
    stopped: str | None = None
    first_reason: str | None = None
    file: list[Loss] = field(default_factory=list)
    """Damage of the file itself."""

    def __bool__(self) -> bool:
        return bool(self.undecodable or self.damaged or self.stopped or self.file)

    def lines(self) -> list[str]:
        """One line per kind of loss, for a person."""
        lines = [str(loss) for loss in self.file]
        if self.undecodable:
            reason = f"; the first: {self.first_reason}" if self.first_reason else ""
            lines.append(f"{self.undecodable} pictures could not be decoded and are missing{reason}")
        if self.damaged:
            lines.append(f"{self.damaged} pictures are damaged (kept as the decoder patched them)")
        if self.out_of_order:
            lines.append(f"{self.out_of_order} pictures have a stamp that is not after the one before (kept)")
        if self.stopped:
            lines.append(self.stopped)
        return lines


class McapImageSource:
    """One image topic of an MCAP as frames, in log-time order; also a context manager.

    Parameters
    ----------
    path: the recording, whole or damaged.
    topic: the image topic; None takes the only one there is.
    time: what a frame's stamp is: the message's header stamp, its log time or its publish time.
    start_ns, end_ns: only frames with start_ns <= stamp < end_ns, in that time; None is open.

    `frame.index` is the message's number on its topic from 0, whatever the start, and counts messages that
    cannot be decoded too, so seeds stay valid. `calibration_topic` is the one beside the pictures, None when
    there is none.

    Raises SourceError when there is no such topic, or no picture of it can be decoded; UsageError when the
    topic has to be named.
    """

    rotation_deg = 0
    pixel_aspect = 1.0

    def __init__(
        self,
        path: str | os.PathLike[str],
        topic: str | None = None,
        *,
        time: TimeBase = "header",
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> None:
        self.path = Path(path)
        self.time = time
        self.start_ns, self.end_ns = start_ns, end_ns
        self.lost = ImageLosses()
        self._pending: Iterator[Frame] | None = None
        self._decoders: dict[int, Callable[[bytes], dict[str, Any]]] = {}
        self._records = McapRecords(path)
        try:
            self.topic = self._chosen(topic)
            self.calibration_topic = self._beside()
            self._open_first()
        except BaseException:
            self._records.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; frames already given stay valid."""
        self._records.close()

    def frames(self) -> Generator[Frame, None, None]:
        """All frames by log time, each decoded once; `lost` is complete at the end. Calling again starts
        over.
        """
        if self._pending is None:
            self.lost = ImageLosses()
            frames = self._read()
        else:
            frames, self._pending = self._pending, None
        last_ns: int | None = None
        for frame in frames:
            if (frame.width_px, frame.height_px) != (self.width_px, self.height_px):
                self.lost.stopped = (
                    f"{self.path}: {self.topic}: the picture size changes from "
                    f"{self.width_px}x{self.height_px} to {frame.width_px}x{frame.height_px} "
                    f"at message {frame.index}; the rest is left out"
                )
                break
            self.lost.out_of_order += last_ns is not None and frame.stamp_ns <= last_ns
            last_ns = frame.stamp_ns
            yield frame
        self.lost.file = list(self._records.lost)

    # --- opening ---

    def _chosen(self, topic: str | None) -> str:
        found = image_topics(self._records)
        listed = ", ".join(map(str, found))
        if topic is None:
            if len(found) == 1:
                return found[0].topic
            if found:
                raise UsageError(f"{self.path} has several image topics, name one with --topic: {listed}")
        elif any(f.topic == topic for f in found):
            return topic
        others = sorted({c.topic for c in self._records.channels.values()})
        if topic in others:
            channel = next(c for c in self._records.channels.values() if c.topic == topic)
            schema = self._records.schemas.get(channel.schema_id)
            name = schema.name if schema is not None else "no schema"
            raise SourceError(
                f"{self.path}: topic {topic} is not an image topic ({name}, {channel.message_encoding}); "
                f"those there are: {listed or 'none'}"
            )
        there = listed or f"no image topic, only {', '.join(others) or 'nothing'}"
        what = f"no topic {topic}" if topic else "no image topic"
        raise SourceError(f"{self.path}: {what}; there is {there}")

    def _open_first(self) -> None:
        """Decode the first picture, for the size; a topic without any is an error."""
        frames = self._read()
        first = next(frames, None)
        if first is None:
            self.lost.file = list(self._records.lost)
            why = "; ".join(self.lost.lines()) or "it has no messages in the asked time"
            raise SourceError(f"{self.path}: no picture of {self.topic} could be decoded: {why}")
        self.width_px, self.height_px = first.width_px, first.height_px
        self.first_stamp_ns = first.stamp_ns
        self._pending = itertools.chain([first], frames)

    @property
    def frame_count_hint(self) -> int:
        """How many messages the topic has."""
        return sum(self._records.counts.get(c.id, 0) for c in self._records.channels.values() if c.topic == self.topic)

    @cached_property
    def calibration(self) -> Camera | None:
        """The Camera found beside the pictures, for the size that it states; None when there is none.

        It is read when first asked for: ask before `frames` are read, or not at all. Raises SourceError for a
        distortion that is not supported.
        """
        for message in self._messages(self.calibration_topic):
            source = f"{self.path.name}: {self.calibration_topic}"
            try:
                camera = _camera(self._fields(message), "rect" in self.topic, source)
            except _UNREADABLE:
                continue
            if camera is not None:
                return camera
        return None

    @cached_property
    def frame_id(self) -> str:
        """The coordinate frame that the calibration names, else the pictures; "" when neither does.

        Ask before `frames` are read.
        """
        for topic in (self.calibration_topic, self.topic):
            for message in itertools.islice(self._messages(topic), 1):
                with suppress(*_UNREADABLE):
                    if name := self._fields(message).get("frame_id"):
                        return str(name)
        return ""

    def _beside(self) -> str | None:
        """The calibration topic beside the images: the same prefix, or one level up (ROS image_transport)."""
        found: dict[str, str] = {}
        for channel in self._records.channels.values():
            schema = self._records.schemas.get(channel.schema_id)
            if schema is not None and _kind(schema, channel) in _CALIBRATIONS:
                found.setdefault(channel.topic.rsplit("/", 1)[0], channel.topic)
        prefix = self.topic.rsplit("/", 1)[0]
        place = prefix if prefix in found else prefix.rsplit("/", 1)[0]
        return found.get(place)

    # --- reading ---

    def _messages(self, topic: str | None) -> Iterator[RawMessage]:
        return self._records.messages({topic} if topic is not None else set())

    def _fields(self, message: RawMessage) -> dict[str, Any]:
        """A message's fields by lower-case name; _UNREADABLE when they cannot be had."""
        channel = message.channel
        if channel.id not in self._decoders:
            self._decoders[channel.id] = _decoder(self._records.schemas.get(channel.schema_id), channel)
        return self._decoders[channel.id](message.data)

    def _read(self) -> Iterator[Frame]:
        """Every frame in the asked time; stills as they come, video through one decoder."""
        pictures = self._pictures()
        first = next(pictures, None)
        if first is None:
            return
        pictures = itertools.chain([first], pictures)
        codec = _video_codec(first[2].format) if not first[2].width else None
        if codec is None:
            yield from self._stills(pictures)
        else:
            yield from self._video(pictures, codec)

    def _pictures(self) -> Iterator[tuple[int, int, _Picture]]:
        """(message number, stamp in ns, picture) up to the asked end."""
        for index, message in enumerate(self._messages(self.topic)):
            try:
                picture = _picture(self._fields(message))
            except _UNREADABLE as error:
                self._miss(index, message.log_time, f"the message does not parse ({_one_line(error)})")
                continue
            stamp_ns = {
                "header": picture.stamp_ns,
                "log": message.log_time,
                "publish": message.publish_time,
            }[self.time]
            # A recording may begin at 0, as that of a video without a date does; elsewhere 0 says: not set.
            if stamp_ns is None or (stamp_ns == 0 and message.log_time != 0):
                raise SourceError(f"{self.path}: {self.topic}: message {index} has no {self.time} time: use --time log")
            if self.end_ns is not None and stamp_ns >= self.end_ns:
                if stamp_ns >= self.end_ns + 1_000_000_000:
                    return
                continue
            yield index, stamp_ns, picture

    def _stills(self, pictures: Iterator[tuple[int, int, _Picture]]) -> Iterator[Frame]:
        for index, stamp_ns, picture in pictures:
            if self.start_ns is not None and stamp_ns < self.start_ns:
                continue
            if picture.width and picture.format.lower() not in RAW_ENCODINGS:
                raise SourceError(
                    f"{self.path}: {self.topic}: encoding {picture.format!r} (message {index}) is not "
                    f"supported; those that are: {', '.join(RAW_ENCODINGS)}"
                )
            try:
                if picture.width:
                    yield _raw_frame(index, stamp_ns, picture)
                else:
                    yield self._still(index, stamp_ns, picture)
            except ValueError as error:
                self._miss(index, stamp_ns, _one_line(error))

    def _still(self, index: int, stamp_ns: int, picture: _Picture) -> Frame:
        name = next((known for known in _STILLS if known in picture.format), None)
        if name is None or "compresseddepth" in picture.format:
            raise SourceError(
                f"{self.path}: {self.topic}: format {picture.format!r} (message {index}) is not supported; "
                f"those that are: {', '.join((*_STILLS, *_VIDEO))}"
            )
        data = np.frombuffer(picture.data, np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
        if image is None:
            raise ValueError(f"{len(data)} bytes that are not a {name} picture")
        frame = BgrFrame(index, stamp_ns, image)  # type: ignore[arg-type]
        if picture.data[:3] == b"\xff\xd8\xff":
            frame.encoded = EncodedPicture(picture.data, "jpeg", True)
        return frame

    def _video(self, pictures: Iterator[tuple[int, int, _Picture]], codec: str) -> Iterator[Frame]:
        """Decode from the last key frame before the start; a frame's packet goes with it."""
        name = "h265" if codec == "hevc" else "av1" if codec == "libdav1d" else codec
        try:
            decoder = av.CodecContext.create(codec, "r")
        except (av.error.FFmpegError, ValueError) as error:
            raise SourceError(f"{self.path}: {self.topic}: this PyAV has no decoder for {name}") from error
        decoder.thread_type = "SLICE"
        waiting: dict[int, tuple[int, EncodedPicture]] = {}
        for index, stamp_ns, picture in self._from_key(pictures, name):
            encoded = EncodedPicture(picture.data, name, is_key_picture(picture.data, name))
            packet = av.Packet(picture.data)
            packet.pts = packet.dts = index
            waiting[index] = (stamp_ns, encoded)
            yield from self._decoded(decoder, packet, waiting)
        yield from self._decoded(decoder, None, waiting)
        for index, (stamp_ns, _) in waiting.items():
            self._miss(index, stamp_ns, f"the {name} decoder gave no picture for it")

    def _from_key(
        self, pictures: Iterator[tuple[int, int, _Picture]], name: str
    ) -> Iterator[tuple[int, int, _Picture]]:
        """Leave out what cannot be decoded or is not needed: all before the key frame that the start hangs
        on.
        """
        group: list[tuple[int, int, _Picture]] = []
        running = False
        for entry in pictures:
            if running:
                yield entry
                continue
            key = is_key_picture(entry[2].data, name)
            wanted = self.start_ns is None or entry[1] >= self.start_ns
            if key:
                group = [entry]
            elif group:
                group.append(entry)
            elif wanted:
                self._miss(entry[0], entry[1], "it comes before the first key frame")
            if wanted and group:
                yield from group
                running = True

    def _decoded(self, decoder: Any, packet: Any, waiting: dict[int, tuple[int, EncodedPicture]]) -> Iterator[Frame]:
        try:
            pictures = decoder.decode(packet)
        except av.error.FFmpegError:
            return
        for picture in pictures:
            index = picture.pts
            if index not in waiting:
                continue
            stamp_ns, encoded = waiting.pop(index)
            for earlier in [i for i in waiting if i < index and not decoder.has_b_frames]:
                self._miss(earlier, waiting.pop(earlier)[0], "the decoder gave no picture for it")
            if self.start_ns is not None and stamp_ns < self.start_ns:
                continue
            self.lost.damaged += bool(picture.is_corrupt)
            frame = _video_frame(index, stamp_ns, picture)
            if encoded.format in ("h264", "h265") and not decoder.has_b_frames:
                frame.encoded = encoded
            yield frame

    def _miss(self, index: int, stamp_ns: int, reason: str) -> None:
        if self.start_ns is not None and stamp_ns < self.start_ns:
            return
        self.lost.undecodable += 1
        if self.lost.first_reason is None:
            self.lost.first_reason = f"{self.topic}, message {index}: {reason}"


def _video_codec(format_: str) -> str | None:
    return next((codec for name, codec in _VIDEO.items() if name in format_), None)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
