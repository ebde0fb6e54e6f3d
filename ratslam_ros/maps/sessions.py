# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sessions: which cuts of the parts belong together, what a new session starts from, what stays.

A session begins when a process opens a map that no other process writes. Processes that open it
later join the session. The parts of a session that have a cut of the same number have processed
exactly the same messages, so that the newest number that all of them have is the map. A part that
was closed receives nothing more: its last cut holds for all later numbers.

A part that was interrupted in the session before is awaited from the beginning of a session: it
needs what the others have received since the last cut that all had. This ends when another part
has as many cuts as are kept, or when all others have been closed.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.files.config import combined_yaml
from ratslam_ros.maps.part import Row, check_part, rows_of
from ratslam_ros.maps.saved_map import Cut, MapMeta, SessionRow
from ratslam_ros.maps.schema import typed

KEPT_CUTS = 16
"""Number of the newest cuts of a part that stay, besides the one that all parts have. A part may
lag behind the others by as many, 32 s for live nodes, and the map is still as old as that part."""

MAX_SESSIONS = 64
"""Number of sessions whose description stays."""

AWAITED = 2
"""Value of `ended` of a part that was interrupted in the session before, until it joins."""

TRANSIENT = ('inputs',)
"""Parts that are worth nothing without the others of the same cut: messages that were held."""


class Member(NamedTuple):
    """A part of a session, as in the table ``members``.

    Attributes:
        part: its name.
        joined: newest cut of all members when it joined, None if there was none.
        ending: 1 if it has been closed, ``AWAITED`` if it was interrupted in the session before
            and has not joined this one, otherwise 0.
    """

    part: str
    joined: int | None
    ending: int

    @property
    def ended(self) -> bool:
        """Whether it has been closed."""
        return self.ending == 1


@dataclass(frozen=True, slots=True)
class Newest:
    """The newest state of a map at which all parts belong together.

    Attributes:
        session: the last session, 0 if there is none.
        members: its parts.
        cut: the newest cut; None if nothing has been saved.
        number: its number if it is of the last session, None if it is older.
        rows: the cut of each part; parts that the last session did not use have older ones.
        lost: stamps from which and to which the last session is missing in it, in ns; also what
            the session before it lost, if nothing of the last one was saved.
        sessions: all sessions, oldest first.
    """

    session: int
    members: Sequence[Member]
    cut: Cut | None
    number: int | None
    rows: Mapping[str, Row]
    lost: tuple[int, int] | None
    sessions: list[SessionRow]


def newest(database: sqlite3.Connection) -> Newest:
    """Return the newest state of a map."""
    (session,) = database.execute('SELECT coalesce(max(session), 0) FROM sessions').fetchone()
    members, sessions = members_of(database, session), _sessions_of(database)
    present = rows_of(database, 'session = ?', [session])
    number = common_number(members, present)
    rows: dict[str, Row] = {row.part: row for row in rows_of(database, 'session < ?', [session])}
    names = {member.part for member in members}
    if number is not None:
        for part in set(TRANSIENT) & (rows.keys() - names):
            del rows[part]
        rows |= {row.part: row for row in present if row.number <= number}
    last = max(rows.values(), key=age, default=None)
    cut = None if last is None else Cut(last.number, last.stamp_ns)
    stamps = [row.stamp_ns for row in present if number is None or row.number > number]
    lost = None
    if number is not None and cut is not None:
        if max(stamps, default=cut.stamp_ns) > cut.stamp_ns:
            lost = cut.stamp_ns, max(stamps)
    else:
        # What the session before lost was not reported either if this one was killed at once.
        stamps += [ns for row in sessions[-1:] for ns in row.lost or ()]
        if stamps:
            lost = min(stamps), max(stamps)
    return Newest(session, members, cut, number, rows, lost, sessions)


def age(row: Row) -> tuple[int, int, int]:
    """Return a key by which later cuts are larger.

    At the end of a session, parts have the same number and the stamps of their last messages.
    """
    return row.session, row.number, row.stamp_ns


def members_of(database: sqlite3.Connection, session: int) -> list[Member]:
    """Return the parts of a session."""
    found = database.execute(
        'SELECT part, joined, ended FROM members WHERE session = ? ORDER BY part', (session,)
    )
    members = typed(found, Member)
    for member in members:
        check_part(member.part)
    return members


def common_number(members: Sequence[Member], rows: Sequence[Row]) -> int | None:
    """Return the newest cut that all members of a session have, None if there is none."""
    numbers = {member.part: set[int]() for member in members}
    for row in rows:
        numbers.setdefault(row.part, set()).add(row.number)
    candidates = set[int]().union(*numbers.values())
    for number in sorted(candidates, reverse=True):
        if all(
            number in numbers[member.part]
            or (member.joined is not None and number <= member.joined)
            or (member.ended and number >= max(numbers[member.part], default=number))
            for member in members
        ):
            return number
    return None


def begin(
    database: sqlite3.Connection, parts: Sequence[str], meta: MapMeta, base: Newest
) -> int:
    """Begin a session at the newest state, within a transaction; return its number.

    Later cuts of the last session are removed, and so is its log.
    """
    if base.session:
        # Without a cut of the last session, that of the session before it is the newest.
        after = -(2**63) if base.number is None else base.number + 1
        dropped = rows_of(database, 'session = ? AND number >= ?', [base.session, after])
        unused = {row.part for row in rows_of(database, '1', [])} - base.rows.keys()
        for part in sorted(unused | {row.part for row in dropped}):
            drop_after(database, part, base.rows.get(part))
        earlier = base.sessions[-1].meta.configuration
        meta = replace(meta, configuration=_combined(earlier, meta.configuration))
    database.execute('DELETE FROM log')
    session, base_ns = base.session + 1, None if base.cut is None else base.cut.stamp_ns
    database.execute(
        'INSERT INTO sessions VALUES (?, ?, ?, ?, ?)',
        (session, base_ns, *(base.lost or (None, None)), meta.to_json()),
    )
    for table in ('sessions', 'members'):
        database.execute(f'DELETE FROM {table} WHERE session <= ?', (session - MAX_SESSIONS,))
    join(database, session, parts, None)
    if not set(TRANSIENT) & set(parts):  # A replay is a single process.
        database.executemany('INSERT INTO members VALUES (?, ?, NULL, ?)', [
            (session, member.part, AWAITED) for member in base.members
            if not member.ended and member.part not in (*parts, *TRANSIENT)
        ])
    return session


def drop_after(database: sqlite3.Connection, part: str, row: Row | None) -> None:
    """Delete the cuts of a part after one of them, or all, within a transaction."""
    last = 0 if row is None else row.id
    database.execute('DELETE FROM cuts WHERE part = ? AND id > ?', (part, last))
    database.execute('DELETE FROM chunks WHERE part = ? AND since > ?', (part, last))


def describe(database: sqlite3.Connection, session: int, meta: MapMeta) -> None:
    """Add the sections of the configuration that a process uses to those of the others.

    Args:
        database: the map.
        session: its last session.
        meta: the description with these sections.
    """
    (text,) = database.execute(
        'SELECT meta FROM sessions WHERE session = ?', (session,)
    ).fetchone()
    present = MapMeta.from_json(text)
    sections = _combined(present.configuration, meta.configuration)
    database.execute(
        'UPDATE sessions SET meta = ? WHERE session = ?',
        (replace(present, configuration=sections).to_json(), session),
    )


def _combined(earlier: str, later: str) -> str:
    """Return ``combined_yaml``, or the later configuration if the earlier one is damaged."""
    try:
        return combined_yaml(earlier, later)
    except (UnusableInput, UnusableParameter):  # It must not prevent saving.
        return later


def join(
    database: sqlite3.Connection, session: int, parts: Sequence[str], number: int | None
) -> bool:
    """Add parts to a session, within a transaction.

    Args:
        database: the map.
        session: its last session.
        parts: the parts.
        number: newest cut that all members have.

    Returns:
        Whether one of the parts has been in this session before, and was interrupted.
    """
    before = {one.part for one in members_of(database, session) if one.ending != AWAITED}
    for part in parts:
        database.execute(
            'INSERT INTO members VALUES (?, ?, ?, 0) ON CONFLICT (session, part) DO UPDATE'
            ' SET joined = iif(ended, excluded.joined, joined), ended = 0',
            (session, part, number),
        )
    return bool(before & set(parts))


def wait_no_longer(database: sqlite3.Connection, session: int) -> None:
    """Remove the awaited parts from a session, as they have not joined it."""
    database.execute('DELETE FROM members WHERE session = ? AND ended = ?', (session, AWAITED))


def remove_old_cuts(database: sqlite3.Connection, session: int, part: str) -> list[int]:
    """Delete the cuts of a part that are not needed any more, within a transaction.

    Returns:
        The ids of those that stay.
    """
    present = rows_of(database, 'session = ?', [session])
    own = [row for row in present if row.part == part]
    if len(own) >= KEPT_CUTS:
        wait_no_longer(database, session)
    number = common_number(members_of(database, session), present)
    kept = {row.id for row in own[-KEPT_CUTS:]} | {row.id for row in own if row.number == number}
    if not any(row.number == number for row in own):
        older = rows_of(database, 'session < ? AND part = ?', [session, part])
        kept |= {row.id for row in older[-1:]}
    for row in rows_of(database, 'part = ?', [part]):
        if row.id not in kept:
            database.execute('DELETE FROM cuts WHERE id = ?', (row.id,))
    return sorted(kept)


def _sessions_of(database: sqlite3.Connection) -> list[SessionRow]:
    found = database.execute(
        'SELECT session, lost_from_ns, lost_to_ns, meta FROM sessions ORDER BY session'
    ).fetchall()
    rows = []
    for session, from_ns, to_ns, meta in typed(found, tuple[int, int | None, int | None, str]):
        members = members_of(database, session)
        rows.append(SessionRow(
            session, MapMeta.from_json(meta),
            None if from_ns is None or to_ns is None else (from_ns, to_ns),
            bool(members) and all(member.ended for member in members),
        ))
    return rows
