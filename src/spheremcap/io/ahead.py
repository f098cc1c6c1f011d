"""Read ahead: the next few items are made in one background thread while the caller works on the current one."""

from collections import deque
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import TypeVar, cast

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
