import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.analysis.chair import ChairFrame
from spheremcap.analysis.curves import ArmCurves, SegmentLength
from spheremcap.analysis.cycles import bands_of
from spheremcap.analysis.findings import Findings, MarkerQuality, Session
from spheremcap.analysis.markup import number
from spheremcap.analysis.page import page
from spheremcap.analysis.rim import Wheel
from spheremcap.analysis.strokes import HandStrokes
from spheremcap.analysis.summary import contact_lags
from spheremcap.core.stroke import EventKind, Stroke, StrokeEvent

START_NS = 1_750_000_000_000_000_000  # 2025-06-15T15:06:40Z
RIM_M, CYCLE_S, PUSH_S = 0.2, 0.5, 0.12
LATE_S = {"left": 0.015, "right": 0.0}


class Parsed(HTMLParser):
    """A page as a reader of it has it: its text, its tables by caption (rows of cells), its tags, headings in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open, self.tags, self.text, self.tables, self.headings, self.ids = [], [], [], {}, [], []
        self.feed(html)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag == "meta":
            return
        self.open.append(tag)
        if tag == "table":
            self.caption, self.rows = "", []
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag in ("h1", "h2", "h3"):
            self.headings.append("")

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == "table":
            self.tables[self.caption] = self.rows

    def handle_data(self, data):
        if "style" in self.open:
            return
        self.text.append(data)
        if "caption" in self.open:
            self.caption += data
        if any(cell in self.open for cell in ("td", "th")):
            self.rows[-1][-1] += data
        if self.open and self.open[-1] in ("h1", "h2", "h3"):
            self.headings[-1] += data

    @property
    def words(self):
        return re.sub(r"\s+", " ", "".join(self.text))

    def table(self, begins):
        return next(rows for caption, rows in self.tables.items() if caption.startswith(begins))

    def row(self, begins, head):
        return next(cells for cells in self.table(begins) if cells and cells[0].replace("\xa0", " ").startswith(head))


def stroke(side, k, **more):
    rng = np.random.default_rng([k, side == "left"])
    push, cycle = PUSH_S + rng.normal(0, 0.005), CYCLE_S
    contact, push_deg = 60 + rng.normal(0, 3), 130 + rng.normal(0, 5)
    at = START_NS + round((0.3 + CYCLE_S * k + LATE_S[side]) * 1e9)
    known = {
        "push_s": push, "push_sd_s": 0.002, "recovery_s": cycle - push, "recovery_sd_s": 0.003,
        "cycle_s": cycle, "cycle_sd_s": 0.002, "frequency_hz": 1 / cycle, "frequency_sd_hz": 0.008,
        "contact_deg": contact, "contact_sd_deg": 1.5,
        "release_deg": contact + push_deg, "release_sd_deg": 2.0, "push_deg": push_deg, "push_sd_deg": 2.5,
        "contact_mps": 3.5 + rng.normal(0, 0.1), "contact_sd_mps": 0.05,
        "recovery_end_mps": 3.2, "recovery_end_sd_mps": 0.04, "wheel_rad_s": 20.0, "pattern": "around", "measured": 1.0,
    }  # fmt: skip
    return Stroke(at, side, f"{side}_wrist", k, **(known | more))


def hand(side, strokes):
    events = []
    for s in strokes:
        for kind, after in ((EventKind.CONTACT, 0.0), (EventKind.RELEASE, s.push_s)):
            if after is not None:
                at = s.stamp_ns + round(after * 1e9)
                events.append(StrokeEvent(at, side, s.marker, kind, s.stroke, 2.0, 60.0, 1.5, 3.5, 0.05, "radius"))
    return HandStrokes(Wheel.of(side, 0.3, 0.0), RIM_M, tuple(events), tuple(strokes), ())


def arm(side, t_s):
    """A wrist that goes round and round once a cycle, out of the rim's plane by nothing."""
    turn = 2 * np.pi * t_s / CYCLE_S
    radius = RIM_M * (1 + 0.5 * np.maximum(0, np.sin(turn)))
    sign = 1 if side == "left" else -1
    xyz = np.stack([radius * np.sin(turn), np.full_like(turn, sign * 0.3), radius * np.cos(turn)], 1).astype(np.float32)
    there, ones = np.ones(len(t_s), bool), np.ones(len(t_s), np.float32)
    values = {
        name: value
        for quantity, mean in (("speed_mps", 3.0), ("elbow_deg", 120.0), ("forearm_elevation_deg", 40.0))
        for name, value in (
            (quantity, (mean * (1 + 0.1 * np.sin(turn))).astype(np.float32)),
            (quantity.replace("_", "_sd_", 1), ones * 0.05),
        )
    }
    packed = np.tile(np.float32([1e-6, 0, 0, 1e-6, 0, 1e-6]), (len(t_s), 1))
    return ArmCurves(side, f"{side}_wrist", there, there, xyz, packed, np.gradient(xyz, axis=0), values)


def session(cycles=8, fps=120, sides=("left", "right"), **more):
    stamp_ns = START_NS + (np.arange(round((cycles * CYCLE_S + 1) * fps)) * 1e9 / fps).round().astype(np.int64)
    t_s = (stamp_ns - START_NS) / 1e9
    back = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
    chair = ChairFrame(
        back, np.array([1.0, 0.01, 0.5]), np.diag([1e-5, 4e-6, 1e-5, 4e-6, 9e-6, 4e-6]), 0.3, 0.002,
        ("tape measure", "pushes"), 0.8, True,
    )  # fmt: skip
    given = {
        "session": Session("ride", {}, {}, None, None, {}, {}), "stamp_ns": stamp_ns, "chair": chair,
        "arms": {side: arm(side, t_s) for side in sides}, "trunk": None,
        "hands": {side: hand(side, [stroke(side, k) for k in range(cycles)]) for side in sides},
        "lengths": (SegmentLength("left forearm", 900, 0.25123, 0.007, 0.004, 0.002),),
        "quality": tuple(MarkerQuality(f"{s}_wrist", 900, 0.987, 0.004, 33.3, 0, 1.1) for s in sides), "notes": (),
    }  # fmt: skip
    return Findings(**(given | more))


IDLE = HandStrokes(Wheel.of("left", 0.3, 0.0), np.nan, (), (), ())


def read(found):
    return Parsed(page(found, bands_of(found)))


def plain(text):
    return text.replace("−", "-").replace("\xa0", " ")


def test_means_are_those_of_the_strokes():
    found = session()
    got = read(found)
    for head, field, factor, digits in (
        ("Push time", "push_s", 1e3, 0), ("Recovery time", "recovery_s", 1e3, 0), ("Frequency", "frequency_hz", 1, 2),
        ("Contact angle", "contact_deg", 1, 1), ("Release angle", "release_deg", 1, 1),
        ("Speed at contact", "contact_mps", 1, 2), ("Push angle", "push_deg", 1, 1),
    ):  # fmt: skip
        cells = got.row("Means", head)
        for first, side in ((1, "left"), (4, "right")):
            values = factor * np.array([getattr(s, field) for s in found.hands[side].strokes])
            assert cells[first] == f"{values.mean():.{digits}f} ± {values.std(ddof=1):.{digits}f}", head
            assert cells[first + 2] == "8"
    share = np.mean([100 * s.push_s / s.cycle_s for s in found.hands["right"].strokes])
    assert got.row("Means", "Push share")[4].startswith(f"{share:.1f} ± ")
    pushes = 1e3 * np.array([s.push_s for s in found.hands["right"].strokes])
    lasts = f"{pushes.mean():.0f} ± {pushes.std(ddof=1):.0f} ms"
    assert got.row("Means", "Path of the recovery")[1:3] == ["8 × around", "8 × around"]
    assert f"The right hand is on the rim for {lasts}, {share:.0f} % of its stroke" in got.words


def test_what_measuring_adds_is_not_what_the_athlete_varies():
    """A stroke's own uncertainty is said apart from the standard deviation over strokes."""
    strokes = [stroke("left", k, push_s=0.120, push_sd_s=sd) for k, sd in enumerate((0.003, 0.004, 0.005))]
    got = read(session(hands={"left": hand("left", strokes)}))
    cells = got.row("Means", "Push time")
    assert cells[1:3] == ["120 ± 0", "± 4.1"]  # root mean square of 3, 4, 5
    assert "on the rim for 120 ± 0 ms, 24 % of its stroke (each measured to 4.1 ms)" in got.words


def test_a_stroke_that_lacks_a_value_is_not_in_its_mean():
    strokes = [
        stroke("left", 0, push_s=0.1),
        stroke("left", 1, push_s=None, push_sd_s=None),
        stroke("left", 2, push_s=0.2),
    ]
    got = read(session(hands={"left": hand("left", strokes)}))
    cells = got.row("Means", "Push time")
    assert (cells[1].split()[0], cells[3]) == ("150", "2")
    assert "Whole strokes (contact, release and next contact seen): 2 of 3 of the left hand" in got.words
    assert "Left hand: 3 strokes found, 2 of them whole" in got.words


def test_the_table_has_every_stroke_as_it_is():
    found = session()
    rows = [row for row in read(found).table("16 strokes") if row[0] != "Time, s"]
    strokes = sorted((s for h in found.hands.values() for s in h.strokes), key=lambda s: (s.stamp_ns, s.side))
    assert len(rows) == len(strokes)
    for row, s in zip(rows, strokes, strict=True):
        assert row[:3] == [f"{(s.stamp_ns - START_NS) / 1e9:.3f}", s.side, str(s.stroke)]
        assert row[3] == f"{s.push_s * 1e3:.0f} ± {s.push_sd_s * 1e3:.1f}"
        assert row[7] == f"{s.contact_deg:.1f} ± {s.contact_sd_deg:.1f}"
        assert row[10] == f"{s.contact_mps:.2f} ± {s.contact_sd_mps:.2f}"


def test_left_against_right_is_positive_where_the_left_is_larger():
    hands = {
        "left": hand("left", [stroke("left", k, push_s=p, contact_deg=70.0) for k, p in enumerate((0.118, 0.122))]),
        "right": hand("right", [stroke("right", k, push_s=p, contact_deg=75.0) for k, p in enumerate((0.098, 0.102))]),
    }
    got = read(session(hands=hands))
    assert got.row("Means", "Push time")[-2:] == ["+20.0 ± 2.8", "+18.2 %"]  # 20 of 110; sd 2.83 of two in each hand
    assert [plain(cell) for cell in got.row("Means", "Contact angle")[-2:]] == ["-5.0 ± 0.0", "–"]


@pytest.mark.parametrize(("late_s", "said"), [(0.015, "15.0 ± 0.0 ms later"), (-0.015, "15.0 ± 0.0 ms earlier")])
def test_which_hand_takes_hold_first_is_said(late_s, said):
    right = [stroke("right", k) for k in range(4)]
    left = [replace(stroke("left", k), stamp_ns=s.stamp_ns + round(late_s * 1e9)) for k, s in enumerate(right)]
    got = read(session(hands={"left": hand("left", left), "right": hand("right", right)}))
    assert f"the left hand takes hold {said} than the right (±: standard deviation over 4 pairs" in got.words


def contacts(side, times_ms):
    return [
        StrokeEvent(START_NS + t * 1_000_000, side, "w", EventKind.CONTACT, k, 1.0, None, None, None, None, "radius")
        for k, t in enumerate(times_ms)
    ]


ALL = {"left": [Stroke(START_NS, "left", "w", 0, cycle_s=0.5)]}


def test_contacts_pair_with_the_nearest_and_with_one():
    assert contact_lags(contacts("left", [0, 500, 1000]), contacts("right", [10, 1040]), ALL).tolist() == [-10, -40]
    assert contact_lags(contacts("left", [480, 510]), contacts("right", [500]), ALL).tolist() == [10]
    assert not len(contact_lags(contacts("left", [0]), contacts("right", [250]), ALL))  # half a cycle tells nothing
    releases = [replace(e, kind=EventKind.RELEASE) for e in contacts("right", [0])]
    assert not len(contact_lags(contacts("left", [0]), releases, ALL))
    assert not len(contact_lags(contacts("left", [0]), contacts("right", [0]), {}))


@given(st.sets(st.integers(0, 3000), max_size=8), st.sets(st.integers(0, 3000), max_size=8))
def test_pairs_are_each_others_nearest(left, right):
    lags = contact_lags(contacts("left", sorted(left)), contacts("right", sorted(right)), ALL).tolist()
    sure = [
        a - b
        for a in sorted(left)
        for b in right
        if abs(a - b) < 250
        and all(abs(a - other) > abs(a - b) for other in right - {b})
        and all(abs(b - other) > abs(a - b) for other in left - {a})
    ]
    assert set(sure) <= set(lags)
    assert len(lags) <= min(len(left), len(right))
    assert all(abs(lag) < 250 for lag in lags)


def test_quality_comes_first_and_is_as_found():
    noisy = MarkerQuality("left_wrist", 1000, 0.9004, 0.05, 141.7, 3, 2.04)
    loose = SegmentLength("left upper arm", 900, 0.27, 0.08, 0.004, 0.05)
    got = read(session(quality=(noisy,), lengths=(*session().lengths, loose)))
    assert got.row("How much", "left_wrist")[1:] == ["1000", "90.0 %", "5.0 %", "142 ms", "3", "× 2.0 (!)"]
    assert got.row("Distances", "left forearm")[2:] == ["251.2 mm", "0.7 %", "0.4 %", "0.2 %", "constant"]
    assert got.row("Distances", "left upper arm")[-1] == "(!) no constant length"
    assert "No constant length: left upper arm." in got.words
    assert "3 questions of the tracker are open" in got.words
    sections = [h for h in got.headings if h in ("How good the recording is", "Strokes", "Left against right")]
    assert sections == ["How good the recording is", "Strokes", "Left against right"]
    assert got.row("Where the camera", "it is forward")[1:] == ["1000 mm", "± 2.0 mm"]
    assert got.row("Where the camera", "it looks down")[1:] == ["0.0°", "± 0.11°"]  # sqrt(4e-6) rad


def test_how_well_the_clocks_agree_is_said():
    synced = {"samples": "9", "rate_hz": "200", "added": "+5 ms", "drift_ppm": "20", "sync_residual_ms": "0.421"}
    synced |= {"sync_error_ms": "0.083", "sync_windows": "11 of 12"}
    clocks = {"imu": synced, "wheel": {"samples": "7", "added": "nothing", "drift_ppm": "0"}}
    got = read(session(session=replace(session().session, clocks=clocks)))
    assert got.row("How the times", "imu")[1:] == [
        "9", "200 Hz", "+5 ms", "20 ppm", "0.421 ms (11 of 12 windows agree)", "0.083 ms",
    ]  # fmt: skip
    assert got.row("How the times", "wheel")[1:] == ["7", "–", "nothing", "0 ppm", "–", "–"]
    assert "Residual: how far apart the clocks are" in got.words


def test_its_time_is_said_where_it_is_known():
    found = session()
    assert "2025-06-15 15:06:40 UTC · 5.0 s · 600 frames · 120.00 frames a second" in read(found).words
    late = replace(found, stamp_ns=found.stamp_ns - START_NS + 7_000_000_000, hands={})
    assert "The recording does not say when it was · 5.0 s" in read(late).words


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"chair": None, "hands": {}}, "There is none: nothing told where the camera is on the chair."),
        ({"hands": {}}, "No strokes were found."),
        ({"hands": {}}, "No strokes could be told."),
        ({"hands": {"left": IDLE}}, "Left hand: 0 strokes found"),
        ({"hands": {"left": session().hands["left"]}}, "There are no strokes of the right hand: nothing can"),
        ({"hands": {"left": hand("left", [stroke("left", 0)])}}, "there is no mean cycle"),
        ({"lengths": ()}, "no length can be checked"),
        ({"lengths": (SegmentLength("left forearm", 3),)}, "too few frames"),
        ({"quality": ()}, "There are no markers in the recording."),
        ({"notes": ("no rim: give wheel.rim_radius_m",)}, "What could not be had no rim: give wheel.rim_radius_m"),
        ({}, "Nothing that the markers support is missing."),
        ({}, "there is one clock"),
        ({"arms": {}, "hands": {}}, "There is no speed of a wrist to draw."),
        ({"chair": replace(session().chair, upright=False)}, "Nothing says how the camera is tilted"),
        (
            {"chair": None, "arms": {}, "hands": {}, "lengths": (), "quality": (), "stamp_ns": np.zeros(0, np.int64)},
            "No frames.",
        ),
    ],
)  # fmt: skip
def test_what_is_not_there_is_said(more, said):
    found = session(**more)
    html = page(found, bands_of(found) if len(found.stamp_ns) else [])
    assert said in re.sub(r"\s+", " ", Parsed(html.replace("</h3>", "</h3> ").replace("<li>", "<li> ")).words)
    assert not re.search(r"<h3>[^<]*</h3>\s*(<h\d|</section)", html)  # no heading over nothing
    assert "nan" not in re.sub(r"<style>.*?</style>", "", html, flags=re.DOTALL).lower().replace("nothing", "")


def test_a_hand_without_angles_has_the_rest():
    bare = dict.fromkeys(("contact_deg", "contact_sd_deg", "release_deg", "release_sd_deg"))
    found = session(hands={side: hand(side, [stroke(side, k, **bare) for k in range(3)]) for side in LATE_S})
    got = read(found)
    assert not any(row[0].startswith("Contact angle") for row in got.table("Means"))
    assert got.row("Means", "Push angle")
    assert "There are no contact and release angles" in got.words


def test_notes_on_strokes_that_say_the_same_are_one():
    told = tuple(f"left hand, stroke {k}: contact: {k} frames are missing at it" for k in range(20))
    got = read(session(notes=(*told, "right hand, stroke 3: release: too few positions were measured at it", "no rim")))
    assert "left hand, strokes 0, 1, 2, 3, 4, 5, 6, 7 and 12 more: contact: frames are missing at it" in got.words
    assert "right hand, stroke 3: release: too few positions" in got.words
    assert "no rim" in got.words


def test_names_from_files_are_text():
    evil = '<script>alert("1")</script>&amp;'
    found = session(
        session=Session(evil, {}, {}, None, None, {}, {evil: {"samples": evil, "added": evil, "drift_ppm": evil}}),
        notes=(evil,), quality=(MarkerQuality(evil, 9, 0.5, 0.0, 1.0, 0, None),),
        lengths=(SegmentLength(evil, 90, 0.2, 0.5, 0.01, 0.0),),
        hands={"left": hand("left", [stroke("left", 0, pattern=evil)])},
        chair=replace(session().chair, told_by=(evil,)),
    )  # fmt: skip
    got = read(found)
    assert not any(tag == "script" for tag, _ in got.tags)
    assert got.words.count(evil) >= 12
    assert got.row("How much", evil)


def test_it_needs_nothing_else_and_a_screen_reader_can_read_it():
    html = page(session(), bands_of(session()))
    assert not re.search(r"<script|<link|<img|src=|url\(|https?:|@import", html)
    got = Parsed(html)
    assert got.tags[0] == ("html", {"lang": "en"})
    assert got.headings[0] == "ride"
    assert all(attrs.get("scope") for tag, attrs in got.tags if tag == "th")
    assert all(attrs.get("role") == "img" and attrs.get("aria-label") for tag, attrs in got.tags if tag == "svg")
    assert all(caption for caption in got.tables)
    assert "@media print" in html


def test_same_findings_same_page():
    assert page(session(), bands_of(session())) == page(session(), bands_of(session()))


def test_figures_mark_what_was_found():
    found = session()
    got = read(found)
    figures = [attrs["aria-label"] for tag, attrs in got.tags if tag == "svg"]
    assert [f.split(",")[0] for f in figures] == [
        "Path of the wrist about the axle", "Speed of the wrists over the start of the session",
        "Mean cycle", "Mean cycle", "Mean cycle", "Mean cycle",  # speed, elbow, forearm, gap
        "Contact angle by stroke", "Release angle by stroke",
    ]  # fmt: skip
    looks = [attrs.get("class") for tag, attrs in got.tags]
    assert [looks.count(f"{side} push") for side in LATE_S] == [8, 8]
    assert [looks.count(f"{side} arc") for side in LATE_S] == [1, 1]
    # legends and the dots of both angles: 1 + 8 each; contacts and releases on the path: 8 each
    assert looks.count("left full") == 8 + 2 * 9
    assert looks.count("right open") == 8 + 2 * 9
    assert (looks.count("left open"), looks.count("right full")) == (8, 8)


def test_the_path_is_seen_with_forward_to_the_right_and_up_above():
    """Contact just past the top is drawn above and to the right of the axle, release below it."""
    found = session(hands={"left": hand("left", [stroke("left", k, push_s=0.2) for k in range(3)])})
    t_s = (found.stamp_ns - START_NS) / 1e9
    after_s = (t_s - 0.3 - LATE_S["left"]) % CYCLE_S
    angle = np.radians(np.interp(after_s, [0.0, 0.2, 0.25, 0.4, CYCLE_S], [40, 180, 180, 40, 40]))
    xyz = np.stack([RIM_M * np.sin(angle), np.full_like(angle, 0.3), RIM_M * np.cos(angle)], 1).astype(np.float32)
    found = replace(found, arms={"left": replace(found.arms["left"], xyz_m=xyz)})
    html = page(found, [])
    axle = re.search(r'class="axis" d="M([\d.]+) ([\d.]+)h14m', html)
    x, y = float(axle[1]) + 7, float(axle[2])
    contact = re.search(r'class="left full" cx="([\d.]+)" cy="([\d.]+)"', html)
    release = re.search(r'class="left open" cx="([\d.]+)" cy="([\d.]+)"', html)
    assert float(contact[1]) > x + 20
    assert float(contact[2]) < y - 20
    assert float(release[2]) > y + 100
    arc = re.search(r'class="left arc" points="([^"]*)"', html)[1].split()
    for drawn, mark in ((arc[0], contact), (arc[-1], release)):  # inside of the marks, as seen from the axle
        px, py = map(float, drawn.split(","))
        assert px - x == pytest.approx(0.88 * (float(mark[1]) - x), abs=2)
        assert py - y == pytest.approx(0.88 * (float(mark[2]) - y), abs=2)


def test_a_gap_is_not_drawn_over():
    found = session()
    speed = found.arms["left"].values["speed_mps"].copy()
    speed[100:120] = np.nan
    gappy = replace(found.arms["left"], values={**found.arms["left"].values, "speed_mps": speed})
    lines = [
        sum(tag == "polyline" and attrs["class"] == "left" for tag, attrs in Parsed(page(f, [])).tags)
        for f in (found, replace(found, arms={**found.arms, "left": gappy}))
    ]
    assert lines == [1, 2]


def test_half_an_hour_is_less_than_a_megabyte():
    found = session(cycles=3600, fps=240)
    notes = tuple(f"left hand, stroke {k}: contact: too few positions were measured at it" for k in range(3000))
    html = page(replace(found, notes=notes), bands_of(found))
    assert len(html.encode()) < 1_000_000
    got = Parsed(html)
    rows = got.table("The first 100 and the last 100 of 7200 strokes")
    assert len(rows) == 1 + 200 + 1
    assert rows[101] == ["… 7000 strokes left out …"]
    assert (rows[1][2], rows[-1][2]) == ("0", "3599")
    assert "The file beside this page whose name ends in .strokes.csv has all strokes" in got.words
    assert "30 min 1 s" in got.words
    assert got.row("Means", "Push time")[3] == "3600"


def test_a_fast_camera_makes_no_larger_page():
    slow, fast = (page(session(cycles=12, fps=fps), []) for fps in (240, 4000))
    assert len(fast) < 1.3 * len(slow)


def test_numbers_are_for_people():
    assert number(-1.26, 1) == "−1.3"
    assert number(-0.04, 1) == "0.0"
    assert number(0.0, 1, sign=True) == "0.0"
    assert number(2.0, 0, sign=True) == "+2"
    assert number(None, 1) == number(float("nan"), 1) == "–"
