# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose cells: a continuous attractor network that turns odometry and template ids into actions."""
