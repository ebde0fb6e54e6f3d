# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writing of a whole map at once."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps.chunks import Compressor, pack
from ratslam_ros.maps.file_writer import unwritable
from ratslam_ros.maps.locks import MapLock
from ratslam_ros.maps.part import PartWriter
from ratslam_ros.maps.saved_map import Cut, MapMeta
from ratslam_ros.maps.schema import (
    NEW,
    beside,
    build,
    check_layout,
    connect,
    end_log,
    remove,
    sync_folder,
)
from ratslam_ros.maps.sessions import begin, newest
from ratslam_ros.version import __version__


def live_meta(configuration: str) -> MapMeta:
    """Return what is known of a map of live nodes with a configuration, as YAML."""
    return MapMeta('live', __version__, configuration)


def save_map(
    path: str | Path, states: Mapping[str, State], meta: MapMeta, cut: Cut | None = None
) -> None:
    """Write a map with one session; an earlier map with this name stays until it is complete.

    Args:
        path: the map file; its folder is created.
        states: by part.
        meta: what is known of the map.
        cut: moment of the states; None for the stamp 0.

    Raises:
        UnusableInput: another process writes the map, the file is no map, or it cannot be written.
    """
    with locked(Path(path), create_folder=True):
        replace_map(Path(path), states, meta, cut)


def replace_map(
    path: Path, states: Mapping[str, State], meta: MapMeta, cut: Cut | None = None
) -> None:
    """Write a map as ``save_map`` does; the caller has locked it."""
    new = beside(path, NEW)
    remove(new)
    try:
        build(new)
        _fill(new, states, meta, Cut(0, 0) if cut is None else cut)
        _end_earlier(path)
        os.replace(new, path)
    except BaseException:
        remove(new)
        raise
    sync_folder(path)


@contextmanager
def locked(path: Path, create_folder: bool = False) -> Iterator[None]:
    """Exclude all other writers of a map.

    Raises:
        UnusableInput: a program writes the map, or its folder cannot be written.
    """
    if path.is_dir():
        raise UnusableInput(f'{path} is a folder; expected a map file')
    try:
        if create_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        lock = MapLock(path.resolve())
        try:
            with lock.opening():
                lock.take_all()
                try:
                    yield
                finally:
                    lock.remove()
        finally:
            lock.close()
    except (OSError, sqlite3.Error) as error:
        raise unwritable(path, error) from None


def _fill(new: Path, states: Mapping[str, State], meta: MapMeta, cut: Cut) -> None:
    compressor = Compressor()
    with closing(connect(new)) as database:
        database.execute('BEGIN IMMEDIATE')
        session = begin(database, sorted(states), meta, newest(database))
        for part, state in sorted(states.items()):
            PartWriter(part, compressor).write(database, session, cut, pack(state))
        database.execute('UPDATE members SET ended = 1')
        database.execute('COMMIT')


def _end_earlier(path: Path) -> None:
    """End the write-ahead log of the map that is replaced, durably."""
    if not path.exists():
        remove(path)  # a log without a map
        sync_folder(path)
        return
    with closing(connect(path)) as database:
        check_layout(database, path)
    as_one_file(path)


def as_one_file(path: Path) -> None:
    """Move the write-ahead log of a map into the map, durably.

    SQLite would apply a log that is left to a file that takes the place of the map.

    Raises:
        UnusableInput: another program reads the map all the time.
    """
    if not end_log(path):
        raise UnusableInput(
            f'{path} is being read by another program; end that program, and try again'
        )
    sync_folder(path)
