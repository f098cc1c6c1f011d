"""Image channels of MCAP files written with the reference libraries: every encoding and way to fail."""

import base64
import json
from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import numpy.typing as npt
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set
from mcap_ros1._vendor.genpy.dynamic import generate_dynamic
from mcap_ros1.writer import Writer as Ros1Writer
from mcap_ros2.writer import Writer as Ros2Writer

from spheremcap.core.camera import Camera
from spheremcap.core.frame import Window, YuvFrame
from spheremcap.errors import SourceError, UsageError
from spheremcap.io import mcap_images
from spheremcap.io.mcap_images import McapImageSource, image_topics

Image = npt.NDArray[np.uint8]
WIDTH, HEIGHT = 64, 48
START = 1_700_000_000_123_456_789
STEP = 4_166_667
LATER = 50_000_000  # log times are this much after the header stamps, publish times half of it


def scene(k: int = 0) -> Image:
    """A smooth colour picture (48, 64, 3) BGR that moves with k."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    b = 100 + 60 * np.sin((x + 3 * k) / 15)
    g = 100 + 60 * np.cos(y / 12)
    r = 60 + 2 * x
    return np.stack([b, g, r], axis=2).clip(0, 255).astype(np.uint8)


def gray() -> Image:
    return np.asarray(cv2.cvtColor(scene(), cv2.COLOR_BGR2GRAY), np.uint8)


def uyvy() -> Image:
    """Packed (48, 64, 2) U Y V Y, and its inverse is OpenCV's own."""
    yuv = cv2.cvtColor(scene(), cv2.COLOR_BGR2YUV_UYVY)
    return np.asarray(yuv, np.uint8)


def nv12() -> Image:
    i420 = np.asarray(cv2.cvtColor(scene(), cv2.COLOR_BGR2YUV_I420), np.uint8).reshape(-1)
    luma, chroma = i420[: WIDTH * HEIGHT], i420[WIDTH * HEIGHT :].reshape(2, -1)
    return np.concatenate([luma, chroma.T.reshape(-1)]).reshape(HEIGHT * 3 // 2, WIDTH)


def bayer() -> Image:
    mosaic = np.empty((HEIGHT, WIDTH), np.uint8)
    bgr = scene()
    mosaic[0::2, 0::2], mosaic[0::2, 1::2] = bgr[0::2, 0::2, 2], bgr[0::2, 1::2, 1]
    mosaic[1::2, 0::2], mosaic[1::2, 1::2] = bgr[1::2, 0::2, 1], bgr[1::2, 1::2, 0]
    return mosaic


RAW: dict[str, tuple[Callable[[], Image], int, float]] = {
    "rgb8": (lambda: scene()[..., ::-1], 3, 0),
    "bgr8": (scene, 3, 0),
    "8UC3": (scene, 3, 0),
    "rgba8": (lambda: np.dstack([scene()[..., ::-1], gray()]), 4, 0),
    "bgra8": (lambda: np.dstack([scene(), gray()]), 4, 0),
    "mono8": (gray, 1, 0),
    "8UC1": (gray, 1, 0),
    "yuv422": (uyvy, 2, 5),
    "uyvy": (uyvy, 2, 5),
    "yuyv": (lambda: uyvy()[..., ::-1], 2, 5),
    "nv12": (nv12, 1, 5),
    "bayer_rggb8": (bayer, 1, 6),
}
STILLS = {"jpeg": 6.0, "png": 0.0, "webp": 6.0}


def encoded(kind: str, k: int = 0) -> bytes:
    extension = ".jpg" if kind == "jpeg" else f".{kind}"
    return bytes(cv2.imencode(extension, scene(k))[1])


def video(codec: str, count: int = 12, gop: int = 5, **options: str) -> list[bytes]:
    """Annex B access units (or AV1/VP9 packets), one a picture, without reordering."""
    packets: list[bytes] = []
    context: Any = av.CodecContext.create(codec, "w")
    context.width, context.height, context.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    context.time_base = Fraction(1, 240)
    context.gop_size = gop
    context.options = options
    for k in range(count):
        frame = av.VideoFrame.from_ndarray(scene(k), format="bgr24").reformat(format="yuv420p")
        frame.pts = k
        packets += [bytes(p) for p in context.encode(frame)]
    packets += [bytes(p) for p in context.encode(None)]
    return packets


def h264(count: int = 12, gop: int = 5) -> list[bytes]:
    return video("libx264", count, gop, preset="ultrafast", tune="zerolatency", **{"x264-params": "repeat-headers=1"})


# --- the four kinds of files ---

Fields = dict[str, Any]
HEADER = "std_msgs/Header header\n"
CDR_HEADER = "================\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
CDR_TIME = "================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
ROS1_HEADER = "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
DEFINITIONS = {
    "Image": HEADER
    + "uint32 height\nuint32 width\nstring encoding # how\nuint8 is_bigendian\nuint32 step\nuint8[] data\n",
    "CompressedImage": HEADER + "uint8 SOME=1\nstring format\nuint8[] data\n",
    "CameraInfo": HEADER + "uint32 height\nuint32 width\nstring distortion_model\nfloat64[] {d}\nfloat64[9] {k}\n"
    "float64[9] {r}\nfloat64[12] {p}\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n",
    "CompressedVideo": "{time} timestamp\nstring frame_id\nuint8[] data\nstring format\n",
    "RawImage": "{time} timestamp\nuint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data\n",
}
ROI = (
    "=" * 80 + "\nMSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\n"
    "uint32 width\nbool do_rectify\n"
)
PROTOBUF = {
    "RawImage": RawImage,
    "CompressedImage": CompressedImage,
    "CompressedVideo": CompressedVideo,
    "CameraCalibration": CameraCalibration,
}
Entry = tuple[str, str, Fields]  # topic, message name, fields


def write_protobuf(path: Path, entries: Iterable[Entry], stamps: list[int] | None = None) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=20_000)
        writer.start()
        ids: dict[str, int] = {}
        for k, (topic, name, fields) in enumerate(entries):
            message_class = PROTOBUF[name]
            if topic not in ids:
                data = build_file_descriptor_set(message_class).SerializeToString()
                schema = writer.register_schema(f"foxglove.{name}", "protobuf", data)
                ids[topic] = writer.register_channel(topic, "protobuf", schema)
            stamp = stamps[k] if stamps else START + k * STEP
            when = Timestamp(seconds=stamp // 10**9, nanos=stamp % 10**9)
            message = message_class(timestamp=when, **fields)
            log_time = START + k * STEP + LATER
            writer.add_message(ids[topic], log_time, message.SerializeToString(), log_time - LATER // 2, k)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_json(path: Path, entries: Iterable[Entry]) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        ids: dict[str, int] = {}
        for k, (topic, name, fields) in enumerate(entries):
            if topic not in ids:
                schema = writer.register_schema(f"foxglove.{name}", "jsonschema", b'{"type":"object"}')
                ids[topic] = writer.register_channel(topic, "json", schema)
            stamp = START + k * STEP
            message: Fields = {
                "timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9},
                "frame_id": "c",
            } | fields
            if "data" in message:
                message["data"] = base64.b64encode(message["data"]).decode()
            writer.add_message(ids[topic], stamp + LATER, json.dumps(message).encode(), stamp + LATER // 2, k)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_ros2(path: Path, entries: Iterable[Entry]) -> Path:
    with path.open("wb") as file, Ros2Writer(file) as writer:
        schemas: dict[str, Any] = {}
        for k, (topic, name, fields) in enumerate(entries):
            stamp = START + k * STEP
            time = {"sec": stamp // 10**9, "nanosec": stamp % 10**9}
            sensor = "header" in DEFINITIONS[name]
            if name not in schemas:
                text = DEFINITIONS[name].format(time="builtin_interfaces/Time", d="d", k="k", r="r", p="p")
                text += (CDR_HEADER if sensor else "") + CDR_TIME + (ROI if name == "CameraInfo" else "")
                package = "sensor_msgs" if sensor else "foxglove_msgs"
                schemas[name] = writer.register_msgdef(f"{package}/msg/{name}", text)
            when = {"header": {"stamp": time, "frame_id": "odd"}} if sensor else {"timestamp": time, "frame_id": "odd"}
            writer.write_message(topic, schemas[name], when | fields, stamp + LATER, stamp + LATER // 2, k)
    return path


def write_ros1(path: Path, entries: Iterable[Entry]) -> Path:
    with path.open("wb") as file:
        writer = Ros1Writer(file)
        classes: dict[str, Any] = {}
        for k, (topic, name, fields) in enumerate(entries):
            stamp = START + k * STEP
            sensor = "header" in DEFINITIONS[name]
            if name not in classes:
                text = DEFINITIONS[name].format(time="time", d="D", k="K", r="R", p="P")
                text += (ROS1_HEADER if sensor else "") + (ROI if name == "CameraInfo" else "")
                full = f"{'sensor_msgs' if sensor else 'foxglove_msgs'}/{name}"
                classes[name] = generate_dynamic(full, text)[full]  # type: ignore[no-untyped-call]
            message = classes[name]()
            time = message.header.stamp if sensor else message.timestamp
            time.secs, time.nsecs = stamp // 10**9, stamp % 10**9
            for key, value in fields.items():
                setattr(message, key.upper() if len(key) == 1 else key, value)
            writer.write_message(topic, message, stamp + LATER, stamp + LATER // 2, k)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


WRITERS: dict[str, Callable[[Path, Iterable[Entry]], Path]] = {
    "protobuf": write_protobuf,
    "json": write_json,
    "ros2": write_ros2,
    "ros1": write_ros1,
}


def raw_entry(kind: str, name: str, padding: int = 0) -> Entry:
    make, channels, _ = RAW[kind]
    rows = np.ascontiguousarray(make()).reshape(-1, WIDTH * channels)
    data = np.pad(rows, ((0, 0), (0, padding))).tobytes()
    step = WIDTH * channels + padding
    return (
        "/front/image",
        name,
        {"width": WIDTH, "height": HEIGHT, "encoding": kind, "step": step, "data": data},
    )


def still_entry(kind: str, k: int = 0) -> Entry:
    return "/front/image", "CompressedImage", {"format": kind, "data": encoded(kind, k)}


def video_entries(packets: list[bytes], format_: str, name: str = "CompressedVideo") -> list[Entry]:
    return [("/front/image", name, {"format": format_, "data": data}) for data in packets]


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("kind", RAW)
def test_raw_encodings(tmp_path: Path, kind: str, writer: str) -> None:
    name = "Image" if writer.startswith("ros") else "RawImage"
    path = WRITERS[writer](tmp_path / "a.mcap", [raw_entry(kind, name), raw_entry(kind, name, padding=10)])
    with McapImageSource(path) as source:
        assert (source.width_px, source.height_px) == (WIDTH, HEIGHT)
        frames = list(source.frames())
        assert not source.lost
    assert [f.stamp_ns for f in frames] == [START, START + STEP]
    wanted = np.repeat(gray()[..., None], 3, axis=2) if kind in ("mono8", "8UC1") else scene()
    for frame in frames:
        difference = np.abs(frame.full.astype(int) - wanted)[2:-2, 2:-2]
        assert np.percentile(difference, 99) <= RAW[kind][2]
        window = Window(10, 11, 20, 15)
        assert np.array_equal(frame.patch(window), frame.full[11:26, 10:30])
    assert isinstance(frames[0], YuvFrame) == (kind in ("yuv422", "uyvy", "yuyv", "nv12"))


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("kind", STILLS)
def test_compressed_stills(tmp_path: Path, kind: str, writer: str) -> None:
    path = WRITERS[writer](tmp_path / "a.mcap", [still_entry(kind, k) for k in range(3)])
    with McapImageSource(path, "/front/image") as source:
        frames = list(source.frames())
        again = list(source.frames())
    assert [f.index for f in frames] == [f.index for f in again] == [0, 1, 2]
    for k, frame in enumerate(frames):
        assert np.abs(frame.full.astype(int) - scene(k)).mean() <= STILLS[kind]
        assert (frame.encoded is not None) == (kind == "jpeg")
    if frames[0].encoded is not None:
        assert (frames[0].encoded.data, frames[0].encoded.key) == (encoded("jpeg"), True)


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("name", ["CompressedVideo", "CompressedImage"])
def test_h264_in_video_and_in_image_messages(tmp_path: Path, writer: str, name: str) -> None:
    packets = h264()
    path = WRITERS[writer](tmp_path / "a.mcap", video_entries(packets, "h264", name))
    with McapImageSource(path) as source:
        frames = list(source.frames())
        assert not source.lost
    assert [f.stamp_ns for f in frames] == [START + k * STEP for k in range(12)]
    assert all(np.abs(f.full.astype(int) - scene(f.index)).mean() < 6 for f in frames)
    assert [f.encoded.data for f in frames if f.encoded] == packets
    assert [f.index for f in frames if f.encoded and f.encoded.key] == [0, 5, 10]


@pytest.mark.parametrize(
    ("codec", "format_", "options"),
    [
        ("libx265", "h265", {"preset": "ultrafast", "tune": "zerolatency", "x265-params": "log-level=none"}),
        ("libvpx-vp9", "vp9", {"deadline": "realtime", "lag-in-frames": "0", "cpu-used": "8"}),
        ("libsvtav1", "av1", {"preset": "12", "svtav1-params": "pred-struct=1"}),
    ],
)
def test_other_video_codecs(tmp_path: Path, codec: str, format_: str, options: dict[str, str]) -> None:
    try:
        packets = video(codec, 8, 5, **options)
    except (av.error.FFmpegError, ValueError):
        pytest.skip(f"this PyAV cannot encode with {codec}")
    path = write_protobuf(tmp_path / "a.mcap", video_entries(packets, format_))
    with McapImageSource(path) as source:
        frames = list(source.frames())
    assert len(frames) == len(packets)
    assert all(np.abs(f.full.astype(int) - scene(f.index)).mean() < 8 for f in frames)
    assert (frames[0].encoded is not None) == (format_ == "h265")


def test_the_time_of_a_frame_is_the_one_asked_for(tmp_path: Path) -> None:
    path = write_protobuf(tmp_path / "a.mcap", [still_entry("png")])
    stamps = {}
    for time in ("header", "log", "publish"):
        with McapImageSource(path, time=time) as source:
            stamps[time] = next(iter(source.frames())).stamp_ns
    assert stamps == {"header": START, "log": START + LATER, "publish": START + LATER // 2}


def test_start_and_end_decode_from_the_key_frame_before(tmp_path: Path) -> None:
    path = write_protobuf(tmp_path / "a.mcap", video_entries(h264(), "h264"))
    with McapImageSource(path, start_ns=START + 7 * STEP, end_ns=START + 9 * STEP) as source:
        frames = list(source.frames())
        assert not source.lost
    assert [f.index for f in frames] == [7, 8]
    assert np.abs(frames[0].full.astype(int) - scene(7)).mean() < 6


def test_what_is_known_of_a_video_is_asked_of_its_first_picture_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    whole = mcap_images.DecodedPictures

    def noted(picture: object) -> object:
        asked.append(picture)
        return whole(picture)  # type: ignore[arg-type]

    monkeypatch.setattr(mcap_images, "DecodedPictures", noted)
    path = write_protobuf(tmp_path / "a.mcap", video_entries(h264(), "h264"))
    with McapImageSource(path) as source:
        assert [len(list(source.frames())) for _ in range(2)] == [12, 12]
    assert len(asked) == 1


def test_video_that_starts_between_key_frames_is_counted(tmp_path: Path) -> None:
    path = write_protobuf(tmp_path / "a.mcap", video_entries(h264()[3:], "h264"))
    with McapImageSource(path) as source:
        frames = list(source.frames())
        assert source.lost.undecodable == 2
        assert "before the first key frame" in source.lost.lines()[0]
    assert [f.index for f in frames] == list(range(2, 9))


def test_undecodable_pictures_are_counted_and_left_out(tmp_path: Path) -> None:
    entries = [still_entry("jpeg", k) for k in range(4)]
    entries[2][2]["data"] = b"not a picture"
    path = write_protobuf(tmp_path / "a.mcap", entries)
    with McapImageSource(path) as source:
        assert [f.index for f in source.frames()] == [0, 1, 3]
        assert source.lost.undecodable == 1
        assert "/front/image, message 2" in source.lost.lines()[0]


def test_raw_data_shorter_than_the_picture_is_named(tmp_path: Path) -> None:
    entries = [raw_entry("rgb8", "RawImage"), raw_entry("rgb8", "RawImage")]
    entries[1][2]["data"] = entries[1][2]["data"][:-5]
    with McapImageSource(write_protobuf(tmp_path / "a.mcap", entries)) as source:
        assert len(list(source.frames())) == 1
        assert "do not hold 64x48 rgb8" in source.lost.lines()[0]


def test_stamps_that_go_back_are_kept_and_counted(tmp_path: Path) -> None:
    entries = [still_entry("png", k) for k in range(4)]
    path = write_protobuf(tmp_path / "a.mcap", entries, [START, START + 3, START + 2, START + 5])
    with McapImageSource(path) as source:
        assert [f.stamp_ns - START for f in source.frames()] == [0, 3, 2, 5]
        assert source.lost.out_of_order == 1
        assert not source.lost


def test_a_change_of_size_ends_the_run_and_says_where(tmp_path: Path) -> None:
    entries = [still_entry("png"), still_entry("png")]
    entries[1][2]["data"] = bytes(cv2.imencode(".png", scene()[:40])[1])
    with McapImageSource(write_protobuf(tmp_path / "a.mcap", entries)) as source:
        assert len(list(source.frames())) == 1
        assert "changes from 64x48 to 64x40 at message 1" in (source.lost.stopped or "")


def test_topics_are_listed_and_chosen(tmp_path: Path) -> None:
    other = ("/left/image", *still_entry("png")[1:])
    path = write_protobuf(tmp_path / "a.mcap", [still_entry("jpeg"), other, other])
    assert [(t.topic, t.messages) for t in image_topics(path)] == [("/front/image", 1), ("/left/image", 2)]
    with pytest.raises(UsageError, match=r"several image topics.*/front/image.*/left/image"):
        McapImageSource(path)
    with pytest.raises(SourceError, match=r"no topic /rear; there is /front/image"):
        McapImageSource(path, "/rear")
    with McapImageSource(path, "/left/image") as source:
        assert source.frame_count_hint == 2


def test_what_is_not_an_image_is_named(tmp_path: Path) -> None:
    calibration = ("/front/calibration", "CameraCalibration", {"width": 64, "height": 48})
    path = write_protobuf(tmp_path / "a.mcap", [calibration])
    with pytest.raises(SourceError, match=r"not an image topic \(foxglove.CameraCalibration"):
        McapImageSource(path, "/front/calibration")
    with pytest.raises(SourceError, match="no image topic"):
        McapImageSource(path)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            ("/i", "RawImage", {"width": 1, "height": 1, "encoding": "16UC1", "step": 2, "data": b"ab"}),
            "'16UC1'.*rgb8",
        ),
        (("/i", "CompressedImage", {"format": "jp2", "data": b"ab"}), "'jp2'.*jpeg"),
        (
            ("/i", "CompressedVideo", {"format": "h264", "data": b"ab"}),
            "no picture.*before the first key frame",
        ),
    ],
)
def test_unknown_encodings_are_named(tmp_path: Path, entry: Entry, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        McapImageSource(write_protobuf(tmp_path / "a.mcap", [entry]))


def calibration_fields(upper: bool, **changes: Any) -> Fields:
    k = [500.0, 0, 31.5, 0, 501.0, 23.5, 0, 0, 1]
    p = [400.0, 0, 30.0, 0, 0, 401.0, 22.0, 0, 0, 0, 1, 0]
    fields: Fields = {
        "width": WIDTH, "height": HEIGHT, "distortion_model": "plumb_bob",
        "d": [-0.3, 0.1, 0.001, 0.002, 0.0], "k": k, "r": [1.0, 0, 0, 0, 1, 0, 0, 0, 1], "p": p,
    } | changes  # fmt: skip
    return {(key.upper() if upper and len(key) == 1 else key): value for key, value in fields.items()}


@pytest.mark.parametrize("writer", WRITERS)
def test_the_calibration_beside_the_images_is_used(tmp_path: Path, writer: str) -> None:
    ros = writer.startswith("ros")
    name, topic = ("CameraInfo", "/front/camera_info") if ros else ("CameraCalibration", "/front/calibration")
    entries = [(topic, name, calibration_fields(upper=not ros)), still_entry("png")]
    with McapImageSource(WRITERS[writer](tmp_path / "a.mcap", entries)) as source:
        camera = source.calibration
        assert camera is not None
        assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (500, 501, 31.5, 23.5)
        assert (camera.model, camera.distortion[:4]) == ("plumb_bob", (-0.3, 0.1, 0.001, 0.002))
        assert topic in camera.source


def test_calibrations_of_other_kinds(tmp_path: Path) -> None:
    def read(topic: str, calibration_topic: str, **changes: Any) -> Camera | None:
        image = (topic, *still_entry("png")[1:])
        fields = calibration_fields(True, **changes)
        path = write_protobuf(tmp_path / "a.mcap", [(calibration_topic, "CameraCalibration", fields), image])
        with McapImageSource(path) as source:
            return source.calibration

    rectified = read("/c/image_rect", "/c/calibration")
    assert rectified is not None
    assert (rectified.fx_px, rectified.model) == (400, "none")
    nested = read("/c/image_raw/compressed", "/c/camera_info")
    assert nested is not None
    assert read("/c/image", "/d/calibration") is None
    assert read("/c/image", "/c/calibration", k=[0.0] * 9) is None
    fisheye = read("/c/image", "/c/calibration", distortion_model="equidistant", d=[0.1, 0.2, 0.3, 0.4])
    assert fisheye is not None
    assert (fisheye.model, fisheye.distortion) == ("fisheye", (0.1, 0.2, 0.3, 0.4))
    larger = read("/c/image", "/c/calibration", width=WIDTH * 2)
    assert larger is not None
    assert (larger.width_px, larger.fx_px) == (2 * WIDTH, 500)
    with pytest.raises(SourceError, match="'fisheye' with 5 coefficients is not supported"):
        read("/c/image", "/c/calibration", distortion_model="fisheye", d=[0.1] * 5)


@pytest.mark.parametrize("writer", WRITERS)
def test_the_coordinate_frame_is_the_calibrations_else_the_pictures(tmp_path: Path, writer: str) -> None:
    ros = writer.startswith("ros")
    name, topic = ("CameraInfo", "/front/camera_info") if ros else ("CameraCalibration", "/front/calibration")
    named = {"protobuf": "lens", "json": "c", "ros2": "odd", "ros1": ""}[writer]
    of_lens = {"frame_id": named} if writer == "protobuf" else {}
    calibration = (topic, name, calibration_fields(upper=not ros) | of_lens)
    with McapImageSource(WRITERS[writer](tmp_path / "a.mcap", [calibration, still_entry("png")])) as source:
        assert source.frame_id == named
    picture = still_entry("png")
    if writer == "protobuf":
        picture[2]["frame_id"] = "lens"
    unnamed = (topic, name, calibration_fields(upper=not ros))
    entries = [unnamed, picture] if writer == "protobuf" else [picture]
    with McapImageSource(WRITERS[writer](tmp_path / "b.mcap", entries)) as source:
        assert source.frame_id == named


def test_a_truncated_recording_gives_its_pictures_and_says_so(tmp_path: Path) -> None:
    path = write_protobuf(tmp_path / "a.mcap", [raw_entry("rgb8", "RawImage") for _ in range(20)])
    path.write_bytes(path.read_bytes()[:-2000])
    with McapImageSource(path) as source:
        assert len(list(source.frames())) > 10
        assert source.lost
        assert any("footer" in line for line in source.lost.lines())
