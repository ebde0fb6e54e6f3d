# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Signals that end a program, recorded so that it ends between two steps and not within one."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from contextlib import suppress
from typing import Any, NoReturn, Self

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopSignals:
    """Context manager that counts stop signals in place of acting on them.

    A KeyboardInterrupt raised by a handler could leave a step half done, or leave compiled code as
    a SystemError. So the first signal is only counted, and the loop inside the context checks
    ``received``. On exit the previous handlers are restored.
    """

    def __init__(
        self, numbers: tuple[signal.Signals, ...] = STOP_SIGNALS, raise_on_second: bool = True,
        repeats_s: float = 0.0,
    ) -> None:
        """Choose the signals; nothing is installed before the context is entered.

        Args:
            numbers: the signals to count.
            raise_on_second: raise KeyboardInterrupt on the second signal, for a loop that hangs;
                False: count all of them.
            repeats_s: time after the first signal for which no further one raises.
        """
        self.count = 0
        """Signals received so far."""
        self.last = numbers[0]
        """The signal received last."""
        self._numbers = numbers
        self._raise_on_second, self._repeats_s = raise_on_second, repeats_s
        self._first_s = 0.0
        self._previous: dict[signal.Signals, Any] = {}

    @property
    def received(self) -> bool:
        """Whether a signal was received."""
        return self.count > 0

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # others cannot set handlers
            for number in self._numbers:
                self._previous[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: object) -> None:
        self.count += 1
        self.last = signal.Signals(number)
        if self.count == 1:
            self._first_s = time.monotonic()
        elif self._raise_on_second and time.monotonic() - self._first_s >= self._repeats_s:
            raise KeyboardInterrupt


class StopAtOnce(StopSignals):
    """Context manager in which a stop signal ends the process with exit code 0.

    It is for a start, in which nothing can be half done. A KeyboardInterrupt would not end it
    reliably: the callbacks of the compiler drop it, imports and Numba turn it into other errors,
    and the start continues.
    """

    def __enter__(self) -> Self:
        super().__enter__()
        if hasattr(signal, 'pthread_sigmask'):  # not on Windows
            signal.pthread_sigmask(signal.SIG_UNBLOCK, self._numbers)  # see supervision.py
        return self

    def _on_signal(self, number: int, frame: object) -> None:
        end_process(0)


def end_process(code: int) -> NoReturn:
    """End the process without waiting for its threads, which may be importing SciPy.

    Args:
        code: the exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(RuntimeError, OSError, ValueError):  # Interrupted in a write, or closed.
            stream.flush()
    os._exit(code)
