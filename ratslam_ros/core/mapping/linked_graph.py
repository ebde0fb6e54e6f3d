# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links of the map: how transitions, failed attempts and pruning change them, and relaxation.

``ExperienceMap`` decides which transitions the robot has made.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ratslam_ros.core.common.pose import Pose, composed, corrected_arc, inverse
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.graph import NotLinked
from ratslam_ros.core.mapping.link_learning import (
    count_other_transitions,
    count_time_out,
    least_confident,
)
from ratslam_ros.core.mapping.links import Link, outgoing_from
from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.mapping.map_update import PrunedExperience
from ratslam_ros.core.mapping.robot_on_graph import Departure, RobotOnGraph
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.errors import UnusableInput

LONG_AGO_M = 100.0
"""Driven distance after which a link that was unlearned stays so."""

UNNOTICED_M = 20.0
"""Distance driven before the first doubt in which tries may have failed in a wrong place. A link
that is learned again without need costs one more time-out."""


class Direction(NamedTuple):
    """Distance, and bearing from straight ahead, of a point in the robot's frame."""

    distance_m: float
    direction_rad: float


class MapStatus(NamedTuple):
    """The current experience, -1 before the first one, and those one link away, ascending."""

    current_id: int
    neighbours: list[int]


class LinkedGraph(RobotOnGraph):
    """The experience graph with the robot, and the changes of its links."""

    def __init__(self, origin: Pose, parameters: ExperienceMapParameters) -> None:
        super().__init__(origin, parameters)
        self.parameters = parameters
        """Parameters in force."""
        self._blocked: list[tuple[float, Link]] = []
        """Links that time-outs unlearned of late, with the odometer reading then, in m."""
        self.on_pruned: list[Callable[[int, int, Pose], None]] = []
        """Called with the fields of ``PrunedExperience`` before its links are deleted."""

    def status(self) -> MapStatus:
        """Return the current experience, and those that links connect with it."""
        current = self.current_id
        return MapStatus(current, [] if current == NO_EXPERIENCE else self.neighbours(current))

    def distance_and_direction(self, target_id: int) -> Direction:
        """Return distance and bearing of a neighbour of the current experience from the robot.

        Computed from the shortest of the links between the two.

        Raises:
            NotLinked: the target is not a neighbour of the current experience.
        """
        source = self.current_id
        outgoing = [] if source == NO_EXPERIENCE else [
            link for link in map(outgoing_from(source), self.link_table.of(source))
            if link.target_id == target_id
        ]
        if not outgoing:
            known = self.status().neighbours
            raise NotLinked(
                f'no link connects experience {target_id} and the current one, {source}; its '
                f'neighbours are {", ".join(map(str, known)) or "none"}: choose one of them, or '
                'ask for a route'
            )
        shortest = min(outgoing, key=lambda link: link.distance_m)
        x, y, _ = composed(inverse(self.offset), shortest.relative_pose)
        return Direction(math.hypot(x, y), math.atan2(y, x))

    def move(self, experience_id: int, pose: Pose) -> None:
        """Set the pose of an experience."""
        self._poses[experience_id] = pose

    def unlearn_blocked(self, behaviour: str, ahead_rad: float, here: Pose | None = None) -> int:
        """Count a behaviour that timed out at the robot's pose, and unlearn blocked links.

        The time-out is a failed attempt of every link that passes within ``exp_try_radius_m`` of
        the robot and leads ahead, see ``link_learning.leading_ahead``. The direction and the
        behaviour of a link do not matter, because routes use links in both directions and by any
        behaviour. Nothing is counted before the first experience or while ``mapping`` is False.

        Args:
            behaviour: name of the behaviour; if it is '', nothing is counted.
            ahead_rad: direction in which the behaviour should have driven, in the map frame.
            here: pose of the robot on the map; None: the map's own estimate.

        Returns:
            Number of links that were unlearned.

        Raises:
            UnusableInput: ``ahead_rad`` is not finite.
        """
        if not math.isfinite(ahead_rad):
            raise UnusableInput(f'ahead_rad is {ahead_rad}; expected a finite angle')
        if not behaviour or not self.mapping or self.current_id == NO_EXPERIENCE:
            return 0
        p, here = self.parameters, here or self.pose
        blocked = count_time_out(self.link_table, self._poses.values, here, ahead_rad, p)
        if blocked:
            odometer_m = self._odometer_m
            self._blocked = [
                (at_m, link) for at_m, link in self._blocked if odometer_m - at_m < LONG_AGO_M
            ] + [(odometer_m, self.link_table[row]) for row in blocked]
            self._unlearn(blocked)
        return len(blocked)

    def connect(
        self, source: int, target: int, target_offset: Pose, behaviour: str, is_leaf: bool,
        recognised: bool = False,
    ) -> bool:
        """Add the link of a transition, or average it with the link that exists.

        Then unlearn links from the same source that the behaviour does not drive any more.

        Args:
            source, target: ids of the experiences.
            target_offset: pose of the robot in the frame of the target.
            behaviour: name of the behaviour that made the transition, '' if unknown.
            is_leaf: whether the target is new. Then this link alone determines its pose, and
                nothing has to be relaxed.
            recognised: whether the link is a recognition.

        Returns:
            Whether the link is new.
        """
        relative = composed(self.offset, inverse(target_offset))
        if not recognised:
            relative = corrected_arc(relative, self.optimiser.turns.inverse)
        link = Link.by_pose(
            source, target, relative, self._duration_s, behaviour, recognised=recognised
        )
        row = self.link_table.row(source, target)
        if row is None:
            self.link_table.append(link)
        else:
            self.link_table.average(row, link)
        if row is not None or not is_leaf:
            self.optimiser.links_changed()
        if behaviour:
            count_other_transitions(self.link_table, source, target, behaviour)
            while True:
                p, count = self.parameters, len(self)
                unlikely = least_confident(self.link_table, source, behaviour, p, count)
                if unlikely is None:
                    break
                self._unlearn([unlikely])
        return row is None

    def connect_departure(self, departure: Departure, target: int, target_offset: Pose) -> None:
        """Add the link of the driven path to a new experience, past the known places between.

        Arguments as for ``connect``, whose link starts at the last of these places, and has the
        error of its recognition.
        """
        relative = composed(departure.offset, inverse(target_offset))
        relative = corrected_arc(relative, self.optimiser.turns.inverse)
        self.link_table.append(Link.by_pose(
            departure.experience_id, target, relative, departure.duration_s
        ))
        self.optimiser.links_changed()

    def separate_since(self, odometer_m: float) -> bool:
        """Make a component of what was learned since an odometer reading, as it is elsewhere.

        Links to the rest of the map are deleted. Links that time-outs unlearned since then, or a
        little before, are learned again: the robot was not where they are.

        Returns:
            Whether the robot is in the new component. If its present place was known before, it
            stays there.
        """
        for blocked_m, link in self._blocked:
            ends = link.source_id, link.target_id
            if blocked_m > odometer_m - UNNOTICED_M and self.link_table.row(*ends) is None:
                self.link_table.append(link)
                self._unlearned.discard(ends)
        self._blocked = []
        created = np.flatnonzero(self.created_m > odometer_m).tolist()
        members = {one for one in created if not self.is_apart(one)}
        self._delete([
            row for row, (i, j) in enumerate(self.link_ends.tolist())
            if (i in members) != (j in members)
        ])
        is_member = self.current_id in members
        if is_member:
            self._components.split(members)
        return is_member

    def _unlearn(self, rows: list[int]) -> None:
        """Delete links that can no longer be driven, and record their ends."""
        self._unlearned.update((i, j) for i, j in self.link_ends[rows].tolist())
        self._delete(rows)

    def _delete(self, rows: list[int]) -> None:
        self.link_table.delete(rows)
        self.optimiser.links_changed()

    def _prune(self, pruned_id: int) -> PrunedExperience:
        """Remove an experience from the graph, and link its neighbours past it.

        If it is the current one, its stand-in (``Links.bypass``) becomes current.
        """
        to_stand_in = self.link_table.bypass(pruned_id)
        stand_in = NO_EXPERIENCE if to_stand_in is None else to_stand_in.target_id
        pose = composed(inverse(self.pose_of(stand_in)), self.pose_of(pruned_id))
        if self.current_id == pruned_id:
            self.current_id = stand_in
            if to_stand_in is not None:
                self.offset = composed(to_stand_in.reversed().relative_pose, self.offset)
                self._duration_s += to_stand_in.duration_s
        if self.departure is not None and self.departure.experience_id == pruned_id:
            self.departure = None
        for notify in self.on_pruned:
            notify(pruned_id, stand_in, pose)
        self._delete(self.link_table.rows_at(pruned_id))
        self._unlearned = {ends for ends in self._unlearned if pruned_id not in ends}
        self._blocked = [
            (at_m, link) for at_m, link in self._blocked
            if pruned_id not in (link.source_id, link.target_id)
        ]
        return PrunedExperience(pruned_id, stand_in, pose)

    # Relaxation

    def _relax(self) -> None:
        if self.mapping:
            self.optimiser.step(self._poses.values, self.link_table)

    def settle(self) -> None:
        """Move all experiences close to their most likely poses, whatever the budget."""
        self.optimiser.settle(self._poses.values, self.link_table)


class Closures(Saved):
    """Which transitions to known places are closures of a loop: all, as in the papers."""

    SAVED = (Field('present/scan_checked_m', 'checked_m'),)

    def __init__(self, robot: LinkedGraph, parameters: ExperienceMapParameters) -> None:
        self._robot, self._p = robot, parameters
        self.checked_m = 0.0
        """Odometer reading at the last check of the scan."""

    def judged(
        self, target: int, target_offset: Pose, scan_match: ScanMatch
    ) -> ClosureEvent | None:
        """Return why a transition makes no link, None if it makes one.

        Args:
            target: experience that the robot is at, according to the pose cells.
            target_offset: pose of the robot in its frame.
            scan_match: the robot's pose by scan matching.

        Returns:
            A rejection, or a relocation of the robot.
        """
        return None

    def may_be_at(self, target: int, target_offset: Pose) -> bool:
        """Return whether the robot may be at a recognised place; arguments as for ``judged``."""
        return True

    def check_view(self, template_id: int, scan_match: ScanMatch) -> None:
        """Compare a view with those of the map at the robot's pose."""

    def check_scan(self, scan_match: ScanMatch) -> None:
        """Compare the scan with the map at the robot's pose."""
