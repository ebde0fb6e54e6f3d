# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Transactions of one process on a map file, and what to do if the file cannot be written."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import sessions
from ratslam_ros.maps.chunks import Compressor, pack
from ratslam_ros.maps.input_log import Base
from ratslam_ros.maps.locks import MapLock
from ratslam_ros.maps.part import Image, PartWriter, Row, load, rows_of
from ratslam_ros.maps.reader import unusable
from ratslam_ros.maps.saved_map import Cut, MapMeta, SavedMap, interruption_note, loss_note
from ratslam_ros.maps.schema import (
    NEW,
    SHM,
    WAL,
    beside,
    check_layout,
    connect,
    create,
    end_log,
    identity,
    remove,
    sync_folder,
)


class FileWriter:
    """Writes parts of a map file, each cut in one transaction."""

    def __init__(self, path: Path, parts: tuple[str, ...], meta: MapMeta) -> None:
        """Open the map and begin or join a session; see ``MapStore``."""
        if path.is_dir():
            raise UnusableInput(f'{path} is a folder; expected the name of a map file')
        self.path, self.parts = path.resolve(), parts
        self._meta = self._described = meta
        self.restored: SavedMap | None = None
        """What to restore; None for a new map. It may lack parts that are new in the map."""
        self.joins = False
        """Whether this process was interrupted in the running session and has to catch up."""
        self.number: int | None = None
        """Number of the restored cut if it is of this session; the next ones are larger."""
        self.base = Base(0, 0, 0)
        """The restored cut."""
        self.common: int | None = None
        """Newest cut that all parts of the session had when the last one was written."""
        self.is_interrupted = False
        """Whether this process, or all of them, were interrupted."""
        self.notes: list[str] = []
        """What is missing of the session before, or may be, as it was interrupted."""
        compressor = Compressor()
        self._writers = {part: PartWriter(part, compressor) for part in parts}
        self._session = 0
        self._lock: MapLock | None = None
        self._database: sqlite3.Connection | None = None
        self._identity: tuple[int, int] | None = None
        self._log: dict[str, tuple[int, int] | None] = {}
        """The opened map, and the files of its write-ahead log by suffix, see ``identity``."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._open()
        except (OSError, sqlite3.Error) as error:
            self._abandon()
            raise unwritable(path, error) from None
        except BaseException:
            self._abandon()
            raise

    def write(self, cut: Cut, states: Mapping[str, State]) -> None:
        """Make a cut durable; nothing in the file changes if that fails.

        Raises:
            UnusableInput: the file cannot be written now.
        """
        try:
            database = self._opened()
            meta = self._meta
            database.execute('BEGIN IMMEDIATE')
            try:
                if meta is not self._described:
                    sessions.describe(database, self._session, meta)
                self._write(database, cut, states)
                database.execute('COMMIT')
            except BaseException:
                with suppress(sqlite3.Error):
                    database.execute('ROLLBACK')
                raise
        except (OSError, sqlite3.Error, UnusableInput) as error:
            self._disconnect()  # The next attempt checks the file anew.
            raise unwritable(self.path, error) from None
        self._described = meta
        for part in states:
            self._writers[part].adopt()

    def configure(self, configuration: str) -> None:
        """Record with the next cut that these sections have other values from now on."""
        self._meta = replace(self._meta, configuration=configuration)

    def base_of(self, number: int) -> Base:
        """Return the identity of a cut of this session."""
        return Base(self._inode, self._session, number)

    @property
    def _inode(self) -> int:
        return 0 if self._identity is None else self._identity[1]

    def close(self, complete: bool) -> None:
        """End; the last process leaves a single file.

        Args:
            complete: whether everything has been written.
        """
        if self._lock is None:
            return
        try:
            if self._database is not None:
                self._opened()  # What is in a file that was replaced would be lost.
            lock = self._lock
            with lock.opening():
                database = self._database
                if database is not None and complete and self._is_same_file():
                    database.executemany(
                        'UPDATE members SET ended = 1 WHERE session = ? AND part = ?',
                        [(self._session, part) for part in self.parts],
                    )
                    if not lock.others():
                        sessions.wait_no_longer(database, self._session)
                self._disconnect()
                if not lock.others():
                    if self._is_same_file():
                        end_log(self.path)
                        sync_folder(self.path)
                    lock.remove()
        except (OSError, sqlite3.Error, UnusableInput):
            pass  # What is in the file and its log is complete; the next process opens both.
        finally:
            self.release()

    def _write(self, database: sqlite3.Connection, cut: Cut, states: Mapping[str, State]) -> None:
        """Write a cut within a transaction."""
        (session,) = database.execute('SELECT max(session) FROM sessions').fetchone()
        if session != self._session:
            raise UnusableInput(
                f'{self.path} was opened by another process although this one writes it; end one '
                'of them'
            )
        for part, state in sorted(states.items()):
            writer = self._writers[part]
            writer.write(database, session, cut, pack(state))
            writer.remove_versions(database, sessions.remove_old_cuts(database, session, part))
        self.common = sessions.common_number(
            sessions.members_of(database, session), rows_of(database, 'session = ?', [session])
        )

    # Opening

    def _open(self) -> None:
        """Lock the parts, create the file if necessary, and begin or join a session."""
        self._lock = MapLock(self.path)
        with self._lock.opening():
            self._lock.take(self.parts)
            remove(beside(self.path, NEW))  # of a process that was killed
            if not self.path.exists():
                create(self.path)
            database = self._connect()
            database.execute('BEGIN IMMEDIATE')
            found = sessions.newest(database)
            rows = {part: row for part, row in found.rows.items() if part in self.parts}
            if self._lock.others() and found.session:
                self._session = found.session
                closed = {member.part for member in found.members if member.ended}
                for row in rows_of(database, 'session = ?', [found.session]):
                    if row.part in closed.intersection(self.parts):  # Others may lag behind it.
                        rows[row.part] = row
                self.joins = sessions.join(database, self._session, self.parts, found.number)
                sessions.describe(database, self._session, self._meta)
                for part in self.parts:
                    sessions.drop_after(database, part, rows.get(part))
                database.execute('COMMIT')  # The others need not wait.
                states = self._load(database, rows)
            else:
                self._session = sessions.begin(database, self.parts, self._meta, found)
                states = self._load(database, rows)  # A damaged map is not changed.
                database.execute('COMMIT')
        last = max(rows.values(), key=sessions.age, default=None)
        cut = found.cut if last is None else Cut(last.number, last.stamp_ns)
        self.base = Base(self._inode, *((0, 0) if last is None else (last.session, last.number)))
        if self.base.session == self._session:
            self.number = self.base.number
        lost = found.lost
        if found.session == self._session:  # All that join a session know what it lacks.
            lost = None if self.joins else found.sessions[-1].lost
        self.notes = [] if lost is None else [loss_note(lost, cut)]
        before = found.sessions[:-1] if found.session == self._session else found.sessions
        own = [member.ended for member in found.members if member.part in self.parts]
        ended = own if self.joins else [before[-1].ended] if before else [True]
        self.is_interrupted = not all(ended)
        if lost is None and self.is_interrupted and not self.joins:
            self.notes = [interruption_note(cut)]
        if rows or found.cut is not None:
            self.restored = SavedMap(
                self.path, found.sessions[-1].meta, cut, states, found.sessions, self.notes,
                {part: row.digest for part, row in rows.items()},
            )

    def _load(self, database: sqlite3.Connection, rows: Mapping[str, Row]) -> dict[str, State]:
        """Return the states at cuts, after which the next ones are written."""
        states: dict[str, State] = {}
        for part, writer in self._writers.items():
            row, image = rows.get(part), Image()
            if row is not None:
                try:
                    states[part], image = load(database, row)
                except UnusableInput as error:
                    raise unusable(self.path, error) from None
            writer.start(database, row, image)
        return states

    def _connect(self) -> sqlite3.Connection:
        self._identity = identity(self.path)
        self._database = database = connect(self.path)
        check_layout(database, self.path)
        self._log = {suffix: identity(beside(self.path, suffix)) for suffix in (WAL, SHM)}
        return database

    def _opened(self) -> sqlite3.Connection:
        """Return a connection to the file of this session; raises if there is none now."""
        if self._database is not None and self._is_same_file():
            return self._database
        old, own = self._database, self._identity
        self._database = None
        try:
            for suffix, opened in self._log.items() if old is not None else ():
                # SQLite would use the log for the file that has the name now, and damage both.
                if identity(beside(self.path, suffix)) == opened:
                    beside(self.path, suffix).unlink(missing_ok=True)
            self._reopen(old)
        except (UnusableInput, sqlite3.DatabaseError) as error:
            is_other = identity(self.path) not in (None, own)
            self._identity = own
            if not is_other or isinstance(error, sqlite3.OperationalError):
                raise
            self._abandon()
            # All processes that write the map find the same name.
            self.path = self.path.with_name(f'{self.path.stem}-{self._inode}{self.path.suffix}')
            self._reopen(old)
        finally:
            if old is not None:
                with suppress(sqlite3.Error):
                    old.close()
        assert self._database is not None
        return self._database

    def _is_same_file(self) -> bool:
        return self._identity is not None and identity(self.path) == self._identity

    def _reopen(self, old: sqlite3.Connection | None) -> None:
        """Open the file again after a failure; create it again if it was removed.

        Args:
            old: connection to the file that was removed, from which it is restored; None if the
                newest states alone are written again.
        """
        lock = self._lock
        if lock is None or not lock.is_current:  # The folder or the lock file was removed.
            if lock is not None:
                lock.close()
                self._lock = None
            lock = self._lock = MapLock(self.path)
            with lock.opening():
                lock.take(self.parts)
        with lock.opening():
            if not self.path.exists():
                create(self.path, old)
            database = self._connect()
            database.execute('BEGIN IMMEDIATE')
            if self._is_own(database):
                for part, writer in self._writers.items():
                    # A transaction that failed in its last moment may be there after all.
                    sessions.drop_after(database, part, writer.row)
                database.execute('COMMIT')
                return
            found = sessions.newest(database)
            own = [part for part in self.parts if part in found.rows]
            is_ended = all(member.ended for member in found.members)
            if own or (found.session and (is_ended or not lock.others())):
                raise UnusableInput(f'{self.path} was replaced by another map; move that one away')
            if found.session:
                sessions.join(database, found.session, self.parts, found.number)
                sessions.describe(database, found.session, self._meta)
                self._session = found.session
            else:
                self._session = sessions.begin(database, self.parts, self._meta, found)
            database.execute('COMMIT')
            for writer in self._writers.values():
                writer.start(database, None, {})

    def _is_own(self, database: sqlite3.Connection) -> bool:
        """Return whether a map is the one that this process has written before."""
        (session,) = database.execute('SELECT coalesce(max(session), 0) FROM sessions').fetchone()
        if session != self._session:
            return False
        rows = [writer.row for writer in self._writers.values() if writer.row is not None]
        return all(rows_of(database, 'id = ?', [row.id]) == [row] for row in rows)

    def _disconnect(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            with suppress(sqlite3.Error):
                database.close()

    def _abandon(self) -> None:
        """End after a failed opening."""
        self._disconnect()
        if self._lock is not None:
            self._lock.end()
            self._lock = None

    def release(self) -> None:
        """Close the file and release the locks, as if the process had ended."""
        self._disconnect()
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def unwritable(path: Path, error: Exception) -> UnusableInput:
    """Return in one line why a map cannot be written."""
    text = str(error)
    if isinstance(error, UnusableInput):
        return error
    if isinstance(error, sqlite3.DatabaseError) and (
        'not a database' in text or 'malformed' in text
    ):
        return unusable(path, error)
    reasons = {
        'locked': ('another program has locked it', 'close that program'),
        'full': ('the disk is full', 'free some space'),
        'readonly': ('it is read-only', 'make it writable'),
        'unable to open': ('it cannot be opened', 'check its folder and permissions'),
    }
    for key, (reason, advice) in reasons.items():
        if key in text:
            return UnusableInput(f'{path} cannot be written: {reason}; {advice}')
    if isinstance(error, OSError) and error.strerror:
        text = error.strerror
    return UnusableInput(f'{path} cannot be written ({text}); check its folder and disk')
