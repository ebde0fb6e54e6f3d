# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the host of some stages needs of their nodes."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any, ClassVar

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.stage import Stage
from ratslam_ros.ros.configured_node import ConfiguredNode
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.mapping.map_operations import MapOperations


class HostedNode(ConfiguredNode):
    """A node whose stage is run by a host, which calls the methods below."""

    TAKES: ClassVar[tuple[str, ...]] = ()
    """Streams that the node can receive from topics."""
    REPEATS: ClassVar[tuple[str, ...]] = ()
    """Streams that the node sends again after a restart from a map file."""
    diagnostics: Diagnostics
    _operations: MapOperations | None = None
    """Saving and loading of the maps of all nodes, for nodes that learn."""

    # Implemented by the nodes

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

    def drop_queued(self) -> int:
        """Drop received messages that the host has not got yet; return their number."""
        return 0

    def drop_tasks(self) -> None:
        """Drop what an earlier session was asked to do."""

    def caught_up(self, are_images_lost: bool) -> None:
        """Prepare for the messages that were sent while the node was restarted."""

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
        return self._section

    def times(self, name: str) -> AbstractContextManager[None]:
        """Return a context manager that measures a step."""
        return self.diagnostics.times(name)

    def count(self, reason: str, number: int) -> None:
        """Count messages that are not used."""
        self.diagnostics.counts[reason] += number

    def drop(self, reason: str, text: str, number: int = 1) -> None:
        """Count messages that are not used, and warn."""
        self.diagnostics.drop(reason, text, number)

    def saved_state(self) -> State:
        """Return the memory of the stage, and what belongs to it."""
        raise NotImplementedError

    def restore_saved(self, state: State) -> None:
        """Replace the memory; raise and change nothing if the new one cannot be used."""
        raise NotImplementedError

    def localise(self) -> None:
        """Stop learning."""
        raise NotImplementedError
