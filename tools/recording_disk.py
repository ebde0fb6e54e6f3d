# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A disk that records what maps write, fails on demand, and shows what a power failure leaves."""

from __future__ import annotations

import os
import random
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import apsw

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from ratslam_ros.maps import file_writer, saving, schema

SECTOR = 512
VFS = 'recorder'
CODES = {'EIO': apsw.IOError, 'ENOSPC': apsw.FullError}


@dataclass
class Disk:
    """Operations on files below a folder, and failures of them."""

    folder: Path
    operations: list[tuple[Any, ...]] = field(default_factory=list)
    calls: int = 0
    fails_at: int = 0
    """Number of the call that fails, 0 for none."""
    fails_for: int = 1
    """Number of calls from there on that fail."""
    failure: str = 'EIO'

    def note(self, *operation: Any) -> None:
        """Add an operation."""
        self.operations.append(operation)

    def call(self) -> None:
        """Count a call for SQLite, and let it fail if it is its turn."""
        if self._is_due():
            raise CODES[self.failure](self.failure)

    def call_system(self) -> None:
        """Count a call of the operating system, and let it fail if it is its turn."""
        if self._is_due():
            number = {'EIO': 5, 'ENOSPC': 28}[self.failure]
            raise OSError(number, os.strerror(number))

    def _is_due(self) -> bool:
        self.calls += 1
        return 0 < self.fails_at <= self.calls < self.fails_at + self.fails_for


class RecordingFile(apsw.VFSFile):
    """A file of SQLite whose changes are recorded."""

    def __init__(self, disk: Disk, name: Any, flags: list[int]) -> None:
        self._disk = disk
        self._name = os.path.basename(name.filename() if hasattr(name, 'filename') else name)
        disk.call()
        is_new = not (disk.folder / self._name).exists()
        super().__init__('', name, flags)
        if is_new:
            disk.note('create', self._name)

    def xWrite(self, data: bytes, offset: int) -> None:  # noqa: N802
        """Write bytes."""
        self._disk.call()
        super().xWrite(data, offset)
        self._disk.note('write', self._name, offset, bytes(data))

    def xTruncate(self, size: int) -> None:  # noqa: N802
        """Cut the file off."""
        self._disk.call()
        super().xTruncate(size)
        self._disk.note('truncate', self._name, size)

    def xSync(self, flags: int) -> None:  # noqa: N802
        """Make the content durable."""
        self._disk.call()
        super().xSync(flags)
        self._disk.note('sync', self._name)
        if self._name.endswith(schema.WAL):  # SQLite syncs the folder of a new log with it.
            self._disk.note('sync folder')

    def excepthook(self, *error: Any) -> None:
        """Print nothing: SQLite ignores some failures, such as of the last checkpoint."""


class RecordingVFS(apsw.VFS):
    """File system of SQLite that records changes."""

    def __init__(self, disk: Disk) -> None:
        self._disk = disk
        super().__init__(VFS, '')

    def xOpen(self, name: Any, flags: list[int]) -> RecordingFile:  # noqa: N802
        """Open a file."""
        return RecordingFile(self._disk, name, flags)

    def xDelete(self, name: str, sync: bool) -> None:  # noqa: N802
        """Remove a file."""
        self._disk.call()
        super().xDelete(name, sync)
        self._disk.note('unlink', os.path.basename(name))
        if sync:
            self._disk.note('sync folder')


class Rows:
    """Cursor of apsw with the errors of sqlite3."""

    def __init__(self, cursor: Any) -> None:
        self._cursor = cursor

    def fetchone(self) -> Any:
        """Return the next row, None after the last one."""
        return _translated(self._cursor.fetchone)

    def fetchall(self) -> Any:
        """Return the remaining rows."""
        return _translated(self._cursor.fetchall)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.fetchall())


class Database:
    """The part of ``sqlite3.Connection`` that maps use, on the recording file system."""

    def __init__(self, path: Path, options: str, vfs: str = VFS) -> None:
        flags = apsw.SQLITE_OPEN_URI | apsw.SQLITE_OPEN_READWRITE | apsw.SQLITE_OPEN_CREATE
        uri = f'{path.absolute().as_uri()}?{options}'
        self._connection = _translated(lambda: apsw.Connection(uri, flags=flags, vfs=vfs))
        self._connection.set_busy_timeout(100)
        self.execute('PRAGMA synchronous = FULL')

    def execute(self, text: str, values: Any = ()) -> Rows:
        """Execute a statement."""
        return Rows(_translated(lambda: self._connection.execute(text, tuple(values))))

    def executemany(self, text: str, rows: Any) -> None:
        """Execute a statement for each row."""
        _translated(lambda: list(self._connection.executemany(text, list(rows))))

    def executescript(self, text: str) -> None:
        """Execute several statements."""
        self.execute(text)

    def close(self) -> None:
        """End the connection."""
        _translated(self._connection.close)


def _translated(call: Callable[[], Any]) -> Any:
    try:
        return call()
    except apsw.CantOpenError:
        raise sqlite3.OperationalError('unable to open database file') from None
    except apsw.FullError:
        raise sqlite3.OperationalError('database or disk is full') from None
    except apsw.NotADBError as error:
        raise sqlite3.DatabaseError(f'file is not a database ({error})') from None
    except apsw.Error as error:
        raise sqlite3.OperationalError(f'disk I/O error ({error})') from None


@contextmanager
def recording(disk: Disk) -> Iterator[None]:
    """Let all writing of maps go through a disk."""
    vfs = RecordingVFS(disk)

    def connect(path: Path, options: str = 'mode=rw', layout: schema.Layout = schema.MAP) -> Any:
        return Database(path, options)

    def noted(function: Callable[..., Any], kind: str) -> Callable[..., Any]:
        def call(*paths: Any, **options: Any) -> Any:
            names = [os.path.basename(path) for path in paths]
            if any(name.endswith((schema.LOCK, schema.SHM)) for name in names) or (
                Path(paths[0]).parent != disk.folder
            ):
                return function(*paths, **options)
            disk.call_system()
            existed = Path(paths[0]).exists()
            result = function(*paths, **options)
            if existed:
                disk.note(kind, *names)
            return result

        return call

    def sync(file: int) -> None:
        disk.call_system()
        disk.note('sync folder')

    with ExitStack() as stack:
        for module in (schema, saving, file_writer):
            stack.enter_context(patch.object(module, 'connect', connect))
        for owner, name, kind in (
            (os, 'link', 'link'), (os, 'replace', 'rename'), (Path, 'rename', 'rename'),
            (Path, 'unlink', 'unlink'),
        ):
            stack.enter_context(patch.object(owner, name, noted(getattr(owner, name), kind)))
        stack.enter_context(patch.object(os, 'fsync', sync))
        try:
            yield
        finally:
            vfs.unregister()


# Reconstruction


class File:
    """Content of a file: what is durable, and writes that are not."""

    def __init__(self, content: bytes = b'') -> None:
        self.durable = bytearray(content)
        self.waiting: list[tuple[Any, ...]] = []

    def sync(self) -> None:
        """Make all writes durable."""
        for change in self.waiting:
            _apply(self.durable, change)
        self.waiting.clear()

    def after(self, changes: list[tuple[Any, ...]]) -> bytes:
        """Return the content if these writes reach the disk."""
        content = bytearray(self.durable)
        for change in changes:
            _apply(content, change)
        return bytes(content)


def _apply(content: bytearray, change: tuple[Any, ...]) -> None:
    if change[0] == 'truncate':
        del content[change[1] :]
        return
    _, offset, data = change
    if len(content) < offset:
        content.extend(bytes(offset - len(content)))
    content[offset : offset + len(data)] = data


def _sectors(change: tuple[Any, ...]) -> list[tuple[Any, ...]]:
    """Return a write as writes that a power failure does not tear."""
    if change[0] == 'truncate':
        return [change]
    _, offset, data = change
    parts = []
    while data:
        length = SECTOR - offset % SECTOR
        parts.append(('write', offset, data[:length]))
        offset, data = offset + length, data[length:]
    return parts


VARIANTS = 'nothing', 'everything', 'torn', 'last only', 'some', 'some'


def crash_states(
    operations: list[tuple[Any, ...]], generator: random.Random, limit: int
) -> Iterator[tuple[int, str, dict[str, bytes]]]:
    """Yield files that crashes can leave.

    Args:
        operations: of a disk.
        generator: chooses the sectors that reach the disk.
        limit: number of states, besides those after the last operation; 0 for all.

    Yields:
        Number of operations before the crash, variant, and content by name.
    """
    chosen = [(at, n) for at in range(len(operations) + 1) for n in range(len(VARIANTS))]
    if limit and limit < len(chosen):
        last = chosen[-len(VARIANTS) :]  # Everything has been acknowledged there.
        chosen = sorted({*generator.sample(chosen, limit), *last})
    wanted: dict[int, list[int]] = {}
    for at, number in chosen:
        wanted.setdefault(at, []).append(number)
    names: dict[str, File] = {}
    durable_names: dict[str, File] = {}
    waiting: list[tuple[Any, ...]] = []
    """Changes of names that are not durable."""
    for at in range(len(operations) + 1):
        for number in wanted.get(at, []):
            variant = VARIANTS[number]
            yield at, variant, _left(durable_names, waiting, variant, generator)
        if at < len(operations):
            kind, *values = operations[at]
            if kind == 'sync folder':
                waiting.clear()
                durable_names = dict(names)
            elif kind == 'put':  # a file with durable content
                names[values[0]] = durable_names[values[0]] = File(values[1])
            elif kind == 'sync':
                names[values[0]].sync()
            elif kind in ('write', 'truncate'):
                names[values[0]].waiting.append((kind, *values[1:]))
            else:
                change = (kind, *values, File()) if kind == 'create' else (kind, *values)
                _rename(names, change)
                waiting.append(change)


def _rename(names: dict[str, File], change: tuple[Any, ...]) -> None:
    kind, name, *rest = change
    if kind == 'create':
        names[name] = rest[0]
    elif kind == 'unlink':
        names.pop(name, None)
    elif name in names:
        names[rest[0]] = names[name] if kind == 'link' else names.pop(name)


def _left(
    names: dict[str, File], waiting: list[tuple[Any, ...]], variant: str, generator: random.Random
) -> dict[str, bytes]:
    names = dict(names)
    for change in waiting:
        is_there = {'nothing': False, 'some': generator.random() < 0.5}.get(variant, True)
        if is_there:
            _rename(names, change)
    files = {}
    for name, file in names.items():
        changes = list(file.waiting)
        if variant == 'nothing':
            changes = []
        elif variant == 'torn' and changes:
            parts = _sectors(changes[-1])
            changes[-1:] = parts[: generator.randrange(len(parts))]
        elif variant == 'last only':
            changes = changes[-1:]
        elif variant == 'some':
            share = generator.random()
            parts = [part for change in changes for part in _sectors(change)]
            changes = [part for part in parts if generator.random() < share]
        files[name] = file.after(changes)
    return files
