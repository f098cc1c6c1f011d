"""Answers are on disk, whole, before anybody says so; nobody's are lost."""

import os
import threading
from pathlib import Path

import pytest

from spheremcap.config import load_seeds
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Hidden, Keep, Seed
from spheremcap.errors import OutputError, SettingsError, UsageError
from spheremcap.io.output import write_durably
from spheremcap.operator import answers as room
from spheremcap.operator.answers import AnswerFile

FIRST = Seed("wrist", 0, Circle(10, 20, 5))
LATER = Seed("wrist", 40, Circle(11, 21, 5), "ada", "2026-01-02T03:04:05Z")
GONE = Hidden("wrist", 20, 30, "ada", "2026-01-02T03:04:06Z")


def test_what_is_given_stands_until_something_is_answered_and_goes_into_the_file_with_it(tmp_path: Path) -> None:
    path = tmp_path / "a.seeds.toml"
    file = AnswerFile(path, [FIRST])
    assert file.answers() == (FIRST,)
    assert not path.exists()
    file.put(LATER)
    assert load_seeds(path) == [FIRST, LATER]
    assert AnswerFile(path, [GONE]).answers() == (FIRST, LATER)


def test_an_answer_takes_the_place_of_the_one_of_the_same_kind_marker_and_frame(tmp_path: Path) -> None:
    file = AnswerFile(tmp_path / "a.toml", [FIRST, LATER])
    moved = Seed("wrist", 0, Circle(12, 20, 5))
    for answer in (moved, GONE, Keep("wrist", 20, 35), Seed("elbow", 0, Circle(1, 1, 1))):
        file.put(answer)
    assert file.answers() == (moved, LATER, GONE, Keep("wrist", 20, 35), Seed("elbow", 0, Circle(1, 1, 1)))
    longer = Hidden("wrist", 20, 33)
    file.put(longer)
    assert file.answers()[2] == longer


def test_an_answer_that_was_taken_back_is_gone_and_cannot_be_again(tmp_path: Path) -> None:
    file = AnswerFile(tmp_path / "a.toml", [FIRST, GONE])
    assert file.take_back("hidden", "wrist", 20) == GONE
    assert load_seeds(file.path) == [FIRST]
    with pytest.raises(UsageError, match=r"no answer \(hidden\) of wrist on frame 20"):
        file.take_back("hidden", "wrist", 20)
    file.take_back("circle", "wrist", 0)
    assert AnswerFile(file.path, [FIRST]).answers() == ()


def test_what_another_program_wrote_is_seen_and_kept(tmp_path: Path) -> None:
    one, other = (AnswerFile(tmp_path / "a.toml") for _ in range(2))
    one.put(FIRST)
    before = other.revision
    assert other.answers() == (FIRST,)
    assert other.revision == before + 1
    other.put(LATER)
    one.put(GONE)
    assert load_seeds(one.path) == [FIRST, LATER, GONE]
    assert one.answers() == other.answers()


def test_many_at_once_lose_none(tmp_path: Path) -> None:
    files = [AnswerFile(tmp_path / "a.toml") for _ in range(3)]

    def give(which: int) -> None:
        for frame in range(8):
            files[which].put(Seed(f"m{which}", frame, Circle(1, 1, 1)))

    threads = [threading.Thread(target=give, args=(which,)) for which in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(load_seeds(tmp_path / "a.toml")) == 24
    assert [p.name for p in tmp_path.iterdir()] == ["a.toml"]


def test_what_is_refused_changes_nothing(tmp_path: Path) -> None:
    def check(answers: object) -> None:
        if len(answers) > 1:  # type: ignore[arg-type]
            raise UsageError("one is enough")

    file = AnswerFile(tmp_path / "a.toml", [FIRST], check)
    with pytest.raises(UsageError, match="one is enough"):
        file.put(LATER)
    assert file.answers() == (FIRST,)
    assert not file.path.exists()


def test_a_file_that_cannot_be_written_stays_as_it_was_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = AnswerFile(tmp_path / "a.toml")
    file.put(FIRST)
    was = file.path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(room.os, "fsync", full)
    with pytest.raises(OutputError, match="free some space"):
        file.put(LATER)
    monkeypatch.undo()
    assert file.path.read_bytes() == was
    assert file.answers() == (FIRST,)
    assert [p.name for p in tmp_path.iterdir()] == ["a.toml"]


def test_the_file_is_synced_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    sync, rename = os.fsync, Path.replace
    monkeypatch.setattr(room.os, "fsync", lambda fd: done.append("sync") or sync(fd))
    monkeypatch.setattr(Path, "replace", lambda self, to: done.append("rename") or rename(self, to))
    write_durably(tmp_path / "a.toml", "x = 1\n")
    assert done == ["sync", "rename", "sync"]
    assert (tmp_path / "a.toml").read_text() == "x = 1\n"


def test_a_damaged_file_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("[[seeds]]\nmarker = 3\n")
    with pytest.raises(SettingsError, match=r"a\.toml: seed 1 must have"):
        AnswerFile(tmp_path / "a.toml")


def test_a_link_is_replaced_and_what_it_leads_to_is_not_written(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    target = elsewhere / "b.toml"
    AnswerFile(target).put(FIRST)
    was = target.read_bytes()
    (tmp_path / "here").mkdir()
    link = tmp_path / "here" / "a.toml"
    link.symlink_to(target)
    AnswerFile(link).put(LATER)
    assert target.read_bytes() == was
    assert load_seeds(link) == [FIRST, LATER]
    assert not link.is_symlink()


def test_a_marker_is_renamed_in_all_its_answers(tmp_path: Path) -> None:
    file = AnswerFile(tmp_path / "a.toml", [FIRST, GONE, Seed("elbow", 0, Circle(1, 1, 1))])
    file.rename("wrist", "left_wrist")
    assert [a.marker for a in file.answers()] == ["left_wrist", "left_wrist", "elbow"]
    assert file.answers()[1] == Hidden("left_wrist", 20, 30, "ada", "2026-01-02T03:04:06Z")
