"""spheremcap track as a user runs it: what comes out, and every kind of bad input."""

import os
import resource
import signal
import subprocess
import sys
import time
from fractions import Fraction

import av
import pytest
from test_mcap_images import WRITERS

import spheremcap
from clips import (
    COUNT,
    LATER_NS,
    START_NS,
    STEP_NS,
    decoded,
    pictures,
    rows,
    seed,
    write_clip,
    write_recording,
)
from scenes import CAMERA, ball_at, picture
from spheremcap.config import load_seeds
from spheremcap.core.estimate import Status
from spheremcap.io.encode import write_video

SEEDS = ("--seed", seed("orange"), "--seed", seed("blue", 1))
ONE = ("--seed", seed("orange"))


def refused(outcome, code, output, *words):
    """One line on stderr that has the words, the exit code, and nothing under the final name."""
    assert (outcome.code, outcome.out) == (code, "")
    assert outcome.err.count("\n") == 1, outcome.err
    assert outcome.err.startswith("spheremcap: ")
    for word in words:
        assert str(word) in outcome.err
    assert not output.exists()


def test_a_video_becomes_a_recording(run, clip, tmp_path):
    out = tmp_path / "out.mcap"
    outcome = run("track", clip, "-o", out, *SEEDS)
    assert outcome.code == 0, outcome.err
    assert f"{COUNT} frames -> {out}" in outcome.out
    assert f"orange: {COUNT - 1} verified, 1 seeded" in outcome.out
    assert "no camera given" in outcome.err
    topics = decoded(out)
    assert len(topics["/camera/video"]) == len(topics["/camera/annotations"]) == COUNT
    assert len(topics["/markers/blue/state"]) == COUNT
    assert "/camera/calibration" not in topics
    again = tmp_path / "again.mcap"
    assert run("track", clip, "-o", again, *SEEDS).code == 0
    assert again.read_bytes() == out.read_bytes()


def test_bad_inputs_are_named_and_leave_nothing(run, clip, tmp_path):
    out = tmp_path / "out.mcap"
    text = tmp_path / "text.mp4"
    text.write_text("not a video at all\n" * 50)
    refused(run("track", tmp_path / "none.mp4", "-o", out, *ONE), 1, out, "none.mp4", "no such file")
    refused(run("track", tmp_path / "none.mcap", "-o", out, *ONE), 1, out, "none.mcap", "no such file")
    folder = tmp_path / "folder"
    folder.mkdir()
    refused(run("track", folder, "-o", out, *ONE), 2, out, folder, "folder", "--rate")
    refused(run("track", text, "-o", out, *ONE), 1, out, "text.mp4", "not a video")
    sound = tmp_path / "sound.wav"
    with av.open(str(sound), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame(format="s16", layout="mono", samples=8000)
        frame.rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    refused(run("track", sound, "-o", out, *ONE), 1, out, "sound.wav", "no video stream")
    fake = tmp_path / "fake.mcap"
    fake.write_bytes(b"not an mcap" * 9)
    refused(run("track", fake, "-o", out, *ONE), 1, out, "fake.mcap", "not an MCAP")


def test_bad_seeds_and_settings_are_named_and_leave_nothing(run, clip, tmp_path):
    out = tmp_path / "out.mcap"

    def told(code, *words, flags):
        refused(run("track", clip, "-o", out, *flags), code, out, *words)

    told(2, clip, "orange", "outside the 320x240 picture", flags=("--seed", "orange@0=900,90,18"))
    told(2, clip, "frame 99", f"0 to {COUNT - 1}", flags=("--seed", "orange@99=100,90,18"))
    told(2, "MARKER@FRAME=X,Y,R", flags=("--seed", "orange=100"))
    told(2, "no marker to track", flags=())
    told(2, "unknown camera preset 'gopro'", flags=(*ONE, "--camera", "gopro"))
    told(2, "none.yaml", flags=(*ONE, "--camera", tmp_path / "none.yaml"))
    settings = tmp_path / "s.toml"
    settings.write_text("[output]\nvidoe = 'none'\n")
    told(2, "s.toml", "unknown key 'output.vidoe'", flags=(*ONE, "-s", settings))
    settings.write_text("[[markers]]\nname = 'blue'\n")
    told(2, "'orange'", "settings do not list", flags=(*ONE, "-s", settings))
    told(2, "none.toml", "no such file", flags=("--seeds", tmp_path / "none.toml"))
    seeds = tmp_path / "seeds.toml"
    seeds.write_text("[[seeds]]\nmarker = 'left wrist'\nframe = 0\nx_px = 99\ny_px = 90\nr_px = 18\n")
    told(2, "left wrist", "letters, digits", flags=("--seeds", seeds))
    told(2, "--start-time", "ISO 8601", flags=(*ONE, "--start-time", "noon"))
    told(2, "clip.mp4", "MCAP input", flags=(*ONE, "--topic", "/front/image"))


def test_an_output_that_exists_or_cannot_be_is_refused(run, clip, tmp_path):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"precious")
    outcome = run("track", clip, "-o", out, *ONE)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "out.mcap exists" in outcome.err
    assert out.read_bytes() == b"precious"
    before = clip.read_bytes()
    outcome = run("track", clip, "-o", clip, *ONE, "--overwrite")
    assert outcome.code == 2
    assert "is an input" in outcome.err
    assert clip.read_bytes() == before
    nowhere = tmp_path / "no" / "out.mcap"
    refused(run("track", clip, "-o", nowhere, *ONE), 1, nowhere, nowhere, "no folder")
    assert run("track", clip, "-o", out, *ONE, "--overwrite", "--video", "none").code == 0
    assert decoded(out)


def test_a_truncated_video_keeps_what_could_be_decoded(run, tmp_path):
    whole = write_clip(tmp_path / "whole.mkv")
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 9 // 10])
    out = tmp_path / "out.mcap"
    outcome = run("track", cut, "-o", out, *ONE)
    assert outcome.code == 3, outcome
    assert "cut.mkv" in outcome.err
    states = decoded(out)["/markers/orange/state"]
    assert 3 < len(states) < COUNT
    assert any("cut.mkv" in message.message for message in decoded(out)["/log"])


def test_a_full_disk_is_one_line(run, clip, log, tmp_path):
    out = tmp_path / "out.mcap"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        outcomes = [run("track", source, "-o", out, *ONE) for source in (clip, log)]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    for outcome in outcomes:
        refused(outcome, 1, out, "out.mcap", "File too large")


def test_ctrl_c_leaves_a_readable_part(tmp_path):
    """Interrupted as soon as the first second of the recording is on disk, with most of the clip still to come."""
    count = 2400
    clip = write_clip(tmp_path / "long.mp4", count)
    out, part = tmp_path / "out.mcap", tmp_path / "out.mcap.part"
    later = ("--seed", f"orange@{count - 1}=100,90,18")
    command = [sys.executable, "-m", "spheremcap", "track", str(clip), "-o", str(out), *ONE, *later]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while not part.exists() or part.stat().st_size < 20_000:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 1, stderr
    assert f"they are in {part}" in stderr
    assert "Traceback" not in stderr
    assert not out.exists()
    assert 0 < len(decoded(part)["/markers/orange/state"]) < count


# --- recordings ---


def test_a_recording_is_copied_with_our_channels_beside(run, log, tmp_path):
    out = tmp_path / "out.mcap"
    outcome = run("track", log, "-o", out, *SEEDS)
    assert outcome.code == 0, outcome.err
    found, given = rows(out), rows(log)
    theirs = {row[0] for row in given}
    assert [row for row in found if row[0] in theirs] == given
    topics = decoded(out)
    assert topics.keys() - theirs > {
        "/front/annotations",
        "/markers/orange/state",
        "/markers/blue/pose",
        "/log",
    }
    assert not topics.keys() & {"/front/calibration", "/front/video", "/camera/video"}
    assert len(topics["/front/annotations"]) == COUNT
    for image, annotations in zip(topics["/front/image"], topics["/front/annotations"], strict=True):
        assert image.timestamp.ToNanoseconds() == annotations.timestamp.ToNanoseconds()
    assert {pose.frame_id for pose in topics["/markers/orange/pose"]} == {"cam0"}
    whole = spheremcap.open(out)
    assert whole.damage is None
    assert whole.tracks["orange"].stamp_ns[0] == START_NS
    assert whole.info["image_topic"] == "/front/image"
    with out.open("rb") as file:
        from mcap.reader import make_reader

        reader = make_reader(file)
        assert {"about"} < {record.name for record in reader.iter_metadata()}
        assert "notes.txt" in {record.name for record in reader.iter_attachments()}
    again = tmp_path / "again.mcap"
    assert run("track", log, "-o", again, *SEEDS).code == 0
    assert again.read_bytes() == out.read_bytes()


def test_what_is_copied_can_be_chosen(run, log, tmp_path):
    images, none, encoded = (tmp_path / f"{name}.mcap" for name in ("images", "none", "encoded"))
    assert run("track", log, "-o", images, *ONE, "--copy", "images").code == 0
    topics = decoded(images)
    assert {(t.parent_frame_id, t.child_frame_id) for some in topics["/tf"] for t in some.transforms} == {
        ("cam0", "cam0_debug")
    }
    assert len(topics["/front/image"]) == COUNT
    assert len(topics["/front/camera_info"]) == 1
    assert run("track", log, "-o", none, *ONE, "--copy", "none").code == 0
    topics = decoded(none)
    assert not any(topic.startswith("/front") for topic in topics)
    assert len(topics["/camera/image"]) == COUNT  # the JPEGs as they were
    assert topics["/camera/calibration"][0].K[0] == 600
    assert run("track", log, "-o", encoded, *ONE, "--video", "h264").code == 0
    topics = decoded(encoded)
    assert len(topics["/front/image"]) == len(topics["/front/video"]) == COUNT


def test_time_start_and_end(run, log, tmp_path):
    out = tmp_path / "out.mcap"
    first = START_NS + 6 * STEP_NS
    flags = ("--seed", seed("orange", index=6), "--start", f"{6 * STEP_NS / 1e9:.9f}", "--time", "log")
    end = START_NS + LATER_NS + 12 * STEP_NS
    outcome = run("track", log, "-o", out, *flags, "--end", f"{end // 10**9}.{end % 10**9:09d}")
    assert outcome.code == 0, outcome.err
    track = spheremcap.open(out).tracks["orange"]
    assert track.frame.tolist() == list(range(6, 12))
    assert track.stamp_ns[0] == first + LATER_NS
    assert len(decoded(out)["/front/image"]) == COUNT  # the copy is whole
    late = tmp_path / "late.mcap"
    refused(run("track", log, "-o", late, *ONE, "--start", 0.02), 2, late, log, "frame 0", "starts on frame 5")
    refused(run("track", log, "-o", late, *ONE, "--start", 99), 1, late, log, "asked time")
    refused(run("track", log, "-o", late, *ONE, "--start-time", 5), 2, late, log, "--time")


def test_topics_have_to_be_there_and_be_told_apart(run, log, tmp_path):
    out = tmp_path / "out.mcap"
    outcome = run("track", log, "-o", out, *ONE, "--topic", "/rear/image")
    refused(outcome, 1, out, log, "no topic /rear/image", "/front/image")
    refused(run("track", log, "-o", out, *ONE, "--topic", "/tf"), 1, out, log, "/tf is not an image topic")
    two = write_recording(tmp_path / "two.mcap", ["/left/image", "/right/image"])
    refused(run("track", two, "-o", out, *ONE), 2, out, two, "--topic", "/left/image", "/right/image")
    both = ("--topic", "/left/image", "--topic", "/right/image")
    refused(run("track", two, "-o", out, *ONE, *both), 2, out, "left/orange", "right/orange")
    flags = (*both, "--seed", f"left/{seed('orange')}", "--seed", f"right/{seed('orange')}")
    outcome = run("track", two, "-o", out, *flags, "--seed", f"right/{seed('blue', 1)}")
    assert outcome.code == 0, outcome.err
    assert f"right/blue: {COUNT - 1} verified" in outcome.out
    topics = decoded(out)
    assert len(topics["/left/annotations"]) == len(topics["/right/annotations"]) == COUNT
    assert [row for row in rows(out) if row[0] in {r[0] for r in rows(two)}] == rows(two)
    tracks = spheremcap.open(out).tracks
    assert set(tracks) == {"left/orange", "right/orange", "right/blue"}
    assert (tracks["left/orange"].status == Status.VERIFIED.value).sum() == COUNT - 1


def test_tracking_our_own_output_again_takes_other_topics(run, log, tmp_path):
    once, twice = tmp_path / "once.mcap", tmp_path / "twice.mcap"
    assert run("track", log, "-o", once, *ONE, "--debug-images", "none").code == 0
    outcome = run("track", once, "-o", twice, *ONE, "--debug-images", "none")
    assert outcome.code == 0, outcome.err
    first, second = rows(once), rows(twice)
    assert [row for row in second if row[0] in {r[0] for r in first}] == first
    assert set(spheremcap.open(twice).tracks) == {"orange", "tracked/orange"}


@pytest.fixture
def own_camera(tmp_path):
    settings = tmp_path / "s.toml"
    settings.write_text(
        "[camera]\nwidth_px = 320\nheight_px = 240\nfx_px = 550\nfy_px = 550\ncx_px = 159.5\ncy_px = 119.5\n"
    )
    return settings


def coordinate_frames(topics):
    """Every coordinate frame that any message is in."""
    messages = [message for some in topics.values() for message in some if hasattr(message, "DESCRIPTOR")]
    messages += [entity for scene in topics.get("/scene", []) for entity in scene.entities]
    return {message.frame_id for message in messages if hasattr(message, "frame_id")}


def test_all_is_in_the_coordinate_frame_that_the_pictures_have(run, log, own_camera, tmp_path):
    bare = write_recording(tmp_path / "bare.mcap", ["/front/image"], calibrated=False)
    for number, (source, flags) in enumerate((
        (log, ()), (log, ("-s", own_camera)), (bare, ("-s", own_camera)),
        (log, ("--copy", "images")), (log, ("--copy", "images", "-s", own_camera)),
    )):  # fmt: skip
        out = tmp_path / f"{number}.mcap"
        assert run("track", source, "-o", out, *ONE, *flags).code == 0
        topics = decoded(out)
        assert coordinate_frames(topics) == {"cam0", "cam0_debug"}
        ours = topics.get("/tracked/tf") or topics["/tf"]  # where the camera is stays the input's to say
        assert {(t.parent_frame_id, t.child_frame_id) for some in ours for t in some.transforms} == {
            ("cam0", "cam0_debug")
        }
    nameless = write_recording(tmp_path / "nameless.mcap", ["/front/image"], frame_id="", calibrated=False)
    out = tmp_path / "placed.mcap"
    assert run("track", nameless, "-o", out, *ONE, "-s", own_camera).code == 0
    assert coordinate_frames(decoded(out)) == {"", "front_optical", "front_optical_debug"}
    placed = {(t.parent_frame_id, t.child_frame_id) for some in decoded(out)["/tracked/tf"] for t in some.transforms}
    assert placed == {("world", "front"), ("front", "front_optical"), ("front_optical", "front_optical_debug")}


def test_a_calibration_that_does_not_fit_matters_only_when_it_is_used(run, own_camera, tmp_path):
    wide = write_recording(tmp_path / "wide.mcap", ["/front/image"], calibrated_for=(640, 240))
    out = tmp_path / "out.mcap"
    outcome = run("track", wide, "-o", out, *ONE)
    refused(outcome, 2, out, wide.name, "/front/camera_info", "640x240", "320x240", "another shape")
    assert run("track", wide, "-o", out, *ONE, "-s", own_camera).code == 0
    assert decoded(out)["/front/calibration"][0].K[0] == 550
    larger = write_recording(tmp_path / "larger.mcap", ["/front/image"], calibrated_for=(640, 480))
    assert run("track", larger, "-o", out, *ONE, "--overwrite").code == 0
    assert decoded(out)["/front/calibration"][0].K[0] == pytest.approx(CAMERA.fx_px / 2)


def test_a_recording_without_calibration_gets_ours_and_a_camera_wins(run, log, own_camera, tmp_path):
    bare = write_recording(tmp_path / "bare.mcap", ["/front/image"], calibrated=False)
    out, settings = tmp_path / "out.mcap", own_camera
    assert run("track", bare, "-o", out, *ONE, "-s", settings).code == 0
    topics = decoded(out)
    assert topics["/front/calibration"][0].K[0] == 550
    assert len(topics["/tf"]) == COUNT + 1  # the input's, untouched
    assert "/markers/orange/pose" in topics
    outcome = run("track", log, "-o", out, *ONE, "-s", settings, "--overwrite")
    assert outcome.code == 0
    assert decoded(out)["/front/calibration"][0].K[0] == 550
    outcome = run("track", bare, "-o", out, *ONE, "--overwrite")
    assert "positions in metres are not" in outcome.err


@pytest.mark.parametrize("suffix", [".mcap", ".bin"])
def test_a_damaged_recording_gives_what_can_be_read(run, log, tmp_path, suffix):
    cut = tmp_path / f"cut{suffix}"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    out = tmp_path / "out.mcap"
    outcome = run("track", cut, "-o", out, *ONE)
    assert outcome.code == 3, outcome
    assert all(line.startswith("spheremcap: ") for line in outcome.err.splitlines())
    assert f"{cut}: byte" in outcome.err
    assert 5 < len(decoded(out)["/front/image"]) < COUNT
    assert os.listdir(tmp_path).count("out.mcap.part") == 0


@pytest.mark.parametrize("kind", ["json", "ros2", "ros1"])
def test_recordings_of_other_tools_keep_their_messages_and_name_the_frame(run, tmp_path, kind):
    size = {"width": CAMERA.width_px, "height": CAMERA.height_px}
    f, cx, cy = CAMERA.fx_px, CAMERA.cx_px, CAMERA.cy_px
    lens = size | {"d": [], "k": [f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0], "r": [0.0] * 9, "p": [0.0] * 12}
    calibration = "CameraCalibration" if kind == "json" else "CameraInfo"
    entries = [("/front/camera_info", calibration, lens | {"distortion_model": ""})]
    if kind == "json":
        entries = [("/front/camera_info", calibration, {k.upper() if len(k) == 1 else k: v for k, v in lens.items()})]
    for image in pictures():
        raw = size | {"encoding": "bgr8", "step": 3 * CAMERA.width_px, "data": image.tobytes()}
        if kind == "json":
            entries.append(("/front/image", "RawImage", raw))
        else:
            entries.append(("/front/image", "Image", raw | {"is_bigendian": 0}))
    theirs = WRITERS[kind](tmp_path / "theirs.mcap", entries)
    out = tmp_path / "out.mcap"
    outcome = run("track", theirs, "-o", out, *ONE)
    assert outcome.code == 0, outcome.err
    given = rows(theirs)
    assert [row for row in rows(out) if row[0] in {r[0] for r in given}] == given
    topics = decoded(out)
    assert "/front/calibration" not in topics
    assert {pose.frame_id for pose in topics["/markers/orange/pose"]} == {
        {"json": "c", "ros2": "odd"}.get(kind, "front_optical")
    }


def test_an_operator_on_the_terminal_is_asked_and_answers_go_into_a_seeds_file(run, tmp_path, monkeypatch):
    """A ball that vanishes for good: asked for once, called hidden, and not asked for again."""
    film = tmp_path / "film.mp4"
    shown = [picture(*([ball_at(100, 90, 18)] if k < 12 else []), noise_seed=k) for k in range(60)]
    write_video(film, shown, Fraction(24), creation_time="2025-06-01T10:00:00Z")
    out, words = tmp_path / "out.mcap", ("--seed", "ball@0=100,90,18", "--operator", "terminal")
    read, write = os.pipe()
    os.write(write, b"hidden 12-59\n")
    os.close(write)
    with os.fdopen(read) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        outcome = run("track", film, "-o", out, *words)
    assert outcome.code == 0, outcome
    assert "ball is lost on frame" in outcome.err
    assert f"{out}.ball@12.png" in outcome.err
    assert sorted(tmp_path.iterdir()) == [film, tmp_path / "out.layout.json", out, tmp_path / "out.seeds.toml"]
    first, hidden = load_seeds(tmp_path / "out.seeds.toml")
    assert (first.frame_index, hidden.frame_index, hidden.to_frame_index) == (0, 12, 59)
    assert hidden.time.endswith("Z")
    states = decoded(out)["/markers/ball/state"]
    assert [s.status for s in states[12:]] == [33] * 48
    again = tmp_path / "again.mcap"
    assert run("track", film, "-o", again, "--seeds", tmp_path / "out.seeds.toml").code == 0
    assert again.read_bytes() == out.read_bytes()
    outcome = run("track", film, "-o", out, *words, "--overwrite")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "give it as --seeds" in outcome.err
