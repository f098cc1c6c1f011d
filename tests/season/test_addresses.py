"""Inputs that lie behind an address: a copy of them, and whether they are another one than they were."""

import os
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from spheremcap.errors import SourceError
from spheremcap.interrupt import Interrupted
from spheremcap.season.addresses import fetched, looked_at

fsspec = pytest.importorskip("fsspec")


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *told: Any) -> None:
        pass


@pytest.fixture
def site(tmp_path: Path) -> Iterator[str]:
    """The address of a web server that has the files of tmp_path / "there"; like many, it gives no parts of a file."""
    pytest.importorskip("aiohttp")
    (tmp_path / "there").mkdir()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(tmp_path / "there")))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_a_file_of_a_web_server_is_copied_and_known_again(site, tmp_path):
    there, content = tmp_path / "there" / "v.mp4", os.urandom(20 << 20)
    there.write_bytes(content)
    os.utime(there, (1e9, 1e9))
    size, mark = looked_at(f"{site}/v.mp4")
    assert size == len(content)
    copy = fetched(f"{site}/v.mp4", tmp_path / "copy")
    assert (copy.name, copy.read_bytes()) == ("v.mp4", content)
    assert looked_at(f"{site}/v.mp4") == (size, mark)
    os.utime(there, (1e9, 1e9 + 5))  # as if others had been written over it
    assert looked_at(f"{site}/v.mp4")[1] != mark


def test_what_a_web_server_does_not_have_or_that_is_none_is_one_line(site, tmp_path):
    with pytest.raises(SourceError, match=r"/no.mp4: nothing is there \(404, .*\); check the address"):
        looked_at(f"{site}/no.mp4")
    with pytest.raises(SourceError, match=r"v.mp4: nothing is there \(Cannot connect .*\); check") as error:
        looked_at("http://127.0.0.1:9/v.mp4")
    assert "\n" not in str(error.value)


class _ReadAt(fsspec.get_filesystem_class("file")):
    """Says when a file was last read, as SFTP does."""

    protocol = "readat"

    def info(self, path: str, **more: Any) -> dict[str, Any]:
        told: dict[str, Any] = super().info(path, **more)
        return told | {"time": os.stat(told["name"]).st_atime}


def test_reading_a_file_does_not_make_it_another_one(tmp_path):
    fsspec.register_implementation("readat", _ReadAt, clobber=True)
    there = tmp_path / "v.mp4"
    there.write_bytes(b"a video")
    before = looked_at(f"readat://{there}")
    os.utime(there, (1, there.stat().st_mtime))
    assert looked_at(f"readat://{there}") == before
    os.utime(there, (1, 1))
    assert looked_at(f"readat://{there}") != before


def test_copying_stops_when_it_is_told_to(tmp_path):
    there = tmp_path / "v.mp4"
    there.write_bytes(bytes(20 << 20))

    def ended() -> None:
        raise Interrupted

    with pytest.raises(Interrupted):
        fetched(f"file://{there}", tmp_path / "copy", ended)
    assert (tmp_path / "copy" / "v.mp4").stat().st_size < 20 << 20
