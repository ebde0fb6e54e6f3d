# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Signals that end a program are counted, and the handlers restored."""

import signal
import threading

import pytest

from ratslam_ros.signals import STOP_SIGNALS, StopAtOnce, StopSignals


@pytest.mark.parametrize('number', STOP_SIGNALS)
def test_first_signal_is_counted_second_raises(number: signal.Signals) -> None:
    with StopSignals() as stop:
        assert not stop.received
        signal.raise_signal(number)
        assert stop.received
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert (stop.count, stop.last) == (2, number)


def test_all_signals_are_counted_if_none_raises() -> None:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    with StopSignals(numbers, raise_on_second=False) as stop:
        for count, number in enumerate(numbers, 1):
            signal.raise_signal(number)
            assert (stop.count, stop.last) == (count, number)


def test_handlers_are_restored_after_an_exception() -> None:
    before = [signal.getsignal(number) for number in STOP_SIGNALS]
    with pytest.raises(ZeroDivisionError), StopSignals():
        assert [signal.getsignal(number) for number in STOP_SIGNALS] != before
        raise ZeroDivisionError
    assert [signal.getsignal(number) for number in STOP_SIGNALS] == before


def test_other_threads_install_no_handlers() -> None:
    before = [signal.getsignal(number) for number in STOP_SIGNALS]
    found = []

    def enter() -> None:
        with StopSignals():
            found.extend(signal.getsignal(number) for number in STOP_SIGNALS)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert found == before


@pytest.mark.parametrize('number', STOP_SIGNALS)
def test_stop_at_once_raises_and_remembers(number: signal.Signals) -> None:
    with pytest.raises(KeyboardInterrupt), StopAtOnce() as stop:
        signal.raise_signal(number)
    assert (stop.received, stop.last) == (True, number)
