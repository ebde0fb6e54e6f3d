# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Source of the ROS time of a node: system time or /clock."""

from __future__ import annotations

from typing import Any

from rclpy_standin.clock import ROSClock, Time
from rclpy_standin.parameters import Parameter
from rclpy_standin.qos import QoSProfile, ReliabilityPolicy
from rclpy_standin.types import message_class

USE_SIM_TIME = 'use_sim_time'
_CLOCK_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class TimeSource:
    """Switches the clock of a node between system time and /clock, following use_sim_time."""

    def __init__(self, node: Any, clock: ROSClock) -> None:
        self._node = node
        self._clock = clock
        self._subscription: Any = None

    def attach(self) -> None:
        """Declare use_sim_time if necessary, apply its value, and follow its changes."""
        if not self._node.has_parameter(USE_SIM_TIME):
            self._node.declare_parameter(USE_SIM_TIME, False)
        self._apply(self._node.get_parameter(USE_SIM_TIME).value)
        self._node.add_on_set_parameters_callback(self._on_set_parameters)

    def _apply(self, enabled: Any) -> None:
        if not isinstance(enabled, bool):
            self._node.get_logger().error(
                f'Invalid type for parameter {USE_SIM_TIME!r}: should be bool'
            )
            return
        self._clock.set_simulated(enabled)
        if enabled and self._subscription is None:
            self._subscription = self._node.create_subscription(
                message_class('rosgraph_msgs/msg/Clock'),
                '/clock',
                lambda message: self._clock.simulate(Time.from_msg(message.clock).nanoseconds),
                _CLOCK_QOS,
            )
        elif not enabled and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _on_set_parameters(self, parameters: list[Parameter]) -> Any:
        result = message_class('rcl_interfaces/msg/SetParametersResult')(successful=True)
        for parameter in parameters:
            if parameter.name == USE_SIM_TIME:
                if parameter.type_ == Parameter.Type.BOOL:
                    self._apply(parameter.value)
                else:
                    result.successful = False
                    result.reason = f'{USE_SIM_TIME} parameter set to something besides a bool'
        return result
