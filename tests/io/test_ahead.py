"""Reading ahead: order, errors in their place, and a thread that is gone before anything is closed."""

import threading
from collections.abc import Iterator
from contextlib import closing, nullcontext

import pytest

from spheremcap.io.ahead import ahead


class Source:
    """Counts up to `count`, then fails if it shall; `made` are the items so far, `closed` says it has ended."""

    def __init__(self, count: int, error: Exception | None = None) -> None:
        self.count, self.error = count, error
        self.made: list[int] = []
        self.threads: set[threading.Thread] = set()
        self.full = threading.Event()
        self.closed = False

    def items(self, full_at: int = 0):
        try:
            for k in range(self.count):
                self.threads.add(threading.current_thread())
                self.made.append(k)
                if len(self.made) == full_at:
                    self.full.set()
                yield k
            if self.error is not None:
                raise self.error
        finally:
            self.closed = True


@pytest.fixture(autouse=True)
def no_thread_left() -> Iterator[None]:
    before = threading.active_count()
    yield
    assert threading.active_count() == before


@pytest.mark.parametrize("count", [0, 1, 3, 4, 50])
def test_everything_comes_in_order_from_one_other_thread(count: int) -> None:
    source = Source(count)
    assert list(ahead(source.items(), 4)) == list(range(count))
    assert source.closed
    assert len(source.threads) == min(1, count)
    assert threading.current_thread() not in source.threads


def test_an_error_comes_after_all_that_came_before_it() -> None:
    source, got = Source(6, ValueError("broken")), []
    with pytest.raises(ValueError, match="broken"):
        got.extend(ahead(source.items(), 4))
    assert got == list(range(6))
    assert source.closed


def test_no_more_than_asked_for_is_made_ahead() -> None:
    source = Source(100)
    with closing(ahead(source.items(full_at=5), 4)) as items:
        assert next(items) == 0
        assert source.full.wait(10)
        for k in range(1, 20):
            assert next(items) == k
            assert len(source.made) <= k + 5


def three_then(error: type[BaseException] | None, source: Source) -> None:
    with closing(ahead(source.items(), 4)) as items:
        for item in items:
            if item == 3 and error is not None:
                raise error
            if item == 3:
                break


def test_the_thread_has_ended_and_the_source_is_closed_when_the_caller_stops() -> None:
    for error in (None, ValueError, KeyboardInterrupt):
        source = Source(100)
        with pytest.raises(error) if error is not None else nullcontext():
            three_then(error, source)
        assert source.closed
        assert not any(thread.is_alive() for thread in source.threads)


def test_closing_waits_for_the_item_that_is_being_made() -> None:
    busy, go = threading.Event(), threading.Event()
    done = []

    def slow():
        yield 0
        busy.set()
        go.wait(10)
        done.append(True)
        yield 1

    items = ahead(slow(), 1)
    next(items)
    assert busy.wait(10)
    release = threading.Timer(0.05, go.set)
    release.start()
    items.close()
    assert done == [True]
    release.join()
