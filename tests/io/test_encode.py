"""H264Encoder, jpeg_encode and write_video: one in one out, the same bytes, the same picture."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import media
import numpy as np
import numpy.typing as npt
import pytest
from av.video.reformatter import Interpolation

from spheremcap.core.frame import BgrFrame, Frame
from spheremcap.errors import OutputError, UsageError
from spheremcap.io.encode import H264Encoder, jpeg_encode, write_video
from spheremcap.io.video import VideoSource

Image = npt.NDArray[np.uint8]


def bgr_frames(count: int, size: tuple[int, int] = (96, 64)) -> list[Frame]:
    return [BgrFrame(i, i, media.picture(i, *size)) for i in range(count)]


def decode_one_by_one(messages: list[bytes]) -> list[Any]:
    """Pictures of a decoder that gets one message at a time and must answer at once."""
    decoder: Any = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    pictures = []
    for message in messages:
        shown = decoder.decode(av.Packet(message))
        assert len(shown) == 1  # no reordering, no waiting
        pictures += shown
    return pictures


def difference(a: Any, b: Any) -> float:
    return float(np.abs(np.asarray(a, np.int16) - np.asarray(b, np.int16)).mean())


def test_every_frame_is_one_annex_b_picture_at_once_and_keys_carry_their_sets() -> None:
    encoder = H264Encoder(key_every=10)
    out = [encoder.encode(frame) for frame in bgr_frames(25)]
    assert [e.key for e in out] == [i % 10 == 0 for i in range(25)]
    for encoded in out:
        assert encoded.format == "h264"
        assert encoded.data.startswith((b"\0\0\0\1", b"\0\0\1"))
        types = [part[0] & 31 for part in encoded.data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1") if part]
        assert sum(t in (1, 5) for t in types) == 1  # one slice: one picture
        assert not encoded.key or {7, 8, 5} <= set(types)
    shown = decode_one_by_one([e.data for e in out])
    assert not any(p.pict_type == 3 for p in shown)
    for index, picture in enumerate(shown):
        bgr = picture.to_ndarray(format="bgr24", src_colorspace="ITU709", src_color_range=1, dst_color_range=2)
        assert difference(bgr, media.picture(index)) < 4
    # A seek to the second key frame needs nothing before it.
    assert len(decode_one_by_one([e.data for e in out[10:]])) == 15


def test_the_same_frames_give_the_same_bytes() -> None:
    runs = []
    for _ in range(2):
        encoder = H264Encoder()
        runs.append([encoder.encode(frame).data for frame in bgr_frames(12)])
    assert runs[0] == runs[1]


@pytest.mark.parametrize("full_range", [False, True])
@pytest.mark.parametrize(("tag", "name"), [(1, "bt709"), (5, "bt601")])
def test_decoded_planes_go_in_untouched_and_keep_their_colour_tags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full_range: bool, tag: int, name: str
) -> None:
    path = media.video(tmp_path / "v.mp4", 4, matrix=tag, full_range=full_range, options={"crf": "2"})
    encoder = H264Encoder(crf=1)
    with VideoSource(path) as source:
        got = list(source.frames())
    monkeypatch.setattr(Frame, "full", property(lambda self: pytest.fail("went through BGR")))
    shown = decode_one_by_one([encoder.encode(frame).data for frame in got])
    for frame, picture in zip(got, shown, strict=True):
        assert picture.color_range == (2 if full_range else 1)
        assert {1: "bt709", 6: "bt601", 5: "bt601"}[picture.colorspace] == name
        for index, plane in enumerate((frame.y, *frame.uv)):  # type: ignore[attr-defined]
            rows = np.frombuffer(memoryview(picture.planes[index]), np.uint8)
            rows = rows.reshape(picture.planes[index].height, -1)[:, : plane.shape[1]]
            assert difference(rows, plane) < 1.5


def test_rotated_video_is_encoded_upright(tmp_path: Path) -> None:
    path = media.rotated(tmp_path / "v.mp4", 90)
    encoder = H264Encoder(crf=5)
    with VideoSource(path) as source:
        got = list(source.frames())
    shown = decode_one_by_one([encoder.encode(frame).data for frame in got])
    assert (shown[0].width, shown[0].height) == (64, 96)
    bgr = shown[0].to_ndarray(format="bgr24", src_colorspace="ITU601", src_color_range=1, dst_color_range=2)
    assert difference(bgr, np.rot90(media.picture(0))) < 5


@pytest.mark.parametrize("decoded", [False, True])
def test_odd_sizes_get_one_more_column_and_row_and_pixels_stay_put(tmp_path: Path, decoded: bool) -> None:
    if decoded:
        with VideoSource(media.video(tmp_path / "v.mkv", 2, codec="ffv1", size=(97, 65))) as source:
            got = list(source.frames())
    else:
        got = bgr_frames(2, (97, 65))
    encoder = H264Encoder(crf=5)
    shown = decode_one_by_one([encoder.encode(frame).data for frame in got])
    assert (encoder.width_px, encoder.height_px) == (shown[0].width, shown[0].height) == (98, 66)
    space = "ITU601" if decoded else "ITU709"
    bgr = shown[0].to_ndarray(format="bgr24", src_colorspace=space, src_color_range=1, dst_color_range=2)
    assert difference(bgr[:65, :97], media.picture(0, 97, 65)) < 5
    assert difference(bgr[65, :97], bgr[64, :97]) < 6
    assert difference(bgr[:65, 97], bgr[:65, 96]) < 6


RED, GREEN = np.array([50.0, 70, 200]), np.array([60.0, 150, 40])


def coloured_edge(down: bool) -> Image:
    """Red turns into green a third of the way across (or down) the picture."""
    mix = 1 / (1 + np.exp(-(np.arange(96) - 31.7) / 2.5))[:, None]
    image = np.broadcast_to(RED + (GREEN - RED) * mix, (64, 96, 3))
    return np.rint(image.swapaxes(0, 1) if down else image).astype(np.uint8)


def edge_px(image: Image, down: bool) -> float:
    """How far the red reaches, between the colours that the picture's ends have."""
    line = image.mean(axis=1 if down else 0)
    red, green = line[:4].mean(axis=0), line[-4:].mean(axis=0)
    return float((1 - (line - red) @ (green - red) / ((green - red) @ (green - red))).sum())


def shown_px(data: bytes, down: bool) -> float:
    """Where FFmpeg's scaler shows the edge when it interpolates the chroma from where H.264 says it is."""
    (picture,) = decode_one_by_one([data])
    smooth = Interpolation.BILINEAR | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND
    matrix = "ITU709" if picture.colorspace == 1 else "ITU601"
    return edge_px(picture.reformat(
        format="bgr24", src_colorspace=matrix, src_color_range=picture.color_range, dst_color_range=2,
        interpolation=smooth,
    ).to_ndarray(), down)  # fmt: skip


@pytest.mark.parametrize("down", [False, True])
def test_colours_stay_where_they_are(down: bool) -> None:
    image = coloured_edge(down)
    shown = shown_px(H264Encoder(crf=1).encode(BgrFrame(0, 0, image)).data, down)
    assert shown == pytest.approx(edge_px(image, down), abs=0.15)


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("source", ["mjpeg", "turned left", "upside down"])
def test_colours_of_decoded_planes_stay_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, down: bool
) -> None:
    monkeypatch.setattr(media, "picture", lambda *_: coloured_edge(down))
    size = coloured_edge(down).shape[1::-1]
    if source == "mjpeg":
        path = media.video(
            tmp_path / "v.avi", 1, codec="mjpeg", pixel_format="yuvj420p", full_range=True, size=size,
            options={"qmin": "1", "qmax": "1"},
        )  # fmt: skip
    else:
        turn_deg = 90 if source == "turned left" else 180
        path = media.video(tmp_path / "v.mp4", 1, size=size, options={"crf": "1"}, prepare=lambda stream: (
            stream.set_display_rotation(turn_deg)))  # fmt: skip
    with VideoSource(path) as video:
        frame = next(video.frames())
    assert frame.uv_origin_px != (0.0, 0.5)  # type: ignore[attr-defined]
    down ^= source == "turned left"
    assert shown_px(H264Encoder(crf=1).encode(frame).data, down) == pytest.approx(edge_px(frame.full, down), abs=0.15)


def test_another_size_is_refused() -> None:
    encoder = H264Encoder()
    encoder.encode(bgr_frames(1)[0])
    with pytest.raises(UsageError, match="frame 0 is 64x48, the first was 96x64"):
        encoder.encode(bgr_frames(1, (64, 48))[0])


def test_jpeg_is_the_whole_picture() -> None:
    encoded = jpeg_encode(bgr_frames(1)[0])
    assert (encoded.format, encoded.key) == ("jpeg", True)
    image = cv2.imdecode(np.frombuffer(encoded.data, np.uint8), cv2.IMREAD_COLOR)
    assert difference(image, media.picture(0)) < 4


def test_write_video_is_deterministic_and_keeps_its_colours(tmp_path: Path) -> None:
    """At 320 x 240. Of pictures of 96 x 64 libx264 (its mbtree) makes other bytes once in a hundred times."""
    pictures = [np.tile(media.picture(i), (4, 4, 1))[:240, :320] for i in range(6)]
    for name in ("large-a.mp4", "large-b.mp4"):
        assert write_video(tmp_path / name, iter(pictures), Fraction(240000, 1001), crf=5) == 6
    assert (tmp_path / "large-a.mp4").read_bytes() == (tmp_path / "large-b.mp4").read_bytes()
    assert write_video(tmp_path / "a.mp4", (media.picture(i) for i in range(6)), Fraction(240000, 1001), crf=5) == 6
    with VideoSource(tmp_path / "a.mp4") as source:
        assert source.passthrough_reason is None
        for frame in source.frames():
            assert frame.matrix == "bt709"  # type: ignore[attr-defined]
            assert difference(frame.full, media.picture(frame.index)) < 3


def test_write_video_refuses_stamps_it_cannot_hold_and_folders_that_are_not_there(tmp_path: Path) -> None:
    pictures = [media.picture(i) for i in range(3)]
    for stamps in ([0, 5, 5], [0, 5, 3_000_000_000]):
        with pytest.raises(UsageError, match="stamps have to rise"):
            write_video(tmp_path / "v.mp4", pictures, Fraction(30), stamps_ns=stamps)
    with pytest.raises(OutputError, match="cannot be written"):
        write_video(tmp_path / "missing" / "v.mp4", pictures, Fraction(30))
