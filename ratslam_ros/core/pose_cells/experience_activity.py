# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience activity: the peak and a place in the pose cells -> how active an experience is."""

from __future__ import annotations

from ratslam_ros.core.pose_cells.torus import Place, Torus


def activity(torus: Torus, peak: Place, place: Place, r_a: float, theta_a: float) -> float:
    """Return what an experience's place makes of its activity; seed 000, equations (1) to (3).

    Equation (4), that the experience has the present view, is the caller's.

    Args:
        torus: the extents; distances are the shortest way round.
        peak: the peak of activity.
        place: that of the experience.
        r_a, theta_a: where activity ends, in cells along (x, y) and along theta.

    Returns:
        2 at the place itself, 0 beyond either of the two.
    """
    r = torus.distance(peak._replace(theta=0.0), place._replace(theta=0.0)) / r_a
    theta = torus.distance(Place(0.0, 0.0, peak.theta), Place(0.0, 0.0, place.theta)) / theta_a
    return 0.0 if r > 1.0 or theta > 1.0 else 2.0 - r - theta
