"""The page without a browser and without HTTP: what it shows and what it does."""

import json
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import cv2
import media
import pytest
from film import COUNT, SETTINGS, elbow, seeds, wrist

import clips
import spheremcap
from spheremcap import api
from spheremcap.config import Settings, load_seeds, load_settings
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import OperatorRequest
from spheremcap.core.marker import Answer, Hidden, Keep, Seed
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.sources import FromMcap
from spheremcap.operator.opened import Opened, Request
from spheremcap.operator.page import Page, _free
from spheremcap.operator.words import FAILED, asked
from spheremcap.verification.checks import CHECKS

Paged = Callable[..., Page]
TRUE_WRIST = {"x_px": wrist(75).x_px, "y_px": wrist(75).y_px, "r_px": wrist(75).r_px}


def done(page: Page) -> str:
    """Wait for the job; what it said."""
    page.work.join(60)
    assert page.work.job.ended == "done", page.work.job
    return page.work.job.said


def test_a_video_is_opened_with_nothing_beside_it(film: Path, paged: Paged) -> None:
    page = paged(film)
    shown = page.session()
    assert (shown["kind"], shown["first"], shown["last"]) == ("video", 0, COUNT - 1)
    assert (shown["width"], shown["height"]) == (320, 240)
    assert shown["markers"] == []
    assert shown["camera"]["metric"] is False
    assert shown["duration_s"] == pytest.approx((COUNT - 1) / 240, abs=1e-6)
    assert page.lanes() == {"known_to": 0, "revision": -1, "lanes": {}, "requests": []}
    assert json.dumps(page.pulse())
    assert [path.name for path in film.parent.iterdir()] == ["film.mp4"]


def test_a_time_is_the_last_frame_up_to_it(film: Path, paged: Paged) -> None:
    page = paged(film)
    assert [page.frame_at(s) for s in (0, 0.00416, 0.00417, 0.5, 99, -1)] == [0, 0, 1, 120, COUNT - 1, 0]
    assert page.seconds(120) == pytest.approx(0.5)
    assert page.frame_at(page.seconds(77)) == 77
    with pytest.raises(UsageError):
        page.frame_at(float("nan"))


def test_markers_and_circles_go_into_the_files_that_track_reads(film: Path, paged: Paged) -> None:
    page = paged(film)
    page.set_marker("wrist", 0.04, None)
    page.set_marker("elbow", 0.05, None, "blue")
    for seed in seeds():
        circle = dict(zip(("x_px", "y_px", "r_px"), seed.circle, strict=True))
        said = page.answer("circle", seed.marker, 0, circle, None)
    assert said["unwritten"] == 2
    settings, answers = load_settings(film.parent / "film.settings.toml"), load_seeds(film.parent / "film.seeds.toml")
    assert [(m.name, m.diameter_m, m.colour) for m in settings.markers] == [
        ("wrist", 0.04, None), ("elbow", 0.05, "blue"),
    ]  # fmt: skip
    assert [(a.marker, a.frame_index, a.author) for a in answers] == [("wrist", 0, "ada"), ("elbow", 0, "ada")]
    assert answers[0].time.endswith("Z")
    assert len(answers[0].time) == 20
    page.set_marker("upper_arm", 0.05, "elbow")
    assert [m.name for m in load_settings(film.parent / "film.settings.toml").markers] == ["wrist", "upper_arm"]
    assert [a.marker for a in load_seeds(film.parent / "film.seeds.toml")] == ["wrist", "upper_arm"]
    with pytest.raises(UsageError, match="has answers"):
        page.drop_marker("wrist")
    page.take_back("circle", "wrist", 0)
    page.drop_marker("wrist")
    assert [m["name"] for m in page.session()["markers"]] == ["upper_arm"]


@pytest.mark.parametrize(
    ("name", "diameter_m", "word"),
    [("left wrist", 0.04, "letters, digits"), ("../x", 0.04, "letters, digits"), ("", 0.04, "letters"),
     ("wrist", 0.04, "already"), ("new", 7.0, "no marker's size")],
)  # fmt: skip
def test_a_marker_that_cannot_be_is_refused(film: Path, paged: Paged, name: str, diameter_m: float, word: str) -> None:
    page = paged(film)
    page.set_marker("wrist", 0.04, None)
    was = (film.parent / "film.settings.toml").read_bytes()
    with pytest.raises(UsageError, match=word):
        page.set_marker(name, diameter_m, None)
    assert (film.parent / "film.settings.toml").read_bytes() == was


def test_what_else_is_in_the_settings_file_stays(film: Path, paged: Paged) -> None:
    (film.parent / "film.settings.toml").write_text("[session]\nsmoother_lag_frames = 17\n")
    page = paged(film)
    page.set_marker("wrist", 0.04, None)
    assert load_settings(film.parent / "film.settings.toml").session.smoother_lag_frames == 17


def test_a_camera_by_preset_or_by_file_and_what_it_means(tmp_path: Path, paged: Paged) -> None:
    path = media.plain(tmp_path / "a.mp4", 3)  # 96x64: no preset's shape
    page = paged(path)
    with pytest.raises(UsageError, match="another shape"):
        page.set_preset("gopro-hero4-silver-720p-narrow")
    assert not (tmp_path / "a.settings.toml").exists()
    with pytest.raises(UsageError):
        page.set_calibration("image_width: 96\n")
    text = (
        "image_width: 96\nimage_height: 64\ncamera_matrix: {rows: 3, cols: 3, data: [90, 0, 48, 0, 90, 32, 0, 0, 1]}\n"
        "distortion_model: plumb_bob\ndistortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )
    page.set_calibration(text)
    shown = page.session()["camera"]
    assert (shown["metric"], shown["given"]) == (True, True)
    assert load_settings(tmp_path / "a.settings.toml").camera.file == "a.camera_info.yaml"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.camera_info.yaml", "a.mp4", "a.settings.toml"]
    page.set_preset(None)
    assert page.session()["camera"]["metric"] is False


@pytest.mark.parametrize(
    ("kind", "frame", "said", "word"),
    [
        ("circle", COUNT, {"x_px": 10, "y_px": 10, "r_px": 5}, "there is no frame"),
        ("circle", 5, {"x_px": 400, "y_px": 10, "r_px": 5}, "outside the 320x240 picture"),
        ("hidden", 5, {"to_frame": COUNT}, "there is no frame"),
        ("hidden", 0, {"to_frame": 4}, "is hidden from frame"),
        ("nonsense", 5, {"to_frame": 6}, "circle, hidden or keep"),
    ],
)
def test_an_answer_that_cannot_be_is_refused_and_not_written(
    recording: Path, paged: Paged, kind: str, frame: int, said: dict, word: str
) -> None:
    page = paged(recording)
    with pytest.raises(UsageError, match=word):
        page.answer(kind, "wrist", frame, said)
    assert not (recording.parent / "out.seeds.toml").exists()


def test_an_answer_of_a_marker_that_the_recording_has_not_is_refused(recording: Path, paged: Paged) -> None:
    with pytest.raises(UsageError, match="which is not among"):
        paged(recording).answer("circle", "knee", 3, {"x_px": 10, "y_px": 10, "r_px": 5})


def test_a_recording_shows_its_requests_in_words(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    shown = page.session()
    assert (shown["kind"], {m["name"] for m in shown["markers"]}) == ("recording", {"wrist", "elbow"})
    lanes = page.lanes()
    assert lanes["known_to"] == COUNT
    first, second = lanes["requests"]
    assert (first["marker"], first["last_verified"], first["first_unverified"], first["end"]) == ("wrist", 39, 40, 50)
    assert (second["marker"], second["last_verified"], second["first_unverified"]) == ("elbow", 89, 90)
    assert "Where is wrist?" in first["words"]
    assert "no outline was found" in first["words"]
    assert not first["answered"]
    assert [a["written"] for a in page.answers()["answers"]] == [True, True]
    states = page.states(38, 45)["states"]["wrist"]
    assert [shown["statuses"][s[0]] for s in states[:3]] == ["found and verified"] * 2 + ["estimated, not seen"]
    assert page.states(0, 10**9)["states"]["wrist"][-1] is not None


def test_every_check_has_its_words() -> None:
    assert set(CHECKS) | {"covered", "votes", "no outline", "hidden"} <= set(FAILED)
    plain = asked(OperatorRequest("wrist", 4, 0, 9, 0, "did not come back into the picture"))
    assert plain.endswith("Did not come back into the picture.")


def test_hidden_answers_a_request_at_once_and_comes_off_again(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    was = page.lanes()["lanes"]
    said = page.answer("hidden", "wrist", 69, {"to_frame": 40})
    assert load_seeds(recording.parent / "out.seeds.toml")[-1] == Hidden("wrist", 40, 69, "ada", said["saved"]["time"])
    assert said["unwritten"] == 1
    lanes = page.lanes()
    assert lanes["requests"][0]["answered"]
    assert not lanes["requests"][1]["answered"]
    assert page.states(69, 69)["states"]["wrist"][0][4] == ["a person said that it is not to be seen"]
    page.take_back("hidden", "wrist", 40)
    assert page.lanes()["lanes"] == was
    assert not page.lanes()["requests"][0]["answered"]


@pytest.mark.parametrize(
    ("answer", "answered"),
    [
        (Hidden("wrist", 30, 39), False), (Hidden("wrist", 30, 40), True), (Keep("wrist", 49, 60), True),
        (Keep("wrist", 50, 60), False), (Keep("elbow", 40, 49), False),
        (Seed("wrist", 39, Circle(1, 1, 1)), False), (Seed("wrist", 40, Circle(1, 1, 1)), True),
        (Seed("wrist", 49, Circle(1, 1, 1)), True), (Seed("wrist", 50, Circle(1, 1, 1)), False),
    ],
)  # fmt: skip
def test_a_request_is_answered_by_what_is_said_of_its_frames(answer: Answer, answered: bool) -> None:
    """Of the wrist it is not known where it was on the frames 40 to 49."""
    lost = OperatorRequest("wrist", 40, 0, 45, 0, "")
    assert Request(0, lost, 39, 50).answered([answer], COUNT - 1) is answered


def test_keep_answers_a_request_and_changes_nothing(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    was = page.lanes()["lanes"]
    said = page.answer("keep", "elbow", 90, {"to_frame": 109}, "bob")
    assert load_seeds(recording.parent / "out.seeds.toml")[-1] == Keep("elbow", 90, 109, "bob", said["saved"]["time"])
    assert page.lanes()["lanes"] == was
    assert page.lanes()["requests"][1]["answered"]


def test_a_stretch_is_shown_beside_the_old_one_before_anything_is_replaced(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    was, bytes_before = page.lanes()["lanes"], recording.read_bytes()
    page.answer("circle", "wrist", 75, TRUE_WRIST)
    assert page.lanes()["lanes"] == was
    page.track_again("wrist", 75)
    done(page)
    trial = page.trial_shown()
    assert trial["first"] <= 70
    assert trial["last"] == COUNT - 1
    there = page.states(90, 110)
    assert abs(there["trial"][10][1][1] - wrist(100).y_px) < 1
    assert abs(there["states"]["wrist"][10][1][1] - 70) < 1  # the ball that it was taken for
    assert page.lanes()["lanes"] == was
    page.accept()
    assert page.trial_shown() is None
    assert abs(page.states(100, 100)["states"]["wrist"][0][1][1] - wrist(100).y_px) < 1
    assert recording.read_bytes() == bytes_before
    with pytest.raises(UsageError, match="nothing to accept"):
        page.accept()


def test_a_stretch_brings_its_own_requests_in_the_place_of_those_it_stands_over(recording: Path, paged: Paged) -> None:
    """From a circle on frame 30 the elbow is followed over the frames on which it is lost."""
    page = paged(recording)
    was = page.lanes()["requests"]
    page.answer("circle", "elbow", 89, {"x_px": elbow(89).x_px, "y_px": elbow(89).y_px, "r_px": 14})
    page.track_again("elbow", 89)
    done(page)
    page.accept()
    now = page.lanes()["requests"]
    assert [r["marker"] for r in now] == ["wrist", "elbow"]
    assert now[1]["raised"] != was[1]["raised"] or now[1] != was[1]
    page.take_back("circle", "elbow", 89)
    assert page.lanes()["requests"] == was


def test_a_stretch_that_is_discarded_takes_its_answer_back(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    was = page.lanes()["lanes"]
    page.answer("circle", "wrist", 75, TRUE_WRIST)
    page.track_again("wrist", 75)
    done(page)
    back = page.discard()
    assert (back["marker"], back["frame"], back["x_px"]) == ("wrist", 75, TRUE_WRIST["x_px"])
    assert load_seeds(recording.parent / "out.seeds.toml") == seeds()
    assert page.lanes()["lanes"] == was
    with pytest.raises(UsageError, match="no circle of wrist was given on frame 75"):
        page.track_again("wrist", 75)


def test_the_new_recording_is_what_retrack_makes_of_the_same_file_byte_for_byte(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    page.answer("hidden", "wrist", 40, {"to_frame": 69})
    page.answer("circle", "wrist", 75, TRUE_WRIST)
    page.answer("keep", "elbow", 90, {"to_frame": 109})
    page.track_again("wrist", 75)
    done(page)
    first, last = page.trial_shown()["first"], page.trial_shown()["last"]
    shown = [state and state[1] for state in page.states(first, last)["trial"]]
    page.accept()
    page.write()
    assert done(page) == "Wrote out.2.mcap with 2 answers"
    assert page.session()["written"] == "out.2.mcap"
    batch = recording.parent / "batch.mcap"
    api.retrack(recording, batch, load_seeds(recording.parent / "out.seeds.toml"))
    assert (recording.parent / "out.2.mcap").read_bytes() == batch.read_bytes()
    track = spheremcap.open(batch).tracks["wrist"]
    for index, circle in enumerate(shown, first):
        if circle is not None:
            assert track.circle_px[index].tolist() == pytest.approx(circle, abs=2e-3)
    page.open_written()
    page._reading.join(30)
    assert page.session()["name"] == "out.2.mcap"
    assert page.answers()["unwritten"] == 0
    assert page.session()["seeds_file"] == "out.seeds.toml"
    page.answer("hidden", "elbow", 90, {"to_frame": 105})
    assert len(load_seeds(recording.parent / "out.seeds.toml")) == 6
    page.write()
    assert done(page) == "Wrote out.3.mcap with 3 answers"


def test_a_first_run_from_the_page_is_what_track_makes_of_the_same_files(film: Path, paged: Paged) -> None:
    page = paged(film)
    page.set_marker("wrist", 0.04, None)
    circle = dict(zip(("x_px", "y_px", "r_px"), seeds()[0].circle, strict=True))
    page.answer("circle", "wrist", 0, circle)
    page.track()
    with pytest.raises(UsageError, match="wait until this has ended"):
        page.track()
    assert done(page) == f"Tracked {COUNT} frames into film.mcap, with 1 request"
    batch = film.parent / "batch.mcap"
    folder = film.parent
    api.track(
        film, batch, load_settings(folder / "film.settings.toml"), load_seeds(folder / "film.seeds.toml"),
        folder=folder,
    )  # fmt: skip
    assert (folder / "film.mcap").read_bytes() == batch.read_bytes()
    page.open_written()
    assert page.session()["kind"] == "recording"
    assert page.session()["seeds_file"] == "film.seeds.toml"


def test_another_circle_where_the_track_began_is_refused_before_it_is_written(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    elsewhere = {"x_px": 75.0, "y_px": 72.0, "r_px": 16.0}
    with pytest.raises(UsageError, match="on the frame after it"):
        page.answer("circle", "wrist", 0, elsewhere)
    assert page.answers()["unwritten"] == 0
    page.answer("circle", "wrist", 75, elsewhere)
    page.answer("circle", "wrist", 75, elsewhere | {"x_px": 112.5})  # the later one counts
    assert [a["x_px"] for a in page.answers()["answers"] if a["frame"] == 75] == [112.5]


def test_of_a_recording_of_several_cameras_one_is_shown_and_answers_to_the_others_stay(
    tmp_path: Path, paged: Paged
) -> None:
    log = clips.write_recording(tmp_path / "log.mcap", ["/front/image", "/left/image"])
    first = [Seed(f"{camera}/orange", 0, clips.truth(clips.balls(0)[0])) for camera in ("front", "left")]
    api.track(log, tmp_path / "out.mcap", Settings(), first, mcap=FromMcap(("/front/image", "/left/image")))
    page = paged(tmp_path / "out.mcap")
    assert (page.session()["cameras"], page.session()["camera_name"]) == (["front", "left"], "front")
    page.answer("hidden", "orange", 3, {"to_frame": 4})
    shown = page.pulse()["shows"]
    page.choose_camera("left")
    assert page.pulse()["shows"] != shown
    assert [a["marker"] for a in page.answers()["answers"]] == ["orange"]
    assert page.answers()["unwritten"] == 0
    page.answer("hidden", "orange", 6, {"to_frame": 6})
    assert page.states(6, 6)["states"]["orange"][0][4]
    with pytest.raises(UsageError, match="there are front, left"):
        page.choose_camera("right")
    saved = [(a.marker, a.frame_index) for a in load_seeds(tmp_path / "out.seeds.toml")]
    assert sorted(saved) == [("front/orange", 0), ("front/orange", 3), ("left/orange", 0), ("left/orange", 6)]
    page.write()
    assert done(page) == "Wrote out.2.mcap with 2 answers"


def test_a_job_can_be_stopped_and_one_that_fails_says_why(film: Path, paged: Paged) -> None:
    page = paged(film)
    page.set_marker("wrist", 0.04, None)
    page.set_marker("unseeded", 0.04, None)
    circle = dict(zip(("x_px", "y_px", "r_px"), seeds()[0].circle, strict=True))
    page.answer("circle", "wrist", 0, circle)
    page.track()
    page.work.join(60)
    assert page.work.job.ended == "failed"
    assert "'unseeded' has no seed" in page.work.job.said
    page.drop_marker("unseeded")
    page.track()
    page.work.stop()
    page.work.join(60)
    assert page.work.job.ended == "stopped"
    assert page.written is None


def test_answers_that_were_given_before_are_there_when_it_opens_again(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    page.answer("hidden", "wrist", 40, {"to_frame": 69})
    again = paged(recording)
    assert again.answers()["unwritten"] == 1
    assert again.lanes()["requests"][0]["answered"]
    assert again.states(60, 60)["states"]["wrist"][0][4]


def test_two_pages_see_each_others_answers(recording: Path, paged: Paged) -> None:
    one, other = paged(recording), paged(recording)
    one.answer("keep", "wrist", 40, {"to_frame": 49})
    mark = other.pulse()["mark"]
    assert len(other.answers()["answers"]) == 3
    one.answer("keep", "elbow", 90, {"to_frame": 99})
    assert other.pulse()["mark"] != mark


def test_a_log_with_pictures_is_tracked_into_another_file(tmp_path: Path, paged: Paged) -> None:
    path = clips.write_recording(tmp_path / "log.mcap", ["/front/image", "/rear/image"])
    with pytest.raises(UsageError, match="several image topics"):
        Opened(path)
    page = paged(path, topic="/front/image")
    assert page.session()["kind"] == "log"
    assert page.session()["camera"]["metric"]
    page.set_marker("orange", 0.04, None)
    circle = clips.truth(clips.balls(3)[0])
    page.answer("circle", "orange", 3, dict(zip(("x_px", "y_px", "r_px"), circle, strict=True)))
    page.track()
    assert done(page) == "Tracked 16 frames into log.tracked.mcap, with 0 requests"
    page.open_written()
    page._reading.join(30)
    assert page.session()["first"] == 0
    assert page.states(3, 3)["states"]["orange"][0][0] == 1


def test_a_folder_of_pictures_needs_its_rate(tmp_path: Path, paged: Paged) -> None:
    folder = tmp_path / "shots"
    folder.mkdir()
    for number in range(4):
        cv2.imwrite(str(folder / f"p{number:03}.png"), media.picture(number))
    with pytest.raises(UsageError, match="--rate"):
        Opened(folder)
    page = paged(folder, rate=Fraction(50))
    page.set_marker("spot", 0.04, None)
    assert (tmp_path / "shots.settings.toml").exists()


def test_what_the_page_cannot_open_is_said_in_one_line(tmp_path: Path, made: Path) -> None:
    with pytest.raises(SourceError, match="no such file"):
        Opened(tmp_path / "none.mp4")
    bare = tmp_path / "bare.mcap"
    hidden = SETTINGS.model_copy(update={"output": SETTINGS.output.model_copy(update={"video": "none"})})
    api.track(made / "film.mp4", bare, hidden, seeds())
    with pytest.raises(UsageError, match="without its pictures"):
        Opened(bare)


def test_a_snap_says_how_sure_the_circle_is_and_metres_only_of_a_known_marker(
    film: Path, paged: Paged, recording: Path
) -> None:
    page = paged(film)
    frame = page.desk.beside(75).result(10)
    rough = Circle(wrist(75).x_px + 2, wrist(75).y_px - 2, wrist(75).r_px + 1.5)
    snapped = page.snap(frame, rough, "")
    assert abs(snapped.circle.x_px - wrist(75).x_px) < 0.5
    assert snapped.distance_m is None
    begun = time.perf_counter()
    page.snap(frame, rough, "wrist")
    assert time.perf_counter() - begun < 0.5


def test_a_free_name_is_the_next_number(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    names = []
    for _ in range(3):
        path = _free(path)
        names.append(path.name)
        path.touch()
    assert names == ["out.mcap", "out.2.mcap", "out.3.mcap"]
    assert _free(tmp_path / "a.b.mcap").name == "a.b.mcap"


def test_markers_are_proposed_with_a_reason_and_kept_with_their_colour(film: Path, paged: Paged) -> None:
    page = paged(film)
    assert page.proposed() == []
    page.propose()
    assert done(page).endswith("proposed")
    found = page.proposed()
    assert json.dumps(found)
    kinds = {p["colour"] for p in found}
    assert {"orange", "blue"} <= kinds
    for colour, place in (("orange", wrist), ("blue", elbow)):
        one = next(p for p in found if p["colour"] == colour)
        assert one["reason"]
        at = place(one["frame"])
        assert abs(one["circle"][0] - at.x_px) < 1
        page.set_marker(colour, 0.04, None, colour)
    assert [m["colour"] for m in page.session()["markers"]] == ["orange", "blue"]


def test_looking_for_markers_can_be_stopped(film: Path, paged: Paged) -> None:
    page = paged(film)
    page.propose()
    page.work.stop()
    page.work.join(60)
    assert page.work.job.ended == "stopped"
