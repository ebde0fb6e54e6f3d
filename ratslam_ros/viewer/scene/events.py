# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Loop closures of the last seconds, accepted and rejected, with the reason."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer.scene.colouring import CLOSURE_IDS

ACCEPTED_NS = 3 * NS_PER_S
"""Run time for which an accepted closure is emphasised."""

REJECTED_NS = 5 * NS_PER_S
"""Run time for which a rejected closure is shown: enough to read the reason."""


@dataclass(frozen=True, slots=True)
class ClosureEvent:
    """A closure between two points on the map, in m; ``reason`` is '' if it was accepted."""

    a: tuple[float, float]
    b: tuple[float, float]
    reason: str


def recent_closures(state: RunState) -> list[ClosureEvent]:
    """Return the closures to emphasise, oldest first; a repeated reason is shown once."""
    found: dict[object, ClosureEvent] = {}
    robot = None if state.pose is None else state.pose.pose[:2]
    places = state.map.poses[:, :2]

    def place_of(number: int) -> tuple[float, float] | None:
        if not 0 <= number < len(places) or not np.isfinite(places[number]).all():
            return None
        x, y = places[number].tolist()
        return x, y

    for view in reversed(state.recent):
        age_ns, key = state.stamp_ns - view.stamp_ns, (view.source_id, view.target_id)
        if age_ns > REJECTED_NS:
            break
        start, end = place_of(view.source_id), place_of(view.target_id)
        if view.reason:
            start = start or robot
            if view.recognised_id != NO_EXPERIENCE:
                end = place_of(view.recognised_id)
        elif (
            view.action != 'link' or age_ns > ACCEPTED_NS
            or abs(view.source_id - view.target_id) <= CLOSURE_IDS
        ):
            continue
        if start is not None and end is not None:
            found.setdefault(view.reason or key, ClosureEvent(start, end, view.reason))
    return list(reversed(found.values()))
