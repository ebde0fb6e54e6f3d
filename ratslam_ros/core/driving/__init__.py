# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local planning: velocity commands from laser scans, along a route or for exploration."""
