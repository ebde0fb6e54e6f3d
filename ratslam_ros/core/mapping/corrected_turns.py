# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Corrections of what was measured before the odometry was calibrated. Not in the papers."""

from __future__ import annotations

from ratslam_ros.core.common.pose import composed, corrected_arc
from ratslam_ros.core.common.rotation_gain import is_small_error
from ratslam_ros.core.common.turn_correction import UNCORRECTED, TurnCorrection
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
    change = now.after(before.inverse)
    own.link_table.correct_turns(change)
    own.offset = corrected_arc(own.offset, change)
    if (departure := own.departure) is not None:
        own.departure = departure._replace(offset=corrected_arc(departure.offset, change))
    if not is_small_error(change.gain):
        own.link_table.shares[:] = 1.0  # of recognitions, which had to agree with a wrong map
        own.optimiser.turns = UNCORRECTED
        _compose(own)
    own.optimiser.links_changed()


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
