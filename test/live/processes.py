# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands in child processes, on a ROS domain of their own, all of which are ended."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from helpers import live_environment

ROOT = Path(__file__).parents[2]
TIMEOUT_S = 120.0


class Commands:
    """Runs ratslam commands on the same ROS domain."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._running: list[subprocess.Popen[str]] = []
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])
        self.environment = {**os.environ, **live_environment(), 'PYTHONPATH': path}

    def start(self, *words: str) -> subprocess.Popen[str]:
        """Start a command; read its output with ``communicate``."""
        return self._start([sys.executable, '-m', 'ratslam_ros', *words])

    def start_python(self, code: str, *words: str) -> subprocess.Popen[str]:
        """Start code that may import rclpy; wait until it has printed a line."""
        top = 'from ratslam_ros.live import ros\nros.require()\n'
        process = self._start([sys.executable, '-c', top + code, *words])
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line, process.communicate()[1]
        return process

    def run(self, *words: str) -> tuple[int, str, str]:
        """Run a command until it ends; return its exit code, output and errors."""
        process = self.start(*words)
        out, err = process.communicate(timeout=TIMEOUT_S)
        return process.returncode, out, err

    def close(self) -> None:
        for process in self._running:
            if process.poll() is None:
                process.kill()
            process.communicate()

    def _start(self, command: list[str]) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            command, cwd=self._folder, env=self.environment, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )
        self._running.append(process)
        return process


def wait_for(condition, timeout_s: float = TIMEOUT_S):  # type: ignore[no-untyped-def]
    """Return the first true value of a condition."""
    end_s = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < end_s
        time.sleep(0.02)
    return found
