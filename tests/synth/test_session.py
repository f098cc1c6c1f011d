"""Rendering to a folder: files that agree, the same bytes every time; every scenario builds."""

import csv
import hashlib
import tomllib
from dataclasses import replace

import av
import numpy as np
import pytest

from spheremcap.core.time import ticks_to_ns
from spheremcap.synth import SCENARIOS, TRUTH_COLUMNS, Scene, build, describe, names, render, rendered
from spheremcap.synth.scene import to_yuv420


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    done = []
    folder = tmp_path_factory.mktemp("racing")
    result = render("racing", folder, frames=3, progress=lambda k, n: done.append((k, n)))
    assert done == [(1, 3), (2, 3), (3, 3)]
    return result


def test_same_bytes_again_and_other_bytes_with_another_seed(session, tmp_path):
    def digests(folder):
        return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}

    again = render("racing", tmp_path / "again", frames=3)
    assert digests(again.folder) == digests(session.folder)
    assert set(digests(session.folder)) == {"session.mp4", "truth.csv", "settings.toml", "seeds.toml"}


def test_stamps_in_truth_are_the_containers(session):
    with av.open(str(session.video)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(video=0))
        assert (stream.width, stream.height, stream.codec_context.pix_fmt) == (1280, 720, "yuv420p")
        assert not stream.codec_context.has_b_frames
    stamps = [ticks_to_ns(frame.pts, frame.time_base) for frame in frames]
    rows = list(csv.DictReader(session.truth.open()))
    assert tuple(rows[0]) == TRUTH_COLUMNS
    assert sorted({int(row["stamp_ns"]) for row in rows}) == stamps == [0, 4170833, 8341667]
    assert {row["marker"] for row in rows} == {"left_wrist", "right_wrist"}


def test_decoded_picture_has_the_rendered_colours(session):
    """BT.709 limited range, as it is tagged: a wrong matrix or range would be off by 10 levels or more."""
    with av.open(str(session.video)) as container:
        frame = next(container.decode(video=0))
        assert (int(frame.colorspace), int(frame.color_range)) == (1, 1)
        planes = frame.to_ndarray()
    picture = Scene(build("racing", frames=1)).picture(0)
    expected = to_yuv420(picture)
    assert np.abs(planes.astype(int) - expected).mean() < 3
    y = planes[:720].astype(float).mean()
    grey = picture.astype(float).mean(axis=(0, 1)) @ (0.0722, 0.7152, 0.2126)
    assert y == pytest.approx(16 + grey * 219 / 255, abs=1)


def test_seeds_and_settings_are_readable_and_near_the_truth(session):
    settings = tomllib.loads(session.settings.read_text())
    assert settings["camera"]["fx_px"] == 1150.0
    assert settings["camera"]["model"] == "plumb_bob"
    assert [m["name"] for m in settings["markers"]] == ["left_wrist", "right_wrist"]
    seeds = tomllib.loads(session.seeds_file.read_text())["seeds"]
    truth = {(r["marker"], int(r["frame"])): r for r in csv.DictReader(session.truth.open())}
    for seed, same in zip(seeds, session.seeds, strict=True):
        row = truth[seed["marker"], seed["frame"]]
        assert float(row["visible"]) == 1
        for key in ("x_px", "y_px", "r_px"):
            assert abs(seed[key] - float(row[key])) <= 1.2
            assert seed[key] == getattr(same.circle, key)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_builds_and_has_truth_throughout(name):
    world = build(name, seed=3)
    assert describe(name) == SCENARIOS[name].about
    assert len(world.ticks) == SCENARIOS[name].frames
    assert all(b > a for a, b in zip(world.ticks, world.ticks[1:], strict=False))
    assert world.ticks[0] == 0
    assert len({ball.name for ball in world.markers}) == len(world.markers)
    scene = Scene(world)
    few = [scene.truth(k) for k in range(0, len(scene), 40)]
    assert all(t.circle is not None and 0 <= t.visible <= 1 for truths in few for t in truths)
    assert any(t.visible == 1 for t in few[0])
    assert repr(scene.truth(40)) == repr(Scene(build(name, seed=3)).truth(40))


def test_one_table_has_the_scenarios_of_both_renderers():
    assert names()[: len(SCENARIOS)] == tuple(SCENARIOS)
    assert all(name.startswith("day-") for name in names()[len(SCENARIOS) :])
    assert len(set(names())) == len(names()) > len(SCENARIOS) + 10
    assert isinstance(rendered("clean", frames=2), Scene)
    assert not isinstance(rendered("day-clean", frames=2), Scene)
    for wrong in (describe, rendered):
        with pytest.raises(KeyError):
            wrong("nonesuch")


def test_unknown_scenario_and_no_frames_are_refused():
    with pytest.raises(KeyError):
        build("nonesuch")
    with pytest.raises(ValueError, match="at least 1 frame"):
        build("clean", frames=0)


def test_total_occlusion_lasts_as_long_as_it_says():
    scene = Scene(build("total-occlusion"))
    hidden = [scene.truth(k)[0].visible < 0.01 for k in range(30, 75)]
    assert 4 <= sum(hidden) <= 6


def test_frames_iterates_without_encoding():
    small = replace(build("clean", frames=2))
    pictures = list(Scene(small).frames())
    assert [stamp for _, stamp, _ in pictures] == [0, 4170833]
    assert pictures[0][0].shape == (720, 1280, 3)
    assert pictures[0][0].dtype == np.uint8
