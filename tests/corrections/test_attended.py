"""A run that a person attends ends in what the same answers give beforehand."""

import os
import sys
from pathlib import Path

import pytest
from filmed import ANNA, COUNT, FIRST, SETTINGS, covered, seed, spans, wrist, write_film

from clips import rows
from scenes import truth
from spheremcap import api
from spheremcap.config import load_seeds
from spheremcap.core.marker import Hidden, Keep
from spheremcap.errors import UsageError
from spheremcap.operator.answers import AnswerFile
from spheremcap.operator.terminal import Terminal, read_line


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    return write_film(tmp_path_factory.mktemp("attended") / "film.mp4")


class Person:
    """Gives the prepared answers, one list a request; and keeps what was asked."""

    def __init__(self, *answers):
        self.answers, self.asked, self.seen = list(answers), [], []

    def ask(self, asked):
        self.asked.append(asked)
        frame = asked.frame_at(asked.request.frame_index)
        self.seen.append((frame.index, frame.stamp_ns))
        assert asked.frame_at(COUNT - 1).index == COUNT - 1  # what is to come can be looked at too
        assert asked.frame_at(COUNT) is None
        return self.answers.pop(0) if self.answers else []


def attended(film, out, person, first=FIRST, **how):
    markers = tuple(m for m in SETTINGS.markers if m.name in {s.marker for s in first})
    return api.track(film, out, SETTINGS.model_copy(update={"markers": markers}), first, operator=person, **how)


def batch(film, out, answers, first=FIRST):
    markers = tuple(m for m in SETTINGS.markers if m.name in {s.marker for s in first})
    return api.track(film, out, SETTINGS.model_copy(update={"markers": markers}), [*first, *answers])


(BEFORE, OUT), (SECOND, AGAIN) = spans(covered)


def test_who_answers_nothing_gets_the_same_recording_with_its_requests(film, tmp_path):
    person = Person()
    report = attended(film, tmp_path / "asked.mcap", person)
    batch(film, tmp_path / "batch.mcap", [])
    assert (tmp_path / "asked.mcap").read_bytes() == (tmp_path / "batch.mcap").read_bytes()
    requests = api.open(tmp_path / "asked.mcap").requests
    assert [a.request for a in person.asked] == list(requests)
    assert report.requests == len(requests) > 0
    assert person.seen == [(r.frame_index, r.stamp_ns) for r in requests]
    asked = person.asked[0]
    assert asked.now_index == asked.request.raised_at_frame_index
    assert asked.last_measured.frame_index == asked.request.frame_index - 1
    assert asked.estimate.frame_index == asked.request.frame_index


def test_answers_in_the_run_give_what_they_give_beforehand(film, tmp_path):
    """At the first request a person says how long it is hidden, and looks ahead for where it comes out."""
    first = [Hidden("wrist", BEFORE, OUT, **ANNA), seed("wrist", OUT + 10, **ANNA)]
    person = Person(first)
    report = attended(film, tmp_path / "asked.mcap", person)
    batch(film, tmp_path / "batch.mcap", first)
    assert (tmp_path / "asked.mcap").read_bytes() == (tmp_path / "batch.mcap").read_bytes()
    open_ones = [r for r in api.open(tmp_path / "asked.mcap").requests if not r.answered]
    assert len(person.asked) == 1 + len(open_ones)
    assert report.requests == len(open_ones)


def test_it_goes_back_to_the_answer_and_continues_from_there(film, tmp_path):
    """A circle on a frame that has gone by: the marker is followed from it, and asked for where it is lost again."""
    back = [seed("wrist", BEFORE - 8, **ANNA)]
    person = Person(back)
    attended(film, tmp_path / "asked.mcap", person)
    batch(film, tmp_path / "batch.mcap", back)
    assert (tmp_path / "asked.mcap").read_bytes() == (tmp_path / "batch.mcap").read_bytes()


def test_a_marker_that_a_circle_was_given_of_is_asked_for_where_that_is_lost(film, tmp_path):
    """The base is on the decoy all along and never lost; the knee that a person gave goes out of sight."""
    lost_again = []

    class Late(Person):
        def ask(self, asked):
            lost_again.append((asked.request.marker, asked.request.raised_at_frame_index, asked.now_index))
            return super().ask(asked)

    person = Late(
        [seed("wrist", OUT + 10, **ANNA), Hidden("wrist", BEFORE, OUT, **ANNA)], [Keep("wrist", SECOND, AGAIN)]
    )
    attended(film, tmp_path / "asked.mcap", person)
    assert all(marker == "wrist" and raised == now for marker, raised, now in lost_again)
    assert len(lost_again) == len({raised for _, raised, _ in lost_again})


def test_answers_that_cannot_be_are_told_to_who_gave_them(film, tmp_path):
    refused = []

    class Wrong(Person):
        def ask(self, asked):
            for answers in ([seed("wrist", 0)], [Hidden("nose", 1, 2)], [Hidden("wrist", 0, 9)]):
                with pytest.raises(UsageError) as error:
                    asked.check(answers)
                refused.append(str(error.value))
            return super().ask(asked)

    attended(film, tmp_path / "asked.mcap", Wrong())
    assert "already" in refused[0]
    assert "'nose'" in refused[1]
    assert "hidden from frame 0 to 9" in refused[2]


# -- on the terminal -------------------------------------------------------------------------------


class Alone:
    def __init__(self):
        self.inside = False

    def __call__(self):
        return self

    def __enter__(self):
        self.inside = True

    def __exit__(self, *_):
        self.inside = False


def terminal(folder, lines, said, alone=None):
    alone = alone or Alone()
    rest = iter(lines)

    def hear():
        assert alone.inside
        return next(rest, None)

    answers = AnswerFile(folder / "seeds.toml")
    for one in FIRST:
        answers.put(one)
    return Terminal(answers, folder / "out.mcap", "anna", alone, hear, said.append, lambda: ANNA["time"])


def test_the_terminal_names_pictures_and_writes_answers_down_before_going_on(film, tmp_path):
    c = truth(wrist(OUT + 10))
    shown = []

    class Looking(list):
        def append(self, line):
            super().append(line)
            path = line.rpartition(": ")[2]
            if path.endswith(".png"):
                shown.append(Path(path).read_bytes())

    said = Looking()
    lines = ["what?", f"see {OUT + 10}", "see 999", f"900,{c.y_px},{c.r_px}", f"{c.x_px:.1f},{c.y_px:.1f},{c.r_px:.1f}"]
    person = terminal(tmp_path, lines, said)
    attended(film, tmp_path / "out.mcap", person)
    given = load_seeds(tmp_path / "seeds.toml")
    assert given[:3] == FIRST
    (answer,) = given[3:]
    assert (answer.marker, answer.frame_index, answer.author, answer.time) == ("wrist", OUT + 10, "anna", ANNA["time"])
    assert len(shown) >= 3
    assert all(picture.startswith(b"\x89PNG") for picture in shown)
    assert not list(tmp_path.glob("*.png"))
    told = "\n".join(said)
    assert "wrist is lost on frame" in told
    assert "'what?' is no answer" in told
    assert "there is no frame 999" in told
    assert "outside the 320x240 picture" in told
    batch(film, tmp_path / "batch.mcap", [answer])
    assert rows(tmp_path / "out.mcap") == rows(tmp_path / "batch.mcap")


@pytest.mark.parametrize(
    ("line", "answers"),
    [
        ("", []),
        ("keep", [Keep("wrist", 36, 40, **ANNA)]),
        ("hidden 31-44", [Hidden("wrist", 31, 44, **ANNA)]),
    ],
)
def test_a_line_is_an_answer(film, tmp_path, line, answers):
    attended(film, tmp_path / "out.mcap", terminal(tmp_path, [line], []))
    given = load_seeds(tmp_path / "seeds.toml")[3:]
    assert [type(a) for a in given] == [type(a) for a in answers]
    for one, other in zip(given, answers, strict=True):
        assert one.author == other.author
        if isinstance(other, Hidden):
            assert one == other


def test_a_line_that_never_comes_holds_nobody_up(monkeypatch):
    read, write = os.pipe()
    with os.fdopen(read) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        stopping = iter([False, False, True])
        assert read_line(lambda: next(stopping)) is None
        os.write(write, b" keep \n")
        assert read_line(lambda: False) == "keep"
        os.close(write)
        assert read_line(lambda: False) is None
