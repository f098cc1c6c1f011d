"""track --auto: no seed at all."""

import pytest

from clips import COUNT, balls, decoded, rows, seed, write_recording
from scenes import ORANGE, ball_at, picture, truth
from spheremcap.config import load_seeds
from spheremcap.core.circle import Circle
from spheremcap.io import recording
from spheremcap.io.encode import write_video


@pytest.fixture
def described(tmp_path):
    """A settings file that lists markers, each with a colour as TOML or None."""

    def write(more="", **colours):
        tables = [
            f'[[markers]]\nname = "{name}"\n' + (f"colour = {colour}\n" if colour is not None else "")
            for name, colour in colours.items()
        ]
        path = tmp_path / "settings.toml"
        path.write_text(more + "\n" + "\n".join(tables), encoding="utf-8")
        return path

    return write


def seeds_in(path, tmp_path):
    """The seeds that a recording holds, by marker."""
    copy = tmp_path / "inside.toml"
    with path.open("rb") as file:
        from mcap.reader import make_reader

        (text,) = [a.data for a in make_reader(file).iter_attachments() if a.name == "seeds.toml"]
    copy.write_bytes(text)
    return {answer.marker: answer for answer in load_seeds(copy)}


def test_without_settings_the_coloured_spheres_are_tracked_under_their_colours(run, clip, tmp_path):
    out = tmp_path / "out.mcap"
    outcome = run("track", clip, "-o", out, "--auto")
    assert outcome.code == 0, outcome.err
    tracks = recording.open(out).tracks
    assert set(tracks) == {"orange", "blue"}
    for name, ball in (("orange", 0), ("blue", 1)):
        assert f"{name}: {COUNT - 1} verified, 1 seeded" in outcome.out
        for index in (0, COUNT - 1):
            assert Circle(*tracks[name].circle_px[index]).dice(truth(balls(index)[ball])) > 0.9
        assert f"{name} is {name}@0=" in outcome.err
    assert "moves against the background" in outcome.err


def test_what_was_taken_and_why_is_in_the_recording_and_gives_the_same_again(run, clip, tmp_path, described):
    out, again = tmp_path / "out.mcap", tmp_path / "again.mcap"
    settings = described(left='"orange"')
    outcome = run("track", clip, "-o", out, "--auto", "-s", settings)
    assert outcome.code == 0, outcome.err
    assert "left alone: blue@0=" in outcome.err
    inside = seeds_in(out, tmp_path)
    assert set(inside) == {"left"}
    assert inside["left"].author == "auto"
    assert inside["left"].circle.dice(truth(balls(0)[0])) > 0.9
    assert "auto left is left@0=" in run("info", out).out
    logged = [message.message for message in decoded(out)["/log"]]
    assert any(line.startswith("left is left@0=") for line in logged)
    assert run("track", clip, "-o", again, "-s", settings, "--seeds", tmp_path / "inside.toml").code == 0
    assert [row for row in rows(again) if row[0] != "/log"] == [row for row in rows(out) if row[0] != "/log"]
    twice = tmp_path / "twice.mcap"
    assert run("track", clip, "-o", twice, "--auto", "-s", settings).code == 0
    assert twice.read_bytes() == out.read_bytes()


def test_a_range_of_hues_and_the_diameter_are_of_the_markers_that_the_settings_list(run, clip, tmp_path, described):
    out = tmp_path / "out.mcap"
    outcome = run("track", clip, "-o", out, "--auto", "-s", described(wrist="[100, 125]"))
    assert outcome.code == 0, outcome.err
    assert seeds_in(out, tmp_path)["wrist"].circle.dice(truth(balls(0)[1])) > 0.9
    assert run("track", clip, "-o", tmp_path / "b.mcap", "--auto", "--diameter", "38 mm").code == 0
    told = run("info", tmp_path / "b.mcap").out
    assert "marker.blue.diameter_m 0.038" in told


def test_a_marker_that_is_not_there_is_said_and_the_rest_is_tracked(run, clip, tmp_path, described):
    out = tmp_path / "out.mcap"
    outcome = run("track", clip, "-o", out, "--auto", "-s", described(left='"green"', right='"blue"'))
    assert outcome.code == 3
    assert "left (green) was not found in the first 3 s (frames 0 to 15)" in outcome.err
    assert "--seed left@FRAME=X,Y,R" in outcome.err
    whole = recording.open(out)
    assert set(whole.tracks) == {"right"}
    assert "left (green) was not found" in run("info", out).out
    only = run("track", clip, "-o", out, "--auto", "--overwrite", "-s", described(left='"green"'))
    assert (only.code, only.out, only.err.count("\n")) == (2, "", 1)
    assert "nothing that is surely left (green) was found" in only.err


def test_what_looks_alike_is_listed_to_choose_from(run, tmp_path, described):
    video, out = tmp_path / "two.mp4", tmp_path / "out.mcap"
    shown = [
        picture(ball_at(80 + 2 * k, 70, 16, rgb=ORANGE), ball_at(240 - 2 * k, 170, 16, rgb=ORANGE), noise_seed=k)
        for k in range(14)
    ]
    write_video(video, shown, 240)
    settings = described(left='"orange"', right='"orange"')
    outcome = run("track", video, "-o", out, "--auto", "-s", settings)
    assert outcome.code == 2
    assert not out.exists()
    assert "cannot tell which is left, right" in outcome.err
    heading, *lines = outcome.out.splitlines()
    assert heading == "# NAME is one of left, right"
    assert len(lines) == 2
    # What is listed can be given as it stands.
    chosen = [
        line.partition("#")[0].split()[1].replace("NAME", name)
        for line, name in zip(lines, ("left", "right"), strict=True)
    ]
    settled = run("track", video, "-o", out, "--auto", "-s", settings, "--seed", chosen[0], "--seed", chosen[1])
    assert settled.code == 0, settled.err
    assert len(recording.open(out).tracks) == 2
    out.unlink()
    one = run("track", video, "-o", out, "--auto", "-s", settings, "--seed", chosen[0])
    assert one.code == 0, one.err
    circles = {a.circle for a in seeds_in(out, tmp_path).values()}
    assert len({round(c.x_px / 20) for c in circles}) == 2
    alone = run("track", video, "-o", out, "--auto", "--overwrite", "-s", described(left='"orange"'))
    assert alone.code == 2
    assert alone.out.startswith("--seed left@0=")


def test_seconds_are_a_setting(run, clip, tmp_path, described):
    out = tmp_path / "out.mcap"
    outcome = run("track", clip, "-o", out, "--auto", "-s", described("[auto]\nseconds = 0.03", left='"green"'))
    assert outcome.code == 2
    assert "in the first 0.03 s (frames 0 to 7)" in outcome.err


def test_what_cannot_be_is_refused_before_anything_is_looked_at(run, clip, tmp_path, described):
    out = tmp_path / "out.mcap"
    for flags, word in (
        (("--seed", seed("orange")), "--auto beside seeds"),
        (("--seed", seed("orange"), "--diameter", "4 cm"), "--auto beside seeds"),
    ):
        outcome = run("track", clip, "-o", out, "--auto", *flags)
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1)
        assert word in outcome.err
    out.write_text("here")
    outcome = run("track", clip, "-o", out, "--auto")
    assert (outcome.code, outcome.out) == (2, "")
    assert "exists" in outcome.err
    out.unlink()
    missing = run("track", tmp_path / "none.mp4", "-o", out, "--auto")
    assert missing.code == 1
    assert "none.mp4" in missing.err


def test_a_recording_s_one_topic_will_do_but_several_are_one_too_many(run, tmp_path, described):
    log, out = write_recording(tmp_path / "log.mcap", ["/front/image", "/rear/image"]), tmp_path / "out.mcap"
    outcome = run("track", log, "-o", out, "--auto", "--topic", "/front/image", "--topic", "/rear/image")
    assert outcome.code == 2
    assert "--auto looks at one camera" in outcome.err
    outcome = run("track", log, "-o", out, "--auto", "--topic", "/front/image")
    assert outcome.code == 0, outcome.err
    assert set(recording.open(out).tracks) == {"orange", "blue"}


def test_all_seeded_there_is_nothing_to_look_for(run, clip, tmp_path, described):
    out = tmp_path / "out.mcap"
    flags = ("--auto", "-s", described(left='"green"'), "--seed", seed("left"))
    outcome = run("track", clip, "-o", out, *flags)
    assert outcome.code == 0, outcome.err
    assert "left alone" not in outcome.err
