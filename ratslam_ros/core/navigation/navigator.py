# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Navigator: experience map, goals in a queue -> where to go now, and what became of each goal."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config.goal_recall import GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal, Goals, Target
from ratslam_ros.core.navigation.route_following import Guidance, RouteFollowing, Status
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.errors import UnreachableGoal

MOST_TRIES, MOST_UNSURE = 12, 1
"""More failed tries for a goal than are needed to unlearn a link; and where they do not count."""

MOST_OUTCOMES = 100
"""Of the goals that have ended, so many are remembered."""


@dataclass(slots=True)
class GoalTask:
    """A goal that was asked for, and what has become of it.

    ``number`` counts all from 0. ``timeout_s``: None as the parameters say, 0 none. ``status``:
    ``queued``, ``active``, or how it ended, with the ``reason`` where it did not succeed.
    ``expected_s``: what the first route said, and ``routed_ns`` when that was.
    """

    number: int
    goal: Goal
    asked: str
    timeout_s: float | None = None
    status: str = 'queued'
    reason: str = ''
    started_ns: int | None = None
    routed_ns: int | None = None
    expected_s: float | None = None
    ended_ns: int | None = None


class Navigator:
    """Goes to goals one after the other; knows the places that have names."""

    def __init__(self, parameters: GoalRecallParameters, experience_map: ExperienceMap) -> None:
        self.recall = RoutePlanner(parameters)
        self.goals = Goals()
        self.guidance = Guidance('idle')
        """What the last update gave."""
        self.outcomes: deque[GoalTask] = deque(maxlen=MOST_OUTCOMES)
        """The goals that have ended, the last one last."""
        self.ended = 0
        """How many that were in all."""
        self.stamp_ns = 0
        """Of the last update."""
        self._map = experience_map
        self._queue: deque[GoalTask] = deque()
        self._following: RouteFollowing | None = None
        self._count = 0
        self._lost_ns: int | None = None
        self._tries = 0

    @property
    def parameters(self) -> GoalRecallParameters:
        """How routes are found and followed; they may be replaced at any time."""
        return self.recall.parameters

    @parameters.setter
    def parameters(self, parameters: GoalRecallParameters) -> None:
        self.recall.parameters = parameters

    @property
    def queue(self) -> Sequence[GoalTask]:
        """The goals that have not ended, the active one first; not to be changed or kept."""
        return self._queue

    def go_to(
        self, *targets: Target, append: bool = False, timeout_s: float | None = None,
        tolerance_m: float = 0.0,
    ) -> list[GoalTask]:  # fmt: skip
        """Go to places, in this order; those asked for before are cancelled.

        Args:
            targets: what ``Goals.find`` knows.
            append: go there after those asked for before.
            timeout_s: time for each, from when the robot sets out for it; 0: none, None: as the
                parameters say.
            tolerance_m: of positions; 0: ``goal_tolerance_m``.

        Raises:
            UnreachableGoal: one is not known, or no link leads to it; then nothing has changed.
        """
        if timeout_s is not None and not 0.0 <= timeout_s < math.inf:
            raise UnreachableGoal(f'the timeout is {timeout_s}; expected 0 or more s')
        found = [
            self.goals.find(target, self._map, self.recall, tolerance_m) for target in targets
        ]
        if not append:
            self.cancel('another goal was asked for')
        errands = [
            GoalTask(self._count + n, goal, str(goal if isinstance(target, int) else target),
                   timeout_s)
            for n, (goal, target) in enumerate(zip(found, targets, strict=True))
        ]  # fmt: skip
        self._count += len(errands)
        self._queue.extend(errands)
        return errands

    def cancel(self, reason: str = 'cancelled', number: int | None = None) -> int:
        """Cancel one goal, or all that have not ended; return how many that were."""
        chosen = [e for e in self._queue if number is None or e.number == number]
        for errand in chosen:
            self._end(errand, 'cancelled', reason)
        return len(chosen)

    def update(self, stamp_ns: int, pose: Pose | None = None, located: bool = True) -> Guidance:
        """Return where to go; see ``RouteFollowing.update`` for what is given.

        The goal that is active has ended if the status says so; the next update sets out for the
        next one.
        """
        self.stamp_ns = stamp_ns
        self.guidance = self._guide(stamp_ns, pose, located)
        return self.guidance

    def _guide(self, stamp_ns: int, pose: Pose | None, located: bool) -> Guidance:
        if not self._queue:
            return Guidance('idle')
        errand = self._queue[0]
        if self._following is None:
            errand.status, errand.started_ns = 'active', stamp_ns
            self._following = RouteFollowing(self.recall, self._map, errand.goal)
        guidance = self._following.update(stamp_ns, pose, located)
        if guidance.status == 'succeeded':
            return self._end(errand, 'succeeded', '', guidance)
        if guidance.status != 'lost':
            self._lost_ns = None
            if errand.routed_ns is None:
                errand.routed_ns, errand.expected_s = stamp_ns, guidance.remaining_s
        elif self._lost_ns is None:
            self._lost_ns = stamp_ns
        over = self._over(errand, stamp_ns)
        return guidance if over is None else self._end(errand, *over, guidance)

    def _over(self, errand: GoalTask, stamp_ns: int) -> tuple[Status, str] | None:
        """Return how a goal has ended that took too long, and why; None: it has not."""
        p = self.parameters
        limits = []
        if errand.timeout_s is not None or p.goal_timeout_s > 0.0:
            limit_s = p.goal_timeout_s if errand.timeout_s is None else errand.timeout_s
            limits.append((errand.started_ns, limit_s))
        elif errand.expected_s is not None and p.goal_timeout_factor > 0.0:
            limit_s = max(p.goal_timeout_factor * errand.expected_s, p.goal_timeout_least_s)
            limits.append((errand.routed_ns, limit_s))
        for since_ns, limit_s in limits:
            assert since_ns is not None
            if 0.0 < limit_s * 1e9 <= stamp_ns - since_ns:
                return 'timed_out', f'not reached within {limit_s:g} s'
        limit_s = p.goal_explore_s
        if self._lost_ns is not None and 0.0 < limit_s * 1e9 <= stamp_ns - self._lost_ns:
            return 'failed', f'no route was found within {limit_s:g} s of exploring'
        return None

    def _end(
        self, errand: GoalTask, status: Status, reason: str, last: Guidance | None = None
    ) -> Guidance:
        """End a goal, and return the guidance that says so."""
        if errand is self._queue[0]:
            self._following = self._lost_ns = None
            self._tries = 0
        self._queue.remove(errand)
        errand.status, errand.reason, errand.ended_ns = status, reason, self.stamp_ns
        self.outcomes.append(errand)
        self.ended += 1
        last = last or self.guidance
        return Guidance(status, goal=last.goal, replanned=last.replanned, switched=last.switched)

    def report_blocked(self) -> bool:
        """Take note that a try led nowhere; return whether the map shall count it.

        It shall not where the robot may be wrong about its place: the way is not closed, the
        robot is not there. Then, and where many tries have unlearned nothing, it explores a bit.
        """
        self._tries += 1
        if self._following is not None:
            self._following.report_blocked()
        unsure = 0.0 < self.parameters.try_unknown_m < self.guidance.unknown_m
        if self._following is not None and self._tries > (MOST_UNSURE if unsure else MOST_TRIES):
            self._following.start_recovery()
            self._tries = 0
        return not unsure

    def forgotten(self, experience_id: int, stand_in_id: int, pose_in_stand_in: Pose) -> None:
        """Keep all goals where an experience is forgotten; see ``Goal.without``."""
        self.recall.forgotten(self._map, experience_id)
        self.goals.forgotten(experience_id, stand_in_id, pose_in_stand_in)
        for errand in self._queue:
            errand.goal = errand.goal.without(experience_id, stand_in_id, pose_in_stand_in)
        if self._following is not None:
            self._following.forgotten(experience_id, stand_in_id, pose_in_stand_in)
