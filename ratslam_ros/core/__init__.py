# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The algorithm itself: no ROS, no files, no clock. pipeline/ composes it."""
