# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the host of some stages needs of their nodes, and the parameters of these."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from rclpy.node import Node

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import SHARED, Config, Value
from ratslam_ros.files.config import to_yaml
from ratslam_ros.maps.parameter_changes import ParameterChanges
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.ros.diagnostics import Diagnostics
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
    _operations: MapOperations | None = None
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
        self.parameter_changes = ParameterChanges((self.SECTION, *self.PARTS), self.config)

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
        if self.parameter_changes.differences(before, self.config):
            self._reconfigure()
        self._on_set(before)

    def resume_parameters(self) -> None:
        """Set the parameters that were set while the restored memory was learned."""
        record = self.parameter_changes.state()
        if record:
            self.set_values({change.key: change.value for change in self.parameter_changes.record})
            self.parameter_changes.start_over(self.config, record)

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set parameters by ``section.name``."""
        self.set_parameters_atomically(self.checked.named(values))

    def _on_set(self, before: Config) -> None:
        """React to parameters that take effect at once."""

    def _reconfigure(self) -> None:
        """Let the stage use the present parameters from now on."""
        raise NotImplementedError

    # Implemented by the nodes, and called by the host

    def new_stages(self, config: Config) -> list[Stage]:
        """Return the stages of the node, with an empty memory."""
        raise NotImplementedError

    def connect(self, pipeline: Pipeline) -> None:
        """Observe the streams that the node publishes."""
        raise NotImplementedError

    def subscribe(self, stream: str) -> None:
        """Subscribe to one of the streams of ``TAKES``, which comes from outside."""
        raise NotImplementedError

    def before(self, stamp_ns: int) -> None:
        """Prepare for the next item of the stream."""
        if self._operations is not None:
            self._operations.before(stamp_ns)

    def processed(self, stream: str) -> None:
        """React to what a message of a stream, and those that it released, have changed."""

    def started_over(self) -> None:
        """Continue after the memory was emptied."""
        self.parameter_changes.start_over(self.config)
        self.diagnostics.clear()

    def start_run(self) -> None:
        """Expect stamps that are earlier than the last ones."""
        if self._operations is not None:
            self._operations.start_run()

    def silent(self) -> None:
        """Do what waits until no message arrives."""
        if self._operations is not None:
            self._operations.pause()

    @property
    def is_busy(self) -> bool:
        """Whether received messages wait that the host has not got yet."""
        return False

    def drop_tasks(self) -> None:
        """Drop what an earlier session was asked to do."""

    def send_again(self) -> None:
        """Send what other nodes may have missed, as this one was interrupted."""

    def lose_place(self) -> None:
        """Continue after a start in a saved map: the robot may be anywhere."""

    def _extra_state(self) -> State:
        """Return what the node keeps beside its stage."""
        return {}

    def restored(self, state: State) -> None:
        """Restore what ``_extra_state`` returned, after the stage was restored."""

    def _diagnostic_values(self) -> dict[str, Any]:
        """Return the node's own values for the diagnostics."""
        return {}

    # The same for all nodes

    @property
    def section(self) -> Any:
        """The parameters of the node's own section."""
        return getattr(self.config, self.SECTION)

    def saved_state(self) -> State:
        """Return the memory of the stage, and what belongs to it."""
        raise NotImplementedError

    def restore_saved(self, state: State) -> None:
        """Replace the memory; raise and change nothing if the new one cannot be used."""
        raise NotImplementedError

    def localise(self) -> None:
        """Stop learning."""
        raise NotImplementedError
