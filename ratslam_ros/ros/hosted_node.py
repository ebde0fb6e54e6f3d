# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a host uses of the nodes whose stages it runs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from std_srvs.srv import SetBool, Trigger

from ratslam_ros.core.common.odometry import MotionFromOdometry
from ratslam_ros.core.config import DECLARATIONS, Config, Value
from ratslam_ros.errors import RatslamError
from ratslam_ros.pipeline.live_stages import LIVE_STAGES
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.ros.inputs import Input
from ratslam_ros.ros.mapping.odometry_frames import OdometryFrames
from ratslam_ros.ros.parameters import NodeParameters
from ratslam_ros.ros.plain_node import PlainNode


class HostedNode(PlainNode, ABC):
    """A node with a stage: its parameters, and what the host calls."""

    PARTS: tuple[str, ...] = ()
    """Further sections of parameters that the node reads, for its optional functions."""
    TAKES: ClassVar[tuple[str, ...]] = ()
    """Streams that the node can receive from topics."""
    checked: NodeParameters
    inputs: list[Input]
    frames: OdometryFrames
    _stage: Any

    @property
    def config(self) -> Config:
        """All parameters; the sections of other nodes have their defaults."""
        return self.checked.config

    @property
    def parts(self) -> tuple[str, ...]:
        """The sections of PARTS that are in use; subclasses may leave some out."""
        return self.PARTS

    @property
    def sections(self) -> tuple[str, ...]:
        """Sections of parameters that belong to the node; a stage of the user has none."""
        return tuple(one for one in (self.SECTION, *self.PARTS) if hasattr(self.config, one))

    @property
    def stage_values(self) -> dict[str, Value]:
        """Parameters that the stage may use from its next message on, by ``section.name``."""
        return {
            key: value for key, value in self.config.flat().items()
            if key.partition('.')[0] in (self.SECTION, *self.PARTS)
            and DECLARATIONS[key][0].runtime == 'at next message'
        }

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set parameters by ``section.name`` that have other values."""
        present = self.config.flat()
        other = {key: value for key, value in values.items() if present[key] != value}
        if other:
            self.set_parameters_atomically(self.checked.named(other))

    @property
    def section(self) -> Any:
        """The parameters of the node's own section."""
        return getattr(self.config, self.SECTION)

    def offer(
        self, name: str, answer: Callable[..., str], kind: Any = Trigger, is_logged: bool = False
    ) -> None:
        """Offer a service whose response is a text, or the reason of a failure.

        Args:
            name: its name.
            answer: returns the text, given the data of a SetBool; raises RatslamError.
            kind: Trigger or SetBool.
            is_logged: whether the text is logged.
        """

        def respond(request: Any, response: Any) -> Any:
            try:
                text, success = answer(*([request.data] if kind is SetBool else [])), True
            except RatslamError as error:
                text, success = str(error), False
            if is_logged:
                self.report(success, text)
            response.success, response.message = success, text
            return response

        self.create_service(kind, name, respond)

    def report(self, success: bool, text: str) -> None:
        """Log a result."""
        if success:  # a line of code must always log with the same severity
            self.get_logger().info(text)
        else:
            self.get_logger().error(text)

    # Implemented by the nodes

    def create_stage(self, config: Config) -> Stage:
        """Create and return the stage of the node."""
        stage = self._stage = self.new_stage(config)
        self._motion = MotionFromOdometry(config.inputs.odom_source)
        return stage

    def new_stage(self, config: Config) -> Stage:
        """Return the stage of the node, with an empty memory."""
        return LIVE_STAGES[self.SECTION](config, self.diagnostics)

    def connect(self, pipeline: Pipeline) -> None:
        """Create what the node publishes and receives, and observe the streams for it."""

    @abstractmethod
    def subscribe(self, stream: str) -> None:
        """Subscribe to a stream that comes from outside."""

    def heard(self, stream: str, message: Any) -> None:
        """Note a message that the process has received or sent, before it is fed."""
        if stream == 'odometry':
            self.frames.update(message)

    def processed(self, stream: str) -> None:
        """React to what a message of a stream, and those that it released, have changed."""

    def started_over(self) -> None:
        """Continue after the memory was emptied."""
        self.diagnostics.clear()

    @property
    def is_busy(self) -> bool:
        """Whether received messages wait that the host has not got yet."""
        return False

    def drop_tasks(self) -> None:
        """Drop what an earlier session was asked to do."""

    def send_again(self) -> None:
        """Send what other nodes may have missed, as this one was interrupted."""

    def restored(self) -> None:
        """Continue after the stage was restored from a state."""
