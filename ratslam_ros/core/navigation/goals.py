# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goals: names given to places, and what is asked for -> a place on the experience map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.errors import UnreachableGoal

AT_IT = Pose(0.0, 0.0, 0.0)

BESIDE_M = 1.0
"""A place no further than this lies beside its experience. After pruning it may lie further, and
a wall between: then it is told from the experience that is nearest, if that is this near."""

LONGEST_NAME = 100


@dataclass(frozen=True, slots=True)
class Goal:
    """A place to go to: where it lies in an experience's frame, so that it moves with the map.

    ``name``: what it is called, empty for none.
    """

    experience_id: int
    offset: Pose = AT_IT
    name: str = ''

    def pose_on(self, experience_map: ExperienceMap) -> Pose:
        """Return where the place is on the map as it is now."""
        return composed(experience_map.pose_of(self.experience_id), self.offset)

    def without(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> Goal:
        """Return the same place, told without an experience that is forgotten.

        Args:
            experience_id: the one that is no more.
            stand_in_id: the one that is known in its place, -1 for none: then the map's start.
            pose_in_stand_in: where the forgotten one lies in the frame of its stand-in.
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
    """A place on the map that is asked for by where it is."""

    x_m: float
    y_m: float

    def __str__(self) -> str:
        return f'({self.x_m:g}, {self.y_m:g})'


Target = int | str | Position
"""What may be asked for: an experience by its id, a place by its name, or by where it is."""


class Goals:
    """The places that have names."""

    def __init__(self) -> None:
        self._named: dict[str, Goal] = {}

    def __len__(self) -> int:
        return len(self._named)

    def __iter__(self) -> Iterator[Goal]:
        """Yield the named places, those first that were named first."""
        return iter(self._named.values())

    def name_place(
        self, experience_map: ExperienceMap, name: str = '', offset: Pose | None = None
    ) -> Goal:
        """Name the place where the robot is; a name that is known means this place from now on.

        Args:
            experience_map: where the robot is.
            name: 1 to 100 characters; empty: the first of place_1, place_2, ... that is free.
            offset: where the robot is in the frame of the current experience, None: as the map
                has it.

        Raises:
            UnreachableGoal: there is no place yet, or the name is none.
        """
        if experience_map.current_id == NO_EXPERIENCE:
            raise UnreachableGoal('there is no place to name yet: the map is empty; drive first')
        name = _checked_name(name) if name else self._free_name()
        place = experience_map.offset if offset is None else offset
        goal = self._named[name] = Goal(experience_map.current_id, place, name)
        return goal

    def rename(self, name: str, new_name: str) -> Goal:
        """Give a place another name; a place that had that name loses it.

        Raises:
            UnreachableGoal: no place has the name, or the new one is none.
        """
        goal = replace(self.named(name), name=_checked_name(new_name))
        if new_name != name:
            self._named.pop(new_name, None)
            # The place keeps its rank among those that are named.
            self._named = {
                (new_name if known == name else known): (goal if known == name else other)
                for known, other in self._named.items()
            }
        return goal

    def remove(self, name: str) -> Goal:
        """Forget a name, and return the place that had it.

        Raises:
            UnreachableGoal: no place has it.
        """
        goal = self.named(name)
        del self._named[name]
        return goal

    def named(self, name: str) -> Goal:
        """Return the place of a name.

        Raises:
            UnreachableGoal: no place has it.
        """
        if name not in self._named:
            known = ', '.join(self._named) or 'none yet'
            raise UnreachableGoal(
                f'no place is called {name!r}; those that have a name: {known}. Name the place '
                'while the robot is there'
            )
        return self._named[name]

    def find(
        self, target: Target, experience_map: ExperienceMap, recall: RoutePlanner,
        tolerance_m: float = 0.0,
    ) -> Goal:  # fmt: skip
        """Return the place that is asked for.

        Args:
            target: the id of an experience, a name, or a position: that means the nearest
                experience within the tolerance, one that links lead to rather than another.
            experience_map: the map.
            recall: finds what links lead to.
            tolerance_m: 0: ``goal_tolerance_m``.

        Raises:
            UnreachableGoal: there is no such place, or no link leads to it.
        """
        asked = self._anchored(target, experience_map) if isinstance(target, str) else target
        if isinstance(asked, int):
            asked = Goal(asked)
        if isinstance(asked, Goal):
            asked = self._beside(asked, experience_map, recall)
            recall.route_to(experience_map, asked.experience_id)
            return asked
        if not (math.isfinite(asked.x_m) and math.isfinite(asked.y_m)):
            raise UnreachableGoal('its position is not finite')
        route = recall.route_to_place(experience_map, asked.x_m, asked.y_m, tolerance_m)
        return Goal(route.experience_ids[-1])

    def _beside(
        self, goal: Goal, experience_map: ExperienceMap, recall: RoutePlanner
    ) -> Goal:
        """Return a goal, told from an experience beside it that links lead to, if there is one."""
        if math.hypot(goal.offset.x_m, goal.offset.y_m) <= BESIDE_M:
            return goal
        place = goal.pose_on(experience_map)
        try:
            route = recall.route_to_place(experience_map, place.x_m, place.y_m, BESIDE_M)
        except UnreachableGoal:
            return goal
        beside = route.experience_ids[-1]
        offset = composed(inverse(experience_map.pose_of(beside)), place)
        return replace(goal, experience_id=beside, offset=offset)

    def _anchored(self, name: str, experience_map: ExperienceMap) -> Goal | Position:
        """Return the place of a name, by where it is if nothing stands in for its experience."""
        goal = self.named(name)
        if goal.experience_id != NO_EXPERIENCE:
            return goal
        x_m, y_m, _ = goal.pose_on(experience_map)
        return Position(x_m, y_m)

    def forgotten(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> None:
        """Keep all names where an experience is forgotten; see ``Goal.without``."""
        self._named = {
            name: goal.without(experience_id, stand_in_id, pose_in_stand_in)
            for name, goal in self._named.items()
        }

    def state(self) -> State:
        """Return all names and places, for ``restore``."""
        return {'named': [[g.name, g.experience_id, *g.offset] for g in self]}

    def restore(self, state: State) -> None:
        """Take what ``state`` gave in place of all names."""
        self._named = {
            name: Goal(experience_id, Pose(*offset), name)
            for name, experience_id, *offset in state['named']
        }

    def _free_name(self) -> str:
        number = 1
        while f'place_{number}' in self._named:
            number += 1
        return f'place_{number}'


def _checked_name(name: str) -> str:
    """Return a name that can be told and written on a picture."""
    if not (0 < len(name) <= LONGEST_NAME and name.isprintable() and name.strip() == name):
        raise UnreachableGoal(
            f'{name!r} cannot be a name; expected 1 to {LONGEST_NAME} printable characters, '
            'without spaces around them'
        )
    return name
