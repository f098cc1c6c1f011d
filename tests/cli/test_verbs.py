"""The other verbs: info, export, evaluate, experiment, tune, synth, config, and the help of all."""

import json

import pytest
from panel_types import check_layout

from clips import COUNT, seed, write_truth
from spheremcap.config import load_settings

VERBS = (
    "annotate", "calibrate", "track", "retrack", "merge", "sync", "analyse", "info", "layout", "export", "render",
    "plot", "recover", "view", "live",
    "evaluate", "experiment", "synth", "tune", "config", "dataset",
)  # fmt: skip


@pytest.fixture(scope="module")
def tracked(clip, tmp_path_factory):
    import spheremcap

    out = tmp_path_factory.mktemp("tracked") / "out.mcap"
    seeds = [spheremcap.Seed("orange", 0, spheremcap.Circle(100, 90, 18))]
    spheremcap.track(clip, out, spheremcap.Settings(), seeds)
    return out


def test_every_verb_has_help(run):
    listed = run("--help")
    assert listed.code == 0
    for verb in VERBS:
        assert verb in listed.out
        outcome = run(verb, "--help")
        assert outcome.code == 0
        assert "Usage" in outcome.out
    assert run("nonsense").code == 2


def test_evaluate_scores_recordings_and_tables(run, tracked, tmp_path):
    truth = write_truth(tmp_path / "truth.csv")
    outcome = run("evaluate", tracked, "--truth", truth)
    assert outcome.code == 0, outcome.err
    assert "orange" in outcome.out
    table = tmp_path / "tracks.csv"
    assert run("export", tracked, "-o", table).code == 0
    assert run("evaluate", table, "--truth", truth, "--marker", "orange").code == 0
    for arguments, code, word in (
        ((tmp_path / "none.mcap", "--truth", truth), 1, "none.mcap"),
        ((tracked, "--truth", tmp_path / "none.csv"), 1, "none.csv"),
        ((tracked, "--truth", truth, "--marker", "nose"), 2, "there are: orange"),
        ((tracked.with_suffix(".txt"), "--truth", truth), 2, ".csv or .parquet"),
    ):
        outcome = run("evaluate", *arguments)
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (code, "", 1)
        assert word in outcome.err


def test_tune_hough_writes_settings_that_can_be_used(run, clip, tmp_path):
    truth, out = write_truth(tmp_path / "truth.csv"), tmp_path / "tuned.toml"
    flags = ("--truth", truth, "-o", out, "--draws", 4, "--no-grid")
    outcome = run("tune", "hough", clip, *flags)
    assert outcome.code == 0, outcome.err
    assert f"on {2 * COUNT} patches" in outcome.out
    assert 1 <= load_settings(out).chain.hough.dp <= 6
    outcome = run("tune", "hough", clip, *flags)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "exists" in outcome.err


def test_experiments_are_listed_and_unknown_ones_named(run, tmp_path):
    outcome = run("experiment", "list")
    assert outcome.code == 0
    assert "accuracy" in outcome.out
    assert "illumination" in outcome.out
    outcome = run("experiment", "nonsense", "-o", tmp_path / "x")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "accuracy" in outcome.err
    outcome = run("experiment", "accuracy", "-o", tmp_path / "x", "--clips", tmp_path / "none")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)


def test_layout_is_written_by_itself_and_beside_what_track_and_merge_write(run, tracked, clip, tmp_path):
    outcome = run("layout", tracked, "-o", tmp_path / "a.json")
    assert outcome.code == 0, outcome.err
    assert "Import from file" in outcome.out
    check_layout(json.loads((tmp_path / "a.json").read_text()))
    film, merged = tmp_path / "film.mcap", tmp_path / "merged.mcap"
    for arguments, out in ((("track", clip, "--seed", seed("orange")), film), (("merge", film), merged)):
        outcome = run(*arguments, "-o", out)
        assert outcome.code == 0, outcome.err
        assert str(out.with_suffix(".layout.json")) in outcome.out
        check_layout(json.loads(out.with_suffix(".layout.json").read_text()))
    kept = film.with_suffix(".layout.json")
    kept.write_text("mine")
    film.unlink()
    outcome = run("track", clip, "--seed", seed("orange"), "-o", film)
    assert (outcome.code, kept.read_text()) == (0, "mine")
    assert "stays" in outcome.err
    other = tmp_path / "other.mcap"
    assert run("track", clip, "--seed", seed("orange"), "-o", other, "--no-layout").code == 0
    assert not other.with_suffix(".layout.json").exists()


def test_info_and_export(run, tracked, log, tmp_path):
    outcome = run("info", tracked)
    assert outcome.code == 0
    assert "orange" in outcome.out
    assert "/camera/video" in outcome.out
    assert run("info", log).code == 0
    out = tmp_path / "tracks.csv"
    assert run("export", tracked, "-o", out).code == 0
    assert len(out.read_text().splitlines()) == COUNT + 1
    outcome = run("export", tracked, "-o", out)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    outcome = run("export", log, "-o", tmp_path / "none.csv")
    assert (outcome.code, outcome.err.count("\n")) == (1, 1)
    assert "no markers" in outcome.err


def test_config_and_synth(run, tmp_path):
    shown = run("config", "show")
    assert shown.code == 0
    settings = tmp_path / "s.toml"
    settings.write_text(shown.out)
    assert load_settings(settings) == load_settings_default()
    assert "gopro-hero4-black-720p240-narrow" in run("config", "presets").out
    listed = run("synth", "list").out.splitlines()
    assert [line.split()[0] for line in listed if line.startswith(("clean ", "day-clean "))] == ["clean", "day-clean"]
    outcome = run("synth", "nonsense", "-o", tmp_path)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)


def load_settings_default():
    from spheremcap.config import Settings

    return Settings()


def test_a_seed_is_told_apart_from_its_camera():
    from spheremcap.cli.track import _seed

    assert _seed(f"front/{seed('orange')}").marker == "front/orange"
    assert _seed(seed("orange")).marker == "orange"
