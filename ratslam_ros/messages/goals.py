# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of goals and behaviours: encoding and strict decoding.

Goals and names are typed by people: such a payload may leave out ``schema_version``, and unknown
keys are refused, so that a misspelt one is not ignored.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

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
    MalformedMessage,
    Payload,
    Stamp,
    Text,
    decode,
    encode,
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


@dataclass(frozen=True, slots=True)
class GoalRequest:
    """Places to drive to, in order, see ``Navigator.go_to``; or a request to cancel.

    ``request``: the client's name of the request; ``cancel``: name of the request whose goals are
    cancelled, without targets then.
    """

    targets: tuple[Target, ...] = ()
    append: bool = False
    timeout_s: float | None = None
    request: str = ''
    cancel: str = ''


@dataclass(frozen=True, slots=True)
class BehaviourReport:
    """Behaviour of the robot from a stamp on.

    ``failed``: the attempt was blocked; ``ahead_rad``: its intended direction in the map's frame.
    """

    stamp_ns: int
    behaviour: str
    failed: bool = False
    ahead_rad: float = 0.0


class _Place(Struct, frozen=True, forbid_unknown_fields=True):
    """A place to drive to: by name, by experience, or by position."""

    name: _Name | UnsetType = UNSET
    experience_id: Id | UnsetType = UNSET
    x_m: _Coordinate | UnsetType = UNSET
    y_m: _Coordinate | UnsetType = UNSET


class _Goal(_Place, Payload, frozen=True, forbid_unknown_fields=True):
    """A request to drive to one place or to several, or to cancel a request."""

    TOPIC: ClassVar[str] = 'experience_map/goal'
    IS_TYPED: ClassVar[bool] = True
    goals: Annotated[list[_Place], Meta(min_length=1, max_length=MAX_GOALS)] | UnsetType = UNSET
    append: bool | UnsetType = UNSET
    timeout_s: Annotated[float, Meta(ge=0.0, le=1e9)] | UnsetType = UNSET
    request: _Name | UnsetType = UNSET
    cancel: Annotated[_Name, Meta(min_length=1)] | UnsetType = UNSET


def decode_goal(payload: str) -> GoalRequest:
    """Return the request of an ``experience_map/goal`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Goal, payload)
    if found.cancel is not UNSET:
        if found != _Goal(cancel=found.cancel):
            raise MalformedMessage(f'{_Goal.TOPIC}: cancel with other keys; expected it alone')
        return GoalRequest(cancel=found.cancel)
    places: Sequence[_Place] = [found]
    if found.goals is not UNSET:
        places = found.goals
        if _place_keys(found):
            raise MalformedMessage(
                f'{_Goal.TOPIC}: goals and {", ".join(_place_keys(found))}; expected only one of '
                'them'
            )
    return GoalRequest(
        tuple(map(_target, places)), found.append is True,
        None if found.timeout_s is UNSET else found.timeout_s,
        '' if found.request is UNSET else found.request,
    )  # fmt: skip


def _place_keys(place: _Place) -> list[str]:
    return [key for key in _Place.__struct_fields__ if getattr(place, key) is not UNSET]


def _target(place: _Place) -> Target:
    match place.name, place.experience_id, place.x_m, place.y_m:
        case str(name), msgspec.UNSET, msgspec.UNSET, msgspec.UNSET:
            return name
        case msgspec.UNSET, int(experience_id), msgspec.UNSET, msgspec.UNSET:
            return experience_id
        case msgspec.UNSET, msgspec.UNSET, float(x_m), float(y_m):
            return Position(x_m, y_m)
    raise MalformedMessage(
        f'{_Goal.TOPIC}: a goal with {", ".join(_place_keys(place)) or "no place"}; expected one '
        'place, by name, by experience_id, or by x_m and y_m'
    )


def encode_request(positions_m: Iterable[tuple[float, float]], request: str) -> str:
    """Return the payload of ``experience_map/goal`` that requests positions on the map.

    Args:
        positions_m: x and y of each goal in m, in order.
        request: name of the request, which the status repeats.
    """
    goals = [_Place(x_m=x, y_m=y) for x, y in positions_m]
    return encode(_Goal(goals=goals, request=request))


def encode_cancel(request: str) -> str:
    """Return the payload of ``experience_map/goal`` that cancels the goals of a request."""
    return encode(_Goal(cancel=request))


class NameRequest(Payload, frozen=True, forbid_unknown_fields=True):
    """A request to name the robot's current place, or to rename or remove a name.

    ``rename_to``: the new name, '' to keep it.
    """

    TOPIC: ClassVar[str] = 'experience_map/name_place'
    IS_TYPED: ClassVar[bool] = True
    name: _Name
    rename_to: Annotated[_Name, Meta(min_length=1)] = ''
    remove: bool = False


def decode_name(payload: str) -> NameRequest:
    """Return the request of an ``experience_map/name_place`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    request = decode(NameRequest, payload)
    if request.remove and request.rename_to:
        raise MalformedMessage(
            f'{NameRequest.TOPIC}: rename_to and remove; expected only one of them'
        )
    return request


class _Behaviour(Payload, frozen=True):
    TOPIC: ClassVar[str] = 'goal_follower/behaviour'
    stamp: Stamp
    behaviour: _Name
    failed: bool
    ahead_rad: Annotated[float, Meta(ge=-math.tau, le=math.tau)]


def encode_behaviour(report: BehaviourReport) -> str:
    """Return the payload of ``goal_follower/behaviour``."""
    return encode(_Behaviour(
        Stamp.of(report.stamp_ns), report.behaviour, report.failed, report.ahead_rad
    ))  # fmt: skip


def decode_behaviour(payload: str) -> BehaviourReport:
    """Return the report of a ``goal_follower/behaviour`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Behaviour, payload)
    return BehaviourReport(found.stamp.ns, found.behaviour, found.failed, found.ahead_rad)


class _Point(Struct, frozen=True):
    x_m: float
    y_m: float


class _Neighbour(Struct, frozen=True):
    id: int
    distance_m: float
    direction_rad: float


class _Task(Struct, frozen=True):
    number: int
    goal: Text
    status: Text
    reason: Text
    expected_s: float | None = None
    took_s: float | None = None
    request: Text = ''


class _Status(Payload, frozen=True, kw_only=True):
    TOPIC: ClassVar[str] = 'experience_map/status'
    stamp: Stamp
    status: Text
    explore: bool
    behaviour: Text = ''  # Earlier releases did not send it.
    reason: Text
    refused: Text = ''
    experience_id: int
    neighbours: list[_Neighbour]
    goal: _Point | None = None
    remaining_s: float | None = None
    replanned: int
    switched: int
    queue: list[_Task]
    outcomes: list[_Task]


def encode_status(
    stamp_ns: int, experience_map: ExperienceMap, guidance: Guidance, queue: Iterable[GoalTask],
    outcomes: Iterable[GoalTask], reason: str = '', refused: str = '',
) -> str:  # fmt: skip
    """Return the payload of ``experience_map/status``.

    Args:
        stamp_ns: stamp of the odometry.
        experience_map: the map, for the neighbours of the current experience.
        guidance: the current guidance of the navigator.
        queue: the goals that have not ended.
        outcomes: the ended goals, of which the last MAX_OUTCOMES are listed.
        reason: why the last requested goal has no route, else empty.
        refused: name of the request that was refused for this reason, '' for none.
    """
    current_id = experience_map.current_id
    neighbours = experience_map.neighbours(current_id) if current_id >= 0 else []
    directions = [(other, experience_map.distance_and_direction(other)) for other in neighbours]
    goal = guidance.goal
    return encode(_Status(
        stamp=Stamp.of(stamp_ns), status=guidance.status, explore=guidance.explore,
        behaviour=guidance.behaviour, reason=reason, refused=only_if(refused != '', refused),
        experience_id=current_id,
        neighbours=[_Neighbour(i, at.distance_m, at.direction_rad) for i, at in directions],
        goal=None if goal is None else _Point(goal.x_m, goal.y_m),
        remaining_s=finite(guidance.remaining_s), replanned=guidance.replanned,
        switched=guidance.switched, queue=list(map(_task, queue)),
        outcomes=list(map(_task, list(outcomes)[-MAX_OUTCOMES:])),
    ))  # fmt: skip


def decode_status(payload: str) -> dict[str, Any]:
    """Return the fields of an ``experience_map/status`` payload, and its ``stamp_ns``.

    Missing ``behaviour``, of an earlier release, ``refused`` and ``request`` are set to ''.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Status, payload)
    return {**msgspec.to_builtins(found), 'stamp_ns': found.stamp.ns}


def _task(task: GoalTask) -> _Task:
    took_s = None
    if task.started_ns is not None and task.ended_ns is not None:
        took_s = (task.ended_ns - task.started_ns) / NS_PER_S
    return _Task(
        task.number, task.asked, task.status, task.reason, task.expected_s, took_s,
        only_if(task.request != '', task.request),
    )  # fmt: skip


class _NamedPlace(Struct, frozen=True):
    name: str
    experience_id: int
    x_m: float
    y_m: float
    heading_rad: float


class _NamedPlaces(Payload, frozen=True):
    goals: list[_NamedPlace]


def encode_goals(experience_map: ExperienceMap, goals: Iterable[Goal]) -> str:
    """Return the answer of ``experience_map/list_goals``: the names and their poses on the map."""
    return encode(_NamedPlaces([
        _NamedPlace(goal.name, goal.experience_id, *goal.pose_on(experience_map))
        for goal in goals
    ]))  # fmt: skip


class _Times(Payload, frozen=True):
    experience_id: int
    arrival_s: list[float | None]


def encode_times(times: TemporalMap) -> str:
    """Return the answer of ``experience_map/temporal_map``; null for unreachable experiences."""
    return encode(_Times(times.start_id, list(map(finite, times.arrival_s.tolist()))))
