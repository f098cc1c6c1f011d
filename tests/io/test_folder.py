"""A folder of numbered pictures is a video."""

from fractions import Fraction
from pathlib import Path

import cv2
import media
import numpy as np
import pytest

from spheremcap.errors import SourceError, UsageError
from spheremcap.io.folder import PictureFolder


def write(folder: Path, *names: str, size: tuple[int, int] = (96, 64)) -> Path:
    folder.mkdir(exist_ok=True)
    for index, name in enumerate(names):
        cv2.imwrite(str(folder / name), media.picture(index, *size))
    return folder


def test_pictures_come_in_the_order_of_their_numbers_at_the_stated_rate(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", "f9.png", "f10.png", "f11.png", "f12.png")
    (folder / "Thumbs.db").write_bytes(b"x")
    with PictureFolder(folder, Fraction(240000, 1001), start_time_ns=10**18) as source:
        frames = list(source.frames())
        assert not source.lost
        assert (source.width_px, source.height_px, source.frame_count_hint, source.first_index) == (96, 64, 4, 0)
        assert source.passthrough_reason is not None
        assert [frame.index for frame in frames] == [0, 1, 2, 3]
        assert [frame.stamp_ns - 10**18 for frame in frames] == [0, 4170833, 8341667, 12512500]
        for picture, frame in enumerate(frames):
            np.testing.assert_array_equal(frame.full, media.picture(picture))
        assert len(list(source.frames())) == 4


def test_a_missing_number_is_a_missing_picture_at_its_time(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", "a_0001.png", "a_0002.png", "a_0005.png", "a_0007.png")
    with PictureFolder(folder, Fraction(10)) as source:
        frames = list(source.frames())
    assert [frame.index for frame in frames] == [0, 1, 4, 6]
    assert [frame.stamp_ns for frame in frames] == [0, 10**8, 4 * 10**8, 6 * 10**8]
    assert source.lost
    assert source.lost.lines() == ["3 pictures missing in the numbering (frames 2 to 3, 5)"]


def test_numbers_that_count_in_steps_have_no_gap(tmp_path: Path) -> None:
    with PictureFolder(write(tmp_path / "a", "a0.png", "a10.png", "a20.png"), Fraction(10)) as source:
        assert [frame.index for frame in source.frames()] == [0, 1, 2]
        assert not source.lost


def test_jpeg_pictures_are_handed_on_as_they_are(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", "1.jpg", "2.jpeg", "3.JPG")
    with PictureFolder(folder, Fraction(10)) as source:
        frames = list(source.frames())
        assert (source.passthrough_reason, source.codec) == (None, "jpeg")
    assert [f.encoded.data for f in frames if f.encoded] == [p.read_bytes() for p in sorted(folder.iterdir())]


def test_what_cannot_be_decoded_is_counted_and_what_changes_size_ends_it(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", "1.png", "2.png", "3.png", "4.png")
    (folder / "2.png").write_bytes(b"nothing")
    cv2.imwrite(str(folder / "4.png"), media.picture(0, 32, 16))
    with PictureFolder(folder, Fraction(10)) as source:
        assert [frame.index for frame in source.frames()] == [0, 2]
    lines = "\n".join(source.lost.lines())
    assert "1 picture could not be decoded" in lines
    assert "2.png" in lines
    assert "32x16 at picture 3" in lines


@pytest.mark.parametrize(
    ("names", "error", "words"),
    [
        ([], SourceError, "folder without pictures"),
        (["left_1.png", "right_1.png"], UsageError, "several series"),
        (["a.png"], UsageError, "no number"),
        (["1.png", "01.png"], UsageError, "same number"),
        (["1.png", "1.jpg"], UsageError, "same number"),
    ],
)
def test_folders_that_are_no_video_say_why(
    tmp_path: Path, names: list[str], error: type[Exception], words: str
) -> None:
    folder = write(tmp_path / "a", *names)
    with pytest.raises(error, match=words):
        PictureFolder(folder, Fraction(10))


def test_a_folder_without_one_good_picture_is_an_error(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "1.png").write_bytes(b"nothing")
    with pytest.raises(SourceError, match=r"no picture in it can be decoded: 1 picture.*1\.png"):
        PictureFolder(folder, Fraction(10))
