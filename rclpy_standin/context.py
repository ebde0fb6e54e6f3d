# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contexts (DDS participant, ROS arguments, nodes) and signal handling."""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
import weakref
from collections.abc import Sequence
from enum import IntFlag
from typing import Any

from rclpy_standin import logging
from rclpy_standin.arguments import Arguments, parse
from rclpy_standin.dds import Participant
from rclpy_standin.exceptions import NotInitializedException
from rclpy_standin.graph import Graph


class SignalHandlerOptions(IntFlag):
    """Signals that trigger shutdown."""

    NO = 0
    SIGINT = 1
    SIGTERM = 2
    ALL = 3


class Context:
    """One initialisation of rclpy; nodes of different contexts communicate over DDS only."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._ok = False
        self._participant: Participant | None = None
        self._graph: Graph | None = None
        self.arguments = Arguments()
        self.nodes: set[Any] = set()
        self.executors: weakref.WeakSet[Any] = weakref.WeakSet()

    def init(self, args: Sequence[str] | None = None) -> None:
        """Join the domain of ROS_DOMAIN_ID.

        Args:
            args: command line; ``sys.argv`` if None.

        Raises:
            RuntimeError: the context is already initialised, or the ROS arguments are invalid.
            ValueError: an environment variable has an invalid value.
        """
        with self._lock:
            if self._ok:
                raise RuntimeError('Context.init() must only be called once')
            self.arguments = parse(sys.argv if args is None else args)
            logging.configure(self.arguments.levels, self.arguments.to_stderr)
            self.close()
            self._participant = Participant(_domain_id())
            try:
                self._graph = Graph(self._participant)
            except BaseException:
                self.close()
                raise
            self._ok = True
        _contexts.add(self)

    @property
    def participant(self) -> Participant:
        """DDS participant; raises NotInitializedException if the context is not initialised."""
        if self._participant is None or not self._ok:
            raise NotInitializedException()
        return self._participant

    @property
    def graph(self) -> Graph:
        """ROS graph; raises NotInitializedException if the context is not initialised."""
        if self._graph is None:
            raise NotInitializedException()
        return self._graph

    def ok(self) -> bool:
        """Return whether the context is initialised and not shut down."""
        return self._ok

    def shutdown(self) -> None:
        """Shut down; raises RuntimeError if the context is not initialised."""
        if not self.try_shutdown():
            raise RuntimeError('Context must be initialized before it can be shutdown')

    def try_shutdown(self) -> bool:
        """Shut down if the context is initialised; return whether it was."""
        with self._lock:
            if not self._ok:
                return False
            self._ok = False
        for executor in list(self.executors):
            executor.wake()
        return True

    def close_if_unused(self) -> None:
        """Leave the domain if the context is shut down and has no nodes."""
        with self._lock:
            if not self._ok and not self.nodes:
                self.close()

    def close(self) -> None:
        """Leave the domain and delete all DDS entities."""
        with self._lock:
            participant, graph = self._participant, self._graph
            self._participant = self._graph = None
        for executor in list(self.executors):
            executor.release()
        if graph is not None:
            graph.close()
        if participant is not None:
            participant.close()


_contexts: weakref.WeakSet[Context] = weakref.WeakSet()
_default = Context()


def get_default_context(*, shutting_down: bool = False) -> Context:
    """Return the context that is used if none is given."""
    return _default


def _domain_id() -> int:
    text = os.environ.get('ROS_DOMAIN_ID', '') or '0'
    if not text.isdigit() or int(text) > 232:
        raise ValueError(f'ROS_DOMAIN_ID={text}: expected an integer from 0 to 232')
    return int(text)


@atexit.register
def _close_all() -> None:
    """Leave all domains at exit, before the threads of DDS outlive the interpreter."""
    for context in list(_contexts):
        context.try_shutdown()
        for node in list(context.nodes):
            node.close()
        context.close()


# Signals

_previous_handlers: dict[int, Any] = {}


def install_signal_handlers(options: SignalHandlerOptions = SignalHandlerOptions.ALL) -> None:
    """Shut down all contexts on signals, then call the previous handler (KeyboardInterrupt)."""
    if threading.current_thread() is not threading.main_thread():
        return
    for flag, number in (
        (SignalHandlerOptions.SIGINT, signal.SIGINT),
        (SignalHandlerOptions.SIGTERM, signal.SIGTERM),
    ):
        if flag & options and number not in _previous_handlers:
            _previous_handlers[number] = signal.signal(number, _on_signal)


def uninstall_signal_handlers() -> None:
    """Restore the previous handlers, except for signals whose handler was replaced since."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number, handler in list(_previous_handlers.items()):
        if signal.getsignal(number) is _on_signal:
            signal.signal(number, handler)
        del _previous_handlers[number]


def _on_signal(number: int, frame: Any) -> None:
    for context in list(_contexts):
        context.try_shutdown()
    handler = _previous_handlers.get(number)
    if callable(handler):
        handler(number, frame)
