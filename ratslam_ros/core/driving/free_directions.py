# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local movement: the free directions of a robot, from a laser scan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.scan import Scan, points_of
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters

Behaviour = Literal['centreline', 'left_wall', 'right_wall', 'straight', 'turn']

WALLS: tuple[Behaviour, ...] = ('left_wall', 'right_wall')
"""Behaviours that follow a wall."""

MIN_NARROW_M = 0.3
"""Free distance that a narrow passage must have, in m."""

HEADING_COUNT = 61
"""Number of examined directions, from 90 degrees right to 90 degrees left: every 3 degrees."""

WALL_DISTANCE_MOST_M = 1.0
"""Largest distance from a wall that is followed, in m. In passages narrower than twice this, the
robot drives in the middle, so that both directions use the same lane."""

WALL_LOOK_AHEAD_M = 0.8
"""Free distance ahead that a direction along a wall must have, in m. With less the robot
oscillates, with more it cuts across small recesses."""

WALL_DISTANCE_STEP_M = 0.05
"""Maximum step between the distances to a wall that are tried, in m."""

CONTINUING_M = 1.5
"""Free distance from which a direction continues along the wall or through an opening, in m."""

OPENING_RAD = math.radians(45.0)
"""Angle to the side of the wall above which a continuing direction leads into an opening."""

DOOR_HEADING_COUNT = 10
"""Maximum width of an opening that is entered through its middle, in directions. Wider openings
are entered along their edge."""

MAX_AWAY_RAD = math.radians(35.0)
"""Maximum angle between the wall and a direction that increases the distance to it."""

LOOKAHEADS_M = (1.0, 1.8, 3.0)
"""Free distances required for a centreline, in m. The longer ones separate the branches of a
junction."""


@dataclass(frozen=True, slots=True)
class DirectionCandidate:
    """A direction in which the robot can drive.

    Attributes:
        behaviour: the behaviour that chooses the direction.
        heading_rad: the direction in the frame of the robot.
        free_m: free distance in m.
    """

    behaviour: Behaviour
    heading_rad: float
    free_m: float


class LocalMovement:
    """Free directions for a robot of some width, in one scan."""

    def __init__(self, parameters: GoalFollowerParameters, scan: Scan) -> None:
        self._p, self.scan = parameters, scan
        self._half_width_m = parameters.robot_radius_m + parameters.margin_m
        self.points = points_of(scan)
        """(n, 2) end points of the beams in the frame of the robot in m."""
        self.headings_rad = np.linspace(-math.pi / 2, math.pi / 2, HEADING_COUNT)
        self._free_at_distance_m: Callable[[float], NDArray[np.float64]] = cache(
            partial(_free_distances_m, self.points, self.headings_rad)
        )
        """Returns (HEADING_COUNT,) free distances for a body that keeps a distance to walls."""

    def free_m(self, heading_rad: float, half_width_m: float | None = None) -> float:
        """Return the free distance straight in a direction in m, at most 8.

        ``half_width_m``: radius of the body in m, None for the robot with its margin.
        """
        width = self._half_width_m if half_width_m is None else half_width_m
        return float(_free_distances_m(self.points, np.array([heading_rad]), width)[0])

    def candidates(self) -> list[DirectionCandidate]:
        """Return the wall and centreline directions; empty if the robot can only turn.

        A wall is followed in the free direction farthest to its side, which leads round the
        corner where the wall ends. A centreline is the middle of a free sector.
        """
        walls = [self.along_wall(side, 0.0, math.pi / 2) for side in WALLS]
        found = [candidate for candidate in walls if candidate is not None]
        body_m = self._free_at_distance_m(self._half_width_m)
        for lookahead_m in LOOKAHEADS_M:
            for first, last in _true_runs(body_m >= lookahead_m):
                heading = float(self.headings_rad[first] + self.headings_rad[last]) / 2
                found.append(DirectionCandidate('centreline', heading, self.free_m(heading)))
        return found

    def narrow_passages(self) -> list[DirectionCandidate]:
        """Return the middle of each sector through which the robot fits without its margin."""
        body_m = self._free_at_distance_m(self._p.robot_radius_m)
        return [
            DirectionCandidate(
                'centreline',
                float(self.headings_rad[first] + self.headings_rad[last]) / 2,
                float(body_m[first : last + 1].max()),
            )
            for first, last in _true_runs(body_m >= MIN_NARROW_M)
        ]

    def along_wall(
        self, side: Behaviour, about_rad: float, within_rad: float
    ) -> DirectionCandidate | None:
        """Return the direction along a wall: the free one farthest to its side.

        The distance to the wall is as large as the room allows, up to WALL_DISTANCE_MOST_M;
        in a passage that is the middle. At the end of the wall, the direction leads round it or
        through the door.

        Args:
            side: ``left_wall`` or ``right_wall``.
            about_rad: middle of the examined sector.
            within_rad: half the width of that sector.

        Returns:
            None if no direction is free for WALL_LOOK_AHEAD_M.
        """
        p = self._p
        near = np.abs(self.headings_rad - about_rad) <= within_rad
        sign = 1.0 if side == 'left_wall' else -1.0
        close_m = self._free_at_distance_m(p.wall_distance_m)
        door_m = self._free_at_distance_m((p.wall_distance_m + p.robot_radius_m + p.margin_m) / 2)
        close = self._outermost(side, close_m, WALL_LOOK_AHEAD_M, near)
        close = close or self._outermost(side, door_m, WALL_LOOK_AHEAD_M, near)
        if close is None:
            return None
        continuing = self._outermost(side, door_m, CONTINUING_M, near)
        if continuing is not None and sign * continuing.heading_rad > OPENING_RAD:
            return self._outermost(side, door_m, CONTINUING_M, near, DOOR_HEADING_COUNT)
        continuing = continuing or close
        if sign * continuing.heading_rad > OPENING_RAD:
            return close
        more_m = WALL_DISTANCE_MOST_M - p.wall_distance_m
        count = math.ceil(more_m / WALL_DISTANCE_STEP_M)
        for step in range(count, 0, -1):
            free_m = self._free_at_distance_m(p.wall_distance_m + step / count * more_m)
            candidate = self._outermost(side, free_m, WALL_LOOK_AHEAD_M, near)
            if (
                candidate
                and sign * (continuing.heading_rad - candidate.heading_rad) < MAX_AWAY_RAD
            ):
                return candidate
        return close

    def _outermost(
        self, side: Behaviour, free_m: NDArray[np.float64], min_free_m: float,
        near: NDArray[np.bool_], max_door_count: int = 0,
    ) -> DirectionCandidate | None:
        """Return the direction farthest to a side among those near and free for ``min_free_m``.

        ``max_door_count``: from a sector of at most this many directions, return the middle.
        """
        runs = _true_runs((free_m >= min_free_m) & near)
        if not runs:
            return None
        first, last = runs[-1] if side == 'left_wall' else runs[0]
        inset = (last - first) // 2 if last - first <= max_door_count else 0
        index = last - inset if side == 'left_wall' else first + inset
        return DirectionCandidate(side, float(self.headings_rad[index]), float(free_m[index]))

    def straight_directions(self) -> list[DirectionCandidate]:
        """Return all examined directions with their free distances."""
        body_m = self._free_at_distance_m(self._half_width_m)
        return [
            DirectionCandidate('straight', heading_rad, free_m) for heading_rad, free_m
            in zip(self.headings_rad.tolist(), body_m.tolist(), strict=True)
        ]


def _true_runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and last index of each run of True."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0)).tolist()
    return [(a, b - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@compiled
def _free_distances_m(
    points: NDArray[np.float64], headings_rad: NDArray[np.float64], half_width_m: float
) -> NDArray[np.float64]:
    """Return for each heading how far a disc can move before it touches a point in m, at most 8.

    A point inside the disc blocks the directions towards it, but not those away from it.

    Args:
        points: (n, 2) obstacle points in m.
        headings_rad: (k,) evenly spaced ascending headings.
        half_width_m: radius of the disc in m.
    """
    count = len(headings_rad)
    reach = np.full(count, 8.0)
    cosines, sines = np.cos(headings_rad), np.sin(headings_rad)
    step = headings_rad[1] - headings_rad[0] if count > 1 else 1.0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        away = math.hypot(x, y)
        # Other headings pass the point at a larger distance.
        aside = math.asin(half_width_m / away) if away > half_width_m else math.pi / 2
        bearing = math.atan2(y, x) - headings_rad[0]
        first = max(math.floor((bearing - aside) / step), 0)
        last = min(math.ceil((bearing + aside) / step), count - 1)
        for k in range(first, last + 1):
            along = cosines[k] * x + sines[k] * y
            across = cosines[k] * y - sines[k] * x
            if along > 0.0 and abs(across) < half_width_m:
                gap = along - math.sqrt(half_width_m * half_width_m - across * across)
                reach[k] = min(reach[k], max(gap, 0.0))
    return reach
