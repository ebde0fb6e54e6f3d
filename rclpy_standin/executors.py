# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The executor: waits for all entities of its nodes and runs their callbacks one by one."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy_standin.context import Context, get_default_context
from rclpy_standin.dds import Guard, WaitSet
from rclpy_standin.exceptions import NotInitializedException, RCLError
from rclpy_standin.node_parts import Waitable
from rclpy_standin.task import Future
from rclpy_standin.timer import Timer

_MAX_WAIT_NS = 100_000_000
"""Longest wait; Python handles signals between waits."""


class ExternalShutdownException(Exception):  # noqa: N818
    """The context was shut down while an executor was spinning."""


class SingleThreadedExecutor:
    """Executor that runs the callbacks of its nodes in the spinning thread."""

    def __init__(self, *, context: Context | None = None) -> None:
        self.context = get_default_context() if context is None else context
        self._lock = threading.RLock()
        self._nodes: list[Any] = []
        self._jobs: deque[tuple[Any, Callable[[], bool]]] = deque()
        self._attached: dict[int, tuple[Any, Waitable]] = {}
        self._stale = True
        self._woken = self._waiting = False
        self._is_shutdown = False
        participant = self.context.participant
        self._guard: Guard | None = Guard(participant)
        self._waitset: WaitSet | None = WaitSet(participant)
        self._waitset.attach(self._guard.reference)
        self.context.executors.add(self)

    # Nodes

    def add_node(self, node: Any) -> bool:
        """Add a node; return whether it was not in this executor yet."""
        with self._lock:
            if node in self._nodes:
                return False
            self._nodes.append(node)
        node.executor = self
        self.entities_changed()
        return True

    def remove_node(self, node: Any) -> None:
        """Remove a node; its callbacks no longer run in this executor."""
        with self._lock:
            if node in self._nodes:
                self._nodes.remove(node)
        node.handle.forget_executor(self)
        self.entities_changed()

    def get_nodes(self) -> list[Any]:
        """Return the nodes of this executor."""
        with self._lock:
            return list(self._nodes)

    # Spinning

    def spin(self) -> None:
        """Run callbacks until shutdown.

        Raises:
            ExternalShutdownException: the context was shut down while the executor waited.
        """
        while self.context.ok() and not self._is_shutdown:
            self.spin_once()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run one callback, waiting for it until the timeout.

        Raises:
            ExternalShutdownException: the context was shut down.
        """
        self._spin_once(timeout_sec, lambda: False)

    def spin_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Run callbacks until a future is done or the timeout has passed."""
        future.add_done_callback(lambda _: self.wake())
        end_s = _end_s(timeout_sec)
        while self.context.ok() and not future.done() and not self._is_shutdown:
            left_s = None if end_s is None else max(0.0, end_s - time.monotonic())
            self._spin_once(left_s, future.done)
            if end_s is not None and time.monotonic() >= end_s:
                return

    def wake(self) -> None:
        """End the wait of the spinning thread; thread-safe."""
        self._woken = True
        if self._waiting:  # otherwise the spinning thread reads _woken before it waits
            with self._lock:
                if self._guard is not None:
                    self._guard.set()

    def entities_changed(self) -> None:
        """Update the set of entities to wait for; call it when they change."""
        self._stale = True
        self.wake()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop spinning, and remove all nodes."""
        self._is_shutdown = True
        for node in self.get_nodes():
            self.remove_node(node)
        self.release()
        return True

    def release(self) -> None:
        """Delete the DDS entities of the executor."""
        with self._lock:
            waitset, guard = self._waitset, self._guard
            self._waitset = self._guard = None
            self._attached = {}
        if guard is not None:
            guard.set()
        if waitset is not None:
            waitset.close()
        if guard is not None:
            guard.close()

    # Waiting and running

    def _spin_once(self, timeout_sec: float | None, done: Callable[[], bool]) -> None:
        end_s = _end_s(timeout_sec)
        while not done() and not self._is_shutdown:
            if not self.context.ok():
                raise ExternalShutdownException()
            if self._run_job():
                return
            left_s = None if end_s is None else end_s - time.monotonic()
            if not self._wait(left_s) and left_s is not None and left_s <= 0.0:
                return

    def _run_job(self) -> bool:
        """Run ready jobs until one had something to do; return whether one had."""
        while self._jobs:
            node, run = self._jobs.popleft()
            if node in self._nodes and run():
                return True
        return False

    def _wait(self, left_s: float | None) -> bool:
        """Wait for a limited time, and queue the ready jobs; return whether there are any."""
        self._woken = False
        self._attach()
        timers = [(node, timer) for node in self.get_nodes() for timer in node.handle.parts(Timer)]
        waits = [wait for _, timer in timers if (wait := timer.wait_ns()) is not None]
        if left_s is not None:
            waits.append(max(0, round(left_s * 1e9)))
        with self._lock:
            waitset, guard = self._waitset, self._guard
        if waitset is None or guard is None:
            raise ExternalShutdownException()
        self._waiting = True
        try:
            triggered = waitset.wait(0 if self._woken else min([_MAX_WAIT_NS, *waits]))
            if guard.reference in triggered:
                guard.take()
        except RCLError:
            if self._waitset is None or not self.context.ok():
                raise ExternalShutdownException() from None
            raise
        finally:
            self._waiting = False
        if not self.context.ok():
            raise ExternalShutdownException()
        for node, timer in timers:
            if timer.is_ready():
                self._jobs.append((node, timer.execute))
        # One message per subscription and wait, so that a busy topic does not starve the others.
        for reference, (node, waitable) in self._attached.items():
            if reference in triggered:
                self._jobs.append((node, waitable.run))
        return bool(self._jobs)

    def _attach(self) -> None:
        """Attach the current entities of the nodes to the wait set."""
        if not self._stale:
            return
        with self._lock:
            self._stale = False
            waitset = self._waitset
            if waitset is None:
                return
            current = {
                waitable.reference: (node, waitable)
                for node in self._nodes
                for waitable in node.handle.waitables()
            }
            for reference in self._attached.keys() - current.keys():
                waitset.detach(reference)
            for reference in list(current.keys() - self._attached.keys()):
                try:
                    waitset.attach(reference)
                except RCLError:
                    del current[reference]  # destroyed in the meantime
            self._attached = current


def _end_s(timeout_sec: float | None) -> float | None:
    return None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec


_global: SingleThreadedExecutor | None = None


def get_global_executor() -> SingleThreadedExecutor:
    """Return the executor that is used if none is given."""
    global _global
    if _global is None or _global._waitset is None or not _global.context.ok():
        context = get_default_context()
        if not context.ok():
            raise NotInitializedException()
        _global = SingleThreadedExecutor(context=context)
    return _global
