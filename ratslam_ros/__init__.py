# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""RatSLAM for ROS 2 Jazzy, and for anyone with a recording and no ROS."""

__version__ = '0.1.0'
