"""What is given to `track` and asked of `info` and `config show`."""

import struct
import tomllib

import cv2
import pytest
import tomli_w
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from clips import COUNT, decoded, pictures, seed, write_clip
from spheremcap.config import Settings, load_settings
from spheremcap.core.stage import StageConfig
from spheremcap.io import mcap_records
from spheremcap.io.mcap_records import McapRecords


@pytest.fixture(scope="module")
def tracked(tmp_path_factory, clip):
    from spheremcap.api import track
    from spheremcap.config import parse_seed

    out = tmp_path_factory.mktemp("tracked") / "out.mcap"
    track(clip, out, Settings(), [parse_seed(seed("orange"))])
    return out


# --- track ---


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_a_folder_of_pictures_is_tracked(run, tmp_path, suffix):
    folder = tmp_path / "shot"
    folder.mkdir()
    for index, picture in enumerate(pictures()):
        cv2.imwrite(str(folder / f"frame{index + 8}.{suffix}"), picture, [cv2.IMWRITE_JPEG_QUALITY, 97])
    out = tmp_path / "out.mcap"
    refused = run("track", folder, "-o", out, "--seed", seed("orange"))
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "--rate" in refused.err
    assert not list(tmp_path.glob("out*"))
    flags = ("--rate", "240", "--start-time", "2025-06-01T10:00:00Z")
    done = run("track", folder, "-o", out, "--seed", seed("orange"), *flags)
    assert done.code == 0, done
    assert f"orange: {COUNT - 1} verified" in done.out
    topics = decoded(out)
    assert [s.timestamp.seconds for s in topics["/markers/orange/state"]] == [1748772000] * COUNT
    video = topics["/camera/image" if suffix == "jpg" else "/camera/video"]
    assert len(video) == COUNT
    if suffix == "jpg":
        assert video[3].data == (folder / "frame11.jpg").read_bytes()
    (folder / f"frame12.{suffix}").unlink()
    gap = run("track", folder, "-o", out, "--overwrite", "--seed", seed("orange"), *flags)
    assert gap.code == 3
    assert "1 picture missing in the numbering (frame 4)" in gap.err


def test_the_diameter_of_markers_that_only_seeds_name(run, clip, tmp_path):
    out = tmp_path / "out.mcap"
    given = ("--seed", seed("orange"), "--seed", seed("blue", 1), "--diameter", "38 mm")
    assert run("track", clip, "-o", out, *given).code == 0
    from spheremcap.io import recording

    markers = recording.open(out).settings["markers"]
    assert [(m["name"], m["diameter_m"]) for m in markers] == [("orange", 0.038), ("blue", 0.038)]


def test_a_lost_marker_says_where_it_was_and_what_to_give(run, tmp_path):
    clip = write_clip(tmp_path / "clip.mp4", 40)
    empty = tmp_path / "shot"
    empty.mkdir()
    for index in range(40):
        picture = pictures()[index] if index < 8 else pictures()[0][:, ::-1] * 0
        cv2.imwrite(str(empty / f"{index}.png"), picture)
    assert clip
    outcome = run("track", empty, "--rate", "240", "-o", tmp_path / "o.mcap", "--seed", seed("orange"))
    assert outcome.code == 3
    line = next(line for line in outcome.err.splitlines() if "LOST" in line)
    assert "orange is LOST at the end, last seen on frame 7 at 11" in line
    assert "spheremcap annotate RECORDING" in line


# --- info ---


def test_info_of_a_video_says_all_that_decides_how_it_is_tracked(run, clip, tmp_path):
    shown = run("info", clip)
    assert shown.code == 0
    for words in ("16 frames", "240 frames/s", "320x240 h264 yuv420p", "2025-06-01T10:00:00", "as it is", "not looked"):
        assert words in shown.out, words
    assert "16 frames decoded" in run("info", "--check", clip).out
    import media

    turned = run("info", media.rotated(tmp_path / "turned.mp4", 90))
    assert "turned: shown 270 degrees" in turned.out
    assert "encoded once as H.264" in turned.out
    assert "says no time of its own" in turned.out
    cut = tmp_path / "cut.mkv"
    whole = write_clip(tmp_path / "whole.mkv", 60)
    cut.write_bytes(whole.read_bytes()[:-2000])
    assert run("info", cut).code == 0
    checked = run("info", "--check", cut)
    assert checked.code == 3
    assert "truncated" in checked.err


def test_info_says_the_verified_share_first_and_what_it_did_not_look_into(run, tracked):
    shown = run("info", tracked)
    assert shown.code == 0
    first = f"orange: {(COUNT - 1) / COUNT:.1%} verified of {COUNT} frames (1 seeded, {COUNT - 1} verified), no gap"
    assert shown.out.splitlines()[0] == first
    assert "not looked into" in shown.out
    assert "info --check" in shown.out
    checked = run("info", "--check", tracked)
    assert checked.code == 0
    assert "not looked into" not in checked.out
    assert "every chunk, checksum and message: nothing is damaged" in checked.out


def spoilt(tracked, path, old: bytes, new: bytes):
    """A copy without compression and checksums in which some bytes of the messages are others."""
    with path.open("wb") as file, McapRecords(tracked) as records:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start()
        ids = {}
        for channel in records.channels.values():
            schema = records.schemas[channel.schema_id]
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
        for raw in records.messages():
            data = raw.data.replace(old, new, 1) if raw.channel.topic == "/camera/video" else raw.data
            writer.add_message(ids[raw.channel.id], raw.log_time, data, raw.publish_time, raw.sequence)
        writer.finish()
    return path


def test_only_check_finds_what_is_behind_the_summary(run, tracked, tmp_path):
    path = spoilt(tracked, tmp_path / "spoilt.mcap", b"h264", b"\xff\xfe64")  # no text that protobuf takes
    assert run("info", path).code == 3  # it looks at the first picture of each topic
    topic = "/camera/video: 16 messages not as the schema says"
    assert topic in run("info", "--check", path).err
    data = bytearray(tracked.read_bytes())
    at = data.index(b"\x28\xb5\x2f\xfd")  # the first zstd frame
    data[at + 400] ^= 0xFF
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    checked = run("info", "--check", hurt)
    assert checked.code == 3
    assert "does not decompress" in checked.err or "checksum" in checked.err


def test_fewer_messages_than_the_statistics_say_are_told(run, log, tmp_path):
    with McapRecords(log) as records:
        at = {opcode: offset for opcode, offset, _ in mcap_records._walk(records._read, 8, records._size, print)}
    data = bytearray(log.read_bytes())
    first = at[Opcode.STATISTICS] + 46  # the first channel of the map that says how many messages each has
    channel_id, count = struct.unpack_from("<HQ", data, first)
    struct.pack_into("<Q", data, first + 2, count + 7)
    data[at[Opcode.FOOTER] + 16 : at[Opcode.FOOTER] + 20] = bytes(4)  # no checksum of the summary
    topic = records.channels[channel_id].topic
    path = tmp_path / "fewer.mcap"
    path.write_bytes(data)
    for arguments in (("info", "--check", path), ("merge", path, "-o", tmp_path / "out.mcap")):
        outcome = run(*arguments)
        assert outcome.code == 3, outcome
        assert f"statistics say {count + 7} messages on {topic}, {count} can be read" in outcome.err


# --- config show ---


def keys(model, table=""):
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, StageConfig):
            yield from keys(value, f"{table}.{name}" if table else name)
        elif name != "markers":
            assert field.description, (table, name)
            yield table, name


def test_config_show_lists_every_key_and_takes_a_marker_at_its_end(run, tmp_path):
    shown = run("config", "show").out
    table, found = "", set()
    for line in shown.splitlines():
        if line.startswith("["):
            table = line.strip("[]")
        elif " = " in line or " =" in line:
            found.add((table, line.removeprefix("# ").split(" =")[0]))
    assert found >= set(keys(Settings()))
    assert "# [[markers]]" in shown
    path = tmp_path / "s.toml"
    path.write_text(shown)
    assert load_settings(path) == Settings()
    path.write_text(shown + '\n[[markers]]\nname = "left_wrist"\ndiameter = "4 cm"\n')
    assert [m.name for m in load_settings(path).markers] == ["left_wrist"]
    lines = shown.splitlines()
    table = lines.index("# [[markers]]")
    path.write_text("\n".join(lines[:table] + [line.removeprefix("# ") for line in lines[table:]]))
    assert load_settings(path).markers[0].diameter_m == 0.04


@pytest.mark.parametrize("name", ['C:\\cal\\new "cam".yaml', "a'b\tc.yaml", "ünïcode.yaml"])
def test_what_is_shown_is_read_back_whatever_is_in_it(run, tmp_path, name):
    path = tmp_path / "s.toml"
    path.write_text(
        tomli_w.dumps({"camera": {"file": name}, "markers": [{"name": "a"}, {"name": "b"}]}), encoding="utf-8"
    )
    shown = run("config", "show", path)
    assert tomllib.loads(shown.out)["camera"]["file"] == name
    path.write_text(shown.out, encoding="utf-8")
    assert load_settings(path).camera.file == name
    assert [m.name for m in load_settings(path).markers] == ["a", "b"]
