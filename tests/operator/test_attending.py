"""A run's question is put on the page, and its answer goes back to the run."""

import threading
import time
from pathlib import Path

import pytest
from film import SETTINGS, seeds

from spheremcap.api import Asked
from spheremcap.config import load_seeds, seeds_toml
from spheremcap.core.circle import Circle
from spheremcap.core.estimate import MarkerEstimate, OperatorRequest, Status
from spheremcap.core.marker import Hidden, Keep
from spheremcap.errors import UsageError
from spheremcap.operator.attending import Attending
from spheremcap.operator.opened import Opened
from spheremcap.operator.page import Page

LOST = OperatorRequest("wrist", 40, 166_666_667, 49, 204_166_667, "no outline", ("no outline",))


def question(check=lambda answers: None) -> Asked:
    last = MarkerEstimate("wrist", 39, 0, Status.VERIFIED, circle=Circle(87.0, 70.0, 16.0))
    return Asked(LOST, last, None, 49, lambda index: None, check)


@pytest.fixture
def page(film: Path):
    (film.parent / "a.seeds.toml").write_text(seeds_toml(seeds()))
    return Page(Opened(film, seeds=film.parent / "a.seeds.toml", attended=SETTINGS), "ada")


def asked(attending: Attending, what: Asked) -> list:
    """Asks in a thread, as the run does; the answers are in the list when the thread has ended."""
    answers: list = []
    thread = threading.Thread(target=lambda: answers.append(attending.ask(what)), daemon=True)
    thread.start()
    until = time.monotonic() + 10
    while attending._page.question is None and time.monotonic() < until:
        time.sleep(0.01)
    return [answers, thread]


def test_the_question_is_the_one_request_on_the_page_and_its_answer_goes_back(film: Path, page: Page) -> None:
    said: list[str] = []
    with Attending(page, said.append, lambda: False, show=False) as attending:
        assert page.lanes()["requests"] == []
        answers, thread = asked(attending, question())
        [shown] = page.lanes()["requests"]
        assert (shown["first_unverified"], shown["last_verified"], shown["circle"]) == (40, 39, [87.0, 70.0, 16.0])
        assert page.pulse()["asked"] == 1
        page.answer("keep", "elbow", 10, {"to_frame": 11})  # about another marker: the run still waits
        assert page.pulse()["asked"] == 1
        page.answer("hidden", "wrist", 40, {"to_frame": 69})
        thread.join(10)
        [[given]] = answers
        assert isinstance(given, Hidden)
        assert load_seeds(film.parent / "a.seeds.toml")[-1] == given
        assert page.pulse()["asked"] == 0
        answers, thread = asked(attending, question())
        assert page.pulse()["asked"] == 2
        page.later()
        thread.join(10)
        assert answers == [[]]
        with pytest.raises(UsageError, match="nothing is asked"):
            page.later()
        assert [url.startswith("http://127.0.0.1:") for url in said] == [True]


def test_an_answer_that_the_run_cannot_take_is_refused_before_it_is_saved(film: Path, page: Page) -> None:
    def check(answers: object) -> None:
        raise UsageError("the run is past that")

    with Attending(page, lambda url: None, lambda: False, show=False) as attending:
        answers, thread = asked(attending, question(check))
        with pytest.raises(UsageError, match="past that"):
            page.answer("keep", "wrist", 40, {"to_frame": 49})
        assert len(load_seeds(film.parent / "a.seeds.toml")) == 2
        assert page.pulse()["asked"] == 1
        page.later()
        thread.join(10)
        assert answers == [[]]


def test_a_run_that_is_stopped_waits_no_longer(page: Page) -> None:
    stop = threading.Event()
    with Attending(page, lambda url: None, stop.is_set, show=False) as attending:
        answers, thread = asked(attending, question())
        stop.set()
        thread.join(10)
        assert answers == [[]]
        page.answer("keep", "wrist", 40, {"to_frame": 49})  # too late, and no harm
        assert isinstance(page.opened.answers.answers()[-1], Keep)


def test_markers_and_camera_of_a_run_stand(page: Page) -> None:
    with Attending(page, lambda url: None, lambda: True, show=False):
        assert page.session()["kind"] == "attended"
        for change in (lambda: page.set_marker("knee", 0.04, None), lambda: page.set_preset("thesis"), page.track):
            with pytest.raises(UsageError, match="already"):
                change()
