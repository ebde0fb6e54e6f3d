# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Closures that the drift of the map, or a laser scan, contradicts. Not in the papers.

See docs/algorithm.md, "Loop-closure gate".
"""

from __future__ import annotations

import numpy as np

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.carried import AGREEING_COUNT
from ratslam_ros.core.mapping.linked_graph import Closures
from ratslam_ros.core.mapping.loop_closure_gate import (
    LOST_COUNT,
    REQUIRED_COUNT,
    ClosureEvent,
    Excess,
    Outcome,
    long_known_experience,
    path_covariance,
)
from ratslam_ros.core.mapping.pose_covariance import compound
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE

SCAN_CHECK_SPACING_M = 1.0
"""Travelled distance between two checks of the scan against long-known experiences."""


class GatedClosures(Closures):
    """Rejects transitions beyond the bound of the covariance, if ``exp_gate_closures`` is set."""

    def judged(
        self, target: int, target_offset: Pose, scan_match: ScanMatch
    ) -> ClosureEvent | None:
        """Return why a transition makes no link, None if it makes one; see ``Closures``."""
        robot, gate = self._robot, self._robot.gate
        claimed = composed(robot.pose_of(target), target_offset)
        if robot.mapping and not robot.is_doubtful(target) and (
            robot.carried.may_move(robot.odometer_m, robot.pose, claimed)
        ):
            return self._found(target, target_offset, claimed)
        excess = self._excess(target, target_offset)
        if excess is None:
            return None
        reason, relocated = str(excess), False
        if self._scan_confirms_pose(scan_match):
            gate.reject_by_scan(robot.pose)
            reason += '; the scan confirms the present pose'
        else:
            by_views = self._p.exp_relocate != 'landmarks' or scan_match.fits is None
            relocated = gate.record_closure(robot.pose, claimed, by_views)
            reason += f'; {gate.agreeing_count} of {REQUIRED_COUNT} closures agree'
            if by_views and not relocated and gate.agreeing_count >= LOST_COUNT:
                robot.lose('recognised places contradict it')
        if relocated:
            robot.carried.restart()
        outcome: Outcome = 'relocated' if relocated else 'rejected'
        return ClosureEvent(outcome, robot.current_id, target, reason)

    def _found(self, target: int, target_offset: Pose, claimed: Pose) -> ClosureEvent | None:
        """Move what was learned since the robot was carried, once views agree on where."""
        robot, reason = self._robot, 'the robot seems to have been carried'
        if not robot.gate.record_closure(
            robot.pose, claimed, required_count=AGREEING_COUNT
        ):
            reason += '; another view has to agree'
            return ClosureEvent('rejected', robot.current_id, target, reason)
        source = robot.current_id
        is_moved = robot.separate_since(robot.carried.since_m)
        robot.carried.restart()
        if not is_moved:
            return ClosureEvent('relocated', source, target, reason)
        robot.rejoin(target, target_offset)
        return None

    def may_be_at(self, target: int, target_offset: Pose) -> bool:
        """Return whether a recognised place is within the bound; see ``Closures``."""
        return not self._robot.carried.is_lost and self._excess(target, target_offset) is None

    def check_view(self, template_id: int, scan_match: ScanMatch) -> None:
        """Compare a view with those of the map at the robot's pose; scans know better."""
        robot = self._robot
        if scan_match.fits is not None or not self._p.exp_gate_closures:
            return
        if robot.current_id == NO_EXPERIENCE:
            return
        if not robot.mapping and not robot.carried.is_lost:
            return  # nothing is learned in a wrong place
        changed = robot.carried.view(
            robot.template_ids, robot.poses, robot.created_m, robot.odometer_m, robot.pose,
            template_id,
        )
        if changed and robot.carried.is_lost:
            robot.lose('its views are not those of the map here')
        elif changed:
            robot.confirm()

    def check_scan(self, scan_match: ScanMatch) -> None:
        """Check the scan against long-known experiences, once per ``SCAN_CHECK_SPACING_M``."""
        if scan_match.fits is None:
            return
        if self._robot.odometer_m - self.checked_m >= SCAN_CHECK_SPACING_M:
            self.checked_m = self._robot.odometer_m
            if self._scan_confirms_pose(scan_match):
                self._robot.confirm()

    def _excess(self, target: int, target_offset: Pose) -> Excess | None:
        """Return by how much a transition displaces the robot, None if it is within the bound."""
        robot, p = self._robot, self._p
        if not p.exp_gate_closures or not robot.mapping or robot.current_id == NO_EXPERIENCE:
            return None
        is_linked = robot.link_table.row(robot.current_id, target) is not None
        if is_linked and not robot.gate.rejecting:
            return None
        excess, optimiser = self._path_excess(target, target_offset), robot.optimiser
        if excess is None or optimiser.is_settled or (
            not optimiser.is_enabled or p.exp_relaxation != 'solve'
        ):
            return excess
        # The poses may still contain the error of a loop closure that has not been relaxed.
        robot.settle()
        optimiser.discard_budget()
        return self._path_excess(target, target_offset)

    def _path_excess(self, target: int, target_offset: Pose) -> Excess | None:
        robot = self._robot
        claimed, measured = composed(robot.pose_of(target), target_offset), robot.view_covariance
        excess = Excess.of(robot.pose, claimed, measured)
        if excess is None:
            return None
        noise = robot.optimiser.noise.variance(robot.view_spacing_m)
        poses, here = robot.poses, robot.current_id
        ends, lengths_m = robot.link_ends, robot.link_table.shapes[:, 0]
        path = path_covariance(poses, ends, lengths_m, here, target, noise)
        if path is None:  # The ways between both are blocked; their lengths are known.
            blocked = robot.blocked_ends
            steps_m = poses[blocked[:, 1], :2] - poses[blocked[:, 0], :2]
            ends = np.concatenate([ends, blocked])
            lengths_m = np.concatenate([lengths_m, np.hypot(*steps_m.T)])
            path = path_covariance(poses, ends, lengths_m, here, target, noise)
        if path is None:
            return None
        compound(path, *robot.offset, robot.travelled_m, *noise)
        return Excess.of(robot.pose, claimed, path + measured)

    def _scan_confirms_pose(self, scan_match: ScanMatch) -> bool:
        """Return whether the scan fits a long-known experience at the robot's present pose."""
        robot = self._robot
        if scan_match.fits is None or robot.gate.accepts_next:
            return False
        known = long_known_experience(
            robot.poses, robot.created_m, robot.odometer_m, robot.pose
        )
        return known is not None and scan_match.fits(
            known, composed(inverse(robot.pose_of(known)), robot.pose)
        )
