# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Futures."""

from __future__ import annotations

import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any


class Future:
    """The result of an asynchronous call, set when it completes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._done = False
        self._result: Any = None
        self._callbacks: list[Callable[[Future], None]] = []

    def done(self) -> bool:
        """Return whether the result was set."""
        return self._done

    def result(self) -> Any:
        """Return the result, None if it is not set."""
        return self._result

    def set_result(self, result: Any) -> None:
        """Set the result, and run the callbacks."""
        with self._lock:
            self._result, self._done = result, True
        self._call_back()

    def add_done_callback(self, callback: Callable[[Future], None]) -> None:
        """Add a callback for completion; it runs at once if the future is done."""
        with self._lock:
            if not self._done:
                self._callbacks.append(callback)
                return
        callback(self)

    def _call_back(self) -> None:
        with self._lock:
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            try:
                callback(self)
            except Exception:
                traceback.print_exc(file=sys.stderr)
