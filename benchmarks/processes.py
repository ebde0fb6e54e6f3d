# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes of ratslam commands in a ROS domain of their own, and what they cost. Linux only."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def use_own_domain() -> None:
    """Separate this process and those that it starts from other nodes, unless that is set."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', '101')


def environment() -> dict[str, str]:
    """Return the environment variables for commands of this working tree."""
    paths = filter(None, [str(ROOT), os.environ.get('PYTHONPATH')])
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(paths)}


def started(log: Path, *words: str) -> subprocess.Popen[bytes]:
    """Start a ratslam command in a session of its own, as in a terminal of its own."""
    with log.open('wb') as out:
        return subprocess.Popen(
            [sys.executable, '-m', 'ratslam_ros', *words], env=environment(), stdout=out,
            stderr=out, start_new_session=True, cwd=log.parent,
        )


def wait_for_text(log: Path, process: subprocess.Popen[bytes], pattern: str) -> str:
    """Return the first match of a pattern in the log of a process."""
    while not (found := re.search(pattern, log.read_text())):
        if process.poll() is not None:
            raise SystemExit(log.read_text())
        time.sleep(0.05)
    return found[0]


def parent_and_cpu_s(process: int) -> tuple[int, float]:
    """Return the parent of a process, and the processor time of all its threads in s."""
    fields = Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()
    return int(fields[1]), (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def cpu_s(process: int) -> float:
    """Return the processor time of all threads of a process, in s."""
    return parent_and_cpu_s(process)[1]


def resident_mb(process: int) -> float:
    """Return the resident memory of a process in MB."""
    pages = int(Path(f'/proc/{process}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6
