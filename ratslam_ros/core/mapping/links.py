# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links: the edges of the experience graph, with geometry, duration, behaviour and counts."""

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
from ratslam_ros.core.common.rows import Rows
from ratslam_ros.core.common.saved import MAX_COUNT, MAX_ID, MAX_NUMBER, Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.mapping.relaxation import corrected_turns


@dataclass(frozen=True, slots=True)
class Link:
    """A transition between two experiences: relative pose, duration, behaviour and count.

    The target is at ``distance_m`` in the direction ``heading_rad`` of the source's frame, and
    its own heading there is ``facing_rad``. ``count``: number of times the transition was made.
    ``recognised``: a recognised view determines the link, and not odometry alone.
    """

    source_id: int
    target_id: int
    distance_m: float
    heading_rad: float
    facing_rad: float
    duration_s: float
    behaviour: str
    count: int
    recognised: bool = False

    @classmethod
    def by_pose(
        cls, source_id: int, target_id: int, relative_pose: Pose, duration_s: float,
        behaviour: str = '', count: int = 1, recognised: bool = False,
    ) -> Link:
        """Return the link to a target with a pose in the frame of the source."""
        x_m, y_m, facing_rad = relative_pose
        return cls(
            source_id, target_id, math.hypot(x_m, y_m), math.atan2(y_m, x_m), facing_rad,
            duration_s, behaviour, count, recognised,
        )

    @property
    def relative_pose(self) -> Pose:
        """Pose of the target in the frame of the source."""
        return Pose(
            self.distance_m * math.cos(self.heading_rad),
            self.distance_m * math.sin(self.heading_rad),
            self.facing_rad,
        )

    def reversed(self) -> Link:
        """Return the link in the opposite direction."""
        back = inverse(self.relative_pose)
        return replace(
            self,
            source_id=self.target_id,
            target_id=self.source_id,
            heading_rad=math.atan2(back.y_m, back.x_m),
            facing_rad=wrap(back.heading_rad),
        )


class Links(Saved):
    """Tables with a row for each link, in the order of creation; at most one per ordered pair."""

    SAVED = (
        Field('ends', '_ends', 'i8', ('links', 2), 0, 'experiences'),
        Field('shapes', '_shapes', 'f8', ('links', 3)),
        Field('durations_s', '_durations_s', 'f8', ('links',), 0.0),
        Field('counts', '_counts', 'i8', ('links',), 0, MAX_COUNT),
        Field('behaviours', '_behaviours', 'i4', ('links',), 0, MAX_ID,
              fits=('numbers of names', lambda numbers, state: (
                  np.max(numbers, initial=-1) < len(state['behaviour_names'])
              ))),
        Field('behaviour_names', 'behaviour_names', list, save=list, load=list,
              fits=('texts', lambda names, _: all(isinstance(name, str) for name in names))),
        Field('failures', '_failures', 'i8', ('links', 2), 0, MAX_COUNT),
        # Left out without recognitions.
        Field('recognised', '_recognised', '?', ('links',), 0, 1,
              when=lambda links: links.recognised.any()),
        Field('shares', '_shares', 'f8', ('links',), when=lambda links: links.recognised.any()),
    )

    def __init__(self) -> None:
        self._ends = Rows(2, np.int64)
        self._shapes = Rows(3)
        self._durations_s = Rows(None)
        self._counts = Rows(None, np.int64)
        self._behaviours = Rows(None, np.int32)
        self._failures = Rows(2, np.int64)
        self._recognised = Rows(None, np.bool_)
        self._shares = Rows(None)
        self.behaviour_names: list[str] = []
        """Names of the behaviours, by their numbers."""
        # Deleting links changes rows but not serial numbers, which ascend with the rows.
        self._serials = Rows(None, np.int64)
        self._serial: dict[tuple[int, int], int] = {}
        self._next_serial = 0
        self.version = 0
        """Counter that grows with every change of a link."""
        self.deletion_count = 0
        """Counter that grows when links are deleted, which moves later links to other rows."""

    def __len__(self) -> int:
        return len(self._ends)

    def __getitem__(self, row: int) -> Link:
        (source, target), (distance, heading, facing) = self._ends[row], self._shapes[row]
        return Link(
            source, target, distance, heading, facing, self._durations_s[row],
            self.behaviour_of(row), self._counts[row], self._recognised[row],
        )

    # Views, valid until links are added or deleted

    @property
    def ends(self) -> NDArray[np.int64]:
        """(links, 2) source and target."""
        return self._ends.values

    @property
    def shapes(self) -> NDArray[np.float64]:
        """(links, 3) distance in m, heading and facing in rad."""
        return self._shapes.values

    @property
    def durations_s(self) -> NDArray[np.float64]:
        """(links,) duration in s."""
        return self._durations_s.values

    @property
    def counts(self) -> NDArray[np.int64]:
        """(links,) number of times each transition was made."""
        return self._counts.values

    @property
    def behaviours(self) -> NDArray[np.int32]:
        """(links,) number of the behaviour in ``behaviour_names``."""
        return self._behaviours.values

    @property
    def failures(self) -> NDArray[np.int64]:
        """(links, 2) numbers of failed attempts; columns: see ``link_learning``."""
        return self._failures.values

    @property
    def recognised(self) -> NDArray[np.bool_]:
        """(links,) whether a link is a recognition."""
        return self._recognised.values

    @property
    def shares(self) -> NDArray[np.float64]:
        """(links,) share of its full weight that a recognition has, see ``link_weights``."""
        return self._shares.values

    @property
    def serials(self) -> NDArray[np.int64]:
        """(links,) serial number, which ascends with the row and is not used again."""
        return self._serials.values

    def row(self, source: int, target: int) -> int | None:
        """Return the row of a link, None if there is no such link."""
        serial = self._serial.get((source, target))
        if serial is None:
            return None
        return int(np.searchsorted(self.serials, serial))

    def rows_at(self, experience_id: int) -> list[int]:
        """Return the rows of the links from and to an experience."""
        rows: list[int] = _rows_at(self.ends, experience_id).tolist()
        return rows

    def rows_by(self, source: int, behaviour: str) -> NDArray[np.int64]:
        """Return the rows of the links that start at an experience and have a behaviour."""
        names = self.behaviour_names
        number = names.index(behaviour) if behaviour in names else -1
        return np.flatnonzero((self.ends[:, 0] == source) & (self.behaviours == number))

    def behaviour_of(self, row: int) -> str:
        """Return the name of the behaviour of a link, '' if unknown."""
        return self.behaviour_names[self._behaviours[row]]

    def of(self, experience_id: int) -> list[Link]:
        """Return the links from and to an experience, except for one from it to itself."""
        links = (self[row] for row in self.rows_at(experience_id))
        return [link for link in links if link.source_id != link.target_id]

    def append(self, link: Link) -> None:
        """Append a link; its ordered pair of experiences must not have one."""
        row = len(self)
        self._ends[row] = link.source_id, link.target_id
        self._shapes[row] = link.distance_m, link.heading_rad, link.facing_rad
        self._durations_s[row], self._counts[row] = link.duration_s, link.count
        self._behaviours[row] = self._behaviour_number(link.behaviour)
        self._failures[row] = 0
        self._recognised[row], self._shares[row] = link.recognised, 1.0
        self._serial[link.source_id, link.target_id] = self._next_serial
        self._serials[row] = self._next_serial
        self._next_serial += 1
        self.version += 1

    def _behaviour_number(self, name: str) -> int:
        if name not in self.behaviour_names:
            self.behaviour_names.append(name)
        return self.behaviour_names.index(name)

    def average(self, row: int, again: Link) -> None:
        """Average a link with a repetition of its transition, each weighted one half.

        Milford, Wyeth and Prasser (2006), equation (6), in polar form.
        """
        distance, heading, facing = self._shapes[row]
        self._shapes[row] = (
            0.5 * (distance + again.distance_m),
            wrap(heading + 0.5 * wrap(again.heading_rad - heading)),
            wrap(facing + 0.5 * wrap(again.facing_rad - facing)),
        )
        self._durations_s[row] = 0.5 * (self._durations_s[row] + again.duration_s)
        if again.behaviour:
            self._behaviours[row] = self._behaviour_number(again.behaviour)
        self._counts[row] += again.count
        self._failures[row] = 0
        self.version += 1

    def correct_turns(self, correction: TurnCorrection) -> None:
        """Correct the turns of all links; see ``corrected_turns``."""
        every = np.ones(len(self), np.bool_)
        self._shapes.replace(corrected_turns(self.shapes, every, *correction))
        self.version += 1

    def delete(self, rows: list[int]) -> None:
        """Delete links; later ones move up and keep their order."""
        for source, target in self.ends[rows].tolist():
            del self._serial[source, target]
        kept = np.delete(np.arange(len(self)), rows)
        for column in vars(self).values():
            if isinstance(column, Rows):
                column.take(kept)
        self.version += 1
        self.deletion_count += 1

    def bypass(self, experience_id: int) -> Link | None:
        """Link the neighbours of an experience that will be removed past it.

        The neighbour at the shortest link becomes its stand-in: the others are linked to it.

        Returns:
            The link from the experience to its stand-in; None if it has no links.
        """
        links = self.of(experience_id)
        if not links:
            return None
        shortest = min(links, key=lambda link: link.distance_m)
        to_stand_in = outgoing_from(experience_id)(shortest)
        others = {end for k in links for end in (k.source_id, k.target_id)}
        for other in sorted(others - {experience_id, to_stand_in.target_id}):
            self._bridge(links, experience_id, to_stand_in.target_id, other)
        return to_stand_in

    def _bridge(self, links: list[Link], middle: int, a: int, b: int) -> None:
        """Add links between a and b that replace the paths through an experience to be removed.

        One link for each direction in which both links of the path were driven; if there is no
        such direction, one from a to b. Nothing is added if a and b are already linked.

        Args:
            links: links of the experience to be removed, from ``of``.
            middle: id of the experience to be removed.
            a, b: ids of two of its neighbours.
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
        ]
        for first, second in through:
            self.append(concatenated(first, second))

    def _restored(self, state: State) -> None:
        count = len(self)
        if 'recognised' not in state:
            self._recognised.replace(np.zeros(count))
            self._shares.replace(np.ones(count))
        self._serial = {(i, j): row for row, (i, j) in enumerate(state['ends'].tolist())}
        self._serials.replace(np.arange(count))
        self._next_serial = count
        self.version += 1


def is_link(fields: list[Any], experience_count: int) -> bool:
    """Return whether saved fields are those of a link between known experiences."""
    source, target, *numbers, behaviour, count, recognised = fields
    return (
        0 <= min(source, target) <= max(source, target) < experience_count
        and len(numbers) == 4 and numbers[3] >= 0.0
        and all(type(n) in (int, float) and abs(n) <= MAX_NUMBER for n in numbers)
        and isinstance(behaviour, str) and 0 <= count <= MAX_COUNT
        and isinstance(recognised, bool) and all(type(n) is int for n in (source, target, count))
    )


def outgoing_from(experience_id: int) -> Callable[[Link], Link]:
    """Return a function that reverses a link of the experience unless it starts there."""
    return lambda link: link if link.source_id == experience_id else link.reversed()


def concatenated(first: Link, second: Link) -> Link:
    """Return the link from the source of the first to the target of the second.

    The first link must end where the second starts.
    """
    return Link.by_pose(
        first.source_id,
        second.target_id,
        composed(first.relative_pose, second.relative_pose),
        first.duration_s + second.duration_s,
        first.behaviour if first.behaviour == second.behaviour else '',
        min(first.count, second.count),
        first.recognised or second.recognised,
    )


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
