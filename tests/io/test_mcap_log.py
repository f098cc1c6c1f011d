"""Real files, written and read back strictly by the mcap package."""

import errno
import itertools
import math
import resource
import runpy
import sys
from collections import Counter, defaultdict
from pathlib import Path

import av
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from recording_data import CAMERA, MARKERS, PERIOD_NS, START_NS, h264_pictures, result, stamp

from spheremcap.core.estimate import FrameResult, MarkerEstimate, Status
from spheremcap.core.frame import EncodedPicture
from spheremcap.errors import OutputError, UsageError
from spheremcap.io import messages
from spheremcap.io.mcap_log import TRAIL_NS, McapLog, RunInfo
from spheremcap.io.output import LIBRARY
from spheremcap.io.topics import Topics

RUN = RunInfo(
    "session.mp4",
    12_345,
    "ab" * 32,
    "the container's creation time",
    "passed through",
    "[a]\nb = 1\n",
    "# seeds\n",
)
COUNT = 60


def write(path: Path, count: int = COUNT, pictures: list[EncodedPicture] | None = None, **options) -> Path:
    pictures = h264_pictures(count) if pictures is None else pictures
    with McapLog(path, camera=CAMERA, markers=MARKERS, run=RUN, **options) as log:
        log.log("INFO", "start", START_NS)
        log.log("WARNING", "in the middle", stamp(10) + 5)
        log.log("INFO", "after the end", stamp(count) + 7)
        for index in range(count):
            log.write(result(index, view=index == 3), pictures[index] if pictures else None)
    return path


def read(path: Path):
    """All messages as (topic, schema name, message record, decoded), strictly, in the order of the file."""
    with path.open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    assert records
    with path.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = [
            (channel.topic, schema.name, message, decoded)
            for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False)
        ]
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary.statistics.message_count == len(found)
    return found, summary


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return write(tmp_path_factory.mktemp("log") / "out.mcap")


def test_times_sequences_and_schemas_are_as_the_viewers_want_them(recorded):
    found, summary = read(recorded)
    assert [m.log_time for _, _, m, _ in found] == sorted(m.log_time for _, _, m, _ in found)
    assert all(m.log_time == m.publish_time for _, _, m, _ in found)
    sequences = defaultdict(list)
    for topic, _, message, decoded in found:
        sequences[topic].append(message.sequence)
        if "timestamp" in decoded.DESCRIPTOR.fields_by_name:
            assert messages.stamp_of(decoded.timestamp) == message.log_time
    assert all(list(s) == sorted(set(s)) for s in sequences.values())
    assert max(Counter(schema.name for schema in summary.schemas.values()).values()) == 1
    told = {channel.topic: channel.metadata for channel in summary.channels.values() if channel.metadata}
    assert told == {"/camera/calibration": {"focal_sd": "0.03"}}
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
    with recorded.open("rb") as file:
        header = make_reader(file).get_header()
    assert (header.profile, header.library) == ("", LIBRARY)


def test_every_topic_has_what_it_should(recorded):
    found, _ = read(recorded)
    counts = Counter((topic, schema) for topic, schema, _, _ in found)
    measured, posed, voted = COUNT // 2, COUNT * 4 // 6, COUNT * 4 // 6
    wrist = "/markers/left_wrist"
    assert counts["/camera/video", "foxglove.CompressedVideo"] == COUNT
    assert counts["/camera/annotations", "foxglove.ImageAnnotations"] == COUNT
    assert counts[f"{wrist}/state", "spheremcap.MarkerState"] == COUNT
    assert counts[f"{wrist}/votes", "spheremcap.MarkerVotes"] == voted
    assert counts[f"{wrist}/pose", "foxglove.PoseInFrame"] == measured
    assert counts[f"{wrist}/smoothed", "foxglove.PoseInFrame"] == posed
    assert counts[f"{wrist}/debug", "foxglove.CompressedImage"] == 1
    assert counts["/requests", "spheremcap.OperatorRequest"] == COUNT // 6
    assert counts["/log", "foxglove.Log"] == 3
    assert 0.2 * COUNT < counts["/scene", "foxglove.SceneUpdate"] < 0.3 * COUNT
    assert counts["/tf", "foxglove.FrameTransforms"] == counts["/camera/calibration", "foxglove.CameraCalibration"] == 1


def test_annotations_are_in_step_with_the_pictures_and_each_decodes_at_once(recorded):
    found, _ = read(recorded)
    decoder = av.CodecContext.create("h264", "r")
    decoder.flags |= 0x80000  # low delay
    decoder.thread_type = "NONE"
    shown = [messages.stamp_of(d.timestamp) for topic, _, _, d in found if topic == "/camera/annotations"]
    pictures = [d for topic, _, _, d in found if topic == "/camera/video"]
    assert [messages.stamp_of(d.timestamp) for d in pictures] == shown == [stamp(i) for i in range(COUNT)]
    assert all(len(decoder.decode(av.Packet(d.data))) == 1 for d in pictures)


def test_a_file_explains_itself(recorded):
    with recorded.open("rb") as file:
        reader = make_reader(file)
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        attachments = {a.name: a for a in reader.iter_attachments()}
    facts = metadata[f"spheremcap/run/{RUN.id}"]
    assert facts["input_sha256"] == "ab" * 32
    assert facts["time_source"] == "the container's creation time"
    assert facts["camera_source"] == "a test"
    assert facts["marker.left_elbow.diameter_m"] == "0.05"
    assert metadata[f"spheremcap/outcome/{RUN.id}"] == {"complete": "yes"}
    assert attachments["settings.toml"].data == b"[a]\nb = 1\n"
    assert {a.log_time for a in attachments.values()} == {START_NS}


def test_the_same_input_gives_the_same_bytes(recorded, tmp_path):
    assert write(tmp_path / "again.mcap").read_bytes() == recorded.read_bytes()
    assert RUN.id != RunInfo("session.mp4", 12_345, "cd" * 32).id


@pytest.mark.parametrize("compression", ["lz4", "none"])
def test_other_compressions_and_jpeg(compression, tmp_path):
    jpeg = [EncodedPicture(b"\xff\xd8 a jpeg", "jpeg", True)] * 3
    found, _ = read(write(tmp_path / "o.mcap", 3, jpeg, compression=compression, topics=Topics("/left", "/left")))
    assert Counter(topic for topic, *_ in found)["/left/image"] == 3
    assert {topic.split("/")[1] for topic, *_ in found} == {"left"}


def test_calibration_is_repeated_so_that_a_cut_still_has_one(tmp_path):
    with McapLog(tmp_path / "o.mcap", camera=CAMERA, markers=MARKERS) as log:
        for index in range(0, 2000, 100):
            log.write(result(index), None)
    found, _ = read(tmp_path / "o.mcap")
    times = [m.log_time for topic, _, m, _ in found if topic == "/camera/calibration"]
    assert len(times) == math.ceil(2000 * PERIOD_NS / 2.1e9)


def test_a_trail_lasts_a_second_and_is_not_drawn_across_a_loss(tmp_path):
    with McapLog(tmp_path / "o.mcap", camera=CAMERA, markers=MARKERS) as log:
        for index in range(400):
            log.write(result(index, [Status.LOST if 350 <= index < 355 else Status.VERIFIED]), None)
    found, _ = read(tmp_path / "o.mcap")
    last = [d for topic, _, _, d in found if topic == "/scene"][-1].entities[0]
    assert len(last.lines) == 2
    points = list(itertools.chain.from_iterable(line.points for line in last.lines))
    assert 50 < len(points) <= TRAIL_NS / 15e6 + 1
    assert not any(3.5 <= p.x < 3.55 for p in points)


def test_it_refuses_what_exists_and_keeps_it(tmp_path):
    out = tmp_path / "o.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(UsageError, match="exists"):
        McapLog(out, camera=CAMERA, markers=MARKERS)
    assert out.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [out]
    write(out, 2, [], overwrite=True)
    assert read(out)[0]


def test_a_missing_folder_is_said_in_one_line(tmp_path):
    with pytest.raises(OutputError, match="no folder"):
        McapLog(tmp_path / "none/o.mcap", camera=CAMERA, markers=MARKERS)


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_an_interruption_leaves_a_readable_part_and_no_final_name(stop, tmp_path):
    out = tmp_path / "o.mcap"

    def interrupted():
        with McapLog(out, camera=CAMERA, markers=MARKERS, run=RUN) as log:
            for index in range(5):
                log.write(result(index), None)
            raise stop

    with pytest.raises(stop):
        interrupted()
    assert not out.exists()
    found, _ = read(tmp_path / "o.mcap.part")
    assert sum(topic == "/camera/annotations" for topic, *_ in found) == 5


def test_a_full_disk_is_one_line_and_what_fitted_is_readable(tmp_path):
    out = tmp_path / "o.mcap"
    noise = [EncodedPicture(bytes((i * 37 + j * j) % 251 for j in range(70_000)), "jpeg", True) for i in range(5)]

    def fill():
        with McapLog(out, camera=None, markers=MARKERS, compression="none") as log:
            for index in range(100):
                log.write(result(index), noise[index % 5])

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, hard))
    try:
        with pytest.raises(OutputError, match="free some space") as raised:
            fill()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert raised.value.__cause__.errno in (errno.EFBIG, errno.ENOSPC)
    assert "\n" not in str(raised.value)
    assert not out.exists()
    with out.with_name("o.mcap.part").open("rb") as file:
        kept = [c.topic for _, c, _ in NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False)]
    assert kept.count("/camera/image") > 20


def test_stamps_that_go_back_are_kept_and_the_file_stays_in_order(tmp_path):
    with McapLog(tmp_path / "o.mcap", camera=CAMERA, markers=MARKERS) as log:
        for index in (0, 2, 1, 3):
            log.write(result(index), None)
    found, _ = read(tmp_path / "o.mcap")
    assert [m.log_time for _, _, m, _ in found] == sorted(m.log_time for _, _, m, _ in found)
    stamps = [messages.stamp_of(d.timestamp) for topic, _, _, d in found if topic == "/camera/annotations"]
    assert stamps == [stamp(i) for i in (0, 2, 1, 3)]


def test_a_stamp_before_1970_is_refused(tmp_path):
    early = FrameResult(0, -5, (MarkerEstimate("a", 0, -5, Status.LOST),))
    with (
        pytest.raises(UsageError, match="1970"),
        McapLog(tmp_path / "o.mcap", camera=None, markers=[]) as log,
    ):
        log.write(early, None)


def test_an_empty_run_is_a_whole_file(tmp_path):
    with McapLog(tmp_path / "o.mcap", camera=CAMERA, markers=MARKERS, run=RUN):
        pass
    assert read(tmp_path / "o.mcap")[0] == []


def test_two_cameras_go_into_one_writer_that_somebody_else_has_open(tmp_path):
    path = tmp_path / "mine.mcap"
    writer = Writer(str(path))
    writer.start(library="mine")
    own = writer.register_channel("/mine", "json", 0)
    logs = [McapLog(writer, camera=CAMERA, markers=MARKERS, topics=Topics(name, name)) for name in ("/a", "/b")]
    for index in range(6):
        writer.add_message(own, stamp(index), b"{}", stamp(index), index)
        for log in logs:
            log.write(result(index), None)
    for log in logs:
        log.close()
    writer.add_message(own, stamp(6), b"{}", stamp(6), 6)
    writer.finish()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().library == "mine"
        counts = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        schemas = Counter(schema.name for schema in reader.get_summary().schemas.values())
        assert list(reader.iter_metadata()) == []
    assert counts["/mine"] == 7
    assert counts["/a/markers/left_elbow/state"] == counts["/b/markers/left_elbow/state"] == 6
    assert set(schemas.values()) == {1}


def test_the_example_runs(tmp_path, monkeypatch, capsys):
    examples = Path(__file__).parents[2] / "examples"
    out = str(tmp_path / "o.mcap")
    for name in ("write_into_my_mcap.py", "read_back.py"):
        monkeypatch.setattr(sys, "argv", [name, out])
        runpy.run_path(str(examples / name), run_name="__main__")
    assert "front/wrist: 240 frames" in capsys.readouterr().out


def test_the_gravest_line_of_a_stamp_is_its_last(tmp_path):
    path = tmp_path / "a.mcap"
    with McapLog(path, camera=CAMERA, markers=MARKERS) as log:
        for level, text in (("INFO", "a"), ("WARNING", "b"), ("ERROR", "c"), ("INFO", "d"), ("WARNING", "e")):
            log.log(level, text, stamp(0))
        log.write(result(0), None)
    with path.open("rb") as file:
        lines = [Log.FromString(m.data) for _, _, m in make_reader(file).iter_messages(topics=["/log"])]
    assert [line.message for line in lines] == ["a", "d", "b", "e", "c"]


def test_frames_are_written_without_a_camera_too_and_debug_pictures_have_their_own(tmp_path):
    path = tmp_path / "a.mcap"
    with McapLog(path, camera=None, markers=MARKERS) as log:
        log.write(result(0, view=True), None)
    with path.open("rb") as file:
        found = {c.topic: m.data for _, c, m in make_reader(file).iter_messages()}
    edges = {(e.parent_frame_id, e.child_frame_id) for e in FrameTransforms.FromString(found["/tf"]).transforms}
    picture = CompressedImage.FromString(found["/markers/left_wrist/debug"])
    assert ("camera_optical", picture.frame_id) in edges
    assert picture.frame_id == "camera_optical_debug"
