"""Image channels of an MCAP as frames: Foxglove's protobuf and JSON messages, ROS 2 (CDR) and ROS 1.

A frame's stamp is the message's own header stamp, or its log or publish time. Still pictures are decoded one
by one; compressed video is decoded from a key frame on, and its packets (and JPEG pictures) are handed on as
they are. How pixels become a frame is `picture`'s business, the same as for files.
"""

import base64
import itertools
import json
import os
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self, cast

import av
from av.video.codeccontext import VideoCodecContext
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from mcap.records import Channel, Schema

from spheremcap.core.camera import Camera
from spheremcap.core.frame import BgrFrame, EncodedPicture, Frame
from spheremcap.errors import SourceError, UsageError, short
from spheremcap.io import ros
from spheremcap.io.annex_b import is_key_picture
from spheremcap.io.calibration import camera_of, focal_sd_of
from spheremcap.io.mcap_records import McapRecords, RawMessage
from spheremcap.io.picture import (
    RAW_ENCODINGS,
    DecodedPictures,
    RawPicture,
    Shown,
    is_cut_jpeg,
    is_jpeg,
    raw_frame,
    set_up_decoder,
    still_image,
)
from spheremcap.io.source import Losses

TimeBase = Literal["header", "log", "publish"]

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
_UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, DecodeError)
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


def calibration_topics(records: McapRecords) -> list[str]:
    """The topics of camera calibrations of a recording, by name."""
    found = ((channel, records.schemas.get(channel.schema_id)) for channel in records.channels.values())
    return sorted({c.topic for c, schema in found if schema is not None and _kind(schema, c) in _CALIBRATIONS})


def _kind(schema: Schema, channel: Channel) -> str | None:
    """The message's name without its package, when its package and encoding are read here."""
    parts = schema.name.replace("::", "/").replace(".", "/").split("/")
    readable = channel.message_encoding in ("protobuf", "json", "cdr", "ros1")
    return parts[-1] if readable and parts[0] in _PACKAGES else None


# --- messages ---


@dataclass(frozen=True, slots=True)
class _Picture:
    """An image message of whatever schema: a raw picture, or data whose `format` is jpeg, h264, ..."""

    stamp_ns: int | None
    format: str
    data: bytes
    raw: RawPicture | None = None


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
    stamp_ns, data = fields["stamp_ns"], fields["data"]
    if not isinstance(data, bytes):
        raise TypeError(f"its data are no bytes but {type(data).__name__}")
    if stamp_ns is not None and not 0 <= stamp_ns < 1 << 63:
        raise ValueError(f"its time of {stamp_ns} ns is none")
    if "encoding" in fields:
        encoding, size = str(fields["encoding"]), [int(fields[name]) for name in ("width", "height", "step")]
        return _Picture(stamp_ns, encoding, data, RawPicture(encoding, data, *size))
    return _Picture(stamp_ns, str(fields["format"]).lower(), data)


# --- the source ---


class McapImageSource:
    """One image topic of an MCAP as frames, in log-time order; also a context manager.

    Parameters
    ----------
    source: the recording, whole or damaged: its path, or its records that somebody else closes.
    topic: the image topic; None takes the only one there is.
    time: what a frame's stamp is: the message's header stamp, its log time or its publish time.
    start_ns, end_ns: only frames with start_ns <= stamp < end_ns, in that time; None is open.

    `frame.index` is the message's number on its topic from 0, whatever the start, and counts messages that
    cannot be decoded too, so seeds stay valid. `calibration_topic` is the one beside the pictures, None when
    there is none.

    Raises SourceError when there is no such topic, or no picture of it can be decoded; UsageError when the
    topic has to be named.
    """

    pixel_aspect = 1.0
    stated_rate: Fraction | None = None

    def __init__(
        self,
        source: McapRecords | str | os.PathLike[str],
        topic: str | None = None,
        *,
        time: TimeBase = "header",
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> None:
        self._mine = not isinstance(source, McapRecords)
        self.path = source.path if isinstance(source, McapRecords) else Path(source)
        self.time = time
        self.start_ns, self.end_ns = start_ns, end_ns
        self.lost = Losses()
        self._pending: Iterator[Frame] | None = None
        self._decoders: dict[int, Callable[[bytes], dict[str, Any]]] = {}
        self._of_video: DecodedPictures | None = None  # by the first picture, wherever frames are read from later
        self._records = source if isinstance(source, McapRecords) else McapRecords(source)
        try:
            self.topic = self._chosen(topic)
            self.calibration_topic = self._beside()
            self._open_first()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, unless it is somebody else's; frames already given stay valid."""
        if self._mine:
            self._records.close()

    def frames(self) -> Generator[Frame, None, None]:
        """All frames by log time, each decoded once; `lost` is complete at the end. Calling again starts
        over.
        """
        if self._pending is None:
            self.lost = Losses()
            frames = self.frames_of(enumerate(self._messages(self.topic)))
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
        self.lost.file = self._damage()

    def forget_first(self) -> None:
        """Let go of the first picture and its decoder, which `frames` would go on with: who looks pictures up by their
        number has no use for them."""
        self._pending = None

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
        frames = self.frames_of(enumerate(self._messages(self.topic)))
        first = next(frames, None)
        if first is None:
            self.lost.file = self._damage()
            why = "; ".join(self.lost.lines()) or "it has no messages in the asked time"
            raise SourceError(f"{self.path}: no picture of {self.topic} could be decoded: {why}")
        self.width_px, self.height_px = first.width_px, first.height_px
        self.first_index, self.first_stamp_ns, self._first = first.index, first.stamp_ns, first.encoded
        self._pending = itertools.chain([first], frames)

    def _damage(self) -> list[str]:
        return list(map(str, self._records.lost))

    @property
    def chroma_note(self) -> str:
        """What the pictures show of where their chroma lies, where nothing says it; else ""."""
        return "" if self._of_video is None else self._of_video.chroma_note

    @property
    def time_source(self) -> str:
        """Where the stamps come from."""
        return f"{self.time} times of {self.topic}"

    @property
    def codec(self) -> str:
        """What the pictures are that can be handed on, by the first of them; "" for others."""
        return "" if self._first is None else self._first.format

    @property
    def passthrough_reason(self) -> str | None:
        """Why the pictures cannot be handed on as they are, by the first of them; None when they can."""
        if self._first is None:
            return "the pictures are not JPEG, nor H.264 or H.265 without B-frames"
        return None if self._first.key else "the first picture asked for is not a key frame"

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
        source = f"{self.path.name}: {self.calibration_topic}"
        for message in self._messages(self.calibration_topic):
            with suppress(*_UNREADABLE):
                fields, focal_sd = self._fields(message), focal_sd_of(message.channel.metadata)
                try:
                    camera = camera_of(fields, source, rectified="rect" in self.topic, focal_sd=focal_sd)
                except ValueError as error:
                    raise SourceError(f"{source}: {error}; give --camera") from error
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

    def frames_of(self, messages: Iterable[tuple[int, RawMessage]]) -> Iterator[Frame]:
        """The frames of some of the topic's messages, each with its number; of video the first is a key frame.

        Stills as they come, video through one decoder.
        """
        pictures = self._pictures(messages)
        first = next(pictures, None)
        if first is None:
            return
        pictures = itertools.chain([first], pictures)
        codec = _video_codec(first[2].format) if first[2].raw is None else None
        if codec is None:
            yield from self._stills(pictures)
        else:
            yield from self._video(pictures, codec)

    def is_key(self, message: RawMessage) -> bool:
        """Whether the message's picture can be decoded without those before it; a still always can."""
        try:
            picture = _picture(self._fields(message))
        except _UNREADABLE:
            return False
        codec = _video_codec(picture.format) if picture.raw is None else None
        return codec is None or is_key_picture(picture.data, _name(codec))

    def stamp_ns(self, message: RawMessage) -> int:
        """When the message's picture was taken, in the chosen time; the log time where that cannot be read."""
        try:
            stamp_ns = self._stamp(_picture(self._fields(message)), message)
        except _UNREADABLE:
            stamp_ns = None
        return message.log_time if stamp_ns is None else stamp_ns

    def _stamp(self, picture: _Picture, message: RawMessage) -> int | None:
        return {"header": picture.stamp_ns, "log": message.log_time, "publish": message.publish_time}[self.time]

    def _pictures(self, messages: Iterable[tuple[int, RawMessage]]) -> Iterator[tuple[int, int, _Picture]]:
        """(message number, stamp in ns, picture) up to the asked end."""
        for index, message in messages:
            try:
                picture = _picture(self._fields(message))
            except _UNREADABLE as error:
                self._miss(index, message.log_time, f"the message does not parse ({short(error)})")
                continue
            stamp_ns = self._stamp(picture, message)
            if stamp_ns is not None and stamp_ns >= 1 << 63:
                self._miss(index, message.log_time, f"its {self.time} time of {stamp_ns} ns is none")
                continue
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
            if picture.raw is not None and picture.format.lower() not in RAW_ENCODINGS:
                raise SourceError(
                    f"{self.path}: {self.topic}: encoding {short(picture.format)} (message {index}) is not "
                    f"supported; those that are: {', '.join(RAW_ENCODINGS)}"
                )
            try:
                if picture.raw is not None:
                    yield raw_frame(index, stamp_ns, picture.raw)
                else:
                    yield self._still(index, stamp_ns, picture)
            except ValueError as error:
                self._miss(index, stamp_ns, short(error))

    def _still(self, index: int, stamp_ns: int, picture: _Picture) -> Frame:
        known = any(name in picture.format for name in _STILLS)
        if not known or "compresseddepth" in picture.format:
            raise SourceError(
                f"{self.path}: {self.topic}: format {short(picture.format)} (message {index}) is not supported; "
                f"those that are: {', '.join((*_STILLS, *_VIDEO))}"
            )
        frame = BgrFrame(index, stamp_ns, still_image(picture.data))
        if is_jpeg(picture.data):
            self.lost.damaged += is_cut_jpeg(picture.data)
            frame.encoded = EncodedPicture(picture.data, "jpeg", True)
        return frame

    def _video(self, pictures: Iterator[tuple[int, int, _Picture]], codec: str) -> Iterator[Frame]:
        """Decode from the last key frame before the start; a frame's packet goes with it."""
        name = _name(codec)
        try:
            decoder = cast(VideoCodecContext, av.CodecContext.create(codec, "r"))
        except (av.FFmpegError, ValueError) as error:
            raise SourceError(f"{self.path}: {self.topic}: this PyAV has no decoder for {name}") from error
        set_up_decoder(decoder, careful=True)
        shown = Shown(codec)
        waiting: dict[int, tuple[int, EncodedPicture]] = {}
        for index, stamp_ns, picture in self._from_key(pictures, name):
            encoded = EncodedPicture(picture.data, name, is_key_picture(picture.data, name))
            packet = av.Packet(picture.data)
            packet.pts = packet.dts = index
            waiting[index] = (stamp_ns, encoded)
            if encoded.key:
                shown.key(index)
            yield from self._decoded(decoder, packet, waiting, shown)
        yield from self._decoded(decoder, None, waiting, shown)
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

    def _decoded(
        self, decoder: Any, packet: Any, waiting: dict[int, tuple[int, EncodedPicture]], shown: Shown
    ) -> Iterator[Frame]:
        try:
            pictures = decoder.decode(packet)
        except (av.FFmpegError, ValueError, MemoryError):
            shown.damaged()
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
            if picture.is_corrupt:
                shown.damaged()
            if not shown(index):
                self._miss(index, stamp_ns, "it is damaged, or made from a damaged one")
                continue
            self.lost.damaged += bool(picture.is_corrupt)
            # Asking a picture for its side data ties it to itself: so only one is ever asked.
            self._of_video = self._of_video or DecodedPictures(picture)
            try:
                frame = self._of_video.frame(index, stamp_ns, picture, copied=True)
            except (av.FFmpegError, ValueError) as error:
                self._miss(index, stamp_ns, f"its pixels cannot be converted ({short(error)})")
                continue
            if encoded.format in ("h264", "h265") and not decoder.has_b_frames:
                frame.encoded = encoded
            yield frame

    def _miss(self, index: int, stamp_ns: int, reason: str) -> None:
        if self.start_ns is not None and stamp_ns < self.start_ns:
            return
        self.lost.miss(f"{self.topic}, message {index}: {reason}")


def _name(codec: str) -> str:
    """What recordings call a codec of FFmpeg's."""
    return {"hevc": "h265", "libdav1d": "av1"}.get(codec, codec)


def _video_codec(format_: str) -> str | None:
    return next((codec for name, codec in _VIDEO.items() if name in format_), None)
