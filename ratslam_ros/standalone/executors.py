# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The executor: waits for everything at once, and calls back one after the other."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from ratslam_ros.standalone.context import Context, get_default_context
from ratslam_ros.standalone.dds import Guard, WaitSet
from ratslam_ros.standalone.exceptions import NotInitializedException, RCLError
from ratslam_ros.standalone.node_parts import Source
from ratslam_ros.standalone.task import Future
from ratslam_ros.standalone.timer import Timer

_LONGEST_WAIT_NS = 100_000_000
"""A signal is noticed within this time: Python's handlers only run between waits."""


class ExternalShutdownException(Exception):  # noqa: N818
    """The context was shut down while an executor waited."""


class SingleThreadedExecutor:
    """Runs the callbacks of nodes in the thread that spins."""

    def __init__(self, *, context: Context | None = None) -> None:
        self.context = get_default_context() if context is None else context
        self._lock = threading.RLock()
        self._nodes: list[Any] = []
        self._jobs: deque[tuple[Any, Callable[[], bool]]] = deque()
        self._attached: dict[int, tuple[Any, Source]] = {}
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
        """Take over a node's callbacks; return whether it was not one of ours."""
        with self._lock:
            if node in self._nodes:
                return False
            self._nodes.append(node)
        node.executor = self
        self.change()
        return True

    def remove_node(self, node: Any) -> None:
        """Leave a node's callbacks to others."""
        with self._lock:
            if node in self._nodes:
                self._nodes.remove(node)
        node.handle.forget_executor(self)
        self.change()

    def get_nodes(self) -> list[Any]:
        """Return the nodes whose callbacks are run."""
        with self._lock:
            return list(self._nodes)

    # Spinning

    def spin(self) -> None:
        """Run callbacks until shutdown.

        Raises:
            ExternalShutdownException: the context was shut down while it waited.
        """
        while self.context.ok() and not self._is_shutdown:
            self.spin_once()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run one callback, or wait until the timeout for one.

        Raises:
            ExternalShutdownException: the context was shut down.
        """
        self._spin_once(timeout_sec, lambda: False)

    def spin_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Run callbacks until a future is done, or the time is over."""
        future.add_done_callback(lambda _: self.wake())
        end_s = _end_s(timeout_sec)
        while self.context.ok() and not future.done() and not self._is_shutdown:
            left_s = None if end_s is None else max(0.0, end_s - time.monotonic())
            self._spin_once(left_s, future.done)
            if end_s is not None and time.monotonic() >= end_s:
                return

    def wake(self) -> None:
        """End the wait of the thread that spins; any thread may."""
        self._woken = True
        if self._waiting:  # else it looks at what was said above before it waits
            with self._lock:
                if self._guard is not None:
                    self._guard.set()

    def change(self) -> None:
        """Look anew at what there is to wait for."""
        self._stale = True
        self.wake()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """End spinning, and leave all nodes."""
        self._is_shutdown = True
        for node in self.get_nodes():
            self.remove_node(node)
        self.release()
        return True

    def release(self) -> None:
        """Let go of what DDS holds."""
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

    def __enter__(self) -> SingleThreadedExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()

    # One round

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
        """Run what is ready, the first that has anything to do."""
        while self._jobs:
            node, run = self._jobs.popleft()
            if node in self._nodes and run():
                return True
        return False

    def _wait(self, left_s: float | None) -> bool:
        """Wait for a short time, and find what is ready; return whether anything is."""
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
            triggered = waitset.wait(0 if self._woken else min([_LONGEST_WAIT_NS, *waits]))
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
        # One message each, then the next round: no topic keeps the others waiting.
        for reference, (node, source) in self._attached.items():
            if reference in triggered:
                self._jobs.append((node, source.run))
        return bool(self._jobs)

    def _attach(self) -> None:
        """Wait for what the nodes have now."""
        if not self._stale:
            return
        with self._lock:
            self._stale = False
            waitset = self._waitset
            if waitset is None:
                return
            wanted = {
                s.reference: (node, s) for node in self._nodes for s in node.handle.sources()
            }
            for reference in self._attached.keys() - wanted.keys():
                waitset.detach(reference)
            for reference in list(wanted.keys() - self._attached.keys()):
                try:
                    waitset.attach(reference)
                except RCLError:
                    del wanted[reference]  # destroyed meanwhile
            self._attached = wanted


Executor = SingleThreadedExecutor


class MultiThreadedExecutor:
    """Not offered."""

    def __init__(self, *_: Any, **__: Any) -> None:
        raise NotImplementedError(
            'the stand-in for rclpy runs callbacks in one thread: use SingleThreadedExecutor'
        )


def _end_s(timeout_sec: float | None) -> float | None:
    return None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec


_global: SingleThreadedExecutor | None = None


def get_global_executor() -> SingleThreadedExecutor:
    """Return the executor that is meant where none is named."""
    global _global
    if _global is None or _global._waitset is None or not _global.context.ok():
        context = get_default_context()
        if not context.ok():
            raise NotInitializedException()
        _global = SingleThreadedExecutor(context=context)
    return _global
