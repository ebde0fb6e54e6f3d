# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Walls, corners and edges from laser scans, by split and merge.

Nguyen, Martinelli, Tomatis and Siegwart (2007), "A comparison of line extraction algorithms using
2D range data for indoor mobile robotics"; splits by a likelihood ratio, and weighted fits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config.line_extraction import LineExtractionParameters
from ratslam_ros.core.landmarks import line_kernels as kernels
from ratslam_ros.core.landmarks.features import Features
from ratslam_ros.core.landmarks.line_kernels import CORNER, EDGE, UNKNOWN, WALL

__all__ = ['CORNER', 'EDGE', 'UNKNOWN', 'WALL', 'LaserLandmarks', 'extract_landmarks']


@dataclass(frozen=True)
class LaserLandmarks:
    """Landmarks of one scan, in the robot's frame.

    A corner is a bar of length 0 whose direction bisects the free space. An edge is the end of a
    wall with free space behind it: a point. A wall with two real ends is a bar from its start to
    its end, counter-clockwise as seen by the robot, so that the robot is on its left. A part of a
    wall whose ends are hidden or out of range is no landmark.

    A complete wall repeats its ends, which are landmarks of their own. The joint covariance
    includes this; use ``without_walls`` where landmarks are taken as independent.

    Attributes:
        features: the landmarks with their joint covariance; identifiers are 0 to n - 1.
        kinds: (n,) CORNER, EDGE or WALL.
        segments_m: (w, 2, 2) start and end of all visible parts of walls, complete or not.
        ends: (w, 2) CORNER, EDGE or UNKNOWN of each start and end.
    """

    features: Features
    kinds: NDArray[np.int64]
    segments_m: NDArray[np.float64]
    ends: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.kinds)

    @cached_property
    def without_walls(self) -> Features:
        """Corners and edges, which contain all information about where walls end."""
        return self.features.selected(np.flatnonzero(self.kinds != WALL))


def extract_landmarks(scan: Scan, parameters: LineExtractionParameters) -> LaserLandmarks:
    """Extract walls, corners and edges from a scan.

    Args:
        scan: ranges that are not finite and positive are ignored.
        parameters: noise of the laser and of the walls.
    """
    p = parameters
    ranges, angles, is_full = kernels.ordered_beams(
        scan.ranges_m, float(scan.angle_min_rad), float(scan.angle_increment_rad), p.le_max_range_m
    )
    noise = p.le_range_sd_m, p.le_wall_sd_m
    spans, lines, covariances = kernels.find_walls(
        ranges, angles, is_full, *noise, p.le_min_length_m
    )
    ends, at, sds = kernels.find_ends(ranges, angles, is_full, *noise, spans, lines)
    kinds, _, offsets, values, covariance = kernels.landmarks_of(
        lines, covariances, ends, at, sds, p.le_wall_sd_m
    )
    features = Features(np.arange(len(kinds)), offsets, values, covariance)
    return LaserLandmarks(features, kinds, at, ends)
