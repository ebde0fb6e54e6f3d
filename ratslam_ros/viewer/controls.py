# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Controls of a run to which nothing can be said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ratslam_ros.viewer.run_source import Answer

FINISHED = (
    'This run is finished, so there is nothing to command. To command a robot, start its nodes '
    'with "ratslam launch --view".'
)


class NoControls:
    """Controls of a finished run: every request is refused with the same reason."""

    def __init__(self, reason: str = FINISHED):
        self.reason = reason
        """Why there is nothing to command, for the user."""
        self.actions: frozenset[str] = frozenset()
        self.diagnostics: dict[str, tuple[str, str]] = {}
        self.places: Sequence[str] = ()
        self.switches: Mapping[str, bool] = {}
        self.parameters: dict[str, object] = {}

    def _refused(self) -> Answer:
        return Answer(False, self.reason)

    def go_to(self, x_m: float, y_m: float, then: bool = False) -> Answer:
        """Refuse."""
        return self._refused()

    def go_to_place(self, name: str, then: bool = False) -> Answer:
        """Refuse."""
        return self._refused()

    def name_place(self, name: str) -> Answer:
        """Refuse."""
        return self._refused()

    def cancel_goals(self) -> Answer:
        """Refuse."""
        return self._refused()

    def explore(self, on: bool) -> Answer:
        """Refuse."""
        return self._refused()

    def pause_nodes(self, on: bool) -> Answer:
        """Refuse."""
        return self._refused()

    def mapping(self, on: bool) -> Answer:
        """Refuse."""
        return self._refused()

    def relocate(self) -> Answer:
        """Refuse."""
        return self._refused()

    def save(self) -> Answer:
        """Refuse."""
        return self._refused()

    def load(self) -> Answer:
        """Refuse."""
        return self._refused()

    def reset(self) -> Answer:
        """Refuse."""
        return self._refused()

    def set_parameter(self, name: str, value: object) -> Answer:
        """Refuse."""
        return self._refused()

    def run_again(self) -> Answer:
        """Refuse."""
        return self._refused()
