# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result of scan matching, and what it replaces."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.pose_covariance import Matrix

VIEW_SD_M = 0.4
"""Standard deviation of the offset between the positions where a view was learned and where it is
recognised."""

TURN_M_PER_RAD = 0.3
"""Distance that turning by one rad counts as."""


class ScanMatch(NamedTuple):
    """Poses of the robot relative to the current and the target experience, None if unknown.

    Covariances are (3, 3), in the robot's frame, at the stamp of the scan.
    """

    from_current: Pose | None = None
    from_target: Pose | None = None
    fits: Callable[[int, Pose], bool] | None = None
    """Function of an experience id and the robot's pose in its frame that returns whether the scan
    fits there. None without a scan."""
    covariance: Matrix | None = None
    """Of ``from_target``."""
    current_covariance: Matrix | None = None
    """Of ``from_current``."""
    driven_m: float = 0.0
    """Distance driven since the scan; turns count as ``TURN_M_PER_RAD`` says."""
