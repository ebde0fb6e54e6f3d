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

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.scan import Scan, points_of
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters

Behaviour = Literal['centreline', 'left_wall', 'right_wall', 'straight', 'turn']

WALLS: tuple[Behaviour, ...] = ('left_wall', 'right_wall')

NARROW_M = 0.3
"""How far a narrow passage must be open."""

HEADINGS = 61
"""Ways on that are looked at, from a quarter turn right to one left: every 3 degrees."""

FINENESS_M = 0.05
"""Distances to walls are tried in steps no greater than this."""

ON_M = 1.5
"""A direction that is open for so long leads on; the furthest to the wall's side runs along it."""

OPENING_RAD = math.radians(45.0)
"""Where that direction leads further aside than this the wall ends, as at a door."""

DOOR_HEADINGS = 10
"""An opening of no more directions is gone into in its middle, a wider one along its edge."""

AWAY_RAD = math.radians(35.0)
"""To come away from a wall the robot turns no further than this from the direction along it."""

LOOK_AHEAD_M = (1.0, 1.8, 3.0)
"""How far a way must be open for a centreline: far ones tell branches of a junction apart."""


@dataclass(frozen=True, slots=True)
class DirectionCandidate:
    """A way on: the behaviour that takes it, its direction, and how far it is open."""

    behaviour: Behaviour
    heading_rad: float
    open_m: float


class LocalMovement:
    """What a scan leaves free for a robot of some width."""

    def __init__(self, parameters: GoalFollowerParameters, scan: Scan) -> None:
        self._p = parameters
        self.scan = scan
        self.points = points_of(scan)
        """(n, 2) m, where beams ended, in the robot's frame."""
        self.headings_rad = np.linspace(-math.pi / 2, math.pi / 2, HEADINGS)
        self._at_distance_m: dict[float, NDArray[np.float64]] = {}

    def _beside_wall_m(self, distance_m: float) -> NDArray[np.float64]:
        """Return (HEADINGS,) how far a body that keeps a distance to walls can go."""
        known = self._at_distance_m.get(distance_m)
        if known is None:
            known = _open_m(self.points, self.headings_rad, distance_m)
            self._at_distance_m[distance_m] = known
        return known

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

    def options(self) -> list[DirectionCandidate]:
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
                found.append(DirectionCandidate('centreline', heading, self.open_m(heading)))
        return found

    def narrow(self) -> list[DirectionCandidate]:
        """Return the middles of all that the bare body still fits through, however short."""
        body = _open_m(self.points, self.headings_rad, self._p.robot_radius_m)
        return [
            DirectionCandidate(
                'centreline',
                float(self.headings_rad[first] + self.headings_rad[last]) / 2,
                float(body[first : last + 1].max()),
            )
            for first, last in _runs(body >= NARROW_M)
        ]

    def wall(
        self, side: Behaviour, about_rad: float, within_rad: float
    ) -> DirectionCandidate | None:
        """Return the way along a wall: of the directions close to one, the furthest to its side.

        As far from the wall as there is room, up to ``wall_distance_most_m``; in a passage that is
        its middle. Where the wall ends the way leads round its end, or through the door in it.
        None where no direction is open for ``wall_look_ahead_m``.
        """
        p = self._p
        near = np.abs(self.headings_rad - about_rad) <= within_rad
        sign = 1.0 if side == 'left_wall' else -1.0
        close_m = self._beside_wall_m(p.wall_distance_m)
        door_m = self._beside_wall_m((p.wall_distance_m + p.robot_radius_m + p.margin_m) / 2)
        close = self._furthest(side, close_m, p.wall_look_ahead_m, near)
        close = close or self._furthest(side, door_m, p.wall_look_ahead_m, near)
        if close is None:
            return None
        on = self._furthest(side, door_m, ON_M, near)
        if on is not None and sign * on.heading_rad > OPENING_RAD:
            return self._furthest(side, door_m, ON_M, near, DOOR_HEADINGS)
        on = on or close
        if sign * on.heading_rad > OPENING_RAD:
            return close
        count = max(math.ceil((p.wall_distance_most_m - p.wall_distance_m) / FINENESS_M), 0)
        for step in range(count, 0, -1):
            share = step / count
            open_m = self._beside_wall_m(
                p.wall_distance_m + share * (p.wall_distance_most_m - p.wall_distance_m)
            )
            option = self._furthest(side, open_m, p.wall_look_ahead_m, near)
            if option and sign * (on.heading_rad - option.heading_rad) < AWAY_RAD:
                return option
        return close

    def _furthest(
        self, side: Behaviour, open_m: NDArray[np.float64], least_m: float,
        near: NDArray[np.bool_], narrow: int = 0,
    ) -> DirectionCandidate | None:  # fmt: skip
        """Return the direction that is the furthest to a side, of those near and open for long.

        ``narrow``: of no more directions than so many it is the middle.
        """
        runs = _runs((open_m >= least_m) & near)
        if not runs:
            return None
        first, last = runs[-1] if side == 'left_wall' else runs[0]
        inset = (last - first) // 2 if last - first <= narrow else 0
        at = last - inset if side == 'left_wall' else first + inset
        return DirectionCandidate(side, float(self.headings_rad[at]), float(open_m[at]))

    def fan(self) -> list[DirectionCandidate]:
        """Return all directions that the robot can go on in, as far as they are open."""
        return [
            DirectionCandidate('straight', float(heading_rad), float(open_m))
            for heading_rad, open_m in zip(self.headings_rad, self._body_m, strict=True)
        ]


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of every stretch of True."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0)).tolist()
    return [(a, b - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@compiled
def _open_m(
    points: NDArray[np.float64], headings_rad: NDArray[np.float64], half_width_m: float
) -> NDArray[np.float64]:
    """Return for each heading how far a disc goes before it touches a point; at most 8 m.

    ``headings_rad``: evenly spaced, rising. A point that the disc touches already bars the way
    towards it, not the way off.
    """
    count = len(headings_rad)
    reach = np.full(count, 8.0)
    cosines, sines = np.cos(headings_rad), np.sin(headings_rad)
    step = headings_rad[1] - headings_rad[0] if count > 1 else 1.0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        away = math.hypot(x, y)
        # Only headings that pass it closely enough are looked at.
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
