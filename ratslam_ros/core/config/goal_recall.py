# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of goals and of the routes to them."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class GoalRecallParameters(Section):
    """Route planning and following, and the conditions under which a goal succeeds or fails."""

    goal_tolerance_m: float = parameter(
        0.5, 'm', 0.0, 1e6,
        'A goal position is assigned to the nearest experience within this distance.',
        'goals beside the driven path are refused', 'goals are assigned to distant places',
        runtime='at once',
    )  # fmt: skip
    goal_radius_m: float = parameter(
        0.3, 'm', 0.0, 1e6,
        'A goal is reached when the robot is within this distance of it on the map and comes no '
        'closer. At the end of the route, 1.2 times this distance suffices.',
        'the robot turns back and forth beside a goal', 'the robot stops beside its goals',
        runtime='at once',
    )  # fmt: skip
    goal_timeout_s: float = parameter(
        0.0, 's; 0: by goal_timeout_factor', 0.0, 1e6,
        'Time limit of a goal, from when the robot sets out for it.',
        'goals time out on the way', 'a robot that is stuck should go on with its next goal',
        runtime='at once',
    )  # fmt: skip
    goal_timeout_factor: float = parameter(
        10.0, 'times the expected time; 0: no limit', 0.0, 1e6,
        'Time limit of a goal relative to the duration of its first route; at least '
        'goal_timeout_least_s.',
        'goals time out on the way', 'a robot that is stuck should go on with its next goal',
        runtime='at once',
    )  # fmt: skip
    goal_timeout_least_s: float = parameter(
        120.0, 's', 0.0, 1e6, 'Lower bound of the time limit by goal_timeout_factor.',
        'near goals time out because people are in the way',
        'a robot that is stuck should go on with its next goal',
        runtime='at once',
    )  # fmt: skip
    goal_explore_s: float = parameter(
        600.0, 's; 0: no limit', 0.0, 1e6,
        'A robot that has lost its route explores for this long to find another one; then its '
        'goal fails.',
        'goals fail while the robot still explores',
        'the robot should go on with its next goal sooner',
        runtime='at once',
    )  # fmt: skip
    route_back_factor: float = parameter(
        1.0, 'times the duration', 1.0, 1000.0,
        'Cost of driving a link against the direction in which it was learned, where a forward '
        'camera has never seen the places. 1: no extra cost, as in the papers.',
        'the robot gets lost on paths that it has driven in the other direction only',
        'it makes long detours to drive in the known direction')  # fmt: skip
    route_join_m: float = parameter(
        0.0, 'm; 0: links only', 0.0, 100.0,
        'Experiences within this distance of each other on the map count as linked when a route '
        'is planned. 0: only learned links are used, as in the papers.',
        'routes make detours through a room that the robot could simply pass',
        'routes lead through walls: paths on two sides of a wall must be further apart than this',
    )  # fmt: skip
    route_keep_s: float = parameter(
        60.0, 's', 0.0, 1e6,
        'Time for which the last valid route is kept if none is found from the present place.',
        'the robot turns back or gives up in stretches that it does not recognise',
        'it drives on for too long in a wrong place',
        runtime='at once',
    )  # fmt: skip
    route_unknown_m: float = parameter(
        0.0, 'm; 0: no limit', 0.0, 1e6,
        'Distance that the robot continues by odometry alone, without recognising a place, before '
        'it explores to relocalise.',
        'it gives up routes that it has driven in the other direction only',
        'it drives into wrong places',
    )  # fmt: skip
    goal_sure_m: float = parameter(
        0.0, 'm; 0: no limit', 0.0, 1e6,
        'A goal counts as reached only within this driven distance of a place recognised by view '
        'or scan; beyond it, the robot explores to relocalise.',
        'the robot is at its goals but they do not succeed',
        'goals succeed although the robot is elsewhere',
    )  # fmt: skip
    try_unknown_m: float = parameter(
        0.0, 'm; 0: no limit', 0.0, 1e6,
        'Failed tries count only within this driven distance of a recognised place; beyond it, a '
        'wrong pose is the more likely cause.',
        'links that are blocked are not removed', 'links that are free are removed',
    )  # fmt: skip
    route_switch_s: float = parameter(
        10.0, 's', 0.0, 1e6,
        'Hysteresis: a longer route replaces the present one only if no other is found for this '
        'long. A shorter route replaces it at once.',
        'the robot changes its route too often', 'it drives on for too long in a wrong place',
        runtime='at once',
    )  # fmt: skip
    route_width_m: float = parameter(
        1.5, 'm', 0.0, 1e6,
        'A route is dropped when the robot is further than this from it on the map.',
        'routes are dropped where the map is bent, or in wide rooms',
        'the robot follows a route on the other side of a wall',
        runtime='at once',
    )  # fmt: skip
    waypoint_ahead_m: float = parameter(
        1.0, 'm', 0.0, 1e6, 'Distance of the waypoint ahead of the robot along the route.',
        'the robot turns too often for small bends of the route', 'it cuts corners',
        runtime='at once',
    )  # fmt: skip
