"""Puts the questions of a run that is going on to a person on the page, and waits for what they answer."""

import webbrowser
from collections.abc import Callable, Sequence
from concurrent.futures import TimeoutError as NotYet
from contextlib import ExitStack
from typing import Self

from spheremcap.api import Asked
from spheremcap.core.marker import Answer
from spheremcap.operator.page import Page
from spheremcap.operator.server import Server

_POLL_S = 0.2


class Attending:
    """An operator at the page, which is opened at the first question; a context manager that closes it.

    `page` is opened on the run's own input. `say` takes its address; `stopped` is asked while nobody answers.
    """

    def __init__(
        self, page: Page, say: Callable[[str], None], stopped: Callable[[], bool], *, show: bool = True
    ) -> None:
        self._page, self._say, self._stopped, self._show = page, say, stopped, show
        self._files = ExitStack()
        self._server: Server | None = None

    def __enter__(self) -> Self:
        self._files.callback(self._page.close)
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def ask(self, asked: Asked) -> Sequence[Answer]:
        """One answer, or none for later."""
        reply = self._page.put(asked)
        if self._server is None:
            self._server = self._files.enter_context(Server(self._page))
            self._say(self._server.url)
            if self._show:
                webbrowser.open(self._server.url)
        while not self._stopped():
            try:
                return reply.result(_POLL_S)
            except NotYet:
                continue
        return []
