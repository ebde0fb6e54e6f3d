# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of LaserScan messages."""

from __future__ import annotations

from collections.abc import Callable

from sensor_msgs.msg import LaserScan

from ratslam_ros.core.common.scan import Scan, UnusableScan, checked_scan
from ratslam_ros.nodes.convert import stamp_ns


def accepted_scan(message: LaserScan, refuse: Callable[[str, str], None]) -> Scan | None:
    """Convert a scan; return None if it is unusable.

    Args:
        message: the scan.
        refuse: called with the stream and the reason if the scan is unusable.
    """
    try:
        return scan_from_message(message)
    except UnusableScan as error:
        refuse('scan', str(error))
        return None


def scan_from_message(message: LaserScan) -> Scan:
    """Convert a scan; raises UnusableScan."""
    return checked_scan(
        stamp_ns(message.header),
        float(message.angle_min),
        float(message.angle_increment),
        float(message.range_min),
        float(message.range_max),
        message.ranges,
    )
