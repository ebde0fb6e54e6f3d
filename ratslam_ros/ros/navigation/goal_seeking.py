# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal memory in the node of the pose cells: marking goals and publishing directions to them."""

from __future__ import annotations

import math
from typing import Any

from std_msgs.msg import String

from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.messages.pose_cells import GoalMemoryPayload
from ratslam_ros.pipeline.commands import MarkGoal
from ratslam_ros.pipeline.pose_cells import PoseCellsStage
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.qos import GOAL, STATE


class GoalSeeking:
    """Learns a goal memory, and publishes the direction to a goal while one is set."""

    def __init__(self, node: RatslamNode, stage: PoseCellsStage) -> None:
        self._node, self._stage = node, stage
        self._goal = ''
        self._publisher = node.create_payload_publisher(GoalMemoryPayload, STATE)
        node.create_subscription(String, 'pose_cells/goal', self._on_goal, GOAL)
        node.offer('pose_cells/mark_goal', self._on_mark)

    @property
    def _memory(self) -> GoalMemory:
        assert self._stage.goal_memory is not None
        return self._stage.goal_memory

    def reset(self) -> None:
        """Seek no goal any more."""
        self._goal = ''

    def update(self, stamp_ns: int) -> None:
        """Publish the direction after a motion, if a goal is set."""
        if self._goal:
            self._publish(stamp_ns)

    def _publish(self, stamp_ns: int) -> None:
        memory, peak = self._memory, self._stage.core.peak
        place = memory.goal(self._goal)
        bearing_rad, remaining_s = None, math.inf
        try:
            times = memory.recall(place)
        except UnreachableGoal as error:
            self._node.diagnostics.warn(f'no route to {self._goal}: {error}')
        else:
            bearing_rad, remaining_s = memory.bearing(times, peak), memory.remaining_s(times, peak)
        reached = memory.reached(place, peak)
        self._publisher.publish(
            GoalMemoryPayload.of(stamp_ns, self._goal, bearing_rad, remaining_s, reached)
        )
        if reached:
            self._node.get_logger().info(f'{self._goal} is reached')
            self._goal = ''

    def _on_goal(self, message: String) -> None:
        """Set the goal by its name; an empty name ends the search."""
        if message.data:
            try:
                self._memory.goal(message.data)
            except UnreachableGoal as error:
                self._node.diagnostics.warn(str(error))
                return
        self._goal = message.data

    def _on_mark(self) -> str:
        number = 1
        while f'goal_{number}' in self._memory.goals:
            number += 1
        name = f'goal_{number}'
        self._node.host.command(MarkGoal(name))
        self._node.get_logger().info(f'{name} is marked here')
        return name

    def diagnostic_values(self) -> dict[str, Any]:
        """Return the values for the diagnostics."""
        return {
            'goals': ', '.join(self._memory.goals) or 'none',
            'goal': self._goal or 'none',
            'goal_links': len(self._memory),
        }
