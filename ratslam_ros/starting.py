# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Announcement of nodes that are starting on this machine and are not visible over ROS yet.

A first start compiles for up to a minute. `ratslam play` waits for announced nodes. Every process
announces its node by a locked file, so that the announcement ends with the process at the latest.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from ratslam_ros.console import ticking

RESTARTS = 'RATSLAM_RESTARTS'
"""Environment variable with what a node reports that is restarted at short intervals."""

_DEFAULT_DOMAIN = '0'


class _Announcement:
    """The locked file of this process, and the elapsed seconds on a terminal."""

    file: IO[str] | None = None
    shown = ExitStack()


def announce(node: str) -> None:
    """Announce that a node is starting in this process, until `ready`.

    Without file locks, or without a writable folder, nothing is announced.
    """
    with suppress(ImportError, OSError):
        _Announcement.file = _locked(node)
    _Announcement.shown.enter_context(ticking(f'starting {node}:'))


@contextmanager
def announced(node: str) -> Iterator[None]:
    """Announce a node as ``announce`` does, until `ready` or the end of the context."""
    announce(node)
    try:
        yield
    finally:
        ready()


def ready() -> None:
    """End the announcement of this process, if there is one."""
    _Announcement.shown.close()
    file, _Announcement.file = _Announcement.file, None
    if file is not None:
        path = Path(file.name)
        path.with_name(path.name.removeprefix('.')).unlink(missing_ok=True)
        file.close()


def starting() -> list[str]:
    """Return the nodes of this user and ROS domain that are starting, in alphabetical order."""
    found = set()
    with suppress(ImportError, OSError):
        import fcntl

        for path in _folder().glob(f'{_domain()}-*-*'):
            with suppress(FileNotFoundError), path.open(encoding='ascii') as file:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    found.add(path.name.split('-')[1])
                else:
                    path.unlink(missing_ok=True)  # its process has ended
    return sorted(found)


def _locked(node: str) -> IO[str]:
    """Create the file that announces a node of this process."""
    import fcntl  # not on Windows

    folder = _folder()
    folder.mkdir(mode=0o700, exist_ok=True)
    path = folder / f'{_domain()}-{node}-{os.getpid()}'
    file = path.with_name(f'.{path.name}').open('w', encoding='ascii')
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    Path(file.name).rename(path)  # only now visible, because a file without a lock is removed
    return file


def _folder() -> Path:
    return Path(tempfile.gettempdir()) / f'ratslam-starting-{os.getuid()}'


def _domain() -> str:
    return os.environ.get('ROS_DOMAIN_ID') or _DEFAULT_DOMAIN
