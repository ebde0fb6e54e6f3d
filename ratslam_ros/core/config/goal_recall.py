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
        0.5, 'A goal position is assigned to the nearest experience within this distance.',
        unit='m', low=0.0, high=1e6,
        raise_if='goals beside the driven path are refused',
        lower_if='goals are assigned to distant places', runtime='at once',
    )
    goal_radius_m: float = parameter(
        0.3,
        'A goal is reached when the robot is within this distance of it on the map and comes no '
        'closer. At the end of the route, 1.2 times this distance suffices.',
        unit='m', low=0.0, high=1e6,
        raise_if='the robot turns back and forth beside a goal',
        lower_if='the robot stops beside its goals', runtime='at once',
    )
    route_back_factor: float = parameter(
        1.0,
        'Cost of driving a link against the direction in which it was learned, where a forward '
        'camera has never seen the places. 1: no extra cost. 0: links are driven in their own '
        'direction only, as in Milford et al. (2006), section IV: no route leads from an '
        'experience that has just been created, and the last route is followed.',
        unit='times the duration; 0: never', low=0.0, high=1000.0,
        raise_if='the robot gets lost on paths that it has driven in the other direction only',
        lower_if='it makes long detours to drive in the known direction',
    )
    route_join_m: float = parameter(
        0.0,
        'Experiences within this distance of each other on the map count as linked when a route '
        'is planned. 0: only learned links are used, as in the papers.',
        unit='m; 0: links only', low=0.0, high=100.0,
        raise_if='routes make detours through a room that the robot could simply pass',
        lower_if='routes lead through walls: paths on two sides of a wall must be further apart '
        'than this',
    )
    route_switch_s: float = parameter(
        10.0,
        'Hysteresis: a longer route replaces the present one only if no other is found for this '
        'long. A shorter route replaces it at once.',
        unit='s', low=0.0, high=1e6,
        raise_if='the robot changes its route too often',
        lower_if='it drives on for too long in a wrong place', runtime='at once',
    )
    route_position: str = parameter(
        'map',
        'Position on the last route, if no route leads from the current experience to the goal. '
        'map: the nearest point of the route on the map. elapsed_time: the point at which the '
        'robot was expected by now, as in Milford et al. (2006), section IV.D.',
        choices=('map', 'elapsed_time'),
        raise_if='leave at map', lower_if='set to elapsed_time to compare with the paper',
    )
