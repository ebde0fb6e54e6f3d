# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping step: one map action, applied to the scan matcher and the experience map."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ratslam_ros.core.common.odometry import MotionFromOdometry
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.mapping.map_update import MapUpdate
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.pose_cells.map_action import MapAction

if TYPE_CHECKING:
    from ratslam_ros.core.mapping.relocator import Relocator
    from ratslam_ros.core.mapping.scan_matching import ScanMatcher


def adopt_correction(
    motion_of: MotionFromOdometry, experience_map: ExperienceMap, action: MapAction
) -> None:
    """Correct the odometry that follows an action, and what the map measured before it."""
    before, now = motion_of.correction, action.correction
    if now is not None and now != before:
        motion_of.correction = now
        experience_map.correct_turns(before, now)


def apply_action(
    experience_map: ExperienceMap, scan_matcher: ScanMatcher | None, stamp_ns: int,
    action: MapAction, behaviour: str = '', relocator: Relocator | None = None,
) -> MapUpdate:
    """Locate the robot by its scan if there is a laser, then apply one action to the map.

    Offline runs and nodes share this step, so that they build the same map.

    Args:
        experience_map: the map; changed.
        scan_matcher: scans of the map's experiences, changed; None without a laser.
        stamp_ns: stamp of the action.
        action: the action, with the ids of the map.
        behaviour: name of the behaviour that was active, '' if unknown.
        relocator: relocates the robot by its scans; None to relocate it by views only.

    Returns:
        The changes of the map.
    """
    scan_match = ScanMatch()
    if scan_matcher is not None:
        scan_match = scan_matcher.locate(
            stamp_ns, action, experience_map.current_id, experience_map.offset,
            experience_map.seen_from(action.target_id), experience_map.covariance,
        )
    update = experience_map.apply(action, behaviour, scan_match)
    if relocator is not None:
        source = experience_map.current_id
        relocation = relocator.step(stamp_ns, action, update)
        if relocation is not None:
            event = ClosureEvent(
                'relocated', source, relocation.experience_id, 'scans have proven the place'
            )
            update = replace(update, relocation=relocation, events=(*update.events, event))
        if relocator.is_lost:
            experience_map.lose('laser scans contradict it')
        elif relocator.confirms:
            experience_map.confirm()
    return update
