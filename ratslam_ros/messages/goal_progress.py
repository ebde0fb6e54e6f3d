# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Progress of one request of goals, as ``experience_map/status`` reports it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.limits import MAX_COORDINATE_M
from ratslam_ros.messages.goals import MAX_GOALS, GoalStatus, Task

ANSWER_TIMEOUT_S = 5.0
"""Time within which the experience map must list a request, in s. It lists one within one cycle of
its inputs; a map that is loading or pruning takes longer, but less than this."""

SUCCESS, UNKNOWN, NO_ROUTE, NO_PROGRESS = 0, 200, 208, 105
"""Error codes of Nav2: NONE, UNKNOWN and NO_VALID_PATH of ComputePathToPose, and
FAILED_TO_MAKE_PROGRESS of FollowPath. NavigateToPose passes on the codes of these actions."""

_CODES = {'failed': NO_ROUTE, 'timed_out': NO_PROGRESS}


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a request ended, with an error code of Nav2 and its reason."""

    kind: Literal['succeeded', 'aborted', 'cancelled']
    code: int = SUCCESS
    text: str = ''


@dataclass(frozen=True, slots=True)
class Estimate:
    """What is left of a request: distance in m, time in s (0 if unknown) and number of goals."""

    distance_m: float
    time_s: float
    goals: int


def refusal(positions_m: Sequence[tuple[float, float]], behavior_tree: str) -> str:
    """Return why a request cannot be accepted, or an empty string.

    Args:
        positions_m: goals on the map.
        behavior_tree: name of the behaviour tree that the request asks for.
    """
    if not positions_m:
        return 'it has no pose'
    if len(positions_m) > MAX_GOALS:
        return f'it has {len(positions_m)} poses; expected at most {MAX_GOALS}'
    for place in positions_m:
        if not all(abs(value) <= MAX_COORDINATE_M for value in place):  # NaN is not
            return f'its pose {place} is farther than {MAX_COORDINATE_M:g} m from the origin'
    if behavior_tree:
        return (
            f'it asks for the behaviour tree {behavior_tree!r:.100}; this node has none, leave '
            'behavior_tree empty'
        )
    return ''


class GoalProgress:
    """Follows a request through the statuses until it has ended.

    A request ends with the first of its goals that is not reached; the caller then cancels the
    others.
    """

    def __init__(
        self, request: str, positions_m: Sequence[tuple[float, float]], now_s: float
    ) -> None:
        """Begin with a request that has just been sent.

        Args:
            request: its name.
            positions_m: its goals on the map, in order.
            now_s: current time in s, of any clock.
        """
        self.request = request
        self.started_s = now_s
        self.recoveries = 0
        """How often the route was lost or had to be recovered."""
        self.is_cancelled = False
        """Whether the caller has asked to cancel it."""
        self.outcome: Outcome | None = None
        self._places = np.array(positions_m, np.float64).reshape(-1, 2)
        self._is_listed = False
        self._left = len(self._places)
        self._status = ''
        self._remaining_s: float | None = None

    def on_status(self, status: GoalStatus) -> None:
        """Take a status."""
        if self.outcome is not None:
            return
        queued = [task for task in status.queue if task.request == self.request]
        ended = [task for task in status.outcomes if task.request == self.request]
        if status.refused == self.request:
            self.outcome = Outcome('aborted', NO_ROUTE, status.reason)
            return
        bad = next((task for task in ended if task.status != 'succeeded'), None)
        if bad is not None:
            self._end(bad)
        elif queued:
            self._is_listed, self._left = True, len(queued)
            if status.queue[0].request == self.request:
                self._follow(status)
        elif ended:
            self.outcome = Outcome('succeeded')
        elif self._is_listed:
            self.outcome = Outcome(
                'aborted', UNKNOWN,
                'the experience map no longer lists the goal: it was reset, loaded or restarted',
            )

    def check(self, now_s: float) -> None:
        """End the request if the experience map does not answer."""
        is_late = now_s - self.started_s > ANSWER_TIMEOUT_S
        if self.outcome is None and not self._is_listed and is_late:
            kind: Literal['cancelled', 'aborted'] = 'cancelled' if self.is_cancelled else 'aborted'
            self.outcome = Outcome(
                kind, UNKNOWN, f'experience_map has not answered within {ANSWER_TIMEOUT_S:g} s'
            )

    def replace(self) -> None:
        """End the request because the caller sends another one."""
        self.outcome = self.outcome or Outcome('aborted', UNKNOWN, 'a newer goal has replaced it')

    def estimate(
        self, route_m: NDArray[np.float64], x_m: float, y_m: float, speed_mps: float
    ) -> Estimate:
        """Return what is left: along the route to the next goal, then straight lines.

        Args:
            route_m: (n, 2) route ahead of the robot; without one, straight from the robot.
            x_m, y_m: position of the robot.
            speed_mps: assumed between the goals that have no route yet.
        """
        left = self._places[len(self._places) - self._left :]
        ahead = np.vstack([[[x_m, y_m]], route_m if len(route_m) else left[:1]])
        first_m, others_m = _length_m(ahead), _length_m(left)
        time_s = 0.0
        if self._remaining_s is not None:
            time_s = self._remaining_s + others_m / speed_mps
        return Estimate(first_m + others_m, time_s, self._left)

    def _follow(self, status: GoalStatus) -> None:
        self._remaining_s = status.remaining_s
        is_recovering = status.status in ('recovering', 'lost')
        self.recoveries += is_recovering and self._status != status.status
        self._status = status.status

    def _end(self, task: Task) -> None:
        text = f'goal {task.goal} {task.status.replace("_", " ")}'
        text += f': {task.reason}' if task.reason else ''
        if task.status == 'cancelled' and self.is_cancelled:
            self.outcome = Outcome('cancelled', SUCCESS, text)
        else:
            self.outcome = Outcome('aborted', _CODES.get(task.status, UNKNOWN), text)


def _length_m(points_m: NDArray[np.float64]) -> float:
    return math.fsum(np.hypot(*np.diff(points_m, axis=0).T).tolist())
