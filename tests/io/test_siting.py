"""Where chroma lies, by pictures whose chroma was put there."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from spheremcap.io.siting import chroma_place, lies_midway
from spheremcap.io.video import VideoSource
from spheremcap.synth.daylight.electronics import planes420

SIDES = {"left": 0.0, "centre": 0.5}


def patches(seed: int, shape: tuple[int, int] = (480, 640), noise: float = 1.0) -> np.ndarray:
    """A picture of coloured patches with soft edges, and noise of its own in each colour."""
    rng = np.random.default_rng(seed)
    picture = np.full((*shape, 3), 110, np.uint8)
    for _ in range(220):
        x, y = (int(rng.integers(side)) for side in shape[::-1])
        axes = tuple(int(a) for a in rng.integers(6, 40, 2))
        colour = tuple(int(c) for c in rng.integers(20, 235, 3))
        cv2.ellipse(picture, (x, y), axes, float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
    soft = cv2.GaussianBlur(picture, (0, 0), 0.8).astype(np.float64)
    return np.clip(np.rint(soft + rng.normal(0, noise, soft.shape)), 0, 255).astype(np.uint8)


def planes(picture: np.ndarray, siting: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    height, width = picture.shape[:2]
    flat = planes420(picture, siting)
    chroma = flat[height:].reshape(2, height // 2, width // 2)
    return flat[:height], chroma[0], chroma[1]


@pytest.mark.parametrize("siting", SIDES)
def test_chroma_is_found_where_it_was_put(siting):
    for seed in range(6):
        shown = planes(patches(seed), siting)
        place, sd = chroma_place(*shown)
        assert place == pytest.approx(SIDES[siting], abs=0.12)
        assert sd < 0.06
        assert lies_midway(*shown) == (siting == "centre")


def test_rows_may_be_whole_and_sides_odd():
    """4:2:2 has a chroma row for each; an odd picture's last column has no neighbour."""
    y, u, v = planes(patches(1, (960, 640)), "centre")
    assert chroma_place(y[0::2], u, v)[0] == pytest.approx(0.5, abs=0.12)
    assert chroma_place(y[:-1, :-1], u, v)[0] == pytest.approx(0.5, abs=0.12)


def test_a_picture_that_does_not_tell_says_so_and_is_left_alone():
    rng = np.random.default_rng(0)
    gray = np.repeat(patches(0)[..., :1], 3, axis=2)
    noise = rng.integers(0, 256, (480, 640, 3)).astype(np.uint8)
    small = patches(0)[:40, :40]
    tiny = patches(0)[:8, :8]
    for picture in (np.full((480, 640, 3), 90, np.uint8), gray, noise, small, tiny):
        for siting in SIDES:
            shown = planes(picture, siting)
            assert np.isnan(chroma_place(*shown)).all()
            assert not lies_midway(*shown)


def displaced(seed: int, place: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planes whose chroma lies `place` columns right of the left one of its two."""
    picture = patches(seed)
    y, _, _ = planes(picture, "left")
    shift = np.array([[1.0, 0.0, -place], [0.0, 1.0, 0.0]])
    moved = cv2.warpAffine(picture, shift, picture.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    _, u, v = planes(moved, "left")
    return y, u, v


@pytest.mark.parametrize("place", [-0.25, 0.2, 0.3, 0.7])
def test_chroma_between_the_usual_places_is_found_there(place):
    for seed in range(3):
        assert chroma_place(*displaced(seed, place))[0] == pytest.approx(place, abs=0.08)


def test_what_may_as_well_be_the_standard_place_is_taken_for_it():
    """A little more than half-way to the middle, but by less than three deviations."""
    for seed in range(3):
        shown = displaced(seed, 0.266)
        place, sd = chroma_place(*shown)
        assert 0.3 < place < 0.3 + 3 * sd
        assert not lies_midway(*shown)


def film(path: Path, siting: str, said: str | None = None) -> Path:
    """A video of one picture, its chroma as `siting`, and what it says of that."""
    y, u, v = planes(patches(3), siting)
    with av.open(str(path), "w") as container:
        options = {"crf": "12"} | ({"x264-params": f"chromaloc={said}"} if said else {})
        stream = container.add_stream("libx264", rate=Fraction(240), options=options)
        stream.width, stream.height, stream.pix_fmt = y.shape[1], y.shape[0], "yuv420p"
        frame = av.VideoFrame(y.shape[1], y.shape[0], "yuv420p")
        for plane, values in zip(frame.planes, (y, u, v), strict=True):
            rows = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)
            rows[:, : plane.width] = values
        container.mux([*stream.encode(frame), *stream.encode()])
    return path


def test_a_video_that_does_not_say_it_is_read_as_its_first_picture_shows(tmp_path):
    for siting, origin in SIDES.items():
        with VideoSource(film(tmp_path / f"{siting}.mp4", siting)) as source:
            frame = next(source.frames())
            assert frame.uv_origin_px == (origin, 0.5)
            assert ("midway" in source.chroma_note) == (siting == "centre")


def test_what_a_video_says_is_believed(tmp_path):
    """x264's 2 is "topleft": nothing is looked at."""
    with VideoSource(film(tmp_path / "said.mp4", "centre", said="2")) as source:
        assert next(source.frames()).uv_origin_px == (0.0, 0.0)
        assert source.chroma_note == ""
