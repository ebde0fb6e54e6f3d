# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Navigator: a queue of goals, guidance to the active one, and the outcome of each."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config.goal_recall import GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal, Goals, Target
from ratslam_ros.core.navigation.route_following import Guidance, RouteFollowing, Status
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.errors import UnreachableGoal

MAX_TRY_COUNT = 12
"""Failed tries for a goal after which the next one starts a recovery. Unlearning a link takes
fewer."""

MAX_UNCERTAIN_TRY_COUNT = 1
"""The same limit while the position is uncertain, so that the map ignores the tries."""

GOAL_TIMEOUT_FACTOR = 10.0
"""Time limit of a goal without one of its own, relative to the duration of its longest route:
people in the way multiply the time, a robot that is stuck never arrives. Time with an unknown pose
does not count. The first route of a robot that was carried may begin in a wrong place."""

MIN_GOAL_TIMEOUT_S = 120.0
"""Lower bound of this limit in s, so that near goals survive a person who stands in the way."""

MAX_EXPLORING_S = 600.0
"""Time in s for which a robot without a route explores until its goal fails."""

MAX_OUTCOME_COUNT = 100
"""Number of finished goals that are kept."""


@dataclass(slots=True)
class GoalTask:
    """A requested goal and its progress.

    Attributes:
        number: counts all requested goals from 0.
        goal: the goal.
        asked: the target as text.
        timeout_s: time limit in s, 0 for none, None for the limit by its routes.
        status: ``queued``, ``active``, or the final status.
        reason: why the goal ended without success.
        started_ns: stamp of the first update for this goal.
        expected_s: duration in s of the longest of its routes.
        counted_ns: time since the first route for which the pose was known.
        ended_ns: stamp of the last update for this goal.
        request: the client's name of the request that the goal belongs to, '' for none.
    """

    number: int
    goal: Goal
    asked: str
    timeout_s: float | None = None
    status: str = 'queued'
    reason: str = ''
    started_ns: int | None = None
    expected_s: float | None = None
    counted_ns: int = 0
    ended_ns: int | None = None
    request: str = ''


class Navigator(Saved):
    """Guides the robot to the goals of a queue. The time limits of restored goals begin anew."""

    SAVED = (
        Field('', 'goals', Goals),
        Field('queue', 'queue', list, optional=True,
              save=lambda queue: [
                  [task.goal.experience_id, *task.goal.offset, task.goal.name, task.asked,
                   task.timeout_s] for task in queue
              ],
              load=lambda rows: [
                  GoalTask(n, Goal(int(at), Pose(x_m, y_m, heading_rad), str(name)), str(asked),
                           timeout_s)
                  for n, (at, x_m, y_m, heading_rad, name, asked, timeout_s) in enumerate(rows)
              ]),
    )

    def __init__(
        self, parameters: GoalRecallParameters, experience_map: ExperienceMap,
        goals: Goals | None = None,
    ) -> None:
        """Start without a goal.

        Args:
            parameters: parameters of planning and following routes.
            experience_map: the map.
            goals: its named places, kept by their owner; None: none yet.
        """
        self.planner = RoutePlanner(parameters, experience_map)
        self.goals = Goals() if goals is None else goals
        self.guidance = Guidance('idle')
        """Guidance of the last update."""
        self.outcomes: deque[GoalTask] = deque(maxlen=MAX_OUTCOME_COUNT)
        """The last finished goals, the newest one last."""
        self.ended = 0
        """Number of all finished goals."""
        self.stamp_ns = 0
        """Stamp of the last update."""
        self.queue: deque[GoalTask] = deque()
        """The unfinished goals, the active one first; do not modify."""
        self._following: RouteFollowing | None = None
        self._count = 0
        self._lost_ns: int | None = None
        self._failed_tries = 0

    def go_to(
        self, *targets: Target, append: bool = False, timeout_s: float | None = None,
        tolerance_m: float = 0.0, request: str = '',
    ) -> list[GoalTask]:
        """Request goals in this order, and cancel all earlier ones unless appending.

        Args:
            targets: see ``Goals.find``.
            append: append the goals to the queue.
            timeout_s: time limit of each goal in s, from its first update; 0 for none, None for
                the limit of the parameters.
            tolerance_m: tolerance of positions in m, 0 for ``goal_tolerance_m``.
            request: the client's name of this request, for ``cancel``.

        Raises:
            UnreachableGoal: a target is unknown or unreachable, or the timeout is invalid. The
                queue is unchanged then.
        """
        if timeout_s is not None and not 0.0 <= timeout_s < math.inf:
            raise UnreachableGoal(f'the timeout is {timeout_s}; expected 0 or more s')
        goals = [self.goals.find(target, self.planner, tolerance_m) for target in targets]
        if not append:
            self.cancel('another goal was asked for')
        tasks = [
            GoalTask(self._count + n, goal, str(goal if isinstance(target, int) else target),
                   timeout_s, request=request)
            for n, (goal, target) in enumerate(zip(goals, targets, strict=True))
        ]
        self._count += len(tasks)
        self.queue.extend(tasks)
        return tasks

    def _restored(self, state: State) -> None:
        self._count = len(self.queue)

    def cancel(self, reason: str = 'on request', request: str | None = None) -> int:
        """Cancel the goals of a request, or all; return how many."""
        tasks = [task for task in self.queue if request in (None, task.request)]
        for task in tasks:
            self._end(task, 'cancelled', reason)
        return len(tasks)

    def update(self, stamp_ns: int, pose: Pose | None = None) -> Guidance:
        """Return the guidance to the active goal; see ``RouteFollowing.update`` for the arguments.

        A final status, such as ``succeeded``, finishes the active goal. The next update activates
        the next goal.
        """
        before_ns, self.stamp_ns = self.stamp_ns, stamp_ns
        self.guidance = self._guide(stamp_ns, before_ns, pose)
        return self.guidance

    def _guide(self, stamp_ns: int, before_ns: int, pose: Pose | None) -> Guidance:
        if not self.queue:
            return Guidance('idle')
        task = self.queue[0]
        if self._following is None:
            task.status, task.started_ns = 'active', stamp_ns
            self._following = RouteFollowing(self.planner, task.goal)
        guidance = self._following.update(stamp_ns, pose)
        is_lost = self.planner.experience_map.localisation == 'unknown'
        if task.expected_s is not None and not is_lost:
            task.counted_ns += stamp_ns - before_ns
        if guidance.status == 'succeeded':
            return self._end(task, 'succeeded', '', guidance)
        if guidance.status != 'lost':
            self._lost_ns = None
            task.expected_s = max(task.expected_s or 0.0, guidance.remaining_s)
        elif self._lost_ns is None:
            self._lost_ns = stamp_ns
        failure = self._timed_out(task, stamp_ns)
        return guidance if failure is None else self._end(task, *failure, guidance)

    def _timed_out(self, task: GoalTask, stamp_ns: int) -> tuple[Status, str] | None:
        """Return status and reason if a time limit has expired, else None."""
        assert task.started_ns is not None
        limit_s, counted_ns = task.timeout_s, stamp_ns - task.started_ns
        if limit_s is None and task.expected_s is not None:
            limit_s = max(GOAL_TIMEOUT_FACTOR * task.expected_s, MIN_GOAL_TIMEOUT_S)
            counted_ns = task.counted_ns
        if limit_s is not None and 0.0 < limit_s * 1e9 <= counted_ns:
            return 'timed_out', f'not reached within {limit_s:g} s'
        if self._lost_ns is not None and stamp_ns - self._lost_ns >= MAX_EXPLORING_S * 1e9:
            return 'failed', f'no route was found within {MAX_EXPLORING_S:g} s of exploring'
        return None

    def _end(
        self, task: GoalTask, status: Status, reason: str, last: Guidance | None = None
    ) -> Guidance:
        """Finish a goal and return the guidance with its final status."""
        if task is self.queue[0]:
            self._following = self._lost_ns = None
            self._failed_tries = 0
        self.queue.remove(task)
        task.status, task.reason, task.ended_ns = status, reason, self.stamp_ns
        self.outcomes.append(task)
        self.ended += 1
        last = last or self.guidance
        return Guidance(status, goal=last.goal, replanned=last.replanned, switched=last.switched)

    def report_blocked(self) -> bool:
        """Record that driving along the route failed; return whether the map should count it.

        The map must not count the failure while the pose is uncertain: the robot may be somewhere
        else, and the link open. Repeated failures start a recovery.
        """
        self._failed_tries += 1
        if self._following is not None:
            self._following.report_blocked()
        uncertain = self.planner.experience_map.localisation != 'localised'
        limit = MAX_UNCERTAIN_TRY_COUNT if uncertain else MAX_TRY_COUNT
        if self._following is not None and self._failed_tries > limit:
            self._following.start_recovery()
            self._failed_tries = 0
        return not uncertain

    def remove_pruned(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> None:
        """Handle the removal of an experience from the map; see ``Goal.reanchored``."""
        self.planner.rejected_shortcuts.discard(experience_id)  # the id may be given again
        self.goals.remove_pruned(experience_id, stand_in_id, pose_in_stand_in)
        for task in self.queue:
            task.goal = task.goal.reanchored(experience_id, stand_in_id, pose_in_stand_in)
        if self._following is not None:
            self._following.remove_pruned(experience_id, stand_in_id, pose_in_stand_in)
