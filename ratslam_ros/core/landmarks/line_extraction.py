# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Corners and edges of walls from laser scans, by split and merge.

Nguyen et al. (2007), "A comparison of line extraction algorithms using 2D range data for indoor
mobile robotics"; here with splits by a likelihood ratio, and weighted fits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.landmarks.features import BAR_SIZE, Features, Observations
from ratslam_ros.core.landmarks.line_kernels import find_walls, ordered_beams
from ratslam_ros.core.landmarks.models import LaserModel
from ratslam_ros.core.landmarks.wall_end_kernels import find_ends, landmarks_of


class LaserLandmarks(NamedTuple):
    """Corners and edges in one scan, in the robot's frame; all are bars of the length 0.

    The direction of a corner bisects the free space. An edge is the end of a wall with free space
    behind it, and its direction is that from the edge along the wall. Ends of walls that are
    hidden or out of range are no landmarks.

    An edge may be a corner whose other wall is out of sight. From a place that shows both walls,
    it is another landmark at the same position, with another direction.

    Attributes:
        features: the landmarks with their joint covariance; identifiers are 0 to n - 1.
        kinds: (n,) CORNER or EDGE, see ``wall_end_kernels``.
    """

    features: Features
    kinds: NDArray[np.int64]


def observations_of(features: Features) -> Observations:
    """Return bars in the robot's frame as observations with variances of their own.

    Correlations are dropped: the noise of range, bearing, direction and length is taken as
    independent.
    """
    starts, covariance = features.offsets[:-1], features.covariance
    variances = np.diagonal(covariance).reshape(-1, BAR_SIZE).copy()
    xx, yy, xy = variances[:, 0].copy(), variances[:, 1].copy(), covariance[starts, starts + 1]
    x, y = features.positions_m[:, 0], features.positions_m[:, 1]
    squared = x * x + y * y
    variances[:, 0] = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / squared
    variances[:, 1] = (y * y * xx - 2.0 * x * y * xy + x * x * yy) / (squared * squared)
    values = features.values.reshape(-1, BAR_SIZE).copy()
    values[:, 0] = np.sqrt(squared)
    values[:, 1] = [math.atan2(b, a) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    return Observations(values, features.identifiers, variances)


def extract_landmarks(scan: Scan, model: LaserModel = LaserModel()) -> LaserLandmarks:
    """Extract corners and edges of walls from a scan.

    Args:
        scan: ranges that are not finite and positive are ignored.
        model: noise of the laser and of the walls.
    """
    ranges, angles, is_full = ordered_beams(
        scan.ranges_m, float(scan.angle_min_rad), float(scan.angle_increment_rad),
        model.max_range_m,
    )
    noise = model.range_sd_m, model.wall_sd_m
    spans, lines, covariances = find_walls(
        ranges, angles, is_full, *noise, model.min_length_m
    )
    ends, at, sds = find_ends(ranges, angles, is_full, *noise, spans, lines)
    kinds, values, covariance = landmarks_of(
        lines, covariances, ends, at, sds, model.wall_sd_m
    )
    # The beams are evenly spaced about the laser; directions and covariances stay those there.
    values[::BAR_SIZE] += scan.x_m
    values[1::BAR_SIZE] += scan.y_m
    n = len(kinds)
    features = Features(np.arange(n), BAR_SIZE * np.arange(n + 1), values, covariance)
    return LaserLandmarks(features, kinds)
