# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Signals that end a program are counted, and the handlers restored."""

import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from ratslam_ros.signals import STOP_SIGNALS, StopSignals

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize('number', STOP_SIGNALS)
def test_first_signal_is_counted_second_raises(number: signal.Signals) -> None:
    with StopSignals() as stop:
        assert not stop.received
        signal.raise_signal(number)
        assert stop.received
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert (stop.count, stop.last) == (2, number)


def test_repeated_signal_within_limit_does_not_raise(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0
    monkeypatch.setattr('time.monotonic', lambda: now_s)
    with StopSignals(repeats_s=1.0) as stop:
        signal.raise_signal(signal.SIGINT)
        now_s = 0.9
        signal.raise_signal(signal.SIGINT)
        assert stop.count == 2
        now_s = 1.1
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


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


SWALLOWED_SOURCE = """
import signal, threading
from ratslam_ros.signals import StopAtOnce

threading.Thread(target=threading.Event().wait).start()  # does not end
with StopAtOnce():
    print('begun')
    try:
        signal.raise_signal({number})
    except BaseException:  # as the callbacks of a compiler
        pass
    print('continued')
"""


@pytest.mark.parametrize('number', STOP_SIGNALS)
def test_stop_at_once_ends_whatever_runs(number: signal.Signals) -> None:
    done = subprocess.run(
        [sys.executable, '-c', SWALLOWED_SOURCE.format(number=int(number))], cwd=ROOT,
        capture_output=True, text=True, timeout=60, check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, 'begun\n', '')
