# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links to recognised places, and the noise of the odometry that they measure.

Not in the papers; see docs/algorithm.md, "Links to recognised places".
"""

from __future__ import annotations

import math

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_weights import reach_m
from ratslam_ros.core.mapping.linked_graph import Closures
from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction


class RecognisedLinks:
    """What recognised views change on the map."""

    def __init__(self, experience_map: ExperienceMap, closures: Closures) -> None:
        self._map, self._closures = experience_map, closures

    def returned(self, action: MapAction) -> None:
        """Measure the noise of the odometry by a return to a known place.

        Nothing happens if ``recognised`` measures it.
        """
        own = self._map
        if action.recognised_id < 0 and own.mapping:
            place = own.pose_of(action.target_id)
            own.optimiser.noise.recognise(place, action.relative_rad, action.view_spacing_m)

    def recognised(self, action: MapAction) -> tuple[ClosureEvent, ...]:
        """Link the current experience to the one that the view was recognised as.

        Nothing happens if they are linked already, or are in different components, or if too few
        recognitions agree for the distance between the two, or the loop-closure gate contradicts.
        """
        own = self._map
        current, target = own.current_id, action.recognised_id
        if (
            not 0 <= target < len(own) or current in (NO_EXPERIENCE, target) or not own.mapping
            or own.is_apart(target) or own.link_table.row(current, target) is not None
        ):
            return ()
        place, here = own.pose_of(target), own.pose
        distance_m = math.hypot(place.x_m - here.x_m, place.y_m - here.y_m)
        spacing_m = action.view_spacing_m
        driven_m = own.odometer_m - own.recognised_at_m
        offset = Pose(0.0, 0.0, action.relative_rad)
        if distance_m > reach_m(driven_m, action.agreement, spacing_m) or (
            not self._closures.may_be_at(target, offset)
        ):
            return ()
        if distance_m < reach_m(0.0, 0.0, spacing_m):
            own.recognised_at_m = own.odometer_m
            if action.agreement == 1.0:  # few of these are false
                own.optimiser.noise.recognise(place, action.relative_rad, spacing_m)
        # If relaxation accepts a recognition beyond the bound, the next ones are within it.
        if action.agreement == 1.0 and not own.is_doubtful(target):
            own.fuse(composed(place, offset))
        own.connect(current, target, offset, '', is_leaf=False, recognised=True)
        return (ClosureEvent('closed', current, target),)
