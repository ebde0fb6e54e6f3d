# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Implementation of rclpy under test: the real one if ROS 2 is installed, else the stand-in."""

from pathlib import Path

from rclpy_standin import StandaloneUnavailable, install

ROOT = Path(__file__).parents[2]
SKIP_REASON = ''
IS_STAND_IN = False
try:
    IS_STAND_IN = install()
except StandaloneUnavailable as error:
    SKIP_REASON = str(error)
