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
    found: dict[tuple[int, int, str], ClosureEvent] = {}
    robot = None if state.pose is None else state.pose.pose[:2]
    places = state.map.poses
    for view in reversed(state.recent):
        age_ns = state.stamp_ns - view.stamp_ns
        if age_ns > REJECTED_NS:
            break
        if not view.reason and (view.action != 'link' or age_ns > ACCEPTED_NS):
            continue
        target = view.recognised_id if view.recognised_id != NO_EXPERIENCE else view.target_id
        if not 0 <= target < len(places) or not np.isfinite(places[target, :2]).all():
            continue
        if view.reason:
            start = robot
            if 0 <= view.source_id < len(places):
                start = places[view.source_id, :2].tolist()
        elif (
            0 <= view.source_id < len(places)
            and abs(view.source_id - view.target_id) > CLOSURE_IDS
        ):  # fmt: skip
            target, start = view.target_id, places[view.source_id, :2].tolist()
        else:
            continue
        if start is None or not np.isfinite(start).all():
            continue
        key = (view.source_id, target, view.reason) if not view.reason else (-1, -1, view.reason)
        x, y = places[target, :2].tolist()
        found.setdefault(key, ClosureEvent((start[0], start[1]), (x, y), view.reason))
    return list(reversed(found.values()))
