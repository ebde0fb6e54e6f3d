# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""SQLite in virtual time: threads change between statements, waiting for locks takes virtual time.

The files are real ones. A disk that is full refuses what would change them.
"""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
from contextlib import suppress
from pathlib import Path
from typing import Any

from virtual_time import MS, Killed, Process, S, Scheduler

BUSY_NS = 5 * S
"""Time for which a statement waits for another connection."""

RETRY_NS = 3 * MS
CHANGES = 'INSERT', 'UPDATE', 'DELETE', 'COMMIT', 'CREATE', 'BEGIN; '
COMMIT_NS = 8 * MS
"""Longest time that a commit takes."""


class Disk:
    """The disk of a simulation, and who has opened files on it."""

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler
        self.full_until_ns = 0
        self.connections: dict[Process, list[Connection]] = {}
        self.locks: dict[Process, list[Any]] = {}

    def __getattr__(self, name: str) -> Any:
        """Return what is left as it is of the module ``sqlite3``."""
        return getattr(sqlite3, name)

    def connect(self, name: str, **options: Any) -> sqlite3.Connection:
        """Open a database, in place of ``sqlite3.connect``."""
        if name == ':memory:':
            return sqlite3.connect(name, **options)
        options['timeout'] = 0.0
        database = sqlite3.connect(name, factory=Connection, **options)
        database.use(self)
        self.connections.setdefault(database.process, []).append(database)
        return database

    def write(self, file: int, data: bytes) -> int:
        """Write to a log, in place of ``os.write``."""
        if self.scheduler.now_ns < self.full_until_ns:
            raise OSError(errno.ENOSPC, 'No space left on device')
        return os.write(file, data)

    def kill(self, process: Process, path: Path) -> None:
        """Close what a killed process has opened, and leave the files as they are."""
        open_ones = [one for one in self.connections.pop(process, ()) if one.is_open]
        others = any(one.is_open for found in self.connections.values() for one in found)
        kept = []
        if open_ones and not others:  # SQLite would move the log into the file.
            for file in (path, path.with_name(f'{path.name}-wal')):
                if file.exists():
                    kept.append((file, file.with_name(f'kept{file.name}')))
                    shutil.copyfile(*kept[-1])
        for one in open_ones:
            sqlite3.Connection.close(one)
        for file, copy in kept:
            shutil.copyfile(copy, file)  # The map keeps its inode.
            copy.unlink()
        for lock in self.locks.pop(process, ()):
            with suppress(OSError):
                lock.close()


class Connection(sqlite3.Connection):
    """A connection of a simulated process."""

    disk: Disk
    process: Process
    is_open = True

    def use(self, disk: Disk) -> None:
        """Belong to the process that runs now."""
        self.disk, self.process = disk, disk.scheduler.current.process

    def execute(self, text: str, *values: Any) -> sqlite3.Cursor:
        self._pause(text)
        return self._retried(lambda: sqlite3.Connection.execute(self, text, *values))

    def executemany(self, text: str, *values: Any) -> sqlite3.Cursor:
        self._pause(text)
        return self._retried(lambda: sqlite3.Connection.executemany(self, text, *values))

    def executescript(self, text: str) -> sqlite3.Cursor:
        self._pause(text)
        return self._retried(lambda: sqlite3.Connection.executescript(self, text))

    def close(self) -> None:
        if self.process.is_dead:
            raise Killed
        self.is_open = False
        super().close()

    def _pause(self, text: str) -> None:
        """Let other threads run, and fail if the disk is full."""
        scheduler = self.disk.scheduler
        if self.process.is_dead:
            raise Killed
        if text == 'COMMIT':
            scheduler.sleep(scheduler.chance.randrange(COMMIT_NS))
        elif text.startswith(('BEGIN', 'INSERT')):
            scheduler.sleep(scheduler.chance.randrange(MS))
        if text.startswith(CHANGES) and scheduler.now_ns < self.disk.full_until_ns:
            scheduler.note('disk full')
            raise sqlite3.OperationalError('database or disk is full')

    def _retried(self, run: Any) -> sqlite3.Cursor:
        scheduler = self.disk.scheduler
        end_ns = scheduler.now_ns + BUSY_NS
        while True:
            try:
                return run()  # type: ignore[no-any-return]
            except sqlite3.OperationalError as error:
                busy = 'locked' in str(error) or 'busy' in str(error)
                if not busy or scheduler.now_ns >= end_ns:
                    raise
            scheduler.sleep(RETRY_NS)
