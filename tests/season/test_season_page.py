"""The season's page: what needs attention first, nothing made up, whole with three sessions and with a thousand."""

import re
from html import unescape
from html.parser import HTMLParser

import pytest
from made_up import asked, clock, many, marker, outcome, season

from spheremcap.season.page import page
from spheremcap.season.page_figures import STRIPS
from spheremcap.season.page_sessions import SHOWN_ROWS, by_need
from spheremcap.season.page_usual import usual_residual, usual_share
from spheremcap.season.rows import rows_of

VOID = {"meta", "br"}


class Parsed(HTMLParser):
    """The page's words, the rows of its tables, and whether each tag is closed."""

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.tables, self.headings = [], [], [], []
        self.html = html
        self.feed(html)
        assert self.open == []
        self.words = plain(re.sub(r"<style>.*?</style>", "", html, flags=re.DOTALL))

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        elif tag == "h2":
            self.headings.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "h2" in self.open:
            self.headings[-1] += data
        if self.tables and self.tables[-1] and ("td" in self.open or "th" in self.open):
            self.tables[-1][-1][-1] += data

    def table(self, first):
        """The rows of the table whose head begins so."""
        return next(rows[1:] for rows in self.tables if rows[0][0] == first)


def plain(html):
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", html))).strip()


def read(outcomes, **more):
    said = season(*outcomes, **more)
    there = {name: one for name, one in outcomes.items() if one is not None}
    return Parsed(page(said.name, said.description, rows_of(said, there)))


def shared(name, left, right=990, **more):
    return outcome(name, markers=(marker("left_wrist", left), marker("right_wrist", right)), **more)


MIXED = {
    "good": shared("good", 1000, 1000),
    "poor": shared("poor", 400, 990, requests=(asked("left_wrist", 3), asked("left_wrist", 9, "keep"))),
    "lossy": outcome("lossy", "lost", lost=("12 frames could not be decoded",)),
    "broken": outcome("broken", "failed", reason="v.mp4: not a video"),
    "waiting": None,
}


def test_the_box_says_how_it_stands():
    got = read(MIXED, name="Season 2026", description="All of it")
    assert "5 sessions: 2 done, 1 done with losses, 1 not run and 1 failed." in got.words
    assert "Over all sessions and markers 89.5 % of the frames were measured." in got.words  # (2000+1390+1980) / 6000
    assert "1 question of the tracker is open, in 1 session. spheremcap dataset requests OUT lists them" in got.words
    assert "Measured least: poor (69.5 %, left_wrist 40.0 %)." in got.words
    assert "Most open questions: poor (1)." in got.words
    assert "Longest gap of a marker: good (0.10 s)." in got.words
    assert "All of it" in got.words
    assert "5 sessions · 2025-06-15 · 12.6 s · 1 subject" in got.words
    assert got.words.index("What to make of it") < got.words.index("What failed, and why")


def test_what_went_well_throughout_is_said_too():
    got = read({"a": outcome("a")})
    assert "1 session: 1 done." in got.words
    assert "No question of the tracker is open." in got.words
    assert "Nothing is missing." in got.words
    assert got.headings == ["What to make of it", "How much was measured", "All sessions", "Clocks",
                            "What could not be had"]  # fmt: skip


def test_sessions_stand_by_how_much_they_need_somebody():
    names = [row[0].split()[0] for row in read(MIXED).table("Session")]
    assert names == ["broken", "waiting", "lossy", "poor", "good"]
    alike = {
        "a": outcome("a", clocks=(clock("wheel", 0.4),)), "b": outcome("b", clocks=(clock("wheel", 0.9),)),
        "c": outcome("c", requests=(asked("left_wrist", 3),)),
    }  # fmt: skip
    assert [row.session for row in by_need(rows_of(season(*alike), alike))] == ["c", "b", "a"]


def test_a_row_has_what_came_out():
    rows = {row[0]: row[1:] for row in read(MIXED).table("Session")}
    assert rows["poor S1"] == [
        "done", "69.5 %", "left_wrist 40.0 %", "1 of 2", "0.10 s", "wheel 0.40 (0.08)", "8, 7",
    ]  # fmt: skip
    assert rows["broken S1"] == ["failed (!)", "v.mp4: not a video"]
    assert rows["waiting"] == ["not run (!)", ""]
    assert rows["lossy S1"][0] == "done with losses"
    bare = read({"bare": outcome("bare", markers=(), clocks=(), strokes={}, start_ns=None, duration_s=0, subject="")})
    assert bare.table("Session") == [["bare", "done", "–", "–", "0", "–"]]
    assert "Nothing yet." in bare.words
    assert "No sensors were merged." in bare.words
    one_side = read({"a": outcome("a", strokes={"left": 3})})
    assert one_side.table("Session")[0][-1] == "3, –"


def test_where_a_sessions_own_page_is_is_told_and_no_link_is_made():
    got = read(MIXED)
    assert "NAME/session.report.html" in got.words
    assert not [attrs for tag, attrs in got.tags if tag in ("a", "script", "img", "link") or "src" in attrs]
    assert "http" not in got.html


def test_reasons_and_losses_that_say_the_same_stand_once():
    outcomes = {f"run{k}": outcome(f"run{k}", "failed", reason=f"/data/run{k}/v.mp4: not a video") for k in range(11)}
    outcomes |= {f"a{k}": outcome(f"a{k}", "lost", lost=(f"{k + 2} frames lost", "same")) for k in range(3)}
    outcomes |= {"alone": outcome("alone", "failed", reason="no light"), "w1": None, "w2": None}
    outcomes["a0"] = outcome("a0", "lost", lost=("2 frames lost", "9 frames lost", "same"))
    got = read(outcomes)
    named = ["run0", "run1", "run10", "run2", "run3", "run4", "run5", "run6"]
    assert got.table("Why") == [
        ["/data/…/v.mp4: not a video", "11", f"{', '.join(named)} and 3 more"], ["no light", "1", "alone"],
    ]  # fmt: skip
    assert got.table("What is in its way") == [["nothing is in its way", "2", "w1 and w2"]]
    assert got.table("What") == [["… frames lost", "4", "a0 (2 times), a1 and a2"], ["same", "3", "a0, a1 and a2"]]


def test_a_name_with_a_number_is_no_number():
    lost = {"a": "imu1 is left out", "b": "imu2 is left out", "c": "v2.1 at 3.5 s", "d": "v2.1 at 12 s"}
    got = read({name: outcome(name, "lost", lost=(line,)) for name, line in lost.items()})
    assert [row[0] for row in got.table("What")] == ["v2.1 at … s", "imu1 is left out", "imu2 is left out"]


def test_far_off_clocks_come_first_and_are_marked():
    residuals = [0.40, 0.42, 0.38, 0.41, 0.39, 0.43, 2.5]
    outcomes = {f"s{k}": outcome(f"s{k}", clocks=(clock("wheel", ms), clock("imu"))) for k, ms in enumerate(residuals)}
    got = read(outcomes)
    rows = got.tables[-1][1:]
    assert rows[0] == ["s6", "wheel", "2.500 ms", "0.410 ms", "(!) far off", "0.500 ms", "11 of 12", "12.5 ppm"]
    assert [row[4] for row in rows[1:]] == ["as usual"] * 6
    assert [row[0] for row in rows[1:3]] == ["s5", "s1"]
    assert "1 sync residual is far above what is usual" in got.words
    assert "wheel 2.50 (0.50) (!)" in got.words
    assert dots(got.html, 1) == [(6, 1)]
    assert "Of 7 more sensors no clock was found from motion" in got.words
    few = read({name: outcomes[name] for name in ("s0", "s1", "s6")})
    assert "far above what is usual:" not in few.words
    assert [row[4] for row in few.tables[-1][1:]] == ["–"] * 3


def test_each_sensor_has_a_usual_of_its_own():
    outcomes = {
        f"s{k}": outcome(f"s{k}", clocks=(clock("wheel", 0.4), clock("imu", 4.0 if k else 9.0))) for k in range(6)
    }
    far = [row[:3] for row in read(outcomes).tables[-1] if "far off" in row[4]]
    assert far == [["s0", "imu", "9.000 ms"]]


def test_what_is_usual_is_not_changed_by_what_is_far_off():
    told = usual_residual([0.4, 0.5, 0.3, 0.45, 0.35, 50.0])
    assert told.median == pytest.approx(0.425)
    assert told.limit == pytest.approx(0.425 + 3 * 1.4826 * 0.075)
    assert usual_residual([0.4, 0.4, 0.4, 0.4, 0.44]).limit == pytest.approx(0.4 * 1.3)  # alike: a tenth is nothing
    assert usual_residual([0.4, 0.4, 0.4, 9.0]) is None
    share = usual_share([0.99, 0.98, 0.97, 0.99, 0.98, 0.2])
    assert share.limit == pytest.approx(0.98 - 3 * 1.4826 * 0.01)
    assert usual_share([1.0] * 6).limit == pytest.approx(0.985)


def dots(html, number=0):
    """Of each strip of a figure: how many dots are as usual, and how many are far off."""
    figure = re.findall(r"<figure>.*?</figure>", html, re.DOTALL)[number]
    strips = figure.split('class="tick end"')[1:]
    return [
        tuple(sum(path.count("M") for path in re.findall(f'class="{look}" d="([^"]*)"', strip)) for look in looks)
        for strip, looks in ((strip, ("dots", "dots far")) for strip in strips)
    ]


def test_each_session_is_a_dot_and_what_is_far_below_is_orange():
    outcomes = {f"s{k}": shared(f"s{k}", 990 - k) for k in range(6)} | {"low": shared("low", 300)}
    got = read(outcomes)
    assert dots(got.html) == [(6, 1), (6, 1), (7, 0)]  # all markers, left_wrist, right_wrist
    assert "Orange: far below what is usual" in got.words
    assert "low: 30.0 %" in got.words
    assert "Orange" not in read({"a": shared("a", 990), "low": shared("low", 300)}).words


def test_no_dot_lies_outside_and_none_upon_another():
    outcomes = {f"s{k}": shared(f"s{k}", 990) for k in range(300)} | {"none": shared("none", 0, 0)}
    html = read(outcomes).html
    places = [tuple(map(float, at)) for at in re.findall(r"M([\d.]+) ([\d.]+)h\.01", html)]
    assert len(places) >= 3 * 200
    strips = {round((y - 28) / 36) for _, y in places}
    assert strips == {0, 1, 2}
    assert all(168 <= x <= 642 and abs(y - 28 - 36 * round((y - 28) / 36)) <= 15 for x, y in places)


def test_many_markers_are_cut_to_the_worst():
    markers = tuple(marker(f"m{k:02d}", 999 - k) for k in range(STRIPS + 4))
    got = read({"a": outcome("a", markers=markers)})
    assert f"There are {STRIPS + 4} markers: those with the lowest shares are drawn." in got.words
    assert len(dots(got.html)) == 1 + STRIPS
    assert "m04" in got.words
    assert "m03" not in got.words


@pytest.mark.parametrize("count", [1, 3, 20, 1000])
def test_it_is_whole_with_few_and_with_many(count):
    outcomes = many(count)
    got = read(outcomes)
    assert not re.search(r"\bnan\b|None", got.words)
    sessions = got.table("Session")
    assert len(sessions) == min(count, SHOWN_ROWS)
    assert len(got.html) < 200_000
    if count == 1000:
        assert (
            f"The other {count - SHOWN_ROWS} sessions are in the file beside this page, sessions.parquet." in got.words
        )
        ends = [row[1] for row in sessions]
        assert ends.count("done") >= SHOWN_ROWS // 4  # those that failed do not push all others out
        lowest = min((one for one in outcomes.values() if one is not None and one.measured), key=lambda o: o.measured)
        assert any(row[0].startswith(lowest.session) for row in sessions)
        assert len(got.tables[-2][1:]) < SHOWN_ROWS  # clocks that are as usual are not all told


def test_thousands_of_failures_are_cut():
    outcomes = {f"s{k:04d}": outcome(f"s{k:04d}", "failed", reason=f"reason {chr(97 + k % 26)}{k}") for k in range(900)}
    got = read(outcomes | {"fine": outcome("fine")})
    assert len(got.table("Why")) == SHOWN_ROWS
    assert f"{900 - SHOWN_ROWS} more are in the file beside this page" in got.words
    assert got.table("Session")[-1][0] == "fine S1"


def test_names_and_reasons_are_text():
    evil = '<script>alert("1")</script>&amp;'
    outcomes = {
        "a": outcome("a", "failed", reason=evil, subject=evil),
        "b": outcome(
            "b", "lost", lost=(evil,), subject=evil, markers=(marker(evil, 900),),
            clocks=(clock(evil, 0.4, windows=evil),),
        ),
    }  # fmt: skip
    got = read(outcomes, name=evil, description=evil)
    assert not any(tag == "script" for tag, _ in got.tags)
    assert got.words.count(evil) >= 10
    one = read(dict.fromkeys([evil]), name="x")
    assert one.table("Session")[0][0] == evil


def test_the_same_sessions_are_the_same_page():
    outcomes = many(50)
    told = season(*outcomes)
    there = {name: one for name, one in outcomes.items() if one is not None}
    again = {name: one.model_copy(update={"seconds": {"x": 1.0}, "peak_mb": 9}) for name, one in there.items()}
    shuffled = dict(reversed(again.items()))
    assert page("a", "", rows_of(told, there)) == page("a", "", rows_of(told, shuffled))
