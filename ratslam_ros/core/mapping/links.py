# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links: the transitions that were made between experiences, and how they went."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.state import State


@dataclass(frozen=True, slots=True)
class Link:
    """A transition that was made: where the target lies in the source's frame, and how it went."""

    source_id: int
    target_id: int
    distance_m: float
    heading_rad: float
    facing_rad: float
    duration_s: float
    behaviour: str
    count: int

    @property
    def way(self) -> Pose:
        """Where the target lies in the frame of the source."""
        return Pose(
            self.distance_m * math.cos(self.heading_rad),
            self.distance_m * math.sin(self.heading_rad),
            self.facing_rad,
        )

    def reversed(self) -> Link:
        """Return the same way, the other way round."""
        back = inverse(self.way)
        return replace(
            self,
            source_id=self.target_id,
            target_id=self.source_id,
            heading_rad=math.atan2(back.y_m, back.x_m),
            facing_rad=wrap(back.heading_rad),
        )


class Links:
    """Rows of arrays, in the order in which the links were made; one for a source and a target."""

    def __init__(self) -> None:
        self._ends = np.empty((64, 2), np.int64)
        self._shapes = np.empty((64, 3), np.float64)
        self._durations_s = np.empty(64, np.float64)
        self._failures = np.empty((64, 2), np.int64)
        self.notes: list[tuple[str, int]] = []
        """Behaviour and count of every link."""
        # A link's serial number stays while rows move up; serials ascend with the rows.
        self._serial: dict[tuple[int, int], int] = {}
        self._serials = np.empty(64, np.int64)
        self._next_serial = 0
        self.version = 0
        """Grows with every change of a link."""
        self.rebuilt = 0
        """Grows where links vanish: then others have moved up to their rows."""

    def __len__(self) -> int:
        return len(self.notes)

    def __getitem__(self, row: int) -> Link:
        source, target = self._ends[row].tolist()
        distance, heading, facing = self._shapes[row].tolist()
        duration = float(self._durations_s[row])
        return Link(source, target, distance, heading, facing, duration, *self.notes[row])

    # Views, which hold until the next link is made or deleted

    @property
    def ends(self) -> NDArray[np.int64]:
        """(links, 2) source and target."""
        return self._ends[: len(self)]

    @property
    def shapes(self) -> NDArray[np.float64]:
        """(links, 3) distance, heading and facing."""
        return self._shapes[: len(self)]

    @property
    def durations_s(self) -> NDArray[np.float64]:
        """(links,) duration."""
        return self._durations_s[: len(self)]

    @property
    def failures(self) -> NDArray[np.int64]:
        """(links, 2) failed tries, see ``adaptation``."""
        return self._failures[: len(self)]

    def row(self, source: int, target: int) -> int | None:
        """Return the row of a link, None if there is no such link."""
        serial = self._serial.get((source, target))
        if serial is None:
            return None
        return int(np.searchsorted(self._serials[: len(self)], serial))

    def rows_at(self, experience_id: int) -> list[int]:
        """Return the rows of the links from and to an experience."""
        rows: list[int] = _rows_at(self.ends, experience_id).tolist()
        return rows

    def rows_by(self, source: int, behaviour: str) -> list[int]:
        """Return the rows of the links from an experience that were made by a behaviour."""
        return [
            row for row in self.rows_at(source)
            if self.notes[row][0] == behaviour and self._ends[row, 0] == source
        ]  # fmt: skip

    def of(self, experience_id: int) -> list[Link]:
        """Return the links from and to an experience, but for one from it to itself."""
        links = (self[row] for row in self.rows_at(experience_id))
        return [link for link in links if link.source_id != link.target_id]

    def append(self, link: Link) -> None:
        """Add a link that there is not yet."""
        row = len(self)
        if row == len(self._ends):
            self._ends = with_room(self._ends, 2 * row)
            self._shapes = with_room(self._shapes, 2 * row)
            self._durations_s = with_room(self._durations_s, 2 * row)
            self._failures = with_room(self._failures, 2 * row)
            self._serials = with_room(self._serials, 2 * row)
        self._ends[row] = link.source_id, link.target_id
        self._shapes[row] = link.distance_m, link.heading_rad, link.facing_rad
        self._durations_s[row] = link.duration_s
        self._failures[row] = 0
        self._serial[link.source_id, link.target_id] = self._next_serial
        self._serials[row] = self._next_serial
        self._next_serial += 1
        self.notes.append((link.behaviour, link.count))
        self.version += 1

    def average(self, row: int, again: Link) -> None:
        """Take that a transition was made again: half of what was known, half of this time."""
        distance, heading, facing = self._shapes[row].tolist()
        self._shapes[row] = (
            0.5 * (distance + again.distance_m),
            wrap(heading + 0.5 * wrap(again.heading_rad - heading)),
            wrap(facing + 0.5 * wrap(again.facing_rad - facing)),
        )
        self._durations_s[row] = 0.5 * (self._durations_s[row] + again.duration_s)
        known, count = self.notes[row]
        self.notes[row] = again.behaviour or known, count + again.count
        self._failures[row] = 0
        self.version += 1

    def delete(self, rows: list[int]) -> None:
        """Take links away; the others move up, in their order."""
        for source, target in self._ends[rows].tolist():
            del self._serial[source, target]
        gone = np.zeros(len(self), np.bool_)
        gone[rows] = True
        _move_up(
            gone, self._ends, self._shapes, self._durations_s, self._failures, self._serials
        )
        for row in sorted(rows, reverse=True):
            del self.notes[row]
        self.version += 1
        self.rebuilt += 1

    def join_past(self, links: list[Link], middle: int, a: int, b: int) -> None:
        """Make of the links between a, an experience and b such as lead past that experience.

        In each direction that was driven all through, or else from a to b; none where the two
        are linked as it is. ``links``: those of that experience, as ``of`` gives them.
        """
        if self.row(a, b) is not None or self.row(b, a) is not None:
            return
        driven = {(k.source_id, k.target_id): k for k in links}
        through = [
            (driven[i, middle], driven[middle, j])
            for i, j in ((a, b), (b, a)) if (i, middle) in driven and (middle, j) in driven
        ] or [
            (
                driven.get((a, middle)) or driven[middle, a].reversed(),
                driven.get((middle, b)) or driven[b, middle].reversed(),
            )
        ]  # fmt: skip
        for first, second in through:
            self.append(in_a_row(first, second))

    def state(self) -> State:
        """Return all links, for ``restore``."""
        return {
            'ends': self.ends.copy(),
            'shapes': self.shapes.copy(),
            'notes': [
                [duration, *note]
                for duration, note in zip(self.durations_s.tolist(), self.notes, strict=True)
            ],
            'failures': self.failures.copy(),
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave in place of all links."""
        self._ends = with_room(state['ends'])
        self._shapes = with_room(state['shapes'])
        self._durations_s = with_room(np.array([duration for duration, *_ in state['notes']]))
        self.notes = [(name, count) for _, name, count in state['notes']]
        links = len(self)
        # Memories of before links learned have no failures.
        self._failures = with_room(state.get('failures', np.zeros((links, 2), np.int64)))
        self._serial = {(i, j): row for row, (i, j) in enumerate(state['ends'].tolist())}
        self._serials = with_room(np.arange(links))
        self._next_serial = links
        self.version += 1


def leading_from(experience_id: int) -> Callable[[Link], Link]:
    """Return what turns the links of an experience such that all lead away from it."""
    return lambda link: link if link.source_id == experience_id else link.reversed()


def length_m(link: Link) -> float:
    """Return how far apart the ends of a link are."""
    return link.distance_m


def in_a_row(first: Link, second: Link) -> Link:
    """Return the link that leads where two lead one after the other."""
    x, y, turn = composed(first.way, second.way)
    return Link(
        first.source_id,
        second.target_id,
        math.hypot(x, y),
        math.atan2(y, x),
        turn,
        first.duration_s + second.duration_s,
        first.behaviour if first.behaviour == second.behaviour else '',
        min(first.count, second.count),
    )


def with_room(rows: NDArray[Any], most: int = 64) -> NDArray[Any]:
    """Return an array that begins with the given rows, and has room for so many."""
    room = np.empty((max(most, len(rows)), *rows.shape[1:]), rows.dtype)
    room[: len(rows)] = rows
    return room


@compiled
def _rows_at(ends: NDArray[np.int64], experience_id: int) -> NDArray[np.int64]:
    """Return the rows of the links from and to an experience."""
    rows = np.empty(ends.shape[0], np.int64)
    count = 0
    for row in range(ends.shape[0]):
        if ends[row, 0] == experience_id or ends[row, 1] == experience_id:
            rows[count] = row
            count += 1
    return rows[:count].copy()


@compiled
def _move_up(
    gone: NDArray[np.bool_], ends: NDArray[np.int64], shapes: NDArray[np.float64],
    durations_s: NDArray[np.float64], failures: NDArray[np.int64], serials: NDArray[np.int64],
) -> None:  # fmt: skip
    """Let the rows that are not gone follow one another, in their order."""
    to = 0
    for row in range(gone.shape[0]):
        if gone[row]:
            continue
        for column in range(2):
            ends[to, column] = ends[row, column]
            failures[to, column] = failures[row, column]
        for column in range(3):
            shapes[to, column] = shapes[row, column]
        durations_s[to] = durations_s[row]
        serials[to] = serials[row]
        to += 1
