"""The newest look wins; what was asked for beside comes too; a step finds its picture decoded."""

import threading
import time
from pathlib import Path

import media
import pytest

from spheremcap.errors import UsageError
from spheremcap.io.pictures import Pictures, open_pictures
from spheremcap.operator.desk import Desk, Outdated


def film(path: Path, count: int = 60) -> Path:
    return media.video(path, count, options={"bf": "0", "g": "20", "sc_threshold": "0"})


class Slow:
    """Pictures of which each takes a while, until it is let go."""

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self.asked: list[int] = []
        self.go = threading.Event()

    def __getattr__(self, name: str) -> object:
        return getattr(self._pictures, name)

    def frame(self, index: int, stop=lambda: False):
        self.asked.append(index)
        while not self.go.is_set() and not stop():
            time.sleep(0.002)
        return None if stop() else self._pictures.frame(index)


def test_the_exact_frame_and_the_key_frame_before_it(tmp_path: Path) -> None:
    with open_pictures(film(tmp_path / "a.mp4")) as pictures, Desk(pictures) as desk:
        assert desk.look("a", 33, exact=True).result(5).index == 33
        assert desk.look("a", 33, exact=False).result(5).index == 20
        assert desk.beside(47).result(5).index == 47


def test_a_newer_look_of_the_same_viewer_wins_and_another_viewer_is_served_too(tmp_path: Path) -> None:
    with open_pictures(film(tmp_path / "a.mp4")) as pictures:
        slow = Slow(pictures)
        with Desk(slow) as desk:  # type: ignore[arg-type]
            crop = desk.beside(3)
            old = desk.look("a", 10, exact=True)
            while 10 not in slow.asked:
                time.sleep(0.002)
            other = desk.look("b", 12, exact=True)
            new = desk.look("a", 50, exact=True)
            with pytest.raises(Outdated):
                old.result(5)
            slow.go.set()
            assert new.result(5).index == 50
            assert other.result(5).index == 12
            assert crop.result(5).index == 3


def test_while_nobody_asks_the_pictures_around_are_decoded(tmp_path: Path) -> None:
    with open_pictures(film(tmp_path / "a.mp4")) as pictures, Desk(pictures) as desk:
        desk.look("a", 25, exact=True).result(5)
        until = time.monotonic() + 10
        while desk._around is not None and time.monotonic() < until:
            time.sleep(0.01)
        assert all(pictures.holds(index) for index in range(60))


def test_an_index_that_there_is_not_is_an_error_and_the_desk_goes_on(tmp_path: Path) -> None:
    with open_pictures(film(tmp_path / "a.mp4")) as pictures, Desk(pictures) as desk:
        with pytest.raises(UsageError):
            desk.look("a", 99, exact=True).result(5)
        with pytest.raises(UsageError):
            desk.beside(-1).result(5)
        assert desk.look("a", 1, exact=True).result(5).index == 1


def test_who_waits_when_it_closes_is_told(tmp_path: Path) -> None:
    with open_pictures(film(tmp_path / "a.mp4")) as pictures:
        desk = Desk(Slow(pictures))  # type: ignore[arg-type]
        look, crop = desk.look("a", 10, exact=True), desk.beside(3)
        desk.close()
        for waiting in (look, crop):
            with pytest.raises(Outdated):
                waiting.result(5)
