# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of all nodes: parameters and diagnostics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from ratslam_ros.core.config.parameter import Section
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.parameters import declare
from ratslam_ros.ros.payloads import P, PayloadPublisher, decoded

DIAGNOSTICS_PERIOD_S = 1.0


class PlainNode(Node):  # type: ignore[misc]
    """A node with one section of parameters."""

    SECTION: ClassVar[str]
    """Name of the node, of its section of parameters and prefix of the topics it publishes."""
    PARAMETERS: ClassVar[type[Section]]

    def __init__(self) -> None:
        """Declare the parameters; end the node and raise if they cannot be used."""
        super().__init__(self.SECTION, automatically_declare_parameters_from_overrides=True)
        # With use_sim_time and no /clock, the node must still publish diagnostics.
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.diagnostics = Diagnostics(self)
        self._refuse = self.diagnostics.refuse
        try:
            self._begin()
        except BaseException:
            self.destroy_node()  # the caller gets no node that it could destroy
            raise
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady)

    def _begin(self) -> None:
        """Declare and use the parameters; raise UnusableParameter if they do not fit."""
        self._p: Any = declare(self, self.PARAMETERS)

    def create_payload_publisher(
        self, kind: type[P], qos: QoSProfile, topic: str = ''
    ) -> PayloadPublisher[P]:
        """Create a publisher of payloads, on the topic of their class unless another is given."""
        return PayloadPublisher(self, kind, qos, topic)

    def create_payload_subscription(
        self, kind: type[P], take: Callable[[P], object], qos: QoSProfile, stream: str = ''
    ) -> None:
        """Subscribe to payloads; ``stream`` names them in reports of refused ones."""
        receive = decoded(kind, take, self._refuse, stream)
        self.create_subscription(String, kind.TOPIC, receive, qos)

    def _publish_diagnostics(self) -> None:
        raise NotImplementedError

    @classmethod
    def warm_up(cls) -> None:
        """Compile what the node needs: most use no compiled functions."""

    def close(self) -> None:
        """End what the node has begun."""
