# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local movement: laser scan -> the ways on that the robot has right now."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.compiled import compiled
from ratslam_ros.core.movement_config import GoalFollowerParameters

Behaviour = Literal['centreline', 'left_wall', 'right_wall', 'straight', 'turn']

WALLS: tuple[Behaviour, ...] = ('left_wall', 'right_wall')

NARROW_M = 0.3
"""How far a narrow passage must be open."""

HEADINGS = 61
"""Ways on that are looked at, from a quarter turn right to one left: every 3 degrees."""

LOOK_AHEAD_M = (1.0, 1.8, 3.0)
"""How far a way must be open for a centreline: far ones tell branches of a junction apart."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One laser scan, beams counter-clockwise from ``angle_min_rad``; 0 is straight ahead.

    ``ranges_m``: (n,); what is not a finite positive number is no obstacle.
    """

    stamp_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    ranges_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Option:
    """A way on: the behaviour that takes it, its direction, and how far it is open."""

    behaviour: Behaviour
    heading_rad: float
    open_m: float


class LocalMovement:
    """What a scan leaves free for a robot of some width."""

    def __init__(self, parameters: GoalFollowerParameters, scan: Scan) -> None:
        self._p = parameters
        self.points = _points(scan.ranges_m, scan.angle_min_rad, scan.angle_increment_rad)
        """(n, 2) m, where beams ended, in the robot's frame."""
        self.headings_rad = np.linspace(-math.pi / 2, math.pi / 2, HEADINGS)

    @cached_property
    def _beside_wall_m(self) -> NDArray[np.float64]:
        """(HEADINGS,) how far a body that keeps its distance to walls can go."""
        return _open_m(self.points, self.headings_rad, self._p.wall_distance_m)

    @cached_property
    def _body_m(self) -> NDArray[np.float64]:
        """(HEADINGS,) how far the robot with its margin can go."""
        return _open_m(self.points, self.headings_rad, self._p.robot_radius_m + self._p.margin_m)

    def open_m(self, heading_rad: float, half_width_m: float | None = None) -> float:
        """Return how far a body can go straight in a direction before it touches something.

        ``half_width_m``: of the body; None: of the robot with its margin.
        """
        width = self._p.robot_radius_m + self._p.margin_m if half_width_m is None else half_width_m
        return float(_open_m(self.points, np.array([heading_rad]), width)[0])

    def options(self) -> list[Option]:
        """Return every way on; none where all is closed, and only turning is left.

        A wall is followed by going as far to its side as is open: past its end that leads round
        the corner. A centreline is the middle of what is open.
        """
        walls = [self.wall(side, 0.0, math.pi / 2) for side in WALLS]
        found = [option for option in walls if option is not None]
        body = self._body_m
        for look_ahead_m in LOOK_AHEAD_M:
            for first, last in _runs(body >= look_ahead_m):
                heading = float(self.headings_rad[first] + self.headings_rad[last]) / 2
                found.append(Option('centreline', heading, self.open_m(heading)))
        return found

    def narrow(self) -> list[Option]:
        """Return the middles of all that the bare body still fits through, however short."""
        body = _open_m(self.points, self.headings_rad, self._p.robot_radius_m)
        return [
            Option(
                'centreline',
                float(self.headings_rad[first] + self.headings_rad[last]) / 2,
                float(body[first : last + 1].max()),
            )
            for first, last in _runs(body >= NARROW_M)
        ]

    def wall(self, side: Behaviour, about_rad: float, within_rad: float) -> Option | None:
        """Return the way along a wall: of the directions close to one, the furthest to its side.

        None where none of them is open for ``wall_look_ahead_m``.
        """
        wall = self._beside_wall_m
        near = np.abs(self.headings_rad - about_rad) <= within_rad
        passable = np.flatnonzero((wall >= self._p.wall_look_ahead_m) & near)
        if len(passable) == 0:
            return None
        at = passable[-1] if side == 'left_wall' else passable[0]
        return Option(side, float(self.headings_rad[at]), float(wall[at]))

    def fan(self) -> list[Option]:
        """Return all directions that the robot can go on in, as far as they are open."""
        return [
            Option('straight', float(heading_rad), float(open_m))
            for heading_rad, open_m in zip(self.headings_rad, self._body_m, strict=True)
        ]

    def towards(self, heading_rad: float) -> Option:
        """Return the way straight on in a direction: across a room, or up to a goal."""
        return Option('straight', heading_rad, self.open_m(heading_rad))


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of every stretch of True."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0)).tolist()
    return [(a, b - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@compiled
def _points(
    ranges_m: NDArray[np.float64], angle_min_rad: float, angle_increment_rad: float
) -> NDArray[np.float64]:
    points = np.empty((len(ranges_m), 2))
    count = 0
    for beam in range(len(ranges_m)):
        if 0.0 < ranges_m[beam] < 1e6:
            angle = angle_min_rad + beam * angle_increment_rad
            points[count, 0] = ranges_m[beam] * math.cos(angle)
            points[count, 1] = ranges_m[beam] * math.sin(angle)
            count += 1
    return points[:count]


@compiled
def _open_m(
    points: NDArray[np.float64], headings_rad: NDArray[np.float64], half_width_m: float
) -> NDArray[np.float64]:
    """Return for each heading how far a disc goes before it touches a point; at most 8 m.

    A point that it touches already bars the way towards it, not the way off.
    """
    reach = np.empty(len(headings_rad))
    for k in range(len(headings_rad)):
        c, s = math.cos(headings_rad[k]), math.sin(headings_rad[k])
        nearest = 8.0
        for i in range(len(points)):
            along = c * points[i, 0] + s * points[i, 1]
            across = c * points[i, 1] - s * points[i, 0]
            if along > 0.0 and abs(across) < half_width_m:
                gap = along - math.sqrt(half_width_m * half_width_m - across * across)
                nearest = min(nearest, max(gap, 0.0))
        reach[k] = nearest
    return reach
