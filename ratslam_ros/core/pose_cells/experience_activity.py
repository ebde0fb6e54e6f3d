# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Activity of an experience as a function of its distance from the peak of the pose cells."""

from __future__ import annotations

from ratslam_ros.core.pose_cells.torus import Place, Torus


def activity(torus: Torus, peak: Place, place: Place, r_a: float, theta_a: float) -> float:
    """Compute the activity of an experience whose template matches the current view.

    Milford et al. (2006), equations (1) to (3). The caller applies equation (4): experiences of
    other templates have no activity.

    Args:
        torus: extents of the pose cells.
        peak: place of the largest activity in the pose cells.
        place: place of the experience.
        r_a: distance along (x, y) at which the activity drops to zero, in cells.
        theta_a: difference of heading at which the activity drops to zero, in cells.

    Returns:
        Activity from 0 to 2: 2 if the places are equal, 0 beyond ``r_a`` or ``theta_a``.
    """
    r = torus.distance(peak._replace(theta=0.0), place._replace(theta=0.0)) / r_a
    theta = torus.distance(Place(0.0, 0.0, peak.theta), Place(0.0, 0.0, place.theta)) / theta_a
    return 0.0 if r > 1.0 or theta > 1.0 else 2.0 - r - theta
