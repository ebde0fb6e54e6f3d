# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Loggers that write to standard error and /rosout in the format of ROS."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from enum import IntEnum
from typing import Any


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
_call_sites: dict[tuple[str, int, str], tuple[int, int]] = {}


class RcutilsLogger:
    """A logger; dots in its name separate the levels of the logger hierarchy."""

    def __init__(self, name: str = '') -> None:
        self.name = name

    def get_effective_level(self) -> LoggingSeverity:
        """Return the level of this logger or, if unset, that of its nearest ancestor."""
        return get_logger_effective_level(self.name)

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

    def log(self, message: object, severity: int, **filters: Any) -> bool:
        """Log a message.

        Args:
            message: text, or an object to convert to text.
            severity: a LoggingSeverity.
            filters: ``throttle_duration_sec``, ``once`` and ``skip_first``; each line of code
                that logs has its own state.

        Returns:
            Whether the message was logged; False if its severity or a filter suppressed it.
        """
        return self._log(message, LoggingSeverity(severity), filters)

    def _log(self, message: object, severity: LoggingSeverity, filters: dict[str, Any]) -> bool:
        if severity < self.get_effective_level():
            return False
        frame = sys._getframe(2)
        if filters and not self._passes(frame, filters):
            return False
        record = Record(filters.get('name', self.name), severity, str(message), frame)
        if _to_stderr:
            _print(record)
        with _lock:
            publish = _publisher(record.name)
        if publish is not None:
            publish(record)
        return True

    def _passes(self, frame: Any, filters: dict[str, Any]) -> bool:
        unknown = set(filters) - {
            'throttle_duration_sec', 'throttle_time_source_type', 'once', 'skip_first', 'name'
        }
        if unknown:
            raise TypeError(f'unknown logging arguments: {", ".join(sorted(unknown))}')
        call_site = (frame.f_code.co_filename, frame.f_lineno, self.name)
        source = filters.get('throttle_time_source_type')
        now_ns = time.monotonic_ns() if source is None else source.now().nanoseconds
        with _lock:
            calls, logged_ns = _call_sites.get(call_site, (0, -1))
            passes = not (filters.get('skip_first') and calls == 0)
            if filters.get('once') and logged_ns >= 0:
                passes = False
            throttle_s = filters.get('throttle_duration_sec')
            if throttle_s and logged_ns >= 0 and now_ns - logged_ns < throttle_s * 1e9:
                passes = False
            _call_sites[call_site] = (calls + 1, now_ns if passes else logged_ns)
        return passes


def get_logger(name: str) -> RcutilsLogger:
    """Return the logger with a name."""
    if not name:
        raise ValueError('Logger name must not be empty.')
    return RcutilsLogger(name)


def set_logger_level(name: str, level: int, detailed_error: bool = False) -> None:
    """Set the lowest severity that a logger and its children log; UNSET removes the level."""
    global _default
    if name:
        _levels[name] = LoggingSeverity(level)
    else:
        _default = LoggingSeverity(level)


def get_logger_level(name: str) -> LoggingSeverity:
    """Return the level of a logger itself; UNSET if it has none."""
    return _levels.get(name, LoggingSeverity.UNSET)


def get_logger_effective_level(name: str) -> LoggingSeverity:
    """Return the level of a logger or, if unset, that of its nearest ancestor."""
    while name:
        level = _levels.get(name, LoggingSeverity.UNSET)
        if level != LoggingSeverity.UNSET:
            return level
        name = name.rpartition('.')[0]
    return _default


def get_logging_severity_from_string(log_severity: str) -> LoggingSeverity:
    """Return the severity with a name, ignoring case.

    Raises:
        RuntimeError: the name is unknown.
    """
    try:
        return LoggingSeverity[log_severity.upper()]
    except KeyError:
        raise RuntimeError(f'unknown severity {log_severity!r}') from None


def configure(levels: list[tuple[str, LoggingSeverity]], to_stderr: bool) -> None:
    """Apply the logging options of a command line."""
    global _to_stderr
    _to_stderr = to_stderr
    for name, level in levels:
        set_logger_level(name, level)


def set_publisher(name: str, publish: Callable[[Record], None] | None) -> None:
    """Set the function that publishes the records of a logger and its children; None for none."""
    with _lock:
        if publish is None:
            _publishers.pop(name, None)
        else:
            _publishers[name] = publish


def _publisher(name: str) -> Callable[[Record], None] | None:
    while name:
        if name in _publishers:
            return _publishers[name]
        name = name.rpartition('.')[0]
    return None


def _print(record: Record) -> None:
    sec, nanosec = divmod(record.stamp_ns, 1_000_000_000)
    line = f'[{record.level.name}] [{sec}.{nanosec:09d}] [{record.name}]: {record.text}'
    try:
        sys.stderr.write(line + '\n')
        sys.stderr.flush()
    except (OSError, ValueError):
        pass  # standard error is closed
