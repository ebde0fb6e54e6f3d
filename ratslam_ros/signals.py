# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Signals that end a program, recorded so that it ends between two steps and not within one."""

from __future__ import annotations

import signal
import threading
from typing import Any, Self

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopSignals:
    """Context manager that counts stop signals in place of acting on them.

    A KeyboardInterrupt raised by a handler could leave a step half done, or leave compiled code as
    a SystemError. So the first signal is only counted, and the loop inside the context checks
    ``received``. On exit the previous handlers are restored.
    """

    def __init__(
        self, numbers: tuple[signal.Signals, ...] = STOP_SIGNALS, raise_on_second: bool = True
    ) -> None:
        """Choose the signals; nothing is installed before the context is entered.

        Args:
            numbers: the signals to count.
            raise_on_second: raise KeyboardInterrupt on the second signal, for a loop that hangs;
                False: count all of them.
        """
        self.count = 0
        """Signals received so far."""
        self.last = numbers[0]
        """The signal received last."""
        self._numbers = numbers
        self._raise_on_second = raise_on_second
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
        if self._raise_on_second and self.count > 1:
            raise KeyboardInterrupt


class StopAtOnce(StopSignals):
    """Context manager in which a stop signal raises KeyboardInterrupt: nothing can be half done.

    It is for a start, which may compile for half a minute. ``received`` tells whether there was a
    signal even if the code that was interrupted has turned the error into another one.
    """

    def _on_signal(self, number: int, frame: object) -> None:
        self.count += 1
        self.last = signal.Signals(number)
        raise KeyboardInterrupt
