# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Child processes that are started and ended together, and started again if they fail."""

from __future__ import annotations

import ctypes
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence

from ratslam_ros.console import print_notice
from ratslam_ros.errors import INTERRUPTED, UNUSABLE
from ratslam_ros.signals import STOP_SIGNALS, StopSignals
from ratslam_ros.starting import RESTARTS

SHUTDOWN_TIMEOUT_S = 20.0
"""Time for the nodes to end, which includes writing a map."""

POLL_S = 0.05

STABLE_S = 60.0
"""A node that has run for this long is started again at once."""

PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0
"""Pause before the second restart of a node that is not stable; it about doubles each time."""

FORWARDED_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_PR_SET_PDEATHSIG = 1


def supervise(
    commands: Mapping[str, Sequence[str]], optional: Collection[str] = (), respawn: bool = False,
    are_nodes: bool = False,
) -> int:
    """Run commands until all have ended.

    A stop signal is forwarded to the commands; a second one kills them. If a command ends by
    itself, the others are stopped too, unless it is optional or started again.

    Args:
        commands: command lines by name.
        optional: names of commands that the others do not need: if one ends, the others go on.
        respawn: start commands again that were killed or ended with an error.
        are_nodes: all commands are ``ratslam run``, which handles stop signals.

    Returns:
        The exit code: 0 if all commands ended without error after a stop signal, otherwise 1.
    """
    children: list[_Child] = []
    with StopSignals(FORWARDED_SIGNALS, raise_on_second=False) as signals:
        try:
            for name, command in commands.items():
                children.append(_Child(name, command, are_nodes))
            return _watch(children, optional, signals, respawn)
        finally:
            for child in children:  # After any error, none may be left.
                if child.process.poll() is None:
                    child.process.kill()
                child.process.wait()


def end_with_parent() -> Callable[[], object] | None:
    """Return a function that makes a child end if this process is killed (Linux only)."""
    if sys.platform != 'linux':
        return None
    libc = ctypes.CDLL(None)  # Loaded before the fork, after which few functions are safe.
    return lambda: libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class _Child:
    """A command and its process, which may be started again."""

    def __init__(self, name: str, command: Sequence[str], is_node: bool) -> None:
        self.name = name
        self._command, self._is_node = command, is_node
        self._start()
        self._restarts = 0
        """Number of restarts in succession at short intervals."""
        self._due: tuple[float, str] | None = None
        """When to start the command again, and what its node reports then."""

    def _start(self, restarts: str = '') -> None:
        # A node begins with stop signals blocked, and `StopAtOnce` receives them: before, they
        # would end in a traceback of the interpreter.
        blocked = STOP_SIGNALS if self._is_node else ()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, blocked)
        try:
            # In a session of its own: Ctrl-C in the terminal reaches it only through `supervise`.
            self.process = subprocess.Popen(
                self._command, stdin=subprocess.DEVNULL, start_new_session=True,
                preexec_fn=end_with_parent(), env={**os.environ, RESTARTS: restarts},
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._started_s = time.monotonic()

    @property
    def is_running(self) -> bool:
        """Whether the process has not ended."""
        return self.process.returncode is None

    def restart(self) -> bool:
        """Start a command that has failed again after its pause; return whether it waits."""
        if self.process.returncode in (None, 0, UNUSABLE):
            return False
        now_s = time.monotonic()
        if self._due is None:
            count = self._restarts if now_s - self._started_s < STABLE_S else 0
            pause_s = min(PAUSE_S * (2**count - 1), LONGEST_PAUSE_S)
            after = f' in {pause_s:g} s' if pause_s else ''
            print_notice(f'ratslam launch: {self.ending}; starting it again{after}')
            report = f'restart {count + 1} at short intervals, after {pause_s:g} s: {self.ending}'
            self._restarts, self._due = count + 1, (now_s + pause_s, report if count else '')
        due_s, report = self._due
        if now_s < due_s:
            return True
        self._due = None
        self._start(report)
        return False

    @property
    def ending(self) -> str:
        """How the process has ended."""
        code = self.process.returncode
        if code < 0:
            return f'{self.name} was ended by {signal.Signals(-code).name}'
        return f'{self.name} ended with code {code}'


def _watch(
    children: Sequence[_Child], optional: Collection[str], signals: StopSignals, respawn: bool
) -> int:
    forwarded, failed, kill_at_s = 0, False, math.inf
    needed = [child for child in children if child.name not in optional]
    while True:
        for child in children:  # Once, as one that ends meanwhile has to wait first.
            child.process.poll()
        restarts = respawn and not (forwarded or failed or signals.count)
        going = [child for child in children if (restarts and child.restart()) or child.is_running]
        running = [child for child in children if child.is_running]
        if not going:
            break
        names, number = ', '.join(child.name for child in running), None
        if signals.count > 1 or time.monotonic() > kill_at_s:
            print_notice(f'ratslam launch: killing {names}')
            number = signal.SIGKILL
        elif signals.count > forwarded:
            forwarded, number = signals.count, signals.last
        elif not forwarded and not failed and (
            ended := [child.ending for child in needed if child not in going]
        ):
            print_notice(f'ratslam launch: {", ".join(ended)}; stopping {names}')
            failed, number = True, signal.SIGINT
        if number is not None:
            for child in running:
                child.process.send_signal(number)
            kill_at_s = time.monotonic() + SHUTDOWN_TIMEOUT_S
        if number == signal.SIGKILL:
            break
        time.sleep(POLL_S)
    # During start-up a process may end by the signal itself, or as an interrupted command.
    ends = 0, INTERRUPTED, *(-number for number in FORWARDED_SIGNALS)
    expected = ends if forwarded else ()
    bad = [child for child in needed if child.process.wait() not in expected]
    if bad and not failed:
        print_notice(f'ratslam launch: {", ".join(child.ending for child in bad)}')
    return 1 if bad or failed else 0
