# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Driving by the goal memory: a queue of goals, and the direction to the first one as a route.

Milford et al. (2005): the robot seeks its goals in order (section IV) in the direction in which
the time decreases fastest (III.B), avoids obstacles, and stops within one cell of a goal (V.C). A
goal that is marked anew leads elsewhere at once (IV). Links "are updated to show the blockage"
(VI), but no equation does that: ``GoalRoutes.blocked`` is ours, and so are the limits after which
a goal is given up.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.driving.goal_follower import TRY_TIMEOUT_S
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal

TOWARDS_M = 2.0
"""Length of the straight route in the direction of the goal memory, for obstacle avoidance."""

MAX_TRY_COUNT = 12
"""Failed tries for a goal after which it is given up; as many let a robot on the map recover."""

PROGRESS_SHARE = 0.99
"""Share of the least time to the goal so far at which the robot has made progress."""

MAX_IDLE_S = 120.0
"""Time without progress after which a goal is given up, in s."""


def route_towards(bearing_rad: float) -> NDArray[np.float64]:
    """Return the route to follow in a direction: (2, 2) m, x ahead and y to the left."""
    return TOWARDS_M * np.array([[0.0, 0.0], [math.cos(bearing_rad), math.sin(bearing_rad)]])


@dataclass(frozen=True, slots=True)
class SoughtGoal:
    """The first goal of a queue, and the direction to it.

    Attributes:
        name: its name.
        bearing_rad: direction relative to the robot, positive to the left; None at the goal, and
            if no direction is known: the robot then explores.
        remaining_s: time to the goal, infinite if it is unknown.
        is_reached: whether the robot is at the goal, which has left the queue.
        given_up: why the goal has left the queue without being reached, '' if it has not.
        no_route: why no route is known, '' if there is one.
    """

    name: str
    bearing_rad: float | None = None
    remaining_s: float = math.inf
    is_reached: bool = False
    given_up: str = ''
    no_route: str = ''


class GoalQueue:
    """Names of marked goals that are visited in order, until each is reached or given up."""

    def __init__(self) -> None:
        self.names: deque[str] = deque()
        """The goals, the sought one first; do not modify."""
        self._place: Place | None = None
        self._bearing_rad: float | None = None
        self._try_count = 0
        self._least_s, self._progress_ns = math.inf, 0

    def append(self, name: str) -> None:
        """Add a goal, unless it is the last one already, as of a topic that is sent repeatedly."""
        if not self.names or self.names[-1] != name:
            self.names.append(name)

    def update(self, stamp_ns: int, memory: GoalMemory, peak: Place) -> SoughtGoal | None:
        """Return the direction to the first goal; a goal that is over leaves the queue.

        Args:
            stamp_ns: the present stamp.
            memory: the goal memory.
            peak: the place of the robot.

        Returns:
            None if the queue is empty.
        """
        if not self.names:
            return None
        name = self.names[0]
        try:
            place = memory.goal(name)
        except UnreachableGoal as error:  # the memory has been replaced
            return self._ended(SoughtGoal(name, given_up=str(error)))
        if place != self._place:  # the next goal, or it was marked anew
            self._place, self._try_count = place, 0
            self._least_s, self._progress_ns = math.inf, stamp_ns
        bearing_rad, remaining_s, no_route = None, math.inf, ''
        try:
            times = memory.recall(place)
        except UnreachableGoal as error:
            no_route = str(error)
        else:
            bearing_rad, remaining_s = memory.bearing(times, peak), memory.remaining_s(times, peak)
        self._bearing_rad = bearing_rad
        is_reached = memory.reached(place, peak)
        given_up = '' if is_reached else self._failure(stamp_ns, remaining_s)
        sought = SoughtGoal(name, bearing_rad, remaining_s, is_reached, given_up, no_route)
        return self._ended(sought) if is_reached or given_up else sought

    def _failure(self, stamp_ns: int, remaining_s: float) -> str:
        """Return why the goal cannot be reached, or an empty string."""
        if remaining_s < PROGRESS_SHARE * self._least_s or stamp_ns < self._progress_ns:
            self._least_s, self._progress_ns = remaining_s, stamp_ns
        if self._try_count >= MAX_TRY_COUNT:
            return f'the way is blocked: {self._try_count} tries have failed'
        if stamp_ns - self._progress_ns >= MAX_IDLE_S * 1e9:
            return f'no progress within {MAX_IDLE_S:g} s'
        return ''

    def _ended(self, sought: SoughtGoal) -> SoughtGoal:
        self.names.popleft()
        self._place = self._bearing_rad = None
        return sought

    def cancel(self, reason: str) -> SoughtGoal | None:
        """Remove all goals; return the sought one as given up for a reason, None without one."""
        if not self.names:
            return None
        sought = self._ended(SoughtGoal(self.names[0], given_up=reason))
        self.names.clear()
        return sought

    def blocked(self) -> tuple[float, float] | None:
        """Count a failed try to drive on in the last direction.

        Returns:
            The direction and the duration of all tries, for ``GoalMemory.blocked``; None if the
            robot seeks no goal or has no direction.
        """
        if self._bearing_rad is None:
            return None
        self._try_count += 1
        self._least_s = math.inf  # other routes take longer
        return self._bearing_rad, self._try_count * TRY_TIMEOUT_S
