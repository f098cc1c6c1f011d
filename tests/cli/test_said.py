"""What a file says goes to the terminal as text, never as orders to it."""

from mcap.writer import Writer

from spheremcap.cli.said import warn
from spheremcap.io.mcap_records import McapRecords

ORDER = "\x1b[31m"


def test_a_line_is_told_without_what_a_terminal_would_obey(capsys):
    warn(f"no topic {ORDER}/imu\r\u202e")
    assert (
        capsys.readouterr().err
        == "spheremcap: no topic \N{REPLACEMENT CHARACTER}[31m/imu\N{REPLACEMENT CHARACTER}\N{REPLACEMENT CHARACTER}\n"
    )


def test_what_has_several_lines_keeps_them(capsys):
    warn("cannot be read; a mapping to start from:\n[columns]\nx = 1")
    assert capsys.readouterr().err.splitlines()[1:] == ["[columns]", "x = 1"]


def test_a_topic_with_a_line_end_makes_no_second_line(tmp_path):
    path = tmp_path / "odd.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel(f"/camera\n{ORDER}", "protobuf", 0), 1, b"x", 1)
        writer.finish()
    with McapRecords(path) as records:
        (channel,) = records.channels.values()
        records.undecodable(channel.topic, ValueError("not one"))
        (line,) = records.damage()
    assert line.startswith("/camera\N{REPLACEMENT CHARACTER}\N{REPLACEMENT CHARACTER}[31m: 1 message not as")
