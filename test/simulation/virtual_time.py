# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Virtual time and threads: one seeded schedule for all threads of all simulated processes.

Each simulated thread is a real one, but only the thread that holds the baton runs. It passes the
baton on where it blocks: at locks, conditions, sleeps and statements of SQLite. The next thread is
drawn from the seed. Time passes only while all threads wait.
"""

from __future__ import annotations

import heapq
import threading
import time
import traceback
from collections.abc import Callable
from random import Random
from types import TracebackType
from typing import Any
from zlib import crc32

MS, S = 1_000_000, 1_000_000_000
EPOCH_NS = 1_700_000_000 * S
"""Time at which a simulation begins."""

MAX_SWITCHES = 300_000
"""Limit of the switches between threads in a simulation; more of them are a hang."""


class Killed(BaseException):
    """The process of this thread was killed."""


class Hang(Exception):  # noqa: N818
    """No thread can continue, or the threads run without an end."""


class Process:
    """A simulated process: its threads end together."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.is_dead = False
        self.tasks: list[Task] = []


class Task:
    """A thread of a simulated process."""

    def __init__(self, name: str, process: Process) -> None:
        self.name, self.process = name, process
        self.baton = threading.Lock()
        self.baton.acquire()
        self.ticket = 0
        self.is_woken = self.is_done = False
        self.joiners: list[Task] = []
        process.tasks.append(self)


class Scheduler:
    """Chooses the thread that runs, and advances the time."""

    def __init__(self, seed: int | str) -> None:
        self.chance = Random(seed)
        self.now_ns = EPOCH_NS
        self.switches = 0
        self.failures: list[str] = []
        """Tracebacks of the exceptions that ended threads."""
        self.driver = Task('driver', Process('driver'))
        self.current = self.driver
        self.trace_hash = 0
        self.trace: list[str] | None = None
        """Events as text, if they are kept."""
        self._killer: Task | None = None
        self._ready: list[Task] = []
        self._number = 0
        self._timers: list[tuple[int, int, Task, int]] = []
        self._events: list[tuple[int, int, Callable[[], None]]] = []

    def note(self, text: str) -> None:
        """Add an event to the trace."""
        line = f'{(self.now_ns - EPOCH_NS) / 1e9:.6f} {self.current.name} {text}'
        self.trace_hash = crc32(line.encode(), self.trace_hash)
        if self.trace is not None:
            self.trace.append(line)

    def at(self, when_ns: int, event: Callable[[], None]) -> None:
        """Call a function at a time; it must not block."""
        self._number += 1
        heapq.heappush(self._events, (max(when_ns, self.now_ns), self._number, event))

    def start(self, process: Process, name: str, run: Callable[[], None]) -> Task:
        """Start a thread of a process."""
        task = Task(name, process)

        def main() -> None:
            task.baton.acquire()
            try:
                if not process.is_dead:
                    run()
            except Killed:
                pass
            except BaseException:
                if not process.is_dead:
                    self.failures.append(f'{task.name}: {traceback.format_exc()}')
            task.is_done = True
            for joiner in task.joiners:
                self.wake(joiner)
            self.current = self._killer or self._choose()
            self.current.baton.release()

        thread = threading.Thread(target=main, name=name, daemon=True)
        thread.start()
        task.is_woken = True
        self._ready.append(task)
        return task

    def block(self, until_ns: int | None = None) -> bool:
        """Wait until ``wake`` or a time; return whether it was ``wake``; raises Killed."""
        task = self.current
        if task.process.is_dead:
            raise Killed
        task.ticket += 1
        task.is_woken = False
        if until_ns is not None:
            self._number += 1
            heapq.heappush(self._timers, (until_ns, self._number, task, task.ticket))
        chosen = self._choose()
        if chosen is not task:
            self.current = chosen
            chosen.baton.release()
            task.baton.acquire()
        if task.process.is_dead:
            raise Killed
        if self.switches > MAX_SWITCHES and task is self.driver:
            raise Hang('the threads run without an end')
        return task.is_woken

    def wake(self, task: Task) -> None:
        """Let a waiting thread continue."""
        if not task.is_woken and not task.is_done and task is not self.current:
            task.is_woken = True
            task.ticket += 1  # its timer is void
            self._ready.append(task)

    def sleep(self, duration_ns: int) -> None:
        """Wait for a time."""
        end_ns = self.now_ns + duration_ns
        while self.now_ns < end_ns:
            self.block(end_ns)

    def kill(self, process: Process) -> None:
        """End all threads of a process where they are; called by the driver."""
        process.is_dead = True
        self._ready = [task for task in self._ready if task.process is not process]
        killer, self._killer = self._killer, self.current
        for task in process.tasks:
            if not task.is_done:
                before = self.current
                self.current = task
                task.baton.release()
                before.baton.acquire()
        self._killer = killer

    def _choose(self) -> Task:
        """Return the next thread, and advance the time if all wait."""
        self.switches += 1
        if self.switches > MAX_SWITCHES:
            self.failures.append('the threads run without an end')
            return self.driver
        while True:
            while self._events and self._events[0][0] <= self.now_ns:
                try:
                    heapq.heappop(self._events)[2]()
                except Exception:
                    self.failures.append(traceback.format_exc())
            while self._timers and self._timers[0][0] <= self.now_ns:
                _, _, task, ticket = heapq.heappop(self._timers)
                if ticket == task.ticket and not task.is_done and not task.process.is_dead:
                    task.ticket += 1
                    self._ready.append(task)
            if self._ready:
                count = len(self._ready)
                index = self.chance.randrange(count) if count > 1 else 0
                return self._ready.pop(index)
            times = [heap[0][0] for heap in (self._events, self._timers) if heap]
            if not times:
                self.failures.append('no thread can continue')
                return self.driver
            self.now_ns = min(times)


class VirtualTime:
    """The module ``time`` of a simulation."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)

    def time_ns(self) -> int:
        if self._scheduler.current.process.is_dead:
            raise Killed
        return self._scheduler.now_ns

    def monotonic_ns(self) -> int:
        return self.time_ns() - EPOCH_NS + 1000 * S

    perf_counter_ns = monotonic_ns

    def time(self) -> float:
        return self.time_ns() / 1e9

    def monotonic(self) -> float:
        return self.monotonic_ns() / 1e9

    perf_counter = process_time = thread_time = monotonic

    def sleep(self, duration_s: float) -> None:
        self._scheduler.sleep(1 + round(duration_s * 1e9))


class VirtualLock:
    """A reentrant lock; also for ``threading.Lock``, which nobody here acquires twice."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._owner: Task | None = None
        self._depth = 0
        self._waiting: list[Task] = []

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        task = self._scheduler.current
        while self._owner is not None and self._owner is not task:
            if not blocking:
                return False
            self._waiting.append(task)
            self._scheduler.block()
        self._owner = task
        self._depth += 1
        return True

    def release(self) -> None:
        if self._owner is not self._scheduler.current:
            return  # The process was killed while this thread waited in a condition.
        self._depth -= 1
        if self._depth == 0:
            self._owner = None
            self._wake()

    def give_up(self) -> int:
        """Release the lock however often it was acquired; return how often."""
        depth, self._depth, self._owner = self._depth, 0, None
        self._wake()
        return depth

    def restore(self, depth: int) -> None:
        """Acquire the lock as before ``give_up``."""
        self.acquire()
        self._depth = depth

    def _wake(self) -> None:
        waiting, self._waiting = self._waiting, []
        for task in waiting:
            self._scheduler.wake(task)

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class VirtualCondition:
    """``threading.Condition``."""

    def __init__(self, scheduler: Scheduler, lock: VirtualLock | None = None) -> None:
        self._scheduler = scheduler
        self._lock = lock or VirtualLock(scheduler)
        self._waiting: list[Task] = []
        self.acquire, self.release = self._lock.acquire, self._lock.release

    def wait(self, timeout: float | None = None) -> bool:
        # Rounded up, or a thread that waits for the rest of a float would not get there.
        end_ns = None if timeout is None else self._scheduler.now_ns + 1 + round(timeout * 1e9)
        task = self._scheduler.current
        self._waiting.append(task)
        depth = self._lock.give_up()
        woken = self._scheduler.block(end_ns)
        if task in self._waiting:
            self._waiting.remove(task)
        self._lock.restore(depth)
        return woken

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        end_ns = None if timeout is None else self._scheduler.now_ns + round(timeout * 1e9)
        while not (result := predicate()):
            left_ns = None if end_ns is None else end_ns - self._scheduler.now_ns
            if left_ns is not None and left_ns <= 0:
                break
            self.wait(None if left_ns is None else left_ns / 1e9)
        return result

    def notify_all(self) -> None:
        waiting, self._waiting = self._waiting, []
        for task in waiting:
            self._scheduler.wake(task)

    notify = notify_all

    def __enter__(self) -> bool:
        return self._lock.acquire()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        place: TracebackType | None,
    ) -> None:
        self._lock.release()


class VirtualEvent:
    """``threading.Event``."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._condition = VirtualCondition(scheduler)
        self._is_set = False

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        with self._condition:
            self._is_set = True
            self._condition.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        with self._condition:
            return bool(self._condition.wait_for(self.is_set, timeout))


class VirtualThread:
    """``threading.Thread``, in the process of the thread that creates it."""

    def __init__(
        self, scheduler: Scheduler, target: Callable[..., Any], args: tuple[Any, ...] = (),
        name: str = '', daemon: bool = False,
    ) -> None:
        self._scheduler = scheduler
        self._process = scheduler.current.process
        self._name = f'{self._process.name}/{name or target.__name__}'
        self._run = lambda: target(*args)
        self.task: Task | None = None

    def start(self) -> None:
        self.task = self._scheduler.start(self._process, self._name, self._run)

    def is_alive(self) -> bool:
        return self.task is not None and not self.task.is_done

    def join(self, timeout: float | None = None) -> None:
        end_ns = None if timeout is None else self._scheduler.now_ns + round(timeout * 1e9)
        assert self.task is not None
        while not self.task.is_done and (end_ns is None or self._scheduler.now_ns < end_ns):
            self.task.joiners.append(self._scheduler.current)
            self._scheduler.block(end_ns)


class VirtualThreading:
    """The module ``threading`` of a simulation."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def __getattr__(self, name: str) -> Any:
        return getattr(threading, name)

    def Lock(self) -> VirtualLock:  # noqa: N802
        return VirtualLock(self._scheduler)

    RLock = Lock

    def Condition(self, lock: VirtualLock | None = None) -> VirtualCondition:  # noqa: N802
        return VirtualCondition(self._scheduler, lock)

    def Event(self) -> VirtualEvent:  # noqa: N802
        return VirtualEvent(self._scheduler)

    def Thread(self, *, target: Callable[..., Any], **options: Any) -> VirtualThread:  # noqa: N802
        return VirtualThread(self._scheduler, target, **options)

    def current_thread(self) -> Task:
        return self._scheduler.current
