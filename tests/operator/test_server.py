"""Over HTTP: who is let in, what is refused, and that pictures are those of the file."""

import http.client
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from spheremcap.config import load_seeds
from spheremcap.errors import UsageError
from spheremcap.io.pictures import open_pictures
from spheremcap.operator.page import Page
from spheremcap.operator.server import Server

Paged = Callable[..., Page]


class Client:
    """Raw requests, so that every header can be wrong."""

    def __init__(self, server: Server) -> None:
        parts = urlsplit(server.url)
        self.host, self.port, self.token = parts.hostname, parts.port, parts.query.removeprefix("token=")
        self.cookie = f"spheremcap-{self.port}={self.token}"

    def __call__(self, path: str, body: object = None, *, raw: bytes | None = None, **headers: str | None):
        """Status, headers and body; `raw` is sent as it is, a header of None is left out."""
        sent = {"Host": f"{self.host}:{self.port}", "Cookie": self.cookie, **headers}
        data = raw if raw is not None else None if body is None else json.dumps(body).encode()
        connection = http.client.HTTPConnection(self.host, self.port, timeout=20)
        connection.putrequest("POST" if data is not None else "GET", path, skip_host=True, skip_accept_encoding=True)
        for name, value in sent.items():
            if value is not None:
                connection.putheader(name, value)
        if data is not None:
            connection.putheader("Content-Length", str(len(data)))
        connection.endheaders(data)
        response = connection.getresponse()
        text = response.read()
        connection.close()
        return response.status, {k.lower(): v for k, v in response.getheaders()}, text

    def json(self, path: str, body: object = None) -> dict:
        status, _, text = self(path, body)
        assert status == 200, text
        return json.loads(text)


@pytest.fixture
def client(recording: Path, paged: Paged) -> Iterator[Client]:
    with Server(paged(recording)) as server:
        yield Client(server)


def test_the_first_address_sets_a_cookie_that_no_script_reads_and_no_other_site_sends(client: Client) -> None:
    status, headers, text = client(f"/?token={client.token}", Cookie=None)
    assert status == 200
    assert b"<canvas" in text
    assert headers["set-cookie"] == f"{client.cookie}; HttpOnly; SameSite=Strict; Path=/"
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["cache-control"] == "no-store"
    assert headers["x-frame-options"] == "DENY"
    status, headers, _ = client("/")
    assert status == 200
    assert "set-cookie" not in headers


PATHS = ["/", "/session", "/picture/0?exact=1", "/static/main.js", "/answers", "/pulse"]


@pytest.mark.parametrize("path", PATHS)
def test_without_the_token_nobody_gets_in(client: Client, path: str) -> None:
    for cookie in (None, "", f"spheremcap-{client.port}=", f"spheremcap-{client.port}={client.token}x", "other=1"):
        status, headers, text = client(path, Cookie=cookie)
        assert status == 403
        assert b"spheremcap annotate" in text
        assert "set-cookie" not in headers


def test_the_token_counts_in_the_first_address_only(client: Client) -> None:
    assert client(f"/session?token={client.token}", Cookie=None)[0] == 403
    assert client("/?token=wrong", Cookie=None)[0] == 403
    assert client("/?token=wrong")[0] == 403
    assert client(f"/?token={client.token}", body={}, Cookie=None)[0] == 403


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1", "localhost", "127.0.0.1:1", "", None])
def test_a_request_that_names_another_host_is_refused(client: Client, path: str, host: str | None) -> None:
    assert client(path, Host=host)[0] in (400, 403)


def test_its_own_names_are_let_in(client: Client) -> None:
    assert client("/session", Host=f"localhost:{client.port}")[0] == 200
    assert client("/session", Origin=f"http://127.0.0.1:{client.port}")[0] == 200


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "http://127.0.0.1",
        "https://127.0.0.1:{port}",
        "http://127.0.0.1:{port}.evil.example",
    ],
)
def test_a_page_of_another_site_is_refused(client: Client, recording: Path, origin: str) -> None:
    origin = origin.format(port=client.port)
    answer = {"kind": "keep", "marker": "wrist", "frame": 40, "to_frame": 49}
    status, _, text = client("/answer", answer, Origin=origin)
    assert (status, b"another site" in text) == (403, True)
    assert client("/session", Origin=origin)[0] == 403
    assert not (recording.parent / "out.seeds.toml").exists()


def test_the_address_is_the_loopback_with_a_port_of_its_own(recording: Path, paged: Paged) -> None:
    page = paged(recording)
    with Server(page) as one, Server(page) as other:
        assert urlsplit(one.url).hostname == "127.0.0.1"
        assert urlsplit(one.url).port != urlsplit(other.url).port
        assert len(Client(one).token) >= 32
        assert Client(one).token != Client(other).token
    with pytest.raises(UsageError, match="no address of this machine"):
        Server(page, "203.0.113.7")


@pytest.mark.parametrize(
    "path",
    ["/static/../server.py", "/static/%2e%2e/server.py", "/static//etc/passwd", "/static/..%2fserver.py",
     "/picture/..%2f..%2fetc", "/picture/-1", "/crop/x?x=1&y=1&half=4", "/../../etc/passwd"],
)  # fmt: skip
def test_no_request_reaches_a_file(client: Client, path: str) -> None:
    status, _, text = client(path)
    assert status in (400, 404)
    assert b"import" not in text
    assert b"root:" not in text


def test_an_exact_picture_is_that_of_the_file_and_a_quick_one_its_key_frame(client: Client, recording: Path) -> None:
    status, headers, text = client("/picture/33?exact=1&viewer=a")
    assert (status, headers["x-frame"], headers["content-type"]) == (200, "33", "image/jpeg")
    assert float(headers["x-seconds"]) == pytest.approx(33 / 240, abs=1e-6)
    shown = cv2.imdecode(np.frombuffer(text, np.uint8), cv2.IMREAD_COLOR)
    with open_pictures(recording, topic="/camera/video") as pictures:
        exact, key = pictures.frame(33).full, pictures.key_at(33)
    assert np.abs(shown.astype(int) - exact).mean() < 3
    assert client("/picture/33?exact=0&viewer=a")[1]["x-frame"] == str(key)
    status, _, text = client("/patch/33?x=80&y=60&width=9&height=7")
    window = cv2.imdecode(np.frombuffer(text, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(window, exact[60:67, 80:89])
    status, _, text = client("/crop/33?x=83&y=70&half=20")
    assert cv2.imdecode(np.frombuffer(text, np.uint8), cv2.IMREAD_COLOR).shape == (112, 112, 3)
    for query in ("x=0&y=0&half=40", "x=319&y=239&half=40", "x=-900&y=0&half=40"):
        status, _, text = client(f"/crop/33?{query}")
        shown = cv2.imdecode(np.frombuffer(text, np.uint8), cv2.IMREAD_COLOR)
        corner = shown[-8:, -8:] if "319" in query else shown[:8, :8]
        assert abs(corner.astype(int) - 40).max() < 12  # out of the picture it is dark


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("/picture/130?exact=1", "there is no frame"),
        ("/patch/3?x=900&y=0&width=5&height=5", "has to be a part"),
        ("/patch/3?x=0&y=0&width=five&height=5", "width has to be a whole number"),
        ("/states?first=0", "last has to be a whole number"),
        ("/time?seconds=soon", "a number of seconds"),
        ("/time?seconds=nan", "a number of seconds"),
    ],
)
def test_a_question_that_makes_no_sense_is_answered_in_one_line(client: Client, path: str, word: str) -> None:
    status, _, text = client(path)
    assert status == 400
    assert word in text.decode()
    assert "\n" not in text.decode()


@pytest.mark.parametrize(
    "body",
    [
        {"kind": "circle", "marker": "wrist", "frame": 75},
        {"kind": "hidden", "marker": "wrist", "frame": 75},
        {"kind": "keep", "marker": "wrist", "frame": 75, "to_frame": 80, "path": "/etc/passwd"},
        {"kind": "keep", "marker": "wrist", "frame": -1, "to_frame": 80},
        {"kind": "circle", "marker": "wrist", "frame": 75, "circle": {"x_px": 1, "y_px": 1, "r_px": 0}},
        {"kind": "circle", "marker": "wrist", "frame": 75, "to_frame": 9, "circle": {"x_px": 1, "y_px": 1, "r_px": 3}},
        ["circle"],
        "circle",
    ],
)
def test_an_answer_that_is_none_is_refused(client: Client, recording: Path, body: object) -> None:
    status, _, text = client("/answer", body)
    assert status == 400, text
    assert not (recording.parent / "out.seeds.toml").exists()


def test_bodies_that_are_no_json_or_too_large_are_refused(client: Client) -> None:
    assert client("/answer", raw=b"\xff\xfe")[0] == 400
    assert client("/answer", raw=b"[" * 100_000)[0] == 400
    assert client("/answer", raw=b" " * (1 << 21))[0] == 413
    assert client("/calibration", raw=b"\xff\xfe\x00")[0] == 400
    assert client("/answer")[0] == 405


def test_an_answer_is_on_disk_when_it_is_answered_for(client: Client, recording: Path) -> None:
    said = client.json("/answer", {"kind": "keep", "marker": "wrist", "frame": 40, "to_frame": 49, "author": "bob"})
    assert said["saved"]["author"] == "bob"
    assert load_seeds(recording.parent / "out.seeds.toml")[-1].author == "bob"
    client.json("/take-back", {"kind": "keep", "marker": "wrist", "frame": 40})
    assert len(load_seeds(recording.parent / "out.seeds.toml")) == 2


def test_a_pulse_waits_for_news_and_is_there_at_once_when_there_are(client: Client) -> None:
    mark = client.json("/pulse")["mark"]
    answer = {"kind": "keep", "marker": "wrist", "frame": 40, "to_frame": 49}
    threading.Timer(0.5, client.json, ("/answer", answer)).start()
    now = client.json(f"/pulse?seen={mark}")
    assert now["mark"] != mark


def test_a_snap_has_its_numbers_and_its_mask(client: Client) -> None:
    said = client.json("/snap", {"marker": "wrist", "frame": 20, "circle": {"x_px": 75, "y_px": 69, "r_px": 17}})
    assert abs(said["circle"]["x_px"] - 74) < 0.5
    assert said["mask"].startswith("data:image/png;base64,")
    assert said["selected"] > 500
    assert len(said["sd_px"]) == 3
    assert client("/snap", {"marker": "wrist", "frame": 20, "circle": {"x_px": 900, "y_px": 9, "r_px": 4}})[0] == 400


def test_nothing_but_the_seeds_file_is_written_beside_the_recording(client: Client, recording: Path) -> None:
    client.json("/answer", {"kind": "hidden", "marker": "wrist", "frame": 40, "to_frame": 49})
    for path, body in (("/preset", {"preset": "thesis"}), ("/marker", {"name": "x", "diameter_mm": 40})):
        assert client(path, body)[0] == 400
    assert client("/track", {})[0] == 400
    assert sorted(p.name for p in recording.parent.iterdir()) == ["out.mcap", "out.seeds.toml"]


def test_it_ends_at_once_though_a_page_waits_for_news(recording: Path, paged: Paged) -> None:
    with Server(paged(recording)) as server:
        client = Client(server)
        mark = client.json("/pulse")["mark"]

        def wait() -> None:
            with suppress(OSError, http.client.HTTPException):
                client(f"/pulse?seen={mark}")

        threading.Thread(target=wait, daemon=True).start()
        time.sleep(0.3)
        begun = time.monotonic()
    assert time.monotonic() - begun < 4
