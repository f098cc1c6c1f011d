"""Frames rendered ahead in threads and given in order."""

import os
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

Frame = TypeVar("Frame")
_MOST_THREADS = 8  # each holds some 40 MB at 1280x720


def ahead(render: Callable[[int], Frame], count: int, workers: int | None = None) -> Generator[Frame, None, None]:
    """render(0) … render(count - 1), rendered ahead in `workers` threads (None: one a core, 8 at most).

    The first one is rendered alone: it compiles what has not been, and makes what is made once.
    """
    if count > 0:
        yield render(0)
    indices = iter(range(1, count))
    workers = workers or min(os.cpu_count() or 1, _MOST_THREADS)
    with ThreadPoolExecutor(workers, "render") as threads:
        waiting = deque(threads.submit(render, index) for index in islice(indices, 2 * workers))
        try:
            while waiting:
                frame = waiting.popleft().result()
                waiting.extend(threads.submit(render, index) for index in islice(indices, 1))
                yield frame
        finally:
            threads.shutdown(cancel_futures=True)
