# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Layouts of databases, their creation, and connections to them that trust nothing in them."""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Iterable
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import guard_database, schema_of
from ratslam_ros.maps.chunks import DamagedData

_T = TypeVar('_T')


@dataclass(frozen=True, slots=True)
class Layout:
    """A kind of database.

    Attributes:
        kind: its name, for messages.
        application_id: `application_id` in the file.
        version: of the layout, `user_version` in the file.
        schema: its tables, in SQL.
        advice: what to do about a file that is damaged or older.
        synchronous: `FULL` if a power failure may not lose a transaction, otherwise `OFF`.
    """

    kind: str
    application_id: int
    version: int
    schema: str
    advice: str = 'use a backup'
    synchronous: str = 'FULL'


# The table `log` is no longer used; with it, maps have the same layout as before.
MAP = Layout('map', 0x52534C4D, 1, """
CREATE TABLE sessions (
    session INTEGER PRIMARY KEY, base_ns INTEGER, lost_from_ns INTEGER, lost_to_ns INTEGER,
    meta TEXT NOT NULL
);
CREATE TABLE members (
    session INTEGER NOT NULL, part TEXT NOT NULL, joined INTEGER, ended INTEGER NOT NULL,
    PRIMARY KEY (session, part)
) WITHOUT ROWID;
CREATE TABLE cuts (
    id INTEGER PRIMARY KEY, session INTEGER NOT NULL, part TEXT NOT NULL,
    number INTEGER NOT NULL, stamp_ns INTEGER NOT NULL,
    outline_bytes INTEGER NOT NULL, digest BLOB NOT NULL,
    UNIQUE (session, part, number)
);
CREATE TABLE chunks (
    part TEXT NOT NULL, array TEXT NOT NULL, position INTEGER NOT NULL, since INTEGER NOT NULL,
    data BLOB NOT NULL
);
CREATE UNIQUE INDEX chunk_versions ON chunks (part, array, position, since);
CREATE TABLE log (
    stream TEXT NOT NULL, stamp_ns INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (stream, stamp_ns)
);
""")  # 'RSLM'

BUSY_S = 5.0
"""Time to wait for a transaction of another process; own transactions take milliseconds."""

MAX_FILE_BYTES = 2**36
"""Largest accepted size of a map file, 64 GB: far above a map at the default limits."""

MAX_VALUE_BYTES = 2**26
"""Largest value of a row that SQLite may allocate, 64 MB; a chunk has 8 kB."""

WAL, SHM, JOURNAL, NEW, LOCK = '-wal', '-shm', '-journal', '.new', '-lock'


def beside(path: Path, suffix: str) -> Path:
    """Return the file beside a map with a suffix, such as its write-ahead log."""
    return path.with_name(path.name + suffix)


def identity(path: Path) -> tuple[int, int] | None:
    """Return device and inode of a file, None if there is none."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino


def connect(path: Path, options: str = 'mode=rw', layout: Layout = MAP) -> sqlite3.Connection:
    """Open a database; statements are committed one by one, unless BEGIN starts a transaction.

    The connection trusts nothing in the file: no functions in its schema, and checked pages.

    Args:
        path: the file.
        options: query of an SQLite URI.
        layout: its layout.

    Raises:
        sqlite3.Error: the file cannot be opened.
    """
    if path.is_fifo():
        raise sqlite3.OperationalError('it is a pipe')  # to open it would block
    database = sqlite3.connect(
        f'{path.absolute().as_uri()}?{options}', uri=True, isolation_level=None, timeout=BUSY_S,
        check_same_thread=False,
    )
    guard_database(database, MAX_VALUE_BYTES)
    database.text_factory = str
    if 'mode=rw' in options:
        database.execute(f'PRAGMA synchronous = {layout.synchronous}')
    return database


def check_layout(database: sqlite3.Connection, path: Path, layout: Layout = MAP) -> None:
    """Check that a database has this layout with exactly the expected tables.

    Raises:
        UnusableInput: it has not.
        sqlite3.Error: it cannot be read.
    """
    (application,) = database.execute('PRAGMA application_id').fetchone()
    (version,) = database.execute('PRAGMA user_version').fetchone()
    kind, expected = layout.kind, layout.version
    if application != layout.application_id:
        if not schema_of(database):  # a file that was created, and nothing written to it
            raise UnusableInput(
                f'{path} is empty: expected a {kind} of RatSLAM; remove it, or choose another file'
            )
        raise UnusableInput(
            f'{path} is another kind of database, not a {kind} of RatSLAM; choose another file'
        )
    if version > expected:
        raise UnusableInput(
            f'{path} was written by a newer version of ratslam_ros ({kind} format {version}, this '
            f'version reads up to {expected}); update ratslam_ros'
        )
    if 0 < version < expected:
        raise UnusableInput(
            f'{path} was written by an earlier version of ratslam_ros ({kind} format {version}, '
            f'this version reads {expected}); {layout.advice}'
        )
    if version != expected or schema_of(database) != _expected(layout.schema):
        raise UnusableInput(
            f'{path} is damaged or was changed by another program: its tables are not those of '
            f'{kind} format {expected}; {layout.advice}'
        )


def typed(rows: Iterable[Any], kind: type[_T]) -> list[_T]:
    """Return rows as tuples of a type: SQLite stores any type in any column.

    Raises:
        DamagedData: a value has another type.
    """
    try:
        return msgspec.convert([*rows], list[kind])  # type: ignore[valid-type]
    except msgspec.ValidationError as error:
        raise DamagedData(f'a row is damaged ({error})') from None


def create(path: Path, source: sqlite3.Connection | None = None) -> None:
    """Create a map under its name in one step, or find that there is one now.

    The caller holds the lock on the map.

    Args:
        path: the file.
        source: the map that is copied; None for an empty one.

    Raises:
        OSError, sqlite3.Error: the file cannot be created.
    """
    remove(path)  # SQLite would apply the log of a map that was deleted to the new one.
    new = beside(path, NEW)
    remove(new)
    if source is None:
        build(new)
    else:
        with closing(connect(new, 'mode=rwc')) as database:
            source.backup(database)
    sync_folder(path)
    try:
        os.link(new, path)  # Unlike a rename, it never replaces a file.
    except FileExistsError:
        remove(new)
        return
    except OSError:  # a file system without hard links
        new.rename(path)
    remove(new)
    sync_folder(path)


def build(path: Path, layout: Layout = MAP) -> None:
    """Write an empty database to a file that does not exist, and sync it as the layout says."""
    with closing(connect(path, 'mode=rwc', layout)) as database:
        database.execute('PRAGMA journal_mode = WAL')
        database.execute(f'PRAGMA application_id = {layout.application_id}')
        database.execute(f'PRAGMA user_version = {layout.version}')
        database.executescript(f'BEGIN; {layout.schema} COMMIT;')
    with path.open('rb') as file:
        header = file.read(20)
    if header[18:] != b'\x02\x02':  # SQLite ignores that it cannot delete its first journal.
        raise sqlite3.OperationalError(f'{path} has no write-ahead log after it was created')


def remove(path: Path) -> None:
    """Remove a database with all files of SQLite beside it."""
    for suffix in (WAL, SHM, JOURNAL, ''):
        beside(path, suffix).unlink(missing_ok=True)


ATTEMPTS, ATTEMPT_S = 20, 0.05
"""Attempts to end a log while readers are active."""


def end_log(path: Path, layout: Layout = MAP) -> bool:
    """Move the write-ahead log into the file; return whether it is gone.

    SQLite does so when the last connection is closed; readers may have one for a moment. The
    caller holds the lock on the map, and no writer has it open.

    Raises:
        sqlite3.Error, UnusableInput: the map cannot be used.
    """
    for attempt in range(ATTEMPTS):
        if not beside(path, WAL).exists():
            return True
        if attempt:
            time.sleep(ATTEMPT_S)
        with closing(connect(path, layout=layout)) as database:
            check_layout(database, path, layout)
    return not beside(path, WAL).exists()


def sync_folder(path: Path) -> None:
    """Make the names of new files in the folder of a file durable."""
    with suppress(OSError):  # It cannot be read, or its file system cannot sync folders.
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@cache
def _expected(schema: str) -> list[tuple[str, str, str, str | None]]:
    with closing(sqlite3.connect(':memory:')) as database:
        database.executescript(schema)
        return schema_of(database)
