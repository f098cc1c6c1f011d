"""The page in a real browser, as a person uses it: with the mouse, and with the keyboard alone."""

import csv
import http.server
import io
import math
import os
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from film import COUNT, SETTINGS, elbow, seeds, wrist, write_chair
from hand import FLAGS, Annotate, Hand, Program, find_chromium

import spheremcap
from spheremcap import api
from spheremcap.config import load_seeds, load_settings, seeds_toml
from spheremcap.core.chair import ChairClick
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Hidden, Keep, Seed
from spheremcap.io.chair_file import load_chair

Visit = Callable[..., Hand]
Serve = Callable[..., Annotate]


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    chromium = find_chromium()
    if chromium is None:
        pytest.skip("no chromium on this machine: apt-get install chromium, and the page is tested in it")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install playwright"
    )
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=chromium, args=FLAGS)
        yield started
        started.close()


@pytest.fixture
def visit(browser: Any) -> Iterator[Visit]:
    """Opens a page in a window of its own; at the end no script on any of them has failed."""
    hands = []

    def open_page(url: str | None = None, width: int = 1280, height: int = 800, **more: Any) -> Hand:
        context = browser.new_context(viewport={"width": width, "height": height}, **more)
        hand = Hand(context.new_page())
        hands.append((context, hand))
        return hand if url is None else hand.open(url)

    yield open_page
    for context, hand in hands:
        assert hand.errors == []
        context.close()


@pytest.fixture
def serve() -> Iterator[Serve]:
    started: list[Annotate] = []

    def start(path: Path, *more: str) -> Annotate:
        started.append(Annotate(path, *more))
        return started[-1]

    yield start
    for server in started:
        server.end()


def near(found: Any, circle: Circle, within_px: float = 0.6) -> bool:
    return all(abs(a - b) < within_px for a, b in zip(found, circle, strict=True))


def answers_beside(path: Path) -> list:
    return load_seeds(path.with_name(f"{path.stem}.seeds.toml"))


# --- a video ---


def test_markers_are_seeded_by_dragging_and_tracked(film: Path, serve: Serve, visit: Visit) -> None:
    server = serve(film)
    hand = visit(server.url)
    x, y, r = wrist(0)
    assert "drag from its centre outwards" in hand.said("#hint")
    assert not hand.seen("#in-hand")
    assert not hand.seen("#next-request")  # nothing is tracked yet
    hand.drag((x + 2, y - 2), (x + 2 + r, y))
    assert near(hand.snapped(), wrist(0))
    assert hand.seen("#in-hand")
    assert not hand.seen("#hint")
    hand.type("#marker-name", "wrist").press("Enter")
    hand.wait(lambda: "wrist" in hand.said("#markers"))
    hand.reload()  # a circle that was not saved is in the hand again
    assert near(hand.circle(), wrist(0))
    hand.click("#save").saved()
    assert not hand.seen("#in-hand")
    assert near(answers_beside(film)[0].circle, wrist(0))
    assert answers_beside(film)[0].author == "ada"

    hand.click("#marker-new").type("#marker-name", "elbow").type("#marker-diameter", "35").press("Enter")
    hand.wait(lambda: hand.said("#markers").count("mm") == 2)
    hand.drag((elbow(0).x_px, elbow(0).y_px), (elbow(0).x_px, elbow(0).y_px + 18))
    assert near(hand.snapped(), elbow(0))
    hand.press("Enter")
    hand.wait(lambda: len(answers_beside(film)) == 2)
    assert [(m.name, m.diameter_m) for m in load_settings(film.with_name("film.settings.toml")).markers] == [
        ("wrist", 0.04), ("elbow", 0.035),
    ]  # fmt: skip
    hand.reload()
    assert near(hand.circle(), elbow(0))

    hand.click("#track")
    hand.wait(lambda: hand.seen("#job"))
    hand.reload()  # in the middle of the run
    hand.wait(lambda: hand.seen("#open-written"), 60)
    hand.click("#open-written")
    hand.wait(lambda: hand.said("#kind") == "tracked recording")
    assert spheremcap.open(film.with_suffix(".mcap")).tracks.keys() == {"wrist", "elbow"}
    assert server.end() == 0


def test_a_circle_is_moved_by_its_middle_and_sized_by_its_rim(film: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(film).url)
    hand.page.uncheck("#auto-snap")
    hand.drag((100, 100), (120, 100))
    assert near(hand.circle(), Circle(100, 100, 20))
    hand.drag((105, 104), (125, 94))
    assert near(hand.circle(), Circle(120, 90, 20))
    hand.drag((120, 110), (120, 122))
    assert near(hand.circle(), Circle(120, 90, 32))
    hand.drag((250, 200), (262, 200))  # anywhere else: a new one
    assert near(hand.circle(), Circle(250, 200, 12))
    hand.press("[").press("Shift+ArrowLeft").press("Alt+Shift+ArrowDown")
    assert near(hand.circle(), Circle(249, 200.1, 11), 0.3)
    hand.type("#r", "15.5").press("Enter")
    assert hand.circle()[2] == 15.5
    hand.click("#clear")
    assert hand.circle() is None


def test_single_pixels_are_shown_as_they_are(film: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(film).url)
    x, y, _ = map(round, wrist(0))
    hand.page.mouse.move(*hand.on_screen(x, y))
    with hand.page.expect_response(lambda r: "/patch/0" in r.url) as patch:
        for _ in range(14):
            hand.page.mouse.wheel(0, -120)
    assert patch.value.status == 200
    assert int(hand.said("#zoom").split()[0]) > 400
    hand.page.wait_for_timeout(300)
    red, green, blue = colour_at(hand, x, y)  # it is where the pointer is, however large
    assert red > green > blue  # the orange ball is still under the pointer
    hand.press("0")
    assert int(hand.said("#zoom").split()[0]) < 400


def colour_at(hand: Hand, x_px: float, y_px: float) -> tuple[int, int, int]:
    """What the canvas shows at a place of the picture, which is fitted to it."""
    x, y = on_canvas(hand, x_px, y_px)
    return tuple(hand.look(f"colour({x}, {y})"))


def test_every_step_shows_the_very_frame(film: Path, serve: Serve, visit: Visit) -> None:
    """Frame 70 is the first on which the orange ball is further down; 40 to 49 a screen is before it."""
    hand = visit(serve(film).url)
    hand.to_frame(68)
    for frame in (69, 70, 71, 70, 69):
        hand.press("ArrowRight" if frame >= int(hand.shown()) else "1").settled()
        assert hand.shown() == str(frame)
        hand.page.wait_for_timeout(60)
        red, _, blue = colour_at(hand, wrist(frame).x_px, 150.0)
        assert (red > blue + 60) == (frame >= 70), frame
    hand.press("End").settled()
    assert hand.shown() == str(COUNT - 1)
    hand.press("Home").settled().press("PageDown").settled()
    assert hand.shown() == "10"
    hand.type("#time", "0:00.250").press("Enter")
    hand.wait(lambda: hand.shown() == "60")


def test_scrubbing_shows_key_frames_and_the_exact_one_when_the_hand_rests(
    film: Path, serve: Serve, visit: Visit
) -> None:
    hand = visit(serve(film).url)
    box = hand.page.locator("#lanes").bounding_box()
    asked: list[str] = []
    hand.page.on("request", lambda request: "/picture/" in request.url and asked.append(request.url))
    mouse = hand.page.mouse
    mouse.move(box["x"] + 5, box["y"] + 15)
    mouse.down()
    for k in range(1, 20):
        mouse.move(box["x"] + box["width"] * k / 20, box["y"] + 15)
    hand.settled()
    mouse.up()
    hand.settled()
    assert any("exact=0" in url for url in asked)
    assert "exact=1" in asked[-1] or any("exact=1" in url for url in asked[-6:])
    assert abs(int(hand.shown()) - COUNT * 19 / 20) < 3


def test_markers_are_proposed_named_and_kept_or_thrown_away(film: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(film).url)
    hand.click("#propose")
    hand.wait(lambda: hand.seen("#proposals"), 60)
    blue = hand.page.locator("#proposal-list li", has=hand.page.locator("img[alt^='a blue']"))
    assert "blue" in blue.locator("p").inner_text()
    blue.locator("input").fill("elbow")
    blue.locator("button:has-text('Keep')").click()
    hand.saved()
    [answer] = answers_beside(film)
    assert answer.marker == "elbow"
    assert near(answer.circle, elbow(answer.frame_index))
    [marker] = load_settings(film.with_name("film.settings.toml")).markers
    assert (marker.name, marker.colour) == ("elbow", "blue")
    hand.wait(lambda: blue.count() == 0)
    left = hand.page.locator("#proposal-list li").count()
    hand.page.locator("#proposal-list button:has-text('Throw away')").first.click()
    assert hand.page.locator("#proposal-list li").count() == left - 1
    assert len(answers_beside(film)) == 1


# --- a recording ---


def test_requests_are_seen_answered_tracked_again_and_written(recording: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(recording).url)
    hand.wait(lambda: hand.said("#requests-left") == "2 of 2 open")
    hand.click("#next-request")
    hand.wait(lambda: "Where is wrist?" in hand.said("#request-words"))
    assert hand.settled().shown() == "40"
    for image in ("#last-verified", "#first-unverified", "#strip img >> nth=9"):
        hand.wait(lambda image=image: hand.page.locator(image).evaluate("i => i.naturalWidth") == 112)
    assert hand.said("#last-caption") == "last verified: 39"
    hand.reload()
    hand.wait(lambda: "Where is wrist?" in hand.said("#request-words"))

    hand.to_frame(40).press("h")
    hand.reload()  # in the middle of from here to here
    hand.to_frame(69).press("h").saved()
    assert answers_beside(recording)[-1] == Hidden("wrist", 40, 69, "ada", answers_beside(recording)[-1].time)
    hand.wait(lambda: hand.said("#requests-left") == "1 of 2 open")
    hand.reload()
    hand.wait(lambda: hand.said("#requests-left") == "1 of 2 open")

    hand.to_frame(75)
    x, y, r = wrist(75)
    hand.drag((x + 1, y + 1), (x + 1 + r, y + 1))
    assert near(hand.snapped(), wrist(75))
    hand.click("#save")
    hand.wait(lambda: hand.seen("#trial"))
    assert isinstance(answers_beside(recording)[-1], Seed)
    assert "Nothing is replaced yet" in hand.said("#trial-said")
    hand.reload()  # in the middle of a trial
    hand.wait(lambda: hand.seen("#trial"))
    assert "wrist, new" in hand.said("#lane-names")
    assert not hand.seen("#trial-doubt")
    hand.click("#accept")
    hand.wait(lambda: not hand.seen("#trial"))
    assert "wrist, new" not in hand.said("#lane-names")
    hand.to_frame(100)
    hand.wait(lambda: "found and verified" in hand.said("#state"))

    hand.click("#next-request")
    hand.wait(lambda: "Where is elbow?" in hand.said("#request-words"))
    hand.click("#keep").saved()
    assert answers_beside(recording)[-1] == Keep("elbow", 90, 109, "ada", answers_beside(recording)[-1].time)
    hand.wait(lambda: hand.said("#requests-left") == "0 of 2 open")
    assert "3 answers" in hand.said("#write")
    hand.click("#write")
    hand.wait(lambda: hand.seen("#open-written"), 60)
    batch = recording.with_name("batch.mcap")
    api.retrack(recording, batch, answers_beside(recording))
    assert recording.with_name("out.2.mcap").read_bytes() == batch.read_bytes()
    hand.click("#open-written")
    hand.wait(lambda: hand.said("#name") == "out.2.mcap")
    hand.wait(lambda: not hand.seen("#write"))


def test_what_was_tracked_again_can_be_discarded_and_the_circle_is_in_the_hand_again(
    recording: Path, serve: Serve, visit: Visit
) -> None:
    hand = visit(serve(recording).url)
    hand.to_frame(75)
    hand.click("#markers label:has-text('wrist')")
    x, y, r = wrist(75)
    hand.drag((x, y), (x + r, y))
    hand.snapped()
    hand.press("Enter")
    hand.wait(lambda: hand.seen("#trial"))
    hand.press("Escape")
    hand.wait(lambda: not hand.seen("#trial") and hand.circle() is not None)
    assert near(hand.circle(), wrist(75))
    assert len(answers_beside(recording)) == 2


def test_what_was_saved_outlives_the_program(recording: Path, serve: Serve, visit: Visit) -> None:
    server = serve(recording)
    hand = visit(server.url)
    hand.to_frame(40).press("r").press("Shift+r")
    hand.wait(lambda: hand.seen("#keep"))
    hand.click("#keep").saved()
    server.kill()
    assert isinstance(answers_beside(recording)[-1], Keep)
    hand.wait(lambda: "has lost its program" in hand.said("#message"))
    again = visit(serve(recording).url)
    again.wait(lambda: again.said("#answers-count") == "3")


def test_what_cannot_be_saved_is_not_said_to_be(recording: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(recording).url)
    hand.press("r")
    hand.wait(lambda: hand.seen("#keep"))
    recording.with_name("out.seeds.toml").mkdir()  # whatever keeps it from being written
    hand.click("#keep")
    hand.wait(lambda: hand.said("#saved") == "Not saved")
    assert "out.seeds.toml" in hand.said("#message")


def test_two_tabs_see_each_others_answers_and_lose_none(recording: Path, serve: Serve, visit: Visit) -> None:
    server = serve(recording)
    one = visit(server.url)
    other = Hand(one.page.context.new_page()).open(server.url.split("?")[0])  # by the cookie alone
    one.press("r")
    one.wait(lambda: "Where is wrist?" in one.said("#request-words"))
    other.press("Shift+r")
    other.wait(lambda: "Where is elbow?" in other.said("#request-words"))
    one.page.locator("#keep").click(no_wait_after=True)
    other.page.locator("#keep").click(no_wait_after=True)
    for tab in (one, other):
        tab.wait(lambda tab=tab: tab.said("#answers-count") == "4")
        tab.wait(lambda tab=tab: tab.said("#requests-left") == "0 of 2 open")
    assert len(answers_beside(recording)) == 4
    one.page.locator("#answers li:has-text('elbow: kept') button >> nth=-1").click()
    other.wait(lambda: other.said("#answers-count") == "3")
    assert other.errors == []


def test_a_recording_is_finished_with_the_keyboard_alone(recording: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(recording).url)
    hand.wait(lambda: hand.said("#requests-left") == "2 of 2 open")
    hand.press("r").settled()
    hand.wait(lambda: "Where is wrist?" in hand.said("#request-words"))
    hand.press("h").to_frame(69).press("h").saved()
    hand.to_frame(75).press("c")
    x, y, r = wrist(75)
    for key, off in (
        ("Shift+ArrowDown", round(y - hand.circle()[1])),
        ("Shift+ArrowRight", round(x - hand.circle()[0])),
    ):
        hand.press(key if off >= 0 else key.replace("Down", "Up").replace("Right", "Left"), abs(off))
    hand.press("]" if r > hand.circle()[2] else "[", abs(round(r - hand.circle()[2])))
    hand.press("x")
    assert near(hand.snapped(), wrist(75))
    hand.press("Enter")
    hand.wait(lambda: hand.seen("#trial"))
    hand.press("a")
    hand.wait(lambda: not hand.seen("#trial"))
    hand.press("r")
    hand.wait(lambda: "Where is elbow?" in hand.said("#request-words"))
    hand.press("k")
    hand.wait(lambda: hand.said("#requests-left") == "0 of 2 open")
    hand.tab_to("#write").press("Enter")
    hand.wait(lambda: hand.seen("#open-written"), 60)
    hand.tab_to("#open-written").press("Enter")
    hand.wait(lambda: hand.said("#name") == "out.2.mcap")
    hand.press("?")
    assert hand.seen("#keys")
    hand.press("Escape")
    assert not hand.seen("#keys")


def test_a_video_is_seeded_and_tracked_with_the_keyboard_alone(film: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(film).url)
    hand.press("c")
    hand.tab_to("#x").page.keyboard.type("61")
    hand.tab_to("#y").page.keyboard.type("71")
    hand.tab_to("#r").page.keyboard.type("17")
    hand.tab_to("#snap").press("Enter")
    assert near(hand.snapped(), wrist(0))
    hand.tab_to("#marker-name").press("Control+a")
    hand.page.keyboard.type("wrist")
    hand.press("Enter")
    hand.wait(lambda: "wrist" in hand.said("#markers"))
    hand.tab_to("#save").press("Enter").saved()
    hand.tab_to("#track").press("Enter")
    hand.wait(lambda: hand.seen("#open-written"), 60)


# --- the chair ---


def rim(k: float) -> tuple[float, float]:
    """A place on a push rim, a turn in 7 steps."""
    return 170 + 60 * math.cos(k * math.tau / 7), 120 + 90 * math.sin(k * math.tau / 7)


def clicks_beside(path: Path) -> list[ChairClick]:
    clicks, size = load_chair(path.with_name(f"{path.stem}.chair.toml"))
    assert size == (320, 240)
    return list(clicks)


def test_the_wheels_of_the_chair_are_clicked_and_are_there_again(film: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(film).url)
    hand.to_frame(3).click("#chair-open")
    assert "centre of the left wheel's hub" in hand.said("#hint")
    hand.point(165, 122)
    hand.point(170, 121).saved()  # there is one axle: the second click takes its place
    hand.click("#clicked label:has-text('Left rim')")
    for k in range(6):
        hand.point(*rim(k))
    hand.wait(lambda: "px off the ellipse" in hand.said("#rims-said"))
    clicks = clicks_beside(film)
    assert [(c.on, c.frame_index) for c in clicks] == [("left_axle", 3)] + [("left_rim", 3)] * 6
    for click, (x, y) in zip(clicks, [(170, 121), *map(rim, range(6))], strict=True):
        assert abs(click.x_px - x) < 0.3
        assert abs(click.y_px - y) < 0.3
    assert float(hand.said("#rims-said").split()[2]) < 0.3
    x, y = on_canvas(hand, *rim(6))
    assert hand.look(f"vivid({x}, {y})") > 120  # the ellipse goes where nobody has clicked
    assert hand.look(f"vivid({x - 30}, {y})") < 120

    hand.drag(rim(2), (rim(2)[0] + 12, rim(2)[1] + 9))
    hand.wait(lambda: abs(clicks_beside(film)[3].x_px - rim(2)[0] - 12) < 0.3)
    hand.point(*rim(6))
    hand.wait(lambda: "is it on the rim?" in hand.said("#rims-said"))
    assert "Left rim 3" in hand.page.locator("#clicks li:has-text('is it on')").inner_text()
    hand.press("u").press("Control+z")
    hand.wait(lambda: abs(clicks_beside(film)[3].x_px - rim(2)[0]) < 0.3)
    assert len(clicks_beside(film)) == 7
    hand.reload()
    assert hand.page.locator("#clicks li").count() == 7
    hand.to_frame(20).click("#clicks button:has-text('Left axle')")
    assert hand.settled().shown() == "3"
    hand.press("Backspace")
    hand.wait(lambda: len(clicks_beside(film)) == 6)
    hand.click("#chair-open")
    assert not hand.seen("#clicks")
    assert hand.seen("#marker-form")
    assert not film.with_name("film.seeds.toml").exists()


def on_canvas(hand: Hand, x_px: float, y_px: float) -> tuple[float, float]:
    """A place of the picture, which is fitted to the canvas, in its CSS pixels."""
    (x, y), box = hand.on_screen(x_px, y_px), hand.page.locator("#picture").bounding_box()
    return x - box["x"], y - box["y"]


def test_a_click_is_as_fine_as_the_picture_is_large(film: Path, serve: Serve, visit: Visit) -> None:
    """Zoomed in about a place, the same movement of the hand is a fraction of a pixel."""
    hand = visit(serve(film).url)
    hand.press("w")
    x, y = hand.on_screen(100, 80)
    hand.page.mouse.move(x, y)
    for _ in range(14):
        hand.page.mouse.wheel(0, -120)
    scale = int(hand.said("#zoom").split()[0]) / 100
    assert scale > 10
    hand.page.mouse.click(x + 20, y)
    hand.press("m")
    hand.page.mouse.click(x + 80, y - 30)
    hand.wait(lambda: film.with_name("film.chair.toml").exists() and len(clicks_beside(film)) == 2)
    left, right = clicks_beside(film)
    assert (left.on, right.on) == ("left_axle", "right_axle")
    assert abs(left.x_px - 100) < 1
    assert abs(right.x_px - left.x_px - 60 / scale) < 0.02
    assert abs(left.y_px - right.y_px - 30 / scale) < 0.02


def test_the_chair_is_clicked_with_the_keyboard_alone(recording: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(recording).url)
    hand.press("w").press("m").press("c").saved()
    hand.press("Shift+ArrowRight", 3).press("Alt+Shift+ArrowUp", 2)
    hand.wait(lambda: abs(clicks_beside(recording)[0].y_px - 119.3) < 1e-6)
    assert clicks_beside(recording) == [ChairClick("right_axle", 0, 162.5, 119.3)]
    hand.press("u")  # all presses at once
    hand.wait(lambda: clicks_beside(recording) == [ChairClick("right_axle", 0, 159.5, 119.5)])
    hand.press("m").press("c").press("Shift+ArrowDown").press("c")
    hand.wait(lambda: len(clicks_beside(recording)) == 3)
    assert [c.on for c in clicks_beside(recording)] == ["right_axle", "left_rim", "left_rim"]
    hand.press("[").press("Delete")
    hand.wait(lambda: len(clicks_beside(recording)) == 2)
    assert clicks_beside(recording)[1].y_px == 119.5
    hand.press("]").press("u").press("u").press("u")
    hand.wait(lambda: clicks_beside(recording)[-1].y_px == 119.5)
    hand.tab_to("#clicks .go").press("Enter")
    hand.wait(lambda: hand.page.locator("#clicks [aria-current=true]").count() == 1)
    hand.press("Escape")
    assert hand.seen("#markers")
    assert not recording.with_name("out.seeds.toml").exists()


def test_a_click_that_cannot_be_saved_is_not_shown_as_if_it_were(film: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(film).url)
    hand.press("w").point(50, 60).saved()
    other = Hand(hand.page.context.new_page()).open(hand.page.url)
    other.press("w")
    assert other.page.locator("#clicks li").count() == 1
    film.with_name("film.chair.toml").unlink()
    film.with_name("film.chair.toml").mkdir()  # whatever keeps it from being written
    hand.press("Shift+ArrowLeft")
    hand.wait(lambda: hand.said("#saved") == "Not saved")
    assert "film.chair.toml" in hand.said("#message")


def test_two_tabs_see_each_others_clicks(film: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(film).url)
    other = Hand(hand.page.context.new_page()).open(hand.page.url)
    hand.press("w").point(50, 60).saved()
    other.press("w")
    other.wait(lambda: other.page.locator("#clicks li").count() == 1)
    other.press("m").point(90, 60).saved()
    hand.wait(lambda: hand.page.locator("#clicks li").count() == 2)
    assert other.errors == []


# --- a run that waits ---


def test_a_run_waits_for_the_person_on_the_page_and_goes_on(film: Path, visit: Visit) -> None:
    folder = film.parent
    (folder / "a.seeds.toml").write_text(seeds_toml(seeds()))
    (folder / "a.settings.toml").write_text(SETTINGS.to_toml())
    files = ("--seeds", folder / "a.seeds.toml", "--settings", folder / "a.settings.toml")
    program = Program("track", film, "-o", folder / "out.mcap", *files, "--operator", "page")
    try:
        hand = visit(program.url_on(program.process.stderr))
        hand.wait(lambda: "Where is wrist?" in hand.said("#request-words"))
        assert hand.settled().shown() == "40"
        assert hand.said("#kind") == "is being tracked"
        for control in ("#track", "#write", "#propose", "#marker-form"):
            assert not hand.seen(control)
        hand.reload()
        hand.wait(lambda: "Where is wrist?" in hand.said("#request-words"))
        hand.press("h").to_frame(69).press("h")
        hand.wait(lambda: "Where is elbow?" in hand.said("#request-words"))
        assert answers_beside(folder / "a")[-1].to_frame_index == 69
        hand.press("l")
        hand.wait(lambda: "The run has ended" in hand.said("#message"))
        assert program.process.wait(30) == 0
    finally:
        program.end()
    batch = folder / "batch.mcap"
    api.track(film, batch, load_settings(folder / "a.settings.toml"), answers_beside(folder / "a"), folder=folder)
    assert (folder / "out.mcap").read_bytes() == batch.read_bytes()


# --- what everybody needs ---


def test_every_control_has_a_name_and_what_has_the_focus_shows_it(recording: Path, serve: Serve, visit: Visit) -> None:
    hand = visit(serve(recording).url)
    hand.press("r")
    hand.wait(lambda: hand.seen("#strip"))
    assert hand.look("unnamed()") == []
    assert hand.look("small()") == []
    for _ in range(25):
        hand.page.keyboard.press("Tab")
        style = hand.page.evaluate("(s => [s.outlineStyle, s.outlineWidth])(getComputedStyle(document.activeElement))")
        assert style == ["solid", "3px"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_at_200_percent_nothing_is_cut_off_and_text_stands_out(
    recording: Path, serve: Serve, visit: Visit, scheme: str
) -> None:
    """A window of 1280x800 at 200 % has room for 640x400."""
    hand = visit(serve(recording).url, 640, 400, device_scale_factor=2, color_scheme=scheme)
    hand.press("r")
    hand.wait(lambda: hand.seen("#strip"))
    nothing_is_cut_off_or_faint(hand)
    hand.settled().press("w").press("c").press("m").press("m").press("c").saved()
    hand.wait(lambda: "1 of at least 5" in hand.said("#rims-said"))
    nothing_is_cut_off_or_faint(hand)
    assert hand.look("unnamed()") == []


def nothing_is_cut_off_or_faint(hand: Hand) -> None:
    wide, room = hand.page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide <= room
    assert hand.look("cut()") == []
    assert hand.look("faint()") == []


def test_a_page_of_another_site_can_neither_look_nor_answer(recording: Path, serve: Serve, visit: Visit) -> None:
    """Another port of the same machine is the same site to the browser: the cookie goes along, and does not help."""
    server = serve(recording)
    hand = visit(server.url)
    base = server.url.split("?")[0]

    class Foreign(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>foreign</title>")

        def log_message(self, *words: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Foreign) as foreign:
        threading.Thread(target=foreign.serve_forever, daemon=True).start()
        page = hand.page.context.new_page()
        page.goto(f"http://127.0.0.1:{foreign.server_address[1]}/")
        tried = Hand(page).look(f"intrude('{base}')")
        foreign.shutdown()
    assert tried[1:] == ["refused", "refused"]
    assert not recording.with_name("out.seeds.toml").exists()


def shot(hand: Hand, name: str) -> None:
    """What is on the screen, as a picture for the docs."""
    from PIL import Image

    hand.page.wait_for_timeout(600)
    picture = Image.open(io.BytesIO(hand.page.screenshot())).convert("RGB")
    picture.quantize(256, Image.Quantize.MAXCOVERAGE).save(
        Path(os.environ["SPHEREMCAP_SCREENSHOTS"]) / f"operator-{name}.png", optimize=True
    )


for_the_docs = pytest.mark.skipif(
    "SPHEREMCAP_SCREENSHOTS" not in os.environ, reason="SPHEREMCAP_SCREENSHOTS names no folder for them"
)


@for_the_docs
def test_the_chair_in_a_picture_for_the_docs(tmp_path: Path, serve: Serve, visit: Visit) -> None:
    """SPHEREMCAP_SCREENSHOTS=docs/images ./run test tests/operator -k chair_in_a_picture makes this one alone."""
    video, places = write_chair(tmp_path / "session.mp4")
    hand = visit(serve(video).url, 1200, 760)
    hand.press("w")
    for on, (x, y) in places:
        hand.page.check(f"#clicked input[value={on}]")
        hand.point(x, y)
    hand.wait(lambda: hand.page.locator("#clicks li").count() == len(places))
    hand.page.locator("#clicks button:has-text('is it on')").click()
    hand.wait(lambda: hand.said("#saved").startswith("Saved"))
    shot(hand, "chair")


@for_the_docs
def test_pictures_for_the_docs(tmp_path: Path, serve: Serve, visit: Visit) -> None:
    """docs/operator.md shows them: SPHEREMCAP_SCREENSHOTS=docs/images ./run test tests/operator -k docs."""
    sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
    from person import BACK, FRAMES, session

    from spheremcap.synth import render
    from spheremcap.synth.scenarios import SCENARIOS, Scenario

    SCENARIOS["person"] = Scenario("two occlusions, an exchange, an exit", FRAMES, session)
    made = render("person", tmp_path / "session")
    truth = {int(row["frame"]): row for row in csv.DictReader(made.truth.open()) if row["x_px"]}

    def place(frame: int) -> Circle:
        return Circle(*(float(truth[frame][key]) for key in ("x_px", "y_px", "r_px")))

    def seed(hand: Hand, circle: Circle) -> None:
        hand.drag((circle.x_px + 1, circle.y_px), (circle.x_px + 1 + circle.r_px, circle.y_px))
        hand.snapped()

    made.seeds_file.unlink()
    hand = visit(serve(made.video, "--settings", str(made.settings)).url, 1200, 760)
    hand.click("#propose")
    hand.wait(lambda: hand.seen("#proposals"), 60)
    hand.page.locator("#proposals").scroll_into_view_if_needed()
    shot(hand, "proposals")
    hand.page.evaluate("document.querySelector('aside').scrollTop = 0")
    hand.to_frame(0)
    seed(hand, place(0))
    hand.page.check("#show-mask")
    hand.click("#zoom-circle").click("#zoom-out").click("#zoom-out")
    shot(hand, "seed")
    hand.press("Enter").saved()
    hand.click("#track")
    hand.wait(lambda: hand.seen("#open-written"), 120)
    hand.click("#open-written")
    hand.wait(lambda: hand.said("#kind") == "tracked recording")
    hand.wait(lambda: " open" in hand.said("#requests-left") and not hand.said("#reading"))
    hand.click("#zoom-fit").press("r")
    hand.wait(lambda: hand.page.locator("#strip img >> nth=9").evaluate("i => i.naturalWidth") == 112)
    shot(hand, "request")
    hand.click("#hide-all").saved()
    hand.to_frame(BACK)
    seed(hand, place(BACK))
    hand.click("#save")
    hand.wait(lambda: hand.seen("#trial"), 60)
    hand.to_frame(BACK + 25)
    shot(hand, "trial")
