# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which views close a loop."""

from __future__ import annotations

from collections import deque

from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.history.records import ViewRecord

NEWEST_COUNT = 10
"""A transition to one of the newest experiences closes no loop."""

MAX_CLOSURES = 500
"""Largest number of listed loop closures: more than a page shows."""


class ClosureDetector:
    """Finds the views of a run that close a loop; it must see all of them in order."""

    def __init__(self) -> None:
        self._recognised_id = NO_EXPERIENCE
        self._newest: deque[int] = deque(maxlen=NEWEST_COUNT)

    def add(self, view: ViewRecord) -> bool:
        """Return whether a view closes a loop, or would have but for a reason."""
        recognised, self._recognised_id = self._recognised_id, view.recognised_id
        if view.action == 'create':
            self._newest.append(view.target_id)
        return (
            view.reason != '' or view.relocated_to != NO_EXPERIENCE
            or (view.action == 'link' and view.target_id not in self._newest)
            or (
                view.recognised_id != recognised
                and view.recognised_id not in (NO_EXPERIENCE, *self._newest)
            )
        )
