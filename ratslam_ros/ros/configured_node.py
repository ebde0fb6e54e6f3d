# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes: their parameters, and changes of these while a node runs."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

from rclpy.node import Node

from ratslam_ros.core.config import Config
from ratslam_ros.files.config import to_yaml
from ratslam_ros.ros.parameter_changes import ParameterChanges, decode_values
from ratslam_ros.ros.parameters import NodeParameters


class ConfiguredNode(Node):  # type: ignore[misc]
    """A node with the parameters of its sections.

    Changes of parameters that influence the map are commands of the stream, and are recorded with
    the memory that is learned with them.
    """

    SECTION: str
    """Name of the node, of its section of parameters and prefix of the topics it publishes."""
    PARTS: tuple[str, ...] = ()
    """Further sections of parameters that the node reads, for its optional functions."""

    def __init__(self, initial: Config) -> None:
        """Create the node and declare its parameters.

        Args:
            initial: values of parameters that are not given to the node.

        Raises:
            UnusableParameter: a given parameter is unknown, of the wrong type or out of range.
        """
        super().__init__(self.SECTION, automatically_declare_parameters_from_overrides=True)
        self._lock = threading.RLock()
        """Serialises the thread that processes images with services and timers."""
        try:
            self._checked = NodeParameters(
                self, initial, self.SECTION, *self.PARTS, changed=self._on_parameters_set
            )
        except BaseException:
            self.destroy_node()  # the caller gets no node that it could destroy
            raise
        self.parameter_changes = ParameterChanges((self.SECTION, *self.PARTS), self.config)
        self._set_from_ns = 0

    @property
    def config(self) -> Config:
        """All parameters; the sections of other nodes have their defaults."""
        return self._checked.config

    @property
    def parts(self) -> tuple[str, ...]:
        """The sections of PARTS that are in use; subclasses may leave some out."""
        return self.PARTS

    @property
    def _section(self) -> Any:
        return getattr(self.config, self.SECTION)

    @property
    def parameter_stream(self) -> str:
        """Name of the changes of parameters in the log of a map file."""
        return f'{self.SECTION}_parameters'

    def _own_sections(self) -> str:
        return to_yaml(self.config, (self.SECTION, *self.PARTS))

    def _on_parameters_set(self, before: Config) -> None:
        with self._lock:
            if self.parameter_changes.differences(before, self.config):
                self._reconfigure(self._set_from_ns)
        self._on_set(before)

    def resume_parameters(self, logged: Iterable[tuple[int, bytes]]) -> None:
        """After a restart, set the parameters again that were set before.

        Args:
            logged: stamps and values of changes after the restored state.
        """
        values = {change.key: change.value for change in self.parameter_changes.record}
        record = self.parameter_changes.state()
        if values:
            self.set_parameters_atomically(self._checked.named(values))
            self.parameter_changes.start_over(self.config, record)
        for stamp_ns, data in logged:
            self._set_from_ns = stamp_ns
            self.set_parameters_atomically(self._checked.named(decode_values(data)))
        self._set_from_ns = 0

    def _on_set(self, before: Config) -> None:
        """React to parameters that take effect at once."""

    def _reconfigure(self, from_ns: int) -> None:
        """Let the stage use the present parameters from a stamp on; 0: from now on."""
        raise NotImplementedError
