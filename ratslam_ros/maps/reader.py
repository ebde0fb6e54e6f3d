# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reading of maps that trusts nothing in them, and changes nothing."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps.chunks import DamagedData
from ratslam_ros.maps.locks import OPENING_S, is_opening, is_written
from ratslam_ros.maps.part import load
from ratslam_ros.maps.saved_map import MapMeta, SavedMap, loss_note
from ratslam_ros.maps.schema import MAX_FILE_BYTES, WAL, beside, check_layout, connect
from ratslam_ros.maps.sessions import newest

ATTEMPTS, ATTEMPT_S = 20, 0.05
"""Attempts to read a map while processes begin or end to write it."""

T = TypeVar('T')


def read_map(path: str | Path, owned: bool = False) -> SavedMap:
    """Read the newest state of a map, also while it is being written.

    Args:
        path: the map file.
        owned: the caller has locked the map, see ``saving.locked``.

    Raises:
        UnusableInput: it does not exist, is damaged, or is no map.
    """
    path = Path(path).resolve()
    return reading(path, lambda database: saved_map(database, path), owned)


def reading(
    path: Path, read: Callable[[sqlite3.Connection], T], owned: bool = False
) -> T:
    """Call a function with a connection to a map that cannot change it.

    Args:
        path: the map file.
        read: is called with the connection within a transaction, perhaps more than once.
        owned: the caller has locked the map.

    Raises:
        UnusableInput: the file cannot be used.
    """
    for attempt in range(ATTEMPTS):
        until = time.monotonic() + OPENING_S
        while not owned and is_opening(path) and time.monotonic() < until:
            time.sleep(ATTEMPT_S)
        before = _identity(path)
        is_live = not owned and is_written(path)
        try:
            with _opened(path, is_live) as database:
                database.execute('BEGIN')
                check_layout(database, path)
                result = read(database)
        except (sqlite3.Error, OSError, UnicodeError, DamagedData) as error:
            if attempt + 1 < ATTEMPTS and (
                is_live or is_written(path) or _identity(path) != before
            ):
                time.sleep(ATTEMPT_S)  # A writer may be beginning or ending.
                continue
            raise unusable(path, error) from None
        # An unlocked file was read without locks: it must not have changed.
        if is_live or (_identity(path) == before and (owned or not is_written(path))):
            return result
    raise UnusableInput(
        f'{path} changes all the time without a lock; end the program that writes it'
    )


def saved_map(database: sqlite3.Connection, path: Path) -> SavedMap:
    """Return the newest state of an opened map."""
    found = newest(database)
    states, digests = {}, {}
    for part, row in sorted(found.rows.items()):
        states[part], _ = load(database, row)
        digests[part] = row.digest
    notes = [] if found.lost is None else [loss_note(found.lost, found.cut)]
    meta = found.sessions[-1].meta if found.sessions else MapMeta()
    return SavedMap(path, meta, found.cut, states, found.sessions, notes, digests)


def unusable(path: Path, error: Exception) -> UnusableInput:
    """Return in one line why a map cannot be used."""
    is_malformed = isinstance(error, sqlite3.Error) and 'malformed' in str(error)
    if is_malformed or isinstance(error, DamagedData):
        return UnusableInput(f'{path} is damaged ({error}); use a backup')
    if isinstance(error, UnusableInput):
        return error if str(path) in str(error) else UnusableInput(f'{path}: {error}')
    if isinstance(error, FileNotFoundError) or not path.exists():
        return UnusableInput(f'{path} does not exist; expected a map file')
    if path.is_dir():
        return UnusableInput(
            f'{path} is a folder; expected a map file (files of nodes, *.npz, are of an earlier '
            'version: load them with it, and save one map with its service ratslam/save_map)'
        )
    if 'not a database' in str(error):
        return UnusableInput(f'{path} is not a map file; choose another file')
    return UnusableInput(f'{path} cannot be read ({error}); check the file and its folder')


@contextmanager
def _opened(path: Path, is_live: bool) -> Iterator[sqlite3.Connection]:
    """Open a map for reading: in place, or a copy of it if its log has to be applied first."""
    if is_live:
        with closing(connect(path, 'mode=ro')) as database:
            yield database
    elif not beside(path, WAL).exists():
        with closing(connect(path, 'mode=ro&immutable=1')) as database:
            yield database
    else:
        with tempfile.TemporaryDirectory(prefix='ratslam-map-') as folder:
            copy = Path(folder) / 'map'
            shutil.copyfile(path, copy)
            shutil.copyfile(beside(path, WAL), beside(copy, WAL))
            with closing(connect(copy)) as database:
                database.execute('PRAGMA synchronous = OFF')
                yield database


def _identity(path: Path) -> list[tuple[int, ...]]:
    """Return what changes when a map or its log is written; raises UnusableInput."""
    found: list[tuple[int, ...]] = []
    for file in (path, beside(path, WAL)):
        try:
            status = file.stat()
        except FileNotFoundError:
            found.append(())
            continue
        except OSError as error:
            raise unusable(path, error) from None
        if status.st_size > MAX_FILE_BYTES:
            raise UnusableInput(
                f'{file} has {status.st_size} bytes, expected at most {MAX_FILE_BYTES} for a map'
            )
        found.append((status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns))
    if not found[0]:
        raise unusable(path, FileNotFoundError())
    return found
