"""The same stream gives the same pixels, whether it comes in a video file or in a recording; and still pictures."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import media
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo

from clips import write_messages
from spheremcap.io.encode import H264Encoder
from spheremcap.io.folder import PictureFolder
from spheremcap.io.mcap_images import McapImageSource
from spheremcap.io.picture import DecodedFrame, is_cut_jpeg, is_jpeg, still_image
from spheremcap.io.video import VideoSource

FORMATS = [
    ("libx264", "yuv420p"), ("libx264", "yuvj420p"), ("libx264", "yuv422p"), ("libx264", "yuv444p"),
    ("libx264", "yuv420p10le"), ("libx264", "yuv422p10le"), ("libx264", "yuv444p10le"), ("libx264", "gray"),
    ("libx264", "nv12"), ("libx265", "yuv420p"), ("libx265", "yuv420p10le"), ("libx265", "yuv444p12le"),
    ("libx265", "gbrp"),
]  # fmt: skip
TAGS = {"untagged": None, "bt709": (1, False), "bt601": (6, False), "bt2020": (9, False), "bt709 full": (1, True)}


def packets(codec: str, pixel_format: str, size: tuple[int, int], tags: tuple[int, bool] | None) -> list[bytes]:
    """Annex B access units of three pictures, tagged in the stream itself or not at all."""
    context: Any = av.CodecContext.create(codec, "w")
    context.width, context.height = size
    context.pix_fmt = pixel_format
    context.time_base, context.gop_size = Fraction(1, 30), 2
    context.options = {
        "preset": "ultrafast", "tune": "zerolatency",
        "x264-params": "repeat-headers=1", "x265-params": "log-level=none:repeat-headers=1",
    }  # fmt: skip
    matrix, full = tags or (2, False)
    if tags is not None:
        context.colorspace, context.color_range = matrix, 2 if full else 1
    found: list[bytes] = []
    for index in range(3):
        frame = av.VideoFrame.from_ndarray(media.picture(index, *size), format="bgr24").reformat(format=pixel_format)
        frame.pts = index
        if tags is not None:
            frame.colorspace, frame.color_range = matrix, 2 if full else 1
        found += [bytes(packet) for packet in context.encode(frame)]
    return found + [bytes(packet) for packet in context.encode(None)]


def recording(path: Path, units: list[bytes], format_: str) -> Path:
    return write_messages(path, "/camera/video", [CompressedVideo(format=format_, data=unit) for unit in units])


@pytest.mark.parametrize("tags", TAGS)
@pytest.mark.parametrize("size", [(96, 64), (98, 722)])
@pytest.mark.parametrize(("codec", "pixel_format"), FORMATS)
def test_a_file_and_a_recording_of_one_stream_give_the_same_pixels(
    tmp_path: Path, codec: str, pixel_format: str, size: tuple[int, int], tags: str
) -> None:
    if pixel_format == "gbrp" and tags != "untagged":
        pytest.skip("RGB has no matrix")
    units = packets(codec, pixel_format, size, TAGS[tags])
    format_ = "h264" if codec == "libx264" else "h265"
    bare = tmp_path / f"a.{'h264' if format_ == 'h264' else 'hevc'}"
    bare.write_bytes(b"".join(units))
    with VideoSource(bare) as file, McapImageSource(recording(tmp_path / "a.mcap", units, format_)) as topic:
        ours, theirs = list(file.frames()), list(topic.frames())
        assert (file.width_px, file.height_px) == (topic.width_px, topic.height_px) == size
    assert len(ours) == len(theirs) == 3
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(a.full, b.full)
        assert type(a) is type(b)
        if isinstance(a, DecodedFrame) and isinstance(b, DecodedFrame):
            assert (a.matrix, a.full_range, a.uv_step_px, a.uv_origin_px) == (
                b.matrix, b.full_range, b.uv_step_px, b.uv_origin_px,
            )  # fmt: skip
            if pixel_format != "gray":  # which has neither matrix nor, in H.264, a range that FFmpeg keeps
                matrix = {"untagged": "bt709" if size[1] >= 720 else "bt601"}.get(tags, tags.split()[0])
                assert a.matrix == matrix
                assert a.full_range == (tags == "bt709 full" or "j" in pixel_format)


def test_video_of_a_recording_is_encoded_again_without_going_through_bgr(tmp_path: Path) -> None:
    units = packets("libx264", "yuv420p", (96, 64), (1, False))
    with McapImageSource(recording(tmp_path / "a.mcap", units, "h264")) as topic:
        frames = list(topic.frames())
    encoder = H264Encoder(crf=1)
    encoder.encode(frames[0])
    np.testing.assert_array_equal(encoder._planes(frames[0])[0], frames[0].y)  # type: ignore[attr-defined]
    assert "full" not in frames[0].__dict__


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize("size", [(1, 1), (5, 3), (320, 240)])
def test_still_pictures_are_read_and_cut_ones_refused(suffix: str, size: tuple[int, int]) -> None:
    data = cv2.imencode(suffix, np.full((size[1], size[0], 3), 77, np.uint8))[1].tobytes()
    assert still_image(data).shape == (size[1], size[0], 3)
    assert is_jpeg(data) == (suffix == ".jpg")
    assert not is_cut_jpeg(data)
    assert not is_cut_jpeg(data + b"a trailer of the camera's")
    assert is_cut_jpeg(data[:-5]) == (suffix == ".jpg")
    for cut in (0, 1, 10, 20):
        with pytest.raises(ValueError, match="picture"):
            still_image(data[:cut])


@pytest.mark.parametrize("options", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]])
def test_the_size_of_a_jpeg_is_found_behind_its_other_segments(options: list[int]) -> None:
    from spheremcap.io.picture import _still_size

    data = cv2.imencode(".jpg", np.zeros((50, 70, 3), np.uint8), options)[1].tobytes()
    assert _still_size(data) == (70, 50)
    comment = b"\xff\xfe" + (2 + 300).to_bytes(2, "big") + b"\xff\xc0" * 150  # looks like a frame header, and is none
    assert _still_size(data[:2] + comment + data[2:]) == (70, 50)
    assert still_image(data[:2] + comment + data[2:]).shape == (50, 70, 3)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_a_folder_and_a_recording_of_the_same_stills_give_the_same_pixels(tmp_path: Path, suffix: str) -> None:
    folder = tmp_path / "stills"
    folder.mkdir()
    stills = [cv2.imencode(suffix, media.picture(i))[1].tobytes() for i in range(3)]
    for i, data in enumerate(stills):
        (folder / f"{i}{suffix}").write_bytes(data)
    messages = [CompressedImage(format=suffix[1:], data=data) for data in stills]
    path = write_messages(tmp_path / "a.mcap", "/front/image", messages)
    with PictureFolder(folder, Fraction(30)) as numbered, McapImageSource(path) as topic:
        for a, b in zip(numbered.frames(), topic.frames(), strict=True):
            np.testing.assert_array_equal(a.full, b.full)
