"""A person's hand in a real browser: Debian's chromium, driven by Playwright, on a page that `annotate` serves."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
LOOK = (Path(__file__).parent / "look.js").read_text()
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def find_chromium() -> str | None:
    """A chromium of this machine's; None when there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Program:
    """spheremcap as a process of its own that serves the page; `url` is what it prints."""

    def __init__(self, *arguments: str | Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "spheremcap", *map(str, arguments)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "CI": "true"},
        )  # fmt: skip
        self.url = ""

    def url_on(self, stream: IO[str] | None) -> str:
        """Waits for the address on its standard output or error."""
        assert stream is not None
        for line in stream:
            if line.startswith("http://127.0.0.1:"):
                return line.strip()
        raise AssertionError(f"it ended without an address: {self.process.communicate()}")

    def kill(self) -> None:
        """As a crash or a power cut would."""
        self.process.kill()
        self.process.communicate()

    def end(self) -> int:
        """As Ctrl-C does, if it has not ended; the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=20)
        return self.process.returncode


class Annotate(Program):
    """`spheremcap annotate FILE`."""

    def __init__(self, path: Path, *more: str) -> None:
        super().__init__("annotate", path, "--no-browser", "--author", "ada", *more)
        self.url = self.url_on(self.process.stdout)


class Hand:
    """What a person does on a page; `page` is Playwright's. `clicks` counts presses of mouse and keys."""

    def __init__(self, page: Any, pause_s: float = 0.0) -> None:
        self.page = page
        self.clicks = 0
        self._pause_s = pause_s
        self.errors: list[str] = []
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    def open(self, url: str) -> "Hand":
        self.page.goto(url)
        self.settled()
        return self

    def wait(self, what: Callable[[], Any], seconds: float = 30) -> Any:
        """Until `what` is so. Fails with what the page says when it never is."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            found = what()
            if found:
                return found
            self.page.wait_for_timeout(40)
        raise AssertionError(f"it never was so; the page says: {self.said('#message')!r}, {self.said('#saved')!r}")

    def said(self, place: str) -> str:
        return self.page.locator(place).inner_text()

    def seen(self, place: str) -> bool:
        return self.page.locator(place).is_visible()

    def look(self, question: str) -> Any:
        """What a function of look.js says of the page."""
        return self.page.evaluate(f"() => {{ {LOOK}\nreturn {question}; }}")

    def settled(self) -> "Hand":
        """The exact picture of the frame is on the screen."""
        self.wait(lambda: self.shown() == self.page.input_value("#frame") != "" and not self.seen("#busy"))
        return self

    def shown(self) -> str:
        found = re.match(r"Frame (\d+) of [^(]*$", self.said("#caption"))
        return found[1] if found else ""

    def press(self, keys: str, times: int = 1) -> "Hand":
        for _ in range(times):
            self._pace()
            self.page.keyboard.press(keys)
        return self

    def click(self, place: str) -> "Hand":
        self._pace()
        self.page.click(place, timeout=10_000)
        return self

    def type(self, place: str, text: str) -> "Hand":
        self.click(place)
        self.page.fill(place, text)
        return self

    def to_frame(self, frame: int) -> "Hand":
        """By its number, with the keyboard."""
        self.press("g")
        self.page.keyboard.type(str(frame))
        self.clicks += 1
        self.page.keyboard.press("Enter")
        return self.settled()

    def on_screen(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Where a place of the whole picture, fitted to the screen, is."""
        box = self.page.locator("#picture").bounding_box()
        width, height = self.page.evaluate("fetch('/session').then(r => r.json()).then(s => [s.width, s.height])")
        scale = min(box["width"] / width, box["height"] / height)
        left, top = box["x"] + (box["width"] - width * scale) / 2, box["y"] + (box["height"] - height * scale) / 2
        return left + (x_px + 0.5) * scale, top + (y_px + 0.5) * scale

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> "Hand":
        """From one place of the picture to another."""
        self._pace()
        mouse, (x0, y0), (x1, y1) = self.page.mouse, self.on_screen(*start), self.on_screen(*end)
        mouse.move(x0, y0)
        mouse.down()
        for k in range(1, 6):
            mouse.move(x0 + (x1 - x0) * k / 5, y0 + (y1 - y0) * k / 5)
        mouse.up()
        return self

    def point(self, x_px: float, y_px: float) -> "Hand":
        """Press and let go at a place of the picture."""
        return self.drag((x_px, y_px), (x_px, y_px))

    def circle(self) -> tuple[float, float, float] | None:
        """The circle in hand."""
        texts = [self.page.input_value(f"#{name}") for name in "xyr"]
        return None if "" in texts else tuple(map(float, texts))  # type: ignore[return-value]

    def snapped(self) -> tuple[float, float, float]:
        """The circle, once its uncertainty is shown."""
        self.wait(lambda: "Uncertainty" in self.said("#facts"))
        found = self.circle()
        assert found is not None
        return found

    def saved(self) -> "Hand":
        """The page says saved."""
        self.wait(lambda: self.said("#saved").startswith("Saved"))
        return self

    def tab_to(self, place: str) -> "Hand":
        """With the Tab key alone."""
        for _ in range(80):
            if self.page.evaluate(f"document.activeElement === document.querySelector('{place}')"):
                return self
            self.page.keyboard.press("Tab")
        raise AssertionError(f"{place} cannot be reached with Tab")

    def reload(self) -> "Hand":
        self.page.reload()
        return self.settled()

    def _pace(self) -> None:
        self.clicks += 1
        if self._pause_s:
            self.page.wait_for_timeout(1000 * self._pause_s)
