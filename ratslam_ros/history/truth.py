# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""True poses that are added to a history while it is read."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.history.run_state import NS_PER_S, RunState, Trail
from ratslam_ros.results.trajectory import Trajectory

MAX_GAP_NS = NS_PER_S
"""Difference of stamps up to which a true pose belongs to a pose of the robot."""


class Truth:
    """The true trajectory in the frame of the map.

    The truth is in a frame of its own. It is moved so that the robot starts where the map has it,
    with its true heading: this needs no more than the start of a run that is still growing, and
    shows the whole drift, unlike a least-squares fit.
    """

    def __init__(self, trajectory: Trajectory, start_ns: int, start: Pose) -> None:
        """Align a trajectory.

        Args:
            trajectory: the true poses.
            start_ns: stamp of the first pose on the map.
            start: that pose.
        """
        first = trajectory.pose(int(np.abs(trajectory.stamp_ns - start_ns).argmin()))
        to_map = composed(start, inverse(first))
        c, s = np.cos(to_map.heading_rad), np.sin(to_map.heading_rad)
        x_m, y_m = trajectory.position_m.T
        self._stamps = trajectory.stamp_ns
        self._headings = trajectory.heading_rad + to_map.heading_rad
        self._points = np.stack(
            [to_map.x_m + c * x_m - s * y_m, to_map.y_m + s * x_m + c * y_m], axis=1
        )
        trail, kept = Trail(), []
        for row, (x, y) in enumerate(self._points.tolist()):
            before = trail.version
            trail.add((x, y))
            if trail.version != before and self._stamps[row] >= start_ns:
                kept.append(row)
        self._trail_stamps = self._stamps[kept]
        self._trail_points = self._points[kept]

    def apply(self, state: RunState) -> None:
        """Set the true pose and trail of a state."""
        if state.pose is None:
            return
        row = int(np.abs(self._stamps - state.pose.stamp_ns).argmin())
        if abs(int(self._stamps[row]) - state.pose.stamp_ns) <= MAX_GAP_NS:
            x_m, y_m = self._points[row].tolist()
            truth = Pose(x_m, y_m, float(self._headings[row]))
            state.pose = replace(state.pose, truth=truth)
        count = int(np.searchsorted(self._trail_stamps, state.stamp_ns, 'right'))
        if count and len(state.truth.points_m) != count:
            state.truth.replace(self._trail_points[:count])
