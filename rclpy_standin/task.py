# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Futures."""

from __future__ import annotations

import sys
import threading
import traceback
from collections.abc import Callable, Generator
from typing import Any


class Future:
    """The result of an asynchronous call, set when it completes."""

    def __init__(self, *, executor: Any = None) -> None:
        self._lock = threading.Lock()
        self._done = self._cancelled = False
        self._result: Any = None
        self._exception: BaseException | None = None
        self._callbacks: list[Callable[[Future], None]] = []

    def __await__(self) -> Generator[None, None, Any]:
        while not self._done:
            yield
        return self.result()

    def cancel(self) -> None:
        """Cancel the future unless it is done."""
        with self._lock:
            if self._done:
                return
            self._cancelled = True
        self._call_back()

    def cancelled(self) -> bool:
        """Return whether the future was cancelled."""
        return self._cancelled

    def done(self) -> bool:
        """Return whether the result or an exception was set."""
        return self._done

    def result(self) -> Any:
        """Return the result, None if it is not set; raises the exception if one was set."""
        if self._exception is not None:
            raise self._exception
        return self._result

    def exception(self) -> BaseException | None:
        """Return the exception; None if none was set."""
        return self._exception

    def set_result(self, result: Any) -> None:
        """Set the result, and run the callbacks."""
        with self._lock:
            self._result, self._done, self._cancelled = result, True, False
        self._call_back()

    def set_exception(self, exception: BaseException) -> None:
        """Set an exception instead of a result, and run the callbacks."""
        with self._lock:
            self._exception, self._done, self._cancelled = exception, True, False
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
