# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Controls of a replay: change parameters, and replay again with them."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence

from ratslam_ros.core.config import Config
from ratslam_ros.viewer.run_source import Answer, NoControls

Again = Callable[[Sequence[str]], None]
"""Requests a replay with settings, each `section.name=value`."""


class ReplayControls(NoControls):
    """Parameters of a replay; they take effect when the recording is replayed again."""

    def __init__(self, config: Config, again: Again) -> None:
        """Start with the parameters of the first replay.

        Args:
            config: parameters of the first replay.
            again: requests another replay; it is called by a thread and returns at once.
        """
        super().__init__('This is a replay: it has no robot to command, only parameters.')
        self.actions = {'set_parameter': self.set_parameter, 'run_again': self.run_again}
        self._again = again
        self._changes: dict[str, object] = {}
        self._lock = threading.Lock()
        self.use(config)

    @property
    def settings(self) -> list[str]:
        """The changed parameters, each as ``section.name=value``."""
        with self._lock:
            return [f'{key}={_text(value)}' for key, value in self._changes.items()]

    def use(self, config: Config) -> None:
        """Set the parameters that a replay has had, such as those chosen for the recording."""
        with self._lock:
            self.parameters = {**config.flat(), **self._changes}

    def set_parameter(self, name: str, value: object) -> Answer:
        """Change a parameter for the next replay; the panel has checked the value."""
        with self._lock:
            self._changes[name] = value
            self.parameters = {**self.parameters, name: value}
        return Answer(True, f'{name} is {_text(value)} in the next replay')

    def run_again(self) -> Answer:
        """Replay the recording again with the changed parameters."""
        settings = self.settings
        self._again(settings)
        return Answer(True, f'replaying again with {", ".join(settings) or "the same parameters"}')


def _text(value: object) -> str:
    """Return a value as ``--set`` reads it."""
    return value if isinstance(value, str) else json.dumps(value)
