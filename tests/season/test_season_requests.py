"""What a season asks: one list, answers beside the videos, and only their stretches tracked again."""

from pathlib import Path

import pytest
import tomli_w
from seasons import SETTINGS, dataset, write_manifest, write_seeds

from scenes import BLUE, ball_at, picture, truth
from spheremcap.config import load_seeds
from spheremcap.core.marker import Hidden
from spheremcap.errors import SourceError
from spheremcap.io.encode import write_video
from spheremcap.operator.answers import AnswerFile
from spheremcap.season.manifest import load_season
from spheremcap.season.outcome import read_outcome
from spheremcap.season.requests import questions
from spheremcap.season.run import here, run_season


def write_lost(folder: Path) -> dict[str, str]:
    """A ball that is gone for good after ten frames."""
    folder.mkdir()
    ball = lambda k: ball_at(100 + 2 * k, 110, 18, rgb=BLUE)  # noqa: E731
    pictures = [picture(*([ball(k)] if k < 10 else []), noise_seed=k) for k in range(40)]
    write_video(folder / "v.mp4", pictures, 240)
    (folder / "settings.toml").write_text(tomli_w.dumps(SETTINGS))
    x, y, r = truth(ball(0))
    write_seeds(folder / "v.seeds.toml", f"blue@0={x:.0f},{y:.0f},{r:.0f}")
    return {"video": f"{folder.name}/v.mp4", "settings": f"{folder.name}/settings.toml"}


@pytest.fixture
def season(tmp_path):
    manifest = write_manifest(tmp_path, {name: write_lost(tmp_path / name) for name in ("a", "b")})
    out = tmp_path / "out"

    def run():
        found = load_season(manifest)
        with here(2) as submit:
            return run_season(found, found.plans, out, submit)

    run()
    return tmp_path, out, run


def test_questions_are_listed_answered_and_gone(season):
    folder, out, run = season
    asked = questions(out)
    assert [(q.session, q.asked.marker, q.answered) for q in asked] == [("a", "blue", False), ("b", "blue", False)]
    assert 8 <= asked[0].asked.frame <= 14
    listed = dataset("requests", out)
    assert listed.returncode == 0
    assert "a: where is blue on frame" in listed.stdout
    assert f"2 open in 2 sessions; the next one: spheremcap annotate {out}" in listed.stdout

    AnswerFile(asked[0].seeds).put(Hidden("blue", asked[0].asked.frame, 39))
    assert [(q.session, q.answered) for q in questions(out)] == [("a", True), ("b", False)]
    done = run()
    assert done.made == ("a",)
    assert "tracking again ..." in (out / "a" / "log.txt").read_text()
    assert [q.session for q in questions(out)] == ["b"]
    found = read_outcome(out / "a")
    assert found is not None
    assert found.requests[0].answered
    assert len(load_seeds(folder / "a" / "v.seeds.toml")) == 2


def test_an_answer_about_something_else_leaves_the_question_open(season):
    _, out, _ = season
    AnswerFile(questions(out)[0].seeds).put(Hidden("blue", 3, 5))
    assert [(q.session, q.answered) for q in questions(out)] == [("a", False), ("b", False)]


def test_annotate_opens_the_session_that_asks_next(season):
    pytest.importorskip("uvicorn")
    from spheremcap.cli.annotate import _next_question
    from spheremcap.errors import UsageError

    folder, out, _ = season
    recording, seeds, more = _next_question(out, None)
    assert (recording, seeds) == (out / "a" / "session.mcap", folder / "a" / "v.seeds.toml")
    assert "the next of 1 more" in more
    for name in ("a", "b"):
        own = next(q for q in questions(out) if q.session == name)
        AnswerFile(own.seeds).put(Hidden("blue", own.asked.frame, 39))
    with pytest.raises(UsageError, match="nothing is asked"):
        _next_question(out, None)


def test_a_folder_of_something_else_is_said(tmp_path):
    with pytest.raises(SourceError, match="no season was run into it"):
        questions(tmp_path)
