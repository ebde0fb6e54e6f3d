# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scan alignment by point-to-line ICP (iterative closest point) with a Gaussian prior."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.pose_covariance import (
    isotropic,
    largest_variance,
    sandwiched,
)

ITERATIONS = 15
"""Number of ICP iterations."""

CORRESPONDENCE_M = (0.8, 0.15)
"""Largest distance to the corresponding point, in the first and in the last iteration."""

POINT_SD_M = 0.05
"""Standard deviation of a point's distance to its line."""

PRIOR_SD_RAD = math.radians(6.0)
"""Standard deviation of the prior's heading."""

CORRELATED_COUNT = 30.0
"""Number of points that have the weight of one in the prior's favour."""

MAX_CORRELATION = 0.99
"""Largest correlation of neighbouring residuals, so that the covariance remains finite."""

INLIER_M, MIN_INLIER_RATIO, MIN_POINT_COUNT = 0.1, 0.7, 40
"""Distance to the line below which a point is an inlier. An alignment is rejected if the ratio of
inliers or the number of points of a scan is smaller than the other two."""

MAX_GAP_M = 0.5
"""Largest gap between neighbouring points that are connected to a line."""


class Alignment(NamedTuple):
    """Pose of a scan in the frame of another, and its (3, 3) covariance along the same axes.

    ``unconstrained_m2``: largest variance of the position if the points have ``POINT_SD_M`` and
    are correlated: how little the lines constrain the pose, whatever the prior is worth.
    """

    pose: Pose
    covariance: NDArray[np.float64]
    unconstrained_m2: float = math.inf


def align(
    reference: NDArray[np.floating[Any]], points: NDArray[np.float64], prior: Pose, sd_m: float,
    prior_covariance: NDArray[np.float64] | None = None,
) -> Alignment | None:
    """Return the pose of a scan in the frame of a reference scan; None if they do not match.

    They do not match if too few points are inliers, or if a scan has too few points. Directions
    that the lines do not constrain, such as the axis of a bare corridor, keep the prior.

    Args:
        reference: (n, 2) m, points of the reference scan in the order of its beams.
        points: (m, 2) m, points of the scan in the robot's frame.
        prior: expected pose of the scan in the frame of the reference scan.
        sd_m: standard deviation of the prior's position that its weight follows from, in m.
        prior_covariance: (3, 3) covariance of the prior's error, along the axes of the frame;
            None: as its weight says.
    """
    known = np.asarray(reference, np.float64)
    if prior_covariance is None:
        prior_covariance = isotropic(sd_m, PRIOR_SD_RAD)
    x, y, heading, inlier_ratio, unconstrained_m2, covariance = _point_to_line_icp(
        known, points, *prior, sd_m, prior_covariance
    )
    if inlier_ratio < MIN_INLIER_RATIO:
        return None
    return Alignment(Pose(x, y, wrap(heading)), covariance, unconstrained_m2)


@compiled
def _point_to_line_icp(
    reference: NDArray[np.float64], points: NDArray[np.float64], x0: float, y0: float, t0: float,
    sd_m: float, prior_covariance: NDArray[np.float64],
) -> tuple[float, float, float, float, float, NDArray[np.float64]]:
    """Return x, y in m, heading in rad, ratio of inliers, and the variances of ``Alignment``.

    The covariance propagates the errors of the prior and of the points, whose variance is that of
    the residuals. If neighbouring residuals have the correlation r, as in a first-order
    autoregressive process, n points are worth n (1 - r) / (1 + r) independent ones. Arguments as
    for ``align``; (x0, y0, t0) is the prior.
    """
    n, m = len(reference), len(points)
    if n < MIN_POINT_COUNT or m < MIN_POINT_COUNT:
        return x0, y0, t0, 0.0, math.inf, np.zeros((3, 3))
    # Unit normal of the line through the neighbours of each point, and its offset from the origin.
    normals = np.zeros((n, 3))
    for k in range(n):
        a, b = max(k - 1, 0), min(k + 1, n - 1)
        d_x, d_y = reference[b, 0] - reference[a, 0], reference[b, 1] - reference[a, 1]
        length = math.hypot(d_x, d_y)
        if 0.0 < length < 2 * MAX_GAP_M:
            normals[k, 0], normals[k, 1] = -d_y / length, d_x / length
            normals[k, 2] = normals[k, 0] * reference[k, 0] + normals[k, 1] * reference[k, 1]
    x, y, t = x0, y0, t0
    inlier_ratio = 0.0
    h = np.zeros((3, 3))
    prior_weight = np.zeros((3, 3))
    prior_weight[0, 0] = prior_weight[1, 1] = CORRELATED_COUNT * (POINT_SD_M / sd_m) ** 2
    prior_weight[2, 2] = CORRELATED_COUNT * (POINT_SD_M / PRIOR_SD_RAD) ** 2
    squares = products = weights = 0.0
    for iteration in range(ITERATIONS):
        part = iteration / (ITERATIONS - 1)
        reach = CORRESPONDENCE_M[0] * (CORRESPONDENCE_M[1] / CORRESPONDENCE_M[0]) ** part
        c, s = math.cos(t), math.sin(t)
        # Normal equations h * step = g of x, y and t, with the prior as a measurement.
        h = prior_weight.copy()
        g = np.zeros(3)
        g[0], g[1], g[2] = h[0, 0] * (x - x0), h[1, 1] * (y - y0), h[2, 2] * (t - t0)
        inliers = 0
        squares = products = weights = e_before = 0.0
        for i in range(m):
            r_x, r_y = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
            p_x, p_y = r_x + x, r_y + y
            nearest, least = -1, reach * reach
            for k in range(n):
                e_x, e_y = reference[k, 0] - p_x, reference[k, 1] - p_y
                away = e_x * e_x + e_y * e_y
                if away < least:
                    nearest, least = k, away
            if nearest < 0 or (normals[nearest, 0] == 0.0 and normals[nearest, 1] == 0.0):
                e_before = 0.0
                continue
            n_x, n_y = normals[nearest, 0], normals[nearest, 1]
            e = n_x * p_x + n_y * p_y - normals[nearest, 2]
            if abs(e) < INLIER_M:
                inliers += 1
            weight = 1.0 / (1.0 + (e / POINT_SD_M) ** 2 * 0.25)
            squares += weight * e * e
            products += weight * e * e_before
            weights += weight
            e_before = e
            lever = n_x * -r_y + n_y * r_x
            row = (n_x, n_y, lever)
            for a in range(3):
                g[a] += weight * row[a] * e
                for b in range(3):
                    h[a, b] += weight * row[a] * row[b]
        step = np.linalg.solve(h, g)
        x, y, t = x - step[0], y - step[1], t - step[2]
        inlier_ratio = inliers / m
    spread: NDArray[np.float64] = np.linalg.inv(h).astype(np.float64)
    unconstrained_m2 = CORRELATED_COUNT * POINT_SD_M**2 * largest_variance(spread)
    variance_m2 = correlation = 0.0
    if squares > 0.0:
        variance_m2 = squares / weights
        correlation = min(max(products / squares, 0.0), MAX_CORRELATION)
    variance_m2 *= (1.0 + correlation) / (1.0 - correlation)
    errors = variance_m2 * (h - prior_weight) + sandwiched(prior_weight, prior_covariance)
    return x, y, t, inlier_ratio, unconstrained_m2, sandwiched(spread, errors)
