# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal memory in the node of the pose cells: marking goals and publishing directions to them."""

from __future__ import annotations

import itertools
from typing import Any

from std_msgs.msg import String

from ratslam_ros.core.driving.goal_queue import GoalQueue, SoughtGoal
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.messages.goals import BehaviourReport
from ratslam_ros.messages.pose_cells import GoalMemoryPayload
from ratslam_ros.pipeline.commands import BlockWay, MarkGoal
from ratslam_ros.pipeline.pose_cells import PoseCellsStage
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.qos import GOAL, RESULT, STATE


class GoalSeeking:
    """Learns a goal memory, and publishes the direction to the first goal of a queue."""

    def __init__(self, node: RatslamNode, stage: PoseCellsStage) -> None:
        self._node, self._stage = node, stage
        self._queue, self._stamp_ns = GoalQueue(), 0
        self._publisher = node.create_payload_publisher(GoalMemoryPayload, STATE)
        node.create_subscription(String, 'pose_cells/goal', self._on_goal, GOAL)
        node.create_subscription(String, 'pose_cells/mark_goal', self._on_mark, GOAL)
        node.offer('pose_cells/mark_goal', self._mark)
        node.create_payload_subscription(
            BehaviourReport, self._on_behaviour, RESULT, 'behaviour'
        )

    @property
    def _memory(self) -> GoalMemory:
        assert self._stage.goal_memory is not None
        return self._stage.goal_memory

    def reset(self) -> None:
        """Seek no goal any more."""
        self._cancel('the goal memory was replaced')

    def update(self, stamp_ns: int) -> None:
        """Publish the direction after a motion, if a goal is set."""
        self._stamp_ns = stamp_ns
        sought = self._queue.update(stamp_ns, self._memory, self._stage.core.peak)
        if sought is None:
            return
        self._publish(sought)
        if sought.no_route:
            self._node.diagnostics.warn(f'no route to {sought.name}: {sought.no_route}')
        if sought.is_reached:
            self._node.get_logger().info(f'{sought.name} is reached')
        elif sought.given_up:
            self._node.diagnostics.warn(f'{sought.name} is given up: {sought.given_up}')

    def _publish(self, sought: SoughtGoal) -> None:
        is_over = sought.is_reached or sought.given_up
        waiting = [*self._queue.names][0 if is_over else 1 :]
        self._publisher.publish(GoalMemoryPayload.of(self._stamp_ns, sought, waiting))

    def _cancel(self, reason: str) -> None:
        sought = self._queue.cancel(reason)
        if sought is not None:
            self._publish(sought)
            self._node.get_logger().info(f'no goal is sought any more: {reason}')

    def _on_goal(self, message: String) -> None:
        """Append a goal by its name to the queue; an empty name cancels all."""
        if not message.data:
            self._cancel('cancelled')
            return
        try:
            self._memory.goal(message.data)
        except UnreachableGoal as error:
            self._node.diagnostics.warn(str(error))
        else:
            self._queue.append(message.data)

    def _on_behaviour(self, report: BehaviourReport) -> None:
        """Let a failed try to drive on change the routes of the memory."""
        blocked = self._queue.blocked() if report.failed else None
        if blocked is not None:
            self._node.host.command(BlockWay(*blocked))

    def _on_mark(self, message: String) -> None:
        self._mark(message.data)

    def _mark(self, name: str = '') -> str:
        """Mark the robot's place by a name, or by the first free number; return the name."""
        if not name:
            numbered = map('goal_{}'.format, itertools.count(1))
            name = next(one for one in numbered if one not in self._memory.goals)
        self._node.host.command(MarkGoal(name))
        self._node.get_logger().info(f'{name} is marked here')
        return name

    def diagnostic_values(self) -> dict[str, Any]:
        """Return the values for the diagnostics."""
        names = self._queue.names
        return {
            'goals': ', '.join(self._memory.goals) or 'none',
            'goal': names[0] if names else 'none',
            'goals_waiting': max(len(names) - 1, 0),
            'goal_links': len(self._memory),
        }
