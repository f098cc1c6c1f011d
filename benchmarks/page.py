"""How quickly the operator's page answers: python benchmarks/page.py [FOLDER]

Renders a racing session (1280x720), encodes it with a key frame every 60 pictures, opens it with `spheremcap annotate`
and asks for pictures as a hand does: scrubbing (the key frame before), resting (the exact frame, anywhere in its group)
and stepping, over HTTP and in chromium, where the time ends when the picture is handed to the canvas. Then it opens a
video of 432,000 frames, made by repetition.
"""

import http.client
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path
from urllib.parse import urlsplit

import av
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "operator"))
from hand import FLAGS, Annotate, Hand, find_chromium

from spheremcap.io.video import VideoSource
from spheremcap.synth import render

FRAMES, KEY_EVERY, LOOKS = 480, 60, 60
LONG = 432_000


def film(folder: Path) -> Path:
    """The session with a key frame every KEY_EVERY pictures and none between."""
    path = folder / "keys.mp4"
    if not path.exists():
        session = render("racing", folder / "racing", frames=FRAMES, overwrite=True)
        with VideoSource(session.video) as source, av.open(str(path), "w") as container:
            options = {"g": str(KEY_EVERY), "keyint_min": str(KEY_EVERY), "sc_threshold": "0", "bf": "0", "crf": "18"}
            stream = container.add_stream("libx264", rate=240, options=options)
            stream.width, stream.height, stream.pix_fmt = source.width_px, source.height_px, "yuv420p"
            for frame in source.frames():
                picture = av.VideoFrame.from_ndarray(frame.full, format="bgr24").reformat(format="yuv420p")
                picture.pts, picture.time_base = frame.index, Fraction(1, 240)
                container.mux(stream.encode(picture))
            container.mux(stream.encode(None))
    return path


def long_film(folder: Path, short: Path) -> Path:
    """The packets of a film again and again, up to LONG pictures."""
    path = folder / "long.mp4"
    if not path.exists():
        with av.open(str(short)) as given, av.open(str(path), "w", options={"movflags": "faststart"}) as container:
            source = given.streams.video[0]
            packets = [(bytes(p), p.is_keyframe) for p in given.demux(source) if p.size]
            stream = container.add_stream_from_template(source)
            for number in range(LONG):
                data, key = packets[number % len(packets)]
                packet = av.Packet(data)
                packet.pts = packet.dts = number
                packet.time_base, packet.stream, packet.is_keyframe, packet.duration = Fraction(1, 240), stream, key, 1
                container.mux(packet)
    return path


class Viewer:
    """Asks for pictures as the page does, over one connection."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        assert parts.hostname is not None
        self._connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=60)
        self._headers = {"Cookie": f"spheremcap-{parts.port}={parts.query.removeprefix('token=')}"}

    def look(self, frame: int, *, exact: bool) -> float:
        """Milliseconds until the whole picture is there."""
        begun = time.perf_counter()
        self._connection.request("GET", f"/picture/{frame}?exact={int(exact)}&viewer=a", headers=self._headers)
        response = self._connection.getresponse()
        response.read()
        assert response.status == 200, response.status
        return 1000 * (time.perf_counter() - begun)


def table(name: str, times_ms: Iterable[float]) -> None:
    """A line: median, 95th percentile and longest of the times."""
    ordered = sorted(times_ms)
    at95 = ordered[min(len(ordered) - 1, int(0.95 * len(ordered)))]
    print(f"{name:42s} {statistics.median(ordered):7.1f} {at95:7.1f} {ordered[-1]:7.1f} ms", flush=True)


def looks(look: Callable[[int, bool], float], rest: Callable[[], None], where: str, last: int) -> None:
    """The three kinds of look, at LOOKS places each."""
    places = random.Random(1).sample(range(last), min(LOOKS, last))
    table(f"{where}: key frame while scrubbing", [look(place, False) for place in places])
    exact = []
    for place in places:
        exact.append(look(place, True))
        rest()
    table(f"{where}: exact frame when the hand rests", exact)
    steps, at = [], 100
    look(at, True)
    rest()
    for step in [1] * 70 + [-1] * 90:
        at += step
        steps.append(look(at, True))
        time.sleep(0.02)
    table(f"{where}: step to a neighbour", steps)


def in_browser(url: str, last: int) -> None:
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=find_chromium(), args=FLAGS)
        hand = Hand(browser.new_context(viewport={"width": 1440, "height": 900}).new_page()).open(url)
        page = hand.page
        shown = """(act) => new Promise(done => {
            const caption = document.getElementById('caption'), begun = performance.now();
            new MutationObserver((_, o) => { o.disconnect(); done(performance.now() - begun); })
                .observe(caption, {childList: true, characterData: true, subtree: true}); %s })"""
        goto = (
            shown % "const i = document.getElementById('frame'); i.value = act; i.dispatchEvent(new Event('change'));"
        )
        key = shown % "document.dispatchEvent(new KeyboardEvent('keydown', {key: act}));"
        drag = (
            shown
            % """const c = document.getElementById('lanes'), b = c.getBoundingClientRect();
            const at = {clientX: b.left + act * b.width, clientY: b.top + 12, bubbles: true, pointerId: 1};
            c.setPointerCapture = () => {}; c.dispatchEvent(new PointerEvent('pointerdown', at));
            window.addEventListener('mouseup', () => 0); c.dispatchEvent(new PointerEvent('pointercancel', at));"""
        )
        places = random.Random(2).sample(range(last), min(LOOKS, last))
        exact = []
        for place in places:
            exact.append(page.evaluate(goto, str(place)))
            hand.settled()
            page.wait_for_timeout(150)
        table("chromium: exact frame when the hand rests", exact)
        hand.to_frame(100)
        page.wait_for_timeout(600)
        page.evaluate("document.activeElement.blur()")
        steps = []
        for name in ["ArrowRight"] * 70 + ["ArrowLeft"] * 90:
            steps.append(page.evaluate(key, name))
            page.wait_for_timeout(30)
        table("chromium: step to a neighbour", steps)
        scrubs = []
        for place in places:
            scrubs.append(page.evaluate(drag, place / last))
            hand.settled()
            page.wait_for_timeout(100)
        table("chromium: first picture while scrubbing", scrubs)
        browser.close()


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp())
    folder.mkdir(exist_ok=True)
    path = film(folder)
    print(f"{'':42s} {'median':>7s} {'95 %':>7s} {'longest':>7s}")
    server = Annotate(path)
    viewer = Viewer(server.url)
    viewer.look(0, exact=True)
    looks(lambda frame, exact: viewer.look(frame, exact=exact), lambda: time.sleep(0.3), "HTTP", FRAMES)
    server.end()
    server = Annotate(path)
    in_browser(server.url, FRAMES)
    server.end()
    long = long_film(folder, path)
    begun = time.perf_counter()
    server = Annotate(long)
    opened = time.perf_counter() - begun
    viewer = Viewer(server.url)
    first = viewer.look(0, exact=True)
    size = f"{LONG} frames, {long.stat().st_size / 1e9:.1f} GB"
    print(f"{size}: the address after {opened:.2f} s, the first picture {first:.0f} ms later")
    looks(lambda frame, exact: viewer.look(frame, exact=exact), lambda: time.sleep(0.3), "long", LONG)
    server.end()


if __name__ == "__main__":
    main()
