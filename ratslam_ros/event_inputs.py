# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of recorded events to the inputs of RatSLAM."""

from __future__ import annotations

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, checked_scan
from ratslam_ros.recordings import OdometryEvent, ScanEvent


def odometry_from_event(event: OdometryEvent) -> Odometry:
    """Return the twist and the planar pose of an odometry event."""
    return Odometry(
        event.stamp_ns,
        Twist(event.linear_x, event.angular_z),
        Pose(event.x, event.y, event.heading_rad),
    )


def scan_from_event(event: ScanEvent) -> Scan:
    """Return the checked scan of an event.

    Raises:
        UnusableScan: angles, range limits or number of beams are invalid.
    """
    return checked_scan(
        event.stamp_ns,
        event.angle_min_rad,
        event.angle_increment_rad,
        event.range_min_m,
        event.range_max_m,
        event.ranges_m,
    )
