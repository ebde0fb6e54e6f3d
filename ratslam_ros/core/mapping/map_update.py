# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What one action changes on the map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation


class PrunedExperience(NamedTuple):
    """An experience that was removed, and the neighbour that represents it from now on.

    ``stand_in_id``: id of that neighbour, -1 if there is none. ``pose``: pose of the pruned
    experience in the frame of that neighbour, or of the start if there is none.
    """

    experience_id: int
    stand_in_id: int
    pose: Pose


@dataclass(frozen=True, slots=True)
class MapUpdate:
    """What one map action changed.

    ``pruned``: the experience that made room for a new one. ``events``: loop closures, rejections
    and relocations. ``relocation``: where scans have relocated the robot after the action, None if
    they have not.
    """

    pruned: PrunedExperience | None = None
    events: tuple[ClosureEvent, ...] = ()
    relocation: MapRelocation | None = None

    @property
    def reason(self) -> str:
        """Why the loop-closure gate rejected the transition; '' if it did not.

        If it did, links and current experience are as before.
        """
        return next((one.reason for one in self.events if one.outcome == 'rejected'), '')
