"""Signals wait for the end of a block, and only there."""

from __future__ import annotations

import signal
import threading

import pytest

from shapefit.io.whole.held_signals import HELD, held_signals

NUMBERS = [signal.SIGINT, signal.SIGTERM]


@pytest.fixture
def came():
    """Collect the signals that their usual handlers get."""
    got = []
    before = {
        number: signal.signal(number, lambda number, _: got.append(number)) for number in HELD
    }
    yield got
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_signal_acts_once_at_the_end(came, number):
    with held_signals():
        signal.raise_signal(number)
        signal.raise_signal(number)
        assert came == []
    assert came == [number]
    signal.raise_signal(number)
    assert came == [number, number]


def test_different_signals_all_act_in_the_order_they_came(came):
    with held_signals():
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGTERM):
            signal.raise_signal(number)
        assert came == []
    assert came == [signal.SIGTERM, signal.SIGINT]


@pytest.mark.parametrize("number", NUMBERS)
def test_the_end_of_the_outer_block_counts(came, number):
    with held_signals():
        with held_signals():
            signal.raise_signal(number)
        assert came == []
    assert came == [number]


def test_a_signal_acts_after_an_error_too(came):
    def run():
        with held_signals():
            signal.raise_signal(signal.SIGTERM)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run()
    assert came == [signal.SIGTERM]


@pytest.mark.usefixtures("came")  # which puts the handler of the process back
def test_what_a_handler_raises_comes_through():
    def run():
        with held_signals():
            signal.raise_signal(signal.SIGINT)

    signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt):
        run()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ignored_signals_stay_ignored(came):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with held_signals():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    assert came == []


def test_other_threads_hold_nothing(came):
    def work():
        with held_signals():
            done.append(signal.getsignal(signal.SIGINT))

    done = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [signal.getsignal(signal.SIGINT)]
    assert came == []
