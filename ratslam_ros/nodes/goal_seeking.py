# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal memory in the node of the pose cells: marking goals and publishing directions to them."""

from __future__ import annotations

import math
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.messages.mapping import encode_goal_memory
from ratslam_ros.nodes.diagnostics import Diagnostics
from ratslam_ros.nodes.qos import GOAL, STATE


class GoalSeeking:
    """Learns a goal memory, and publishes the direction to a goal while one is set."""

    def __init__(self, node: Node, diagnostics: Diagnostics, config: Config) -> None:
        self._node = node
        self._diagnostics = diagnostics
        self._config = config
        self._publisher = node.create_publisher(String, 'pose_cells/goal_memory', STATE)
        node.create_subscription(String, 'pose_cells/goal', self._on_goal, GOAL)
        node.create_service(Trigger, 'pose_cells/mark_goal', self._on_mark)

    def use_pose_cells(self, pose_cells: PoseCells, state: State | None = None) -> None:
        """Replace the pose cells and the goal memory.

        Args:
            pose_cells: the new pose cells.
            state: the goal memory saved with them; None: an empty one.

        Raises:
            UnusableInput: the state is of pose cells of another size; nothing is changed then.
        """
        memory = GoalMemory(self._config.goal_memory, self._config.pose_cells)
        if state is not None:
            memory.restore(state)
        self._pose_cells, self._memory = pose_cells, memory
        self._goal = ''

    def relocated(self) -> None:
        """Create no link from the place before a relocation to the next one."""
        self._memory.relocated()

    def memory_state(self) -> State:
        """Return the goal memory, for ``use_pose_cells``."""
        return self._memory.state()

    def integrate(self, stamp_ns: int, motion: Motion) -> None:
        """Learn from a motion that the pose cells have integrated; publish the direction."""
        with self._diagnostics.times('goal_memory'):
            self._memory.integrate(motion, self._pose_cells)
            if self._goal:
                self._publish(stamp_ns)

    def _publish(self, stamp_ns: int) -> None:
        memory, peak = self._memory, self._pose_cells.peak
        place = memory.goal(self._goal)
        bearing_rad, remaining_s = None, math.inf
        try:
            times = memory.recall(place)
        except UnreachableGoal as error:
            self._diagnostics.warn(f'no route to {self._goal}: {error}')
        else:
            bearing_rad, remaining_s = memory.bearing(times, peak), memory.remaining_s(times, peak)
        reached = memory.reached(place, peak)
        payload = encode_goal_memory(stamp_ns, self._goal, bearing_rad, remaining_s, reached)
        self._publisher.publish(String(data=payload))
        if reached:
            self._node.get_logger().info(f'{self._goal} is reached')
            self._goal = ''

    def _on_goal(self, message: String) -> None:
        """Set the goal by its name; an empty name ends the search."""
        if message.data:
            try:
                self._memory.goal(message.data)
            except UnreachableGoal as error:
                self._diagnostics.warn(str(error))
                return
        self._goal = message.data

    def _on_mark(self, request: Any, response: Any) -> Any:
        number = 1
        while f'goal_{number}' in self._memory.goals:
            number += 1
        name = f'goal_{number}'
        self._memory.mark(name, self._pose_cells.peak)
        self._node.get_logger().info(f'{name} is marked here')
        response.success, response.message = True, name
        return response

    def diagnostic_values(self) -> dict[str, Any]:
        """Return the values for the diagnostics."""
        return {
            'goals': ', '.join(self._memory.goals) or 'none',
            'goal': self._goal or 'none',
            'goal_links': len(self._memory),
        }
