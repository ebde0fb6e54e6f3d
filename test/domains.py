# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS domains for tests, none of which two processes use at the same time."""

from __future__ import annotations

import fcntl
import os
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

DOMAINS = 100
"""Number of ROS domains for tests; benchmarks and tools use 101. From 102 on, ports are those
of other connections."""

_locks: list[Any] = []
"""Locked files of the domains that this process has taken, open until it ends."""


@cache
def own_domain(number: int = 0) -> int:
    """Return a ROS domain that no other test process of this machine uses until this one ends.

    Args:
        number: which one, for tests that need several.
    """
    folder = Path(tempfile.gettempdir())
    for n in range(DOMAINS):
        domain = 1 + (os.getpid() + n) % DOMAINS
        try:
            file = (folder / f'ratslam-test-domain-{domain}').open('w')
        except OSError:
            continue  # of another user
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            continue
        _locks.append(file)
        return domain
    raise AssertionError(f'all {DOMAINS} ROS domains are in use: remove {folder}/ratslam-test-*')
