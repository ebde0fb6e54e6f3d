# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compile, or load from the cache, every inner loop before the first message."""

from __future__ import annotations

import numpy as np

from ratslam_ros.core.config import Config
from ratslam_ros.core.local_view import ViewMatch
from ratslam_ros.core.odometry import Odometry, Pose, Twist
from ratslam_ros.core.ratslam import RatSLAM


def warm_up() -> None:
    """Run a small map through every compiled function; takes a while only where none is cached."""
    config = Config().with_values(
        {'local_view.template_x_size': 4, 'local_view.template_y_size': 2,
         'local_view.vt_shift_match': 1, 'local_view.vt_patch_normalise': 1,
         'pose_cells.pc_vt_agree_views': 0}
    )  # fmt: skip
    slam = RatSLAM(config, visual_odometry=True)
    for frame in range(3):
        slam.image(frame, np.full((4, 8), 60 * frame, np.uint8))
    slam = RatSLAM(config)
    for n in range(30):
        slam.odometry(Odometry(n * 10**9, Twist(1.0, 0.1), Pose(0.0, 0.0, 0.0)))
        slam.template(n * 10**9 + 1, ViewMatch(n % 15, n < 15, 0.0, 0.0))
    slam.pose_cells.activity()
