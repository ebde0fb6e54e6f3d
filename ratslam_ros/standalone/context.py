# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Between init and shutdown: the participant, the arguments, and what signals do."""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
import weakref
from collections.abc import Callable, Sequence
from enum import IntFlag
from typing import Any

from ratslam_ros.standalone import logging
from ratslam_ros.standalone.arguments import Arguments, parse
from ratslam_ros.standalone.dds import Participant
from ratslam_ros.standalone.exceptions import NotInitializedException
from ratslam_ros.standalone.graph import Graph


class SignalHandlerOptions(IntFlag):
    """Which signals shut down."""

    NO = 0
    SIGINT = 1
    SIGTERM = 2
    ALL = 3


class Context:
    """One initialisation of rclpy; nodes of several ones see each other through DDS alone."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._ok = False
        self._participant: Participant | None = None
        self._graph: Graph | None = None
        self._callbacks: list[Callable[[], Any]] = []
        self.arguments = Arguments()
        self.nodes: set[Any] = set()
        self.executors: weakref.WeakSet[Any] = weakref.WeakSet()

    def init(
        self,
        args: Sequence[str] | None = None,
        *,
        initialize_logging: bool = True,
        domain_id: int | None = None,
    ) -> None:
        """Join a domain, that of ROS_DOMAIN_ID unless told otherwise.

        Raises:
            RuntimeError: it has been initialised before, or arguments are wrong.
            ValueError: a variable of the environment has a value that ROS does not know.
        """
        with self._lock:
            if self._ok:
                raise RuntimeError('Context.init() must only be called once')
            self.arguments = parse(sys.argv if args is None else args)
            if initialize_logging:
                logging.configure(self.arguments.levels, self.arguments.to_stderr)
            self.close()
            self._participant = Participant(_domain_id() if domain_id is None else domain_id)
            try:
                self._graph = Graph(self._participant)
            except BaseException:
                self.close()
                raise
            self._ok = True
        _contexts.add(self)

    @property
    def participant(self) -> Participant:
        """The participant; raises NotInitializedException where there is none."""
        if self._participant is None or not self._ok:
            raise NotInitializedException()
        return self._participant

    @property
    def graph(self) -> Graph:
        """The graph; raises NotInitializedException where there is none."""
        if self._graph is None:
            raise NotInitializedException()
        return self._graph

    def ok(self) -> bool:
        """Tell whether it was initialised and not shut down."""
        return self._ok

    def get_domain_id(self) -> int:
        """Return the domain that was joined."""
        return self.participant.domain_id

    def on_shutdown(self, callback: Callable[[], Any]) -> None:
        """Call something at shutdown."""
        with self._lock:
            self._callbacks.append(callback)

    def shutdown(self) -> None:
        """Shut down; raises RuntimeError where that has been done."""
        if not self.try_shutdown():
            raise RuntimeError('Context must be initialized before it can be shutdown')

    def try_shutdown(self) -> bool:
        """Shut down unless that has been done; return whether it was not."""
        with self._lock:
            if not self._ok:
                return False
            self._ok = False
            callbacks, self._callbacks = self._callbacks, []
        for executor in list(self.executors):
            executor.wake()
        for callback in callbacks:
            callback()
        return True

    def end(self) -> None:
        """Leave the domain, once shut down and without nodes and spinning executors."""
        with self._lock:
            if not self._ok and not self.nodes:
                self.close()

    def close(self) -> None:
        """Leave the domain at once."""
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
    """Return the context that is meant where none is named."""
    return _default


def _domain_id() -> int:
    text = os.environ.get('ROS_DOMAIN_ID', '') or '0'
    if not text.isdigit() or int(text) > 232:
        raise ValueError(f'ROS_DOMAIN_ID={text}: expected an integer from 0 to 232')
    return int(text)


@atexit.register
def _end_all() -> None:
    """Leave all domains while the interpreter still works: DDS has threads of its own."""
    for context in list(_contexts):
        context.try_shutdown()
        for node in list(context.nodes):
            node.close()
        context.close()


# Signals

_before: dict[int, Any] = {}


def install_signal_handlers(options: SignalHandlerOptions = SignalHandlerOptions.ALL) -> None:
    """Shut down at signals; SIGINT then still is Python's KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        return
    for flag, number in (
        (SignalHandlerOptions.SIGINT, signal.SIGINT),
        (SignalHandlerOptions.SIGTERM, signal.SIGTERM),
    ):
        if flag & options and number not in _before:
            _before[number] = signal.signal(number, _on_signal)


def uninstall_signal_handlers() -> None:
    """Undo ``install_signal_handlers``, where nobody else has set handlers since."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number, handler in list(_before.items()):
        if signal.getsignal(number) is _on_signal:
            signal.signal(number, handler)
        del _before[number]


def _on_signal(number: int, frame: Any) -> None:
    for context in list(_contexts):
        context.try_shutdown()
    handler = _before.get(number)
    if callable(handler):
        handler(number, frame)
