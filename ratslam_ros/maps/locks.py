# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Locks on a database: each part has one writer at a time, in one process or in several.

The file FILE-lock exists while a map or history is written. It has a row for each part that was
written since then, with the id of the process. Byte 0 is locked while a process opens or closes
the file, and byte 1 + n while the part of row n is written. The operating system releases the
locks of a process however it ends.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps.schema import LOCK, beside, identity

with suppress(ImportError):  # on Windows, where recordings are replayed without a map file
    import fcntl

CAN_LOCK = 'fcntl' in globals()
"""Whether files can be locked. Elsewhere, an interrupted history seems to grow."""

OPENING_S = 30.0
"""Time to wait while another process opens or closes the map, and perhaps restores it."""

TRY_S = 0.02
PROBES = 10
"""Attempts to lock a part: a reader that tests a lock holds it for a moment."""

_ROW_BYTES, _MOST_ROWS = 64, 64


class MapLock:
    """The lock file of a map, opened by one writer."""

    def __init__(self, path: Path) -> None:
        """Open the lock file, and create it if it is missing.

        Raises:
            OSError: it cannot be opened.
        """
        self.path = beside(path, LOCK)
        self._map = path
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        self._parts: tuple[str, ...] = ()

    @contextmanager
    def opening(self) -> Iterator[None]:
        """Exclude other processes that open or close the map.

        Raises:
            UnusableInput: another process did not finish in time.
            OSError: the file cannot be opened.
        """
        until = time.monotonic() + OPENING_S
        while not self._take_current():
            if time.monotonic() > until:
                raise UnusableInput(
                    f'{self._map} is being opened or closed by another process for more than '
                    f'{OPENING_S:g} s; end that process'
                )
            time.sleep(TRY_S)
        try:
            yield
        finally:
            _release(self._file, 0)

    def take(self, parts: Sequence[str]) -> None:
        """Lock parts; raises UnusableInput and locks none if another writer has one of them.

        Call it within ``opening``, as new parts get rows.
        """
        rows = self._rows()
        names = [*dict.fromkeys([*rows, *parts])]
        taken: list[int] = []
        for part in parts:
            byte = 1 + names.index(part)
            if not self._try(byte):
                for other in taken:
                    _release(self._file, other)
                raise UnusableInput(
                    f'{self._map} is in use: {part} is written by process {rows[part]}; end it, '
                    'or choose another file'
                )
            taken.append(byte)
            row = f'{part} {os.getpid()}'.ljust(_ROW_BYTES)
            os.pwrite(self._file, row.encode(), byte * _ROW_BYTES)
        self._parts = tuple(parts)

    def take_all(self) -> None:
        """Lock all parts; see ``take``."""
        self.take([*self._rows(), 'map'])

    def others(self) -> bool:
        """Return whether another writer has a part."""
        for byte, part in enumerate(self._rows(), 1):
            if part not in self._parts:
                if not _take(self._file, byte):
                    return True
                _release(self._file, byte)
        return False

    @property
    def is_current(self) -> bool:
        """Whether the opened file is still the one with this name."""
        own = os.fstat(self._file)
        return identity(self.path) == (own.st_dev, own.st_ino)

    def remove(self) -> None:
        """Remove the file, after which other processes create a new one; see ``opening``."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)

    def end(self) -> None:
        """Release all locks; remove the file if no other writer has a part."""
        with suppress(OSError, UnusableInput), self.opening():
            if not self.others():
                self.remove()
        self.close()

    def close(self) -> None:
        """Release all locks."""
        os.close(self._file)

    def _take_current(self) -> bool:
        """Try to lock byte 0 of the file that has the name now."""
        if not _take(self._file, 0):
            return False
        if self.is_current:
            return True
        # Another process has removed the file at its end, between the two steps.
        os.close(self._file)
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        return False

    def _try(self, byte: int) -> bool:
        for attempt in range(PROBES):
            if attempt:
                time.sleep(TRY_S)
            if _take(self._file, byte):
                return True
        return False

    def _rows(self) -> dict[str, str]:
        """Return the process of each part, in the order of the rows."""
        text = os.pread(self._file, _MOST_ROWS * _ROW_BYTES, _ROW_BYTES).decode('ascii', 'replace')
        rows = (text[at : at + _ROW_BYTES] for at in range(0, len(text), _ROW_BYTES))
        return {part: process.strip() for part, _, process in (row.partition(' ') for row in rows)}


def is_opening(path: Path) -> bool:
    """Return whether a process opens, closes or replaces the map now."""
    return _is_locked(path, 0, 1)


def is_written(path: Path) -> bool:
    """Return whether a process writes parts of the map or history now."""
    return not CAN_LOCK or _is_locked(path, 1, _MOST_ROWS)


def _is_locked(path: Path, byte: int, count: int) -> bool:
    try:
        with beside(path, LOCK).open('rb') as file:
            return not _take(file.fileno(), byte, count, shared=True)
    except OSError:  # Nothing is locked, or nothing can be.
        return False


_LAYOUT = struct.Struct('hhqqi4x')  # struct flock of Linux


def _take(file: int, byte: int, count: int = 1, shared: bool = False) -> bool:
    """Try to lock bytes."""
    try:
        _call(file, byte, fcntl.F_RDLCK if shared else fcntl.F_WRLCK, count)
    except (BlockingIOError, PermissionError):
        return False
    return True


def _release(file: int, byte: int) -> None:
    _call(file, byte, fcntl.F_UNLCK)


def _call(file: int, byte: int, kind: int, count: int = 1) -> None:
    if hasattr(fcntl, 'F_OFD_SETLK'):
        # A lock of the opened file: unlike those of a process, it excludes other writers of the
        # same process, and closing another descriptor of the file does not release it.
        fcntl.fcntl(file, fcntl.F_OFD_SETLK, _LAYOUT.pack(kind, os.SEEK_SET, byte, count, 0))
    else:  # macOS
        modes = {
            fcntl.F_RDLCK: fcntl.LOCK_SH, fcntl.F_WRLCK: fcntl.LOCK_EX,
            fcntl.F_UNLCK: fcntl.LOCK_UN,
        }
        block = 0 if kind == fcntl.F_UNLCK else fcntl.LOCK_NB
        fcntl.lockf(file, modes[kind] | block, count, byte, os.SEEK_SET)
