# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose cells: their activity and what they decided."""

from __future__ import annotations

from html import escape

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.panels.desk import Desk, put
from ratslam_ros.viewer.panels.html import block, dim, strong, table
from ratslam_ros.viewer.panels.texts import cells_text, decision_text

EXPLANATION = (
    'The box beside the map shows the pose cells: x and y across, heading upwards. It wraps '
    'around at all sides. Activity forms packets; the largest one is the estimate of the pose. A '
    'recognised view injects activity at the pose where it was learned. If that packet becomes '
    'the largest one, the estimate jumps and a loop closes.'
)


class CellsPanel:
    """Energy, packets and the decision of the pose cells."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self.text = desk.gui.add_html('')
        desk.gui.add_html(block(dim(EXPLANATION)))

    def update(self, state: RunState) -> None:
        """Show the activity of a moment."""
        required = self._desk.playback.source.required_views
        parts = [strong('Decision')]
        view = state.view
        parts.append(escape(decision_text(view, required)) if view else dim('no view'))
        parts.append(strong('Activity'))
        parts.append(table(cells_text(state.cells)) if state.cells else dim('not recorded'))
        put(self.text, 'content', block(*parts))
