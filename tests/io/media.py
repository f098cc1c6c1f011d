"""Small awkward video files, made when a test asks for them; each function says what is wrong with its."""

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt

from spheremcap.io.encode import write_video

Image = npt.NDArray[np.uint8]


def picture(index: int, width: int = 96, height: int = 64) -> Image:
    """Smooth colours that differ in every corner, and a green spot that tells the pictures apart."""
    y, x = np.mgrid[:height, :width]
    image = np.stack([40 + 170 * x / width, 200 - 150 * y / height, 60 + 120 * (x + y) / (width + height)], axis=2)
    spot = np.exp(-((x - 12 - 3 * index) ** 2 + (y - 20) ** 2) / 60)[..., None]
    return np.rint(image * (1 - spot) + np.array([30.0, 230.0, 60.0]) * spot).astype(np.uint8)


def video(
    path: Path,
    count: int = 8,
    *,
    codec: str = "libx264",
    pixel_format: str = "yuv420p",
    size: tuple[int, int] = (96, 64),
    rate: Fraction = Fraction(30),
    options: dict[str, str] | None = None,
    pts: Sequence[int] | None = None,
    time_base: Fraction | None = None,
    matrix: int = 5,
    full_range: bool = False,
    prepare: Callable[[Any], None] | None = None,
    container_options: dict[str, str] | None = None,
    change: Callable[[bytes, int], bytes] | None = None,
) -> Path:
    """Any codec and pixel format; `change(data, index)` edits packets on their way into the file."""
    with av.open(str(path), "w", options=container_options or {}) as container:
        stream: Any = container.add_stream(codec, rate=rate, options=options or {})
        stream.width, stream.height = size
        stream.pix_fmt = pixel_format
        stream.codec_context.thread_count = 1
        stream.codec_context.colorspace = matrix
        stream.codec_context.color_range = 2 if full_range else 1
        base = time_base or 1 / rate
        stream.time_base = stream.codec_context.time_base = base
        if prepare:
            prepare(stream)
        number = 0

        def mux(packets: list[Any]) -> None:
            nonlocal number
            for packet in packets:
                if change:
                    changed: Any = av.Packet(change(bytes(packet), number))
                    changed.pts, changed.dts, changed.time_base = packet.pts, packet.dts, packet.time_base
                    changed.is_keyframe, changed.stream = packet.is_keyframe, packet.stream
                    packet = changed
                number += 1
                container.mux(packet)

        for index in range(count):
            frame = av.VideoFrame.from_ndarray(picture(index, *size), format="bgr24").reformat(
                format=pixel_format, dst_colorspace=matrix, dst_color_range=2 if full_range else 1
            )
            frame.colorspace, frame.color_range = matrix, 2 if full_range else 1
            frame.pts, frame.time_base = (index if pts is None else pts[index]), base
            mux(stream.encode(frame))
        mux(stream.encode(None))
    return path


def plain(path: Path, count: int = 8, **more: Any) -> Path:
    """Nothing is wrong with it: H.264, no B-frames, constant rate."""
    write_video(path, (picture(i) for i in range(count)), more.pop("rate", Fraction(30)), **more)
    return path


def rotated(path: Path, counter_clockwise_deg: int, **more: Any) -> Path:
    """A phone held on its side: the pictures are stored lying down, a display matrix turns them upright."""
    return video(
        path, 3, prepare=lambda stream: stream.set_display_rotation(counter_clockwise_deg, **more),
        options={"crf": "5", "bf": "0"},
    )  # fmt: skip


def hidden_start(path: Path, hidden: int = 3) -> Path:
    """An edit list hides the first pictures: they have to be decoded but must not be shown."""
    return video(path, options={"bf": "0"}, pts=range(-hidden, 8 - hidden))


def cut(path: Path, whole: Path, fraction: float) -> Path:
    """The copy stopped half-way: the file ends in the middle of a picture."""
    data = whole.read_bytes()
    path.write_bytes(data[: int(len(data) * fraction)])
    return path


def index_first(path: Path, count: int = 30) -> Path:
    """An MP4 with its index at the front, so that what is there of a cut one can still be read."""
    return video(path, count, options={"bf": "0", "g": "5"}, container_options={"movflags": "faststart"})


def bad_packets(path: Path, bad: Sequence[int], count: int = 12) -> Path:
    """Some pictures in the middle are garbage: the decoder refuses them, the others are whole."""

    def spoil(data: bytes, index: int) -> bytes:
        return b"\0" * len(data) if index in bad else data

    return video(path, count, codec="mjpeg", pixel_format="yuvj420p", full_range=True, change=spoil)


def growing(path: Path) -> Path:
    """The picture size changes half-way: streams of two sizes behind one another, as a switcher gives."""
    parts = []
    for number, size in enumerate([(96, 64), (64, 48)]):
        part = path.with_name(f"part{number}.h264")
        parts.append(video(part, 4, size=size, options={"bf": "0", "x264-params": "repeat-headers=1"}).read_bytes())
        part.unlink()
    path.write_bytes(b"".join(parts))
    return path


def sound_only(path: Path) -> Path:
    """A sound file: there is no video stream in it."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
    return path


def cover_and_video(path: Path) -> Path:
    """A large still picture in a stream of its own beside a small video: the video is what is meant."""
    with av.open(str(path), "w") as container:
        cover: Any = container.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 320, 240, "yuvj420p"
        cover.disposition = av.stream.Disposition.attached_pic
        stream: Any = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        still = av.VideoFrame.from_ndarray(picture(0, 320, 240), format="bgr24").reformat(format="yuvj420p")
        still.pts = 0
        container.mux(cover.encode(still) + cover.encode(None))
        for index in range(4):
            frame = av.VideoFrame.from_ndarray(picture(index), format="bgr24").reformat(format="yuv420p")
            frame.pts = index
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path
