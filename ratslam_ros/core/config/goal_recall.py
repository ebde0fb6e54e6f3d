# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of goals and of the routes to them."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class GoalRecallParameters(Section):
    """How routes are found and followed, and when a goal is reached or given up."""

    goal_tolerance_m: float = parameter(
        0.5, 'm', 0.0, 1e6, 'A goal position means the nearest experience within this distance.',
        'goals beside the driven path are refused', 'goals are taken for too distant places',
    )  # fmt: skip
    goal_radius_m: float = parameter(
        0.3, 'm', 0.0, 1e6,
        'A goal is reached where the robot has come within this distance of it on the map and '
        'comes no closer; at the end of its route 1.2 times that suffices.',
        'the robot turns back and forth beside a goal', 'the robot stops beside its goals',
    )  # fmt: skip
    goal_timeout_s: float = parameter(
        0.0, 's; 0: as goal_timeout_factor says', 0.0, 1e6,
        'Time that a goal has, from when the robot sets out for it.',
        'goals time out on the way', 'a robot that is stuck should go on with its next goal',
    )  # fmt: skip
    goal_timeout_factor: float = parameter(
        10.0, 'times the time expected; 0: none', 0.0, 1e6,
        'Time that a goal has, against what its first route says; at least '
        'goal_timeout_least_s.',
        'goals time out on the way', 'a robot that is stuck should go on with its next goal',
    )  # fmt: skip
    goal_timeout_least_s: float = parameter(
        120.0, 's', 0.0, 1e6, 'Time that every goal has, however near it is.',
        'near goals time out where somebody is in the way',
        'a robot that is stuck should go on with its next goal',
    )  # fmt: skip
    goal_explore_s: float = parameter(
        600.0, 's; 0: for ever', 0.0, 1e6,
        'How long a robot that has lost its route explores for another one, before its goal has '
        'failed.',
        'goals fail while the robot still explores', 'it should sooner go on with its next goal',
    )  # fmt: skip
    route_back_factor: float = parameter(
        1.0, 'times the duration', 1.0, 1000.0,
        'What a link costs that is driven against the direction in which it was learned: a camera '
        'that looks ahead has not seen the places from that side. 1: as the papers do.',
        'the robot loses itself on ways that it has driven in the other direction only',
        'it makes long detours to drive in the direction that it knows')  # fmt: skip
    route_join_m: float = parameter(
        0.0, 'm; 0: links only', 0.0, 100.0,
        'Places that lie this close together on the map count as linked on a route, however the '
        'robot came there. 0: as the papers do.',
        'routes lead into a room and round it that was only passed',
        'routes lead through walls: there must be more between two ways than this')  # fmt: skip
    route_keep_s: float = parameter(
        60.0, 's', 0.0, 1e6,
        'How long the last good route is followed where the present place has no other one.',
        'the robot turns back, or gives up, in stretches that it does not recognise',
        'it drives on for too long where it is wrong',
    )  # fmt: skip
    route_unknown_m: float = parameter(
        0.0, 'm; 0: any', 0.0, 1e6,
        'How far the robot goes on by odometry alone, over places that it has never seen, until '
        'it explores to find itself.',
        'it breaks off on ways that it knows from one side only', 'it drives into wrong places',
    )  # fmt: skip
    goal_sure_m: float = parameter(
        0.0, 'm; 0: any', 0.0, 1e6,
        'A goal is reached only where the robot has come no further than this from a known '
        'place, by its view or its scan; else it explores to find itself.',
        'goals are reached but not believed', 'the robot believes to be where it is not',
    )  # fmt: skip
    try_unknown_m: float = parameter(
        0.0, 'm; 0: any', 0.0, 1e6,
        'What leads nowhere counts as a failed try only so far from a known place: where the '
        'robot is wrong about its place the way is not closed.',
        'closed ways are not unlearned', 'open ways are unlearned',
    )  # fmt: skip
    route_switch_s: float = parameter(
        10.0, 's', 0.0, 1e6,
        'How long a route is followed while only longer ones are found; a shorter one is taken at '
        'once.',
        'the robot changes its mind too often', 'it drives on for too long where it is wrong',
    )  # fmt: skip
    route_width_m: float = parameter(
        1.5, 'm', 0.0, 1e6,
        'A route that the robot is further away from, on the map, is not followed any longer.',
        'routes are dropped where the map is bent, or in wide rooms',
        'the robot follows a route through the wall beside it',
    )  # fmt: skip
    waypoint_ahead_m: float = parameter(
        1.0, 'm', 0.0, 1e6, 'How far ahead on the route the waypoint lies.',
        'the robot turns too often for small bends of the route', 'it cuts corners',
    )  # fmt: skip
