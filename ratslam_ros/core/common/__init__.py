# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses, odometry, scans, stamps and compilation: what every part of the core uses."""
