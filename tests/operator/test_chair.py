"""Clicks on the chair: on disk before anybody says so, and an ellipse through a rim's points that shows a wrong one."""

import json
import math
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clips
from spheremcap import api
from spheremcap.config import Settings
from spheremcap.core.camera import Camera
from spheremcap.core.chair import CLICKED, ChairClick
from spheremcap.core.marker import Seed
from spheremcap.errors import OutputError, SettingsError, UsageError
from spheremcap.io.chair_file import chair_toml, load_chair
from spheremcap.io.sources import FromMcap
from spheremcap.operator import answers as room
from spheremcap.operator.chair import ChairFile, fit_rim
from spheremcap.operator.opened import Opened
from spheremcap.operator.page import Page
from spheremcap.operator.words import CLICKED_ON, rim_said

Paged = Callable[..., Page]
STRAIGHT = Camera(1280, 720, 900, 900, 639.5, 359.5)
SMALL = Camera(320, 240, 200, 200, 159.5, 119.5)
BENT = Camera(1280, 720, 700, 700, 639.5, 359.5, "fisheye", (0.05, -0.02, 0.0, 0.0))
AXLE = ChairClick("left_axle", 3, 100.0, 120.0)
FRONT = ChairClick("front", 3, 200.25, 60.5)


def rim_of(camera: Camera, count: int, *, x_m: float = 0.1, on: str = "left_rim") -> list[ChairClick]:
    """Points of a rim of 0.35 m radius, seen at a slant, where the camera projects them exactly."""
    angle = np.radians(np.arange(count) * 360 / count)
    around, side = np.array([0.6, 0.1, 0.8]), np.array([-0.1, 0.98, -0.05])
    side -= around * (around @ side) / (around @ around)
    axes = around / np.linalg.norm(around), side / np.linalg.norm(side)
    places = np.array([x_m, 0.05, 1.2]) + 0.35 * (np.outer(np.cos(angle), axes[0]) + np.outer(np.sin(angle), axes[1]))
    return [ChairClick(on, 0, float(x), float(y)) for x, y in camera.project(places)]


# --- the fit ---


@pytest.mark.parametrize("camera", [STRAIGHT, BENT], ids=["straight", "bent"])
def test_the_points_of_a_circle_are_on_the_ellipse_through_any_lens(camera: Camera) -> None:
    fit = fit_rim(rim_of(camera, 9, x_m=0.6), camera)
    assert fit is not None
    assert max(fit.off_px) < 0.03
    assert fit.doubted is None
    others = rim_of(camera, 50, x_m=0.6)
    near = [min(math.dist((c.x_px, c.y_px), place) for place in fit.outline) for c in others]
    assert max(near) < 4  # the outline's own points are that far from each other
    assert len(fit.outline) == 720


def test_without_the_lens_a_circle_would_not_fit() -> None:
    """So that the test above says something."""
    fit = fit_rim(rim_of(BENT, 9, x_m=0.6), STRAIGHT)
    assert fit is not None
    assert fit.rms_px > 0.5


def test_how_far_a_point_is_off_is_in_pixels_of_the_picture() -> None:
    clicks = [
        ChairClick("left_rim", 0, 300 + 100 * math.cos(k * 0.3), 200 + 100 * math.sin(k * 0.3)) for k in range(21)
    ]
    away = [replace(clicks[0], x_px=clicks[0].x_px + 2.0), *clicks[1:]]
    fit = fit_rim(away, STRAIGHT)
    assert fit is not None
    assert fit.off_px[0] == pytest.approx(2.0, abs=0.6)  # the fit gives way to it a little
    assert fit.rms_px == pytest.approx(math.sqrt(sum(v * v for v in fit.off_px) / 21))
    assert max(fit.off_px[1:]) < 0.6


@pytest.mark.parametrize("count", [7, 8, 12])
def test_the_wrong_one_of_the_points_is_found_though_another_is_farther_off(count: int) -> None:
    worst = set()
    for wrong in range(count):
        clicks = rim_of(STRAIGHT, count)
        clicks[wrong] = replace(clicks[wrong], y_px=clicks[wrong].y_px + 9.0, x_px=clicks[wrong].x_px + 9.0)
        fit = fit_rim(clicks, STRAIGHT)
        assert fit is not None
        if fit.rms_px > 1:
            assert fit.doubted == wrong
            assert fit.rms_without_px is not None
            assert fit.rms_without_px < 0.05
        worst.add(int(np.argmax(fit.off_px)) == wrong)
    assert count > 8 or False in worst


def test_hands_that_click_alike_are_not_doubted() -> None:
    noise = np.random.default_rng(3)
    for _ in range(50):
        clicks = [
            replace(c, x_px=c.x_px + noise.normal(0, 0.5), y_px=c.y_px + noise.normal(0, 0.5))
            for c in rim_of(STRAIGHT, 9)
        ]
        fit = fit_rim(clicks, STRAIGHT)
        assert fit is not None
        assert fit.doubted is None
        assert fit.rms_px < 1


def test_where_there_is_no_ellipse_none_is_made_up() -> None:
    assert fit_rim(rim_of(STRAIGHT, 4), STRAIGHT) is None
    assert fit_rim([], STRAIGHT) is None
    assert fit_rim([ChairClick("left_rim", 0, 50.0, 60.0)] * 6, STRAIGHT) is None
    assert fit_rim([ChairClick("left_rim", 0, 10.0 * k, 20.0 * k) for k in range(6)], STRAIGHT) is None


def test_what_is_said_of_a_rim_says_what_is_missing() -> None:
    fits = {count: fit_rim(rim_of(STRAIGHT, count), STRAIGHT) for count in (5, 6, 7)}
    assert rim_said(0, None) == ""
    assert rim_said(3, None) == "3 of at least 5 points"
    assert "no ellipse" in rim_said(6, None)
    assert "one more" in rim_said(5, fits[5])
    assert "0.0" in rim_said(6, fits[6])
    assert "one more" in rim_said(6, fits[6])
    assert rim_said(7, fits[7]).endswith("off the ellipse (rms)")
    assert set(CLICKED_ON) == set(CLICKED)


# --- the file ---


def test_a_click_is_added_moved_and_taken_out_and_each_is_on_disk(tmp_path: Path) -> None:
    file = ChairFile(tmp_path / "a.chair.toml", 320, 240)
    assert not file.path.exists()
    for now in (AXLE, FRONT, *rim_of(SMALL, 3)):
        before = file.revision
        file.change(None, now)
        assert load_chair(file.path)[0] == file.clicks()
        assert file.revision == before + 1
    moved = replace(AXLE, x_px=101.5)
    file.change(AXLE, moved)
    assert load_chair(file.path)[0][:2] == (moved, FRONT)
    file.change(FRONT, None)
    assert FRONT not in load_chair(file.path)[0]
    file.change(None, moved)  # it is there: another hand was as fast
    assert len(file.clicks()) == 4
    assert load_chair(file.path)[1] == (320, 240)
    assert [p.name for p in tmp_path.iterdir()] == ["a.chair.toml"]


@pytest.mark.parametrize(
    ("was", "now", "word"),
    [
        (FRONT, None, "is not there any more"),
        (None, replace(AXLE, x_px=7.0), "both of left_axle"),
        (None, replace(FRONT, x_px=319.6), "outside the 320x240 picture"),
        (None, replace(FRONT, on="hub"), "expected one of left_axle"),
    ],
)
def test_what_is_refused_changes_nothing(
    tmp_path: Path, was: ChairClick | None, now: ChairClick | None, word: str
) -> None:
    file = ChairFile(tmp_path / "a.chair.toml", 320, 240)
    file.change(None, AXLE)
    before = file.path.read_bytes()
    with pytest.raises(UsageError, match=word):
        file.change(was, now)
    assert (file.path.read_bytes(), file.clicks()) == (before, (AXLE,))


def test_what_another_program_wrote_is_seen_and_kept(tmp_path: Path) -> None:
    one, other = (ChairFile(tmp_path / "a.chair.toml", 320, 240) for _ in range(2))
    one.change(None, AXLE)
    assert other.clicks() == (AXLE,)
    other.change(None, FRONT)
    assert one.clicks() == (AXLE, FRONT)
    one.path.unlink()
    assert other.clicks() == ()


def test_many_at_once_lose_none(tmp_path: Path) -> None:
    files = [ChairFile(tmp_path / "a.chair.toml", 320, 240) for _ in range(3)]

    def give(which: int) -> None:
        for k in range(8):
            files[which].change(None, ChairClick("left_rim", which, float(k), 1.0))

    threads = [threading.Thread(target=give, args=(which,)) for which in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(load_chair(tmp_path / "a.chair.toml")[0]) == 24


def test_a_file_that_cannot_be_written_stays_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = ChairFile(tmp_path / "a.chair.toml", 320, 240)
    file.change(None, AXLE)
    was = file.path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(room.os, "fsync", full)
    with pytest.raises(OutputError, match="free some space"):
        file.change(None, FRONT)
    monkeypatch.undo()
    assert (file.path.read_bytes(), file.clicks()) == (was, (AXLE,))


# --- the page ---


def test_clicks_are_kept_beside_the_video_and_are_there_again(film: Path, paged: Paged) -> None:
    page = paged(film)
    assert page.session()["chair_file"] == "film.chair.toml"
    assert [one["on"] for one in page.session()["clicked"]] == list(CLICKED)
    assert page.chair()["clicks"] == []
    mark = page.pulse()["mark"]
    page.click(None, AXLE)
    assert page.pulse()["mark"] != mark
    mark = page.pulse()["mark"]
    ChairFile(film.parent / "film.chair.toml", 320, 240).change(None, FRONT)  # another program's
    assert page.pulse()["mark"] != mark
    page.click(FRONT, None)
    for click in rim_of(SMALL, 7):
        said = page.click(None, click)
    rim = said["rims"]["left_rim"]
    assert (rim["count"], rim["rms_px"] < 0.05, len(rim["outline"])) == (7, True, 720)
    assert [click["off_px"] is None for click in said["clicks"]] == [True] + [False] * 7
    assert said["rims"]["right_rim"] == {"count": 0, "said": "", "rms_px": None, "outline": []}
    assert json.dumps(said)
    assert paged(film).chair()["clicks"] == said["clicks"]
    assert sorted(p.name for p in film.parent.iterdir()) == ["film.chair.toml", "film.mp4"]


def test_of_five_points_it_is_not_said_that_they_fit(film: Path, paged: Paged) -> None:
    page = paged(film)
    for click in rim_of(SMALL, 5):
        said = page.click(None, click)
    assert said["rims"]["left_rim"]["rms_px"] is None
    assert {click["off_px"] for click in said["clicks"]} == {None}
    assert len(said["rims"]["left_rim"]["outline"]) == 720


def test_the_wrong_point_is_marked_on_the_page(film: Path, paged: Paged) -> None:
    page = paged(film)
    page.click(None, FRONT)
    for k, click in enumerate(rim_of(SMALL, 9, on="right_rim")):
        said = page.click(None, replace(click, x_px=click.x_px + 8.0) if k == 4 else click)
    assert [k for k, click in enumerate(said["clicks"]) if click["doubted"]] == [5]
    assert "without the one that is marked" in said["rims"]["right_rim"]["said"]


def test_what_cannot_be_clicked_is_refused(film: Path, paged: Paged) -> None:
    page = paged(film)
    with pytest.raises(UsageError, match="there is no frame 130: 0 to 129 are there"):
        page.click(None, replace(AXLE, frame_index=130))
    with pytest.raises(UsageError, match="neither was given"):
        page.click(None, None)
    assert not (film.parent / "film.chair.toml").exists()


def test_clicks_on_pictures_of_another_size_are_refused(film: Path, paged: Paged) -> None:
    path = film.parent / "film.chair.toml"
    path.write_text(chair_toml([AXLE], 640, 480))
    with pytest.raises(SettingsError, match="of 640x480, these are of 320x240: move it away"):
        paged(film)


def test_they_are_kept_with_the_answers_and_never_in_the_file_of_the_settings(film: Path, paged: Paged) -> None:
    elsewhere = film.parent / "kept"
    elsewhere.mkdir()
    page = paged(film, seeds=elsewhere / "mine.toml")
    page.click(None, AXLE)
    assert load_chair(elsewhere / "mine.chair.toml")[0] == (AXLE,)
    with pytest.raises(UsageError, match="cannot be kept in one file"):
        paged(film, settings=film.parent / "film.chair.toml")


def test_a_corrected_recording_that_is_opened_goes_on_with_the_same_clicks(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    page.click(None, AXLE)
    page.answer("keep", "wrist", 40, {"to_frame": 49}, None)
    page.write()
    page.work.join(60)
    page.open_written()
    assert page.session()["name"] == "out.2.mcap"
    assert [click["on"] for click in page.chair()["clicks"]] == ["left_axle"]


def test_each_camera_of_a_recording_has_clicks_of_its_own(tmp_path: Path, paged: Paged) -> None:
    log = clips.write_recording(tmp_path / "log.mcap", ["/front/image", "/left/image"])
    first = [Seed(f"{camera}/orange", 0, clips.truth(clips.balls(0)[0])) for camera in ("front", "left")]
    api.track(log, tmp_path / "b.mcap", Settings(), first, mcap=FromMcap(("/front/image", "/left/image")))
    page = paged(tmp_path / "b.mcap")
    page.click(None, AXLE)
    page.choose_camera("left")
    assert page.chair()["clicks"] == []
    page.click(None, FRONT)
    assert load_chair(tmp_path / "b.front.chair.toml")[0] == (AXLE,)
    assert load_chair(tmp_path / "b.left.chair.toml")[0] == (FRONT,)


def test_while_a_run_waits_the_chair_is_not_clicked_and_a_damaged_file_of_it_does_not_stop_it(film: Path) -> None:
    (film.parent / "film.chair.toml").write_text("nonsense")
    with Opened(film, attended=Settings()) as opened:
        page = Page(opened)
        assert page.session()["chair_file"] is None
        assert page.chair() == {"revision": -1, "clicks": [], "rims": page.chair()["rims"]}
        assert page.pulse()["chair"] == -1
        with pytest.raises(UsageError, match="while a run waits"):
            page.click(None, AXLE)
        page.close()
