# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Corrections of what was measured before the odometry was calibrated. Not in the papers."""

from __future__ import annotations

import math

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.rotation_gain import is_small_error
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.mapping.experience_map import ExperienceMap


def correct_turns(
    experience_map: ExperienceMap, before: TurnCorrection, now: TurnCorrection
) -> None:
    """Correct everything that was measured with another correction of the odometry.

    After a large change, the poses are composed anew along driven links, as relaxation only
    adjusts a map whose headings are about right. Links that are measured by scans are not
    corrected.
    """
    own = experience_map
    if own.parameters.exp_align_scans:
        return
    own.link_table.correct_turns(before, now)
    own.offset = _corrected(own.offset, before, now)
    if (departure := own.departure) is not None:
        offset = _corrected(departure.offset, before, now)
        own.departure = departure._replace(offset=offset)
    if not is_small_error(now.gain / before.gain):
        own.link_table.shares[:] = 1.0  # of recognitions, which had to agree with a wrong map
        _compose(own)
    own.optimiser.links_changed()


def _corrected(pose: Pose, before: TurnCorrection, now: TurnCorrection) -> Pose:
    """Return a relative pose by odometry with another correction of its turn."""
    x, y, turn = pose
    distance = math.hypot(x, y)
    half = 0.5 * (now.corrected(before.measured(turn, distance), distance) - turn)
    return composed(Pose(0.0, 0.0, half), Pose(x, y, turn + half))


def _compose(experience_map: ExperienceMap) -> None:
    """Compose the poses anew along the driven links, from one experience of each part."""
    links = experience_map.link_table
    reached: set[int] = set()
    for first in range(len(experience_map)):
        waiting = [first] if first not in reached else []
        reached.update(waiting)
        for i in waiting:
            driven = [link for link in links.of(i) if not link.recognised]
            for link in driven:
                to = link if link.source_id == i else link.reversed()
                if to.target_id not in reached:
                    reached.add(to.target_id)
                    waiting.append(to.target_id)
                    pose = composed(experience_map.pose_of(i), to.relative_pose)
                    experience_map.move(to.target_id, pose)
