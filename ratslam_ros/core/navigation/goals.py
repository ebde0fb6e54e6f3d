# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goals and named places on the experience map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import Field, Saved, named_numbers
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_planner import RoutePlanner, check_on_map, nowhere_because
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.errors import UnreachableGoal

AT_EXPERIENCE = Pose(0.0, 0.0, 0.0)
"""Offset of a goal that lies at its experience."""

MAX_ANCHOR_M = 1.0
"""Distance between a goal and its experience above which the goal is given another anchor, in m.

Pruning can leave a goal farther from its experience than this, possibly with a wall between them.
"""

MAX_NAME_CHARACTERS = 100
"""Longest name of a goal, in characters."""


@dataclass(frozen=True, slots=True)
class Goal:
    """A goal, anchored at an experience so that it moves with the map.

    Attributes:
        experience_id: the anchor.
        offset: pose of the goal in the frame of the anchor.
        name: name of the place, empty for none.
    """

    experience_id: int
    offset: Pose = AT_EXPERIENCE
    name: str = ''

    def pose_on(self, experience_map: ExperienceMap) -> Pose:
        """Return the pose of the goal on the map."""
        return composed(experience_map.pose_of(self.experience_id), self.offset)

    def reanchored(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> Goal:
        """Return the goal after an experience was removed from the map.

        Args:
            experience_id: the removed experience.
            stand_in_id: the experience that replaces it as anchor, -1 for the origin of the map.
            pose_in_stand_in: pose of the removed experience in the frame of its stand-in.
        """
        if experience_id != self.experience_id:
            return self
        return replace(
            self, experience_id=stand_in_id, offset=composed(pose_in_stand_in, self.offset)
        )

    def __str__(self) -> str:
        return self.name or f'experience {self.experience_id}'


@dataclass(frozen=True, slots=True)
class Position:
    """A goal position on the map."""

    x_m: float
    y_m: float

    def __str__(self) -> str:
        return f'({self.x_m:g}, {self.y_m:g})'


Target = int | str | Position
"""A requested goal: an experience by id, a place by name, or a position on the map."""


class Goals(Saved):
    """The named places of a map."""

    SAVED = (
        Field('named', '_named', list, fits=named_numbers(4),
              save=lambda named: [
                  [goal.name, goal.experience_id, *goal.offset] for goal in named.values()
              ],
              load=lambda rows: {
                  name: Goal(experience_id, Pose(*offset), name)
                  for name, experience_id, *offset in rows
              }),
    )

    def __init__(self) -> None:
        self._named: dict[str, Goal] = {}

    def __len__(self) -> int:
        return len(self._named)

    def __iter__(self) -> Iterator[Goal]:
        """Iterate over the places in the order in which they were named."""
        return iter(self._named.values())

    def name_place(
        self, experience_map: ExperienceMap, name: str = '', offset: Pose | None = None
    ) -> Goal:
        """Name the place where the robot is. An existing name moves to this place.

        Args:
            experience_map: the map with the current experience.
            name: 1 to 100 characters; empty: the first unused name of place_1, place_2, ...
            offset: pose of the robot in the frame of the current experience, None for the
                estimate of the map.

        Raises:
            UnreachableGoal: the map is empty, or the name is invalid.
        """
        if experience_map.current_id == NO_EXPERIENCE:
            reason = 'the robot is at no experience since the odometry had a gap'
            if len(experience_map) == 0:
                reason = 'the map is empty'
            raise UnreachableGoal(f'there is no place to name yet: {reason}; drive first')
        name = _checked_name(name) if name else self._unused_name()
        place = experience_map.offset if offset is None else offset
        goal = self._named[name] = Goal(experience_map.current_id, place, name)
        return goal

    def rename(self, name: str, new_name: str) -> Goal:
        """Rename a place. Another place with the new name loses its name.

        Raises:
            UnreachableGoal: no place has the name, or the new name is invalid.
        """
        goal = replace(self.named(name), name=_checked_name(new_name))
        if new_name != name:
            self._named.pop(new_name, None)
            # Rebuilt because the place keeps its position in the order.
            self._named = {
                (new_name if known == name else known): (goal if known == name else other)
                for known, other in self._named.items()
            }
        return goal

    def remove(self, name: str) -> Goal:
        """Remove a name and return the place that had it.

        Raises:
            UnreachableGoal: no place has the name.
        """
        return self._named.pop(self.named(name).name)

    def named(self, name: str) -> Goal:
        """Return the place with a name.

        Raises:
            UnreachableGoal: no place has the name.
        """
        if name not in self._named:
            known = ', '.join(self._named) or 'none yet'
            raise UnreachableGoal(
                f'no place is called {name!r}; those that have a name: {known}. Name the place '
                'while the robot is there'
            )
        return self._named[name]

    def find(self, target: Target, planner: RoutePlanner, tolerance_m: float = 0.0) -> Goal:
        """Return the goal for a target.

        The goal may turn out to be unreachable later if the robot's own place is unknown, or if no
        link is driven against its direction. Then no route leads from a new experience, and the
        robot explores to find one (Milford et al. 2006, section IV.D).

        Args:
            target: an experience id, a name, or a position. A position stands for the nearest
                reachable experience within the tolerance.
            planner: the route planner of the map.
            tolerance_m: tolerance of a position in m, 0 for ``goal_tolerance_m``.

        Raises:
            UnreachableGoal: there is no such place, or no route leads to it.
        """
        experience_map = planner.experience_map
        is_open = bool(nowhere_because(experience_map)) or math.isinf(planner.back_factor)
        goal = self.named(target) if isinstance(target, str) else target
        if isinstance(goal, int):
            goal = Goal(goal)
        elif isinstance(goal, Goal) and goal.experience_id == NO_EXPERIENCE:  # has lost its anchor
            goal = Position(*goal.pose_on(experience_map)[:2])
        if isinstance(goal, Goal):
            check_on_map(goal.experience_id, len(experience_map))
            goal = self._with_near_anchor(goal, planner, tolerance_m)
            if not is_open:
                planner.route_to(goal.experience_id)
            return goal
        if not (math.isfinite(goal.x_m) and math.isfinite(goal.y_m)):
            raise UnreachableGoal('its position is not finite')
        if is_open:
            return Goal(planner.nearest(goal.x_m, goal.y_m, tolerance_m))
        route = planner.route_to_place(goal.x_m, goal.y_m, tolerance_m)
        return Goal(route.experience_ids[-1])

    def _with_near_anchor(self, goal: Goal, planner: RoutePlanner, tolerance_m: float) -> Goal:
        """Anchor a goal at the nearest reachable experience if its own is far or unreachable.

        The second happens after failed tries to reach it, which unlearn its links. The goal stays
        unchanged if no reachable experience lies within MAX_ANCHOR_M, or within the tolerance of a
        position if its own is unreachable.
        """
        experience_map, within_m = planner.experience_map, MAX_ANCHOR_M
        place = goal.pose_on(experience_map)
        try:
            reachable = np.isfinite(planner.temporal_map().arrival_s)
            if math.hypot(goal.offset.x_m, goal.offset.y_m) <= MAX_ANCHOR_M:
                within_m = tolerance_m
                if reachable[goal.experience_id]:
                    return goal
            anchor = planner.nearest(place.x_m, place.y_m, within_m, reachable)
        except UnreachableGoal:
            return goal
        if not reachable[anchor]:
            return goal
        offset = composed(inverse(experience_map.pose_of(anchor)), place)
        return replace(goal, experience_id=anchor, offset=offset)

    def remove_pruned(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> None:
        """Handle the removal of an experience from the map; see ``Goal.reanchored``."""
        self._named = {
            name: goal.reanchored(experience_id, stand_in_id, pose_in_stand_in)
            for name, goal in self._named.items()
        }

    def _unused_name(self) -> str:
        names = (f'place_{number}' for number in count(1))
        return next(name for name in names if name not in self._named)


def _checked_name(name: str) -> str:
    """Return a valid name.

    Raises:
        UnreachableGoal: the name cannot be sent in a message or drawn on a picture.
    """
    if not (0 < len(name) <= MAX_NAME_CHARACTERS and name.isprintable() and name.strip() == name):
        raise UnreachableGoal(
            f'{name!r} cannot be a name; expected 1 to {MAX_NAME_CHARACTERS} printable '
            'characters, without spaces around them'
        )
    return name
