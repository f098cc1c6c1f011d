"""Work beside the caller in one background thread: the next few items made ahead, or what is done written behind."""

from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from typing import Any, TypeVar, cast

Item = TypeVar("Item")

AHEAD_FRAMES = 4
"""Enough to even out slow frames (a key frame, a full search) and few enough that memory stays flat."""


def ahead(items: Generator[Item, None, None], count: int = AHEAD_FRAMES) -> Generator[Item, None, None]:
    """The items in their order, up to `count` of them made before they are asked for.

    What `items` raises comes out at its place in the order. Closing the result waits until the thread has ended,
    then closes `items`: close it before anything that `items` reads from (a decoder must not lose its file).
    """
    end = object()
    with closing(items), ThreadPoolExecutor(1, "ahead") as thread:
        waiting = deque(thread.submit(next, items, end) for _ in range(count))
        try:
            while (item := waiting.popleft().result()) is not end:
                waiting.append(thread.submit(next, items, end))
                yield cast(Item, item)
        finally:
            thread.shutdown(cancel_futures=True)


@contextmanager
def in_order(count: int = 2 * AHEAD_FRAMES) -> Iterator[Callable[..., None]]:
    """Gives what hands calls on to one background thread, which makes them one by one in their order.

    At most `count` calls wait; then handing on waits too. What a call raises comes out at a later one, or at the end,
    where all calls have been made.
    """
    waiting: deque[Future[Any]] = deque()

    def call(function: Callable[..., Any], *arguments: Any) -> None:
        if len(waiting) >= count:
            waiting.popleft().result()
        waiting.append(thread.submit(function, *arguments))

    with ThreadPoolExecutor(1, "behind") as thread:
        try:
            yield call
        except BaseException:
            thread.shutdown(cancel_futures=True)
            raise
        while waiting:
            waiting.popleft().result()
