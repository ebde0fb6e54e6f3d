# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of the map and of the robot on it: pose, markers, grid, changes, scans."""
