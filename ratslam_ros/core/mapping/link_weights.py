# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Link weights: inverse variances of odometry and recognitions, robust against false ones.

Maximum likelihood needs each link weighted by the inverse of its variance. The variance of
odometry grows with the distance driven, that of a recognition does not depend on it. Both are
expressed in view spacings, the only scale of the scene that is known without calibration: a view
can be recognised within about a spacing of the place where it was learned.

Recognitions can be false. Their residuals have the robust kernel of Geman and McClure (1985), by
iteratively reweighted least squares: each relaxation is followed by new weights for the residuals
that remain. A new recognition starts with its full weight. A loop is thus closed in spite of the
drift, and reopened if the rest of the map contradicts it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.mapping.relaxation import link_residual

Reals = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

LEAST_ODOMETRY_STD, LEAST_ODOMETRY_STD_RAD = 0.02, 0.01
"""Standard deviations of a link of length zero: position in view spacings, and heading."""

VIEW_STD, VIEW_STD_RAD = 0.25, 0.15
"""Standard deviation of a recognition: position in view spacings, and heading."""

KERNEL_STDS = 2.0
"""Residual, in standard deviations, at which the weight of a recognition is a quarter."""


NEAR_SPACINGS, MAX_DRIFT = 10.0, 0.3
"""Error of the robot's position on the map that all agreeing recognitions together may correct:
view spacings, and share of the distance driven since the last recognition."""


def reach_m(driven_m: float, agreement: float, view_spacing_m: float) -> float:
    """Return the largest distance of a recognised place from the robot on the map.

    It is proportional to the number of recognitions that agree, at least two view spacings, and
    not limited if their number is the one required anywhere.

    Args:
        driven_m: distance driven since the last recognition.
        agreement: share of the required number of recognitions that agree.
        view_spacing_m: view spacing.
    """
    if agreement >= 1.0:
        return math.inf
    far_m = max(NEAR_SPACINGS * view_spacing_m, MAX_DRIFT * driven_m)
    return max(agreement * far_m, 2.0 * view_spacing_m)


@compiled
def geman_mcclure(squared: float) -> float:
    """Return the weight of a residual, 0 to 1.

    Args:
        squared: square of the residual in standard deviations.
    """
    share = 1.0 / (1.0 + squared / (KERNEL_STDS * KERNEL_STDS))
    return share * share


@compiled
def link_weights(
    shapes: Reals, recognised: Flags, shares: Reals, view_spacing_m: float, odometry_std: float,
    odometry_std_rad: float,
) -> Reals:
    """Return the weights of all links, (links, 2): position in 1/m^2, heading in 1/rad^2.

    Args:
        shapes: (links, 3) distance in m, heading and facing in rad.
        recognised: (links,) whether a link is a recognition; the others are odometry.
        shares: (links,) share of its full weight that each recognition has.
        view_spacing_m: view spacing.
        odometry_std, odometry_std_rad: standard deviations of position, in view spacings, and
            heading after one view spacing of odometry.
    """
    weights = np.empty((shapes.shape[0], 2))
    for link in range(shapes.shape[0]):
        if recognised[link]:
            share = max(shares[link], 1e-6)  # never 0, so that no experience loses its last link
            weights[link, 0] = share / (VIEW_STD * VIEW_STD)
            weights[link, 1] = share / (VIEW_STD_RAD * VIEW_STD_RAD)
        else:
            spacings = shapes[link, 0] / view_spacing_m
            variance = odometry_std * odometry_std * spacings
            weights[link, 0] = 1.0 / (variance + LEAST_ODOMETRY_STD * LEAST_ODOMETRY_STD)
            variance = odometry_std_rad * odometry_std_rad * spacings
            weights[link, 1] = 1.0 / (variance + LEAST_ODOMETRY_STD_RAD * LEAST_ODOMETRY_STD_RAD)
        weights[link, 0] /= view_spacing_m * view_spacing_m
    return weights


@compiled
def reweigh(
    poses: Reals, ends: Indices, shapes: Reals, recognised: Flags, shares: Reals,
    view_spacing_m: float,
) -> float:
    """Compute the share of its full weight that each recognition has at the present poses.

    Args:
        poses: (n, 3) x, y in m and heading in rad.
        ends: (links, 2) source and target.
        shapes, recognised, view_spacing_m: as for ``link_weights``.
        shares: (links,) shares; changed in place.

    Returns:
        The largest change of a share.
    """
    largest = 0.0
    for link in range(ends.shape[0]):
        if not recognised[link]:
            continue
        _, _, x_m, y_m, turn_rad = link_residual(poses, ends, shapes, link)
        x, y, turn = x_m / view_spacing_m, y_m / view_spacing_m, turn_rad / VIEW_STD_RAD
        squared = (x * x + y * y) / (VIEW_STD * VIEW_STD) + turn * turn
        share = geman_mcclure(squared)
        largest = max(largest, abs(share - shares[link]))
        shares[link] = share
    return largest
