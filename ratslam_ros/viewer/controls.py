# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Controls of a run to which nothing can be said."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ratslam_ros.viewer.run_source import Answer

FINISHED = (
    'This run is finished, so there is nothing to command. To command a robot, start its nodes '
    'with "ratslam launch --view".'
)


class NoControls:
    """Controls of a finished run."""

    def __init__(self, reason: str = FINISHED):
        self.reason = reason
        """Why there is nothing to command, for the user."""
        self.actions: Mapping[str, Callable[..., Answer]] = {}
        self.diagnostics: dict[str, tuple[str, str]] = {}
        self.places: Sequence[str] = ()
        self.switches: Mapping[str, bool] = {}
        self.parameters: dict[str, object] = {}
