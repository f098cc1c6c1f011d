"""The public names, and tracking as a function."""

import subprocess
import sys
import threading
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from mcap.writer import Writer

import spheremcap
from clips import COUNT, START_NS, balls, decoded, rows, write_clip, write_recording
from scenes import CAMERA, ball_at, picture, truth
from spheremcap import api
from spheremcap.config import MarkerSettings, Settings
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, Status
from spheremcap.core.marker import Seed
from spheremcap.core.presets import PRESETS
from spheremcap.errors import SourceError
from spheremcap.io.encode import write_video
from spheremcap.io.mcap_images import McapImageSource
from spheremcap.io.mcap_log import McapLog
from spheremcap.io.video import VideoSource
from spheremcap.session import SessionConfig


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("api") / "clip.mp4")


SETTINGS = spheremcap.Settings.model_validate(
    {
        "camera": {
            "width_px": CAMERA.width_px, "height_px": CAMERA.height_px, "fx_px": CAMERA.fx_px,
            "fy_px": CAMERA.fy_px, "cx_px": CAMERA.cx_px, "cy_px": CAMERA.cy_px,
        },
        "output": {"debug_images": "none"},
    }
)  # fmt: skip


def seeds(index: int = 0) -> list[spheremcap.Seed]:
    return [spheremcap.Seed("orange", index, truth(balls(index)[0]))]


def test_importing_costs_nothing_and_every_name_is_there() -> None:
    code = "import spheremcap, sys; assert not {'numpy', 'cv2', 'av', 'mcap'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
    for name in spheremcap.__all__:
        assert getattr(spheremcap, name) is not None
    assert set(spheremcap.__all__) <= set(dir(spheremcap))
    stub = Path(spheremcap.__file__).with_suffix(".pyi").read_text()
    assert all(f" {name} as {name}\n" in stub for name in spheremcap.__all__)
    assert stub.count(" import ") == len(spheremcap.__all__)
    with pytest.raises(AttributeError, match="nonsense"):
        spheremcap.nonsense  # noqa: B018


def test_the_jobs_are_in_one_place() -> None:
    for name in ("track", "merge", "open"):
        assert getattr(api, name) is getattr(spheremcap, name)


def test_merge_is_a_function_whatever_was_imported_before(tmp_path: Path) -> None:
    log = write_recording(tmp_path / "log.mcap", ["/front/image"])
    code = (
        "import sys, spheremcap.merging.clock, spheremcap.api, spheremcap as s;"
        "from types import FunctionType; from pathlib import Path; assert type(s.merge) is FunctionType;"
        "s.merge([s.Source(Path(sys.argv[1]))], sys.argv[2])"
    )
    subprocess.run([sys.executable, "-c", code, log, tmp_path / "one.mcap"], check=True)
    spheremcap.merge([spheremcap.Source(log)], tmp_path / "two.mcap")
    assert rows(tmp_path / "one.mcap") == rows(tmp_path / "two.mcap") == rows(log)


def test_tracking_gives_a_report_and_a_recording_to_read_back(clip: Path, tmp_path: Path) -> None:
    out, told = tmp_path / "out.mcap", []
    report = spheremcap.track(clip, out, SETTINGS, seeds(), progress=lambda *now: told.append(now))
    assert report.complete
    assert (report.frames, report.lost, report.requests) == (COUNT, [], 0)
    assert told == [(k + 1, COUNT) for k in range(COUNT)]
    assert report.statuses["orange"][spheremcap.Status.VERIFIED] == COUNT - 1
    track = spheremcap.open(out).tracks["orange"]
    true = np.array([balls(k)[0].xyz for k in range(COUNT)])
    assert np.abs(track.xyz_cam_m[:, :2] - true[:, :2]).max() < 3e-3
    assert np.abs(track.xyz_cam_m[:, 2] / true[:, 2] - 1).max() < 0.02


def test_stopping_leaves_the_part_and_later_seeds_are_no_error(clip: Path, tmp_path: Path) -> None:
    out, asked = tmp_path / "out.mcap", iter(range(100))
    later = [*seeds(), *seeds(COUNT - 1)]
    report = spheremcap.track(clip, out, SETTINGS, later, stop=lambda: next(asked) >= 5)
    assert report.stopped
    assert not report.complete
    assert report.frames == 5
    assert not out.exists()
    part = tmp_path / "out.mcap.part"
    assert len(spheremcap.open(part).tracks["orange"]) == 5
    assert spheremcap.open(part).info["complete"] == "no"


def test_stopping_a_copy_leaves_what_there_was_up_to_then(tmp_path: Path) -> None:
    log = write_recording(tmp_path / "log.mcap", ["/front/image"])
    asked = iter(range(100))
    spheremcap.track(log, tmp_path / "out.mcap", SETTINGS, seeds(), stop=lambda: next(asked) >= 5)
    part = tmp_path / "out.mcap.part"
    assert not (tmp_path / "out.mcap").exists()
    assert len(spheremcap.open(part).tracks["orange"]) == 5
    assert 0 < sum(row[0] == "/front/image" for row in rows(part)) <= 6


def test_stopping_while_the_rest_is_copied_is_stopping_too(tmp_path: Path) -> None:
    log, long, asked = write_recording(tmp_path / "log.mcap", ["/front/image"]), tmp_path / "long.mcap", iter(range(99))
    with long.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/x", "x", 0)
        for k in range(3000):
            writer.add_message(channel, START_NS + 10**10 + k, b"", k)
        writer.finish()  # type: ignore[no-untyped-call]
    spheremcap.merge([spheremcap.Source(log), spheremcap.Source(long)], tmp_path / "both.mcap", force=True)
    out = tmp_path / "out.mcap"
    report = spheremcap.track(tmp_path / "both.mcap", out, SETTINGS, seeds(), stop=lambda: next(asked) >= COUNT)
    assert (report.stopped, report.frames) == (True, COUNT)
    assert not out.exists()
    assert 900 < sum(row[0] == "/x" for row in rows(tmp_path / "out.mcap.part")) < 1024


def test_an_error_in_the_middle_leaves_no_output_and_a_readable_part(clip: Path, tmp_path: Path) -> None:
    def broken(done: int, total: int | None) -> None:
        if done == 8:
            raise SourceError("the cable is out")

    at_once = SETTINGS.model_copy(update={"session": SessionConfig(smoother_lag_frames=1)})
    with pytest.raises(SourceError, match=r"the cable is out; what was written until then is in .*out\.mcap\.part"):
        spheremcap.track(clip, tmp_path / "out.mcap", at_once, seeds(), progress=broken)
    assert not (tmp_path / "out.mcap").exists()
    assert 4 <= len(spheremcap.open(tmp_path / "out.mcap.part").tracks["orange"]) <= 8


def test_a_wrong_seed_is_told_before_anything_is_written(clip: Path, tmp_path: Path) -> None:
    wrong = [*seeds(), spheremcap.Seed("orange", 8, spheremcap.Circle(900, 90, 18))]
    with pytest.raises(api.UsageError, match=r"clip\.mp4: seed of orange on frame 8"):
        spheremcap.track(clip, tmp_path / "out.mcap", SETTINGS, wrong)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("where", ["reading", "writing"])
def test_nothing_is_decoded_any_more_when_the_file_is_closed(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    threads, closed = threading.active_count(), []

    def broken(*_: object) -> None:
        raise KeyboardInterrupt

    def close(source: VideoSource) -> None:
        closed.append(threading.active_count())
        close_it(source)

    close_it = VideoSource.close
    monkeypatch.setattr(VideoSource, "close", close)
    if where == "writing":
        monkeypatch.setattr(McapLog, "write", broken)
    options = {"progress": broken} if where == "reading" else {}
    at_once = SETTINGS.model_copy(update={"session": SessionConfig(smoother_lag_frames=1)})
    with pytest.raises(KeyboardInterrupt):
        spheremcap.track(clip, tmp_path / "out.mcap", at_once, seeds(), **options)
    assert closed == [threads]


def test_pictures_that_are_encoded_go_with_their_own_frames(clip: Path, tmp_path: Path) -> None:
    settings = SETTINGS.model_copy(update={"output": SETTINGS.output.model_copy(update={"video": "jpeg"})})
    spheremcap.track(clip, tmp_path / "out.mcap", settings, seeds())
    with VideoSource(clip) as video, McapImageSource(tmp_path / "out.mcap") as written:
        for given, found in zip(video.frames(), written.frames(), strict=True):
            assert given.stamp_ns == found.stamp_ns
            assert np.abs(given.full.astype(int) - found.full).mean() < 2.5


def test_the_camera_is_the_settings_then_the_one_beside_the_pictures() -> None:
    beside = spheremcap.Camera(320, 240, 500, 500, 160, 120, source="log.mcap: /front/camera_info")
    resolve = api.resolve_camera
    nothing = spheremcap.Settings().camera
    assert resolve(SETTINGS.camera, 320, 240, Path(), beside)[0].fx_px == CAMERA.fx_px
    camera, metric, note = resolve(nothing, 320, 240, Path(), beside)
    assert camera is beside
    assert metric
    assert "/front/camera_info" in note
    assert not resolve(nothing, 320, 240, Path())[1]
    assert resolve(nothing, 1280, 720, Path())[0] == PRESETS["gopro-hero4-black-720p240-narrow"]
    assert resolve(SETTINGS.camera, 640, 480, Path())[0].fx_px == pytest.approx(2 * CAMERA.fx_px)
    with pytest.raises(api.UsageError, match="another shape"):
        resolve(SETTINGS.camera, 640, 360, Path())


def test_pixels_that_are_not_square_squeeze_the_camera_that_is_for_square_ones() -> None:
    resolve, nothing = api.resolve_camera, spheremcap.Settings().camera
    preset = PRESETS["gopro-hero4-black-720p240-narrow"]
    camera, metric, note = resolve(nothing, 960, 720, Path(), pixel_aspect=4 / 3)
    assert metric
    assert "1.333 times as wide as high" in note
    assert (camera.width_px, camera.height_px) == (960, 720)
    assert camera.fx_px == pytest.approx(preset.fx_px * 3 / 4)
    assert camera.fy_px == preset.fy_px
    named = spheremcap.Settings.model_validate({"camera": {"preset": "gopro-hero4-black-720p240-narrow"}}).camera
    assert resolve(named, 960, 720, Path(), pixel_aspect=4 / 3)[0] == camera
    guess, metric, note = resolve(nothing, 720, 576, Path(), pixel_aspect=16 / 15)
    assert not metric
    assert guess.fy_px == pytest.approx(guess.fx_px * 16 / 15)
    assert "1.067 times" in note
    given = resolve(SETTINGS.camera, 320, 240, Path(), pixel_aspect=4 / 3)[0]  # for the pixels as they are stored
    assert given.fx_px == CAMERA.fx_px


@pytest.mark.parametrize(("stated", "aspect"), [(None, 1.0), (Fraction(4, 3), 4 / 3)])
def test_the_stream_says_what_shape_its_pixels_have(tmp_path: Path, stated: Fraction | None, aspect: float) -> None:
    path = tmp_path / "clip.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 160, 120, "yuv420p"
        if stated is not None:
            stream.codec_context.sample_aspect_ratio = stated
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((120, 160, 3), 90, np.uint8), "bgr24")))
        container.mux(stream.encode(None))
    with VideoSource(path, packets=False) as source:
        assert source.pixel_aspect == pytest.approx(aspect)


@pytest.mark.parametrize(
    ("stated", "late", "aspect"), [(None, 0, 1.5), (Fraction(1), 3, 1.5), (Fraction(4, 3), 0, 4 / 3)]
)
def test_where_the_stream_says_nothing_the_first_seeds_outline_does(
    tmp_path: Path, stated: Fraction | None, late: int, aspect: float
) -> None:
    """What the stream says is not doubted; 1:1 says as little as nothing."""
    ball = ball_at(160, 120, 40)
    wide = cv2.resize(picture(ball), (214, 240), interpolation=cv2.INTER_AREA)
    path, circle = tmp_path / "clip.mp4", truth(ball)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "12"})
        stream.width, stream.height, stream.pix_fmt = 214, 240, "yuv420p"
        if stated is not None:
            stream.codec_context.sample_aspect_ratio = stated
        for k in range(5):
            image = wide if k >= late else np.full_like(wide, 128)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "bgr24")))
        container.mux(stream.encode(None))
    seeds = [Seed("ball", late, Circle(circle.x_px / 1.5, circle.y_px, circle.r_px / 1.5**0.5))]
    with VideoSource(path, packets=False) as source:
        found, by = api.aspect_of(source, seeds)
        assert found == pytest.approx(aspect, rel=0.03)
        assert ("outline of ball's seed" in by) == (aspect == 1.5)
        assert api.aspect_of(source, [])[0] == source.pixel_aspect
        assert sum(1 for _ in source.frames()) == 5  # none of them is gone


def test_a_seed_where_no_outline_shows_is_said(tmp_path: Path) -> None:
    write_video(tmp_path / "clip.mp4", [np.full((64, 96, 3), 90 + k, np.uint8) for k in range(4)], Fraction(240))
    report = api.track(tmp_path / "clip.mp4", tmp_path / "out.mcap", Settings(), [Seed("ball", 1, Circle(40, 30, 8))])
    line = "seed of ball on frame 1: no outline there; is it the marker?"
    assert line in report.notes
    logged = decoded(tmp_path / "out.mcap")["/log"]
    assert any(line in entry.message for entry in logged)


def test_a_recording_that_begins_at_time_zero_can_be_tracked_again(tmp_path):
    pictures = [np.full((64, 96, 3), 90 + k, np.uint8) for k in range(12)]
    write_video(tmp_path / "clip.mp4", pictures, Fraction(240))
    seed = Seed("ball", 0, Circle(40, 30, 8))
    api.track(tmp_path / "clip.mp4", tmp_path / "out.mcap", Settings(), [seed])
    source = McapImageSource(tmp_path / "out.mcap", "/camera/video")
    assert [frame.stamp_ns for frame in source.frames()][:2] == [0, 4166667]
    source.close()


def test_debug_pictures_come_at_once_where_a_doubt_begins_and_are_rare_else():
    settings = Settings(markers=(MarkerSettings(name="a"),))
    keep = api._view_keeper(settings)
    second = 10**9

    def kept(status, start_s, end_s, step=10):
        frames = range(start_s * step, end_s * step)
        return [k / step for k in frames if keep(MarkerEstimate("a", k, k * second // step, status))]

    assert kept(Status.VERIFIED, 0, 41) == [0, 20, 40]
    assert kept(Status.ESTIMATED, 41, 44) == [41, 42, 43]
    assert kept(Status.VERIFIED, 44, 50) == []
    assert kept(Status.LOST, 50, 51) == [50]
    # A status that flickers makes no more pictures than one that stays.
    flickering = [keep(MarkerEstimate("a", k, 60 * second + k * second // 240, (Status.VERIFIED, Status.LOST)[k % 2]))
                  for k in range(480)]  # fmt: skip
    assert sum(flickering) <= 3
