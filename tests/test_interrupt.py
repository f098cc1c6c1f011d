"""Ctrl-C, SIGTERM and SIGHUP: the first is noted, the second raises; what is ignored stays ignored."""

import signal

import pytest

from spheremcap import interrupt
from spheremcap.interrupt import SIGNALS, Interrupt, Interrupted


@pytest.fixture(autouse=True)
def as_before():
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:  # whatever the tests were started to ignore (nohup)
        signal.signal(number, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_all_three_are_taken_care_of():
    assert set(SIGNALS) == {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}


@pytest.mark.parametrize("number", SIGNALS)
def test_the_first_is_noted_and_the_second_raises(number):
    before = signal.getsignal(number)
    with Interrupt() as interrupted:
        assert not interrupted()
        signal.raise_signal(number)
        assert interrupted()
        with pytest.raises(Interrupted):
            signal.raise_signal(number)
    assert signal.getsignal(number) is before


def test_what_the_process_was_started_to_ignore_stays_so():
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    interrupt.leave_at_once()
    interrupt.unwind()
    with Interrupt() as interrupted:
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGTERM)
        assert not interrupted()
        signal.raise_signal(signal.SIGINT)
        assert interrupted()
    assert {signal.getsignal(number) for number in SIGNALS} == {signal.SIG_IGN}


def test_once_it_works_a_signal_raises():
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    interrupt.unwind()  # without the start, as in somebody's own program, nothing changes
    assert {signal.getsignal(number) for number in SIGNALS} == {signal.SIG_DFL}
    interrupt.leave_at_once()
    interrupt.unwind()
    for number in SIGNALS:
        with pytest.raises(Interrupted, match="interrupted"):
            signal.raise_signal(number)
