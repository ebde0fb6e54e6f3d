# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What of the states of all parts is learned, and what is only the robot's present situation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ratslam_ros.core.common.state import State

PRESENT = {
    'visual_odometry', 'inputs',
    # Local view: its motion, the images it has seen, and where the robot is.
    'local_view/has_matched', 'local_view/ahead', 'local_view/core/motion',
    'local_view/core/low_texture', 'local_view/core/sequence',
    'local_view/core/look_alikes/now', 'local_view/core/look_alikes/bent/now',
    'local_view/core/look_alikes/seen_at_m',
    # Pose cells: activity, recent recognitions, current experience and component, and the
    # measurements since the last view.
    'pose_cells/motion', 'pose_cells/relocations', 'pose_cells/sequence',
    'pose_cells/goal_memory/present', 'pose_cells/core/present', 'pose_cells/core/packets',
    'pose_cells/core/unrolled/peak', 'pose_cells/core/unrolled/here',
    'pose_cells/core/messages',
    'pose_cells/core/last_template', 'pose_cells/core/current', 'pose_cells/core/since_current',
    'pose_cells/core/stepped', 'pose_cells/core/agreement',
    'pose_cells/core/components/current', 'pose_cells/core/components/gaps',
    'pose_cells/core/components/alive', 'pose_cells/core/lengths/gap',
    'pose_cells/core/lengths/latest', 'pose_cells/core/calibration/turned_rad',
    'pose_cells/core/calibration/visited',
    # Experience map: the robot's pose, its drive so far, recent closures and scans.
    'experience_map/correction', 'experience_map/motion', 'experience_map/dead_reckoning',
    'experience_map/joining/next', 'experience_map/core/current',
    'experience_map/core/offset', 'experience_map/core/duration_s', 'experience_map/core/way_m',
    'experience_map/core/odometer_m', 'experience_map/core/recognised_at_m',
    'experience_map/core/odometry_noise/trail', 'experience_map/core/odometry_noise/motion',
    'experience_map/core/odometry_noise/driven_m', 'experience_map/core/odometry_noise/present',
    'experience_map/core/jumps', 'experience_map/core/present',
    'experience_map/core/components/current', 'experience_map/core/components/gaps',
    'experience_map/scans/present', 'experience_map/relocator/present',
    'experience_map/relocator/counts',
}
"""Paths of all entries of ``RatSLAM.state()`` that localisation changes."""

PLACES, RECENT_USE = 'pose_cells/core/memories', slice(5, 7)
"""Associations of templates with places; the last columns say how often each was seen lately."""


def learned(states: Mapping[str, State]) -> dict[str, State]:
    """Return what the states of all parts contain apart from the robot's present situation.

    While ``RatSLAM.mapping`` is False, it stays the same.

    Args:
        states: from ``RatSLAM.state``.
    """
    found = _learned(states, '')
    assert isinstance(found, dict)
    return found


def _learned(value: Any, path: str) -> Any:
    if path == PLACES:
        kept = value.copy()
        kept[:, RECENT_USE] = 0.0
        return kept
    if not isinstance(value, Mapping):
        return value
    inside = {key: f'{path}/{key}' if path else str(key) for key in value}
    return {
        key: _learned(item, inside[key])
        for key, item in value.items() if inside[key] not in PRESENT
    }
