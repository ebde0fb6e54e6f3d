# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes without a stage: parameters of their own, and diagnostics."""

from __future__ import annotations

from typing import Any, ClassVar

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ratslam_ros.core.config.parameter import Section
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.node import DIAGNOSTICS_PERIOD_S
from ratslam_ros.ros.parameters import declare


class PlainNode(Node):  # type: ignore[misc]
    """A node with one section of parameters."""

    SECTION: ClassVar[str]
    """Name of the node."""
    PARAMETERS: ClassVar[type[Section]]
    parts: tuple[str, ...] = ()

    def __init__(self) -> None:
        """Declare the parameters; end the node and raise if they cannot be used."""
        super().__init__(self.SECTION, automatically_declare_parameters_from_overrides=True)
        try:
            self._p: Any = declare(self, self.PARAMETERS)
            self._prepare()
        except BaseException:
            self.close()
            self.destroy_node()
            raise
        self._diagnostics = Diagnostics(self)
        self._refuse = self._diagnostics.refuse
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady)

    def _prepare(self) -> None:
        """Use the parameters; raise UnusableParameter if they do not fit."""

    def _publish_diagnostics(self) -> None:
        raise NotImplementedError

    @classmethod
    def warm_up(cls) -> None:
        """Compile what the node needs: most use no compiled functions."""

    def close(self) -> None:
        """End what the node has begun."""
