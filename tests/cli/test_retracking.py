"""spheremcap retrack as a user runs it."""

import pytest

import spheremcap
from clips import COUNT, balls, rows, seed
from scenes import truth
from spheremcap.config import seeds_toml


@pytest.fixture(scope="module")
def tracked(clip, tmp_path_factory):
    """The ball goes by the name of the other one: a wrong click."""
    out = tmp_path_factory.mktemp("tracked") / "out.mcap"
    spheremcap.track(clip, out, spheremcap.Settings(), [spheremcap.Seed("orange", 0, truth(balls(0)[1]))])
    return out


def test_a_wrong_click_is_put_right_and_what_was_done_is_said(run, tracked, tmp_path):
    out = tmp_path / "two.mcap"
    outcome = run("retrack", tracked, "--seed", seed("orange", index=8), "-o", out)
    assert (outcome.code, outcome.err) == (0, "")
    assert (
        "orange: frames 1 to 15 by the circle on frame 8 (the circle before, on frame 0; the last frame)" in outcome.out
    )
    assert f"frames tracked again -> {out}\n" in outcome.out
    track = spheremcap.open(out).tracks["orange"]
    assert all(abs(track.circle_px[i][0] - truth(balls(i)[0]).x_px) < 1 for i in range(1, COUNT))


def test_answers_come_from_a_file_and_what_they_say_is_in_info(run, tracked, tmp_path):
    seeds, out = tmp_path / "seeds.toml", tmp_path / "two.mcap"
    told = [
        spheremcap.Seed("orange", 8, truth(balls(8)[0]), "anna", "2026-11-30T09:15:00Z"),
        spheremcap.Hidden("orange", 12, 14, "ben"),
    ]
    seeds.write_text(seeds_toml(told))
    assert run("retrack", tracked, "--seeds", seeds, "-o", out).code == 0
    outcome = run("info", out)
    assert outcome.code == 0
    assert "by the circle on frame 8, anna" in outcome.out
    assert "hidden on frames 12 to 14, ben" in outcome.out
    states = [line for line in outcome.out.splitlines() if line.startswith("/markers/orange/state")]
    assert len(states) == 1
    assert f" {COUNT} " in states[0]
    back = tmp_path / "back.mcap"
    assert run("retrack", out, "-o", back).code == 0
    assert rows(back) == rows(tracked)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--seed", "nose@3=100,90,18"), 2, "'nose', which is not among orange"),
        (("--seed", "orange@99=100,90,18"), 2, "there are frames 0 to 15"),
        (("--seed", "orange@3=1,2"), 2, "2 numbers after =, not 3"),
        (("--seeds", "none.toml"), 2, "none.toml"),
        (("--seed", seed("orange", index=8), "--source", "none.mp4"), 2, "another size, or not there"),
    ],
)
def test_errors_are_one_line(run, tracked, tmp_path, words, code, said):
    outcome = run("retrack", tracked, *words, "-o", tmp_path / "two.mcap")
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (code, "", 1), outcome
    assert said in outcome.err
    assert not list(tmp_path.iterdir())


def test_what_is_no_recording_of_ours_is_one_line(run, clip, log, tmp_path):
    for given in (clip, log, tmp_path / "none.mcap"):
        outcome = run("retrack", given, "--seed", seed("orange"), "-o", tmp_path / "two.mcap")
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (1, "", 1), outcome
