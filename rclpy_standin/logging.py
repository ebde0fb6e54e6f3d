# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Loggers that write to standard error and /rosout in the format of ROS."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, TypeVar

Value = TypeVar('Value')


class LoggingSeverity(IntEnum):
    """Severity of a log record."""

    UNSET = 0
    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


class Record:
    """A log record, with the location of the call."""

    __slots__ = ('file', 'function', 'level', 'line', 'name', 'stamp_ns', 'text')

    def __init__(self, name: str, level: LoggingSeverity, text: str, frame: Any) -> None:
        self.name, self.level, self.text = name, level, text
        self.stamp_ns = time.time_ns()
        self.file, self.line = frame.f_code.co_filename, frame.f_lineno
        self.function = frame.f_code.co_name


_lock = threading.RLock()
_levels: dict[str, LoggingSeverity] = {}
_default = LoggingSeverity.INFO
_to_stderr = True
_publishers: dict[str, Callable[[Record], None]] = {}
_call_sites: dict[tuple[str, int, str], tuple[int, int | None]] = {}


class RcutilsLogger:
    """A logger; dots in its name separate the levels of the logger hierarchy."""

    def __init__(self, name: str = '') -> None:
        self.name = name

    def debug(self, message: object, **filters: Any) -> bool:
        """Log a message of severity DEBUG."""
        return self._log(message, LoggingSeverity.DEBUG, filters)

    def info(self, message: object, **filters: Any) -> bool:
        """Log a message of severity INFO."""
        return self._log(message, LoggingSeverity.INFO, filters)

    def warning(self, message: object, **filters: Any) -> bool:
        """Log a message of severity WARN."""
        return self._log(message, LoggingSeverity.WARN, filters)

    def warn(self, message: object, **filters: Any) -> bool:
        """Log a message of severity WARN."""
        return self._log(message, LoggingSeverity.WARN, filters)

    def error(self, message: object, **filters: Any) -> bool:
        """Log a message of severity ERROR."""
        return self._log(message, LoggingSeverity.ERROR, filters)

    def fatal(self, message: object, **filters: Any) -> bool:
        """Log a message of severity FATAL."""
        return self._log(message, LoggingSeverity.FATAL, filters)

    def _log(self, message: object, severity: LoggingSeverity, filters: dict[str, Any]) -> bool:
        """Log a message.

        Args:
            message: text, or an object to convert to text.
            severity: its severity.
            filters: ``throttle_duration_sec``, ``once`` and ``skip_first``; each line of code
                that logs has its own state.

        Returns:
            Whether the message was logged; False if its severity or a filter suppressed it.
        """
        if severity < _nearest(_levels, self.name, _default):
            return False
        frame = sys._getframe(2)
        if filters and not self._passes(frame, **filters):
            return False
        record = Record(self.name, severity, str(message), frame)
        if _to_stderr:
            _print(record)
        with _lock:
            publish = _nearest(_publishers, self.name, None)
        if publish is not None:
            publish(record)
        return True

    def _passes(
        self, frame: Any, *, throttle_duration_sec: float = 0.0, once: bool = False,
        skip_first: bool = False,
    ) -> bool:
        call_site = (frame.f_code.co_filename, frame.f_lineno, self.name)
        now_ns = time.monotonic_ns()
        with _lock:
            calls, logged_ns = _call_sites.get(call_site, (0, None))
            passes = not (skip_first and calls == 0) and (logged_ns is None or not (
                once or now_ns - logged_ns < throttle_duration_sec * 1e9
            ))
            _call_sites[call_site] = (calls + 1, now_ns if passes else logged_ns)
        return passes


def get_logger(name: str) -> RcutilsLogger:
    """Return the logger with a name."""
    if not name:
        raise ValueError('Logger name must not be empty.')
    return RcutilsLogger(name)


def configure(levels: list[tuple[str, LoggingSeverity]], to_stderr: bool) -> None:
    """Apply the logging options of a command line; a level without a name is the default."""
    global _to_stderr, _default
    _to_stderr = to_stderr
    for name, level in levels:
        if name:
            _levels[name] = level
        else:
            _default = level


def set_publisher(name: str, publish: Callable[[Record], None] | None) -> None:
    """Set the function that publishes the records of a logger and its children; None for none."""
    with _lock:
        if publish is None:
            _publishers.pop(name, None)
        else:
            _publishers[name] = publish


def _nearest(values: Mapping[str, Value], name: str, default: Value) -> Value:
    """Return the value of a logger or, if it has none, that of its nearest ancestor."""
    while name:
        if name in values:
            return values[name]
        name = name.rpartition('.')[0]
    return default


def _print(record: Record) -> None:
    sec, nanosec = divmod(record.stamp_ns, 1_000_000_000)
    line = f'[{record.level.name}] [{sec}.{nanosec:09d}] [{record.name}]: {record.text}'
    try:
        sys.stderr.write(line + '\n')
        sys.stderr.flush()
    except (OSError, ValueError):
        pass  # standard error is closed
