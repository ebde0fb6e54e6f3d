# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the host of some stages needs of their nodes, and the parameters of these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from rclpy.node import Node

from ratslam_ros.core.config import DECLARATIONS, SHARED, Config, Value
from ratslam_ros.files.config import to_yaml
from ratslam_ros.pipeline.live_stages import LIVE_STAGES
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.inputs import Input
from ratslam_ros.ros.mapping.map_operations import MapOperations
from ratslam_ros.ros.parameters import NodeParameters


class HostedNode(Node):  # type: ignore[misc]
    """A node with the parameters of its sections, whose stage is run by a host.

    Changes of parameters that influence the map are commands of the stream, and are recorded with
    the memory that is learned with them.
    """

    SECTION: str
    """Name of the node, of its section of parameters and prefix of the topics it publishes."""
    SHARED: tuple[str, ...] = SHARED
    """Shared sections of parameters that the node reads."""
    PARTS: tuple[str, ...] = ()
    """Further sections of parameters that the node reads, for its optional functions."""

    TAKES: ClassVar[tuple[str, ...]] = ()
    """Streams that the node can receive from topics."""
    diagnostics: Diagnostics
    _stage: Any
    operations: MapOperations | None = None
    """Saving and loading of the maps of all nodes, for nodes that learn."""

    def __init__(self, initial: Config) -> None:
        """Create the node and declare its parameters.

        Args:
            initial: values of parameters that are not given to the node.

        Raises:
            UnusableParameter: a given parameter is unknown, of the wrong type or out of range.
        """
        super().__init__(self.SECTION, automatically_declare_parameters_from_overrides=True)
        try:
            self.checked = NodeParameters(
                self, initial, (*self.SHARED, self.SECTION), self.PARTS, self._on_parameters_set
            )
        except BaseException:
            self.destroy_node()  # the caller gets no node that it could destroy
            raise

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

    def _own_sections(self) -> str:
        return to_yaml(self.config, self.sections)

    def _on_parameters_set(self, before: Config) -> None:
        """React to parameters that were set."""
        raise NotImplementedError

    @property
    def stage_values(self) -> dict[str, Value]:
        """Parameters that the stage may use from its next message on, by ``section.name``."""
        return {
            key: value for key, value in self.config.flat().items()
            if key.partition('.')[0] in (self.SECTION, *self.PARTS)
            and DECLARATIONS[key][0].runtime == 'at next message'
        }  # fmt: skip

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set parameters by ``section.name`` that have other values."""
        present = self.config.flat()
        other = {key: value for key, value in values.items() if present[key] != value}
        if other:
            self.set_parameters_atomically(self.checked.named(other))

    # Implemented by the nodes, and called by the host

    def create_stage(self, config: Config) -> Stage:
        """Create and return the stage of the node."""
        stage = self._stage = self.new_stage(config)
        return stage

    def new_stage(self, config: Config) -> Stage:
        """Return the stage of the node, with an empty memory."""
        return LIVE_STAGES[self.SECTION](config, self.diagnostics)

    def connect(self, pipeline: Pipeline) -> None:
        """Create what the node publishes and receives, and observe the streams for it."""
        raise NotImplementedError

    def subscribe(self, stream: str) -> None:
        """Subscribe to one of the streams of ``TAKES``, which comes from outside."""
        raise NotImplementedError

    def subscribe_for_followers(self, stream: str) -> None:
        """Subscribe to a stream that only the processes that follow need."""
        raise NotImplementedError

    def watch(self, one: Input) -> None:
        """Report an input in the diagnostics, and process what waits if all are silent."""
        raise NotImplementedError

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

    def _diagnostic_values(self) -> dict[str, Any]:
        """Return the node's own values for the diagnostics."""
        return {}

    # The same for all nodes

    @property
    def section(self) -> Any:
        """The parameters of the node's own section."""
        return getattr(self.config, self.SECTION)


def given_config(nodes: Sequence[HostedNode]) -> Config:
    """Return a configuration with the sections of all nodes of a process."""
    return replace(nodes[0].config, **{
        section: getattr(node.config, section) for node in nodes for section in node.sections
    })  # fmt: skip
