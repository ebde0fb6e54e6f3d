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

    name: _Name | UnsetType = UNSET
    """A named place."""
    experience_id: Id | UnsetType = UNSET
    """An experience."""
    x_m: _Coordinate | UnsetType = UNSET
    """Position in the frame of the map."""
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
    goals: Annotated[list[_Place], Meta(min_length=1, max_length=MAX_GOALS, examples=[
        [{'name': 'kitchen'}, {'experience_id': 17}, {'x_m': 1.5, 'y_m': -2.0}],
    ])] | UnsetType = UNSET
    """Several places to visit in order, each with one of the keys above, in place of one."""
    append: Annotated[bool, Meta(examples=[True])] = False
    """Whether earlier goals are kept."""
    timeout_s: Annotated[float, Meta(ge=0.0, le=1e9, examples=[120.0])] | UnsetType = UNSET
    """Time limit of each goal, 0 for none; without it, the parameters apply."""
    request: _Name = ''
    """Name of the request; the tasks in the status repeat it."""
    cancel: Annotated[_Name, Meta(min_length=1)] | UnsetType = UNSET
    """Name of the request whose goals are cancelled; without other keys."""

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
    name: Annotated[_Name, Meta(examples=['kitchen'])]
    """The name; an existing one is moved to this place."""
    rename_to: Annotated[_Name, Meta(min_length=1)] = ''
    """The new name of that place; another place with this name loses it."""
    remove: bool = False
    """Whether the name is removed."""

    def __post_init__(self) -> None:
        if self.remove and self.rename_to:
            raise ValueError('rename_to and remove; expected only one of them')


class BehaviourReport(Payload, frozen=True):
    """Behaviour of the robot from a stamp on."""

    TOPIC: ClassVar[str] = 'goal_follower/behaviour'
    stamp: Stamp
    """From which on the robot behaves so."""
    behaviour: Annotated[_Name, Meta(examples=['left_wall'])]
    """Name of the behaviour."""
    failed: Annotated[bool, Meta(examples=[True])]
    """Whether the attempt was blocked."""
    ahead_rad: Annotated[float, Meta(ge=-math.tau, le=math.tau, examples=[1.5])]
    """Intended direction of the robot in the frame of the map."""

    @classmethod
    def of(
        cls, stamp_ns: int, behaviour: str, failed: bool = False, ahead_rad: float = 0.0
    ) -> BehaviourReport:
        """Return a report of a stamp in ns."""
        return cls(Stamp.of(stamp_ns), behaviour, failed, ahead_rad)


class _Point(Struct, frozen=True):
    x_m: Annotated[float, Meta(examples=[1.5])]
    """Position on the map."""
    y_m: Annotated[float, Meta(examples=[-2.0])]


class _Neighbour(Struct, frozen=True):
    id: Annotated[int, Meta(examples=[12])]
    """The experience."""
    distance_m: float
    """Its distance from the robot."""
    direction_rad: Annotated[float, Meta(examples=[0.25])]
    """Its direction relative to the robot, positive to the left."""


class Task(Struct, frozen=True):
    """A requested goal and its progress."""

    number: Annotated[int, Meta(examples=[3])]
    """Counts all requested goals from 0."""
    goal: Annotated[Text, Meta(examples=['kitchen'])]
    """The target as text."""
    status: Annotated[Text, Meta(examples=['active'])]
    """See above."""
    reason: Text
    """Why the goal ended without success."""
    expected_s: Annotated[float | None, Meta(examples=[24.0])] = None
    """Duration of the longest of its routes."""
    took_s: Annotated[float | None, Meta(examples=[None])] = None
    """Time taken; null if it has not begun or ended."""
    request: Text = ''
    """Name of its request; left out if it has none."""

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
    stamp: Stamp
    """Stamp of the odometry."""
    status: Annotated[Text, Meta(examples=['following'])]
    """`following` the current route of the map; `recovering`: following the last good route,
    because the map has none now, or only a slower one; `lost`: no route; `idle`: no goal; or how
    the last goal ended."""
    explore: bool
    """Whether the robot should explore, as the route is lost."""
    behaviour: Annotated[Text, Meta(examples=['left_wall'])] = ''
    """`left_wall` or `right_wall` if the next part of the route was learned along a wall, which is
    then followed again; else empty."""
    localisation: Annotated[Text, Meta(examples=['localised'])] = 'localised'
    """`unknown`: there is no pose on this map, and goals wait until a place is recognised;
    `uncertain`: the pose was given on `initialpose` and not confirmed yet, or its standard
    deviation exceeds 0.75 m; `localised`."""
    reason: Text
    """Why the last requested goal or plan (`experience_map/recall_goal`) has no route, or why the
    first goal of the queue is paused; else empty."""
    refused: Text = ''
    """Name of the request that `reason` refuses; left out if it has none."""
    experience_id: Annotated[int, Meta(examples=[40])]
    """The current experience; -1 for none."""
    neighbours: list[_Neighbour]
    """The experiences one link away."""
    goal: Annotated[_Point | None, Meta(examples=[...])] = None
    """Position of the goal on the map; null if there is none."""
    remaining_s: Annotated[float | None, Meta(examples=[18.5])] = None
    """Expected time to the goal; null if there is no route."""
    replanned: Annotated[int, Meta(examples=[1])]
    """Number of routes taken for this goal."""
    switched: Annotated[int, Meta(examples=[0])]
    """How often a route was replaced by a faster one, or by the only one that existed for
    `route_switch_s`."""
    queue: list[Task]
    """The goals that have not ended."""
    outcomes: Annotated[list[Task], Meta(examples=[[{
        'number': 2, 'goal': '(1, 0)', 'status': 'timed_out',
        'reason': 'not reached within 60 s', 'expected_s': 12.5, 'took_s': 60.0,
    }]])]
    """The last ten goals that have ended."""

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
