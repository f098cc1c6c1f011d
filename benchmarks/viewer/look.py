"""Open a recording in Lichtblick with its layout, in a browser without a screen, and keep a picture of the window.

    python benchmarks/viewer/look.py LICHTBLICK RECORDING.mcap LAYOUT.json -o window.png --at 1.5
    python benchmarks/viewer/look.py LICHTBLICK ws://127.0.0.1:8765 LAYOUT.json -o window.png

LICHTBLICK is the folder of its web build (see build.sh here), `--at` are seconds after the recording's first message.
Of `spheremcap live` or `view` the address is given that it prints.
Needs playwright (an extra of the `dev` ones) and Chromium, /usr/bin/chromium unless CHROMIUM says otherwise.
"""

import argparse
import os
import re
import sys
import threading
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

from playwright.sync_api import sync_playwright

from spheremcap.core.time import NS_PER_S, format_time
from spheremcap.io.summary import summarise

BROWSER = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
PLACEHOLDER = "/*LICHTBLICK_SUITE_DEFAULT_LAYOUT_PLACEHOLDER*/"


class Files(SimpleHTTPRequestHandler):
    """The viewer, with the layout as its default, and the recording in the ranges that it asks for."""

    def __init__(self, *args, recording: Path, layout: Path, **kwargs) -> None:
        self.recording, self.layout = recording, layout
        super().__init__(*args, **kwargs)

    def do_GET(self) -> None:
        if self.path.startswith("/recording.mcap"):
            self._range()
        elif self.path.partition("?")[0] in ("/", "/index.html"):
            page = (Path(self.directory) / "index.html").read_text(encoding="utf-8")
            self._send(page.replace(PLACEHOLDER, self.layout.read_text(encoding="utf-8")).encode(), "text/html")
        else:
            super().do_GET()

    def do_HEAD(self) -> None:
        if self.path.startswith("/recording.mcap"):
            self._range()
        else:
            super().do_HEAD()

    def _range(self) -> None:
        size = self.recording.stat().st_size
        asked = re.match(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        start = int(asked[1]) if asked else 0
        end = min(int(asked[2]) if asked and asked[2] else size - 1, size - 1)
        self.send_response(206 if asked else 200)
        self.send_header("Content-Type", "application/octet-stream")
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(end - start + 1))
        if asked:
            self.send_header("Content-Range", f"bytes {start}-{end}/{size}")
        self.end_headers()
        if self.command == "GET":
            with self.recording.open("rb") as file:
                file.seek(start)
                with suppress(ConnectionError):  # the viewer asks anew for what it needs first
                    self.wfile.write(file.read(end - start + 1))

    def _send(self, body: bytes, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args) -> None:
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("lichtblick", type=Path)
    parser.add_argument("recording", help="a file, or the ws:// address of one that is shown as it goes on")
    parser.add_argument("layout", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--at", type=float, default=1.0, help="seconds after the first message")
    parser.add_argument("--wait", type=float, default=20.0, help="seconds that the viewer has to load")
    parser.add_argument("--size", default="1600x1000")
    given = parser.parse_args()
    serve = partial(Files, recording=Path(given.recording), layout=given.layout, directory=str(given.lichtblick))
    server = ThreadingHTTPServer(("127.0.0.1", 0), serve)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    here = f"http://127.0.0.1:{server.server_port}"
    if given.recording.startswith("ws://"):
        asked = f"ds=foxglove-websocket&ds.url={quote(given.recording, safe='')}"
    else:
        start_ns = summarise(Path(given.recording)).start_ns or 0
        time = format_time(start_ns + round(given.at * NS_PER_S))
        asked = f"ds=remote-file&ds.url={quote(f'{here}/recording.mcap', safe='')}&time={quote(time, safe='')}"
    width, height = map(int, given.size.split("x"))
    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=os.environ.get("CHROMIUM", "/usr/bin/chromium"), args=list(BROWSER)
        )
        page = browser.new_page(viewport={"width": width, "height": height})
        page.on("pageerror", lambda error: print(f"page: {error}"[:300], file=sys.stderr))
        page.goto(f"{here}/?{asked}", timeout=120_000)
        page.wait_for_timeout(1000 * given.wait)
        page.screenshot(path=str(given.output))
        browser.close()
    server.shutdown()


if __name__ == "__main__":
    main()
