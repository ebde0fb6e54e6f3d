# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of goals and behaviours.

Goals and names are typed by people: such a payload may leave out ``schema_version``, and unknown
keys are refused, so that a misspelt one is not ignored.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, ClassVar

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal, Position, Target
from ratslam_ros.core.navigation.navigator import GoalTask
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.core.navigation.route_planner import TemporalMap
from ratslam_ros.limits import MAX_COORDINATE_M
from ratslam_ros.messages.json_schema import (
    NS_PER_S,
    Id,
    Payload,
    Stamp,
    Text,
    about,
    finite,
    only_if,
)

MAX_OUTCOMES = 10
"""Number of ended goals listed in the status."""

MAX_GOALS = 1000
"""Largest accepted number of goals in a request: each is planned a route to."""

_Name = Annotated[str, Meta(max_length=100)]
"""A name of a place, of a request or of a behaviour."""
_Coordinate = Annotated[float, Meta(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]


class _Place(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A place to drive to: by name, by experience, or by position."""

    name: Annotated[_Name, about('a named place')] | UnsetType = UNSET
    experience_id: Annotated[Id, about('an experience')] | UnsetType = UNSET
    x_m: Annotated[_Coordinate, about('position in the frame of the map')] | UnsetType = UNSET
    y_m: _Coordinate | UnsetType = UNSET

    def __post_init__(self) -> None:
        self.target()

    def keys(self) -> list[str]:
        """Return the keys that are set."""
        return [key for key in _Place.__struct_fields__ if getattr(self, key) is not UNSET]

    def target(self) -> Target:
        """Return the place; raise ValueError if it is not exactly one."""
        match self.name, self.experience_id, self.x_m, self.y_m:
            case str(name), msgspec.UNSET, msgspec.UNSET, msgspec.UNSET:
                return name
            case msgspec.UNSET, int(experience_id), msgspec.UNSET, msgspec.UNSET:
                return experience_id
            case msgspec.UNSET, msgspec.UNSET, float(x_m), float(y_m):
                return Position(x_m, y_m)
        raise ValueError(
            f'a goal with {", ".join(self.keys()) or "no place"}; expected one place, by name, by '
            'experience_id, or by x_m and y_m'
        )


class GoalRequest(_Place, Payload, frozen=True, kw_only=True):
    """A request to drive to one place or to several, or to cancel a request."""

    TOPIC: ClassVar[str] = 'experience_map/goal'
    IS_TYPED: ClassVar[bool] = True
    goals: Annotated[list[_Place], Meta(min_length=1, max_length=MAX_GOALS), about(
        'several places to visit in order, each with one of the keys above, in place of one',
        [{'name': 'kitchen'}, {'experience_id': 17}, {'x_m': 1.5, 'y_m': -2.0}],
    )] | UnsetType = UNSET
    append: Annotated[bool, about('whether earlier goals are kept', True)] = False
    timeout_s: Annotated[float, Meta(ge=0.0, le=1e9), about(
        'time limit of each goal, 0 for none; without it, the parameters apply', 120.0
    )] | UnsetType = UNSET
    request: Annotated[_Name, about(
        'name of the request; the tasks in the status repeat it'
    )] = ''
    cancel: Annotated[_Name, Meta(min_length=1), about(
        'name of the request whose goals are cancelled; without other keys'
    )] | UnsetType = UNSET

    def __post_init__(self) -> None:
        if self.cancel is not UNSET:
            others = self.goals, self.timeout_s, *map(self.__getattribute__, self.keys())
            if any(one is not UNSET for one in others) or self.append or self.request:
                raise ValueError('cancel with other keys; expected it alone')
        elif self.goals is UNSET:
            self.target()
        elif self.keys():
            raise ValueError(f'goals and {", ".join(self.keys())}; expected only one of them')

    @property
    def targets(self) -> tuple[Target, ...]:
        """The places to drive to, in order; none of a request to cancel."""
        if self.cancel is not UNSET:
            return ()
        return tuple(place.target() for place in ([self] if self.goals is UNSET else self.goals))

    @classmethod
    def of(cls, positions_m: Iterable[tuple[float, float]], request: str) -> GoalRequest:
        """Return a request for positions on the map, with its name."""
        return cls(goals=[_Place(x_m=x, y_m=y) for x, y in positions_m], request=request)


class NameRequest(Payload, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A request to name the robot's current place, or to rename or remove a name."""

    TOPIC: ClassVar[str] = 'experience_map/name_place'
    IS_TYPED: ClassVar[bool] = True
    name: Annotated[_Name, about(
        'the name; an existing one is moved to this place', 'kitchen'
    )]
    rename_to: Annotated[_Name, Meta(min_length=1), about('the new name of that place')] = ''
    remove: Annotated[bool, about('whether the name is removed')] = False

    def __post_init__(self) -> None:
        if self.remove and self.rename_to:
            raise ValueError('rename_to and remove; expected only one of them')


class BehaviourReport(Payload, frozen=True):
    """Behaviour of the robot from a stamp on."""

    TOPIC: ClassVar[str] = 'goal_follower/behaviour'
    stamp: Annotated[Stamp, about('from which on the robot behaves so')]
    behaviour: Annotated[_Name, about('name of the behaviour', 'left_wall')]
    failed: Annotated[bool, about('whether the attempt was blocked', True)]
    ahead_rad: Annotated[float, Meta(ge=-math.tau, le=math.tau), about(
        'intended direction of the robot in the frame of the map', 1.5
    )]

    @classmethod
    def of(
        cls, stamp_ns: int, behaviour: str, failed: bool = False, ahead_rad: float = 0.0
    ) -> BehaviourReport:
        """Return a report of a stamp in ns."""
        return cls(Stamp.of(stamp_ns), behaviour, failed, ahead_rad)


class _Point(Struct, frozen=True):
    x_m: Annotated[float, about('position on the map', 1.5)]
    y_m: Annotated[float, about(example=-2.0)]


class _Neighbour(Struct, frozen=True):
    id: Annotated[int, about('the experience', 12)]
    distance_m: Annotated[float, about('its distance from the robot')]
    direction_rad: Annotated[float, about(
        'its direction relative to the robot, positive to the left', 0.25
    )]


class Task(Struct, frozen=True):
    """A requested goal and its progress."""

    number: Annotated[int, about('counts all requested goals from 0', 3)]
    goal: Annotated[Text, about('the target as text', 'kitchen')]
    status: Annotated[Text, about('see above', 'active')]
    reason: Annotated[Text, about('why the goal ended without success')]
    expected_s: Annotated[float | None, about(
        'duration of its first route, or of a longer one since the pose was found', 24.0
    )] = None
    took_s: Annotated[float | None, about(
        'time taken; null if it has not begun or ended', None
    )] = None
    request: Annotated[Text, about('name of its request; left out if it has none')] = ''

    @classmethod
    def of(cls, task: GoalTask) -> Task:
        """Return a goal and its progress."""
        took_s = None
        if task.started_ns is not None and task.ended_ns is not None:
            took_s = (task.ended_ns - task.started_ns) / NS_PER_S
        return cls(
            task.number, task.asked, task.status, task.reason, task.expected_s, took_s,
            only_if(task.request != '', task.request),
        )


class GoalStatus(Payload, frozen=True, kw_only=True):
    """The goals and their progress."""

    TOPIC: ClassVar[str] = 'experience_map/status'
    stamp: Annotated[Stamp, about('stamp of the odometry')]
    status: Annotated[Text, about(
        '`following` the current route of the map; `recovering`: following the last good route, '
        'because the map has none now, or only a slower one; `lost`: no route; `idle`: no goal; '
        'or how the last goal ended', 'following'
    )]
    explore: Annotated[bool, about('whether the robot should explore, as the route is lost')]
    behaviour: Annotated[Text, about(
        '`left_wall` or `right_wall` if the next part of the route was learned along a wall, '
        'which is then followed again; else empty', 'left_wall'
    )] = ''
    localisation: Annotated[Text, about(
        '`unknown`: there is no pose on this map, and goals wait until a place is recognised; '
        '`uncertain`: the pose was given on `initialpose` and not confirmed yet, or its standard '
        'deviation exceeds 0.75 m; `localised`', 'localised'
    )] = 'localised'
    reason: Annotated[Text, about(
        'why the last requested goal or plan (`experience_map/recall_goal`) has no route, or why '
        'the first goal of the queue is paused; else empty'
    )]
    refused: Annotated[Text, about(
        'name of the request that `reason` refuses; left out if it has none'
    )] = ''
    experience_id: Annotated[int, about('the current experience; -1 for none', 40)]
    neighbours: Annotated[list[_Neighbour], about('the experiences one link away')]
    goal: Annotated[_Point | None, about(
        'position of the goal on the map; null if there is none', ...
    )] = None
    remaining_s: Annotated[float | None, about(
        'expected time to the goal; null if there is no route', 18.5
    )] = None
    replanned: Annotated[int, about('number of routes taken for this goal', 1)]
    switched: Annotated[int, about(
        'how often a route was replaced by a faster one, or by the only one that existed for '
        '`route_switch_s`', 0
    )]
    queue: Annotated[list[Task], about('the goals that have not ended')]
    outcomes: Annotated[list[Task], about('the last ten goals that have ended', [{
        'number': 2, 'goal': '(1, 0)', 'status': 'timed_out',
        'reason': 'not reached within 60 s', 'expected_s': 12.5, 'took_s': 60.0,
    }])]

    @classmethod
    def of(
        cls, stamp_ns: int, experience_map: ExperienceMap, guidance: Guidance,
        queue: Iterable[GoalTask], outcomes: Iterable[GoalTask], reason: str = '',
        refused: str = '',
    ) -> GoalStatus:
        """Return the status.

        Args:
            stamp_ns: stamp of the odometry.
            experience_map: the map, for the neighbours of the current experience.
            guidance: the current guidance of the navigator.
            queue: the goals that have not ended.
            outcomes: the ended goals, of which the last MAX_OUTCOMES are listed.
            reason: why the last requested goal has no route, else empty.
            refused: name of the request that was refused for this reason, '' for none.
        """
        current_id, neighbours = experience_map.status()
        directions = [(i, experience_map.distance_and_direction(i)) for i in neighbours]
        goal = guidance.goal
        return cls(
            stamp=Stamp.of(stamp_ns), status=guidance.status, explore=guidance.explore,
            behaviour=guidance.behaviour, localisation=experience_map.localisation,
            reason=reason or guidance.reason, refused=only_if(refused != '', refused),
            experience_id=current_id,
            neighbours=[_Neighbour(i, at.distance_m, at.direction_rad) for i, at in directions],
            goal=None if goal is None else _Point(goal.x_m, goal.y_m),
            remaining_s=finite(guidance.remaining_s), replanned=guidance.replanned,
            switched=guidance.switched, queue=list(map(Task.of, queue)),
            outcomes=list(map(Task.of, list(outcomes)[-MAX_OUTCOMES:])),
        )


class _NamedPlace(Struct, frozen=True):
    name: str
    experience_id: int
    x_m: float
    y_m: float
    heading_rad: float


class NamedPlaces(Payload, frozen=True):
    """Answer of ``experience_map/list_goals``: the names and their poses on the map."""

    goals: list[_NamedPlace]

    @classmethod
    def of(cls, experience_map: ExperienceMap, goals: Iterable[Goal]) -> NamedPlaces:
        """Return the places of goals on a map."""
        return cls([
            _NamedPlace(goal.name, goal.experience_id, *goal.pose_on(experience_map))
            for goal in goals
        ])


class ArrivalTimes(Payload, frozen=True):
    """Answer of ``experience_map/temporal_map``; null for unreachable experiences."""

    experience_id: int
    arrival_s: list[float | None]

    @classmethod
    def of(cls, times: TemporalMap) -> ArrivalTimes:
        """Return the times from an experience to all others."""
        return cls(times.start_id, list(map(finite, times.arrival_s.tolist())))
