"""What it costs a person to finish a session on the operator's page: python benchmarks/person.py [FOLDER]

A session is rendered in which a card hides the marker twice; the second time another ball of the same colour takes its
place behind it, and the marker itself comes back from below; then it leaves the picture. A script does what a person
does, at a person's pace (KEY_S before every key, MOUSE_S before every click or drag, LOOK_S to take in each request and
each result), and says how many seconds and presses it took, apart from the seconds that the tracker was waited for, and
how much of the track is right in the end. What the hand points at is taken from the truth, two pixels beside it.

With a FOLDER that has them, clips of real cameras are finished as well; what a person does about them was found by
looking at them. The clips are not in the repository.
"""

import csv
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "operator"))
from hand import FLAGS, Annotate, Hand, find_chromium

import spheremcap
from spheremcap.core.circle import Circle
from spheremcap.synth import render
from spheremcap.synth.parts import Ball, Card, World
from spheremcap.synth.scenarios import FRAME_S, GREEN, NARROW, SCENARIOS, Scenario, escort, image_path, world

KEY_S, MOUSE_S, LOOK_S = 0.3, 1.2, 1.5
FRAMES = 560
SWAP, UNSEEN, BACK = 200, 247, 280  # when the other ball takes its place, the last frame without it, and one with it


def eased(frame: Any, stops: list[tuple[int, float]]) -> Any:
    """Between stops (frame, value) with no leap in speed."""
    frames, values = np.array(stops, float).T
    k = np.clip(np.searchsorted(frames, frame, "right") - 1, 0, len(frames) - 2)
    share = np.clip((frame - frames[k]) / (frames[k + 1] - frames[k]), 0, 1)
    return values[k] + (values[k + 1] - values[k]) * (0.5 - 0.5 * np.cos(np.pi * share))


def session(rng: np.random.Generator, frames: int) -> World:
    def wander(t: Any) -> Any:
        """Where the marker would be without the exchange: a slow wander that leaves to the right and comes back."""
        f = np.asarray(t) / FRAME_S
        out = eased(f, [(0, 0), (290, 0), (390, 1000), (410, 1000), (510, 0)])
        x, y = 560 + 120 * np.sin(2 * np.pi * f / 210) + out, 260 + 60 * np.sin(2 * np.pi * f / 130)
        return np.stack([x, y, 1.0 + 0.05 * np.sin(2 * np.pi * f / 300)], axis=1)

    def marker(t: Any) -> Any:
        place = wander(t)
        place[:, 1] += eased(np.asarray(t) / FRAME_S, [(182, 0), (196, 600), (244, 600), (276, 150)])
        return place

    def other(t: Any) -> Any:
        place = wander(t)
        place[:, 0] += np.where(np.abs(np.asarray(t) / FRAME_S - 300) > 300 - SWAP, 4000, 0)
        return place

    path = image_path(NARROW, wander)
    stops = [(0, 300.0), (60, 0.0), (105, -300.0), (180, 0.0), (232, 300.0), (560, 300.0)]
    card = Card(escort(path, stops, 8, 0.0), (60.0, 340.0), 0.5, texture="brick")
    return world(
        frames, Ball("wrist", image_path(NARROW, marker), GREEN),
        Ball("", image_path(NARROW, other), GREEN, tracked=False), cards=(card,),
    )  # fmt: skip


CLIPS: dict[str, list[tuple[str, int, Circle | None]]] = {
    # A ball in a hand that comes and goes: seen a second time before the seed, half out of the picture on 278.
    "green_ball_hand3.mp4": [
        ("seed", 178, Circle(924.8, 114.3, 34.3)),
        ("circle", 93, Circle(1108.0, 134.0, 38.0)),
        ("hide", 111, None),
        ("keep", 278, None),
        ("hide", 435, None),
    ],
    # A toss against a wall: seeded at its top, it leaves the picture downwards.
    "green_ball_toss.mp4": [("seed", 26, Circle(504.8, 48.0, 22.8)), ("gone", 37, None)],
}
"""What is done about each, on which frame."""


class Person:
    """Does things on a page at a person's pace, and counts."""

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        self.presses = 0
        self.acting_s = self.waiting_s = 0.0

    def key(self, name: str, times: int = 1) -> None:
        for _ in range(times):
            self._act(KEY_S, lambda: self.hand.page.keyboard.press(name))

    def click(self, place: str) -> None:
        self._act(MOUSE_S, lambda: self.hand.page.click(place))

    def drag(self, circle: Circle) -> None:
        """A new circle from its centre to its rim, two pixels beside what it should be."""
        x, y, r = circle
        self._act(MOUSE_S, lambda: self.hand.drag((x + 1.5, y - 1.5), (x + 1.5 + r + 1, y - 1.5)))
        self.wait(lambda: "Uncertainty" in self.hand.said("#facts"))

    def type(self, text: str) -> None:
        for letter in text:
            self._act(KEY_S, lambda letter=letter: self.hand.page.keyboard.press(letter))  # type: ignore[misc]

    def look(self) -> None:
        self.hand.page.wait_for_timeout(1000 * LOOK_S)
        self.acting_s += LOOK_S

    def wait(self, what: Callable[[], Any], seconds: float = 300) -> None:
        """For the program."""
        begun = time.perf_counter()
        self.hand.wait(what, seconds)
        self.waiting_s += time.perf_counter() - begun

    def to_frame(self, frame: int) -> None:
        self.key("g")
        self.type(str(frame))
        self.key("Enter")
        self.wait(lambda: self.hand.shown() == str(frame))

    def _act(self, pause_s: float, act: Callable[[], Any]) -> None:
        begun = time.perf_counter()
        self.hand.page.wait_for_timeout(1000 * pause_s)
        act()
        self.presses += 1
        self.acting_s += time.perf_counter() - begun


def start(person: Person, name: str, frame: int, circle: Circle) -> None:
    """Seed the marker and track it; the recording is open then."""
    hand = person.hand
    if frame:
        person.to_frame(frame)
    person.drag(circle)
    person.click("#marker-name")
    hand.page.keyboard.press("Control+a")
    person.type(name)
    person.key("Enter")
    person.wait(lambda: name in hand.said("#markers"))
    person.click("#save")
    person.wait(lambda: hand.said("#saved").startswith("Saved"))
    person.click("#track")
    person.wait(lambda: hand.seen("#open-written"))
    person.click("#open-written")
    person.wait(lambda: hand.said("#kind") == "tracked recording" and not hand.said("#reading"))


def correct(person: Person, frame: int, circle: Circle) -> None:
    """Give a circle, look at what comes of it, accept."""
    hand = person.hand
    person.to_frame(frame)
    person.drag(circle)
    person.key("Enter")
    person.wait(lambda: hand.seen("#trial"))
    person.look()
    person.key("a")
    person.wait(lambda: not hand.seen("#trial"))


def hide_requests(person: Person) -> int:
    """Say of every request that is open that the marker was not to be seen; how many there were."""
    hand, count = person.hand, 0
    while not hand.said("#requests-left").startswith("0 of") and hand.said("#requests-left") != "none":
        left = hand.said("#requests-left")
        person.key("r")
        person.look()
        person.click("#hide-all")
        person.wait(lambda left=left: hand.said("#requests-left") != left)  # type: ignore[misc]
        count += 1
    return count


def write(person: Person) -> None:
    hand = person.hand
    person.click("#write")
    person.wait(lambda: hand.seen("#open-written"))
    person.click("#open-written")
    person.wait(lambda: not hand.seen("#write") and hand.said("#requests-left").startswith("0 of"))


def report(name: str, person: Person) -> None:
    print(
        f"{name}: {person.presses} presses in {person.acting_s:.0f} s of clicking and looking; "
        f"{person.waiting_s:.0f} s more were waited for the program",
        flush=True,
    )


def rendered(browser: Any, folder: Path) -> None:
    SCENARIOS["person"] = Scenario("two occlusions, an exchange, an exit", FRAMES, session)
    made = render("person", folder, overwrite=True)
    for path in (made.settings, made.seeds_file):
        path.unlink()
    with made.truth.open() as file:
        truth = {
            int(row["frame"]): Circle(float(row["x_px"]), float(row["y_px"]), float(row["r_px"]))
            for row in csv.DictReader(file)
            if row["x_px"] and float(row["visible"]) > 0.05
        }
    server = Annotate(made.video)
    person = Person(Hand(browser.new_context(viewport={"width": 1440, "height": 900}).new_page()).open(server.url))
    start(person, "wrist", 0, truth[0])
    score("as tracked", sorted(folder.glob("session*.mcap"))[0], truth)
    # A look along the track shows that behind the second card it has jumped to another ball.
    person.look()
    correct(person, BACK, truth[BACK])
    # What comes back on frame BACK was not to be seen before, from where it went behind the card.
    person.key("r", 2)
    person.look()
    person.key("h")
    person.to_frame(UNSEEN)
    person.key("h")
    person.wait(lambda: person.hand.said("#saved").startswith("Saved"))
    hide_requests(person)
    write(person)
    report("rendered session", person)
    server.end()
    score("in the end", max(folder.glob("session*.mcap"), key=lambda path: path.stat().st_mtime), truth)


def real(browser: Any, clip: Path, folder: Path) -> None:
    video = Path(shutil.copy(clip, folder / clip.name))
    server = Annotate(video)
    person = Person(Hand(browser.new_context(viewport={"width": 1440, "height": 900}).new_page()).open(server.url))
    for step, frame, circle in CLIPS[clip.name]:
        if step == "seed" and circle is not None:
            start(person, "ball", frame, circle)
        elif step == "circle" and circle is not None:
            correct(person, frame, circle)
        elif step == "gone":
            person.to_frame(frame)
            person.key("h")
            person.key("End")
            person.key("h")
        else:
            person.key("r")
            person.look()
            person.click("#keep" if step == "keep" else "#hide-all")
        person.look()
    person.wait(lambda: person.hand.said("#requests-left").startswith("0 of"))
    write(person)
    report(clip.name, person)
    server.end()
    last = max(folder.glob("*.mcap"), key=lambda path: path.stat().st_mtime)
    counts = Counter(spheremcap.open(last).tracks["ball"].status.tolist())
    print(
        "  in the end: " + ", ".join(f"{count} {status.lower()}" for status, count in counts.most_common()), flush=True
    )


def score(when: str, recording: Path, truth: dict[int, Circle]) -> None:
    """How often it was measured where it is in full view, and how often where it is not or is not to be seen."""
    track = spheremcap.open(recording).tracks["wrist"]
    right = wrong = 0
    for frame, status, (x, y, _) in zip(track.frame, track.status, track.circle_px, strict=True):
        if status in ("VERIFIED", "SEEDED"):
            circle = truth.get(int(frame))
            near = circle is not None and np.hypot(x - circle.x_px, y - circle.y_px) < circle.r_px
            right, wrong = right + near, wrong + (not near)
    print(
        f"  {when}: measured on {right} of the {len(truth)} frames on which it is seen; {wrong} claims are wrong",
        flush=True,
    )


def main() -> None:
    folder = Path(tempfile.mkdtemp())
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=find_chromium(), args=FLAGS)
        rendered(browser, folder)
        for name in CLIPS if len(sys.argv) > 1 else ():
            place = folder / Path(name).stem
            place.mkdir()
            real(browser, Path(sys.argv[1]) / name, place)
        browser.close()
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
