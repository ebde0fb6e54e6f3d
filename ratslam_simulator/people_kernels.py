# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled motion of people: they follow routes, keep to the right and stop for bodies ahead."""

from __future__ import annotations

import math

from numba import njit

from ratslam_simulator.bodies import fits, slide
from ratslam_simulator.world import PERSON_RADIUS_M

SPEED, WAITED, PATIENCE, TARGET, HAS_TARGET, COLUMNS = 0, 1, 2, 3, 4, 5
"""Columns of the walkers' array; speed in m/s, time waited and patience in s."""

MIN_GAP_M = 0.05
"""Distance between outlines below which people never approach another body."""

_STOP_GAP_M = 0.5
"""Distance between outlines at which people stop for a body ahead."""

_LATERAL_GAP_M = 0.08
"""Lateral distance between outlines beyond which a body ahead is not in the way."""

_LOOK_AHEAD_M = 0.9
"""Length of the route ahead within which the aim point is chosen."""

_KEEP_RIGHT_M = 0.45
"""Lateral offset of the aim point to the right of the route."""

_ARRIVED_M = 0.3
"""Remaining route length below which the destination counts as reached."""


@njit(cache=True)
def walk(  # type: ignore[no-untyped-def]
    solid, cell_m, people, walkers, next_cell, robot_x_m, robot_y_m, robot_radius_m, duration_s,
):
    """Move everyone who has a destination, for a short time.

    Args:
        solid, cell_m: the grid of the floor and the side of its cells.
        people: (n, 4) as in `World`, changed in place.
        walkers: (n, COLUMNS), changed in place; HAS_TARGET is cleared on arrival and when the
            patience is exhausted.
        next_cell: (destinations, cells), see `PeopleRoutes`.
        robot_x_m, robot_y_m, robot_radius_m: the robot's body.
        duration_s: time to walk for.

    Returns:
        The number of people who need a new destination.
    """
    undecided = 0
    no_discs = people[:0]
    for person in range(len(people)):
        walker = walkers[person]
        if walker[HAS_TARGET] == 0.0:
            undecided += 1
            continue
        x_m, y_m = people[person, 0], people[person, 1]
        aim_x, aim_y, left_m = _aim(solid, cell_m, next_cell[int(walker[TARGET])], x_m, y_m)
        distance_m = math.hypot(aim_x - x_m, aim_y - y_m)
        if left_m < _ARRIVED_M:
            walker[HAS_TARGET] = 0.0
            undecided += 1
            continue
        ahead_x, ahead_y = (aim_x - x_m) / distance_m, (aim_y - y_m) / distance_m
        people[person, 2] = math.atan2(ahead_y, ahead_x)
        step_m = min(walker[SPEED] * duration_s, distance_m)
        to_x, to_y, _ = slide(
            solid, cell_m, no_discs, 0.0, x_m, y_m, x_m + step_m * ahead_x, y_m + step_m * ahead_y,
            PERSON_RADIUS_M,
        )
        blocked = _in_the_way(
            x_m, y_m, to_x, to_y, ahead_x, ahead_y, robot_x_m, robot_y_m, robot_radius_m
        )
        for other in range(len(people)):
            blocked |= other != person and _in_the_way(
                x_m, y_m, to_x, to_y, ahead_x, ahead_y, people[other, 0], people[other, 1],
                PERSON_RADIUS_M,
            )
        if not blocked:
            people[person, 0], people[person, 1] = to_x, to_y
        if blocked or math.hypot(to_x - x_m, to_y - y_m) < step_m / 4:
            walker[WAITED] += duration_s
            if walker[WAITED] > walker[PATIENCE]:
                walker[HAS_TARGET] = 0.0
                undecided += 1
        else:
            walker[WAITED] = 0.0
    return undecided


@njit(cache=True)
def _aim(solid, cell_m, next_cell, x_m, y_m):  # type: ignore[no-untyped-def]
    """Choose the aim point: the farthest visible point of the route ahead, offset to the right.

    Returns x_m, y_m and the remaining length of the route, at most the look-ahead.
    """
    n_x = solid.shape[1]
    cell = int(y_m / cell_m) * n_x + int(x_m / cell_m)
    aim_x, aim_y = x_m, y_m
    way_m = 0.0
    visible = True
    while way_m < _LOOK_AHEAD_M:
        following = next_cell[cell]
        if following < 0:
            break
        cell = following
        to_x, to_y = (cell % n_x + 0.5) * cell_m, (cell // n_x + 0.5) * cell_m
        # The first point is always accepted: otherwise a person off the route could not move.
        visible = visible and (way_m == 0.0 or _straight(solid, cell_m, x_m, y_m, to_x, to_y))
        if visible:
            aim_x, aim_y = to_x, to_y
        way_m += cell_m
    distance_m = math.hypot(aim_x - x_m, aim_y - y_m)
    if way_m >= _LOOK_AHEAD_M and distance_m > _KEEP_RIGHT_M:
        right_x, right_y = (aim_y - y_m) / distance_m, -(aim_x - x_m) / distance_m
        kept_x, kept_y = aim_x + _KEEP_RIGHT_M * right_x, aim_y + _KEEP_RIGHT_M * right_y
        if _straight(solid, cell_m, x_m, y_m, kept_x, kept_y):
            aim_x, aim_y = kept_x, kept_y
    return aim_x, aim_y, min(way_m, math.hypot(aim_x - x_m, aim_y - y_m))


@njit(cache=True)
def _straight(solid, cell_m, x_m, y_m, to_x, to_y):  # type: ignore[no-untyped-def]
    """Return whether a person can walk in a straight line to a point."""
    pieces = int(math.hypot(to_x - x_m, to_y - y_m) / PERSON_RADIUS_M) + 1
    for piece in range(1, pieces + 1):
        share = piece / pieces
        if not fits(
            solid, cell_m, x_m + share * (to_x - x_m), y_m + share * (to_y - y_m), PERSON_RADIUS_M
        ):
            return False
    return True


@njit(cache=True)
def _in_the_way(  # type: ignore[no-untyped-def]
    x_m, y_m, to_x, to_y, ahead_x, ahead_y, other_x, other_y, other_radius_m,
):
    """Return whether a body is just ahead, or the step would come closer to it than MIN_GAP_M."""
    touching_m = PERSON_RADIUS_M + other_radius_m
    dx, dy = other_x - x_m, other_y - y_m
    before_m, after_m = math.hypot(dx, dy), math.hypot(other_x - to_x, other_y - to_y)
    if after_m < touching_m + MIN_GAP_M and after_m < before_m:
        return True
    along_m, aside_m = dx * ahead_x + dy * ahead_y, abs(dy * ahead_x - dx * ahead_y)
    return 0.0 < along_m < touching_m + _STOP_GAP_M and aside_m < touching_m + _LATERAL_GAP_M
